"""From detected pixels to an Observation: undistorted coordinates, depth as the scenario says, pose."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera
from vstestbed.camera.base import FORWARD_COSINE
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, adjoint, all_finite, exp, inverse, transform
from vstestbed.core.planar import arc, composed, place_of, pose_on_ground, wrapped
from vstestbed.features.depth import AtGoal, Constant, Depth, Estimate, OnFloor, OracleDepth, PnP
from vstestbed.features.observation import Goal, Observation, OwnMotion
from vstestbed.targets.base import Target
from vstestbed.vision.base import Detection
from vstestbed.vision.pose.calibration_error import pose_by_depth
from vstestbed.vision.pose.derotate import NO_TRIM, Derotation, Trim, level_from_tilt, level_rays, level_twist, trimmed
from vstestbed.vision.pose.floor_pose import solve_place
from vstestbed.vision.pose.flow_depth import FlowMemory, init_flow, update_flow
from vstestbed.vision.pose.homography import relative_view
from vstestbed.vision.pose.pnp import solve_pose_from_rays

COMPASS_S = 0.5
"""Time constant with which a heading by odometry follows the compass [s]."""
LANDMARKS_S = 0.25
"""Time constant with which a position by odometry follows the landmarks [s]."""
NEAREST_M = 0.01
"""A depth carried on by the camera's own motion stays at or above this [m]."""


@dataclass(frozen=True, slots=True)
class ObserverMemory:
    """Time [s] of the last frame, the pose (4, 4) then (None: never known), and the depth estimator's memory.

    Of a vehicle also its place (None: never known) and its way by odometry, (x, y, heading). Of a craft the trim of its tilt.
    """

    t: float = np.nan
    T_camera_target: Array | None = None
    flow: FlowMemory | None = None
    place: Array | None = None
    odometry: Array | None = None
    trim: Trim = NO_TRIM


