"""The contract of a plant, between the loop and the simulation, the simulator's truth, and the
plant that is an ideal camera.
"""

from __future__ import annotations

import contextlib
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, DepthImage, Image, Picture, Regions
from vstestbed.core.errors import ParameterError, UnreachableError
from vstestbed.core.geometry import Array, adjoint, exp, inverse
from vstestbed.imaging.shutter import Contribution, Rows
from vstestbed.robots import VEHICLES, Robot
from vstestbed.robots.base import Reading
from vstestbed.sim.scene.world import AWAY, World
from vstestbed.targets import Target
from vstestbed.targets.motion import Path
from vstestbed.timing.setpoints import Interpolator, SetpointBuffer, Stop

if TYPE_CHECKING:
    from vstestbed.sim.render.image_sensor import ImageSensor
    from vstestbed.sim.scene.scene import Scene

__all__ = [
    "IdealPlant",
    "OtherEye",
    "Plant",
    "PlantCamera",
    "Renderer",
    "SceneDescription",
    "Truth",
    "Viewpoint",
    "camera_start",
    "flange_for",
    "posture_at",
    "target_start",
]


@dataclass(frozen=True)
class SceneDescription:
    """The parts of a scene.

    `sights` are points that the outside view must show, besides the robot's start and the target
    [m]. `plate_m` is the edge of a plate in reserve, out of sight until a person holds it
    somewhere; 0 for none [m]. `others` are cameras besides the servo camera.
    """

    robot: Robot
    camera: Camera
    target: Target
    world: World
    step: float
    sights: tuple[tuple[float, float, float], ...] = ()
    plate_m: float = 0.0
    others: tuple[Viewpoint, ...] = ()

    def stands(self, eye: str) -> bool:
        """Whether a camera stands in the room, so that it sees what encloses the lens of one on the
        flange.
        """
        return any(other.stands for other in self.others if other.name == eye)

    @property
    def leader(self) -> Robot | None:
        """The vehicle that carries the target; None without one."""
        return None if self.target.carrier is None else VEHICLES[self.target.carrier.by]()

    @property
    def glossy(self) -> bool:
        """Whether the target is a picture that shows highlights, or the floor does."""
        sheet = self.target.sheet
        return self.world.floor.gloss > 0 or (sheet is not None and sheet.gloss > 0)

    @property
    def simulated(self) -> bool:
        """Whether MuJoCo is needed even without pictures: for a body, or what may hide markers."""
        solid = self.target.body is not None and not self.target.outlined
        return self.robot.body is not None or self.plate_m > 0 or self.world.hides or solid

    @property
    def steps_per_frame(self) -> int:
        """Physics steps between two pictures of the servo camera."""
        return round(self.camera.period / self.step)

    def setpoints(
        self, order_s: float = math.inf, interpolator: Interpolator | None = None
    ) -> SetpointBuffer:
        """The setpoints of a run.

        order_s: how long a command lasts before the robot stops [s]. interpolator: leads from one
        command to the next; None: at once.
        """
        robot = self.robot
        first = robot.onboard and robot.onboard.first_setpoint
        return SetpointBuffer(robot.stopping, first, order_s / self.step, self.step, interpolator)

    @property
    def T_world_target(self) -> Array:
        """Pose of the target at the start (4, 4)."""
        return target_start(self.robot, self.target)

    @property
    def start(self) -> tuple[Array, Array]:
        """Joints (n,) and the servo camera's pose (4, 4) at the nominal start."""
        return self.robot.start_joints(), camera_start(self.robot, self.camera, self.target)


class SceneState(NamedTuple):
    """A state of a scene, as a run's log has it.

    t: time [s]. T_world_target, T_world_camera: poses (4, 4). q: joints (n,).
    """

    t: float
    T_world_target: Array
    q: Array
    T_world_camera: Array


