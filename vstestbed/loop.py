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
from vstestbed.course import course_of
from vstestbed.errors import ParameterError
from vstestbed.flight_log import flight_row, level_error
from vstestbed.geometry import Array, all_finite, inverse
from vstestbed.goal import GoalLanding
from vstestbed.laws import Law
from vstestbed.observation import Encoders, Observation
from vstestbed.pilot import Pilot, pilot_of
from vstestbed.provenance import versions
from vstestbed.recording import Layout, Log, Recording, Tick, Watcher
from vstestbed.robots import Allocation, Mount
from vstestbed.scenario import IMAGE_STREAM, NOISE_STREAM, SENSOR_STREAM, TIMING_STREAM, Scenario
from vstestbed.sim.base import Plant, Truth
from vstestbed.sim.build import build_plant
from vstestbed.sim.timing import DelayLine, Planned, Shutter
from vstestbed.stop import Evidence, Judge, Outcome
from vstestbed.target import Square
from vstestbed.task import band_of, estimated, off, slipped
from vstestbed.touchdown import Touchdown
from vstestbed.vision import Detector, Observer, TruthView

PARTS = ("physics", "render", "detect", "law", "record", "video")
"""Where a run's wall time goes."""


@dataclass(frozen=True, slots=True)
class Shot:
    """A picture on its way to the law, with what the robot measured at its exposure and the mean twist ordered since the last."""

    number: int
    frame: Frame | None
    t: float
    truth: Truth
    encoders: Encoders
    ordered: Array


def _observer(scenario: Scenario) -> Observer:
    return Observer(
        camera=scenario.believed_camera,
        target=scenario.target,
        goal=scenario.goal_view,
        depth=scenario.law.depth,
        pixel_sigma_px=scenario.noise.pixel_sigma_px,
        wanted=scenario.law.inputs,
        grounded=scenario.robot.grounded,
        derotation=scenario.derotation,
        trim_s=scenario.level_trim_s,
        depth_scale=scenario.depth_scale,
    )


class _Servo:
    """Eye to hand: what happens when a picture arrives. Holds the memories that detector, observer and law pass on."""

    def __init__(self, scenario: Scenario, plant: Plant, spent: dict[str, float]):
        self.scenario, self.plant, self.spent = scenario, plant, spent
        self.course, self.pilot = course_of(scenario), pilot_of(scenario)
        self.mount = Mount.of(scenario.believed_camera.mount.T)
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

    def arrive(self, shot: Shot, t_cmd: float) -> Tick:
        """Detect, observe, decide; what is decided here reaches the robot at t_cmd [s]."""
        s, began = self.scenario, time.perf_counter()
        view = TruthView(shot.truth.p_camera, shot.truth.hidden) if s.detector.needs_truth else None
        self.seeing, detection = self.detector.detect(self.seeing, shot.frame, view, self.seen_through, s.target, self.rng)
        last, twist = self.before or shot, shot.ordered
        if self.observer.uses_motion(detection):
            twist = s.robot.measured_twist(last.encoders, shot.encoders, shot.t - last.t, shot.ordered, self.mount)
        compass = shot.encoders.instruments.get("compass")
        heading = None if compass is None else float(compass[0])
        tilt = shot.encoders.instruments.get("tilt")
        self.observing, seen = self.observer.observe(self.observing, shot.t, detection, twist, self.rng, heading, tilt)
        goal = self.course.goal(seen)
        detected = time.perf_counter()
        self.control, command = self.law.step(self.control, seen, goal, self.basis)
        now = self.plant.encoders()
        allocation = s.robot.allocate(command.twist, now, self.mount, s.camera.period)
        if self.pilot:
            allocation = replace(allocation, setpoint=self.pilot.order(shot.t, command.held, now.instruments, allocation.setpoint))
        self.spent["detect"] += detected - began
        self.spent["law"] += time.perf_counter() - detected
        error = seen.uv - goal.uv
        if not (all_seen := all_finite(error)):
            error = error[seen.seen]
        lost = bool(command.held) or not error.size  # a law may order motion although it sees nothing
        error_px = math.nan if lost else math.sqrt(float(np.vdot(error, error)) / error.size)
        image = shot.frame.image if shot.frame and shot.frame.whole else None
        slip, estimate = self._slip(last, shot, seen), (math.nan, math.nan)
        if s.stop.converged.by_estimate:
            estimate = estimated(seen, goal)
        flight = flight_row(s, shot.encoders, shot.truth, seen, goal, self.pilot) if self.pilot else None
        at, n = self.course.view, shot.number
        tick = Tick(n, lost, all_seen, error_px, seen, command, allocation, shot.truth, image, goal, at, slip, estimate, flight, t_cmd)
        self.before, self.seen_before = shot, seen
        if self.course.passed(error_px):
            self.control = self.law.init(s.goal_views[self.course.view])
        return tick

    def _slip(self, last: Shot, shot: Shot, seen: Observation) -> float:
        """For the log: what the encoders did not notice [m/s]."""
        if seen.odometry is None or self.seen_before is None or self.seen_before.odometry is None:
            return 0.0
        back = self.scenario.camera.mount.T
        T_before, T_now = (s.truth.T_world_camera @ inverse(back) for s in (last, shot))
        return slipped(T_before, T_now, self.seen_before.odometry, seen.odometry, shot.t - last.t)


