"""Control step for one camera frame: detect, observe, compute the law, allocate to the actuators."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vstestbed.camera import Look
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.outcome import Outcome
from vstestbed.features.observation import Goal, Observation, OwnMotion
from vstestbed.laws import Command, Law
from vstestbed.loop.guarded_law import GuardedLaw
from vstestbed.loop.shutter import Exposed
from vstestbed.robots import Allocation, Mount, Reading
from vstestbed.robots.orders import stop_order
from vstestbed.robots.robot_log import RobotLog, RobotState
from vstestbed.scenario.scenario import NOISE_STREAM, Scenario
from vstestbed.sim.base import Plant
from vstestbed.tasks.frame import Frame, FrameTiming, ImageError
from vstestbed.vision import Detector, Observer, TruthView

_NOWHERE = np.full(3, np.nan)
"""Place and odometry of a robot that has none."""
NONE_SEEN, FEW_SEEN, NO_PICTURE = "no marker was in sight", "too few markers were in sight", "no picture arrived"
"""Why there is no measurement, where the law itself gives no reason."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """Arrival of a picture: its time [s], when its command will reach the robot [s], the integral of all commands so far (6,) [m, rad]."""

    t: float
    t_cmd: float
    displacement: Array


def _observer(scenario: Scenario) -> Observer:
    return Observer(
        camera=scenario.believed_camera,
        target=scenario.target,
        goal=scenario.goal_view,
        depth=scenario.law.depth,
        pixel_sigma_px=scenario.noise.pixel_sigma_px,
        dropout=scenario.noise.dropout,
        required_fields=scenario.law.inputs,
        grounded=scenario.robot.base == "planar",
        derotation=scenario.derotation,
        trim_s=scenario.level_trim_s,
        depth_scale=scenario.depth_scale,
    )


class FrameController:
    """The control step when a picture arrives. Holds the state of detector, observer, reference and law between frames.

    Args:
        scenario: the experiment. plant: source of the robot's sensor readings. spent: wall time by part, added to [s].
    """

    def __init__(self, scenario: Scenario, plant: Plant, spent: dict[str, float]):
        self.scenario, self.plant, self.spent = scenario, plant, spent
        # The calibrated mount: what the robot does with a command follows from what it believes, errors included.
        self.mount = Mount.of(scenario.believed_camera.mount.T)
        self.last_twist = np.zeros(6)
        self._setpoint, self._way_from = np.zeros(1), (0.0, plant.reading())
        at_start = scenario.robot.start_joints()
        # an oracle looks with the true lens; a real detector knows only the calibrated one
        self.seen_through = scenario.camera if scenario.detector.needs_truth else scenario.believed_camera
        self.rng = scenario.rng(NOISE_STREAM)
        self.observer = _observer(scenario)
        self.detector: Detector[Any] = scenario.detector
        self.law: Law[Any] = scenario.law
        self.guarded = GuardedLaw(scenario.law)
        self._needed = scenario.law.markers_needed(scenario.robot.motion_basis(self._mount_at(at_start), at_start))
        self.detector_memory, self.observer_memory = scenario.detector.init(), self.observer.init()
        self.reference_memory = scenario.goal.begin(scenario.setup, scenario.goal_views)
        self.law_memory = scenario.law.init(scenario.goal_views[0])
        self.supervisor = scenario.robot.supervisor(scenario.goal.lands, scenario.stop.lost_after_s, scenario.stop.lost_after_m)
        self.monitor = scenario.goal.monitor(scenario.setup, self.supervisor)
        self.robot_log = scenario.robot.log(self.supervisor)
        self.before: Exposed | None = None
        self.failed = False
        self._needs_motion, self._own = "motion" in scenario.law.inputs, len(self.robot_log.columns) + len(self.monitor.columns)
        self._latest_s = scenario.timing.latest_s(scenario.camera)

    def look(self) -> Look | None:
        """The detector's region of interest for the next picture; None for all of it."""
        return self.detector.look(self.detector_memory, self.seen_through, self.scenario.target)

    def arrive(self, shot: Exposed, now: Arrival) -> Frame:
        """One control step: detect, observe, reference, law, allocation."""
        s, last = self.scenario, self.before or shot
        began, rendered = time.perf_counter(), self.plant.render_s
        seen = self._observe(shot, last, now)
        self.reference_memory, goal = s.goal.reference(self.reference_memory, seen)
        seen = seen.only(goal.counted)
        detected = time.perf_counter()
        # The robot as it is now, not as it was at the exposure: the command acts from here on.
        reading = self.plant.reading()
        mount = self._mount_at(reading.q)
        basis = s.robot.motion_basis(mount, reading.q)
        self.law_memory, command = self.guarded.step(self.law_memory, seen, goal, basis)
        late = now.t - shot.t > self._latest_s
        error = ImageError.of(seen, goal, command.rest_reason)
        blind = command.rest_reason or self._unseen(seen, goal, error) or (f"pictures arrived {now.t - shot.t:.2g} s late" if late else "")
        moved = self._moved(now.t, reading, blind, mount)
        allocation = self._supervised(shot.t, blind, self._allocate(command, reading, mount, rests=late), reading, moved)
        # A detector may have had a picture drawn whole: that time is the renderer's.
        self.spent["detect"] += detected - began - (self.plant.render_s - rendered)
        self.spent["law"] += time.perf_counter() - detected
        frame = self._frame(shot, now, seen, goal, error, command, allocation)
        self.before = shot
        self.reference_memory, next_goal = s.goal.passed(self.reference_memory, frame.error)
        if next_goal is not None:  # a law's memory belongs to one goal
            self.law_memory = self.law.init(next_goal)
        return frame

    def _frame(
        self, shot: Exposed, now: Arrival, seen: Observation, goal: Goal, error: ImageError, command: Command, allocation: Allocation
    ) -> Frame:
        """The frame, with the robot's and the task's own columns."""
        image = shot.picture.image if shot.picture else None
        row = np.empty(self._own)
        frame = Frame(FrameTiming(shot.number, shot.t, now.t_cmd), seen, goal, error, command, allocation, shot.truth, image, row)
        values = self.monitor.measure(frame)
        row[:] = (*self._robot_row(frame, shot), *values)
        return frame

    def _robot_row(self, frame: Frame, shot: Exposed) -> Iterable[float]:
        """Values of the robot's own columns."""
        if self.robot_log.columns == RobotLog.columns:
            return (self.supervisor.mode,)  # the state, which takes a tenth of an ideal frame, is not needed
        seen = frame.observation
        place, odometry = (_NOWHERE if known is None else known for known in (seen.place, seen.odometry))
        T_base = frame.T_world_base(self.monitor.mount_inverse)
        return self.robot_log.row(RobotState(shot.t, T_base, place, odometry, shot.reading, shot.truth.act, shot.truth.wind))

    def _mount_at(self, q: Array) -> Mount:
        """The camera's mount; eye to hand, the camera's pose relative to the flange at the joints q."""
        if not self.scenario.target.on_gripper:
            return self.mount
        return Mount.facing(inverse(self.scenario.robot.flange_pose(q)) @ self.mount.T_flange_camera)

    def _own_motion(self, last: Exposed, shot: Exposed, now: Arrival, twist: Array) -> OwnMotion:
        """The camera's motion since the last picture, and since this one's exposure, by the robot's own sensors."""
        # Integrated commands stand in for a robot without sensors of its motion.
        moved, age, reading = now.displacement - shot.displacement, now.t - shot.t, self.plant.reading()
        if age > 0:
            moved = self.scenario.robot.measured_twist(shot.reading, reading, age, moved / age, self._mount_at(reading.q)) * age
        return OwnMotion(twist, shot.t - last.t, moved, age, self.last_twist)

    def _observe(self, shot: Exposed, last: Exposed, now: Arrival) -> Observation:
        """The law's measurement from this picture."""
        s = self.scenario
        # Truth reaches a detector only if it says that it needs it (an oracle): the one place where it passes the fence.
        view = TruthView(shot.truth.p_camera, shot.truth.hidden) if s.detector.needs_truth else None
        detected = self.detector.detect(self.detector_memory, shot.picture, view, self.seen_through, s.target, self.rng)
        self.detector_memory, detection = detected
        twist, own = shot.commanded, None
        if self.observer.uses_motion(detection):
            mount = self._mount_at(shot.reading.q)
            twist = s.robot.measured_twist(last.reading, shot.reading, shot.t - last.t, shot.commanded, mount)
        if self._needs_motion:
            own = self._own_motion(last, shot, now, twist)
        heading, tilt = shot.reading.heading, shot.reading.tilt
        observed = self.observer.observe(self.observer_memory, shot.t, detection, twist, self.rng, heading, tilt, own)
        self.observer_memory, seen = observed
        return seen

    def _unseen(self, seen: Observation, goal: Goal, error: ImageError) -> str:
        """Why a law that gives no reason has no measurement; "" where it has one."""
        n = len(seen.uv) if error.all_seen and goal.counted is None else np.count_nonzero(seen.seen)
        return "" if n >= self._needed else FEW_SEEN if n else NONE_SEEN

    def _moved(self, t: float, reading: Reading, blind: str, mount: Mount) -> float:
        """Way of the camera since the last call, by the robot's own sensors [m]; 0 where it is not needed, with sight."""
        (before_t, before), self._way_from = self._way_from, (t, reading)
        if not blind or t <= before_t:
            return 0.0
        v = self.scenario.robot.measured_twist(before, reading, t - before_t, self.last_twist, mount)[:3]
        return float(np.linalg.norm(v)) * (t - before_t)

    def _allocate(self, command: Command, reading: Reading, mount: Mount, rests: bool) -> Allocation:
        """The setpoint for a command, within the robot's limits; the order to stop where the law has no measurement and no motion."""
        robot, twist = self.scenario.robot, command.twist
        if command.null_space is not None:
            twist = twist + robot.secondary_task(command.null_space, reading, mount)
        allocation = robot.allocate(twist, reading, mount, self.scenario.camera.period)
        # The command within limits, before the supervisor: a law with feedforward predicts by it (`OwnMotion.commanded`).
        self.last_twist = allocation.twist
        if rests or (command.rest_reason and not twist.any()):
            return replace(allocation, setpoint=stop_order(allocation.setpoint), twist=np.zeros(6))
        return allocation

    def _supervised(self, t: float, blind: str, allocation: Allocation, reading: Reading, moved: float) -> Allocation:
        """The allocation, unless the robot's supervisor overrides it."""
        if self.guarded.failure and not self.failed:
            self.failed = True
            self.supervisor.abort(t, Outcome.law_failed, self.guarded.failure)
        self._setpoint = setpoint = self.supervisor.filter(t, blind, reading, allocation.setpoint, moved)
        return allocation if setpoint is allocation.setpoint else replace(allocation, setpoint=setpoint)

    def without_picture(self, t: float) -> Array:
        """The setpoint at a time [s] at which the last picture is older than a command lasts."""
        reading = self.plant.reading()
        moved = self._moved(t, reading, NO_PICTURE, self._mount_at(reading.q))
        self._setpoint = self.supervisor.filter(t, NO_PICTURE, reading, stop_order(self._setpoint), moved)
        return self._setpoint
