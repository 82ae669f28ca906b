"""The observer: from detected pixels to an Observation, with undistorted coordinates, depths, pose
(of several cameras, too), odometry.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera
from vstestbed.camera.base import FORWARD_COSINE, pixel_interaction
from vstestbed.core.geometry import Array, adjoint, all_finite, exp, inverse, transform
from vstestbed.core.lazy import cv2
from vstestbed.core.planar import arc, composed
from vstestbed.features.depth import Depth, DepthCues, Estimate, triangulated
from vstestbed.features.observation import EgoMotion, Goal, Observation
from vstestbed.targets.base import Target
from vstestbed.vision.base import Detection, points_of
from vstestbed.vision.derotate import (
    NO_TRIM,
    Derotation,
    Trim,
    level_from_tilt,
    level_rays,
    level_twist,
    trimmed,
)
from vstestbed.vision.floor_pose import corrections, fused_place, pose_on_floor
from vstestbed.vision.homography import relative_view
from vstestbed.vision.perturb import Perturbed
from vstestbed.vision.pnp import solve_pose_from_rays, unit_for

# Depth from motion: recursive least squares for each marker's inverse range from the flow of its
# ray, for any lens.

# standard deviation of a ray along one direction [rad]: 0.1 px at a focal length of 350 px
FLOW_NOISE = 3e-4
RANGE = 50.0  # the estimate is limited to the initial depth divided and multiplied by this
# Evidence, in units of that of the noise, at which a frame (it gives the range to 18 %) forgets at
# half the full rate. Weaker frames forget less: information fades as new information arrives, not
# as the motion fades.
CLEAR = 30.0


@dataclass(frozen=True, slots=True)
class FlowState:
    """State of the estimator, of N markers.

    Attributes:
        inverse_range: estimates theta, shape (N,) [1/m], NaN until the marker is first seen. t:
            time of the last frame [s].
        information: sum of phi.phi with forgetting, shape (N,) [(m/s)^2]. ray: unit rays at the
            last frame, shape (N, 3).
        ids: number of the point in each row, shape (N,), where they are not always the same
            markers.
    """

    inverse_range: Array
    information: Array
    ray: Array
    t: float
    ids: NDArray[np.intp] | None = None

    def of(self, ids: NDArray[np.intp] | None) -> FlowState:
        """The state for rows with points `ids` (N,): of a point that was not in its row nothing is
        known.
        """
        if ids is None:
            return self
        if self.ids is None:
            return replace(self, ids=ids)
        same = ids == self.ids
        theta = np.where(same, self.inverse_range, np.nan)
        information = np.where(same, self.information, 0.0)
        ray = np.where(same[:, None], self.ray, np.nan)
        return FlowState(theta, information, ray, self.t, ids)


def init_flow(n: int) -> FlowState:
    """No marker seen yet."""
    return FlowState(np.full(n, np.nan), np.zeros(n), np.full((n, 3), np.nan), np.nan)


def update_flow(
    estimate: Estimate, state: FlowState, t: float, ray: Array, twist: Array
) -> FlowState:
    """One frame of recursive least squares on theta = 1/R of each marker, under the camera's twist
    (6,) in force since the last frame.

    The flow of a unit ray r to a point at the range R:   r_dot = -(v - r (r.v)) / R - w x r
    at mid-interval:   y = r_dot + w x r = phi theta + noise,   phi = r (r.v) - v
    gain:        I <- I exp(-c dt/forget) + phi.phi,   theta <- theta + phi.(y - phi theta) / I
                 c = phi.phi / (phi.phi + CLEAR least),
                 so that I settles no lower than CLEAR least forget / dt
    prediction:  theta_dot = theta^2 r.v,   since R_dot = -r.v (half before, half after)

    A marker starts at the initial depth. I starts at and never falls below
    least = (sqrt(2) FLOW_NOISE / (dt theta))^2, which is a prior of 100 % uncertainty. A frame with
    less evidence than that is skipped, without forgetting. Rays (N, 3) are those of the time t [s],
    NaN where not seen.
    Reference: De Luca, Oriolo & Robuffo Giordano 2008, doi:10.1177/0278364908095847 (depth from
    flow and known motion); Ljung 1999, System Identification, section 11.2 (least squares with
    forgetting).
    """
    dt = t - state.t
    # Of a marker at the side depth is a small share of the range, which then is the initial depth.
    begin = np.where(ray[:, 2] > 0.2, ray[:, 2], 1.0) / estimate.initial_m
    theta = np.where(
        np.isnan(state.inverse_range) & np.isfinite(ray[:, 0]), begin, state.inverse_range
    )
    if not dt > 0:  # also the first frame, whose dt is NaN
        return FlowState(
            theta, state.information, np.where(np.isfinite(ray), ray, state.ray), t, state.ids
        )
    known = np.isfinite(ray[:, 0]) & np.isfinite(state.ray[:, 0])
    # Lost markers get any unit ray, so that no NaN spreads; `known` masks the result.
    middle = np.where(known[:, None], ray + state.ray, [0.0, 0.0, 1.0])
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    nearing = middle @ twist[:3]
    theta = _advance(theta, nearing, dt / 2)  # to mid-interval, where the flow is measured
    phi = middle * nearing[:, None] - twist[:3]
    y = np.where(known[:, None], (ray - state.ray) / dt + np.cross(twist[3:], middle), 0.0)
    evidence = np.einsum("ni,ni->n", phi, phi)
    least = (np.sqrt(2) * FLOW_NOISE / (dt * theta)) ** 2
    teaches = known & (evidence > least)
    information = np.fmax(state.information, least)
    forgotten = np.exp(-dt / estimate.forget_s * evidence / (evidence + CLEAR * least))
    information = np.where(teaches, information * forgotten + evidence, information)
    innovation = np.einsum("ni,ni->n", phi, y - phi * theta[:, None])
    # The limits keep a single bad frame from sending a range to infinity or to zero.
    theta = theta + np.where(teaches, innovation / information, 0.0)
    low = 1 / (RANGE * estimate.initial_m)
    high = RANGE / estimate.initial_m
    theta = np.clip(_advance(np.clip(theta, low, high), nearing, dt / 2), low, high)
    return FlowState(theta, information, ray, t, state.ids)


def _advance(theta: Array, nearing: Array, dt: float) -> Array:
    """Inverse ranges (N,) a short time later: one midpoint step of theta_dot = theta^2 (r.v),
    nearing = r.v (N,) [m/s].
    """
    half = theta + theta**2 * nearing * dt / 2
    return theta + half**2 * nearing * dt


# Effects of calibration errors: the goal view as shown to a miscalibrated camera, and poses with
# wrong depths.
def shown_goal(true: Camera, believed: Camera, target: Target, T_camera_target: Array) -> Goal:
    """The goal view recorded by the true camera and interpreted with the believed calibration
    (teach by showing).

    The pixels are those of the true camera at T_camera_target (4, 4); the pose, and with it every
    depth, is solved from them and the target's dimensions with the believed calibration. Where the
    pixels leave it open, the true pose is kept. (Of a ball the depths follow from its size.)
    """
    points = target.points
    uv = true.project(target.points_at(T_camera_target))
    ray = believed.ray(uv)
    if (sized := target.by_size(ray)) is not None:
        return Goal.of_picture(believed, uv, sized, T_camera_target)
    placed = len(target.places) > 2 and bool(np.isfinite(ray).all())
    solved = solve_pose_from_rays(ray, points, T_camera_target) if placed else None
    T = T_camera_target if solved is None else solved
    return Goal.of_picture(believed, uv, target.points_at(T), T)


def pose_by_depth(T: Array, points: Array, scale: Array) -> Array:
    """The pose (4, 4) that fits markers whose depths along their rays are multiplied by `scale`
    (N,).

    Rigid registration of the points P_i to scale_i T P_i: R from the singular vectors of the
    covariance, t = mean(scale_i T P_i)
    - R mean(P_i) (Umeyama 1991, eqs 40-42 without scale, doi:10.1109/34.88573). A common factor
      leaves the rotation.
    """
    q = scale[:, None] * transform(T, points)
    at = points.mean(axis=0)
    to = q.mean(axis=0)
    U, s, Vt = np.linalg.svd((q - to).T @ (points - at))
    # collinear: the registration leaves the rotation about the line open, the old one is kept
    if s[1] < 1e-9 * s[0]:
        R = T[:3, :3]
    else:
        R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    out = np.eye(4)
    out[:3, :3] = R
    out[:3, 3] = to - R @ at
    return out


class ObserverState(NamedTuple):
    """What an observer keeps from one frame to the next.

    Attributes:
        t: exposure of the last frame [s]. T_camera_target: pose then (4, 4); None where it has
            never been known.
        flow: state of the depth estimator; None without one. trim: correction of a craft's measured
            tilt.
        place: a vehicle's planar pose (x, y, heading) in the world [m, rad]; None where it is not
            known.
        odometry: a vehicle's planar pose by odometry alone, from where it started; None for other
            robots.
        uv: the last picture's own markers (N, 2) [px], where a fused pose has put others beside
            them; None else.
    """

    t: float = np.nan
    T_camera_target: Array | None = None
    flow: FlowState | None = None
    place: Array | None = None
    odometry: Array | None = None
    trim: Trim = NO_TRIM
    uv: Array | None = None


class SensorData(NamedTuple):
    """What is measured beside the markers at an exposure.

    Attributes:
        compass: a vehicle's heading [rad]; None without a compass.
        tilt: a craft's estimated roll and pitch (2,) [rad]; None for robots that do not tilt.
        motion: the camera's own, passed on to a law that requires it.
        depth_image: (H, W) [m], NaN in its holes; None without one.
        pair: rays (N, 3) of the second camera of a pair, and its pose (4, 4) in this one's frame;
            None without one.
        others: what further cameras see. The pose is then that of all pictures, and markers that
            this one lacks are where it puts them.
    """

    compass: float | None = None
    tilt: Array | None = None
    motion: EgoMotion | None = None
    depth_image: NDArray[np.float32] | None = None
    pair: tuple[Array, Array] | None = None
    others: Sequence[CameraPixels] = ()


NOTHING_ELSE = SensorData()


@dataclass(frozen=True, kw_only=True)
class Observer:
    """Turns detections into observations.

    Attributes:
        camera: as calibrated. pixel_sigma_px: standard deviation of the noise added to every
            measured coordinate [px].
        dropout: probability that a marker is not reported, for each marker and picture.
        required_fields: fields of the observation that the law reads; `ray`, `relative` and a pose
            that the detector has not solved are computed only where they are required.
        grounded: the robot is a ground vehicle; its planar pose is estimated where the target
            stands still.
        derotation: how the measurements of a tilted craft are rotated into its level frame
            (`derotate`).
        trim_s: time constant with which the goal view corrects the craft's measured tilt [s]; 0
            leaves it uncorrected.
        depth_scale: factor on each marker's reported depth (N,), a calibration error. The state
            stays unscaled.
        perturbed: perturbs the measured coordinates further. rows: number of points that the
            detector reports, where not the markers.
        points: what is measured (N, 3), in the target's frame [m]; None: the target's markers.
    """

    camera: Camera
    target: Target
    goal: Goal
    depth: Depth
    pixel_sigma_px: float = 0.0
    dropout: float = 0.0
    required_fields: tuple[str, ...] = ()
    grounded: bool = False
    derotation: Derotation = "none"
    trim_s: float = 0.0
    depth_scale: Array | None = None
    perturbed: Perturbed | None = None
    rows: int | None = None
    points: Array | None = None

    @cached_property
    def _points(self) -> Array:
        return self.target.points if self.points is None else self.points

    def init(self) -> ObserverState:
        """The state before the first frame."""
        flow = None
        if self.depth.estimator is not None:
            flow = init_flow(len(self.target.points) if self.rows is None else self.rows)
        return ObserverState(flow=flow, odometry=np.zeros(3) if self.grounded else None)

    @cached_property
    def needs_pose(self) -> bool:
        """Whether a pose is needed, which is predicted by the twist where the detector does not
        solve it.
        """
        return self.depth.needs_pose or not {"T_camera_target", "place"}.isdisjoint(
            self.required_fields
        )

    @cached_property
    def _direct(self) -> bool:
        """Whether the points are reported as they are detected, and nothing is kept from frame to
        frame: the ideal loop, at its speed.
        """
        changed = (
            self.dropout,
            self.pixel_sigma_px,
            self.perturbed is not None,
            self.depth_scale is not None,
        )
        kept = (
            self.needs_pose,
            self.depth.estimator is not None,
            self.grounded,
            self.derotation != "none",
        )
        read = (
            self.depth.measured,
            self.depth.needs_size,
            self.depth.camera,
            not {"xy", "xyw", "depth"}.issuperset(self.required_fields),
        )
        return not any(changed + kept + read)

    def uses_motion(self, detection: Detection) -> bool:
        """Whether `observe` reads the measured twist: for depth from motion, odometry, or a pose
        propagated over missing markers.
        """
        if self.grounded or self.depth.estimator is not None or "motion" in self.required_fields:
            return True
        return self.needs_pose and (
            self.dropout > 0 or self.perturbed is not None or not all_finite(detection.uv)
        )

    def observe(
        self,
        state: ObserverState,
        t: float,
        detection: Detection,
        twist: Array,
        rng: np.random.Generator,
        sensors: SensorData = NOTHING_ELSE,
    ) -> tuple[ObserverState, Observation]:
        """What a law may know of one frame.

        The pose is the detector's where it solved one (and no noise is added), else it is solved
        from the pixels; with too few markers the last one is propagated by the camera's own motion,
        T <- exp(-twist dt) T, which holds for a target at rest.

        Args:
            t: time of exposure [s]. twist: of the camera (6,) since the last frame, in its frame,
                as the robot measures it [m/s, rad/s].
            rng: source of the pixel noise and of the dropout.

        Raises ParameterError: the oracle's depth is asked for and the detector is not the oracle.
        """
        if detection.goal is not None:  # other points in every picture
            own_points = replace(self, goal=detection.goal, points=points_of(detection.goal))
            alone = sensors._replace(pair=None, others=())
            state, seen = own_points.observe(
                state, t, replace(detection, goal=None), twist, rng, alone
            )
            return state, replace(seen, ids=detection.ids)
        if self._direct:
            xy = self.camera.normalise(detection.uv)
            depth = self.depth.depths(DepthCues(self.goal, xy, p_true=detection.p_camera))
            return state, Observation(t, detection.uv, xy, depth, detection.T_camera_target)
        return self._estimated(state, t, detection, twist, rng, sensors)

    def _estimated(
        self,
        state: ObserverState,
        t: float,
        detection: Detection,
        twist: Array,
        rng: np.random.Generator,
        sensors: SensorData,
    ) -> tuple[ObserverState, Observation]:
        uv, T = self._reported(detection, t, rng)
        reads_rays = self._reads_rays or self._solves(T) or sensors.pair is not None
        ray = self.camera.ray(uv) if reads_rays else None
        T, solved = self._pose(ray, t, state, T, twist)
        flow = self._flow(state, t, ray, detection.ids, twist)
        measured_uv = None
        fused = self._fused(T, uv, sensors.others)
        if fused is not None:
            T = fused
            solved = True
            measured_uv = uv
            uv = np.where(np.isfinite(uv), uv, self.camera.project(transform(T, self._points)))
            ray = None if ray is None else self.camera.ray(uv)
        cues = self._cues(uv, ray, T, flow, detection, sensors)
        view = self._view(t, uv, ray, T, cues, sensors.motion)
        trim = state.trim
        if sensors.tilt is not None and self.derotation != "none":
            trim = self._trimmed(state, t, sensors.tilt, T if solved else None)
            view = self._leveled(view, sensors.tilt + trim[0])
        measured_T = view.T_camera_target if solved else None
        odometry, place = self._driven(state, t, twist, measured_T, sensors.compass)
        # The pose is kept as it is in the camera's own frame: the next frame's tilt is another.
        after = ObserverState(t, T, flow, place, odometry, trim, measured_uv)
        return after, self._observation(view, solved, odometry, place)

    @cached_property
    def _reads_rays(self) -> bool:
        return (
            "ray" in self.required_fields
            or self.depth.estimator is not None
            or self.depth.needs_size
            or self.derotation != "none"
        )

    def _flow(
        self,
        state: ObserverState,
        t: float,
        ray: Array | None,
        ids: NDArray[np.intp] | None,
        twist: Array,
    ) -> FlowState | None:
        if self.depth.estimator is None or state.flow is None or ray is None:
            return state.flow
        return update_flow(self.depth.estimator, state.flow.of(ids), t, ray, twist)

    def _fused(self, T: Array | None, uv: Array, others: Sequence[CameraPixels]) -> Array | None:
        """The pose (4, 4) by all cameras; None where there are no others, or it is open."""
        if not others:
            return None
        own = CameraPixels(self.camera, uv, np.eye(4))
        return pose_of_all(T, self._points, own, others)

    def _trimmed(self, state: ObserverState, t: float, tilt: Array, T: Array | None) -> Trim:
        """The trim of the tilt, corrected by a pose of the target where one was measured."""
        if T is None or not self.trim_s:
            return state.trim
        gain = 0.0 if math.isnan(state.t) else 1 - math.exp(-(t - state.t) / self.trim_s)
        return trimmed(
            state.trim, tilt, T, self.goal.T_camera_target, self.camera.mount.T[:3, :3], gain
        )

    def _cues(
        self,
        uv: Array,
        ray: Array | None,
        T: Array | None,
        flow: FlowState | None,
        detection: Detection,
        sensors: SensorData,
    ) -> DepthCues:
        """What the depths may be from."""
        by_pose = by_size = by_pair = by_flow = None
        if T is not None and self.depth.needs_pose:
            by_pose = transform(T, self._points)
        if ray is not None and self.depth.needs_size:
            by_size = self.target.by_size(ray)
        if ray is not None and sensors.pair is not None:
            by_pair = triangulated(ray, *sensors.pair)
        if flow is not None:
            by_flow = flow.ray, 1 / flow.inverse_range
        xy = self.camera.normalise(uv)
        measured = self.depth.read(sensors.depth_image, uv)
        return DepthCues(
            self.goal, xy, by_pose, detection.p_camera, by_flow, measured, by_size, by_pair
        )

    def _view(
        self,
        t: float,
        uv: Array,
        ray: Array | None,
        T: Array | None,
        cues: DepthCues,
        motion: EgoMotion | None,
    ) -> Observation:
        """What is measured in the camera's frame."""
        needs_ranges = "ray" in self.required_fields or self.derotation != "none"
        ranges = self.depth.ranges(cues) if needs_ranges else None
        return Observation(t, uv, cues.xy, self.depth.depths(cues), T, ray, ranges, motion=motion)

    def _reported(
        self, detection: Detection, t: float, rng: np.random.Generator
    ) -> tuple[Array, Array | None]:
        """The detection's pixels (N, 2) with dropout and noise, and its pose; None where dropout
        took a marker from under it.
        """
        uv = detection.uv
        T = detection.T_camera_target
        if self.dropout > 0:
            dropped = rng.random(len(uv)) < self.dropout
            uv = np.where(dropped[:, None], np.nan, uv)
            T = None if dropped.any() else T
        if self.pixel_sigma_px > 0:
            uv = uv + rng.normal(0.0, self.pixel_sigma_px, uv.shape)
        if self.perturbed is not None:
            uv = self.perturbed.pixels(uv, t)
            T = None  # the detector's pose is not perturbed
        return uv, T

    def prepare(self, needs_image: bool) -> None:
        """Import OpenCV where the first frame needs it, for pictures or a pose: a robot does not
        wait for it between two pictures.
        """
        if needs_image or self.needs_pose:
            cv2.setNumThreads(1)

    def _solves(self, T: Array | None) -> bool:
        return self.needs_pose and (T is None or self.pixel_sigma_px > 0)

    def _pose(
        self, ray: Array | None, t: float, state: ObserverState, T: Array | None, twist: Array
    ) -> tuple[Array | None, bool]:
        """The pose (4, 4) in this frame, from rays (N, 3) or the detector's pose T, and whether it
        was measured rather than propagated.
        """
        if ray is None or not self._solves(T):
            return T, T is not None
        last = state.T_camera_target
        predicted = T if last is None else exp(-twist * (t - state.t)) @ last
        found = self._solved(ray, predicted)
        return (predicted, False) if found is None else (found, True)

    def _solved(self, ray: Array, predicted: Array | None) -> Array | None:
        """The pose (4, 4) from rays (N, 3); None where too few are seen, or they leave it open."""
        seen = np.isfinite(ray[:, 0])  # noise may put a pixel outside a lens's image circle
        if np.count_nonzero(seen) < (1 if self.depth.on_floor else 3):
            return None
        rays = ray[seen]
        points = self._points[seen]
        mount = self.camera.mount.T
        place = self.target.pose.T
        if self.depth.on_floor:
            return pose_on_floor(rays, points, mount, place, predicted)
        found = solve_pose_from_rays(rays, points, predicted)
        if found is None and predicted is None and self.grounded:
            # Three markers leave up to four poses; of a vehicle's, one has the base upright on the
            # floor.
            upright = pose_on_floor(rays, points, mount, place, None)
            found = solve_pose_from_rays(rays, points, upright)
        return found

    def _leveled(self, view: Observation, tilt: Array) -> Observation:
        """The same in the level camera's frame."""
        assert view.ray is not None
        mount = self.camera.mount.T[:3, :3]
        ray = level_rays(view.ray, tilt, self.camera, self.derotation)
        T = view.T_camera_target
        depth = view.depth
        motion = view.motion
        ahead = ray[:, 2:]
        xy = ray[:, :2] / np.where(ahead > FORWARD_COSINE, ahead, np.nan)
        if T is not None:
            T_level_camera = np.eye(4)
            T_level_camera[:3, :3] = level_from_tilt(tilt, mount)
            T = T_level_camera @ T
        if view.range is not None and not self.depth.preset:
            depth = view.range * ray[:, 2]  # the rotation leaves ranges alone
        if motion is not None:
            motion = replace(
                motion,
                twist=level_twist(motion.twist, tilt, mount),
                moved=level_twist(motion.moved, tilt, mount),
            )
        return replace(view, ray=ray, xy=xy, depth=depth, T_camera_target=T, motion=motion)

    def _driven(
        self, state: ObserverState, t: float, twist: Array, T: Array | None, compass: float | None
    ) -> tuple[Array | None, Array | None]:
        if state.odometry is None:
            return None, state.place
        dt = t - state.t
        step = np.zeros(3)
        if not np.isnan(state.t):
            step = arc(adjoint(self.camera.mount.T)[[0, 1, 5]] @ twist, dt)
        odometry = composed(state.odometry, step)
        if self.target.moves:  # no landmark
            return odometry, None
        predicted = None if state.place is None else composed(state.place, step)
        # by the landmarks, whose places are known
        T_map_camera = None if T is None else self.target.pose.T @ inverse(T)
        return odometry, fused_place(
            predicted, T_map_camera, self.camera.mount.T, compass, corrections(dt)
        )

    def _observation(
        self, view: Observation, solved: bool, odometry: Array | None, place: Array | None
    ) -> Observation:
        """What the law requires of a view, with the errors of the calibration in its depths."""
        required = self.required_fields
        pose = view.T_camera_target if solved or self._predictable else None
        depth = view.depth
        reach = view.range
        if self.depth_scale is not None:
            depth = depth * self.depth_scale
            if reach is not None:
                reach = reach * self.depth_scale
            if pose is not None:
                pose = pose_by_depth(pose, self._points, self.depth_scale)
        radius = self._radius_px(view.uv, depth, reach) if "radius_px" in required else None
        rays = (view.ray, reach) if "ray" in required else (None, None)
        motion = view.motion if "motion" in required else None
        relative = None
        if "relative" in required:
            relative = relative_view(self.goal.xy, view.xy, self.goal.normal)
        return Observation(
            view.t, view.uv, view.xy, depth, pose, *rays, relative, odometry, place, motion, radius
        )

    @cached_property
    def _predictable(self) -> bool:
        """Whether the target's pose is known while it is not seen."""
        return not self.target.moves or self.target.on_gripper

    def _radius_px(self, uv: Array, depth: Array, reach: Array | None) -> Array:
        """The larger of half width and half height (N,); without ranges by the depths."""
        ray = self.camera.ray(uv)
        p = ray * (depth / ray[:, 2] if reach is None else reach)[:, None]
        return self.camera.half_size(p, self.target.marker.radius).max(axis=1)