def _evidence(scenario: Scenario, tick: Tick, pilot: Pilot | None, touchdown: Touchdown | None) -> Evidence:
    """What the judge may look at: the truth, beside what was seen and ordered."""
    T, t = tick.truth.T_world_target, tick.observation.t
    T_base = tick.truth.T_world_camera @ inverse(scenario.camera.mount.T)
    feet = tick.truth.aloft is not None and tick.truth.aloft.feet
    if touchdown:
        touchdown.watch(t, T_base, T, feet)
    away = (tick.truth.T_world_camera[:3, 3] - T[:3, 3]).tolist()
    return Evidence(
        t=t,
        lost=tick.lost,
        held=tick.command.held,
        all_seen=tick.all_seen,
        error_px=tick.error_px if tick.flight is None else level_error(scenario, tick.observation, tick.goal),
        command_size=max(map(abs, tick.command.twist.tolist())),
        scale=tick.allocation.scale,
        limit=tick.allocation.limit,
        distance=math.hypot(*away),
        behind=isinstance(scenario.target, Square) and sum(map(mul, away, T[:3, 2].tolist())) >= 0,
        contact=tick.truth.contact or (feet and pilot is not None and not pilot.may_touch),
        last_view=tick.view + 1 == len(scenario.goal_views) and touchdown is None,
        position_m=tick.estimate[0],
        rotation_rad=tick.estimate[1],
        off_m=off(scenario, T_base, T),
        aborted=pilot.aborted if pilot else None,
        down=pilot is not None and pilot.down(t),
        touchdown=touchdown.verdict if touchdown else None,
        flies=pilot is not None,
    )


class _Eye:
    """The camera on the clock: takes the pictures that its shutter plans, and sends them on their way."""

    def __init__(self, scenario: Scenario, plant: Plant):
        self.plant = plant
        rng = scenario.rng(TIMING_STREAM)
        self.shutter = Shutter(scenario.timing, scenario.camera, plant.step_s, plant.steps_per_frame, rng)
        self.line: DelayLine[Shot] = DelayLine()
        self.moved, self.since = np.zeros(6), 0
        self._plan()

    def _plan(self) -> None:
        self.planned: Planned = self.shutter.following()
        self.opening, self.middle = 0, None

    def next_event(self) -> int:
        """The step at which the shutter opens next, or a picture arrives."""
        opens, due = self.planned.opens[self.opening], self.line.next_due()
        return opens if due is None else min(opens, due)

    def act(self, step: int, servo: _Servo) -> None:
        """Open the shutter where that is due; a picture that is whole is sent."""
        while (planned := self.planned).opens[self.opening] == step:
            # with pictures still on their way, nobody knows yet where to look
            look = servo.look() if self.line.next_due() is None else None
            if len(planned.opens) == 1:
                frame, truth = self.plant.capture(look)
                if frame is not None and planned.arrives > step:
                    frame = frame.copy()  # it will wait while the next ones are taken
                self._send(planned, frame, self._shot(step, truth))
            else:
                self._expose(planned, step, look)

    def _expose(self, planned: Planned, step: int, look: Look | None) -> None:
        if step >= planned.middle and self.middle is None:
            self.middle = self._shot(step, self.plant.truth())
        self.plant.expose(planned.weights[self.opening], look)
        self.opening += 1
        if self.opening == len(planned.opens) and self.middle is not None:
            self._send(planned, self.plant.developed(self.middle.t), self.middle)

    def _shot(self, step: int, truth: Truth) -> Shot:
        """What is true and measured at an exposure, still without its picture."""
        ordered = self.moved / max(1, step - self.since)
        self.moved, self.since = np.zeros(6), step
        return Shot(self.planned.frame, None, step * self.plant.step_s, truth, self.plant.encoders(), ordered)

    def _send(self, planned: Planned, frame: Frame | None, shot: Shot) -> None:
        self.line.push(planned.arrives, replace(shot, frame=frame))
        self._plan()


def _until_the_end(scenario: Scenario, plant: Plant, note: Callable[[Tick], None], spent: dict[str, float]) -> tuple[Outcome, str]:
    """Take pictures, deliver them and the commands made of them, each when it is due; stop when the judge says so."""
    servo, eye, judge = _Servo(scenario, plant, spent), _Eye(scenario, plant), Judge(scenario.stop, band_of(scenario))
    orders: DelayLine[Allocation] = DelayLine(round(scenario.timing.command_latency_s / plant.step_s))
    touchdown = Touchdown(scenario.goal) if isinstance(scenario.goal, GoalLanding) else None
    step, twist = 0, np.zeros(6)
    while True:
        eye.act(step, servo)
        for shot in eye.line.pop_due(step):
            tick = servo.arrive(shot, (step + orders.delay_steps) * plant.step_s)
            orders.push(step, tick.allocation)
            note(tick)
            if verdict := judge.verdict(_evidence(scenario, tick, servo.pilot, touchdown)):
                return verdict
        for allocation in orders.pop_due(step):
            plant.apply(allocation.setpoint)
            twist = allocation.twist
        due = orders.next_due()
        ahead = (eye.next_event() if due is None else min(eye.next_event(), due)) - step
        start = time.perf_counter()
        if not plant.advance(ahead):
            return Outcome.crashed, f"{Outcome.crashed.value} at {step * plant.step_s:.3f} s"
        spent["physics"] += time.perf_counter() - start
        step += ahead
        eye.moved += twist * ahead


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
