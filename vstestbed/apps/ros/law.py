"""The law as a node: pictures and readings of a robot in, twists out, for a real robot or the
simulated one.
"""

from __future__ import annotations

import bisect
import logging
import math
import threading
import time
from dataclasses import replace
from typing import TypeVar

import numpy as np

from vstestbed.apps.ros.link import Link
from vstestbed.apps.ros.messages import (
    CLOCK,
    COMPRESSED,
    IMAGE,
    OPTICAL,
    Message,
    PassedOver,
    body_frame,
    check_finite,
    check_single,
    depth_of,
    joints_of,
    picture_of,
    reading_of,
    sensors_of,
    text,
    time_of,
    twist,
)
from vstestbed.camera import DepthImage
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.loop.controller import FROZEN, Controller
from vstestbed.loop.ego_motion import believed_mount, mount_at
from vstestbed.robots import Mount, Order, Reading, Robot
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.frame import Cycle

REMEMBERED = 400  # readings of each topic, two seconds of joints at 200 Hz
OF_CLOCK_S = 10.0  # stamps this near to a running `/clock` are of it, and so are all that follow
# stamps this near to the clock of this machine are of it; others are of a simulation, or of a bag
WALL_S = 3600.0
# for how long a picture waits for the reading of its exposure, unless the next picture comes first
# [s]
WAIT_S = 1.0
RESTART_S = 5.0  # a clock that goes back by more has begun anew [s]
# by so much a camera's clock may be slower than this machine's; a queue that grows no faster is not
# noticed [s/s]
DRIFT = 2e-4
LONGEST_S = 10.0  # a watchdog that lets a twist stand for longer is none [s]
CLOCK_SET = "by the node's own clock; if the camera's was set or started anew, start this node anew"
SET_CLOCKS = "set the clocks of both machines by NTP"
LATE = 1.5  # a reading this many camera periods away from a picture's exposure is none of it


def command_topic(scenario: Scenario) -> str:
    """Where twists go: as MoveIt Servo takes them for an arm, as bases take them for all else."""
    return "/servo_node/delta_twist_cmds" if scenario.robot.base == "fixed" else "/cmd_vel"


def command_frame(scenario: Scenario) -> str:
    """In which frame twists are: the camera's, which arms take; the body's of a base, and of an arm
    in front of a camera in the room.
    """
    by_camera = scenario.robot.base == "fixed" and not scenario.target.on_gripper
    return OPTICAL if by_camera else body_frame(scenario.robot)


def sent(scenario: Scenario, mount: Mount, order: Order, q: Array) -> Array:
    """The twist (6,) of an order in the frame in which twists are sent; of a robot whose joints are
    at q.
    """
    if command_frame(scenario) == OPTICAL:
        return order.twist
    return mount_at(scenario, mount, q).to_flange @ order.twist


def watchdog_of(scenario: Scenario, given: float | None) -> float:
    """The time without the other side after which a node rests [s]; by default for as long as an
    order lasts. ParameterError: no time.
    """
    watchdog_s = given or scenario.timing.order_s(scenario.camera)
    if not 0 < watchdog_s <= LONGEST_S:
        words = (
            "for so long the last twist may stand;"
            " by default it is as long as an order lasts (`timing.command_timeout_s`)"
        )
        raise ParameterError.bound(
            "--watchdog", "between", f"0 and {LONGEST_S:g} s", watchdog_s, words
        )
    return watchdog_s


Heard = TypeVar("Heard")


def _remember(known: list[tuple[float, Heard]], t: float, heard: Heard) -> None:
    """Put what was heard in its place by time: a reading of an exposure may come after a later one;
    of one time the newer counts.
    """
    if known and t < known[-1][0] - RESTART_S:
        known.clear()
    after = bisect.bisect_left(known, t, key=lambda one: one[0])
    same = after < len(known) and known[after][0] == t
    known[after : after + same] = [(t, heard)]
    del known[:-REMEMBERED]


def _nearest(known: list[tuple[float, Heard]], t: float) -> tuple[float, Heard]:
    """What was heard nearest to a time [s]; of infinity the newest."""
    return known[-1] if t == math.inf else min(known, key=lambda one: abs(one[0] - t))


