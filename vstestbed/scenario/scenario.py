"""Scenario: one experiment as a frozen object; `load` reads its YAML."""

from __future__ import annotations

from dataclasses import field, replace
from functools import cached_property
from typing import Annotated, Any, Literal, Self

import numpy as np
from annotated_types import Len

from vstestbed.camera import CAMERAS, Calibration, Camera, Perspective
from vstestbed.camera.intrinsics import read_calibration
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, inverse
from vstestbed.core.quantity import Seed, Time
from vstestbed.core.spec import FromFile, spec
from vstestbed.endings.monitors import MONITORS, MonitorContract
from vstestbed.features.observation import Goal
from vstestbed.laws import LAWS, Law
from vstestbed.robots import ROBOTS, Robot, Vehicle
from vstestbed.robots.base import longest_step
from vstestbed.scenario import checks
from vstestbed.scenario.cameras import (
    FurtherCamera,
    OtherCamera,
    check_cameras,
    eyes_of,
    measured_draws,
)
from vstestbed.scenario.distributions import (
    BODY_STREAM,
    DEPTH_STREAM,
    DISTRIBUTIONS,
    PERTURB_STREAM,
    START_STREAM,
    TARGET_STREAM,
    Distribution,
    check_randomise,
    drawn,
)
from vstestbed.scenario.noise import Noise
from vstestbed.sim.base import SceneDescription, camera_start, flange_for, posture_at, target_start
from vstestbed.sim.scene.world import World
from vstestbed.targets import TARGETS, Target
from vstestbed.tasks import GOALS, Setup, Task
from vstestbed.tasks.metrics import METRICS, MetricContract, check_metrics
from vstestbed.tasks.stop import Stop
from vstestbed.timing.clock import Clock
from vstestbed.timing.plan import Timing
from vstestbed.vision import DETECTORS, Blobs, Detector
from vstestbed.vision.derotate import Derotation
from vstestbed.vision.perturb import Perturbed

__all__ = ["Scenario", "check_scenario"]

VIEW_MARGIN_PX = 10.0  # margin round each whole marker in the picture of a random start [px]


def in_view(
    robot: Robot, camera: Camera, target: Target, detector: Detector[Any], goal: Goal, world: World
) -> bool:
    """Whether the robot's start has the whole target in the picture, or all of it that counts for
    the first goal, seen from its front.
    """
    T_world_camera = camera_start(robot, camera, target)
    T = inverse(T_world_camera) @ target_start(robot, target)
    # points that are not its markers: its middle must be seen from the front
    if detector.rows is not None:
        return bool(T[2, 2] > 0.17 and camera.whole(T[None, :3, 3], 0.0, VIEW_MARGIN_PX).all())
    p = target.seen_from(inverse(T))
    # cosine of the view on the plane
    facing = float(T[:3, 2] @ T[:3, 3]) / max(float(np.linalg.norm(T[:3, 3])), 1e-9)
    turned = T[2, 2] if isinstance(camera, Perspective) else facing
    # within 80 degrees of the target's normal: beyond, discs are slivers
    faces = turned > 0.17 or not target.one_sided
    whole = camera.whole(p, target.marker.radius, VIEW_MARGIN_PX) & ~target.hides(inverse(T))
    if world.scenery is not None and whole.any():
        names = world.scenery_before(T_world_camera, p, target.marker.clearance_m(p))
        whole &= np.array([not name for name in names])
    if goal.counted is not None:
        whole = whole[goal.counted]
    return bool(faces and whole.all())


TRIES = 1000  # largest number of random starts drawn until the target is in view
DISPLACEMENT_STEPS = 12
"""Parts of the way from the goal view to a displaced start: of a half turn 15 degrees each, within
which Newton's steps keep a posture.
"""


def check_scenario(given: object) -> None:
    """Refuse what is no Scenario, such as the name of one."""
    if not isinstance(given, Scenario):
        why = "vstestbed.load('arm_ibvs') returns one"
        raise ParameterError.fixed("scenario", "a Scenario", given, why=why)