# The target's pose by the pictures of several cameras at once.
# most Gauss-Newton steps: from a pose of one picture it takes three or four
ROUNDS = 10
SETTLED = 1e-9  # the step [unit, rad] at which they end
LEAST_MARKERS = 3  # fewest markers in all pictures together that tell a pose
# the least singular value of L, as a share of the largest, with which they do
LEAST_SHARE = 1e-6


class CameraPixels(NamedTuple):
    """What one camera sees of a target.

    camera: the lens as calibrated. uv: its markers (N, 2) [px], NaN where one is not seen.
    T_this_reference: pose (4, 4) of the reference camera in this one's frame. weight: of its
    squared errors. T_this_target: the target's pose (4, 4) by this camera alone, if any.
    """

    camera: Camera
    uv: Array
    T_this_reference: Array
    weight: float = 1.0
    T_this_target: Array | None = None


def fused_pose(T: Array, points: Array, seen: Sequence[CameraPixels]) -> tuple[Array, Array] | None:
    """T_reference_target (4, 4) that minimises sum of w |uv - project(T_this_reference T P)|^2 over
    all cameras and markers, by Gauss-Newton steps from a pose T (4, 4); and its information (6, 6),
    sum of w L^T L: with w = 1 / sigma^2 the inverse of its covariance, of a displacement of the
    reference camera in its own frame. None where too little is seen, or the steps do not settle.

    To first order this is the mean of the poses by each camera alone, weighted by the inverses of
    their covariances; a camera that sees too few markers for a pose of its own still adds what it
    sees. points: the markers (N, 3) in the target's frame [m].

    Reference: Bar-Shalom, Li & Kirubarajan 2001, Estimation with Applications to Tracking and
    Navigation, section 3.4 (least squares and its covariance).
    """
    rows = [np.isfinite(one.uv[:, 0]) for one in seen]
    if sum(map(np.count_nonzero, rows)) < LEAST_MARKERS:
        return None
    units = np.repeat([unit_for(points), 1.0], 3)  # of steps
    for _ in range(ROUNDS):
        information = np.zeros((6, 6))
        gradient = np.zeros(6)
        for one, known in zip(seen, rows, strict=True):
            p = transform(one.T_this_reference @ T, points[known])
            error = one.uv[known] - one.camera.project(p)
            # beside the lens: the pose to begin with was a wrong one
            if not np.isfinite(error).all():
                return None
            L = pixel_interaction(one.camera, p) @ adjoint(one.T_this_reference)
            L = L.reshape(-1, 6) * units
            information += one.weight * L.T @ L
            gradient += one.weight * L.T @ error.ravel()
        values = np.linalg.eigvalsh(information)
        if not values[0] > LEAST_SHARE**2 * values[-1]:
            return None
        step = np.linalg.solve(information, gradient).astype(float)
        T = exp(-step * units) @ T
        if np.abs(step).max() < SETTLED:
            return T, information / np.outer(units, units)
    return None


def pose_of_all(
    T: Array | None, points: Array, own: CameraPixels, others: Sequence[CameraPixels]
) -> Array | None:
    """The pose (4, 4) by the pictures of a reference camera and others, from that of the camera
    that sees most; None where they tell none.

    T: the pose (4, 4) in the reference camera's frame by its own picture, or as it was; None where
    it has never been known.
    """
    most = np.count_nonzero(np.isfinite(own.uv[:, 0]))
    for other in others:
        n = np.count_nonzero(np.isfinite(other.uv[:, 0]))
        if other.T_this_target is not None and (T is None or n > most):
            most = n
            T = inverse(other.T_this_reference) @ other.T_this_target
    if T is None:
        return None
    found = fused_pose(T, points, [own, *others])
    return None if found is None else found[0]
