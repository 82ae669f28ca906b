"""run(scenario): the only time loop. It keeps the clock, the delay of pictures, the order of a frame's parts, the end."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from operator import mul
from typing import Any

import numpy as np

from vstestbed.camera import Frame, Look
from vstestbed.errors import ParameterError
from vstestbed.geometry import Array, all_finite, inverse
from vstestbed.goal import GoalViews
from vstestbed.laws import Law
from vstestbed.observation import Encoders, Observation, OwnMotion
from vstestbed.provenance import versions
from vstestbed.recording import Layout, Log, Recording, Tick, Watcher
from vstestbed.robots import Mount
from vstestbed.robots.base import Redundant
from vstestbed.scenario import IMAGE_STREAM, MOTION_STREAM, NOISE_STREAM, SENSOR_STREAM, Scenario
from vstestbed.sim.base import Plant, Truth
from vstestbed.sim.build import build_plant
from vstestbed.sim.timing import DelayLine
from vstestbed.stop import Evidence, Judge, Outcome
from vstestbed.target import Held, Square
from vstestbed.task import band_of, estimated, off, slipped
from vstestbed.vision import Detector, Observer, TruthView

PARTS = ("physics", "render", "detect", "law", "record", "video")
"""Where a run's wall time goes."""


@dataclass(frozen=True, slots=True)
class Shot:
    """A picture on its way to the law, with what the robot measured at its exposure and the mean twist ordered since the last.

    `way` is the sum of all that was ordered until the exposure, (6,) [m, rad].
    """

    frame: Frame | None
    t: float
    truth: Truth
    encoders: Encoders
    ordered: Array
    way: Array


def _observer(scenario: Scenario) -> Observer:
    return Observer(
        camera=scenario.camera,
        target=scenario.target,
        goal=scenario.goal_view,
        depth=scenario.law.depth,
        pixel_sigma_px=scenario.noise.pixel_sigma_px,
        dropout=scenario.noise.dropout,
        wanted=scenario.law.inputs,
        grounded=scenario.robot.grounded,
    )


