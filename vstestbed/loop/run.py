"""run(scenario): the only time loop. It advances the clock from event to event: exposures, arriving pictures, arriving commands."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.core.provenance import versions
from vstestbed.laws.solve import load_lapack
from vstestbed.loop.columns import Layout
from vstestbed.loop.controller import Arrival, FrameController
from vstestbed.loop.judge import Judge
from vstestbed.loop.recording import Log, MemoryRows, Recording, Rows, Watcher
from vstestbed.loop.shutter import CameraClock
from vstestbed.robots import Allocation
from vstestbed.scenario.scenario import IMAGE_STREAM, MOTION_STREAM, SENSOR_STREAM, Scenario
from vstestbed.sim.base import Plant
from vstestbed.sim.build import build_plant
from vstestbed.sim.timing import DelayLine
from vstestbed.tasks.frame import Frame

PARTS = ("physics", "render", "detect", "law", "record", "video")
"""Parts of a run's wall time."""


def _until_the_end(scenario: Scenario, plant: Plant, note: Callable[[Frame], None], spent: dict[str, float]) -> tuple[Verdict, float]:
    """Take pictures, deliver them and their commands, each when it is due, until the judge's verdict; that, and its time [s]."""
    controller, camera = FrameController(scenario, plant, spent), CameraClock(scenario, plant)
    judge = Judge(controller.monitor, scenario.stop, scenario.target, controller.supervisor)
    commands: DelayLine[Allocation] = DelayLine(round(scenario.timing.command_latency_s / plant.step_s))
    step, twist = 0, np.zeros(6)
    order_steps = round(scenario.timing.order_s(scenario.camera) / plant.step_s)
    silent_at = order_steps + round(scenario.camera.latency_s / plant.step_s)
    while True:
        camera.act(step, controller.look)
        for shot in camera.line.pop_due(step):
            silent_at = step + order_steps
            arrival = Arrival(step * plant.step_s, (step + commands.delay_steps) * plant.step_s, camera.displacement)
            frame = controller.arrive(shot, arrival)
            commands.push(step, frame.allocation)
            note(frame)
            if verdict := judge.verdict(frame):
                return verdict, frame.t
        if step >= silent_at:  # a camera that is dead must not leave the robot without a supervisor, nor the run without an end
            plant.apply(controller.without_picture(step * plant.step_s))
            if verdict := judge.without_picture(step * plant.step_s, plant.truth()):
                return verdict, step * plant.step_s
            if controller.supervisor.aborted:  # orders still on their way must not set a robot that stops in motion again
                commands.clear()
            silent_at = step + plant.steps_per_frame
        # After the pictures: without latency, a command takes effect in the step in which its picture arrived.
        for allocation in commands.pop_due(step):
            plant.apply(allocation.setpoint)
            twist = allocation.twist
        # The physics runs to the next event in one call.
        due = commands.next_due()
        ahead = min(camera.next_event(), silent_at, silent_at if due is None else due) - step
        start = time.perf_counter()
        if not plant.advance(ahead):
            return (Outcome.crashed, f"{Outcome.crashed.value} at {step * plant.step_s:.3f} s"), step * plant.step_s
        spent["physics"] += time.perf_counter() - start
        step += ahead
        camera.displacement = camera.displacement + twist * (ahead * plant.step_s)


def run(scenario: Scenario, watch: Iterable[Watcher] = (), rows: Rows | None = None) -> Recording:
    """Simulate a scenario from its nominal start until an outcome.

    Args:
        scenario: the experiment (`Scenario.randomised` draws another start).
        watch: receive every frame. A KeyboardInterrupt ends the run with the outcome `interrupted`.
        rows: where the rows of the log go; into memory by default.

    Raises:
        ParameterError: `scenario` is not a Scenario.
        EnvironmentLackError: a picture is needed that only OpenGL can draw, and it does not work here.
    """
    if not isinstance(scenario, Scenario):
        raise ParameterError("scenario", "must be a Scenario: vstestbed.run(vstestbed.load('arm_ibvs'))", scenario)
    began = time.perf_counter()
    layout = Layout(scenario)
    rows = MemoryRows(layout.columns) if rows is None else rows
    log, watchers = Log(layout, rows), tuple(watch)
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
        order_s=scenario.timing.order_s(scenario.camera),
    )

    def note(frame: Frame) -> None:
        start = time.perf_counter()
        log.append(frame)
        spent["record"] += time.perf_counter() - start
        for watcher in watchers:
            watcher.frame(frame)

    if hasattr(scenario.law, "solve"):
        load_lapack()
    ready = time.perf_counter()
    try:
        (outcome, reason), ended_s = _until_the_end(scenario, plant, note, spent)
    except KeyboardInterrupt:
        outcome, reason, ended_s = Outcome.interrupted, Outcome.interrupted.value, 0.0
    finally:
        # Also when a watcher raises: the plant holds an OpenGL context, which the next run needs.
        spent["render"] = plant.render_s
        try:
            log.flush()
        finally:
            loop_s = time.perf_counter() - ready
            plant.close()
    took_s, made_by = time.perf_counter() - began, versions() | {"renderer": renderer}
    return Recording(scenario, outcome, reason, rows, took_s, loop_s, {k: 1e3 * v for k, v in spent.items()}, made_by, ended_s)