class Senses:
    """What was heard of a robot, by time: readings are found for the exposure of a picture, and for
    now.

    robot: whose. near_s: a reading further than this from an exposure is none of it [s].
    """

    def __init__(self, robot: Robot, near_s: float):
        self._robot = robot
        self._near_s = near_s
        self._heard: dict[str, list[tuple[float, Message]]] = {
            topic: [] for topic in sensors_of(robot)
        }
        self._joints: list[tuple[float, tuple[Array, Array]]] = []
        self._others = ""  # why joints that were heard are none of this robot's
        self.passed = PassedOver()
        self._lock = threading.Lock()

    def hear(self, topic: str, message: Message) -> None:
        """Remember a message of a topic of `sensors_of`; joints of another device, such as a
        gripper, are passed over and counted, and so is what has numbers that are none.
        """
        t = time_of(message)
        with self._lock:
            try:
                if topic == "joint_states":
                    _remember(self._joints, t, joints_of(message, self._robot.joints))
                else:
                    check_finite(topic, message)
            except ParameterError as error:
                if topic == "joint_states":
                    self._others = str(error)
                self.passed.note(topic, t, error)
                return
            _remember(self._heard[topic], t, message)

    def clear(self) -> None:
        """Forget all: what is heard from now on may be of another run of the robot, at the same
        times.
        """
        with self._lock:
            self._joints.clear()
            for known in self._heard.values():
                known.clear()

    def until(self, stamp: float) -> bool:
        """Whether every topic was heard up to a time [s]."""
        with self._lock:
            return all(known and known[-1][0] >= stamp - 1e-9 for known in self._heard.values())

    def at(self, stamp: float | None = None) -> Reading:
        """The reading at a time [s], of joints by a straight line between two messages; None: the
        newest. ParameterError: nothing was heard of a topic, or nothing near to that time.
        """
        with self._lock:
            known = {topic: list(messages) for topic, messages in self._heard.items()}
            joints = list(self._joints)
        if self._others and not joints:
            raise ParameterError(self._others)
        near = math.inf if stamp is None else stamp
        times: dict[str, float] = {}
        nearest: dict[str, Message] = {}
        for topic, messages in known.items():
            if messages:
                times[topic], nearest[topic] = _nearest(messages, near)
        reading = reading_of(self._robot, nearest)
        if stamp is not None:
            self._check_near(times, stamp)
        return reading if not joints else replace(reading, **self._between(joints, stamp))

    def _check_near(self, times: dict[str, float], stamp: float) -> None:
        """Refuse what was heard too long before or after a picture."""
        for name, t in times.items():
            if abs(t - stamp) > self._near_s:
                words = (
                    f"of {name} nearest to the picture of {stamp:.3f} s is of {t:.3f} s;"
                    " are both stamped by one clock?"
                )
                raise ParameterError("readings", words)

    @staticmethod
    def _between(
        joints: list[tuple[float, tuple[Array, Array]]], stamp: float | None
    ) -> dict[str, Array]:
        """Positions and velocities at a time; velocities that the driver does not tell are those of
        the way between two messages.
        """
        times = [t for t, _ in joints]
        stamp = times[-1] if stamp is None else stamp
        after = min(max(int(np.searchsorted(times, stamp, side="left")), 1), len(joints) - 1)
        t0, (q0, qd0) = joints[after - 1]
        t1, (q1, qd1) = joints[after]
        share = 1.0
        way = np.zeros_like(q1)
        if t1 > t0:
            share = min(max((stamp - t0) / (t1 - t0), 0.0), 1.0)
            way = (q1 - q0) / (t1 - t0)
        q = q0 + share * (q1 - q0)
        qd = qd0 + share * (qd1 - qd0)
        if share in (0.0, 1.0):  # to the last digit
            q, qd = (q1, qd1) if share else (q0, qd0)
        return {"q": q, "qd": np.where(np.isfinite(qd), qd, way)}


