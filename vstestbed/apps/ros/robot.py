"""The simulated robot as a node: what its camera and its sensors tell goes out, twists come in,
with its latency, limits and supervisor.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from vstestbed.apps.ros.law import SET_CLOCKS, command_frame, command_topic, watchdog_of
from vstestbed.apps.ros.link import Link
from vstestbed.apps.ros.messages import (
    OPTICAL,
    TWIST,
    WORLD,
    Message,
    body_frame,
    camera_info,
    check_single,
    clock,
    depth_image,
    header,
    image,
    pose,
    readings,
    sensors_of,
    text,
    time_of,
    transforms,
    twist,
    twist_of,
)
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.loop.ego_motion import believed_mount, mount_at
from vstestbed.loop.episode import Episode
from vstestbed.loop.recording import Recording, Watcher
from vstestbed.robots import Reading
from vstestbed.scenario.scenario import Scenario, check_scenario
from vstestbed.tasks.frame import Frame

Pace = Literal["lockstep", "wall"]
AGAIN_S = 0.01  # after so long without an answer readings are told again [s]
# a faster twist is a mistake, and squares of its numbers could be infinite [m/s, rad/s]
FASTEST = 1e6


class Voice:
    """What a robot's camera and sensors tell, frame by frame, as messages. link: where to.
    offset_s: what t = 0 is by the stamps [s]. truth: whether the poses of camera and target are
    told, under `/truth`.
    """

    def __init__(self, scenario: Scenario, link: Link, truth: bool, offset_s: float = 0.0):
        check_single(scenario.camera)
        self._scenario = scenario
        self._link = link
        self._truth = truth
        self._offset = offset_s
        self.mount = believed_mount(scenario)
        self._info = camera_info(0.0, scenario.believed_camera)
        self._readings: list[tuple[float, Reading]] = []
        self.stamp = self.now = 0.0
        self.q = scenario.robot.start_joints()

    def topics(self) -> list[str]:
        """All that it tells."""
        told = ["/clock", "/tf", *sensors_of(self._scenario.robot), "~/image_raw"]
        if self._info is not None:
            told.append("~/camera_info")
        if self._scenario.camera.depth_sensor is not None:
            told.append("~/depth")
        if self._truth:
            told += ["/truth/camera_pose", "/truth/target_pose"]
        return told

    def readings(self) -> None:
        """Those of the last exposure and of now; again, as a robot's driver tells them: single ones
        may be lost beside a picture.
        """
        for stamp, reading in self._readings:
            for topic, message in readings(stamp, self._scenario.robot, reading).items():
                self._link.publish(topic, message, stamp)

    def frame(self, episode: Episode, frame: Frame) -> None:
        """A frame that has just arrived: readings at its exposure and now, where the camera is,
        then the picture.
        """
        link = self._link
        shot = episode.controller.before
        assert shot is not None and frame.image is not None
        self.stamp = t = shot.t + self._offset
        self.now = now = episode.now + self._offset
        reading = episode.plant.reading()
        self.q = reading.q
        link.publish("/clock", clock(now), now)
        self._readings = [(t, shot.reading)]
        if now > t:
            self._readings.append((now, reading))
        self.readings()
        link.publish("/tf", transforms(t, self._poses(shot.reading.q)), t)
        if self._truth:
            taken = frame.t + self._offset
            link.publish("/truth/camera_pose", pose(taken, frame.truth.T_world_camera), now)
            link.publish("/truth/target_pose", pose(taken, frame.truth.T_world_target), now)
        if self._info is not None:
            link.publish("~/camera_info", replace(self._info, header=header(t, OPTICAL)), now)
        if frame.depth_image is not None:
            link.publish("~/depth", depth_image(t, frame.depth_image), now)
        link.publish("~/image_raw", image(t, frame.image), now)

    def _poses(self, q: Array) -> dict[tuple[str, str], Array]:
        """The poses (4, 4) of an arm's flange and of the camera, as the robot knows them, each by
        its parent frame and its own; q: the joints (n,).
        """
        s = self._scenario
        poses: dict[tuple[str, str], Array] = {}
        if s.robot.base == "fixed" and s.robot.joints:
            poses[WORLD, "flange"] = s.robot.flange_pose(q)
        parent = WORLD if s.target.on_gripper else body_frame(s.robot)
        poses[parent, OPTICAL] = self.mount.T_flange_camera
        return poses


class RobotNode:
    """A session whose commands come from outside. Services: `~/stop` (latched: no twist moves it
    until `~/start`), `~/start`.

    Args:
        scenario: the experiment; its law computes too, for the log, and moves nothing.
        link: to the others.
        pace: `lockstep`: simulated time waits for a command to each picture; `wall`: it goes with
            the clock of this machine, and stamps are of it.
        truth: whether the poses of camera and target are told, under `/truth`.
        watchdog_s: wall time without a command after which the robot is told to rest [s]; by
            default for as long as an order lasts.
        ended: when to end.

    Its `record` is a bag that keeps what is told and commanded; None for none. Raises
    ParameterError: see `Link.publishes`.
    """

    def __init__(
        self,
        scenario: Scenario,
        link: Link,
        pace: Pace = "lockstep",
        truth: bool = False,
        watchdog_s: float | None = None,
        ended: threading.Event | None = None,
    ):
        check_scenario(scenario)
        self.scenario = scenario.resolved
        self.link = link
        self._pace = pace
        self._truth = truth
        self._voice = Voice(self.scenario, link, truth)
        self.record: Link | None = None
        self.watchdog_s = watchdog_of(self.scenario, watchdog_s)
        self._order_s = self.scenario.timing.order_s(self.scenario.camera)
        self._news = threading.Condition()
        # stamp, twist of the camera, when it came
        self._command: tuple[float, Array, float] | None = None
        # commands of stamps before it came too late: of the last one obeyed, or when it was told to
        # rest
        self._past = 0.0
        self._least_age_s = math.inf  # of all commands: clocks may differ by so much
        self._stopped = False
        self._as_told = np.zeros(6), command_frame(scenario)
        self._heard = self._silent = False  # a command ever; none for too long
        self.answered_s: list[float] = []  # from a picture's sending to its command
        self.behind_s = 0.0  # at most, of simulated behind wall time
        self.refused = ""
        self.dropped = 0  # commands, by their stamps
        self.ended = ended or threading.Event()
        link.subscribe(command_topic(scenario), TWIST, self._hear)
        link.serve("~/stop", self.stop)
        link.serve("~/start", self.start)
        link.publishes(*self._voice.topics())

    def stop(self) -> tuple[bool, str]:
        """Rest, whatever is commanded, until `start`."""
        with self._news:
            self._stopped = True
            self._command = None
            self._news.notify()
        return True, "the robot rests until ~/start"

    def start(self) -> tuple[bool, str]:
        """Follow commands again."""
        with self._news:
            self._stopped = False
            self._passes(self._latest())
        return True, "the robot follows commands"

    def _hear(self, message: Message) -> None:
        try:
            v = self._checked(message)
        except ParameterError as error:
            self._refuse(str(error))
            return
        age_s = self._age_s(message)
        # a rest is obeyed, whenever it was ordered
        if v.any() and (self._drops(age_s) or self._outdated(message)):
            return
        stamp = time_of(message)
        came = time.monotonic() - max(age_s, 0.0)
        with self._news:
            self._heard = True
            self._as_told = v, message.header.frame_id
            if self._stopped:
                return
            if self._command is not None and 0 != stamp == self._command[0]:  # the same one again
                came = min(came, self._command[2])
            self._command = stamp, self._of_camera(*self._as_told), came
            self._passes(stamp if v.any() else self._latest())
            self._news.notify()

    def _checked(self, message: Message) -> Array:
        """The twist (6,) of a command; ParameterError: in no frame of this robot, or no speed."""
        v = twist_of(message)
        frame = message.header.frame_id
        body = body_frame(self.scenario.robot)
        if frame not in (OPTICAL, body, ""):
            words = f"is in the frame {frame}; works: {OPTICAL} or {body}"
            raise ParameterError("twist", words)
        if np.abs(v).max() > FASTEST:
            raise ParameterError.bound("twist", "at most", f"{FASTEST:g} m/s and rad/s", v.tolist())
        return v

    def _passes(self, t: float) -> None:
        """Commands stamped before t [s] are past, and those before the newest one; unless the clock
        has been set back.
        """
        self._past = t if self._is_ahead(self._past) else max(self._past, t)

    def _latest(self) -> float:
        """The latest stamp that a command may have which was sent before now [s]: the law's clock
        may be behind this one.
        """
        behind_s = max(self._least_age_s, 0.0)
        return time.time() - (behind_s if math.isfinite(behind_s) else 0.0)

    def _is_ahead(self, t: float) -> bool:
        return t - time.time() > self._order_s

    def _age_s(self, message: Message) -> float:
        """How old a command is by its stamp [s], of which the least is kept; 0 where it has none,
        or time is simulated.
        """
        stamp = time_of(message)
        age_s = time.time() - stamp if self._pace == "wall" and stamp else 0.0
        if stamp and abs(age_s) <= self._order_s:
            self._least_age_s = min(self._least_age_s, age_s)
        return age_s

    def _drops(self, age_s: float) -> bool:
        """Whether a command is not obeyed, by its age [s]; said once of clocks that differ."""
        if abs(age_s) <= self._order_s:
            return False
        self.dropped += 1
        side = f"s {'behind' if age_s > 0 else 'ahead of'} this clock"
        if side not in self.refused:
            self._refuse(
                f"the commands' stamps are {abs(age_s):.3g} {side}: they are dropped; {SET_CLOCKS}"
            )
        return True

    def _outdated(self, message: Message) -> bool:
        """Whether a command was stamped before the one in force, or before the robot was told to
        rest, whenever that was ordered.
        """
        before = self._pace == "wall" and 0 < time_of(message) < self._past
        if not before or self._is_ahead(self._past):
            return False
        self.dropped += 1
        words = "a command that is older than the one in force, or than the last rest, is dropped"
        why = "does more than one law send commands?"
        least_s = self._least_age_s
        if least_s > 2 * self.scenario.camera.period:
            why = f"all stamps were {least_s:.2g} s or more behind this clock; {SET_CLOCKS}"
        self._refuse(f"{words}; {why}")
        return True

    def _refuse(self, words: str) -> None:
        """Tell once why commands move nothing."""
        if self.refused != words:
            self.refused = words
            self.link.publish("~/status", text(words))
            logging.getLogger("vstestbed").warning("%s", words)

    def _of_camera(self, v: Array, frame: str) -> Array:
        """The camera's twist (6,) of one in a frame, by default in that of commands."""
        if (frame or command_frame(self.scenario)) == OPTICAL:
            return v
        return mount_at(self.scenario, self._voice.mount, self._voice.q).to_camera @ v

    def fly(
        self,
        scenario: Scenario,
        watch: Iterable[Watcher] = (),
        folder: Path | None = None,
        *,
        pictures: bool = True,
    ) -> Recording:
        """Run it until an outcome, or `ended`; as `loop.run`."""
        episode = Episode(scenario, True, tuple(watch), folder)
        with contextlib.closing(episode):
            frame = episode.advance()
            if frame is not None:
                self._follow(episode, frame)
        return episode.recording()

    def _follow(self, episode: Episode, frame: Frame) -> None:
        """Follow commands from the first frame on."""
        began = time.monotonic() - frame.t  # when t = 0 was, by the own clock
        offset = time.time() - frame.t if self._pace == "wall" else 0.0
        self._voice = Voice(self.scenario, self.link, self._truth, offset)
        recorded = self.record and Voice(self.scenario, self.record, True, offset)
        while episode.outcome is None and not self.ended.is_set():
            if recorded is not None:
                recorded.frame(episode, frame)
            self._voice.frame(episode, frame)
            if self._pace == "lockstep" and not self._heard:
                self._wait_for_the_first(episode, frame)
                began = time.monotonic() - frame.t
            v = self._answer(began + frame.t + self.scenario.camera.period)
            episode.changed_by_hand("commanded from outside")
            following = episode.advance(v)
            if following is None:
                return
            frame = following
            self.behind_s = max(self.behind_s, time.monotonic() - began - frame.t)

    def _answer(self, due: float) -> Array:
        """The twist (6,) that answers the frame that was told, zero where none does; due: when the
        next picture is due [s].
        """
        sent = time.monotonic()
        v = self._wait(due)
        if v is None:
            return np.zeros(6)
        self.answered_s.append(time.monotonic() - sent)
        if self.record is not None:
            now = self._voice.now
            raw, frame_id = self._as_told
            self.record.publish(command_topic(self.scenario), twist(now, raw, frame_id), now)
        return v

    def _wait_for_the_first(self, episode: Episode, frame: Frame) -> None:
        """Tell a frame again until there is a command: who will give it may not be there yet."""
        logging.getLogger("vstestbed").warning(
            "waits for commands on %s", self.link.name(command_topic(self.scenario))
        )
        while not (self._heard or self.ended.is_set()):
            with self._news:
                # before the law takes the same picture for silence
                self._news.wait(self.watchdog_s / 2)
            if not self._heard:
                self._voice.frame(episode, frame)

    def _wait(self, due: float) -> Array | None:
        """The twist for the frame that was told; None for rest. What it tells meanwhile it tells
        without the lock: who hears it may be about to command.
        """
        v = self._by_the_clock(due) if self._pace == "wall" else self._in_step()
        with self._news:
            return None if self._stopped else v

    def _by_the_clock(self, due: float) -> Array | None:
        """The newest twist when the next picture is due; None where it is too old."""
        while not self.ended.is_set() and (left := due - time.monotonic()) > 0:
            with self._news:
                heard = self._news.wait(min(left, AGAIN_S))
            if not heard:
                self._voice.readings()
        command = self._command
        self._silent = command is None or time.monotonic() - command[2] > self.watchdog_s
        return None if command is None or self._silent else command[1]

    def _in_step(self) -> Array | None:
        """The twist that answers the picture, once; None where none comes within the watchdog time.
        After a silence simulated time goes on with the wall's: a robot whose law is dead comes to
        rest, and its pictures go on.
        """
        wait_s = self.scenario.camera.period if self._silent or self._stopped else self.watchdog_s
        end = time.monotonic() + wait_s
        while not self.ended.is_set() and (left := end - time.monotonic()) > 0:
            with self._news:
                if self._command is not None and not self._stopped:
                    stamp, v, _ = self._command
                    if stamp >= self._voice.stamp - 1e-6:
                        self._command = None  # each answers one picture
                        self._silent = False
                        return v
                heard = self._news.wait(min(left, AGAIN_S))
            if not heard:
                self._voice.readings()
        self._silent = True
        return None