@spec
class Scenario:
    """One experiment: robot, camera, target, detector, law, goal, nuisances, end.

    Args:
        name: names the folder of its results; by default its file's name; e.g. `my_experiment`.
        description: one line for lists and reports.
        plugins: files or modules that add kinds, loaded before the rest is checked
            (`scenario.plugins`); e.g. `[my_law.py]`.
        seed: seed of all random numbers of a run.
        draw_start: draw the start from `robot.start.random` with the seed, as `--seed` does; a
            nominal start that is put over the file (`--set robot.start.nominal=...`) is where a run
            begins.
        robot: what moves the camera, or the target.
        camera: lens, size, rate and latency of the pictures, and where the camera is mounted.
        cameras: further cameras by name, each with a block of its own, for laws of several cameras,
            for a fused pose, for films and learners; e.g.
            `{room: {on: world, camera: {mount: {xyz: [1, -1.5, 1], rpy_deg: [-90, 0, 0]}}}}`.
        fusion: whether the target's pose is that which fits the markers in the pictures of all
            cameras best (`pose`), also where `camera` itself sees too few of them; or its own alone
            (`none`).
        target: what the camera looks at: markers, or lines on the floor.
        detector: how markers are found in a picture.
        law: the control law.
        goal: what is to be reached or kept.
        derotation: how image features of a tilted craft are rotated into its level frame
            (`vision.derotate`).
        level_trim_s: time constant with which the picture corrects the IMU's roll and pitch for
            derotation [s]; 0: not at all (`vision.derotate.trimmed`).
        metrics: figures of the summary besides those of every run.
        monitors: rules of when a run ends besides those of every run.
        stop: when a run ends.
        noise: noise of pictures and of measured coordinates.
        calibration: the calibration that robot, detector, observer and law work with: its errors,
            or the name of its file.
        timing: exposure, jitter, lost pictures, clocks, and latency and rate of the commands.
        world: floor, scenery, wind, plates and decoys.
        physics: the clock of the simulation.
        randomise: fields that are drawn anew for each seed (domain randomisation).

    A scenario is what was given. `resolved` is the same with everything written out that its seed
    draws, which is what runs; a run's folder keeps both, as `scenario.yaml` and `resolved.yaml`.

    Raises (from the constructor): ParameterError where two parts contradict each other.
    """

    name: str = ""
    description: str = ""
    plugins: tuple[str, ...] = ()
    seed: Seed = 0
    draw_start: bool = False
    robot: Annotated[Robot, ROBOTS]
    camera: Annotated[Camera, CAMERAS] = Perspective()
    cameras: dict[str, FurtherCamera] = field(default_factory=dict)
    fusion: Literal["none", "pose"] = "none"
    target: Annotated[Target, TARGETS]
    detector: Annotated[Detector[Any], DETECTORS] = Blobs()
    law: Annotated[Law[Any], LAWS]
    goal: Annotated[Task, GOALS]
    derotation: Derotation = "none"
    level_trim_s: Time = 0.0
    stop: Stop = Stop()
    noise: Noise = Noise()
    metrics: tuple[Annotated[MetricContract, METRICS], ...] = ()
    monitors: tuple[Annotated[MonitorContract, MONITORS], ...] = ()
    calibration: Annotated[Calibration, FromFile(read_calibration)] = Calibration()
    timing: Timing = Timing()
    world: World = World()
    physics: Clock = Clock()
    randomise: Annotated[tuple[Annotated[Distribution, DISTRIBUTIONS], ...], Len(0, 100)] = ()

    def __post_init__(self) -> None:
        checks.check_depth(self.robot, self.camera, self.detector, self.law)
        # first: the clock refuses a step that does not divide the camera's period
        self.timing.check(self.camera, self.clock[0])
        checks.check_times(
            self.robot, self.camera, self.timing, self.stop, self.clock[0], self.needs_image
        )
        checks.check_metres(self.robot, self.camera, self.target)
        self.believed_camera  # noqa: B018 - refuses errors that the lens cannot have
        check_cameras(self)
        self.goal.check(self.setup)
        checks.check_robot(self.robot)
        checks.check_flight(self.robot, self.target, self.world, self.derotation, self.level_trim_s)
        checks.check_contact(self.robot, self.target, self.world)
        checks.check_carrier(self.target)
        if self.world.floor.mirror and self.camera.renderer == "rays":
            why = "a floor that mirrors needs OpenGL"
            renderer = self.camera.renderer
            raise ParameterError.fixed("camera.renderer", "gl or auto", renderer, why=why)
        self.noise.target.check(self.target)
        if self.stop.duration_s < self.camera.period:
            words = f"one camera period, {self.camera.period:g} s"
            raise ParameterError.bound("stop.duration_s", "at least", words, self.stop.duration_s)
        checks.check_markers(
            self.robot, self.camera, self.target, self.detector, self.law, self.goal.needs_pose
        )
        checks.check_goal_pictures(
            self.goal, self.camera, self.needs_goal_image, self.law, self.detector
        )
        checks.check_judged(self.stop, self.target, self.detector, self.law)
        check_metrics(self.metrics)
        check_randomise(self.randomise)
        place = "goal.T_camera_target" if hasattr(self.goal, "T_camera_target") else "goal"
        for view in self.goal_views:
            checks.check_length(place, view.T_camera_target, checks.MOST_VIEW_M)
        checks.check_own_points(self.robot, self.camera, self.detector, self.law, self.goal_views)
        self.goal.check_views(self.setup, self.goal_views)
        self.law.check(self.target.points, self.goal_view)
        if self.detector.rows is None:  # else its own points, which the goal's picture shows
            checks.check_determined(self.robot, self.camera, self.target, self.law, self.goal_view)
        for goal in self.goal_views:
            self.law.check_view(goal, self.target.marker.radius, self.target.called)

    @property
    def draws(self) -> bool:
        """Whether another seed gives another run: some part of the experiment says that it draws
        from a stream of the seed.
        """
        if self.randomise or self.robot.start.random is not None or self._draws_heading:
            return True
        parts: list[Any] = [self.robot, self.target.motion, self.world, self.timing]
        parts += self.eyes.values()
        if self.reads_depth:
            parts.append(self.camera.depth_sensor)
        if self.needs_goal_image:
            parts += self.goal.pictures
        return measured_draws(self) or any(part is not None and part.draws for part in parts)

    @property
    def _draws_heading(self) -> bool:
        """Whether the seed draws the error of the compass by which a vehicle knows landmarks."""
        landmarks = not self.target.moves and self.target.painted_route is None
        return landmarks and isinstance(self.robot, Vehicle) and self.robot.draws_heading

    @cached_property
    def eyes(self) -> dict[str, OtherCamera]:
        """The further cameras by name, each with what a run needs of it."""
        return eyes_of(self)

    @property
    def clock(self) -> tuple[float, int]:
        """The physics step [s], and how many of them a camera frame takes."""
        return self.physics.resolve(self.camera, longest_step(self.robot))

    @cached_property
    def setup(self) -> Setup:
        """The parts that the task uses."""
        wrong = self.calibration
        shown = wrong.goal == "shown" and not (wrong.camera_exact and wrong.depth_exact)
        return Setup(
            self.robot,
            self.camera,
            self.believed_camera,
            self.target,
            self.law,
            self.detector,
            self.stop,
            self.world,
            depth_scale=self.depth_scale,
            goal_shown=shown,
        )

    @cached_property
    def goal_views(self) -> tuple[Goal, ...]:
        """The goals for the law: one view, or several in turn; their arrays are read-only."""
        return tuple(view.protected() for view in self.goal.goal_views(self.setup))

    @property
    def goal_view(self) -> Goal:
        """The last goal for the law."""
        return self.goal_views[-1]

    @cached_property
    def free_motions(self) -> int:
        """How many motions `law.redundant` leaves free at the goal, whose pose is then not
        determined; 0 for none.
        """
        if self.detector.rows is not None:
            return 0
        return checks.free_motions(self.robot, self.camera, self.target, self.law, self.goal_view)

    @property
    def rows(self) -> int:
        """Number of points in an observation: the target's markers, or as many as a detector of
        other points reports.
        """
        return len(self.target.points) if self.detector.rows is None else self.detector.rows

    @property
    def by_rows(self) -> bool:
        """Whether a picture is not that of an instant under steady light:
        rolling shutter, flicker.
        """
        light = self.world.light
        return self.camera.readout_s > 0 or (light is not None and light.flicker.depth > 0)

    @property
    def needs_image(self) -> bool:
        """Whether pictures are taken: the detector, or the law, works on them."""
        return self.detector.needs_image or "image" in self.law.inputs or self.law.depth.measured

    @property
    def reads_depth(self) -> bool:
        """Whether depth pictures are read."""
        return self.law.depth.measured

    @property
    def needs_goal_image(self) -> bool:
        """Whether a picture must be taken at the goal before the run."""
        return self.detector.needs_goal or "image" in self.law.inputs

    @cached_property
    def believed_camera(self) -> Camera:
        """The camera as calibrated, known to robot, detector, observer and law; `camera` is the
        true one.
        """
        return self.calibration.believed(self.camera)

    @cached_property
    def depth_scale(self) -> Array | None:
        """Ratio of each marker's assumed depth to the true one in this run, shape (N,); None for
        exact depths.
        """
        return self.calibration.depth_scale(self.rows, self.rng(DEPTH_STREAM))

    @cached_property
    def goal_poses(self) -> tuple[Array, ...]:
        """T_camera_target (4, 4) of the true camera at each goal view in turn: for the log, not for
        the law.
        """
        return self.goal.goal_poses(self.target, self.camera.mount.T)

    def goal_pose_at(self, t: float, view: int) -> Array | None:
        """T_camera_target (4, 4) at the goal of a time [s] and a view; None where the goal is no
        single pose.
        """
        return self.goal.goal_pose_at(self.setup, self.goal_poses, t, view)

    @cached_property
    def own_columns(self) -> tuple[str, ...]:
        """The robot's, its effects' and the task's own columns of the log."""
        supervisor = self.robot.supervisor(self.goal.lands, *self.stop.lost_after)
        columns = self.robot.log(supervisor).columns
        for effect in self.robot.acting:
            columns += tuple(effect.columns)
        return columns + self.goal.monitor(self.setup, supervisor).columns

    @property
    def sights(self) -> tuple[tuple[float, float, float], ...]:
        """Points that the outside view must show besides the start and the target: goals, and
        routes every 50 cm [m].
        """
        places = [goal.place for goal in self.goal_views if goal.place is not None]
        shown = [(p[0], p[1], 0.0) for p in (*places, *self.target.floor_path[::50])]
        if self.robot.base == "floating":
            for goal in self.goal_views:
                T_world_goal = self.target.T_world_start @ inverse(goal.T_camera_target)
                shown.append(tuple(T_world_goal[:3, 3]))
        return tuple((float(x), float(y), float(z)) for x, y, z in shown)

    @property
    def scene(self) -> SceneDescription:
        """What is simulated and seen, in this run."""
        others = tuple(eye.viewpoint for eye in self.eyes.values())
        parts = self.robot, self.camera, self.target_in_run, self.world
        return SceneDescription(*parts, self.clock[0], self.sights, others=others)

    @property
    def T_world_goal(self) -> Array:
        """The camera's goal pose in the world (4, 4), for the target at its start."""
        return target_start(self.robot, self.target) @ inverse(self.goal_poses[-1])

    @cached_property
    def target_in_run(self) -> Target:
        """The target as it looks in this run, with the changes of its picture that the seed draws
        (`noise.target`).
        """
        return self.noise.target.on(self.target, self.rng(TARGET_STREAM))

    def perturbed(self) -> Perturbed | None:
        """The perturbations of a run, with what is drawn for it; None where there are none."""
        kinds = self.noise.perturb
        return Perturbed(kinds, self.rng(PERTURB_STREAM)) if kinds else None

    def rng(self, stream: int) -> np.random.Generator:
        """The generator of one of the independent streams (START_STREAM, ...)."""
        return np.random.default_rng([self.seed, stream])

    @cached_property
    def resolved(self) -> Scenario:
        """The scenario that runs: all that the seed draws is written out, so that nothing is left
        to draw; itself where nothing is.

        The start stands in `robot.start.nominal`, drawn again until the target is in view; the body
        in the robot's blocks, whose lists take the place of the standard deviations; what
        `randomise` draws in its fields, clutter in `world.clutter.placed`.
        Raises ParameterError: a drawn value is refused, the robot has no random block, or no start
        in it sees the target.
        """
        made = drawn(self)
        if made.draw_start:
            made = replace(made, robot=made.start(made.seed), draw_start=False)
        else:
            robot = made.robot.drawn(made.rng(BODY_STREAM))
            if robot is not made.robot:
                made = replace(made, robot=robot)
        if made is not self:
            made.__dict__["given"] = self  # no field either: a changed copy is given as it is
        return made

    def start(self, seed: int) -> Robot:
        """The robot that a seed draws, at the start that it draws, of a scenario with nothing else
        to be drawn. Errors: see `resolved`.
        """
        rng = np.random.default_rng([seed, START_STREAM])
        body = self.robot.drawn(np.random.default_rng([seed, BODY_STREAM]))
        parts = (self.camera, self.target, self.detector, self.goal_views[0], self.world)
        for _ in range(TRIES):
            robot = body.randomised(rng)
            if in_view(robot, *parts):
                return robot
        words = f"gave no start in {TRIES} draws that has the whole target in view; make it smaller"
        raise ParameterError("robot.start.random", words)

    @cached_property
    def given(self) -> Scenario:
        """Of a scenario from `resolved`: the one before anything was drawn; else itself."""
        return self

    @property
    def made_of(self) -> dict[str, Any] | None:
        """The plain values that it was loaded from, with what was put over them; None where it was
        made or changed in Python.
        """
        return self.__dict__.get("_made_of")

    def loaded_from(self, plain: dict[str, Any]) -> Self:
        """Itself, which remembers the plain values that it was loaded from."""
        self.__dict__["_made_of"] = (
            plain  # no field: a copy with other values was not loaded from these
        )
        return self

    def but(self, **values: str | int | bool) -> Scenario:
        """A copy with other plain values, such as another name, which remembers what it was loaded
        from with them.
        """
        made = replace(self, **values)
        if self.made_of is not None:
            # what is new stands first
            made.loaded_from({**values, **self.made_of, **values})
        return made

    def with_seed(self, seed: int) -> Scenario:
        """The same experiment with another seed; its start is the given one, unless `draw_start`
        says otherwise. Errors: see `resolved`.
        """
        made = self.given.but(seed=seed)
        made.resolved  # noqa: B018 - refuses what it draws
        return made

    def randomised(self, seed: int) -> Scenario:
        """The same experiment with this seed and a start drawn from it (`draw_start`). Errors: see
        `resolved`.
        """
        made = self.given.but(seed=seed, draw_start=True)
        made.resolved  # noqa: B018 - refuses what it draws
        return made

    def displaced(self, by: Pose, of: Literal["camera", "target"]) -> Scenario:
        """The same experiment, begun at a displacement D from its goal view: the robot's start is
        found by inverse kinematics.

        of: `camera`, displaced in the frame of the camera at its goal, T_camera_target = D^-1 T*;
        or `target`, seen displaced in its own frame at the goal, T_camera_target = T* D. Raises
        UnreachableError. ParameterError: the robot is neither an arm nor the free camera.
        """
        T = self.goal_poses[-1]
        q = posture_at(self.robot, flange_for(self.camera, self.target, T))
        # in small steps: the arm keeps its posture at the goal
        for share in np.linspace(0.0, 1.0, DISPLACEMENT_STEPS + 1):
            xyz = (share * np.array(by.xyz)).tolist()
            rpy_deg = (share * np.array(by.rpy_deg)).tolist()
            D = Pose(xyz=tuple(xyz), rpy_deg=tuple(rpy_deg)).T
            seen = inverse(D) @ T if of == "camera" else T @ D
            q = self.robot.configuration_at(flange_for(self.camera, self.target, seen), q)
        return replace(self, robot=self.robot.started_at(q), draw_start=False)
