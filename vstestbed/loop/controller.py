"""The controller of a scenario: one control step for each picture, without the simulator."""

from __future__ import annotations

import copy
import math
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vstestbed.camera import DepthImage, Image, Picture, Regions
from vstestbed.core.errors import ParameterError, SessionError, short
from vstestbed.core.geometry import Array, all_finite
from vstestbed.core.outcome import Outcome
from vstestbed.features.observation import EgoMotion, Goal, Observation, Sight
from vstestbed.laws import Command, Law
from vstestbed.laws.base import LawFailedError, inputs_of
from vstestbed.loop.ego_motion import (
    CommandHistory,
    Exposure,
    OwnRates,
    believed_mount,
    mount_at,
)
from vstestbed.loop.inputs import (
    Inputs,
    OwnClock,
    Readings,
    SightClock,
    all_or_none,
    images_of,
    seconds,
)
from vstestbed.loop.perception import STILL, OtherCameras, Perception, Stillness, observer_of
from vstestbed.loop.plants import sight_of, with_images
from vstestbed.robots import Allocation, Mount, Reading
from vstestbed.robots.allocation import Order
from vstestbed.robots.arm import Arm
from vstestbed.robots.own_model import OwnModel
from vstestbed.scenario.cameras import OWN
from vstestbed.scenario.scenario import Scenario, check_scenario
from vstestbed.tasks.frame import Cycle, FrameTiming, ImageError
from vstestbed.vision.observe import CameraPixels

__all__ = ["FROZEN", "GUESS", "Controller", "GuardedLaw"]


class GuardedLaw:
    """A law that has failed is not asked again: its robot must be stopped, whatever it does next.
    `failure` says what it did, or is "".
    """

    def __init__(self, law: Law[Any], failure: str = ""):
        self._law = law
        self.failure = failure
        self._mode = 0  # in which it failed: to fail is no switch

    def step(self, state: Any, seen: Observation, goal: Goal, basis: Array) -> tuple[Any, Command]:
        """One frame of the law; after a failure rest, with `failure` as its reason. Whatever the
        law raises is its failure, a ParameterError too: the scenario was accepted, and a robot that
        moves must be stopped.
        """
        if not self.failure:
            stepped = self._asked(self._law.step, state, seen, goal, basis)
            if not self.failure and (wrong := self._wrong(stepped, seen)):
                self.fail(f"law {self._law.kind} {wrong}")
            if not self.failure:
                self._mode = stepped[1].mode
                return stepped
        return state, replace(Command.rest(basis, self.failure), mode=self._mode)

    def fail(self, words: str) -> None:
        """It has failed; of several failures the first one counts."""
        self.failure = self.failure or words

    def init(self, goal: Goal, state: Any) -> Any:
        """The state for another goal of a run; the one so far where the law fails at it."""
        made = None if self.failure else self._asked(self._law.init, goal)
        return state if self.failure else made

    def _asked(self, method: Callable[..., Any], *given: Any) -> Any:
        try:
            return method(*given)
        except KeyboardInterrupt:
            raise
        except LawFailedError as error:
            self.failure = str(error)
        except BaseException as error:  # also sys.exit: a law must not end the program
            where = _raised_at(error, type(self._law).__module__)
            self.failure = f"law {self._law.kind} raised {type(error).__name__}: {error} ({where})"

    def _wrong(self, stepped: Any, seen: Observation) -> str:
        """What is wrong with what `step` returned;
        "" for a state and a command of finite numbers.
        """
        if not (
            isinstance(stepped, tuple) and len(stepped) == 2 and isinstance(stepped[1], Command)
        ):
            return f"returned {_types(stepped)}; its step must return (state, Command)"
        command = stepped[1]
        modes = len(self._law.modes)
        if modes and not 0 <= command.mode < modes:
            return (
                f"gave the mode {short(command.mode)};"
                f" the modes of its commands must be 0 to {modes - 1}"
            )
        wrong = (
            _wrong_twist(command.twist)
            or _wrong_beside(command, self._law.columns)
            or _wrong_rates(command.rates, seen.robot)
        )
        if wrong:
            self._mode = command.mode
        return wrong


def _types(stepped: Any) -> str:
    if not isinstance(stepped, tuple):
        return type(stepped).__name__
    return f"({', '.join(type(part).__name__ for part in stepped)})"


def _raised_at(error: BaseException, module: str) -> str:
    """File and line where an error came from: in the module of the law or in a file of others, else
    the innermost ones.
    """
    frames = list(traceback.walk_tb(error.__traceback__))
    own = []
    for frame, line in frames:
        name = str(frame.f_globals.get("__name__"))
        ours = name == module or "@" in name  # as `load_file` names them
        # what dataclasses generate has no line
        if ours and not frame.f_code.co_filename.startswith("<string>"):
            own.append((frame, line))
    frame, line = (own or frames)[-1]
    return f"{Path(frame.f_code.co_filename).name}, line {line}"


