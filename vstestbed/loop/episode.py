"""Episode: the only time loop. It advances the clock from event to event: exposures, arriving
pictures, arriving commands.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Generator, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vstestbed.camera import Image
from vstestbed.core.geometry import Array, inverse, transform
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.core.provenance import versions
from vstestbed.endings import Termination
from vstestbed.features.observation import Goal
from vstestbed.laws import Law
from vstestbed.loop.columns import Layout
from vstestbed.loop.controller import Controller
from vstestbed.loop.ego_motion import Exposure
from vstestbed.loop.explanation import Explanation
from vstestbed.loop.log_file import LogWriter
from vstestbed.loop.plants import plant_of, shown_clean, take_goal_images
from vstestbed.loop.recording import Recording, Watcher
from vstestbed.loop.shutter import CameraClock, Exposed
from vstestbed.loop.stability import Stability
from vstestbed.robots.allocation import Order
from vstestbed.robots.base import RobotLog, RobotState
from vstestbed.scenario.distributions import LINK_STREAM
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import Truth
from vstestbed.tasks.frame import CameraRecord, Cycle, Frame
from vstestbed.timing.clock import DelayLine, directions
from vstestbed.vision.base import goal_of_points, points_of

__all__ = ["BY_HAND", "Episode"]

_NOWHERE = np.full(3, np.nan)  # place and odometry of a robot that has none

BY_HAND = "Changed by hand during the run:"  # in the description of a run that no scenario repeats


class Episode:
    """One run under way: the plant, the controller, the termination, the log.
    ended_s: simulated time of the verdict [s]. frame: the last frame; its command is not sent
    before the next `advance`. by_hand: what a person changed during the run, in words, each with
    the time of the first [s] and how often.
    """

    def __init__(
        self,
        scenario: Scenario,
        pictures: bool,
        watchers: tuple[Watcher, ...],
        folder: Path | None,
        plate_m: float = 0.0,
    ):
        began = time.perf_counter()
        self.scenario = scenario = scenario.resolved
        self._watchers = watchers
        self._log = LogWriter(Layout(scenario), folder)
        self.outcome: Outcome | None = None
        self.reason = ""
        self.ended_s = 0.0
        self.by_hand: dict[str, tuple[float, int]] = {}
        self.frame: Frame | None = None
        self._waits = self._commanded = self.closed = False
        self._physics_s = self._record_s = self._redrawn_s = 0.0
        shown = shown_clean(scenario)
        self.plant, self._renderer = plant_of(scenario, pictures, plate_m)
        taken = take_goal_images(scenario, self.plant) if shown is None else shown
        self.controller = Controller(scenario, taken)
        self._goal_images = tuple(sight.image for sight in taken)
        link = scenario.timing.link
        from_camera, self._to_robot = directions(link, scenario.rng(LINK_STREAM))
        whole = pictures or "image" in scenario.law.inputs
        self._camera = CameraClock(scenario, self.plant, whole, from_camera)
        self._others: dict[str, CameraClock] = {}
        for name, eye in scenario.eyes.items():
            from_eye, _ = directions(link, eye.rng(LINK_STREAM))
            self._others[name] = CameraClock(eye, self.plant.others[name], pictures, from_eye)
        self._last_of: dict[str, Exposed] = {}  # what the further cameras showed last
        supervisor = self.controller.supervisor
        self._task = scenario.goal.monitor(scenario.setup, supervisor)
        self._robot_log = scenario.robot.log(supervisor)
        self._explanation = Explanation(scenario, self.plant.names_before)
        self._termination = Termination(
            self._task,
            scenario.setup,
            supervisor,
            [(rule.kind, rule.monitor(scenario.setup)) for rule in scenario.monitors],
            self._explanation,
        )
        self._interpolator = scenario.timing.interpolator(*scenario.clock)
        # Of points that are not the target's markers, by the true lens: they lie in the target's
        # plane where it saw them at the goal.
        self._goal: Goal | None = None
        if scenario.detector.rows is not None:
            last = scenario.goal_poses[-1]
            self._goal = Goal.from_view(scenario.camera, scenario.target.points, last)
        self._own_columns = len(scenario.own_columns)
        self._timing_columns = scenario.timing.columns + scenario.camera.columns
        self._commands: DelayLine[Order] = DelayLine(
            round(scenario.timing.command_latency_s / self.plant.step_s)
        )
        self._frames = self._turn()
        self.build_s = time.perf_counter() - began
        self.loop_s = 0.0

    def advance(self, command: Array | None = None) -> Frame | None:
        """Send a command, or the law's, for the last frame; the next frame, or None where the run
        ended without one.
        """
        start = time.perf_counter()
        try:
            if self._waits:
                self._send(command)
            return next(self._frames, None)
        except BaseException:
            # whatever a law, a watcher or Ctrl-C raises: the plant holds an OpenGL context, which
            # the next run needs
            self.close()
            raise
        finally:
            self.loop_s += time.perf_counter() - start

    @property
    def now(self) -> float:
        """The simulated time [s]; of a frame that has just come that of its picture's arrival."""
        return self._step * self.plant.step_s

    @property
    def steps(self) -> bool:
        """Whether it is under way to its next frame, in another thread."""
        return inspect.getgeneratorstate(self._frames) == inspect.GEN_RUNNING

    def ended(self) -> Frame:
        """The last frame, with the outcome of a run that ended without another one."""
        assert self.frame is not None and self.outcome is not None
        return replace(self.frame, verdict=(self.outcome, self.reason))

    def close(self) -> None:
        """Write what waits to the log, free the simulation."""
        if self.closed:
            return
        self.closed = True
        try:
            if self._waits:
                self._note()
            self._log.flush()
        finally:
            self._log.close()
            # it holds this object: a cycle, in which the model (100 MB with an arm's meshes) waited
            # for the collector
            self._frames.close()
            self.plant.close()

    def recording(self) -> Recording:
        """The record of what has run so far; frames that come later are not in it."""
        if not self.closed:
            self._log.flush()
        outcome = self.outcome or Outcome.interrupted
        spent = self.controller.spent
        detect_s = spent["detect"] - self._redrawn_s
        plants = (self.plant, *self.plant.others.values())
        took = {
            "physics": self._physics_s,
            "render": sum(plant.render_s for plant in plants),
            "detect": detect_s,
            "law": spent["law"],
            "record": self._record_s,
            "video": 0.0,
        }
        scenario = self.scenario
        if self.by_hand:
            words = "; ".join(
                f"{what} from {t:.2f} s on ({times} times)"
                for what, (t, times) in self.by_hand.items()
            )
            scenario = replace(
                scenario, description=f"{scenario.description} {BY_HAND} {words}.".strip()
            )
        return Recording(
            scenario,
            outcome,
            self.reason or outcome.value,
            self._log.log(),
            wall_time_s=self.build_s + self.loop_s,
            loop_s=self.loop_s,
            time_ms={part: 1e3 * seconds for part, seconds in took.items()},
            versions=versions() | {"renderer": self._renderer},
            ended_s=self.ended_s,
            goal_images=self._goal_images,
        )

    def take_pictures(self, on: bool) -> None:
        """Whether the exposures from now on take whole pictures; only of an episode that was begun
        with pictures.
        """
        for camera in (self._camera, *self._others.values()):
            camera.whole = on

    def changed_by_hand(self, what: str) -> None:
        """Remember what a person changed, which no scenario file repeats."""
        t, times = self.by_hand.get(what, (self.frame.t if self.frame else 0.0, 0))
        self.by_hand[what] = t, times + 1

    def retune(self, law: Law[Any]) -> None:
        """Go on with other parameters of the law."""
        self.controller.retune(law)
        self.scenario = self.controller.scenario
        self._explanation.stability = Stability(self.scenario)
        self.changed_by_hand("law")

    def _send(self, command: Array | None) -> None:
        """Send the command for the last frame on its way, and put the frame into the log."""
        assert self.frame is not None
        self._commanded = command is not None
        if command is not None:
            # of commands from outside neither gain nor delay is known
            self._explanation.stability = None
            wanted, allocation, order = self.controller.override(self.frame, command)
            self.frame = replace(self.frame, command=wanted, allocation=allocation, order=order)
        if self._to_robot is None or not self._to_robot(self._step // self.plant.steps_per_frame):
            self._commands.push(self._step, self.frame.order)
        else:
            timing = self.frame.timing
            timing = timing._replace(own={**(timing.own or {}), "command_lost": 1.0})
            self.frame = replace(self.frame, timing=timing)
        self._note()

    def _note(self) -> None:
        assert self.frame is not None
        self._waits = False
        start = time.perf_counter()
        self._log.append(self.frame)
        self._record_s += time.perf_counter() - start
        if self._watchers:
            self.frame.protected()
        for watcher in self._watchers:
            watcher.frame(self.frame)

    def _end(self, verdict: Verdict, t: float) -> None:
        self.outcome, self.reason = verdict
        self.ended_s = t

    def _turn(self) -> Generator[Frame]:
        """Take pictures, deliver them and their commands, each when it is due, until the verdict
        that ends the run.
        """
        scenario = self.scenario
        plant = self.plant
        camera = self._camera
        self._step = step = 0
        order_steps = round(scenario.timing.order_s(scenario.camera) / plant.step_s)
        silent_at = order_steps + round(scenario.camera.latency_s / plant.step_s)
        while True:
            camera.act(step, self.controller.regions_of_interest)
            for name, other in self._others.items():
                self._see(name, other, step)
            for made in camera.line.pop_due(step):
                if (frame := self._arrive(made, step)) is None:  # refused
                    continue
                silent_at = step + order_steps
                yield frame
                if frame.outcome is not None:
                    return
            # a camera that is dead must not leave the robot without a supervisor, nor the run
            # without an end
            if step >= silent_at:
                self._stop_in_silence(step * plant.step_s)
                if self.outcome is not None:
                    return
                silent_at = step + plant.steps_per_frame
            # After the pictures: without latency, a command takes effect in the step in which its
            # picture arrived.
            for order in self._commands.pop_due(step):
                plant.apply(order.setpoint, order.stop)
            # The physics runs to the next event in one call.
            ahead = min(silent_at, self._next_event()) - step
            start = time.perf_counter()
            if not plant.advance(ahead):
                t = step * plant.step_s
                words = f"{Outcome.crashed.value} at {t:.3f} s"
                return self._end((Outcome.crashed, words), t)
            self._physics_s += time.perf_counter() - start
            self._step = step = step + ahead

    def _stop_in_silence(self, t: float) -> None:
        """Stop the robot at a time [s] at which the last picture is too old; the run may end."""
        order = self.controller.lapsed(t, self.plant.reading())
        self.plant.apply(order.setpoint, order.stop)
        if verdict := self._termination.without_picture(t, self.plant.truth()):
            self._end(verdict, t)
        # orders still on their way must not set a robot that stops in motion again
        if self.controller.supervisor.aborted:
            self._commands.clear()

    def _next_event(self) -> int:
        """The step at which a camera acts next, or a command arrives."""
        following = self._camera.next_event()
        for other in self._others.values():
            following = min(following, other.next_event())
        due = self._commands.next_due()
        return following if due is None else min(following, due)

    def _see(self, name: str, camera: CameraClock, step: int) -> None:
        """Take the pictures of a further camera, and deliver them."""
        assert self.controller.others is not None
        perception = self.controller.others.perception[name]
        camera.act(step, perception.regions_of_interest)
        for shot, truth in camera.line.pop_due(step):
            given, _ = camera.received(shot, step)
            # overtaken, by the stamps, which are all that a robot has
            if perception.before is not None and given.t <= perception.before.t:
                continue
            self.controller.see(name, given)
            self._last_of[name] = shot, truth

    def _records(self, c: Cycle) -> dict[str, CameraRecord]:
        """What the further cameras showed last."""
        records: dict[str, CameraRecord] = {}
        others = self.controller.others
        for name, seen in others.seen().items() if others else ():
            shot, truth = self._last_of[name]
            view = (c.observation.cameras or {}).get(name)
            goal_uv = np.full_like(seen.uv, np.nan)
            if view is not None and view.goal is not None:
                goal_uv = view.goal.uv
            image = self._image(shot)
            records[name] = CameraRecord(
                shot.t, seen.uv, seen.depth, goal_uv, truth.p_camera, truth.T_world_camera, image
            )
        return records

    def _image(self, shot: Exposure) -> Image | None:
        """The image of an exposure, which the caller may keep."""
        image = shot.picture.image if shot.picture else None
        return image.copy() if self._camera.whole and image is not None else image

    def _arrive(self, made: Exposed, step: int) -> Frame | None:
        """A picture has arrived: the frame with its command, and its outcome if it is the last;
        None for one that is refused.
        """
        shot, truth = made
        plant = self.plant
        rendered = plant.render_s
        given, stamp = self._camera.received(shot, step)
        if self.controller.refuses(given):
            return None
        due = step + self._commands.delay_steps
        reaches = due if self._interpolator is None else self._interpolator.next_tick(due)
        cycle = self.controller.arrive(
            given, step * plant.step_s, reaches * plant.step_s, plant.reading()
        )
        if self._timing_columns:
            timing = cycle.timing._replace(t=shot.t, own=self._timed(shot, stamp))
            cycle = replace(cycle, timing=timing)
        # A detector may have had a picture drawn whole: that time is the renderer's.
        self._redrawn_s += plant.render_s - rendered
        before = self.frame
        judged = self.frame = frame = self._assembled(cycle, shot, truth)
        # A command given in place of the law's is not known yet: the frame is judged, and at the
        # end logged, with that in force.
        if self._commanded and before is not None:
            judged = replace(
                frame, command=before.command, allocation=before.allocation, order=before.order
            )
        self._waits = True
        if verdict := self._termination.verdict(judged):
            self._end(verdict, frame.t)
            self.frame = replace(judged, verdict=verdict)
            self._note()
        return self.frame

    def _timed(self, shot: Exposure, stamp: float) -> dict[str, float]:
        """The columns of an exposure's times and losses, and of how it was exposed."""
        own = {"t_stamp": stamp, "refused": float(self.controller.refused), "command_lost": 0.0}
        control = self.scenario.camera.blurring
        picture = shot.picture if self.scenario.needs_image else None
        if picture is not None and picture.exposed is not None:
            own |= {"exposure_s": picture.exposed.time_s, "gain": picture.exposed.gain}
        elif control is not None:  # without a picture those with which the camera begins
            own["exposure_s"], own["gain"] = control.first
        return {name: own[name] for name in self._timing_columns}

    def _assembled(self, c: Cycle, shot: Exposure, truth: Truth) -> Frame:
        """The cycle of an exposure with the truth then, and the columns that only this robot and
        this task have.
        """
        image = self._image(shot)
        depth = shot.picture.depth if shot.picture else None
        if self._goal is not None:
            points = points_of(goal_of_points(self._goal, c.goal.uv))
            T_camera_target = inverse(truth.T_world_camera) @ truth.T_world_target
            truth = truth._replace(p_camera=transform(T_camera_target, points))
        row = np.empty(self._own_columns)
        parts = c.timing, c.observation, c.goal, c.error, c.command, c.allocation
        frame = Frame(
            *parts,
            truth,
            image,
            row,
            order=c.order,
            depth_image=depth,
            cameras=self._records(c),
        )
        values = self._task.measure(frame)
        if self._robot_log.columns == RobotLog.columns:
            # the state, a tenth of an ideal frame, is not needed
            of_robot: Iterable[float] = (self.controller.supervisor.mode,)
        else:
            seen = c.observation
            place = _NOWHERE if seen.place is None else seen.place
            odometry = _NOWHERE if seen.odometry is None else seen.odometry
            T_base = frame.T_world_base(self._task.mount_inverse)
            state = RobotState(shot.t, T_base, place, odometry, shot.reading, truth.act, truth.wind)
            of_robot = self._robot_log.row(state)
        row[:] = (*of_robot, *truth.effects, *values)
        return frame