@dataclass(frozen=True)
class Viewpoint:
    """A further camera of a scene.

    name: of its camera and its site in the scene. camera: the lens, with its pose in what carries
    it. stands: it stands in the room; else the flange carries it.
    """

    name: str
    camera: Camera
    stands: bool = False

    def pose(self, T_world_flange: Array) -> Array:
        """Its pose (4, 4) where the flange is at one (4, 4)."""
        return self.camera.mount.T if self.stands else T_world_flange @ self.camera.mount.T


class Truth(NamedTuple):
    """Ground truth at one instant, for the log, the judge and the oracle detector, and for nothing
    else.

    Attributes:
        T_world_camera, T_world_target: poses (4, 4), camera in computer-vision axes.
        twist: true camera twist (6,) in the camera frame [m/s, rad/s]. q, qd, ctrl: joints [rad,
            rad/s] and actuator controls.
        p_camera: marker centres in the camera frame (N, 3) [m]. hidden: occluded markers, (N,)
            bool; all False where no detector needs it.
        contact: what a part of the robot other than its feet touches, as `forearm and floor`; ""
            where nothing does. feet: the same of its feet.
        act: activations of those of its actuators that have one. wind: velocity of the air in the
            world (3,) [m/s].
        effects: values of the columns of the robot's effects.
        tau: torques (forces of joints that slide) of the motors, referred to the joint, in the last
            physics step [Nm, N].
    """

    T_world_camera: Array
    T_world_target: Array
    twist: Array
    q: Array
    qd: Array
    ctrl: Array
    p_camera: Array
    hidden: NDArray
    contact: str
    feet: str
    act: Array
    wind: Array
    effects: tuple[float, ...] = ()
    tau: Array = np.zeros(0)


class Renderer(Protocol):
    """Renders the servo camera's images.

    Attributes:
        name: of the renderer, such as OpenGL's GL_RENDERER string. spent_s: wall time spent on
            images so far [s].
        whole: the last images are complete; no part was left blank.
        depth: true depth of each pixel (H, W) [m] of the last images that were asked for with it,
            inf where there is nothing.
    """

    name: str
    spent_s: float
    whole: bool
    depth: DepthImage | None

    def full_image(self) -> Image:
        """The camera's own image now, shape (H, W, 3) uint8 RGB, as a copy that the caller may
        keep.
        """
        ...

    def images(
        self, regions: Regions | None = None, with_depth: bool = False, rows: Rows | None = None
    ) -> tuple[Image | None, ...]:
        """The images now without noise, one for each panel, valid until the next call.

        regions: regions of interest, None for everything; the rest may be blank. with_depth: of a
        perspective camera, `depth` as well, of everything. rows: of a camera without panels, the
        only ones that are needed.
        """
        ...


