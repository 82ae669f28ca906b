"""Scenario: one experiment as a frozen object. Its YAML is read in `scenario_file`."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from annotated_types import Ge, Lt
from numpy.typing import NDArray

from vstestbed.camera import CAMERAS, Calibration, Camera, Catadioptric, Fisheye, Perspective, SphericalCamera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.spec import spec
from vstestbed.features.depth import OnFloor, OracleDepth, PnP
from vstestbed.features.observation import Goal
from vstestbed.laws import IBVS, LAWS, PBVS, Hybrid, LineFollowing, Partitioned, PoseController, Pursuit
from vstestbed.robots import ROBOTS, Car, Free, Mount, Omni, Puma560, Quadrotor, Robot
from vstestbed.scenario.check_flight import check_level
from vstestbed.scenario.check_ground import check_drive, check_leader
from vstestbed.scenario.goal import AnyGoal, GoalGap, GoalLine, GoalPath, GoalPlace, GoalTrack, GoalView, GoalViewFrom, GoalViews
from vstestbed.scenario.goal_view import goal_pose, told_goal
from vstestbed.scenario.stop import Stop
from vstestbed.sim.clock import Clock
from vstestbed.sim.render.noise import Drift
from vstestbed.sim.scene.start_pose import camera_start, target_start
from vstestbed.sim.scene.world import World
from vstestbed.sim.timing import Timing
from vstestbed.targets.base import Carried, Held, Points, Square
from vstestbed.targets.ground_lines import GroundLines
from vstestbed.targets.kinds import TARGETS
from vstestbed.vision import DETECTORS, Blobs, Lines, Oracle, Tags
from vstestbed.vision.pose.derotate import Derotation


@spec
class Noise:
    """Sensor noise.

    Args:
        image_sigma: standard deviation of Gaussian noise on each channel of the picture, in grey levels (of 255). What it
            does to a measured coordinate is up to the detector: with `blobs` and its `grey` moments, scatter in proportion,
            about .0025 px a grey level for discs of 8 px radius. Under 1 it has hardly any effect, above 20 markers get lost.
        pixel_sigma_px: standard deviation of Gaussian noise on each measured coordinate, whatever the detector [px].
        dropout: probability of each marker in each picture not to be reported, whatever the detector.
        drift: of the picture's brightness and colour.
    """

    image_sigma: Annotated[float, Ge(0)] = 0.0
    pixel_sigma_px: Annotated[float, Ge(0)] = 0.0
    dropout: Annotated[float, Ge(0), Lt(1)] = 0.0
    drift: Drift = Drift()


PLANE_INPUTS = {"xy", "depth", "relative"}
"""Fields of an observation that exist only for what is in front of the camera."""
START_STREAM, NOISE_STREAM, IMAGE_STREAM, SENSOR_STREAM, TIMING_STREAM, DEPTH_STREAM, MOTION_STREAM = range(7)
"""Independent random streams of one seed: the start, the noise of measured pixels, of pictures, of the robot's own sensors,
of times, of depths, and the target's random walk."""
TRIES = 1000
"""How many random starts are drawn at most until the target is in view."""
VIEW_MARGIN_PX = 10.0
"""A random start has every marker at least this far inside the picture, beside the marker's own size [px]."""


