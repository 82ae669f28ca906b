"""Inputs of a law: the Observation of one frame, and the Goal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array, transform, unit_of
from vstestbed.robots.own_model import OwnModel

# fields with a row for each marker, of an observation and of a goal view
COLUMNS = ("uv", "depth", "ray", "range")


@dataclass(frozen=True, slots=True)
class Sight:
    """An RGB-D image: RGB (H, W, 3) uint8; depth (H, W) [m] along the optical axis, NaN where none
    was measured, or None.
    """

    image: NDArray[np.uint8]
    depth: NDArray[np.float32] | None = None


Relative = tuple[Array, Array]
"""This view against the goal's, from the image of one plane: the homography H (3, 3) with Z/Z* m =
H m*, and R_camera_goal (3, 3).
"""


@dataclass(frozen=True, slots=True)
class EgoMotion:
    """The camera's own motion, as measured by the robot (joints) and as commanded.

    Attributes:
        twist: mean twist (6,) since the last picture.
        since_s: for how long that was [s]; 0 at the first.
        moved: displacement (6,) from the exposure until now [m, rad].
        age_s: how long ago the exposure was [s].
        commanded: the last commanded twist (6,).
    """

    twist: Array
    since_s: float
    moved: Array
    age_s: float
    commanded: Array


@dataclass(frozen=True, slots=True)
class Observation:
    """What the camera and the robot's own sensors tell at one frame; nothing of the simulator's
    truth.

    Attributes:
        t: time of exposure [s].
        uv: measured marker pixels (N, 2), NaN where a marker is not seen.
        xy: the same, normalised and undistorted (N, 2); NaN also where a wide lens sees a marker
            beside or behind it.
        depth: Z of each marker as the scenario says it is found (N,) [m], NaN where unknown.
        T_camera_target: estimated pose (4, 4), or None where it is not estimated.
        odometry: a ground vehicle's dead reckoning by its encoders alone, (x, y, heading) [m, rad]
            from its start.
        place: a ground vehicle's (x, y, heading) [m, rad] in the world, from its landmarks, compass
            and encoders; None where it is not known yet, or the target is no landmark.
        ids: number of the point in each row (N,), the same as long as the row shows the same point,
            -1 in an empty row; None: row i is always marker i.

    Only for laws that ask for it:
        ray, range: unit rays (N, 3) to the markers and distances (N,) [m] along them.
        relative: this view against the goal's.
        motion: the camera's own motion.
        image: the whole picture.
        radius_px: apparent radius of each marker (N,) [px], from the target's model and its depth.
        proprioception: what the robot's own sensors tell of its state (k,) at the exposure
            (`Robot.proprioception`).
        robot: its own velocities, their limits and the camera twist that they make, when the
            picture has arrived.
        cameras: what the further cameras tell, by name, as far as they have taken a picture.
        wrench: force and moment (6,) on the tool by the wrist's sensor, at the camera's origin in
            its frame [N, Nm]; None without a sensor.

    Where the scenario derotates, xy, depth, T_camera_target, ray, relative and motion are those of
    the level camera, which shares the craft's place and heading; uv is what the picture shows.
    """

    t: float
    uv: Array
    xy: Array
    depth: Array
    T_camera_target: Array | None = None
    ray: Array | None = None
    range: Array | None = None
    relative: Relative | None = None
    odometry: Array | None = None
    place: Array | None = None
    motion: EgoMotion | None = None
    radius_px: Array | None = None
    proprioception: Array | None = None
    robot: OwnModel | None = None
    image: Sight | None = None
    ids: NDArray[np.intp] | None = None
    cameras: Mapping[str, CameraView] | None = None
    wrench: Array | None = None

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Which markers are seen, shape (N,)."""
        return np.isfinite(self.uv[:, 0])

    @property
    def xyw(self) -> Array:
        """Normalised coordinates and the inverse depth w = 1/Z [1/m] of each marker,
        shape (N, 3).
        """
        return np.column_stack([self.xy, 1 / self.depth])

    def same(self, before: Observation) -> NDArray[np.bool_]:
        """Which rows show the point that they showed in another observation, shape (N,)."""
        if self.ids is None or before.ids is None:
            return np.ones(len(self.uv), dtype=bool)
        return np.asarray((self.ids == before.ids) & (self.ids >= 0))

    def _columns(self, *more: str) -> dict[str, Array]:
        """Its fields with a row for each marker, as far as it has them."""
        columns = {name: getattr(self, name) for name in (*COLUMNS, "xy", "radius_px", *more)}
        return {name: a for name, a in columns.items() if a is not None}

    def of_rows(self, rows: NDArray[np.bool_] | slice) -> Observation:
        """The same of its markers `rows` (N,) alone."""
        return replace(self, **{name: a[rows] for name, a in self._columns("ids").items()})

    def only(self, counted: NDArray[np.bool_] | None) -> Observation:
        """The same without the markers that do not count, (N,) bool;
        all count where that is None.
        """
        if counted is None:
            return self
        return replace(self, **{name: _only(a, counted) for name, a in self._columns().items()})


def _only(a: Array, kept: NDArray[np.bool_]) -> Array:
    """An array of rows (N,) or (N, k) with NaN in those that are not kept (N,)."""
    return np.where(kept if a.ndim == 1 else kept[:, None], a, np.nan)


