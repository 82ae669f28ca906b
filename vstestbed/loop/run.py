"""run(scenario): the only time loop. It keeps the clock, the delay of pictures, the order of a frame's parts, the end."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from operator import mul

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import inverse
from vstestbed.core.provenance import versions
from vstestbed.loop.controller import Now, Servo
from vstestbed.loop.failsafe import Pilot
from vstestbed.loop.flight_columns import level_error
from vstestbed.loop.recording import Layout, Log, Recording, Tick, Watcher
from vstestbed.loop.shutter import Eye
from vstestbed.loop.task_error import Ways, band_of, off
from vstestbed.loop.touchdown import Touchdown
from vstestbed.robots import Allocation
from vstestbed.scenario.goal import GoalLanding
from vstestbed.scenario.scenario import IMAGE_STREAM, MOTION_STREAM, SENSOR_STREAM, Scenario
from vstestbed.scenario.stop import Evidence, Judge, Outcome
from vstestbed.sim.base import Plant
from vstestbed.sim.build import build_plant
from vstestbed.sim.timing import DelayLine
from vstestbed.targets.points import Square

PARTS = ("physics", "render", "detect", "law", "record", "video")
"""Where a run's wall time goes."""


def _evidence(scenario: Scenario, tick: Tick, pilot: Pilot | None, touchdown: Touchdown | None, ways: Ways) -> Evidence:
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
        held=tick.command.rest_reason,
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
        off_m=off(scenario, T_base, T, t),
        ways=ways.after(T_base, T),
        aborted=pilot.aborted if pilot else None,
        down=pilot is not None and pilot.down(t),
        touchdown=touchdown.verdict if touchdown else None,
        flies=pilot is not None,
    )


def _until_the_end(scenario: Scenario, plant: Plant, note: Callable[[Tick], None], spent: dict[str, float]) -> tuple[Outcome, str]:
    """Take pictures, deliver them and the commands made of them, each when it is due; stop when the judge says so."""
    servo, eye, judge = Servo(scenario, plant, spent), Eye(scenario, plant), Judge(scenario.stop, band_of(scenario))
    orders: DelayLine[Allocation] = DelayLine(round(scenario.timing.command_latency_s / plant.step_s))
    touchdown = Touchdown(scenario.goal) if isinstance(scenario.goal, GoalLanding) else None
    step, twist, ways = 0, np.zeros(6), Ways(scenario)
    while True:
        eye.act(step, servo.look)
        for shot in eye.line.pop_due(step):
            tick = servo.arrive(shot, Now(step * plant.step_s, (step + orders.delay_steps) * plant.step_s, eye.way))
            orders.push(step, tick.allocation)
            note(tick)
            if verdict := judge.verdict(_evidence(scenario, tick, servo.pilot, touchdown, ways)):
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
        eye.way = eye.way + twist * (ahead * plant.step_s)


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