class PlantCamera(ABC):
    """Takes the pictures of one camera of a plant, each with the truth then.

    step_s: the physics step [s]. steps_per_frame: how many of them lie between two pictures.
    sensor: takes the pictures; None where no detector needs them.
    """

    def __init__(self, step_s: float, steps_per_frame: int, sensor: ImageSensor | None):
        self.step_s = step_s
        self.steps_per_frame = steps_per_frame
        self._eye = sensor

    @property
    @abstractmethod
    def _t(self) -> float:
        """The time now [s]."""

    @abstractmethod
    def _show(self) -> None:
        """Bring the stage, from which pictures are taken, to the present time."""

    @abstractmethod
    def truth(self) -> Truth:
        """The truth, now."""

    @abstractmethod
    def reading(self) -> Reading:
        """The robot's sensor reading, now."""

    @property
    def render_s(self) -> float:
        """Wall time spent on pictures so far [s]."""
        return self._eye.spent_s if self._eye else 0.0

    def capture(self, regions: Regions | None = None) -> tuple[Picture | None, Truth]:
        """The picture (None where no detector needs one; valid until the next capture) and the
        truth, now.

        regions: the detector's regions of interest; None for everything. A copy of a picture of
        which only they were drawn can be completed until the next such picture is taken.
        """
        truth = self.truth()
        return self._eye.capture(self._t, regions) if self._eye else None, truth

    def with_own(self, picture: Picture) -> Picture:
        """A picture just taken with the camera's own image, where it has none: that of a lens with
        panels, `Picture.own`.
        """
        return self._eye.with_own(picture) if self._eye else picture

    def exposure_s(self) -> float | None:
        """Exposure time of the next picture as the camera's exposure control has set it [s]; None
        where nothing is pictured.
        """
        self._show()
        return self._eye.exposure_s(self._t) if self._eye else None

    def expose(
        self, weight: float | Contribution, regions: Regions | None = None, middle: bool = False
    ) -> None:
        """Add an image, as a share `weight` of one exposure, or of each of its rows; nothing where
        no detector needs pictures.

        regions: as `capture`'s, and the same for all images of an exposure. middle: it is that of
            the exposure's middle.
        """
        self._show()
        if self._eye is not None:
            self._eye.expose(weight, regions, middle)

    def developed(self, t: float) -> Picture | None:
        """The picture of all images added since the last one, stamped t [s]."""
        return self._eye.developed(t) if self._eye else None


class Plant(PlantCamera):
    """The simulated robot, camera and target. The clock counts whole physics steps.

    parts: of the scene. stage: the compiled scene; None for an ideal camera without pictures and
    occlusion. eye: takes the pictures; None where no detector needs them. path: the pose of a
    target that moves by itself as a function of time, else None. others: its further cameras by
    name.
    """

    _stage: Scene | None

    def __init__(
        self,
        parts: SceneDescription,
        stage: Scene | None,
        eye: ImageSensor | None,
        path: Path | None,
        setpoints: SetpointBuffer,
    ):
        super().__init__(parts.step, parts.steps_per_frame, eye)
        self._parts = parts
        self._stage = stage
        self._path = path
        self._target = parts.target
        self._own_path = path  # without what `move_target` has shifted
        self._steps = 0
        self.others = dict[str, OtherEye]()
        self._setpoints = setpoints

    @property
    def _t(self) -> float:
        return self._steps * self.step_s

    @property
    def target(self) -> Target:
        """What the cameras look at."""
        return self._target

    @abstractmethod
    def _actuate(self) -> None:
        """Put the setpoint in force into effect."""

    @abstractmethod
    def picture_from(self, T_world_flange: Array, q: Array | None = None) -> Picture:
        """A whole picture without noise with the flange at another pose (4, 4), an arm in its
        configuration q there.

        The plant keeps its state. Only of a plant that takes pictures.
        """

    @abstractmethod
    def pose_of(self, viewpoint: Viewpoint) -> Array:
        """Pose (4, 4) of a further camera, now."""

    def hidden(
        self, viewpoint: Viewpoint, T_world_camera: Array, p_camera: Array
    ) -> NDArray[np.bool_]:
        """Which marker centres (N, 3) are occluded for a further camera at a pose (4, 4)."""
        if self._stage is None:
            return np.zeros(len(p_camera), dtype=bool)
        return self._stage.hidden(T_world_camera, p_camera, viewpoint.name)

    def names_before(self, T_world_camera: Array, p_camera: Array) -> tuple[str, ...]:
        """What stands now before each of points p_camera (N, 3) of a camera at a pose (4, 4), by
        the name of its body; "" for nothing.
        """
        if self._stage is None:
            return ("",) * len(p_camera)
        return self._stage.names_before(T_world_camera, p_camera)

    def apply(self, setpoint: Array, stop: Stop = "") -> None:
        """Set the setpoint, which stays in force until the next one, or until it has lasted its
        time; or a stop in its place.
        """
        self._setpoints.give(self._steps, setpoint, stop)
        self._actuate()

    @abstractmethod
    def advance(self, steps: int) -> bool:
        """Advance by physics steps; False when the simulation became unstable."""

    @property
    def weight_n(self) -> float:
        """Weight of the robot [N]; 0 for an ideal camera."""
        return 0.0

    def push(self, force: Array, duration_s: float) -> None:
        """Push the robot with a force (3,) along world axes [N] for a while. ParameterError where
        it has no mass.
        """
        raise ParameterError.needs(
            "push", "a robot with a mass", why="this camera follows its twist exactly"
        )

    def move_target(self, T_world_target: Array) -> None:
        """Put the target at a pose (4, 4); one that moves goes on from there. ParameterError where
        it is carried.
        """
        if self._target.on_gripper or self._parts.leader is not None:
            raise ParameterError.excluded("target", "moved", why="it goes where its carrier goes")
        start = self._parts.T_world_target
        own = self._own_path or (lambda _: start)
        shift = T_world_target @ inverse(own(self._t))
        self._path = lambda t: shift @ own(t)

    def hold_plate(self, T_world_plate: Array | None) -> None:
        """Put the plate in reserve at a pose (4, 4), or away. ParameterError where the scene has
        none.
        """
        if self._stage is None or self._stage.hand_plate is None:
            raise ParameterError.missing("plate", "a session has one with plate_m=0.1")
        if T_world_plate is None:
            T_world_plate = np.eye(4)
            T_world_plate[:3, 3] = AWAY
        self._stage.put(self._stage.hand_plate, T_world_plate)

    def close(self) -> None:
        """Free pictures and physics."""
        if self._stage is not None:
            self._stage.close()


