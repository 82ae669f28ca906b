"""What a batch of ideal closed loops needs: the scenario made ideal, and what all its runs share."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, inverse
from vstestbed.experiments.basin.one_by_one import OneByOne
from vstestbed.features.depth import Estimate, PnP
from vstestbed.features.observation import Goal
from vstestbed.laws.base import TwistLimits
from vstestbed.laws.views import BatchLaw, has_batch
from vstestbed.loop.recording import BLOCK
from vstestbed.robots import Free, Mount
from vstestbed.robots.free import FreeStart
from vstestbed.robots.robot_log import RobotLog
from vstestbed.scenario.noise import Noise
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.scene.world import World
from vstestbed.sim.timing import Timing
from vstestbed.vision import Oracle

if TYPE_CHECKING:
    from vstestbed.experiments.comparison.plan import Comparison

SLACK_S = 1e-9
"""The judge of one run allows this much when it compares times [s]."""

MOST_STARTS = 4_000_000
"""Starts that need no `--force`: one map of the largest `--n` (2000 x 2000), which takes some GB of memory."""


def ideal(scenario: Scenario, field_of_view: str | None = None) -> Scenario:
    """The same task with the ideal camera of a batch: oracle detector, no noise, no latency, no obstacles.

    The camera starts where the scenario's robot holds it. Gains, depth, goal, stop block and the camera's rate stay.

    Args:
        scenario: of a robot that moves its camera with six degrees of freedom.
        field_of_view: `limited` or `unlimited`; None: that of the scenario's oracle, else limited.

    Raises:
        ParameterError: the law works on whole pictures, the robot has fewer degrees of freedom, or the target moves.
    """
    if "image" in scenario.law.inputs:
        words = "works on whole pictures, and a batch draws none; sweep and compare --vary run it start by start"
        raise ParameterError("law.kind", f"{scenario.law.kind} {words}")
    robot, camera, detector = scenario.robot, scenario.camera, scenario.detector
    field_of_view = field_of_view or (detector.field_of_view if isinstance(detector, Oracle) else "limited")
    if scenario.target.moves:
        raise ParameterError("target.motion", "must be still in a batch", scenario.target.motion.kind)
    if (motions := robot.motion_basis(Mount.of(camera.mount.T), robot.start_joints()).shape[1]) != 6:
        words = f"moves its camera in {motions} directions, and the ideal camera of a batch in all six; use free or puma560"
        raise ParameterError("robot.kind", words, robot.kind)
    if detector.rows is not None and field_of_view == "limited" and not _shows_markers(scenario):
        words = (
            f"{detector.kind} finds points of its own in pictures, and a batch, which draws none, has the target's corners in their place:"
        )
        words = f"{words} the goal's view does not show them all; sweep and compare --vary run it start by start"
        raise ParameterError("detector.kind", words)
    start = FreeStart(nominal=Pose.of(robot.flange_pose(robot.configuration())))
    return replace(
        scenario,
        robot=robot if robot.model is None else Free(start=start),
        camera=replace(camera, latency_s=0.0, readout_s=0.0),
        timing=Timing(),
        detector=Oracle(field_of_view=field_of_view),  # pyright: ignore[reportArgumentType]
        noise=Noise(),
        world=World(),
    )


def _shows_markers(scenario: Scenario) -> bool:
    """Whether the goal's view has all points of the target within the picture."""
    camera, p = scenario.camera, scenario.target.points_at(scenario.goal_view.T_camera_target)
    return bool(camera.inside(camera.project(p)).all())


