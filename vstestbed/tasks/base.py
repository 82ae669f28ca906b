"""The contract of a task: checks, goal views, reference generation, monitor and metrics.

A goal block of a scenario is a `Task`: parameters and behaviour in one frozen object. No code
outside this folder tests its kind.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.named_files import absolute_file, place_of_file
from vstestbed.core.outcome import Outcome
from vstestbed.core.quantity import Sigma, TighterBounds
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal, Observation
from vstestbed.imaging.stream import JpegStream, round_trip
from vstestbed.laws import Law
from vstestbed.robots import Robot
from vstestbed.robots.base import Base, Supervisor
from vstestbed.targets import Target
from vstestbed.targets.picture import read_rgb
from vstestbed.tasks.frame import ImageError
from vstestbed.tasks.judged import JudgedError, Log, by_convergence
from vstestbed.tasks.monitor import Setup, TaskMonitor
from vstestbed.tasks.stop import Stop
from vstestbed.vision.observe import pose_by_depth, shown_goal

# fields of an observation that exist only for points in front of the camera
PLANE_INPUTS = {"xy", "xyw", "depth", "relative"}
LEVEL_DEG = 1.0  # largest tilt of the craft at a goal view [deg]


def check_visible(
    setup: Setup, field: str, T_camera_target: Array, counted: NDArray[np.bool_] | None
) -> None:
    """Refuse a goal view with a marker that counts outside the picture or hidden, or any behind an
    image plane. setup: the experiment's parts. field: of the view. T_camera_target: its pose (4,
    4). counted: the markers that count (N,); None: all.
    Raises ParameterError: it names the field, the markers, what hides them, and what would work.
    """
    camera = setup.camera
    target = setup.target
    T_target_camera = inverse(T_camera_target)
    p = target.seen_from(T_target_camera)
    if counted is None:
        counted = np.ones(len(p), dtype=bool)
    _check_ahead(setup, field, p)
    if setup.detector.rows is not None:  # it finds other points than the target's markers
        return
    uv = camera.project(p)
    limited = getattr(setup.detector, "field_of_view", "limited") == "limited"
    # An oracle may report markers all round, and six panels have no border between them.
    inside = camera.inside(uv) if limited and len(camera.panels) == 1 else np.isfinite(uv[:, 0])
    outside = ~inside & counted
    if outside.any():
        where = f"outside the {camera.width} x {camera.height} picture"
        remedy = "move the goal back, or use a wider camera or a smaller target"
        raise _not_visible(field, target, outside, where, remedy)
    if not limited:
        return
    hidden = target.hides(T_target_camera) & counted
    if hidden.any():
        remedy = "move the goal, or let goal.markers name those that are to be seen"
        raise _not_visible(field, target, hidden, "hidden by the target itself", remedy)
    if target.on_gripper:
        _check_scenery(setup, field, camera.mount.T, p, counted)
    # else where the goal view is in the room is not known before the run
    elif not target.moves:
        _check_scenery(setup, field, target.T_world_start @ T_target_camera, p, counted)


def _check_ahead(setup: Setup, field: str, p: Array) -> None:
    """Refuse markers p (N, 3) [m] behind an image plane; a law of rays or poses has none."""
    behind = p[:, 2] <= 0
    if not behind.any():
        return
    where = "behind the camera"
    if isinstance(setup.camera, Perspective):
        what = "a wider camera"
    elif PLANE_INPUTS & set(setup.law.inputs):
        where += f", where law {setup.law.kind} has no image plane to work in"
        what = "a law of rays (feature spherical) or poses"
    else:
        return
    remedy = f"move the goal back, or use {what} or a smaller target"
    raise _not_visible(field, setup.target, behind, where, remedy)


def _check_scenery(
    setup: Setup, field: str, T_world_camera: Array, p: Array, counted: NDArray[np.bool_]
) -> None:
    """Refuse markers p (N, 3) [m] that count and that scenery hides from a camera (4, 4)."""
    target = setup.target
    names = setup.world.scenery_before(T_world_camera, p, target.marker.clearance_m(p))
    hidden = np.array([bool(name) for name in names]) & counted
    if hidden.any():
        what = ", ".join(dict.fromkeys(names[i] for i in np.flatnonzero(hidden)))
        remedy = (
            "move the goal, or the scenery by world.scenery.pose,"
            " or let goal.markers name the markers that are to be seen"
        )
        raise _not_visible(field, target, hidden, f"hidden by the scenery ({what})", remedy)


def _not_visible(
    field: str, target: Target, bad: NDArray[np.bool_], where: str, remedy: str
) -> ParameterError:
    """The error for markers (N,) that a goal view does not show."""
    called = [target.called(int(i)) for i in np.flatnonzero(bad)]
    markers = f"marker {called[0]} is" if len(called) == 1 else f"markers {', '.join(called)} are"
    return ParameterError(field, f"is a view in which {markers} {where}; {remedy}")


# The picture of a goal: a file from a real camera, or one that the simulated camera takes there,
# also under other light.
PLAIN: dict[str, float | None] = {
    "brightness": 1.0,
    "contrast": 1.0,
    "image_sigma": 0.0,
    "jpeg_quality": None,
}
MID_GREY = 128.0  # the grey level that a change of contrast leaves as it is
Factor = Annotated[float, Gt(0), Le(10)]


@spec
class GoalPicture:
    """The picture that was taken at the goal, for a law or a detector that compares with it.

    Without a file the simulated camera takes it there before the run, without noise. Under other
    light than the run's its grey levels I become contrast (brightness I - 128) + 128; then it may
    be kept as a JPEG file.

    Args:
        file: a PNG or JPEG file of the camera's size, from a real camera at the goal; its name
            alone is enough; e.g. `goal.png`.
        brightness: factor on the grey levels [1].
        contrast: factor on their distance from mid-grey [1].
        image_sigma: standard deviation of Gaussian noise on each channel [grey levels].
        jpeg_quality: of the JPEG file in which it is kept, 1 to 100; None: it is kept as it is;
            e.g. `95`.
    """

    file: str | None = None
    brightness: Factor = 1.0
    contrast: Factor = 1.0
    image_sigma: Annotated[Sigma, TighterBounds(le=255)] = 0.0
    jpeg_quality: Annotated[int, Ge(1), Le(100)] | None = None

    def __post_init__(self) -> None:
        """Make the name independent of the folder; refuse other light for a picture that is taken
        already.
        """
        if self.file is None:
            return
        # frozen; a run remembers where its picture is
        object.__setattr__(self, "file", absolute_file(self.file, Path.cwd()))
        if self.other_light:
            changed = [name for name, value in self._changes.items() if value != PLAIN[name]]
            words = "a picture that the simulated camera takes; leave it out, or the file"
            raise ParameterError.only_for(changed[0], words)

    @property
    def other_light(self) -> bool:
        """Whether the picture that is taken is changed."""
        return self._changes != PLAIN

    @property
    def _changes(self) -> dict[str, float | None]:
        return {name: getattr(self, name) for name in PLAIN}

    @property
    def draws(self) -> bool:
        """Whether a seed makes a difference to the picture: it has noise."""
        return self.image_sigma > 0

    @property
    def source(self) -> Path | None:
        """The file; None where the simulated camera takes the picture. Raises ParameterError: it is
        not there.
        """
        return None if self.file is None else place_of_file(self.file)

    def read(self, camera: Camera) -> Image:
        """The file's picture (H, W, 3) RGB. Raises ParameterError: it cannot be read, or is of
        another size than the camera's pictures.
        """
        assert self.source is not None
        image = read_rgb(self.source)
        height, width = image.shape[:2]
        if (width, height) != (camera.width, camera.height):
            words = (
                f"has {width} x {height} px,"
                f" and the camera's pictures have {camera.width} x {camera.height};"
                " take it with this camera, or set camera.width and camera.height"
            )
            raise ParameterError("file", words, self.file)
        return image

    def under_its_light(self, image: Image, rng: np.random.Generator) -> Image:
        """A picture (H, W, 3) that was taken in the light of the run, as it is under the light of
        teaching.
        """
        if not self.other_light:
            return image
        made = self.contrast * (self.brightness * image.astype(np.float32) - MID_GREY) + MID_GREY
        made += rng.standard_normal(image.shape, dtype=np.float32) * np.float32(self.image_sigma)
        kept = np.clip(made + 0.5, 0, 255).astype(np.uint8)
        if self.jpeg_quality is None:
            return kept
        return round_trip(JpegStream(quality=self.jpeg_quality), 1.0)(kept)


class Task:
    """The task of a scenario, its `goal` block, with defaults for all but `kind` and `goal_poses`:
    one view, on any base.
    """

    # The word by which a law declares that it supports such tasks (`Law.tasks`)
    asks: ClassVar[str] = "view"
    # The bases of robots that can execute it
    bases: ClassVar[frozenset[Base]] = frozenset({"fixed", "planar", "floating"})
    # Whether it has no goal to reach, but an error to keep within a tolerance until the end
    continuing: ClassVar[bool] = False
    lands: ClassVar[bool] = False  # Whether it ends on the ground
    ends: ClassVar[Outcome] = Outcome.converged  # The outcome with which it is done
    # Whether the reference moves with time, so that `goal_poses` are points on a trajectory
    by_clock: ClassVar[bool] = False
    needs_pose: ClassVar[bool] = False
    """Whether the law needs the target's pose itself, so that its depth source must be one that
    estimates it.
    """
    needs_still: ClassVar[bool] = False  # Whether the target must stand still
    # The scenario's field of each goal view, for error messages; `goal` where there is none
    view_fields: ClassVar[tuple[str, ...]] = ()

    kind: Any  # The word in a scenario, a field of each task
    settle_s: Any = 0.0  # Settling time, after which the tolerance counts [s]

    @property
    def tolerance_m(self) -> float | None:
        """Of a continuing task, the largest permitted error once settled [m]; None for others."""
        return None

    @abstractmethod
    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        """T_camera_target (4, 4) at each goal view in turn, for a camera at this mount
        T_base_camera (4, 4).
        """
        ...

    def check(self, setup: Setup) -> None:
        """Refuse unsuitable robots, laws and targets. ParameterError names the field and what would
        work.
        """
        self._check_law(setup.law)
        self._check_base(setup.robot)
        if setup.target.painted_route is not None:
            words = (
                "needs markers, and lines on the floor have none; use goal: {kind: line} and law:"
                " {kind: line_following}"
            )
            raise ParameterError("goal", f"of kind {self.kind} {words}")
        if self.needs_still and setup.target.moves:
            words = (
                "needs a target that stands still;"
                " for one that moves use goal: {gap_m: ...} or {T_camera_target: ...}"
            )
            raise ParameterError("goal", f"of kind {self.kind} {words}")

    def _check_law(self, law: Law[Any]) -> None:
        if self.asks not in law.tasks:
            takes = " or ".join(law.tasks)
            what = f"of kind {self.kind} with law {law.kind}, which takes {takes}"
            raise ParameterError.excluded("goal", what)
        if self.needs_pose and not law.depth.needs_pose:
            words = f"{law.depth.kind} with law {law.kind}, which needs the pose itself"
            raise ParameterError.excluded("law.depth", words, works="floor or pnp")

    def _check_base(self, robot: Robot) -> None:
        if robot.base in self.bases:
            return
        what = f"{self.kind} with robot {robot.kind}"
        if self.bases == {"floating"}:
            why = "it is for a craft that flies (robot quadrotor)"
            raise ParameterError.excluded("goal", what, why=why)
        raise ParameterError.excluded(
            "goal", what, why="it is for a vehicle", works="T_camera_target"
        )

    @property
    def pictures(self) -> tuple[GoalPicture, ...]:
        """What is said of the picture at each goal view; () where nothing is: the simulated camera
        takes it.
        """
        return ()

    def check_views(self, setup: Setup, views: tuple[Goal, ...]) -> None:
        """Refuse goal views that do not show their markers, or at which a flying robot is not
        level. Raises ParameterError.
        """
        poses = self.goal_poses(setup.target, setup.camera.mount.T)
        fields = self.view_fields or ("goal",) * len(poses)
        for field, pose, view in zip(fields, poses, views, strict=True):
            check_visible(setup, field, pose, view.counted)
            if setup.robot.base != "floating":
                continue
            # z of the craft's base in the world's axes: its last component is the cosine of the
            # tilt, and a craft hovers level.
            up = (setup.target.T_world_start @ inverse(pose) @ inverse(setup.camera.mount.T))[2, 2]
            lean = math.degrees(math.acos(max(-1.0, min(1.0, float(up)))))
            if lean > LEVEL_DEG:
                words = (
                    f"is the view from a craft tilted by {lean:.3g} deg, and it hovers level;"
                    " turn the view, or camera.mount, by as much"
                )
                raise ParameterError(field, words)

    def goal_pose_at(
        self, setup: Setup, poses: tuple[Array, ...], t: float, view: int
    ) -> Array | None:
        """T_camera_target (4, 4) at the goal of a time [s] and a view, of `poses`, the
        `goal_poses`; None where no single pose is it.
        """
        return poses[view] if np.isfinite(poses[view]).all() else None

    def goal_views(self, setup: Setup) -> tuple[Goal, ...]:
        """The goals for the law: the views from the goal poses."""
        n = len(self.goal_poses(setup.target, setup.camera.mount.T))
        # i=i binds the number now: a plain closure would give every view the last pose.
        return tuple(
            view_from(setup, lambda mount, i=i: self.goal_poses(setup.target, mount)[i], i)
            for i in range(n)
        )

    def begin(self, setup: Setup, views: tuple[Goal, ...]) -> Any:
        """The initial state of the reference: here the first view, which stays the goal."""
        return views[0]

    def reference(self, state: Any, seen: Observation) -> tuple[Any, Goal]:
        """The next state, and the goal for the law at this frame: the current view."""
        return state, state

    def passed(self, state: Any, error: ImageError) -> tuple[Any, Goal | None]:
        """After a frame: the next state, and the new goal for which the law must be initialised
        again, if there is one.
        """
        return state, None

    def monitor(self, setup: Setup, supervisor: Supervisor) -> TaskMonitor:
        """What measures the task's error and decides when it is completed or failed; by default
        reached when `stop.converged` holds.
        """
        views = len(self.goal_poses(setup.target, setup.camera.mount.T))
        return TaskMonitor(setup, views, supervisor)

    def metrics(self, log: Log) -> dict[str, float | None]:
        """Summary figures of this task alone."""
        return {}

    def judged(self, log: Log, stop: Stop) -> JudgedError:
        """The error by which the task was judged, from the log of a run; by default the one that
        `stop.converged` tests.
        """
        return by_convergence(log, stop.converged)

    def distance_to_go_m(self, log: Log, goal_poses: tuple[Array, ...]) -> float:
        """Straight distance from the start of a run to its goal [m]: the first frame's position
        error.
        """
        return float(log["position_error_m"][0])


TaskBase = Task  # the name by which tasks of one's own derive from it


def view_from(setup: Setup, pose_with: Callable[[Array], Array], number: int = 0) -> Goal:
    """The goal for the law: the view from a goal pose.
    setup: the experiment's parts. pose_with: maps a mount T_base_camera (4, 4) to T_camera_target
    (4, 4) at the goal: where the goal is a place of the base, a wrong calibration of the mount
    displaces the believed goal view. number: of the view, among several in turn.
    """
    target = setup.target
    believed = setup.believed_camera
    scale = setup.depth_scale
    if setup.goal_shown:
        T = pose_with(setup.camera.mount.T)
        made = shown_goal(setup.camera, believed, target, T)
    else:
        T = pose_with(believed.mount.T)
        made = Goal.of_points(believed, target.points_at(T), T)
    if scale is not None:
        pose = made.T_camera_target
        # A shown goal is known by its picture alone, so that its pose is estimated with the wrong
        # depths, too.
        if setup.goal_shown:
            pose = pose_by_depth(pose, target.points, scale)
        made = replace(
            made,
            depth=made.depth * scale,
            range=made.range * scale,
            middle=made.middle * scale.mean(),
            T_camera_target=pose,
        )
    return replace(made, view=number) if number else made