class Feed:
    """The controller of a scenario, fed with messages: its clock begins with the first picture. It
    is the same for a node and for a bag.

    scenario: whose detector, law, calibration and robot work. live: stamps are of this machine's
    clock where they are near to it.
    """

    def __init__(self, scenario: Scenario, live: bool = True):
        check_single(scenario.camera)
        self.scenario = scenario
        self._live = live
        self.controller = Controller(scenario)
        self.senses = Senses(scenario.robot, LATE * scenario.camera.period)
        self.mount = believed_mount(scenario)
        self._order_s = scenario.timing.order_s(scenario.camera)
        self._latest_s = scenario.timing.latest_s(scenario.camera)
        self.began: float | None = None
        self.controller.simulates(not live)
        # Which clock stamps are of, and how late pictures came, outlive a reset: a queue does, too.
        self.by_wall = False
        self.hint = ""
        # The own clock minus the stamp, of another clock: of the task's first picture, and the
        # sooner ones of two that followed each other.
        self._first_s = self._soonest_s = math.inf
        self._last = -math.inf, math.inf  # stamp, and the own clock minus it
        self._newest = -math.inf
        self._heard_s = 0.0
        self.depth: Message | None = None

    def reset(self) -> None:
        """Begin the task anew with the next picture. How late pictures came so far is kept, unless
        stamps begin anew.
        """
        self.controller.reset()
        self.began = self.depth = None
        self._first_s = math.inf

    @property
    def before(self) -> float | None:
        """The stamp of the last picture that was used [s]; None before the first."""
        last = self.controller.before
        return None if last is None or self.began is None else self.began + last.t

    def step(
        self, message: Message, arrived: float | None = None, heard: float | None = None
    ) -> Cycle:
        """One control step for a picture. arrived: when it came [s], by the clock of the stamps;
        None: after `camera.latency_s`, or as the own clock tells: heard, when it came by a clock
        that goes on while the robot moves [s]; None: time is simulated. ParameterError: see
        `Controller.step`; an encoding that is not read; no reading near to the exposure.
        """
        stamp = time_of(message)
        picture = picture_of(message)
        given = self.senses.at(stamp), self.senses.at()
        depth = self._depth_at(stamp)
        # Once it is the clock of this machine, a stamp far from it is wrong. One of 0, before a
        # driver has begun, tells nothing.
        self.by_wall = self.by_wall or (self._live and abs(time.time() - stamp) < WALL_S)
        self.hint = ""
        if self._live:
            self.controller.simulates(heard is None)
        if arrived is None:
            arrived = self._came(stamp, heard)
        if self.began is None:
            self.began = stamp
        now = None if arrived is None else max(arrived, stamp) - self.began
        return self.controller.step(picture, stamp - self.began, given, now, depth=depth)

    def _came(self, stamp: float, heard: float | None) -> float | None:
        """When a picture comes [s], by the clock of this machine where stamps are of it, or as the
        own clock tells; None where time is simulated.
        """
        if self.by_wall:
            return self._arrived(stamp)
        if heard is None:
            return None
        arrived = self._arrived_by(stamp, heard)
        if arrived - stamp > self._latest_s:
            self.hint = CLOCK_SET
        return arrived

    def _arrived(self, stamp: float) -> float:
        """When a picture comes that is stamped by this machine's clock [s]. ParameterError: its
        stamp is far ahead, and tells no age.
        """
        now = time.time()
        if stamp - now > self._order_s:
            raise ParameterError(
                f"the picture's stamp is {stamp - now:.3g} s ahead of this machine's clock;"
                f" {SET_CLOCKS}"
            )
        return now

    def _arrived_by(self, stamp: float, heard: float) -> float:
        """When a picture comes, by a clock of which no more is known than this [s]: its age is
        unknown, but not by how much it grows, of stamps that hardly advance, or a queue that fills.
        A single stamp that is ahead counts for no longer than its task.
        """
        if stamp == 0:  # it tells nothing
            return heard - min(self._first_s, self._soonest_s, heard)
        behind_s = heard - stamp
        drift_s = DRIFT * (heard - self._heard_s)
        if self._first_s == math.inf and stamp < self._newest - RESTART_S:
            self._soonest_s = math.inf
            self._last = -math.inf, math.inf
            self._newest = -math.inf
        self._first_s = behind_s if self._first_s == math.inf else self._first_s + drift_s
        self._soonest_s += drift_s
        if stamp != self._last[0]:
            self._soonest_s = min(self._soonest_s, max(behind_s, self._last[1]))
            self._newest = max(self._newest, min(stamp, self._last[0]))
            self._last = stamp, behind_s
        self._heard_s = heard
        return heard - min(self._first_s, self._soonest_s, behind_s)

    def clock_told(self, now: float, heard: float) -> None:
        """The `/clock` of the stamps told a time [s], when the own clock told another: where it
        ends, that goes on from there.
        """
        self._first_s = self._soonest_s = heard - now
        self._last = now, heard - now
        self._newest = now
        self._heard_s = heard

    def _depth_at(self, stamp: float) -> DepthImage | None:
        if self.depth is None:
            return None
        t = time_of(self.depth)
        if self._live and abs(t - stamp) > self._order_s:
            raise ParameterError("depth", f"is of {t:.3f} s, and the picture of {stamp:.3f} s")
        return depth_of(self.depth)

    def silent(self, elapsed_s: float) -> Order:
        """The order so long after the last picture [s]."""
        last = self.controller.before
        t = (0.0 if last is None else last.t) + elapsed_s
        return self.controller.without_picture(t, self.senses.at())

    def sent(self, order: Order) -> Array:
        """The twist (6,) of an order in the frame in which twists are sent (`command_frame`)."""
        return sent(self.scenario, self.mount, order, self.senses.at().q)


