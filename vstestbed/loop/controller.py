"""Control step for one camera frame: detect, observe, compute the law, allocate to the actuators."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vstestbed.camera import Look
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.features.observation import Goal, Observation, OwnMotion
from vstestbed.laws import Command, Law
from vstestbed.loop.shutter import Exposed
from vstestbed.robots import Allocation, Mount, Reading
from vstestbed.robots.robot_log import RobotState
from vstestbed.scenario.scenario import NOISE_STREAM, Scenario
from vstestbed.sim.base import Plant
from vstestbed.tasks.frame import Frame, FrameTiming, ImageError
from vstestbed.vision import Detector, Observer, TruthView

_NO_ROW = np.zeros(0)
_NOWHERE = np.full(3, np.nan)
"""Place and odometry of a robot that has none."""


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


def _checked(law: Law[Any], stepped: Any) -> tuple[Any, Command]:
    """What `step` returned, if it is a memory and a command.

    Raises:
        ParameterError: it is something else, or the twist is no six finite numbers: no outcome of a run would be true then.
    """
    if not (isinstance(stepped, tuple) and len(stepped) == 2 and isinstance(stepped[1], Command)):
        raise ParameterError("law.kind", f"{law.kind}: step must return (memory, Command), got {type(stepped).__name__}")
    twist = stepped[1].twist
    if np.shape(twist) != (6,) or not math.isfinite(twist.sum()):
        raise ParameterError("law.kind", f"{law.kind}: the twist of a Command must be six finite numbers, got {twist}")
    return stepped


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
        # an oracle looks with the true lens; a real detector knows only the calibrated one
        self.seen_through = scenario.camera if scenario.detector.needs_truth else scenario.believed_camera
        self.rng = scenario.rng(NOISE_STREAM)
        self.observer = _observer(scenario)
        self.detector: Detector[Any] = scenario.detector
        self.law: Law[Any] = scenario.law
        self.detector_memory, self.observer_memory = scenario.detector.init(), self.observer.init()
        self.reference_memory = scenario.goal.begin(scenario.setup, scenario.goal_views)
        self.law_memory = scenario.law.init(scenario.goal_views[0])
        self.supervisor = scenario.robot.supervisor(scenario.goal.lands, scenario.stop.lost_after_s)
        self.monitor = scenario.goal.monitor(scenario.setup, self.supervisor)
        self.robot_log = scenario.robot.log(self.supervisor)
        self.before: Exposed | None = None

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
        stepped = self.law.step(self.law_memory, seen, goal, s.robot.motion_basis(mount, reading.q))
        self.law_memory, command = _checked(self.law, stepped)
        allocation = self._allocate(shot.t, command, reading, mount)
        # A detector may have had a picture drawn whole: that time is the renderer's.
        self.spent["detect"] += detected - began - (self.plant.render_s - rendered)
        self.spent["law"] += time.perf_counter() - detected
        frame = self._frame(shot, now, seen, goal, command, allocation)
        self.before = shot
        self.reference_memory, next_goal = s.goal.passed(self.reference_memory, frame.error)
        if next_goal is not None:  # a law's memory belongs to one goal
            self.law_memory = self.law.init(next_goal)
        return frame

    def _frame(self, shot: Exposed, now: Arrival, seen: Observation, goal: Goal, command: Command, allocation: Allocation) -> Frame:
        """The frame, with the robot's and the task's own columns."""
        error = ImageError.of(seen, goal, command.rest_reason)
        image = shot.picture.image if shot.picture else None
        timing = FrameTiming(shot.number, shot.t, now.t_cmd)
        frame = Frame(timing, seen, goal, error, command, allocation, shot.truth, image, _NO_ROW)
        values = self.monitor.measure(frame)
        if self.robot_log.columns:
            place, odometry = (_NOWHERE if known is None else known for known in (seen.place, seen.odometry))
            T_base = frame.T_world_base(self.monitor.mount_inverse)
            state = RobotState(shot.t, T_base, place, odometry, shot.reading, shot.truth.act, shot.truth.wind)
            return replace(frame, row=np.concatenate([self.robot_log.row(state), values]))
        return replace(frame, row=np.array(values)) if values else frame

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
        if "motion" in s.law.inputs:
            own = self._own_motion(last, shot, now, twist)
        heading, tilt = shot.reading.heading, shot.reading.tilt
        observed = self.observer.observe(self.observer_memory, shot.t, detection, twist, self.rng, heading, tilt, own)
        self.observer_memory, seen = observed
        return seen

    def _allocate(self, t: float, command: Command, reading: Reading, mount: Mount) -> Allocation:
        """The setpoint for a command, within the robot's limits, unless its supervisor overrides it."""
        robot, twist = self.scenario.robot, command.twist
        if command.null_space is not None:
            twist = twist + robot.secondary_task(command.null_space, reading, mount)
        allocation = robot.allocate(twist, reading, mount, self.scenario.camera.period)
        # The command within limits, before the supervisor: a law with feedforward predicts by it (`OwnMotion.commanded`).
        self.last_twist = allocation.twist
        setpoint = self.supervisor.filter(t, command.rest_reason, reading, allocation.setpoint)
        return allocation if setpoint is allocation.setpoint else replace(allocation, setpoint=setpoint)