def _wrong_twist(twist: Array) -> str:
    """What is wrong with the twist of a command; "" for six finite numbers."""
    if not isinstance(twist, np.ndarray) or twist.shape != (6,) or twist.dtype.kind not in "fiu":
        return (
            f"gave the twist {short(twist)}; the twist of a Command must be an array of six numbers"
        )
    if not all_finite(twist):
        return f"gave a twist that is not finite, {np.round(twist, 3)}"
    return ""


def _wrong_beside(command: Command, columns: Sequence[str]) -> str:
    """What is wrong with what a command may have beside velocities; "" for finite numbers. columns:
    of the law in the log.
    """
    wrench = command.wrench
    if wrench is not None and not (wrench.shape == (6,) and all_finite(wrench)):
        return (
            f"gave the wrench {short(wrench)}; the wrench of a Command must be six finite numbers"
        )
    for share, twists in command.free:
        if not (math.isfinite(share) and all_finite(twists)):
            return "gave free motions that are not finite"
    if command.row and len(command.row) != len(columns):
        return (
            f"gave {len(command.row)} numbers as the row of its Command,"
            f" and has the columns {', '.join(columns) or 'none'}"
        )
    return ""


def _wrong_rates(rates: Array | None, robot: OwnModel | None) -> str:
    """What is wrong with velocities of the robot's own that a law orders; "" for as many finite
    ones as the robot has, which it reads.
    """
    if rates is None:
        return ""
    if not all_finite(rates):
        return f"gave rates that are not finite, {np.round(rates, 3)}"
    names = robot.names if robot else ()
    if rates.shape == (len(names),):
        return ""
    return (
        f"gave {rates.size} rates; those of a Command must be the velocities of `Observation.robot`"
        f" ({', '.join(names) or 'not read'})"
    )


# Why the law has no measurement, in words, for the reason of a run that ends as `target_lost`.
NONE_SEEN = "no marker was in sight"
FEW_SEEN = "too few markers were in sight"
NO_PICTURE = "no picture arrived"
GUESS = ": at the start they may be outside of it, hidden or too small"
"""What a robot may think of markers that it has never found; by the truth the reason says which it
was (`explanation.LostMarkers`).
"""


def unseen(seen: Observation, goal: Goal, error: ImageError, needed: int) -> str:
    """Why a law that gives no reason has no measurement; "" where it has as many markers as it
    needs.
    """
    all_count = error.all_seen and goal.counted is None
    n = len(seen.uv) if all_count else np.count_nonzero(seen.seen)
    if n >= needed:
        return ""
    return FEW_SEEN if n else NONE_SEEN


def detail(scenario: Scenario, seen: Observation, found: bool, why: str = "") -> str:
    """What the detector says (`why`), or which markers are not seen, by their names, in brackets;
    "" where they have none, or all are seen. Where the detector has never found a marker in the run
    (`found`), what may be wrong instead.
    """
    if why:
        return f" ({why})"
    if not found and scenario.detector.needs_image:
        return f" ({_never_found(scenario)})"
    if scenario.detector.changing:
        return ""
    names = [
        name for name, there in zip(scenario.target.names, seen.seen, strict=False) if not there
    ]
    return f" (not seen: {', '.join(names)})" if names else ""


def _never_found(scenario: Scenario) -> str:
    """That a detector of pictures has found nothing from the start on, and the likely causes."""
    if scenario.detector.changing:
        words = (
            f"detector {scenario.detector.kind} has found nothing of the goal's"
            " picture in any picture"
        )
        return (
            f"{words}: the start may show too little of it, or from too far aside,"
            " or too few points of it are looked for"
        )
    target = scenario.target
    n = len(target.points)
    words = (
        f"detector {scenario.detector.kind} has not found one of {n}"
        f" marker{'s' * (n != 1)} in any picture"
    )
    if scenario.detector.needs_sheet:
        return (
            f"{words}: at the start the picture may be outside of it, too small,"
            " too oblique or without structure"
        )
    if target.draw_markers:
        return words + GUESS
    return (
        f"{words}: the file {target.source.name if target.source else ''} may not show"
        f" {target.marker.looks(n)} there"
    )


FROZEN = (
    "the pictures are the same to the byte, although a velocity is ordered: is the camera frozen?"
)
CREEPS = 0.1  # stamps that advance by less in an order's time tell no time [camera periods]
REST_S = 1e3  # time after which a robot that stops has come to rest, whatever its way to stop [s]