class OtherEye(PlantCamera):
    """A further camera of a plant.

    see_hidden: whether its detector needs the occlusion of markers.
    """

    def __init__(
        self,
        plant: Plant,
        viewpoint: Viewpoint,
        target: Target,
        sensor: ImageSensor | None,
        see_hidden: bool,
    ):
        super().__init__(plant.step_s, round(viewpoint.camera.period / plant.step_s), sensor)
        self._plant = plant
        self._viewpoint = viewpoint
        self._target = target
        self._see_hidden = see_hidden

    @property
    def _t(self) -> float:
        return self._plant._t

    def _show(self) -> None:
        self._plant._show()

    def reading(self) -> Reading:
        return self._plant.reading()

    def truth(self) -> Truth:
        """The truth, now: pose of this camera, and the markers in its frame; the twist is the servo
        camera's.
        """
        truth = self._plant.truth()
        T = self._plant.pose_of(self._viewpoint)
        p_camera = self._target.seen_from(inverse(truth.T_world_target) @ T)
        if self._see_hidden:
            hidden = self._plant.hidden(self._viewpoint, T, p_camera)
        else:
            hidden = np.zeros(len(p_camera), dtype=bool)
        return truth._replace(T_world_camera=T, p_camera=p_camera, hidden=hidden)


# Most postures from which the goal's is sought: Newton's steps find the Jaco's from every second
# one
POSTURES = 12


def camera_start(robot: Robot, camera: Camera, target: Target) -> Array:
    """Pose of the servo camera at the start (4, 4): on the robot, or in the room (eye to hand)."""
    if target.on_gripper:
        return camera.mount.T
    return robot.flange_pose(robot.configuration()) @ camera.mount.T


def target_start(robot: Robot, target: Target) -> Array:
    """Pose of the target at the start (4, 4)."""
    if target.on_gripper:
        return robot.flange_pose(robot.configuration()) @ target.pose.T
    return target.T_world_start


def flange_for(camera: Camera, target: Target, T_camera_target: Array) -> Array:
    """Pose of the flange (4, 4) with which the camera sees the target, where it is at the start, at
    T_camera_target (4, 4).
    """
    if target.on_gripper:
        return camera.mount.T @ T_camera_target @ inverse(target.pose.T)
    return target.T_world_start @ inverse(camera.mount.T @ T_camera_target)