@spec
class Scenario:
    """One experiment: who moves, what it sees, what it wants, how it ends. `name` is its file's name by default.

    `derotation` says how the law of a craft that leans is given what it would see if it did not; `level_trim_s` with what time
    constant the picture corrects the roll and pitch of its IMU for that [s] (0: not at all; `vision.derotate.trimmed`).

    Raises (from the constructor): ParameterError where two parts contradict each other.
    """

    name: str = ""
    description: str = ""
    seed: Annotated[int, Ge(0)] = 0
    robot: Annotated[Free | Puma560 | Omni | Car | Quadrotor, ROBOTS]
    camera: Annotated[Perspective | Fisheye | Catadioptric | SphericalCamera, CAMERAS] = Perspective()
    target: Annotated[Square | Points | GroundLines, TARGETS]
    detector: Annotated[Blobs | Tags | Lines | Oracle, DETECTORS] = Blobs()
    law: Annotated[IBVS | Partitioned | PBVS | Hybrid | PoseController | Pursuit | LineFollowing, LAWS]
    goal: AnyGoal
    derotation: Derotation = "none"
    level_trim_s: Annotated[float, Ge(0)] = 0.0
    stop: Stop = Stop()
    noise: Noise = Noise()
    calibration: Calibration = Calibration()
    timing: Timing = Timing()
    world: World = World()
    physics: Clock = Clock()

    def __post_init__(self) -> None:
        """Refuse parts that do not belong together."""
        if isinstance(self.law.depth, OracleDepth) and not isinstance(self.detector, Oracle):
            words = "may be oracle only with detector: {kind: oracle}; with pixels use pnp, constant, goal or estimate"
            raise ParameterError("law.depth", words)
        self.timing.check(self.camera, self.clock[0])  # a clock refuses steps that do not fit
        self.believed_camera  # noqa: B018 - refuses errors that the lens cannot have
        self._check_task()
        if self.stop.duration_s < self.camera.period:
            raise ParameterError("stop.duration_s", f"must be at least one camera period, {self.camera.period:g} s", self.stop.duration_s)
        self._check_markers()
        self._check_goal()
        self.law.check(self.target.points, self.goal_view)

    def _check_task(self) -> None:
        kind, tasks = self.goal.kind, self.law.tasks
        task = "view" if isinstance(self.goal, GoalView | GoalViewFrom | GoalViews | GoalTrack) else kind
        if task not in tasks:
            raise ParameterError("goal", f"may not be of kind {kind} with law {self.law.kind}, which takes {' or '.join(tasks)}")
        flight = kind in ("path", "landing")
        self._check_flight(flight)
        if not self.robot.grounded and not flight and (task != "view" or any(isinstance(v, GoalViewFrom) for v in self._views)):
            raise ParameterError("goal", f"of kind {kind} is for a vehicle; robot {self.robot.kind} takes T_camera_target")
        if isinstance(self.target, GroundLines) != (task == "line"):
            words = "needs a line on the floor" if task == "line" else "cannot be had of lines on the floor, which have no markers"
            other = "target: {kind: lines}" if task == "line" else "goal: {kind: line} and law: {kind: line_following}"
            raise ParameterError("goal", f"of kind {kind} {words}; use {other}")
        check_drive(self.robot, self.camera, self.target, self.law, self.goal, self.stop)
        check_leader(self.target)
        if self.world.floor_friction is not None and getattr(self.robot, "wheels", "") == "planar":
            words = "is not felt by wheels: planar, which never slip; use wheels: rollers"
            raise ParameterError("world.floor_friction", words, self.world.floor_friction)
        if self.target.moves and any(isinstance(v, GoalViewFrom | GoalPlace) for v in self._views):
            raise ParameterError("goal", f"of kind {kind} needs a target that stands still; one that moves is followed by a gap or a view")
        if isinstance(self.target.motion, Held) and not isinstance(self.robot, Puma560):
            raise ParameterError("target.motion", f"held is for an arm's hand; robot {self.robot.kind} has none, use puma560")

    def _check_flight(self, flight: bool) -> None:
        kind, robot = self.goal.kind, self.robot
        if flight != bool(robot.feet) and (flight or isinstance(self.goal, GoalViewFrom)):
            raise ParameterError("goal", f"of kind {kind} is {'for' if flight else 'not for'} a craft that flies (robot quadrotor)")
        if not robot.feet and self.derotation != "none":
            raise ParameterError("derotation", "is for a craft that leans (robot quadrotor); here it must be none", self.derotation)
        if not robot.feet and not self.world.wind.still:
            raise ParameterError("world.wind", f"is for a craft that flies (robot quadrotor), and robot {robot.kind} does not feel it")
        if self.level_trim_s and (self.derotation == "none" or self.target.moves):
            words = "corrects the tilt for a derotation by a target that stands still; here it must be 0"
            raise ParameterError("level_trim_s", words, self.level_trim_s)
        if kind == "landing" and self.target.pad is None:
            raise ParameterError("target.pad", "is missing: goal of kind landing needs one, e.g. {side: 0.9}")

    def _check_markers(self) -> None:
        points, marker, seen = self.target.points, self.target.marker.kind, self.detector.markers
        if seen and marker not in seen:
            words = f"may not be {marker}: detector {self.detector.kind} sees {', '.join(seen)}; with {marker} use"
            able = [kind for kind, member in DETECTORS.members.items() if not member.markers or marker in member.markers]
            raise ParameterError("target.marker", f"{words} detector {' or '.join(able)}")
        needed = max(self.law.markers_needed(self.robot.motion_basis(Mount.of(self.camera.mount.T))), 1)
        if len(points) < needed:
            markers = f"{len(points)} marker{'s' * (len(points) != 1)}"
            words = f"has {markers}, and law {self.law.kind} needs {needed} or more for this robot's motions"
            less = self._needed_on_floor
            enough = less is not None and len(points) >= less
            raise ParameterError("target", words + (f"; with law.depth floor {less} will do" if enough else ""))
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if isinstance(self.law.depth, PnP) and (len(points) < 3 or spread[1] < 1e-6 * spread[0]):
            if any(field.name == "depth" for field in fields(self.law)):
                poses = self.goal.kind in ("gap", "pose")
                depths = "floor" if poses else "floor, goal or estimate" if self.robot.grounded else "goal or estimate"
                which = "all markers lie on one line" if len(points) > 1 else "there is a single marker"
                raise ParameterError("law.depth", f"may not be pnp: {which}, which leaves the pose open; use {depths}")
            words = f"has all markers on one line, which leaves the pose open that law {self.law.kind} works with; use other places"
            raise ParameterError("target", words)

    @property
    def _needed_on_floor(self) -> int | None:
        """How many markers the law would need with depth `floor`; None where it has another than `pnp`, or none of the two."""
        if not self.robot.grounded or not isinstance(self.law.depth, PnP) or isinstance(self.law, PBVS | Hybrid | LineFollowing):
            return None
        return replace(self.law, depth=OnFloor()).markers_needed(self.robot.motion_basis(Mount.of(self.camera.mount.T)))

    def _check_counted(self, view: GoalView, field: str) -> None:
        """Refuse a view in which markers count that do not exist, or too few for the law."""
        if view.markers is None:
            return
        n, needed = len(self.target.points), self.law.markers_needed(self.robot.motion_basis(Mount.of(self.camera.mount.T)))
        if max(view.markers) >= n:
            raise ParameterError(field, f"must be numbers of markers, 0 to {n - 1}", list(view.markers))
        if len(set(view.markers)) < needed:
            raise ParameterError(field, f"must name {needed} markers or more for law {self.law.kind}", list(view.markers))

    def _check_goal(self) -> None:
        if isinstance(self.goal, GoalLine) and not self.camera.inside(self.goal_view.uv).all():
            words = f"are outside the {self.camera.width} x {self.camera.height} picture even where all is well"
            raise ParameterError("target.look_m", f"{words}; turn the camera, or use a wider one or other distances")
        if isinstance(self.goal, GoalPlace | GoalGap | GoalLine):
            return  # what is seen there is not what is asked for
        for i, view in enumerate(self._views):
            where = f"goal.{'way' if isinstance(self.goal, GoalPath) else 'views'}.{i}" if len(self._views) > 1 else "goal"
            names = {"view_from": "view_from", "landing": "above"}
            if isinstance(view, GoalView):
                self._check_counted(view, f"{where}.markers")
            field = f"{where}.{names.get(view.kind, 'T_camera_target')}"
            self._check_view(field, self.goal_poses[i], self.goal_views[i].counted)
            check_level(self.robot, self.camera, self.target, self.goal_poses[i], field)

    def _check_view(self, field: str, T_camera_target: Array, counted: NDArray[np.bool_] | None) -> None:
        p = self.target.seen_from(inverse(T_camera_target))
        counted = np.ones(len(p), dtype=bool) if counted is None else counted
        uv, plane = self.camera.project(p), PLANE_INPUTS & set(self.law.inputs)
        limited = not (isinstance(self.detector, Oracle) and self.detector.field_of_view == "unlimited")
        picture = limited and len(self.camera.panels) == 1
        behind = p[:, 2] <= 0 if plane or isinstance(self.camera, Perspective) else np.zeros(len(p), dtype=bool)
        outside = ~(self.camera.inside(uv) if picture else np.isfinite(uv[:, 0]))
        bad = [str(i) for i in np.flatnonzero(behind if behind.any() else outside & counted)]
        if not bad:
            return
        where, remedy = f"outside the {self.camera.width} x {self.camera.height} picture", "a wider camera"
        if behind.any():
            where = "behind the camera"
            if not isinstance(self.camera, Perspective):
                where += f", where law {self.law.kind} has no image plane to work in"
                remedy = "a law of rays (feature spherical) or poses"
        markers = f"marker {bad[0]} is" if len(bad) == 1 else f"markers {', '.join(bad)} are"
        words = f"is a view in which {markers} {where}; move the goal back, or use {remedy} or a smaller target"
        raise ParameterError(field, words)

    @property
    def clock(self) -> tuple[float, int]:
        """The physics step [s], and how many of them a camera frame takes."""
        return self.physics.resolve(self.camera, self.robot.largest_step_s)

    @property
    def _views(self) -> tuple[AnyGoal, ...]:
        if isinstance(self.goal, GoalPath):
            return self.goal.way
        return self.goal.views if isinstance(self.goal, GoalViews) else (self.goal,)

    @cached_property
    def goal_views(self) -> tuple[Goal, ...]:
        """What the law wants to see: one view, or several in turn."""
        return tuple(self._goal_of(view) for view in self._views)

    @property
    def goal_view(self) -> Goal:
        """What the law wants to see in the end."""
        return self.goal_views[-1]

    @cached_property
    def believed_camera(self) -> Camera:
        """The camera as robot, detector, observer and law know it; `camera` is what it is."""
        return self.calibration.believed(self.camera)

    @cached_property
    def depth_scale(self) -> Array | None:
        """By how much each marker's depth is told wrong in this run, shape (N,); None where it is not."""
        return self.calibration.depth_scale(len(self.target.points), self.rng(DEPTH_STREAM))

    @cached_property
    def goal_poses(self) -> tuple[Array, ...]:
        """T_camera_target (4, 4) of the true camera at the goal, of one view or of several in turn: for the log, not for the law."""
        return tuple(goal_pose(view, self.target, self.camera.mount.T) for view in self._views)

    def _goal_of(self, goal: AnyGoal) -> Goal:
        return told_goal(goal, self.camera, self.believed_camera, self.target, self.depth_scale, self._shown)

    @property
    def _shown(self) -> bool:
        """Whether the goal was shown through the true camera, and differs thereby from what is told."""
        wrong = self.calibration
        return wrong.goal == "shown" and not (wrong.camera_exact and wrong.depth_exact)

    @property
    def sights(self) -> tuple[tuple[float, float, float], ...]:
        """Places that the view from outside shall show besides the start and the target: goals, and routes."""
        places = [goal.place for goal in self.goal_views if goal.place is not None]
        target = self.target
        if isinstance(target.motion, Carried):
            places += list(target.motion.route.samples.xy[::50])
        if isinstance(target, GroundLines):
            places += list(target.way[::50])
        high = [(target.T_world_start @ inverse(goal.T_camera_target))[:3, 3] for goal in self.goal_views if self.robot.feet]
        return (*((float(p[0]), float(p[1]), 0.0) for p in places), *((float(p[0]), float(p[1]), float(p[2])) for p in high))

    @property
    def T_world_goal(self) -> Array:
        """The camera's goal pose in the world (4, 4), of the target where it starts."""
        return self.target.T_world_start @ inverse(self.goal_poses[-1])

    def rng(self, stream: int) -> np.random.Generator:
        """The scenario's random numbers: one independent stream each for the start and the noises."""
        return np.random.default_rng([self.seed, stream])

    def randomised(self, seed: int) -> Scenario:
        """The same experiment with this seed and the start that it draws, redrawn until the target is in view.

        The start is written into `robot.start.nominal`, so that the scenario as run says where it started.

        Raises:
            ParameterError: the robot has no random block, or no start in it sees the target.
        """
        seeded = replace(self, seed=seed)
        rng = seeded.rng(START_STREAM)
        for _ in range(TRIES):
            robot = self.robot.randomised(rng)
            if seeded._in_view(robot):
                return replace(seeded, robot=robot)
        raise ParameterError("robot.start.random", f"gave no start in {TRIES} draws that has the whole target in view; make it smaller")

    def _in_view(self, robot: Robot) -> bool:
        T = inverse(camera_start(robot, self.camera, self.target)) @ target_start(robot, self.target)
        p = self.target.seen_from(inverse(T))
        facing = float(T[:3, 2] @ T[:3, 3]) / max(float(np.linalg.norm(T[:3, 3])), 1e-9)  # of the plane, for who looks at it
        turned = T[2, 2] if isinstance(self.camera, Perspective) else facing
        faces = turned > 0.17 or not isinstance(self.target, Square)  # within 80 degrees of square to the target
        return bool(faces and self.camera.whole(p, self.target.marker.radius, VIEW_MARGIN_PX).all())