class LawNode:
    """The node: it serves `~/start`, `~/stop` and `~/reset`, and says in `~/status` what it does. A
    stop is latched: no twist but zero leaves it until `~/start`, whatever it sees.

    link: to the others. watchdog_s: wall time without a new picture after which zero is sent [s];
    by default for as long as an order lasts.
    started: servo at once; else with `~/start`.
    """

    def __init__(
        self, scenario: Scenario, link: Link, watchdog_s: float | None = None, started: bool = False
    ):
        self.servo = Feed(scenario)
        self.link = link
        self.scenario = scenario
        self.watchdog_s = watchdog_of(scenario, watchdog_s)
        self._stopped = "" if started else "not started"
        self._asked_to_reset = self._moved = False  # moved: it has sent a twist since it was reset
        # with the times of the own clock and `/clock` at which it was heard
        self._picture: tuple[Message, float, float] | None = None
        # when the last new picture was heard
        self._fresh = time.monotonic()
        self._fresh_clock_s = math.nan
        self._moves = self._spins = False  # moves: the twist in force is none of rest
        # of `/clock`, and when it last advanced, by the own clock
        self._clock_s = math.nan
        self._ticked_at = -math.inf
        self._clock_anew = False  # its next time counts, although it may be an earlier one
        # when the twist in force was given, by both clocks: by a picture, when that was heard
        self._order_of = -math.inf, math.nan
        self._latest_s = scenario.timing.latest_s(scenario.camera)
        self._of_clock = False  # the pictures are stamped by a `/clock` that has run
        # that clock runs: pictures, orders and the law's work are as old as it says, and in
        # lockstep it stands
        self._simulated = False
        self._news = threading.Condition()
        self._status = ""
        self.took_s: list[float] = []
        for name, kind in sensors_of(scenario.robot).items():
            link.subscribe(name, kind, lambda message, name=name: self._sensed(name, message))
        link.subscribe("/vstestbed_robot/image_raw", IMAGE, self._seen)
        link.subscribe("/vstestbed_robot/image_raw/compressed", COMPRESSED, self._seen)
        link.subscribe("/clock", CLOCK, self._ticked)
        if scenario.law.depth.measured:
            link.subscribe("/vstestbed_robot/depth", IMAGE, self._deep)
        link.serve("~/start", self.start)
        link.serve("~/stop", self.stop)
        link.serve("~/reset", self.reset)
        link.publishes(command_topic(scenario), "~/status")

    def _sensed(self, topic: str, message: Message) -> None:
        self.servo.senses.hear(topic, message)
        with self._news:
            self._news.notify()

    def _seen(self, message: Message) -> None:
        with self._news:
            # the newest: one that the law had no time for is past
            self._picture = message, time.monotonic(), self._clock_s
            self._news.notify()

    def _ticked(self, message: Message) -> None:
        told = message.clock.sec + 1e-9 * message.clock.nanosec
        if self._clock_anew or not told <= self._clock_s:  # of two clocks the later one counts
            self._clock_s = told
            self._ticked_at = time.monotonic()
            self._clock_anew = False

    def _by_clock(self, stamp: float) -> bool:
        """Whether a stamp is of a `/clock` that runs, and simulated; not of a dead one, or of
        somebody else. Before the first twist it stands still in lockstep, where the robot waits for
        one. Once stamps were of it, one that is far from it is late, or wrong.
        """
        runs = time.monotonic() - self._ticked_at < self.watchdog_s
        near = abs(self._clock_s - stamp) < OF_CLOCK_S and abs(self._clock_s - time.time()) > WALL_S
        self._of_clock = self._of_clock or (runs and near)
        if runs and self._of_clock:
            self.servo.clock_told(self._clock_s, self._ticked_at)
        return (runs and self._of_clock) or (near and not self._moved)

    def _arrived(self, stamp: float) -> float | None:
        """When a picture came by `/clock`, where it is late [s]. ParameterError: its stamp is of
        the future.
        """
        if not self._simulated:
            return None
        age_s = self._clock_s - stamp
        if age_s < -OF_CLOCK_S:
            raise ParameterError(f"the picture's stamp is {-age_s:.3g} s ahead of /clock")
        return self._clock_s if age_s > self._latest_s else None

    def _since(self, own_s: float, clock_s: float) -> float:
        """The time since two clocks told these times [s], by the one that counts: in lockstep
        `/clock` stands while the law is at work.
        """
        return self._clock_s - clock_s if self._simulated else time.monotonic() - own_s

    def _deep(self, message: Message) -> None:
        self.servo.depth = message

    def start(self) -> tuple[bool, str]:
        """Servo from the next picture on, anew after a stop."""
        with self._news:
            if self._stopped:
                self._begin_anew()
                self._stopped = ""
        return True, "servoing"

    def _begin_anew(self) -> None:
        self._asked_to_reset = self._clock_anew = True
        self.servo.senses.clear()

    def stop(self, why: str = "asked to stop") -> tuple[bool, str]:
        """Stop, until `start`."""
        with self._news:
            self._stopped = self._stopped or why
            self._rest(self._stopped)
            self._news.notify()
        return True, self._stopped

    def reset(self) -> tuple[bool, str]:
        """Forget the task so far, and a stop with it; it stays stopped until `start`."""
        with self._news:
            self._begin_anew()
            self._stopped = "not started"
            self._rest(self._stopped)
            self._moved = False
        return True, self._stopped

    def _rest(self, why: str) -> None:
        # who has not begun leaves the robot to others, who may bring it to its start
        if self._moved:
            self._send(np.zeros(6), self._now())
        self._tell(f"stopped: {why}")

    def _send(self, v: Array, t: float) -> None:
        self._moves = bool(v.any())
        self.link.publish(command_topic(self.scenario), twist(t, v, command_frame(self.scenario)))

    def _tell(self, words: str) -> None:
        if words != self._status:
            self._status = words
            self.link.publish("~/status", text(words))
            logging.getLogger("vstestbed").warning("%s", words)

    def _now(self) -> float:
        """The time [s] by the clock of the stamps."""
        last = self.servo.controller.before
        if self.servo.by_wall or self.servo.began is None or last is None:
            return time.time()
        return self.servo.began + last.t + self.scenario.camera.latency_s

    def spin(self, ended: threading.Event) -> None:
        """Servo until `ended`; then, and whatever happens,
        send zero and say that it has stopped.
        """
        self._fresh = time.monotonic()
        self._spins = True
        threading.Thread(target=self._watch, daemon=True).start()
        try:
            while not ended.is_set():
                self._turn()
        finally:
            self._spins = False
            for _ in range(3):  # one may be lost
                self._rest("the node has ended")

    def _watch(self) -> None:
        """Stop the robot where its order is too old while the law is still at work on the
        next one.
        """
        while self._spins:
            time.sleep(min(self.watchdog_s, 0.1) / 4)
            with self._news:
                if self._moves and self._since(*self._order_of) >= self.watchdog_s:
                    self._rest(f"no new order for over {self.watchdog_s:g} s")

    def _silent_s(self) -> float:
        """For how long no new picture has been heard [s], by this machine's clock that no one sets,
        or by `/clock`.
        """
        return max(time.monotonic() - self._fresh, self._since(self._fresh, self._fresh_clock_s))

    def _turn(self) -> None:
        """Wait for a picture with its reading, and answer it;
        without a new one for too long, stop.
        """
        with self._news:
            self._news.wait_for(
                lambda: self._picture is not None, timeout=min(self.watchdog_s, 0.1)
            )
            heard, self._picture = self._picture, None
            stopped = self._stopped
            if self._asked_to_reset:
                self._asked_to_reset = False
                self.servo.reset()
        if stopped:
            self._fresh = time.monotonic()
            self._fresh_clock_s = self._clock_s
            self._rest(stopped)
            return
        why = "" if heard is None else self._answered(*heard)
        if self._silent_s() >= self.watchdog_s and not self._stopped:
            self._silent(why)

    def _answered(self, message: Message, heard: float, clock_s: float) -> str:
        """Answer a picture that was heard at these times of the own clock and `/clock` [s]; why the
        robot does not move by it, or "".
        """
        stamp = time_of(message)
        clock_s = min(self._clock_s, clock_s)  # it may have begun anew
        self._wait_for_reading(stamp)
        self._simulated = self._by_clock(stamp)
        before = self.servo.controller.before
        began = time.perf_counter()
        try:
            cycle = self.servo.step(
                message, self._arrived(stamp), None if self._simulated else heard
            )
        except ParameterError as error:
            self._rest(str(error))
            return str(error)
        took_s = time.perf_counter() - began
        if self.servo.controller.before is not before:
            self._refresh(heard, clock_s)
        over = self._is_over(cycle.order)
        if self._silent_s() >= self.watchdog_s and not over:
            late = f"the last one was answered after {self._since(heard, clock_s):.2g} s"
            return cycle.notes[0] if cycle.notes else late
        # held while it is sent: a stop comes before it, and then it is not, or after it
        with self._news:
            if self._stopped:
                return ""
            self._moved = True
            self._order_of = self._fresh, self._fresh_clock_s
            self._send(self.servo.sent(cycle.order), self._now())
        self.took_s.append(took_s)
        if over:
            self.stop("; ".join(filter(None, (cycle.reason, *cycle.notes, self.servo.hint))))
        else:
            self._tell_of(cycle)
        return ""

    def _refresh(self, heard: float, clock_s: float) -> None:
        """A new picture was answered, which was heard at these times [s]."""
        self._fresh = time.monotonic() if self._simulated else heard
        if self._clock_s != self._fresh_clock_s and self._simulated:
            self._ticked_at = self._fresh  # in lockstep it waited for this answer
        self._fresh_clock_s = clock_s

    def _tell_of(self, cycle: Cycle) -> None:
        doing = "rests" if cycle.stopped else "servoing"
        frozen = next((note for note in cycle.notes if FROZEN in note), "")
        self._tell(": ".join(filter(None, (doing, cycle.reason, frozen, self.servo.hint))))

    def _is_over(self, order: Order) -> bool:
        """Whether an order is a stop for good: of a craft, once it stands; until then it sinks."""
        return order.latched and (order.stop == "off" or self.scenario.robot.base != "floating")

    def _wait_for_reading(self, stamp: float) -> None:
        """Until the robot's readings of an exposure have come, or the next picture."""
        end = time.monotonic() + min(WAIT_S, self.watchdog_s)
        with self._news:
            self._news.wait_for(
                lambda: self.servo.senses.until(stamp) or self._picture is not None,
                timeout=max(0.0, end - time.monotonic()),
            )

    def _silent(self, why: str) -> None:
        """No new picture for too long: rest, and after `stop.lost_after_s` stop; a craft, which
        cannot stop in the air, is told to sink. why: of pictures that came and are none to move by.
        """
        if self.servo.controller.before is None:
            self._rest(why or "waits for pictures")
            return
        words = f"picture for over {self.watchdog_s:g} s"
        words = f"no new {words}: {why}" if why else f"no {words}"
        try:
            order = self.servo.silent(self._silent_s())
            v = self.servo.sent(order)
        except ParameterError as error:
            self._rest(f"{words}; {error}")
            return
        if order.stopped:
            self._rest(words)
        else:
            self._sinks(v, f"{order.reason}; {words}")
        if self._is_over(order):
            self.stop(f"{order.reason}; {words}")

    def _sinks(self, v: Array, words: str) -> None:
        """Send the twist (6,) of a descent, which the controller orders anew at each turn."""
        with self._news:
            if not self._stopped:
                self._order_of = time.monotonic(), self._clock_s
                self._send(v, self._now())
                self._tell(words)


def median_ms(seconds: list[float]) -> float:
    """The median of times [s], in milliseconds; NaN of none."""
    return 1e3 * float(np.median(seconds)) if seconds else math.nan


def excite(scenario: Scenario, link: Link, motion: Array, ended: threading.Event) -> int:
    """Send the commands of a motion (n, motions), one each camera period of wall time, as twists,
    and zero at the end, or when `ended`; how many were sent. Record them, and what the robot and
    its camera say, as a bag: `identify` reads it.
    """
    q = scenario.robot.start_joints()
    mount = mount_at(scenario, believed_mount(scenario), q)
    basis = scenario.robot.motion_basis(mount, q)
    frame = command_frame(scenario)
    turn = np.eye(6) if frame == OPTICAL else mount.to_flange

    def send(v: Array) -> None:
        link.publish(command_topic(scenario), twist(time.time(), v, frame))

    sent_ones = 0
    begun = time.monotonic()
    try:
        for u in motion:
            if ended.wait(max(0.0, begun + sent_ones * scenario.camera.period - time.monotonic())):
                break
            send(turn @ (basis @ u))
            sent_ones += 1
    finally:
        for _ in range(3):
            send(np.zeros(6))
    return sent_ones
