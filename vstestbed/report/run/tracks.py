"""Data of the figures of a run: the log as arrays, and the parts of the scenario that the log does
not hold.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray

from vstestbed.core.geometry import Array, inverse, rotation_from_quaternion, transform
from vstestbed.loop.log_file import Log

if TYPE_CHECKING:
    from vstestbed.camera import Camera
    from vstestbed.features import Feature
    from vstestbed.scenario.scenario import Scenario

# Polar grid around the camera's foot point on which the visible region of a plane is sampled
RINGS, DIRECTIONS = 120, 541


def ideal_bicycle_path(scenario: Scenario) -> Array | None:
    """Path (K, 2) [m] of the pose controller with an ideal bicycle: true pose, no actuator
    dynamics, the car's steering limit.

    It ends at its point nearest to the goal. None for other laws and vehicles.
    """
    from vstestbed.laws import PoseController
    from vstestbed.robots.car import BicycleLimits, Car, drive

    law = scenario.law
    robot = scenario.robot
    goal = scenario.goal_view.place
    # the ideal bicycle is the ideal car: no other robot has its wheelbase and steering
    if not (isinstance(law, PoseController) and isinstance(robot, Car)) or goal is None:
        return None
    state = law.init(scenario.goal_view)

    def command(place: Array) -> tuple[Array, Array]:
        nonlocal state
        state, v, w = law.toward(state, place, goal)
        return np.array(v), np.array(w)

    way = drive(
        command,
        robot.configuration(),
        robot.parameters.wheelbase_m,
        BicycleLimits(robot.limits.speed_mps, robot.limits.steering_rad),
        scenario.stop.duration_s,
        scenario.camera.period,
    ).place[:, :2]
    return way[: int(np.argmin(np.linalg.norm(way - goal[:2], axis=1))) + 1]


def largest_deviation(path: Array, reference: Array) -> float:
    """Largest distance [m] of the points (T, 2) of a path from a polyline (K, 2)."""
    a = reference[:-1]
    d = np.diff(reference, axis=0)
    to = path[:, None] - a
    # foot point on each segment, as a share of its length; 1e-12 m^2: repeated points
    share = np.clip((to * d).sum(axis=-1) / np.maximum((d * d).sum(axis=-1), 1e-12), 0, 1)
    return float(np.linalg.norm(to - share[..., None] * d, axis=-1).min(axis=1).max())


def visible_region(
    camera: Camera, T_world_camera: Array, height: float, reach: float
) -> tuple[Array, Array, Array]:
    """The part of the horizontal plane at this height [m] that is in the image, within `reach` [m]
    of the camera's foot point.

    Gives x, y [m] of a grid's points and 1 where a point is in the image, else 0; shape (RINGS,
    DIRECTIONS) each.
    """
    r = np.linspace(1e-3, reach, RINGS)[:, None]
    a = np.linspace(0, 2 * np.pi, DIRECTIONS)
    foot = T_world_camera[:3, 3]
    across = r * np.cos(a)
    along = r * np.sin(a)
    step = np.stack([across, along, np.full_like(across, height - foot[2])], axis=-1).reshape(-1, 3)
    # not `@`: over so many rows BLAS starts threads, which wait for each other longer than the
    # product takes
    uv = camera.project(np.einsum("ni,ij->nj", step, T_world_camera[:3, :3]))
    # a camera with several panels has no image border, only directions that it cannot project
    seen = camera.inside(uv) if len(camera.panels) == 1 else np.isfinite(uv[:, 0])
    return foot[0] + across, foot[1] + along, seen.reshape(across.shape).astype(float)


# Longer logs are thinned for drawing: a figure is about 700 px wide, and a page should open at once
MOST_ROWS = 4000


class MeasuredError(NamedTuple):
    """An error in the image that a log may have."""

    column: str = "error_px"  # of the log
    label: str = "RMS error [px]"  # of its axis, with the unit
    unit: str = "px"  # as a threshold has it
    # under it the goal is reached; None where it decides nothing, or is unknown
    threshold: float | None = None


@dataclass(frozen=True)
class Setting:
    """Parts of the scenario that the figures use; each is None where it is unknown or does not
    apply.
    """

    width: int | None = None  # width, height: image size of the servo camera [px]
    height: int | None = None
    threshold_px: float | None = None  # RMS error that counts as converged [px]
    points: Array | None = None  # marker centres in the target frame, shape (N, 3) [m]
    T_camera_target: Array | None = None  # the goal view, shape (4, 4)
    description: str = ""  # the scenario's description
    feature: Feature | None = None  # the image feature of the law; None for a law without one
    camera: Camera | None = None  # the servo camera
    planar: bool = False  # the robot is a ground vehicle, which has the next three
    # poses (x, y, heading) in their order, shape (K, 3) [m, m, rad]
    goals: Array = field(default_factory=lambda: np.empty((0, 3)))
    # to be driven, by it or by what it follows, shape (M, 2) [m]
    reference_path: Array = field(default_factory=lambda: np.empty((0, 2)))
    # path of an ideal vehicle from the same start, shape (K, 2) [m]
    expected_path: Array | None = None
    # band_m, settle_s: of a continuing task: error tolerance [m] after this time [s]
    band_m: float | None = None
    settle_s: float = 0.0
    names: tuple[str, ...] = ()  # of the markers; () where they have none
    # the fields in which the scenario differs from the bundled one of its name, `("law.gain=2",)`
    changed: tuple[str, ...] = ()
    outlined: bool = False  # the markers are the outline of one region
    # words for what the law does in a frame; () for a law without modes
    modes: tuple[str, ...] = ()
    changing: bool = False  # whether a row of the log may come to show another point
    # RMS difference of picture and goal picture that counts as converged [grey levels]
    threshold_grey: float | None = None
    own: tuple[str, ...] = ()  # columns of the law's own, and of the effects'
    slides: tuple[str, ...] = ()  # joints whose positions are in metres
    # whether the joints' inputs are speeds: of inner loops they are torques
    told_speeds: bool = True
    # further cameras' width and height [px]
    cameras: Mapping[str, tuple[int, int]] = field(default_factory=dict[str, tuple[int, int]])

    @property
    def image_errors(self) -> tuple[MeasuredError, ...]:
        """Of markers, and of whole pictures; first the one that decides, that of markers where
        neither does.
        """
        grey = MeasuredError(
            "error_grey", "RMS difference [grey levels]", "grey levels", self.threshold_grey
        )
        markers = MeasuredError(threshold=self.threshold_px)
        grey_decides = self.threshold_px is None and self.threshold_grey is not None
        return (grey, markers) if grey_decides else (markers, grey)

    @classmethod
    def of(cls, scenario: Scenario) -> Setting:
        """The setting of a loaded scenario; goal view and thresholds are None for tasks that have
        none.
        """
        from vstestbed.report.recorded_run import unit_of_joint
        from vstestbed.scenario.dump import changes  # here: the figures themselves need no scenario

        goal = scenario.goal
        law = scenario.law
        view = getattr(goal, "T_camera_target", None)
        joints = [name for name in scenario.robot.joints if unit_of_joint(name, scenario) == "m"]
        effects = chain.from_iterable(effect.columns for effect in scenario.robot.acting)
        found = cls(
            told_speeds=scenario.robot.onboard is None,
            slides=tuple(joints),
            cameras={
                name: (eye.camera.width, eye.camera.height) for name, eye in scenario.eyes.items()
            },
            width=scenario.camera.width,
            height=scenario.camera.height,
            points=scenario.target.places if len(scenario.target.places) else None,
            names=scenario.target.names,
            T_camera_target=getattr(view, "T", view),
            description=scenario.description,
            feature=law.feature,
            camera=scenario.camera,
            band_m=goal.tolerance_m,
            settle_s=goal.settle_s,
            changed=changes(scenario),
            outlined=scenario.target.outlined,
            modes=law.modes,
            changing=scenario.detector.changing,
            own=(*law.columns, *effects),
        )
        if not goal.continuing:
            limits = scenario.stop.converged
            found = replace(found, threshold_px=limits.error_px, threshold_grey=limits.error_grey)
        if scenario.robot.base != "planar":
            return found
        goals = [view.place for view in scenario.goal_views if view.place is not None]
        return replace(
            found,
            planar=True,
            goals=np.array(goals).reshape(-1, 3),
            reference_path=scenario.target.floor_path[::5],
            expected_path=ideal_bicycle_path(scenario),
        )


def _shown_rows(table: Array) -> NDArray[np.intp]:
    """Which rows of a log (T, k) stand for all: see `LogArrays.of`."""
    rows = np.arange(len(table))
    chosen = [np.linspace(0, rows[-1], MOST_ROWS // 2).astype(int)]
    for part in np.array_split(rows, max(1, MOST_ROWS // (4 * table.shape[1]))):
        values = table[part]
        known = np.isfinite(values)  # an infinity cannot be drawn
        least = np.where(known, values, np.inf).argmin(axis=0)
        largest = np.where(known, values, -np.inf).argmax(axis=0)
        has_values = known.any(axis=0)
        chosen += [part[least[has_values]], part[largest[has_values]]]
    return np.unique(np.concatenate(chosen))


@dataclass(frozen=True)
class LogArrays:
    """A log (one row per frame) as arrays over time; a column that is absent reads as NaN."""

    log: pl.DataFrame
    setting: Setting

    @classmethod
    def of(cls, log: Log | pl.DataFrame, setting: Setting) -> LogArrays:
        """The tracks of a log, thinned to some MOST_ROWS rows: every n-th, the first and the last,
        and those with an extreme of a column.

        In each of the intervals, as many as half the rows allow, each column keeps its least and
        its largest value, and so its peaks.
        """
        if isinstance(log, pl.DataFrame):
            return cls(log, setting)
        table = log.table
        if len(table) > MOST_ROWS:
            table = table[_shown_rows(table)]
        return cls(pl.DataFrame(Log(log.columns, table).by_name()), setting)

    def column(self, name: str) -> Array:
        """One column as floats, shape (T,)."""
        # columns differ between robots and laws, and older logs lack some
        if name not in self.log.columns:
            return np.full(len(self.log), np.nan)
        return self.log[name].cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy()

    def columns(self, *names: str) -> Array:
        """Several columns side by side, shape (T, len(names))."""
        return np.stack([self.column(n) for n in names], axis=-1)

    def numbered(self, stem: str) -> Array:
        """The columns `stem_0 .. stem_{N-1}`, one per marker, shape (T, N)."""
        names = [f"{stem}_{i}" for i in range(self.markers)]
        return self.columns(*names) if names else np.empty((len(self.log), 0))

    def pixels(self, suffix: str = "", before: str = "") -> Array:
        """Marker pixels (T, N, 2) [px]: measured, or with the suffix `_true` or `_goal`; of a
        further camera with its name and _ before.
        """
        return np.stack([self.numbered(f"{before}{axis}{suffix}") for axis in "uv"], axis=-1)

    def named(self, stem: str) -> list[str]:
        """Names after `stem_` in the column names, in the log's order: names of joints or
        actuators.
        """
        return [c[len(stem) + 1 :] for c in self.log.columns if c.startswith(f"{stem}_")]

    def poses(self, stem: str) -> Array:
        """Poses T_world_cam or T_world_tgt (stem `cam` or `tgt`), shape (T, 4, 4); NaN where the
        log has none.
        """
        T = np.full((len(self.log), 4, 4), np.nan)
        T[:, :3, :3] = rotation_from_quaternion(self.columns(*(f"{stem}_q{a}" for a in "wxyz")))
        T[:, :3, 3] = self.columns(*(f"{stem}_{a}" for a in "xyz"))
        T[:, 3] = 0.0, 0.0, 0.0, 1.0
        return T

    def planar_poses(self, stem: str) -> Array:
        """Planar poses (x, y, heading) of a vehicle: `base` (true), `est` (estimate) or `odo`
        (odometry), shape (T, 3) [m, m, rad].
        """
        return self.columns(*(f"{stem}_{name}" for name in ("x", "y", "heading")))

    @cached_property
    def markers(self) -> int:
        """Number of markers in the log."""
        return sum(re.fullmatch(r"u_\d+", c) is not None for c in self.log.columns)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the markers; () where they have none, or the log is of another target."""
        return self.setting.names if len(self.setting.names) == self.markers else ()

    @cached_property
    def t(self) -> Array:
        """Time [s], shape (T,)."""
        return self.column("t")

    @cached_property
    def lost(self) -> NDArray[np.bool_]:
        """Whether the target was lost, shape (T,)."""
        return self.column("lost") == 1.0

    @cached_property
    def true_depth(self) -> Array | None:
        """Depth of the markers computed from the true poses, shape (T, N) [m]; None where the
        marker points are unknown.
        """
        points = self.setting.points
        if points is None or len(points) != self.markers:  # a log of another target
            return None
        T_camera_target = inverse(self.poses("cam")) @ self.poses("tgt")
        return transform(T_camera_target, points)[..., 2]

    def lost_intervals(self) -> list[tuple[float, float]]:
        """Start and end times of the intervals without target [s]; an interval lasts until the
        first frame with target.
        """
        edges = np.flatnonzero(np.diff(self.lost, prepend=False, append=False))
        last = len(self.t) - 1
        return [(float(self.t[a]), float(self.t[min(b, last)])) for a, b in edges.reshape(-1, 2)]