def posture_at(robot: Robot, T_world_flange: Array) -> Array:
    """The configuration of an arm at a flange pose (4, 4): from the nominal start, else from the
    first of POSTURES others that gets there.

    Raises UnreachableError: it does not get there.
    """
    rng = np.random.default_rng(0)
    nominal = robot.configuration()
    for _ in range(POSTURES):
        with contextlib.suppress(UnreachableError):
            return robot.configuration_at(T_world_flange, nominal)
        nominal = robot.configuration() + rng.uniform(-np.pi, np.pi, len(nominal))
    return robot.configuration_at(T_world_flange, nominal)


# The ideal plant: a camera that follows its twist exactly. It needs MuJoCo only for pictures and
# occlusion.
NONE = np.zeros(0)
STILL_AIR = np.zeros(3)
NO_JOINTS = Reading(NONE, NONE)


class IdealPlant(Plant):
    """T_world_camera <- T_world_camera exp([v] dt), v the camera's twist for the flange twist in
    force, the setpoint.
    """

    def __init__(self, parts: SceneDescription, *of_plant: Any):
        super().__init__(parts, *of_plant)
        self._T = parts.start[1]
        self._T_camera_flange = inverse(parts.camera.mount.T)
        self._to_camera = adjoint(self._T_camera_flange)
        self._T_world_target = parts.target.pose.T
        self._T_target_world = inverse(self._T_world_target)
        self._twist = np.zeros(6)
        self._followed: Array | None = None
        self._hidden = np.zeros(len(self._target.points), dtype=bool)

    def truth(self) -> Truth:
        """The truth, now; it also updates the stage, from which pictures are taken."""
        T = self._T  # never written to: `advance` makes a new one
        self._show()  # before the cast of rays, and before the picture that `capture` takes next
        p_camera = self._target.seen_from(self._T_target_world @ T)
        hidden = self._hidden if self._stage is None else self._stage.hidden(T, p_camera)
        return Truth(
            T,
            self._T_world_target,
            self._twist,
            NONE,
            NONE,
            NONE,
            p_camera,
            hidden,
            contact="",
            feet="",
            act=NONE,
            wind=STILL_AIR,
        )

    def picture_from(self, T_world_flange: Array, q: Array | None = None) -> Picture:
        """A whole picture without noise with the flange at another pose (4, 4)."""
        assert self._stage is not None and self._eye is not None
        with self._stage.kept():
            self._stage.place(
                self._t, self._T_world_target, NONE, T_world_flange @ self._parts.camera.mount.T
            )
            return self._eye.clean(self._t)

    def pose_of(self, viewpoint: Viewpoint) -> Array:
        """Pose (4, 4) of a further camera, now."""
        return viewpoint.pose(self._T @ self._T_camera_flange)

    def _show(self) -> None:
        if self._path is not None:
            self._T_world_target = self._path(self._t)
            self._T_target_world = inverse(self._T_world_target)
        if self._stage is not None:
            self._stage.place(self._t, self._T_world_target, NONE, self._T)

    def reading(self) -> Reading:
        return NO_JOINTS

    def _actuate(self) -> None:
        setpoint = self._setpoints.at(self._steps)
        if setpoint is not None and setpoint is not self._followed:
            self._followed = setpoint
            self._twist = self._to_camera @ setpoint

    def advance(self, steps: int) -> bool:
        """Advance by exact exponentials: no integration error, however many steps each stands for.
        False beyond all numbers.
        """
        end = self._steps + steps
        while self._steps < end:
            ahead = self._setpoints.unchanged(self._steps, end - self._steps)
            try:
                self._T = self._T @ exp(self._twist * (ahead * self.step_s))
            except (ValueError, OverflowError):  # a twist so large that its square overflows
                return False
            self._steps += ahead
            self._actuate()
        return True
