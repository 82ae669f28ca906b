"""Eye to hand: what becomes of one picture, from detection to what is ordered of the robot."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vstestbed.camera import Look
from vstestbed.core.geometry import Array, all_finite, inverse
from vstestbed.features.observation import Observation, OwnMotion
from vstestbed.laws import Command, Law
from vstestbed.loop.failsafe import pilot_of
from vstestbed.loop.flight_columns import flight_row
from vstestbed.loop.recording import Tick
from vstestbed.loop.reference import course_of
from vstestbed.loop.shutter import Shot
from vstestbed.loop.task_error import estimated, slipped
from vstestbed.robots import Allocation, Mount
from vstestbed.robots.base import Redundant
from vstestbed.scenario.scenario import NOISE_STREAM, Scenario
from vstestbed.sim.base import Plant
from vstestbed.targets.base import Held
from vstestbed.vision import Detector, Observer, TruthView


@dataclass(frozen=True, slots=True)
class Now:
    """When a picture has arrived [s], when what is made of it will reach the robot [s], and the sum of all ordered so far (6,)."""

    t: float
    t_cmd: float
    way: Array


def _observer(scenario: Scenario) -> Observer:
    return Observer(
        camera=scenario.believed_camera,
        target=scenario.target,
        goal=scenario.goal_view,
        depth=scenario.law.depth,
        pixel_sigma_px=scenario.noise.pixel_sigma_px,
        dropout=scenario.noise.dropout,
        required_fields=scenario.law.inputs,
        grounded=scenario.robot.grounded,
        derotation=scenario.derotation,
        trim_s=scenario.level_trim_s,
        depth_scale=scenario.depth_scale,
    )


class Servo:
    """Eye to hand: what happens when a picture arrives. Holds the memories that detector, observer and law pass on."""

    def __init__(self, scenario: Scenario, plant: Plant, spent: dict[str, float]):
        self.scenario, self.plant, self.spent = scenario, plant, spent
        self.course, self.pilot = course_of(scenario), pilot_of(scenario)
        self.mount = Mount.of(scenario.believed_camera.mount.T)
        self.held = isinstance(scenario.target.motion, Held)
        self.last_twist = np.zeros(6)
        self.seen_through = scenario.camera if scenario.detector.needs_truth else scenario.believed_camera
        self.basis = scenario.robot.motion_basis(self.mount)
        self.rng = scenario.rng(NOISE_STREAM)
        self.observer = _observer(scenario)
        self.seeing, self.observing = scenario.detector.init(), self.observer.init()
        self.control = scenario.law.init(scenario.goal_views[0])
        self.detector: Detector[Any] = scenario.detector
        self.law: Law[Any] = scenario.law
        self.before: Shot | None = None
        self.seen_before: Observation | None = None

    def look(self) -> Look | None:
        """Where the detector is going to look next, as far as it knows by now."""
        return self.detector.look(self.seeing, self.seen_through, self.scenario.target)

    def _mount_at(self, q: Array) -> Mount:
        """The camera's mount; of one that watches the hand, where it is against the flange at the joints q."""
        if not self.held:
            return self.mount
        return Mount.facing(inverse(self.scenario.robot.flange_pose(q)) @ self.mount.T_flange_camera)

    def _own_motion(self, last: Shot, shot: Shot, now: Now, twist: Array) -> OwnMotion:
        """What the robot knows of the camera's motion since the last picture, and since this one's exposure."""
        moved, age, encoders = now.way - shot.way, now.t - shot.t, self.plant.encoders()
        if age > 0:
            moved = self.scenario.robot.measured_twist(shot.encoders, encoders, age, moved / age, self._mount_at(encoders.q)) * age
        return OwnMotion(twist, shot.t - last.t, moved, age, self.last_twist)

    def arrive(self, shot: Shot, now: Now) -> Tick:
        """Detect, observe, decide."""
        s, began, last = self.scenario, time.perf_counter(), self.before or shot
        seen = self._observe(shot, last, now)
        goal = self.course.goal(seen)
        seen = seen.only(goal.counted)
        detected = time.perf_counter()
        self.control, command = self.law.step(self.control, seen, goal, self.basis)
        allocation = self._allocate(shot.t, command)
        self.spent["detect"] += detected - began
        self.spent["law"] += time.perf_counter() - detected
        error = seen.uv - goal.uv
        if not (all_seen := all_finite(error)):
            error = error[seen.seen]
            all_seen = goal.counted is not None and bool(seen.seen[goal.counted].all())
        lost = bool(command.held) or not error.size  # a law may order motion although it sees nothing
        error_px = math.nan if lost else math.sqrt(float(np.vdot(error, error)) / error.size)
        image = shot.frame.image if shot.frame and shot.frame.whole else None
        slip, estimate = self._slip(last, shot, seen), (math.nan, math.nan)
        if s.stop.converged.by_estimate:
            estimate = estimated(seen, goal)
        flight = flight_row(s, shot.encoders, shot.truth, seen, goal, self.pilot) if self.pilot else None
        at, n = self.course.view, shot.number
        tick = Tick(n, lost, all_seen, error_px, seen, command, allocation, shot.truth, image, goal, at, slip, estimate, flight, now.t_cmd)
        self.before, self.seen_before = shot, seen
        if self.course.passed(error_px, all_seen):
            self.control = self.law.init(s.goal_views[self.course.view])
        return tick

    def _observe(self, shot: Shot, last: Shot, now: Now) -> Observation:
        """What the law may know of this picture."""
        s = self.scenario
        view = TruthView(shot.truth.p_camera, shot.truth.hidden) if s.detector.needs_truth else None
        self.seeing, detection = self.detector.detect(self.seeing, shot.frame, view, self.seen_through, s.target, self.rng)
        twist, own = shot.ordered, None
        if self.observer.uses_motion(detection):
            mount = self._mount_at(shot.encoders.q)
            twist = s.robot.measured_twist(last.encoders, shot.encoders, shot.t - last.t, shot.ordered, mount)
        if "motion" in s.law.inputs:
            own = self._own_motion(last, shot, now, twist)
        compass = shot.encoders.instruments.get("compass")
        heading = None if compass is None else float(compass[0])
        tilt = shot.encoders.instruments.get("tilt")
        self.observing, seen = self.observer.observe(self.observing, shot.t, detection, twist, self.rng, heading, tilt, own)
        return seen

    def _allocate(self, t: float, command: Command) -> Allocation:
        """What is ordered of the robot for a command."""
        robot, encoders = self.scenario.robot, self.plant.encoders()
        mount, twist = self._mount_at(encoders.q), command.twist
        if command.free is not None and isinstance(robot, Redundant):
            twist = twist + robot.aside(command.free, encoders, mount)
        allocation = robot.allocate(twist, encoders, mount, self.scenario.camera.period)
        self.last_twist = allocation.twist
        if self.pilot:
            return replace(allocation, setpoint=self.pilot.order(t, command.held, encoders.instruments, allocation.setpoint))
        return allocation

    def _slip(self, last: Shot, shot: Shot, seen: Observation) -> tuple[float, float]:
        """For the log: what the encoders did not notice [m/s, rad/s]."""
        if seen.odometry is None or self.seen_before is None or self.seen_before.odometry is None:
            return 0.0, 0.0
        back = self.scenario.camera.mount.T
        T_before, T_now = (s.truth.T_world_camera @ inverse(back) for s in (last, shot))
        return slipped(T_before, T_now, self.seen_before.odometry, seen.odometry, shot.t - last.t)