class _Servo:
    """Eye to hand: what happens when a picture arrives. Holds the memories that detector, observer and law pass on."""

    def __init__(self, scenario: Scenario, plant: Plant, spent: dict[str, float]):
        self.scenario, self.plant, self.spent = scenario, plant, spent
        self.view = 0
        self.goal = scenario.goal_views[0]
        self.held = isinstance(scenario.target.motion, Held)
        self.mount = Mount.of(scenario.camera.mount.T)
        self.last_twist = np.zeros(6)
        self.basis = scenario.robot.motion_basis(self.mount)
        self.rng = scenario.rng(NOISE_STREAM)
        self.observer = _observer(scenario)
        self.seeing, self.observing, self.control = scenario.detector.init(), self.observer.init(), scenario.law.init(self.goal)
        self.detector: Detector[Any] = scenario.detector
        self.law: Law[Any] = scenario.law
        self.count = 0
        self.before: Shot | None = None
        self.seen_before: Observation | None = None

    def look(self) -> Look | None:
        """Where the detector is going to look next, as far as it knows by now."""
        return self.detector.look(self.seeing, self.scenario.camera, self.scenario.target)

    def _mount_at(self, q: Array) -> Mount:
        """The camera's mount; of one that watches the hand, where it is against the flange at the joints q."""
        if not self.held:
            return self.mount
        return Mount.facing(inverse(self.scenario.robot.flange_pose(q)) @ self.mount.T_flange_camera)

    def _own_motion(self, last: Shot, shot: Shot, now: float, way: Array) -> OwnMotion:
        """What the robot knows of the camera's motion since the last picture, and since this one's exposure."""
        robot, since, age, encoders = self.scenario.robot, shot.t - last.t, now - shot.t, self.plant.encoders()
        twist = robot.measured_twist(last.encoders, shot.encoders, since, shot.ordered, self._mount_at(shot.encoders.q))
        moved = way - shot.way
        if age > 0:
            moved = robot.measured_twist(shot.encoders, encoders, age, moved / age, self._mount_at(encoders.q)) * age
        return OwnMotion(twist, since, moved, age, self.last_twist)

    def arrive(self, shot: Shot, now: float, way: Array) -> Tick:
        """Detect, observe, decide, move: at a time `now` [s], when `way` has been ordered in all."""
        s, began = self.scenario, time.perf_counter()
        view = TruthView(shot.truth.p_camera, shot.truth.hidden) if s.detector.needs_truth else None
        self.seeing, detection = self.detector.detect(self.seeing, shot.frame, view, s.camera, s.target, self.rng)
        last, twist = self.before or shot, shot.ordered
        if self.observer.uses_motion(detection):
            twist = s.robot.measured_twist(last.encoders, shot.encoders, shot.t - last.t, shot.ordered, self._mount_at(shot.encoders.q))
        compass = shot.encoders.instruments.get("compass")
        heading = None if compass is None else float(compass[0])
        self.observing, seen = self.observer.observe(self.observing, shot.t, detection, twist, self.rng, heading)
        if "motion" in s.law.inputs:
            seen = replace(seen, motion=self._own_motion(last, shot, now, way))
        seen = seen.only(self.goal.counted)
        detected = time.perf_counter()
        self.control, command = self.law.step(self.control, seen, self.goal, self.basis)
        encoders = self.plant.encoders()
        mount, twist = self._mount_at(encoders.q), command.twist
        if command.free is not None and isinstance(s.robot, Redundant):
            twist = twist + s.robot.aside(command.free, encoders, mount)
        allocation = s.robot.allocate(twist, encoders, mount, s.camera.period)
        self.last_twist = allocation.twist
        self.plant.apply(allocation.setpoint)
        self.spent["detect"] += detected - began
        self.spent["law"] += time.perf_counter() - detected
        error = seen.uv - self.goal.uv
        if not (all_seen := all_finite(error)):
            error = error[seen.seen]
            all_seen = self.goal.counted is not None and bool(seen.seen[self.goal.counted].all())
        lost = bool(command.held) or not error.size  # a law may order motion although it sees nothing
        error_px = math.nan if lost else math.sqrt(float(np.vdot(error, error)) / error.size)
        image = shot.frame.image if shot.frame and shot.frame.whole else None
        slip, estimate = self._slip(last, shot, seen), (math.nan, math.nan)
        if s.stop.converged.by_estimate:
            estimate = estimated(seen, self.goal)
        tick = Tick(
            self.count, lost, all_seen, error_px, seen, command, allocation, shot.truth, image, self.goal, self.view, slip, estimate
        )
        self.count += 1
        self.before, self.seen_before = shot, seen
        self._pass_view(tick)
        return tick

    def _slip(self, last: Shot, shot: Shot, seen: Observation) -> float:
        """For the log: what the encoders did not notice [m/s]."""
        if seen.odometry is None or self.seen_before is None or self.seen_before.odometry is None:
            return 0.0
        back = self.mount.T_flange_camera
        T_before, T_now = (s.truth.T_world_camera @ inverse(back) for s in (last, shot))
        return slipped(T_before, T_now, self.seen_before.odometry, seen.odometry, shot.t - last.t)

    def _pass_view(self, tick: Tick) -> None:
        """Via points: on to the next view when this one is near enough."""
        goal = self.scenario.goal
        if isinstance(goal, GoalViews) and tick.error_px < goal.threshold_px and self.view + 1 < len(goal.views):
            self.view += 1
            self.goal = self.scenario.goal_views[self.view]
            self.control = self.law.init(self.goal)


def _evidence(scenario: Scenario, tick: Tick) -> Evidence:
    """What the judge may look at: the truth, beside what was seen and ordered."""
    T = tick.truth.T_world_target
    T_base = tick.truth.T_world_camera @ inverse(scenario.camera.mount.T)
    away = (tick.truth.T_world_camera[:3, 3] - T[:3, 3]).tolist()
    return Evidence(
        t=tick.observation.t,
        lost=tick.lost,
        held=tick.command.held,
        all_seen=tick.all_seen,
        error_px=tick.error_px,
        command_size=max(map(abs, tick.command.twist.tolist())),
        scale=tick.allocation.scale,
        limit=tick.allocation.limit,
        distance=math.hypot(*away),
        behind=isinstance(scenario.target, Square) and sum(map(mul, away, T[:3, 2].tolist())) >= 0,
        contact=tick.truth.contact,
        last_view=tick.view + 1 == len(scenario.goal_views),
        position_m=tick.estimate[0],
        rotation_rad=tick.estimate[1],
        off_m=off(scenario, T_base, T),
    )