@dataclass(frozen=True, kw_only=True)
class Observer:
    """Turns detections into observations.

    Attributes:
        camera: the calibrated lens.
        target: the marker layout.
        goal: the goal view.
        depth: where depths come from.
        pixel_sigma_px: standard deviation of the noise added to every measured coordinate, whatever detected it [px].
        dropout: probability of each marker in each picture not to be reported.
        wanted: fields of the observation that the law looks at: `ray`, `relative` and a pose that the detector has not
            solved are made only where they are wanted.
        grounded: the robot is a vehicle on the floor; its place is told where the target stands still.
        derotation: how what a tilted craft sees is brought to its level frame (`derotate`).
        trim_s: time constant with which the picture corrects the craft's tilt for that [s]; 0: not at all.
        depth_scale: by how much each marker's depth is told wrong, shape (N,); None where it is not. The memory stays right.
    """

    camera: Camera
    target: Target
    goal: Goal
    depth: Depth
    pixel_sigma_px: float = 0.0
    dropout: float = 0.0
    wanted: tuple[str, ...] = ()
    grounded: bool = False
    derotation: Derotation = "none"
    trim_s: float = 0.0
    depth_scale: Array | None = None

    def init(self) -> ObserverMemory:
        """The memory before the first frame."""
        flow = init_flow(len(self.target.points)) if isinstance(self.depth, Estimate) else None
        return ObserverMemory(flow=flow, odometry=np.zeros(3) if self.grounded else None)

    def uses_motion(self, detection: Detection) -> bool:
        """Whether `observe` will look at the twist: to estimate depth, or to carry the pose on where markers are missing."""
        guess = isinstance(self.depth, Estimate) or self.dropout > 0 or not all_finite(detection.uv)
        return guess or self.grounded or "motion" in self.wanted

    def observe(
        self,
        memory: ObserverMemory,
        t: float,
        detection: Detection,
        twist: Array,
        rng: np.random.Generator,
        compass: float | None = None,
        tilt: Array | None = None,
        own: OwnMotion | None = None,
    ) -> tuple[ObserverMemory, Observation]:
        """What a law may know of one frame.

        The pose is the detector's where it solved one (and no noise is added), else it is solved from the pixels; with
        too few markers the last one is carried on by the camera's own motion, T <- exp(-twist dt) T, which holds for a
        target that stands still.

        Args:
            memory: the last frame.
            t: time of exposure [s].
            detection: pixels (N, 2), and what the detector found besides.
            twist: camera twist (6,) since the last frame, in the camera frame, as the robot measures it.
            rng: draws the pixel noise.
            compass: a vehicle's heading as its compass has it [rad]; None without one.
            tilt: a craft's roll and pitch (2,) as it estimates them at the exposure [rad]; None for what cannot tilt.
            own: the camera's own motion, told on to a law that asks for it.

        Raises:
            ParameterError: the oracle's depth is asked for and the detector is not the oracle.
        """
        uv, T = self._reported(detection, rng)
        xy, flow = self.camera.normalise(uv), memory.flow
        solve = self._poses and (T is None or self.pixel_sigma_px > 0)
        turned = tilt if self.derotation != "none" else None
        ray = self.camera.ray(uv) if solve or self._rays or flow is not None or turned is not None else None
        fresh = T is not None
        if solve and ray is not None:
            T, fresh = self._pose(ray, t, memory, T, twist)
        if isinstance(self.depth, Estimate) and flow is not None and ray is not None:
            flow = update_flow(self.depth, flow, t, ray, twist)
        depth, reach = self._distances(detection, T, flow, xy)
        carried, trim = T, memory.trim
        if turned is not None and ray is not None:
            if self.trim_s > 0 and fresh and T is not None:
                share = 0.0 if math.isnan(memory.t) else 1 - math.exp(-(t - memory.t) / self.trim_s)
                trim = trimmed(trim, turned, T, self.goal.T_camera_target, self.camera.mount.T[:3, :3], share)
            turned = turned + trim.angles
            mount = self.camera.mount.T[:3, :3]
            ray, xy, depth, T = self._level(ray, reach, depth, T, turned, level_from_tilt(turned, mount))
            if own is not None:
                own = replace(own, twist=level_twist(own.twist, turned, mount), moved=level_twist(own.moved, turned, mount))
        relative = relative_view(self.goal.xy, xy, self.goal.normal) if "relative" in self.wanted else None
        odometry, place = self._driven(memory, t, twist, T if fresh else None, compass)
        depth, reach, pose = self._scaled(depth, reach, T if fresh or self._stays else None)
        told = (ray, reach) if self._rays else (None, None)
        seen = Observation(t, uv, xy, depth, pose, *told, relative, odometry, place, own if "motion" in self.wanted else None)
        return ObserverMemory(t, carried, flow, place, odometry, trim), seen

    def _reported(self, detection: Detection, rng: np.random.Generator) -> tuple[Array, Array | None]:
        """The detection's pixels (N, 2), some dropped and with noise, and its pose if it has one that all of them stand behind."""
        uv, T = detection.uv, detection.T_camera_target
        if self.dropout > 0:
            dropped = rng.random(len(uv)) < self.dropout
            uv, T = np.where(dropped[:, None], np.nan, uv), None if dropped.any() else T
        if self.pixel_sigma_px > 0:
            uv = uv + rng.normal(0.0, self.pixel_sigma_px, uv.shape)
        return uv, T

    def _scaled(self, depth: Array, reach: Array | None, pose: Array | None) -> tuple[Array, Array | None, Array | None]:
        """Depths, ranges and pose as a scenario tells them wrong."""
        scale = self.depth_scale
        if scale is None:
            return depth, reach, pose
        wrong = None if pose is None else pose_by_depth(pose, self.target.points, scale)
        return depth * scale, None if reach is None else reach * scale, wrong

    def _driven(
        self, memory: ObserverMemory, t: float, twist: Array, T: Array | None, compass: float | None
    ) -> tuple[Array | None, Array | None]:
        """A vehicle's odometry and its place, with T_camera_target (4, 4) where it is seen; None for other robots."""
        if memory.odometry is None:
            return None, memory.place
        step = np.zeros(3) if np.isnan(memory.t) else arc(self._to_base @ twist, t - memory.t)
        trust = -np.expm1([(memory.t - t) / tau for tau in (COMPASS_S, LANDMARKS_S)])
        before = None if memory.place is None else composed(memory.place, step)
        return composed(memory.odometry, step), self._place(before, T, compass, trust)

    def _level(
        self, ray: Array, reach: Array | None, depth: Array, T: Array | None, tilt: Array, R: Array
    ) -> tuple[Array, Array, Array, Array | None]:
        """Rays, normalised coordinates, depths and pose in the level camera's frame. Constant depths stay as they are."""
        ray = level_rays(ray, tilt, self.camera, self.derotation)
        ahead = ray[:, 2:]
        xy = ray[:, :2] / np.where(ahead > FORWARD_COSINE, ahead, np.nan)
        if T is not None:
            turned = np.eye(4)
            turned[:3, :3] = R
            T = turned @ T
        if not isinstance(self.depth, Constant | AtGoal) and reach is not None:
            depth = reach * ray[:, 2]
        return ray, xy, depth, T

    @property
    def _rays(self) -> bool:
        return "ray" in self.wanted

    @property
    def _ranges(self) -> bool:
        return self._rays or self.derotation != "none"

    @property
    def _poses(self) -> bool:
        return isinstance(self.depth, PnP | OnFloor) or bool({"T_camera_target", "place"} & set(self.wanted))

    @property
    def _stays(self) -> bool:
        """Whether a pose may be carried on by the camera's own motion: where a target goes that moves is known only while it is seen."""
        return not self.target.moves or self.target.on_gripper

    @cached_property
    def _to_base(self) -> Array:
        """Of a twist (6,) of the camera the vehicle's (vx, vy, wz), shape (3, 6)."""
        return adjoint(self.camera.mount.T)[[0, 1, 5]]

    def _place(self, carried: Array | None, T: Array | None, compass: float | None, trust: Array) -> Array | None:
        """(x, y, heading): the position by what is seen, the heading by the compass; each by odometry where it lacks.

        The lens's place in the map is seen whatever way the vehicle is said to head; the mount's arm leads from there to it.
        Both are carried on by the encoders and drawn to what is seen and read, with time constants LANDMARKS_S and COMPASS_S, of
        which `trust` (2,) is what a frame makes, compass first: biases stay, noise less so.
        """
        if self.target.moves:
            return None
        seen = None if T is None else self.target.pose.T @ inverse(T)
        mount = self.camera.mount.T
        before = carried if seen is None else place_of(seen @ inverse(mount))
        if before is None:
            return None
        heading = float(before[2])
        if compass is not None:
            heading = compass if carried is None else float(carried[2] + trust[0] * wrapped(compass - carried[2]))
        if seen is None:
            return np.array([before[0], before[1], heading])
        arm = pose_on_ground(np.array([0.0, 0.0, heading])) @ mount[:, 3]
        xy = seen[:2, 3] - arm[:2]
        if carried is not None:
            xy = carried[:2] + trust[1] * (xy - carried[:2])
        return np.array([xy[0], xy[1], heading])

    def _pose(self, ray: Array, t: float, memory: ObserverMemory, hint: Array | None, twist: Array) -> tuple[Array | None, bool]:
        """The pose solved from the rays (N, 3) of noisy or bare pixels; else the last one, carried on; and whether it was solved."""
        last = memory.T_camera_target
        carried = hint if last is None else exp(-twist * (t - memory.t)) @ last
        seen = np.isfinite(ray[:, 0])  # noise may put a pixel outside a lens's circle
        if np.count_nonzero(seen) < (1 if isinstance(self.depth, OnFloor) else 3):
            return carried, False
        if isinstance(self.depth, OnFloor):
            found = self._pose_on_floor(ray[seen], seen, carried)
        else:
            found = solve_pose_from_rays(ray[seen], self.target.points[seen], carried)
            if found is None and carried is None and self.grounded:  # three markers leave up to four poses: one stands on the floor
                found = solve_pose_from_rays(ray[seen], self.target.points[seen], self._pose_on_floor(ray[seen], seen, None))
        return (carried, False) if found is None else (found, True)

    def _pose_on_floor(self, rays: Array, seen: NDArray[np.bool_], carried: Array | None) -> Array | None:
        mount, pose = self.camera.mount.T, self.target.pose.T
        before = None if carried is None else place_of(pose @ inverse(mount @ carried))
        place = solve_place(rays, transform(pose, self.target.points[seen]), mount, before)
        return None if place is None else inverse(pose_on_ground(place) @ mount) @ pose

    def _distances(self, detection: Detection, T: Array | None, flow: FlowMemory | None, xy: Array) -> tuple[Array, Array | None]:
        """Depth of each marker (N,) and, where the law wants it, range (N,) [m]; NaN where not known.

        A constant is taken for either; an estimate by flow is of range, and tells the depth too.
        """
        n = len(detection.uv)
        match self.depth:
            case PnP() | OnFloor() if T is not None:
                p = transform(T, self.target.points)
                depth = np.where(np.isfinite(xy[:, 0]), np.maximum(p[:, 2], NEAREST_M), p[:, 2])
                return depth, np.linalg.norm(p, axis=1) if self._ranges else None
            case PnP() | OnFloor():
                return np.full(n, np.nan), np.full(n, np.nan) if self._ranges else None
            case Constant(depth_m=depth):
                return np.full(n, depth), np.full(n, depth) if self._ranges else None
            case AtGoal():
                return self.goal.depth, self.goal.range
            case Estimate() if flow is not None:
                reach = 1 / flow.inverse_range
                return reach * flow.ray[:, 2], reach if self._ranges else None
            case OracleDepth() if detection.p_camera is not None:
                p = detection.p_camera
                return p[:, 2], np.linalg.norm(p, axis=1) if self._ranges else None
            case OracleDepth():
                raise ParameterError("depth", "oracle is only with detector {kind: oracle}; valid here: pnp, constant, goal, estimate")
            case _:
                raise ParameterError("memory", "does not belong to this depth; begin with Observer.init()")