@dataclass(frozen=True, slots=True)
class CameraView:
    """The last observation of a further camera.

    Attributes:
        seen: the observation, in its own frame.
        goal: the goal as it sees it; None of one that does not move with the law's camera.
        T_camera_this: its pose (4, 4) in the frame of the law's camera, as the robot knows it at
            this frame.
        rigid: both move as one: its twist is Ad(inverse(T_camera_this)) v, with v the twist of the
            law's camera.
    """

    seen: Observation
    goal: Goal | None
    T_camera_this: Array
    rigid: bool


@dataclass(frozen=True)
class Goal:
    """The goal of a law: a view through a calibrated camera, and the other quantities of tasks that
    are not defined by a view.

    Attributes:
        uv: markers in the picture (N, 2) [px]; `xy` (N, 2) the same, normalised.
        depth, range, ray: of the markers (N,) [m], (N,) [m], (N, 3).
        T_camera_target: pose at the goal (4, 4).
        camera: the calibrated lens, with its mount `T_base_camera`.
        middle: mean of the markers in the camera's frame (3,) [m].
        normal: unit normal (3,) of the plane that fits the markers best, away from the camera.
        place: (x, y, heading) where a vehicle is to stand [m, m, rad].
        gap_m: distance to keep from the target [m].
        twist: of the camera of a view that moves (6,) [m/s, rad/s], in its own frame.
        counted: which markers count, (N,) bool; None: all.
        view: number of the view, among several in turn.
        moves: the view is on its way to that one, and reaching it ends nothing.
        image: the picture taken there, for laws and detectors that work with it.
    """

    uv: Array
    depth: Array
    ray: Array
    range: Array
    T_camera_target: Array
    camera: Camera
    middle: Array
    normal: Array
    place: Array | None = None
    gap_m: float | None = None
    twist: Array | None = None
    counted: NDArray[np.bool_] | None = None
    view: int = 0
    moves: bool = False
    image: Sight | None = None

    @cached_property
    def reach_m(self) -> float:
        """Mean distance of the markers [m], by which it is judged what is near and what is small; 1
        without any.
        """
        known = self.range[np.isfinite(self.range)]
        return float(known.mean()) if len(known) else 1.0

    @cached_property
    def unit_m(self) -> float:
        """The unit of length in which a law's equations are solved (`unit_of`) [m]."""
        return unit_of(self.reach_m)

    @cached_property
    def xy(self) -> Array:
        """Normalised coordinates of the markers, shape (N, 2)."""
        xy = self.camera.normalise(self.uv)
        xy.setflags(write=False)  # kept
        return xy

    @cached_property
    def xyw(self) -> Array:
        """Normalised coordinates and the inverse depth w = 1/Z [1/m] of the markers,
        shape (N, 3).
        """
        return np.column_stack([self.xy, 1 / self.depth])

    def protected(self) -> Goal:
        """The same goal with its arrays read-only: a scenario keeps its goals, and who wrote to one
        would change every later run.
        """
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        return self

    @property
    def T_base_camera(self) -> Array:
        """The camera's mount, as the robot knows it (4, 4)."""
        return self.camera.mount.T

    @classmethod
    def from_view(cls, camera: Camera, points: Array, T_camera_target: Array) -> Goal:
        """The view that `camera` has of target points (N, 3) from the relative pose T_camera_target
        (4, 4).
        """
        return cls.of_points(camera, transform(T_camera_target, points), T_camera_target)

    @classmethod
    def of_points(cls, camera: Camera, p: Array, T_camera_target: Array) -> Goal:
        """The view of points p (N, 3) in the camera's frame [m]."""
        uv = camera.project(p)
        reach = np.linalg.norm(p, axis=-1)
        return cls(uv, p[:, 2], p / reach[:, None], reach, T_camera_target, camera, *_plane(p))

    @classmethod
    def of_picture(cls, camera: Camera, uv: Array, p: Array, T_camera_target: Array) -> Goal:
        """The view in a picture with markers at uv (N, 2), taken to be at p (N, 3) in the camera's
        frame [m].
        """
        reach = np.linalg.norm(p, axis=-1)
        return cls(uv, p[:, 2], camera.ray(uv), reach, T_camera_target, camera, *_plane(p))

    def of_rows(self, rows: NDArray[np.bool_] | slice) -> Goal:
        """The same view with its markers `rows` (N,) alone; plane and middle stay those of all."""
        made = replace(self, **{name: a[rows] for name, a in self._of_points.items()})
        vars(made)["xy"] = self.xy[rows]  # not computed again
        return made

    def rows(self, index: NDArray[np.intp]) -> Goal:
        """The same view with its points `index` (K,) in this order; -1 for a row without a point,
        which does not count.
        """
        there = index >= 0
        taken = {name: _only(a[index], there) for name, a in self._of_points.items()}
        return replace(self, **taken, counted=there)

    def of(self, points: Goal) -> Goal:
        """This view, of the points of another goal for the same view."""
        return replace(
            self,
            **points._of_points,
            middle=points.middle,
            normal=points.normal,
            counted=points.counted,
        )

    @property
    def _of_points(self) -> dict[str, Array]:
        return {name: getattr(self, name) for name in COLUMNS}


def _plane(p: Array) -> tuple[Array, Array]:
    """Mean (3,) of points (N, 3), and the unit normal (3,) of the plane that fits them best, away
    from the origin.
    """
    middle = p.mean(axis=0)
    normal = np.linalg.svd(p - middle)[2][2]
    return middle, normal if normal @ middle > 0 else -normal