class Controller:
    """The controller of a scenario: detector, observer, reference, law, limits and supervisor, as
    the time loop has them.

    It needs no simulator: with a real camera and robot, `step` turns each picture into one order, a
    velocity or a stop.

        controller = vs.Controller(vs.load("arm_ibvs"))
        cycle = controller.step(image, t, vs.Reading(q, qd), arrived=now())
        if cycle.stopped:
            robot.stop(cycle.reason)
        else:
            robot.move(cycle.setpoint)

    `arrived` is the time now, on the clock of `t`: without it, the age of a new picture is not
    known, nor how long the law took.

    A stop ends with its cause: a law that measures again orders a velocity again. Once the
    supervisor has given the task up (`cycle.latched`: the target was out of sight for too long, the
    law failed), `reset` alone ends it.

    It holds the state of all its parts between pictures, and serves one thread at a time: `step`,
    `reset`, `retune` and `without_picture` are refused while another thread is in one of them. The
    other methods are the parts of a step, for the time loop, which calls them from one thread; they
    refuse nothing. Who watches it from a second thread, as for `without_picture`, holds a lock of
    their own round each call.

    To make one takes up to two seconds in a new process, since it imports what the first step
    needs; to `reset` it takes a millisecond.

    A picture that comes again is no new one: where the last new one is older than a command lasts,
    by the time of arrival or by the own clock (`clock`, of this machine unless somebody sets
    another), the robot stops as `without_picture` stops it. So it does where a step that was told
    the time of arrival took as long, and where stamps advance by less than a tenth of a camera
    period while the own clock advances by as much. Where a simulator gives pictures more often
    than that, in a time that passes more slowly, `simulates(True)` lets stamps alone tell it.

    goal_images: pictures taken at its goal views, for a law or a detector that compares with them.
    Raises ParameterError: `scenario` is not a Scenario, or it needs pictures of its goal views that
    are not given.
    """

    def __init__(self, scenario: Scenario, goal_images: Sequence[Sight] = ()):
        check_scenario(scenario)
        self.scenario = scenario = scenario.resolved
        scenario.law.prepare()  # a robot does not wait for imports between two pictures
        # The calibrated mount: what the robot does with a command follows from what it believes,
        # errors included.
        self.mount = believed_mount(scenario)
        self.observer = observer_of(scenario)
        self.observer.prepare(scenario.detector.needs_image)
        self.law: Law[Any] = scenario.law
        self._needed = self._markers_needed()
        self._views = with_images(scenario, goal_images)
        inputs = inputs_of(scenario.law)
        self._needs_motion = "motion" in inputs
        self._needs_sight = "image" in inputs
        self._needs_robot = "robot" in inputs
        self._needs_own_state = "proprioception" in inputs and bool(
            scenario.robot.proprioception_names
        )
        self._latest_s = scenario.timing.latest_s(scenario.camera)
        self._order_s = scenario.timing.order_s(scenario.camera)
        delay_s = scenario.camera.latency_s + scenario.timing.command_latency_s
        self._until_seen = 1 + delay_s / scenario.camera.period
        self.clock: Callable[[], float] = time.monotonic
        self.spent = {"detect": 0.0, "law": 0.0}
        self._busy = threading.Lock()
        self._own = OwnClock(lambda: self.clock())
        self._begin()

    def reset(self) -> None:
        """Begin the task anew, as a new controller would: all states, the clock, and a stop that
        was latched.
        The robot moves again with the next picture: call it when the cause is found, and nobody
        stands in its way.
        """
        with self._alone():
            self._begin()

    def _begin(self) -> None:
        s = self.scenario
        mode = s.timing.interpolation
        period = s.camera.period
        self.last_twist = np.zeros(6)
        self.ordered = CommandHistory(6, mode, period)
        self._own_rates = OwnRates(s.robot, period, mode) if self._needs_robot else None
        self._order: Order | None = None  # in force
        self._taken_over = False
        self._at: tuple[float, Reading, Mount] | None = None
        self.guarded = GuardedLaw(self.law)
        self._perception = Perception(s, self.observer, self._views[0])
        self.others: OtherCameras | None = None
        if s.cameras:
            mount = self.mount.T_flange_camera
            self.others = OtherCameras(s, mount, self._views[0], self._own_s)
        self.reference_state = s.goal.begin(s.setup, self._views)
        self.law_state = self.law.init(self._views[0])
        self.supervisor = s.robot.supervisor(s.goal.lands, *s.stop.lost_after)
        self.before: Exposure | None = None
        self.refused = 0
        self._failed = False
        self.inputs = Inputs(s)
        self._other_inputs = {name: Inputs(eye) for name, eye in s.eyes.items()}
        self._cycle: Cycle | None = None
        # stamp of the newest picture given to `step`, and the own clock at its first coming
        self._given: tuple[float, float] | None = None
        # when the last picture that was used came, by stamps and by the own clock [s]
        self._came: tuple[float, float] | None = None
        # the last stamp that advanced, and the own clock then [s]
        self._advanced = -math.inf, 0.0
        self._sight = SightClock()
        self._silent = self._by_hand = False
        self._stillness: dict[str, Stillness] = {}

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Refuse a call while another thread is in one: both would write to the same states."""
        if not self._busy.acquire(blocking=False):
            words = (
                "another thread is in a call of this controller, which serves one thread at a time"
            )
            raise SessionError(
                words, "hold a lock of your own round each call, or give each thread a controller"
            )
        try:
            yield
        finally:
            self._busy.release()

    def step(
        self,
        picture: Image | Sequence[Image] | Mapping[str, Image | Sequence[Image]],
        t: float,
        readings: Reading | Readings,
        arrived: float | None = None,
        depth: DepthImage | None = None,
    ) -> Cycle:
        """One control step for a picture of a real camera.

        Args:
            picture: (H, W, 3) uint8 RGB of the camera's size; of a camera with panels (spherical)
                one for each of them. Of several cameras their pictures of one time by name, the
                law's as `camera`; those that come at other times go to `look`.
            t: time of the exposure's middle [s], on a clock that starts with the task.
            readings: of the robot's sensors, at the exposure and now; one where there is no
                difference.
            arrived: the time now [s]; by default `camera.latency_s` after the exposure.
            depth: of a depth camera, (H, W) of the picture's size [m], NaN or 0 in holes; only
                `law.depth: sensor` needs it.

        Returns the cycle with its order, due `timing.command_latency_s` later: `stopped` with
        `reason`, or a velocity, as `setpoint` and as `twist`, to which the sender leads with
        `timing.interpolation` (`setpoints.Profile`). `notes` tell of pictures that came late or
        twice, or did not come, or do not change. For a picture that comes twice, or (with
        `out_of_order` or `camera_clock`) an older one, it is the last cycle again, with the order
        in force: a stop once the last new picture is too old.

        Raises ParameterError: a picture of another size or kind, a reading of another robot or
        outside of its joints' ranges, a time that goes back, a detector that needs the simulator's
        truth. Nothing has changed then. SessionError: another thread is in a call.
        """
        with self._alone():
            self._by_hand = True
            t = seconds(t)
            depth = self.inputs.depth(depth)
            others: dict[str, Exposure] = {}
            with all_or_none([self.inputs, *self._other_inputs.values()]):
                if isinstance(picture, Mapping):
                    others, picture = self._given_together(picture, t, readings)
                (at_exposure, now), notes = self.inputs.given(picture, t, readings, arrived)
            for name, shot in others.items():
                self.see(name, shot)
            if (again := self._again(t, arrived, now, notes)) is not None:
                return again
            at = t + self.scenario.camera.latency_s if arrived is None else seconds(arrived)
            # after an error: it is as old as it was
            came_again = self._given is not None and t <= self._given[0]
            if not came_again:
                self._given = t, self._own.s()
            assert self._given is not None
            came = at, self._given[1]
            if self.others is not None:
                notes += self.others.forgotten(at)
            self._sight.tick(*came)
            whole = Picture(t, images_of(picture), depth=depth)
            shot = Exposure(self.inputs.taken, t, whole, at_exposure)
            cycle = self.arrive(shot, at, at + self.scenario.timing.command_latency_s, now)
            self._came = came
            self._silent = False
            notes += self._slow(arrived is not None or came_again, now)
            notes += self._frozen_for(self._order_s)
            # Copies: who reads the cycle may write to its arrays.
            command, allocation = copy.deepcopy((cycle.command, cycle.allocation))
            self._cycle = replace(
                cycle, command=command, allocation=allocation, order=self._in_force(), notes=notes
            )
            return self._cycle

    def _given_together(
        self,
        pictures: Mapping[str, Image | Sequence[Image]],
        t: float,
        readings: Reading | Readings,
    ) -> tuple[dict[str, Exposure], Image | Sequence[Image]]:
        """The new pictures of further cameras, by name, and the own camera's."""
        if OWN not in pictures:
            raise ParameterError.missing(
                "picture", f"{OWN}, the law's own camera; others alone go to `look`", list(pictures)
            )
        first = readings[0] if isinstance(readings, tuple) else readings
        new = {}
        for name, one in pictures.items():
            if name != OWN and self._inputs_of(name).newest != t:
                new[name] = self._inputs_of(name).shot(one, t, first)
        return new, pictures[OWN]

    def _in_force(self) -> Order:
        """The order in force, in arrays of its own."""
        assert self._order is not None
        return copy.deepcopy(self._order)

    def _stop_if_old(self, t: float, arrived: float | None, reading: Reading) -> None:
        """Stop the robot where the last new picture is too old, whatever stamps say: by the time of
        arrival, or by the own clock where that has gone further. Who gives a time that stands still
        has no clock.
        """
        now = self._now(t if arrived is None else arrived)
        assert self._came is not None
        late = arrived is not None and arrived - t > self._latest_s
        if late or now - self._came[0] >= self._order_s:
            self._without(now, reading)

    def _again(
        self, t: float, arrived: float | None, reading: Reading, notes: tuple[str, ...]
    ) -> Cycle | None:
        """The last cycle, with the order in force, for a picture that came twice, that is refused,
        or whose stamp tells no time; None for a new one.
        """
        if self._cycle is None:
            self._advanced = t, self._own.s()
            return None
        if t <= self._cycle.t:
            self.refused += t < self._cycle.t
            self._stop_if_old(t, arrived, reading)
        elif creeps := self._creeps(t):
            notes += (creeps,)
            self._without(self._now(t if arrived is None else arrived), reading)
        else:
            return None
        # Not the cycle's own order: since then, silence may have stopped the robot.
        return replace(self._cycle, order=self._in_force(), notes=notes)

    def _creeps(self, t: float) -> str:
        """What to say of a picture whose stamp [s] has hardly advanced for as long as an order
        lasts, by the own clock; "" where it has, and where time is simulated. However slow a law
        is in lockstep, the next picture's stamp is a period later.
        """
        # after an error: `_given` knows its age
        if self._given is not None and t <= self._given[0]:
            return ""
        own_s = self._own.s()
        before, by_clock = self._advanced
        if t - before >= CREEPS * self.scenario.camera.period:
            self._advanced = t, own_s
            return ""
        if own_s - by_clock < self._order_s:
            return ""
        words = f"stamps have advanced by {t - before:.2g} s in {own_s - by_clock:.2g} s"
        return f"{words} of the own clock: the robot is told to stop"

    def _now(self, t: float) -> float:
        """The time [s] that somebody says, or, where that is later, the one that the own clock
        gives since the last picture came.
        """
        if self._came is None:
            return t
        at, by_clock = self._came
        return max(t, at + self._own.s() - by_clock)

    def _slow(self, stops: bool, reading: Reading) -> tuple[str, ...]:
        """Where the law took so long for a picture that its command would have ended, stop the
        robot, or say what would.
        """
        assert self._came is not None
        at, by_clock = self._came
        took_s = self._own.s() - by_clock
        if took_s < self._order_s:
            return ()
        words = f"the picture was answered after {took_s:.2g} s"
        if not stops:
            return (f"{words}; with `arrived` the robot is told to stop then",)
        self.lapsed(at + took_s, reading, words)
        return ()

    def retune(self, law: Law[Any]) -> None:
        """Go on with other parameters of the law from the next picture on; the states of all parts
        stay.
        Raises ParameterError: a law of another kind, feature, modes or source of depth, or one that
        this scenario refuses.
        """
        with self._alone():
            for name in ("kind", "feature", "depth", "inputs", "modes"):
                if getattr(self.law, name) != getattr(law, name):
                    raise ParameterError(
                        f"law.{name}",
                        "cannot be changed during a run, since the law's state belongs to it",
                    )
            self.scenario = replace(self.scenario, law=law)
            self.law = law
            # one that has failed is not asked again
            self.guarded = GuardedLaw(law, self.guarded.failure)
            self._needed = self._markers_needed()

    def regions_of_interest(self) -> Regions | None:
        """The detector's region of interest for the next picture; None for all of it."""
        return self._perception.regions_of_interest()

    def look(
        self, name: str, picture: Image | Sequence[Image], t: float, readings: Reading
    ) -> None:
        """A picture of a further camera, which the law has at its own camera's next one.
        t: time of the exposure's middle [s]. readings: of the robot's sensors at the exposure.
        Errors: as of `step`, and ParameterError: the scenario has no camera of this name, or its
        stamp is of the future.
        """
        with self._alone():
            self._by_hand = True
            latest = max(self._now(-math.inf), self._inputs_of(name).newest) + self._order_s
            if self._came is not None and seconds(t) > latest:
                words = (
                    f"{latest:.4g} s, as long as an order lasts from now by the last pictures of"
                    f" {OWN} and {name} and by the own clock"
                )
                raise ParameterError.bound(
                    "t", "at most", words, t, why="all stamps are of one clock"
                )
            self.see(name, self._inputs_of(name).shot(picture, seconds(t), readings))

    def see(self, name: str, shot: Exposure) -> None:
        """The same, of what has been checked."""
        assert self.others is not None
        began = time.perf_counter()
        if shot.picture is not None:
            self._watch(name, shot.picture.images, shot.t)
        self.others.see(name, shot, self.ordered, self._mount_at(shot.reading.q))
        self.spent["detect"] += time.perf_counter() - began

    def _inputs_of(self, name: str) -> Inputs:
        if name not in self._other_inputs:
            raise ParameterError.choice("picture", (OWN, *self._other_inputs), name)
        return self._other_inputs[name]

    def refuses(self, shot: Exposure) -> bool:
        """Whether a picture is not later than the last one that was used, by its stamp
        (`timing.refuses`); `refused` counts them.
        """
        refused = (
            self.before is not None and shot.t <= self.before.t and self.scenario.timing.refuses
        )
        self.refused += refused
        return refused

    def arrive(self, shot: Exposure, t: float, t_cmd: float, reading: Reading) -> Cycle:
        """One control step: detect, observe, reference, law, allocation.
        shot: the picture, with the reading at its exposure. t, reading: the time of its arrival
        [s], and the robot's sensor reading then: the command acts on the robot as it is now. t_cmd:
        when the command will reach the robot [s].
        """
        s = self.scenario
        began = time.perf_counter()
        mount = self._mount_at(reading.q)
        seen = self._observe(shot, t, t_cmd, reading, mount)
        goal = self._reference(seen)
        seen = seen.only(goal.counted)
        if self.others is not None:
            seen = replace(seen, cameras=self.others.views(shot, t, goal))
        detected = time.perf_counter()
        basis = s.robot.motion_basis(mount, reading.q)
        self.law_state, command = self.guarded.step(self.law_state, seen, goal, basis)
        own = self._perception.own(seen)
        others_tell = own is not seen or bool(self.law.cameras and not command.rest_reason)
        error = ImageError.of(own, goal, command.rest_reason, others_tell)
        unusable = self._unusable(shot, t)
        blind = command.rest_reason
        if not blind and not others_tell:
            blind = unseen(seen, goal, error, self._needed)
        blind = self._detailed(blind or unusable, seen)
        moved = self._moved(t, reading, blind, mount)
        allocation, order = self._wanted(command, reading, mount, unusable, blind)
        # stamps that are too old to be true tell no time, either
        told = max(shot.t, t - self._latest_s)
        if not (blind or self.supervisor.aborted):
            self._sight.seen()
        order = self._supervised(told, blind, order, reading, basis, moved)
        self._ordered(t_cmd, order)
        self.before = shot
        self.reference_state, next_goal = s.goal.passed(self.reference_state, error)
        if next_goal is not None:  # a law's state belongs to one goal
            self.law_state = self.guarded.init(next_goal, self.law_state)
        self.spent["detect"] += detected - began
        self.spent["law"] += time.perf_counter() - detected
        timing = FrameTiming(shot.number, shot.t, t_cmd)
        return Cycle(timing, own, goal, error, command, allocation, order=order)

    def _reference(self, seen: Observation) -> Goal:
        """The goal in force; by a detector's own points, where it has any."""
        self.reference_state, goal = self.scenario.goal.reference(self.reference_state, seen)
        by_points = self._perception.goal
        return goal if by_points is None else goal.of(by_points)

    def _detailed(self, blind: str, seen: Observation) -> str:
        """Why there is no measurement, with what the detector says of it; "" where there is one."""
        if not blind:
            return ""
        return blind + detail(self.scenario, seen, self._perception.found, self._perception.why)

    def _wanted(
        self, command: Command, reading: Reading, mount: Mount, unusable: str, blind: str
    ) -> tuple[Allocation, Order]:
        """A command within the robot's limits, and the order for it: a stop, `blind` its reason,
        where the law rests or the picture is unusable.
        """
        allocation = self._allocate(command, reading, mount)
        law_rests = command.rest_reason and not command.twist.any() and not command.free
        if not (unusable or law_rests):
            return allocation, Order.of(allocation)
        rest = replace(allocation, twist=np.zeros(6), rates=None)
        return rest, Order.of(rest).halted(blind)

    def _unusable(self, shot: Exposure, t: float) -> str:
        """Why the robot must not move by a picture that has come at t [s]: it is late, or the
        camera is frozen, and the task given up; "" where it may.
        """
        if t - shot.t > self._latest_s:
            return f"pictures arrived {t - shot.t:.2g} s late"
        if shot.picture is None:
            return ""
        self._watch(OWN, shot.picture.images, shot.t)
        if shot.picture.depth is not None:
            self._watch("depth", (shot.picture.depth,), shot.t)
        after_s = self.scenario.stop.frozen_after
        if not self._frozen_for(after_s):
            return ""
        words = (
            f"the pictures were the same to the byte for {after_s:g} s, although a velocity was"
            " ordered: the camera is frozen"
        )
        if not self.supervisor.aborted:
            self.supervisor.abort(shot.t, Outcome.target_lost, words)
        return words

    def _watch(self, name: str, images: Sequence[Image | DepthImage | None], t: float) -> None:
        """Count for how long the pictures of a camera, exposed at t [s], stay the same while a
        velocity is ordered: of a real one, and where a scenario asks for it.
        """
        if self._by_hand or self.scenario.stop.frozen_after < math.inf:
            moves = self._order is not None and bool(self._order.twist.any())
            self._stillness.setdefault(name, Stillness(self._until_seen)).add(
                images, t, self._own_s(), self.ordered, moves
            )

    def simulates(self, stands: bool) -> None:
        """Whether time is simulated from now on, and stamps alone tell it: the own clock stands."""
        self._own.stand(stands)

    def _own_s(self) -> float:
        """The own clock [s]; it stands where time is simulated."""
        return self._own.s() if self._by_hand else 0.0

    def _frozen_for(self, least_s: float) -> tuple[str, ...]:
        """What to say of the cameras whose pictures have been the same for so long [s]."""
        names = [name for name, still in self._stillness.items() if still.for_s + 1e-9 >= least_s]
        return tuple(FROZEN if name == OWN else f"{name}: {FROZEN}" for name in names)

    def override(self, cycle: Cycle, command: Array) -> tuple[Command, Allocation, Order]:
        """Another command in place of the law's in the last cycle: as it reads, within the robot's
        limits, and what the robot is told. command: a camera twist (6,), or velocities along the
        robot's motions (n,). A supervisor that has taken over is obeyed first.
        """
        assert self._at is not None
        _, reading, mount = self._at
        basis = self.scenario.robot.motion_basis(mount, reading.q)
        twist = command if len(command) == 6 else basis @ command
        u = np.linalg.pinv(basis) @ command if len(command) == 6 else command
        wanted = Command(u, twist)
        allocation = self._allocate(wanted, reading, mount)
        order = cycle.order if self._taken_over else Order.of(allocation)
        self._ordered(cycle.timing.t_cmd, order)
        return wanted, allocation, order

    def _ordered(self, t_cmd: float, order: Order) -> None:
        self._order = order
        self.ordered.add(t_cmd, order.twist)
        if self._own_rates is not None:
            self._own_rates.order(t_cmd, order)

    def _markers_needed(self) -> int:
        robot = self.scenario.robot
        q = robot.start_joints()
        return self.law.markers_needed(robot.motion_basis(self._mount_at(q), q))

    def _mount_at(self, q: Array) -> Mount:
        return mount_at(self.scenario, self.mount, q)

    def _observe(
        self, shot: Exposure, t: float, t_cmd: float, reading: Reading, mount: Mount
    ) -> Observation:
        s = self.scenario
        last = self.before or shot
        detection = self._perception.detect(shot)
        twist = self._twist_since(last, shot, self.observer.uses_motion(detection))
        own = None
        if self._needs_motion:
            moved, age = self._moved_since(shot, t, reading, mount)
            own = EgoMotion(twist, shot.t - last.t, moved, age, self.last_twist)
        partner = None
        others: list[CameraPixels] = []
        if self.others is not None:
            partner = self.others.views(shot, t, None).get(s.law.depth.camera)
            if s.fusion == "pose":
                others = self.others.pixels(shot, t, self.ordered, mount)
        seen = self._perception.observe(shot, detection, twist, own, partner, others)
        if self._own_rates is not None:
            seen = replace(seen, robot=self._own_rates.model(last, shot, t, t_cmd, reading, mount))
        if self._needs_own_state:
            seen = replace(seen, proprioception=s.robot.proprioception(shot.reading, seen.odometry))
        if shot.reading.wrench is not None:
            to_flange = self._mount_at(shot.reading.q).to_flange
            seen = replace(seen, wrench=to_flange.T @ shot.reading.wrench)
        if self._needs_sight and shot.picture is not None:
            seen = replace(seen, image=sight_of(shot.picture))
        return seen

    def _twist_since(self, last: Exposure, shot: Exposure, measured: bool) -> Array:
        """Mean twist of the camera (6,) since the last exposure: as commanded, or `measured` by the
        robot's sensors; STILL where nothing reads it.
        """
        period = shot.t - last.t
        twist = STILL
        if period > 0 and (measured or self.observer.needs_pose):
            twist = (self.ordered.displacement(shot.t) - self.ordered.displacement(last.t)) / period
        if not measured:
            return twist
        mount = self._mount_at(shot.reading.q)
        return self.scenario.robot.measured_twist(last.reading, shot.reading, period, twist, mount)

    def _moved_since(
        self, shot: Exposure, t: float, reading: Reading, mount: Mount
    ) -> tuple[Array, float]:
        """How far the camera has gone from the exposure to t [s], (6,) [m, rad], and the time
        between; integrated commands stand in for a robot without sensors of its motion.
        """
        moved = self.ordered.displacement(t) - self.ordered.displacement(shot.t)
        age = t - shot.t
        if age > 0:
            robot = self.scenario.robot
            moved = robot.measured_twist(shot.reading, reading, age, moved / age, mount) * age
        return moved, age

    def _moved(self, t: float, reading: Reading, blind: str, mount: Mount) -> float:
        """Way of the camera since the last call, by the robot's own sensors [m]; 0 where it is not
        needed, with sight.
        """
        before, self._at = self._at, (t, reading, mount)
        if not blind or before is None:
            return 0.0
        since, last, _ = before
        if t <= since:
            return 0.0
        v = self.scenario.robot.measured_twist(last, reading, t - since, self.last_twist, mount)[:3]
        return float(np.linalg.norm(v)) * (t - since)

    def _allocate(self, command: Command, reading: Reading, mount: Mount) -> Allocation:
        robot = self.scenario.robot
        twist = command.twist
        if isinstance(robot, Arm):  # the others have no secondary task
            for share, free in command.free:
                twist = twist + share * robot.secondary_task(free, reading, mount)
        # a secondary task changes the twist alone
        rates = command.rates if twist is command.twist else None
        allocation = self._limited(twist, rates, reading, mount)
        if command.wrench is not None:
            allocation = self._pressed(allocation, command.wrench, mount)
        if not (
            all_finite(allocation.setpoint)
            and (allocation.twist is command.twist or all_finite(allocation.twist))
        ):
            self.guarded.fail(
                f"robot {robot.kind} made a setpoint that is not finite, {allocation.setpoint},"
                f" of the twist {np.round(twist, 3)}"
            )
            allocation = Allocation(np.zeros_like(allocation.setpoint), np.zeros(6), 0.0)
        # The command within limits, before the supervisor: a law with feedforward predicts by it
        # (`EgoMotion.commanded`).
        self.last_twist = allocation.twist
        return allocation

    def _limited(
        self, twist: Array, rates: Array | None, reading: Reading, mount: Mount
    ) -> Allocation:
        """A twist (6,), or the robot's own velocities that make it, within the robot's limits."""
        robot = self.scenario.robot
        period = self.scenario.camera.period
        if rates is not None and isinstance(robot, Arm):
            allocation = robot.allocate_rates(rates, reading, mount, period)
        else:
            made = twist if rates is None else robot.motion_basis(mount, reading.q) @ rates
            allocation = robot.allocate(made, reading, mount, period)
        # also of rates that make another one than their law says
        return allocation.told(twist)

    def _pressed(self, allocation: Allocation, wrench: Array, mount: Mount) -> Allocation:
        """An allocation with a wrench (6,), of a robot that takes one; else the law has failed."""
        robot = self.scenario.robot
        if isinstance(robot, Arm) and robot.controller.takes_wrench:
            return robot.pressed(allocation, wrench, mount)
        self.guarded.fail(
            f"law {self.law.kind} orders a wrench, which needs an arm with `controller: impedance`"
        )
        return allocation

    def _supervised(
        self, t: float, blind: str, order: Order, reading: Reading, basis: Array, moved: float
    ) -> Order:
        """The order, unless the robot's supervisor has another; of a stop with the setpoint at
        which the robot comes to rest.
        """
        if self.guarded.failure and not self._failed:
            self._failed = True
            self.supervisor.abort(t, Outcome.law_failed, self.guarded.failure)
        made = self.supervisor.filter(t + self._sight.behind_s, blind, reading, order, basis, moved)
        self._taken_over = made is not order
        if made.stop == "stop" and self._order is not None:
            setpoint = self.scenario.robot.stopping(self._order.setpoint, REST_S)
            made = made._replace(setpoint=setpoint + 0.0)  # no -0
        return made

    def without_picture(self, t: float, reading: Reading) -> Order:
        """The order at a time [s] at which the last picture is older than a command lasts
        (`timing.command_timeout_s`). A robot stops, and a craft holds; after `stop.lost_after_s`
        its supervisor gives the task up. Errors: as of `step`.
        """
        with self._alone():
            now = self._now(self.inputs.now(t))
            self._sight.tick(now, self._own.s())
            return self._without(now, self.inputs.reading(reading))

    def _without(self, t: float, reading: Reading) -> Order:
        """The same of what has been checked. The silence has begun when the last order ended,
        whenever somebody asks.
        """
        if self._came is not None and not self._silent:
            began = self._came[0] + self._order_s
            if began < t:
                self.lapsed(began, reading)
        return self.lapsed(t, reading)

    def lapsed(self, t: float, reading: Reading, why: str = NO_PICTURE) -> Order:
        """The same for the time loop, which asks in time."""
        self._silent = True
        robot = self.scenario.robot
        mount = self._mount_at(reading.q)
        basis = robot.motion_basis(mount, reading.q)
        moved = self._moved(t, reading, why, mount)
        rest = robot.allocate(np.zeros(6), reading, mount, self.scenario.camera.period)
        stop = Order.of(rest).halted(why)
        order = self._supervised(t, why, stop, reading, basis, moved)
        self._ordered(t, order)
        return order

    @property
    def failure(self) -> str:
        """What the law did wrong, in words; "" while it works."""
        return self.guarded.failure
