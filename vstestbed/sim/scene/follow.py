"""The camera of films from outside: it follows a robot that moves and shows robot, target and goal
in each frame.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from vstestbed.core.geometry import Array, inverse, transform
from vstestbed.sim.scene.joint_chain import before, names_of, turned
from vstestbed.sim.scene.meshes import CORNERS, RANGE_GROUP
from vstestbed.sim.scene.overview import (
    AZIMUTHS,
    LEAST_REACH,
    ROOM,
    Axes,
    extremes,
    eye_of,
    holds,
    slanting,
)
from vstestbed.sim.scene.scene import Scene

ELEVATIONS = np.radians([26.0, 36.0, 16.0, 10.0, 5.0])
"""Elevations from which the view may look down [rad]; of equally good ones the first is taken."""
ENOUGH = 0.12
"""Share of the picture's width beyond which a moving robot need not appear larger: views from
nearer the ground show less of the floor.
"""
# Turns of the view of a free camera about its vertical, from the composed one [rad]
SIDES = np.radians([0.0, 10.0, 20.0, -10.0, -20.0])
# Extent shown round a moving robot over its own: it never fills the picture, and the floor beside
# it shows its motion
AROUND = 2.2
LEAST_SHARE = 0.08
"""Least extent of the robot over the picture's width. Where robot, target and goal are too far
apart for it, the others may be cut off.
"""
# Natural frequency of the filter that smooths the following [rad/s]: the camera starts and stops
# within about a second
RATE = 2.5
ROOM_TO_MOVE = 1.2
SLACK = 1.02
"""Margin of the view of a robot that stays, and what is left of it when the view is taken anew:
until then it rests, and of the picture only what has moved must be drawn again.
"""
SHOWN = "robot/", "leader/", "target/", "eye"
"""Beginnings of the names of bodies, or of geoms in the world, that are in the picture, and not of
plates, decoys and the floor.
"""
STRIPE = "target/line_"  # but not these: lines on the floor reach far
# a ray that ends so near before its point has reached it: the lens lies within a housing [m]
HIDDEN_M = 0.12
RING = np.array([[math.cos(a), math.sin(a), 0.0] for a in np.arange(8) * math.pi / 4])
UP = np.array([0.0, 0.0, 1.0])
BOXES = np.vstack([CORNERS, CORNERS])
CYLINDERS = np.vstack([RING - UP, RING + UP])
BALLS = np.vstack([RING, *(math.sqrt(0.5) * (RING[::2] + side * UP) for side in (-1, 1))])
"""Points (16, 3) on shapes of half sizes 1, of which they are the corners or come near to it."""
ROUND: dict[int, Array] = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE): BALLS,
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): BALLS,
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): CYLINDERS,
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): CYLINDERS,
}
BISECTIONS = 7


class Things:
    """The geoms that an outside view shows: robot, servo camera, target, its carrier.

    Args:
        model: the scene.

    Attributes:
        geoms: their numbers (G,). own: which of them (G,) are the robot's.
    """

    def __init__(self, model: mujoco.MjModel):
        # A robot may have geoms that are fixed to the world; those of a body may have no name.
        bodies = names_of(model, "body")
        names = names_of(model, "geom")
        for i, root in enumerate(model.body_rootid[model.geom_bodyid]):
            if root > 0:
                names[i] = f"{bodies[root]} {names[i]}"
        named = np.array([name.startswith(SHOWN) and STRIPE not in name for name in names])
        drawn = (model.geom_group != RANGE_GROUP) & (model.geom_rgba[:, 3] > 0)
        shown = np.flatnonzero(named & drawn)
        self.geoms = shown
        self.own = np.array([names[i].startswith("robot/") for i in shown])
        shape = np.array([ROUND.get(kind, BOXES) for kind in model.geom_type[shown].tolist()])
        self._local = model.geom_aabb[shown, None, :3] + model.geom_aabb[shown, None, 3:] * shape

    def points(self, data: mujoco.MjData) -> Array:
        """Points (G, 16, 3) in the world whose convex hulls are nearly the geoms (of a mesh, the
        box round it).
        """
        R = data.geom_xmat[self.geoms].reshape(-1, 3, 3)
        return data.geom_xpos[self.geoms, None] + self._local @ R.transpose(0, 2, 1)


def put_overview(stage: Scene, eye: Array, view: Axes, middle: Array) -> None:
    """Set the camera `overview` of a placed stage, and the light that casts shadows over the middle
    (3,) of what is shown.
    """
    model = stage.model
    data = stage.data
    camera = model.camera("overview").id
    light = model.light("key").id
    data.cam_xpos[camera] = eye
    data.cam_xmat[camera] = np.column_stack([view.right, view.up, -view.ahead]).ravel()
    data.light_xpos[light] = middle - LEAST_REACH * data.light_xdir[light]


class FixedView:
    """The camera `overview` where somebody wants it, as MuJoCo's viewer names a place.

    Args:
        azimuth_deg, elevation_deg: of the direction in which it looks; 0, 0 is along the world's x,
            and elevation -90 straight down [deg].
        distance_m: from the point that it looks at [m]. at: that point (3,) [m]; None: the middle
            of what is in the first picture.
    """

    def __init__(
        self, azimuth_deg: float, elevation_deg: float, distance_m: float, at: Array | None = None
    ):
        self._view = Axes.of(*slanting(math.radians(azimuth_deg), -math.radians(elevation_deg)))
        self._distance = distance_m
        self._at = at

    def place(self, stage: Scene, things: Things) -> None:
        """Set the camera of a placed stage."""
        if self._at is None:
            self._at = things.points(stage.data).reshape(-1, 3).mean(axis=0)
        put_overview(stage, self._at - self._distance * self._view.ahead, self._view, self._at)


class FollowCamera:
    """Pose of the scene's camera `overview` at each frame, from the frames so far.

    Its direction is chosen at the first frame, as that with the largest robot that is not hidden. A
    robot on a fixed base, or a free camera, is shown with all the places where something has been;
    a moving one is followed, smoothed by a g-h filter without lag at constant velocity (critically
    damped: g = 1 - th^2, h = (1 - th)^2, th = exp(-RATE dt); Brookner 1998, Tracking and Kalman
    Filtering Made Easy, section 1.2.6).

    stage: the scene. things: in it. aspect: width over height of the picture.
    free: share of the picture's width, from the left, that nothing is drawn over.
    """

    def __init__(self, stage: Scene, things: Things, aspect: float, free: float):
        self._stage = stage
        model = stage.model
        self._camera = model.camera("overview").id
        half = math.tan(math.radians(model.cam_fovy[self._camera]) / 2)
        self._width = 2 * half * aspect
        tangents = np.array([half * aspect, half * aspect * (2 * free - 1), half, half])
        self._moving = stage.parts.robot.base != "fixed"
        self._tangents = tangents / (ROOM if self._moving else ROOM_TO_MOVE)
        self._edges = tangents / SLACK
        self._things = things
        self._view: Axes | None = None
        self._extremes = np.full((2, 4), -np.inf)
        self._framed = np.zeros(3)
        self._t = 0.0
        self._eye = np.zeros(3)
        self._velocity = np.zeros(3)

    def place(self, t: float, T_world_goal: Array | None) -> None:
        """Set the camera for a placed stage at a time [s]; T_world_goal: pose (4, 4) of the servo
        camera at its goal, if it has one.
        """
        around, beside = self._contents(T_world_goal)
        first = self._view is None
        if self._view is None:
            self._view = self._chosen(around, beside)
        eye = self._eye_for(self._view, around, beside)
        if first:
            self._eye = eye
        elif t > self._t:
            still = math.exp(-RATE * (t - self._t))
            dt = t - self._t
            ahead = self._eye + self._velocity * dt
            self._eye = ahead + (1 - still**2) * (eye - ahead)
            self._velocity = self._velocity + (1 - still) ** 2 / dt * (eye - ahead)
        self._t = t
        put_overview(self._stage, self._eye, self._view, around.mean(axis=0))

    def _contents(self, T_world_goal: Array | None) -> tuple[Array, Array]:
        """Points (N, 3) round the robot, and (M, 3) round what else must be in the picture."""
        points = self._things.points(self._stage.data)
        camera = self._stage.camera_pose()
        robot = points[self._things.own].reshape(-1, 3)
        beside = points[~self._things.own].reshape(-1, 3)
        if not self._moving:
            robot = np.vstack([robot, camera[None, :3, 3]])
        if T_world_goal is not None:
            at_goal = T_world_goal[None, :3, 3]
            if self._moving:
                at_goal = transform(T_world_goal @ inverse(camera), robot)
            beside = np.vstack([beside, at_goal])
        return robot, beside

    def _eye_for(self, view: Axes, around: Array, beside: Array) -> Array:
        """The nearest eye (3,) that shows everything, or as much of it as leaves the robot its
        least size.
        """
        if not self._moving:
            points = np.vstack([around, beside])
            now = np.array([extremes(points, view, t) for t in (self._tangents, self._edges)])
            first = not np.isfinite(self._extremes).all()
            self._extremes = np.maximum(self._extremes, now)
            if first or not holds(self._framed, self._extremes[1], view, self._edges):
                self._framed = eye_of(self._extremes[0], view, self._tangents)
            return self._framed
        eye = self._showing(view, around, beside)
        if self._share(eye, view, around) >= LEAST_SHARE:
            return eye
        middle = around.mean(axis=0)
        near = 0.0
        far = 1.0
        for _ in range(BISECTIONS):
            share = (near + far) / 2
            eye = self._showing(view, around, middle + share * (beside - middle))
            if self._share(eye, view, around) >= LEAST_SHARE:
                near = share
            else:
                far = share
        return eye

    def _showing(self, view: Axes, around: Array, beside: Array) -> Array:
        """The nearest eye (3,) that shows everything, with room beside a robot that moves."""
        if self._moving:
            across = np.array(view[:2])
            around = around + (AROUND - 1) * (around - around.mean(axis=0)) @ across.T @ across
        ends = extremes(np.vstack([around, beside]), view, self._tangents)
        return eye_of(ends, view, self._tangents)

    def _share(self, eye: Array, view: Axes, around: Array) -> float:
        extent = max(float(np.ptp(around @ axis)) for axis in view[:2])
        return extent / (self._width * max(float((around.mean(axis=0) - eye) @ view.ahead), 1e-6))

    def _chosen(self, around: Array, beside: Array) -> Axes:
        """The direction of the film's view; near that of the composed scene for a free camera,
        which has no upright.
        """
        if self._stage.parts.robot.body is None:
            right, up, _ = turned(self._stage.model.cam_quat[self._camera]).T
            back = np.cross(right, up)
            views = [Axes.of(right * math.cos(a) + back * math.sin(a), up) for a in SIDES]
        else:
            views = [
                Axes.of(*slanting(azimuth, elevation))
                for elevation in ELEVATIONS
                for azimuth in AZIMUTHS[::2]
            ]
        return max(views, key=lambda view: self._merit(view, around, beside))

    def _merit(self, view: Axes, around: Array, beside: Array) -> float:
        """Extent of the robot, times how much of it all one sees.

        The share of the markers that are not hidden, and of the camera on a robot that stays; how
        much the markers' faces, or the floor with its lines, are turned to the viewer; for a robot
        that stays, how much one sees the way from camera to target from the side, for one that
        moves, of the floor.
        """
        eye = self._showing(view, around, beside)
        target = self._stage.parts.target
        T_target = self._stage.target_pose()
        size = self._share(eye, view, around)
        at = self._stage.camera_pose()[:3, 3]
        slack = 2 * target.marker.radius
        seen = self._sees(eye, transform(T_target, target.places), slack)
        faces = 1.0
        if not target.marker.height_m:
            away = -T_target[:3, :3] @ target.normals.mean(axis=0)
            faces = float((away if len(target.places) else -UP) @ view.ahead)
        if self._moving:
            size = min(size, ENOUGH) + 0.05 * size
            aside = 1.0
            size *= 0.8 + 0.2 * min(-float(UP @ view.ahead) / math.sin(ELEVATIONS[0]), 1.0)
        else:
            way = T_target[:3, 3] - at
            seen += self._sees(eye, at[None], HIDDEN_M)
            across = np.linalg.norm(np.cross(way, view.ahead))
            aside = float(across / max(np.linalg.norm(way), 1e-9))
        merit = (
            size
            * (0.1 + sum(seen) / max(len(seen), 1)) ** 2
            * (0.4 + 0.6 * max(faces, 0.0))
            * (0.4 + 0.6 * aside)
        )
        # of views that are equally good the first wins, whatever the last bit of a sum is
        return round(merit, 6)

    def _sees(self, eye: Array, points: Array, slack: float) -> list[bool]:
        """Whether nothing hides points (N, 3) from the eye."""
        stage = self._stage
        hides = before(stage.model, stage.data, eye, points - eye, slack, (RANGE_GROUP,))
        return (hides < 0).tolist()