def _until_the_end(scenario: Scenario, plant: Plant, note: Callable[[Tick], None], spent: dict[str, float]) -> tuple[Outcome, str]:
    """Capture every `steps_per_frame` steps, deliver after the camera's latency, stop when the judge says so."""
    servo, judge = _Servo(scenario, plant, spent), Judge(scenario.stop, band_of(scenario))
    line: DelayLine[Shot] = DelayLine(round(scenario.camera.latency_s / plant.step_s))
    step, next_capture = 0, 0
    twist, moved, way = np.zeros(6), np.zeros(6), np.zeros(6)
    while True:
        if step == next_capture:
            # with pictures still on their way, nobody knows yet where to look
            frame, truth = plant.capture(servo.look() if line.next_due() is None else None)
            if frame is not None and line.delay_steps > 0:
                frame = frame.copy()  # it will wait while the next ones are taken
            line.push(step, Shot(frame, step * plant.step_s, truth, plant.encoders(), moved / plant.steps_per_frame, way))
            moved = np.zeros(6)
            next_capture += plant.steps_per_frame
        for shot in line.pop_due(step):
            tick = servo.arrive(shot, step * plant.step_s, way)
            twist = tick.allocation.twist
            note(tick)
            if verdict := judge.verdict(_evidence(scenario, tick)):
                return verdict
        due = line.next_due()
        ahead = next_capture - step if due is None else min(next_capture, due) - step
        start = time.perf_counter()
        if not plant.advance(ahead):
            return Outcome.crashed, f"{Outcome.crashed.value} at {step * plant.step_s:.3f} s"
        spent["physics"] += time.perf_counter() - start
        step += ahead
        moved += twist * ahead
        way = way + twist * (ahead * plant.step_s)


def run(scenario: Scenario, watch: Iterable[Watcher] = ()) -> Recording:
    """Simulate a scenario from its nominal start until an outcome.

    Args:
        scenario: the experiment (`Scenario.randomised` draws another start).
        watch: told of every frame. A KeyboardInterrupt ends the run with the outcome `interrupted`.

    Raises:
        ParameterError: it is no Scenario.
        EnvironmentLackError: a picture is needed that only OpenGL can draw, and it does not work here.
    """
    if not isinstance(scenario, Scenario):
        raise ParameterError("scenario", "must be a Scenario: vstestbed.run(vstestbed.load('arm_ibvs'))", scenario)
    began = time.perf_counter()
    layout = Layout(scenario)
    log, watchers = Log(layout), tuple(watch)
    spent: dict[str, float] = dict.fromkeys(PARTS, 0.0)
    plant, renderer = build_plant(
        scenario.robot,
        scenario.camera,
        scenario.target,
        scenario.world,
        scenario.physics,
        needs_image=scenario.detector.needs_image,
        needs_truth=scenario.detector.needs_truth,
        image_sigma=scenario.noise.image_sigma,
        rng=scenario.rng(IMAGE_STREAM),
        sensor_rng=scenario.rng(SENSOR_STREAM),
        motion_rng=scenario.rng(MOTION_STREAM),
        drift=scenario.noise.drift,
    )

    def note(tick: Tick) -> None:
        start = time.perf_counter()
        log.append(tick)
        spent["record"] += time.perf_counter() - start
        for watcher in watchers:
            watcher.tick(tick)

    ready = time.perf_counter()
    try:
        outcome, reason = _until_the_end(scenario, plant, note, spent)
    except KeyboardInterrupt:
        outcome, reason = Outcome.interrupted, Outcome.interrupted.value
    finally:
        spent["render"] = plant.render_s
        loop_s = time.perf_counter() - ready
        plant.close()
    made_by = versions() | {"renderer": renderer}
    time_ms = {k: 1e3 * v for k, v in spent.items()}
    return Recording(scenario, outcome, reason, layout.columns, log.table(), time.perf_counter() - began, loop_s, time_ms, made_by)