@dataclass(frozen=True)
class BatchSetup:
    """What all runs of a batch share: the scenario, checked, and values derived from it."""

    scenario: Scenario

    def __post_init__(self) -> None:
        """Refuse what a batch cannot simulate."""
        self._check_law()
        self._check_task()
        self._check_target()
        self._check_ideal()

    def _check_law(self) -> None:
        s = self.scenario
        foreign = sorted({"proprioception", "motion", "odometry", "place"} & set(s.law.inputs))
        if foreign:
            raise ParameterError("law.kind", f"{s.law.kind} reads {foreign[0]}, which the ideal cameras of a batch do not measure")
        if s.law.visibility.margin_px > 0:
            raise ParameterError("law.visibility.margin_px", "must be 0 in a batch", s.law.visibility.margin_px)
        if s.law.feedforward.kind != "none":
            raise ParameterError("law.feedforward", "must be none in a batch")
        if isinstance(s.law.depth, Estimate) or s.law.depth.measured:
            raise ParameterError("law.depth", f"may not be {s.law.depth.kind} in a batch; valid: pnp, constant, goal, oracle")

    def _check_task(self) -> None:
        s = self.scenario
        if s.randomise:
            raise ParameterError("randomise", "must be [] in a batch, whose runs share one scenario; compare --seeds draws it for each run")
        if len(s.goal_views) > 1 or s.target.moves or s.goal.continuing or s.goal.lands:
            raise ParameterError("goal", "must be one view of a target that stands still, in a batch")
        if s.stop.converged.error_px is None or s.stop.converged.by_estimate:
            raise ParameterError("stop.converged", "must be judged by error_px alone in a batch")

    def _check_target(self) -> None:
        s = self.scenario
        if s.target.body is not None and not s.target.outlined and isinstance(s.detector, Oracle) and s.detector.field_of_view == "limited":
            words = (
                "has a solid, and a batch does not know which markers it hides; give an unlimited field of view, or a target without one"
            )
            raise ParameterError("target", words)

    def _check_ideal(self) -> None:
        s = self.scenario
        disturbed = s.noise != Noise() or s.timing != Timing() or any((s.camera.latency_s, s.camera.readout_s))
        if not (s.calibration.camera_exact and s.calibration.depth_exact):
            raise ParameterError("calibration", "must be exact in a batch, whose poses and depths are true")
        if s.monitors:
            raise ParameterError("monitors", "must be none in a batch, which ends runs by the loop's own alone")
        if not (s.robot.model is None and isinstance(s.detector, Oracle)) or disturbed or s.world.hides:
            words = (
                "must have a free camera, detector oracle, no latency, no noise, no rolling shutter, and no plates or scenery for a batch;"
            )
            words = f"{words} `basin.setup.ideal` makes it so"
            raise ParameterError("scenario", words)

    @cached_property
    def law(self) -> BatchLaw | OneByOne:
        """The law, by its equations for many runs where it has such."""
        law = self.scenario.law
        return law if has_batch(law) else OneByOne(law, self.scenario.camera)

    @cached_property
    def complete(self) -> bool:
        """Whether a run in which the law sees all markers in all frames has the log that a single run would have, but for rounding.

        The law has equations for many runs and does not shorten its commands, all markers count, robot and task add no columns, and the
        log fits a block.
        """
        s = self.scenario
        plain = s.law.limits == TwistLimits() and s.goal_view.counted is None and s.own_columns == RobotLog.columns
        return plain and not s.law.modes and has_batch(s.law) and self.frames(s.stop.duration_s) < BLOCK

    @cached_property
    def error_px(self) -> float:
        """RMS error that counts as converged [px]."""
        return s if (s := self.scenario.stop.converged.error_px) is not None else math.nan

    @cached_property
    def needed(self) -> int:
        """Fewest visible markers with which the law gives a command."""
        return self.scenario.law.markers_needed(np.eye(6))

    @cached_property
    def posed(self) -> bool:
        """Whether the law uses a pose solved from the pixels, or depths from it."""
        law = self.scenario.law
        return isinstance(law.depth, PnP) and law.inputs != ("relative",)

    def frames(self, duration_s: float) -> int:
        """Number of frames after which a time [s] has passed, by the rule of the `Judge`; of inf more than any run has."""
        if math.isinf(duration_s):
            return sys.maxsize // 2
        return max(0, math.ceil((duration_s - SLACK_S) * self.scenario.camera.rate_hz - 1e-9))

    def goal(self, rows: NDArray[np.bool_] | slice) -> Goal:
        """The goal view with only some of the markers."""
        g = self.scenario.goal_view
        return replace(g, uv=g.uv[rows], depth=g.depth[rows], ray=g.ray[rows], range=g.range[rows])


def start_of(scenario: Scenario) -> Array:
    """The scenario's own start T_camera_target (4, 4)."""
    T_world_camera = scenario.robot.flange_pose(scenario.robot.configuration()) @ scenario.camera.mount.T
    return inverse(T_world_camera) @ scenario.target.pose.T


def started_at(scenario: Scenario, T_camera_target: Array) -> Scenario:
    """The scenario of an ideal camera, started at a pose T_camera_target (4, 4)."""
    T_world_flange = scenario.target.pose.T @ inverse(T_camera_target) @ inverse(scenario.camera.mount.T)
    return replace(scenario, robot=Free(start=FreeStart(nominal=Pose.of(T_world_flange))))


def must_be_few_starts(comparison: Comparison, n: int, force: bool = False) -> None:
    """Refuse maps of more than MOST_STARTS starts in all (each n x n), unless by force.

    Raises:
        ParameterError: with the product of which the starts come.
    """
    maps = len(comparison.base) * math.prod(map(len, (comparison.cases | comparison.axes).values()))
    if maps * n * n > MOST_STARTS and not force:
        words = f"would make {maps:,} maps of {n} x {n} starts; more than {MOST_STARTS:,} starts in all need --force"
        raise ParameterError("basin", words)
