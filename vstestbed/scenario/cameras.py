"""Cameras besides the one of the law: their blocks in a scenario, and what a run needs of each."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from vstestbed.camera import CAMERAS, Calibration, Camera, Perspective
from vstestbed.camera.intrinsics import read_calibration
from vstestbed.core.errors import ParameterError, within
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.quantity import PositiveGain
from vstestbed.core.spec import FromFile, spec
from vstestbed.features.depth import DepthSource, PnP
from vstestbed.features.observation import Goal
from vstestbed.laws.base import inputs_of
from vstestbed.robots.arm import Arm
from vstestbed.scenario.checks import MOST_MOUNT_M, MOST_PLACE_M, check_detected, check_length
from vstestbed.scenario.distributions import DEPTH_STREAM, PERTURB_STREAM
from vstestbed.scenario.noise import Noise
from vstestbed.sim.base import Viewpoint
from vstestbed.timing.plan import Timing
from vstestbed.vision import DETECTORS, Detector
from vstestbed.vision.observe import shown_goal
from vstestbed.vision.perturb import Perturbed

if TYPE_CHECKING:
    from vstestbed.robots import Robot
    from vstestbed.scenario.scenario import Scenario
    from vstestbed.sim.scene.world import World
    from vstestbed.targets import Target

__all__ = ["OWN", "FurtherCamera", "OtherCamera", "check_cameras", "eyes_of"]

# least distance between the lenses of a pair [m]: nearer they are in one place but for rounding
LEAST_BASELINE_M = 1e-6
OWN = "camera"  # name of the law's own camera where several are listed
RESERVED = (OWN, "eye", "overview", "robot", "target", "leader", "scenery", "floor", "truth")
_NAME = re.compile(r"[a-z][a-z0-9_]{0,30}")


@spec
class FurtherCamera:
    """A camera besides the one of the law (`camera`), with a rate, a latency and a detector of its
    own.

    Its pictures arrive when they arrive; at each picture of `camera` the law has the last
    observation of every other one.

    Args:
        camera: lens, size, rate and latency of its pictures, and where it is mounted.
        on: what carries it: the robot's `flange` (of a vehicle its body), or the `world`, in whose
            frame `camera.mount` is then its pose.
        detector: how markers are found in its pictures; None: as in those of `camera`; e.g.
            `blobs`.
        noise: of its pictures and measured coordinates; None: that of the scenario; e.g.
            `{pixel_sigma_px: 0.5}`.
        calibration: the calibration that robot, detector, observer and law work with: its errors,
            or the name of its file.
        weight: of its squared errors in pixels in the fused pose (`fusion`), beside those of
            `camera` [1].
    """

    camera: Annotated[Camera, CAMERAS] = Perspective()
    on: Literal["flange", "world"] = "flange"
    detector: Annotated[Detector[Any], DETECTORS] | None = None
    noise: Noise | None = None
    calibration: Annotated[Calibration, FromFile(read_calibration)] = Calibration()
    weight: PositiveGain = 1.0


@dataclass(frozen=True)
class OtherCamera:
    """A further camera in its scenario. It has the names that a Scenario has for its own camera, so
    that both are used alike.

    scenario: to which it belongs. name: of the camera; number: its place among them, from 1 on.
    """

    scenario: Scenario
    name: str
    number: int

    @property
    def block(self) -> FurtherCamera:
        """As the scenario has it."""
        return self.scenario.cameras[self.name]

    @property
    def camera(self) -> Camera:
        """The true lens."""
        return self.block.camera

    @cached_property
    def believed_camera(self) -> Camera:
        """The camera as calibrated."""
        return self.calibration.believed(self.camera)

    @property
    def calibration(self) -> Calibration:
        """Its calibration."""
        return self.block.calibration

    @property
    def detector(self) -> Detector[Any]:
        """Finds markers in its pictures."""
        return self.block.detector or self.scenario.detector

    @property
    def noise(self) -> Noise:
        """Of its pictures and measured coordinates."""
        return self.block.noise or self.scenario.noise

    @property
    def stands(self) -> bool:
        """Whether it stands in the room."""
        return self.block.on == "world"

    @property
    def rigid(self) -> bool:
        """Whether it and the law's camera move as one, so that their twists are one motion: both on
        the flange, or both in the room.
        """
        return self.stands == self.scenario.target.on_gripper

    @property
    def needs_image(self) -> bool:
        """Whether pictures are taken."""
        return self.detector.needs_image

    @property
    def draws(self) -> bool:
        """Whether the seed makes a difference to what it tells."""
        return measured_draws(self)

    @cached_property
    def depth_scale(self) -> Array | None:
        """Ratio of each marker's assumed depth to the true one in this run, shape (N,); None for
        exact depths.
        """
        return self.calibration.depth_scale(len(self.target.points), self.rng(DEPTH_STREAM))

    @property
    def reads_depth(self) -> bool:
        """Whether depth pictures are read."""
        return self.depth.measured

    @property
    def robot(self) -> Robot:
        """The scenario's."""
        return self.scenario.robot

    @property
    def target(self) -> Target:
        """The scenario's."""
        return self.scenario.target

    @property
    def timing(self) -> Timing:
        """The scenario's."""
        return self.scenario.timing

    @property
    def world(self) -> World:
        """The scenario's."""
        return self.scenario.world

    @property
    def viewpoint(self) -> Viewpoint:
        """Where it is in the scene."""
        return Viewpoint(self.name, self.camera, self.stands)

    @property
    def depth(self) -> DepthSource:
        """The law's source of depth, where this camera has it; else the pose."""
        own: DepthSource = self.scenario.law.depth
        unmeasured = own.measured and self.camera.depth_sensor is None
        unknown = own.true and not self.detector.needs_truth
        if unmeasured or unknown or own.camera or own.on_floor:
            return PnP()
        return own

    @property
    def required_fields(self) -> tuple[str, ...]:
        """The fields of an Observation of it that are used: those of the law, the pose where poses
        are fused, rays where depths are.
        """
        used = tuple(
            name
            for name in inputs_of(self.scenario.law)
            if name in ("xy", "xyw", "depth", "ray", "range", "T_camera_target")
        )
        if self.scenario.fusion == "pose":
            used += ("T_camera_target",)
        if self.scenario.law.depth.camera == self.name:
            used += ("ray",)
        return used

    def rng(self, stream: int) -> np.random.Generator:
        """The generator of one of the independent streams, another one than that of the law's
        camera.
        """
        return np.random.default_rng([self.scenario.seed, stream, self.number])

    def perturbed(self) -> Perturbed | None:
        """The perturbations of a run, with what is drawn for it; None where there are none."""
        kinds = self.noise.perturb
        return Perturbed(kinds, self.rng(PERTURB_STREAM)) if kinds else None

    def T_camera_eye(self, q: Array, mount: Array) -> Array:
        """Pose (4, 4) of this camera in the frame of the law's camera by what the robot knows: its
        joints q (n,), the calibrations.

        mount: of the law's camera as calibrated (4, 4); eye to hand its pose in the world. Of a
        camera in the room the robot must be an arm.
        """
        if not self.rigid:
            mount = self.robot.flange_pose(q) @ mount
        return inverse(mount) @ self.believed_camera.mount.T

    def goal(self, goal: Goal, T_camera_eye: Array) -> Goal:
        """What it sees at a goal view of the law's camera, for T_camera_eye (4, 4) there, with the
        markers that count there.

        Of a calibration whose goal is `shown`, that is what the true camera records there.
        """
        believed = self.believed_camera
        wrong = self.calibration
        if wrong.goal == "shown" and not wrong.camera_exact and self.rigid:
            rig = inverse(self.scenario.camera.mount.T) @ self.camera.mount.T
            T = inverse(rig) @ self.scenario.goal_poses[goal.view]
            made = shown_goal(self.camera, believed, self.target, T)
        else:
            T = inverse(T_camera_eye) @ goal.T_camera_target
            made = Goal.of_points(believed, self.target.points_at(T), T)
        return replace(made, counted=goal.counted, view=goal.view, moves=goal.moves)


def measured_draws(view: Scenario | OtherCamera) -> bool:
    """Whether the seed makes a difference to what is measured in a camera's pictures."""
    sensed = view.needs_image and view.camera.sensor is not None
    noise = view.noise.draws(view.needs_image, view.detector.rows != 0)
    return sensed or noise or view.calibration.draws or view.detector.draws


def eyes_of(scenario: Scenario) -> dict[str, OtherCamera]:
    """The further cameras of a scenario by name."""
    return {
        name: OtherCamera(scenario, name, number)
        for number, name in enumerate(scenario.cameras, start=1)
    }


def check_cameras(scenario: Scenario) -> None:
    """Refuse further cameras with names or rates that do not fit, and uses of cameras that there
    are not. Raises ParameterError.
    """
    eyes = scenario.eyes
    for name, eye in eyes.items():
        with within(f"cameras.{name}"):
            _check_camera(scenario, eye)
    _check_uses(scenario.law, eyes)
    pair = scenario.law.depth.camera
    if pair:
        _check_pair(scenario, eyes[pair])
    if scenario.fusion == "none":
        return
    if not eyes:
        raise ParameterError.needs("fusion", "further cameras (`cameras`)")
    if scenario.detector.rows is not None:
        what = f"pose with detector {scenario.detector.kind}"
        why = "fuses poses of the target by its markers"
        raise ParameterError.excluded("fusion", what, why=why)


def _check_uses(law: Any, eyes: dict[str, OtherCamera]) -> None:
    """Refuse cameras that a law names and that there are not, or that do not move as its own."""
    for field, name in _uses(law):
        if name not in eyes:
            valid = list(eyes) or ["none: there are no further cameras"]
            raise ParameterError.choice(field, valid, name)
        if not eyes[name].rigid:
            words = (
                f"must name a camera that moves as the law's own does, and {name} does not;"
                " works: fusion: pose"
            )
            raise ParameterError(field, words, name)
    if law.cameras and not getattr(law, "law", law).stacks:
        able = "laws of an error and its Jacobian, such as ibvs and pbvs"
        raise ParameterError.only_for("law.cameras", able, law.kind)


def _uses(law: Any) -> Iterator[tuple[str, str]]:
    """Where a law, or one within it, names a camera, and which."""
    if law.depth.camera:
        yield "law.depth.camera", law.depth.camera
    yield from ((f"law.cameras.{name}", name) for name in law.cameras)
    for part in getattr(law, "laws", ()):
        yield from _uses(part.law)


def _check_camera(scenario: Scenario, eye: OtherCamera) -> None:
    if not _NAME.fullmatch(eye.name) or eye.name in RESERVED:
        words = f"must have a name of small letters, digits and _ other than {', '.join(RESERVED)}"
        raise ParameterError("", words, eye.name)
    camera = eye.camera
    detector = eye.detector
    step = scenario.clock[0]
    frames = camera.period / step
    if abs(round(frames) - frames) > 1e-6 * frames:
        words = (
            f"must be that of pictures a whole number of physics steps of {step:g} s apart;"
            f" {1 / (round(frames) * step):.6g} Hz is"
        )
        raise ParameterError("camera.rate_hz", words, camera.rate_hz)
    eye.timing.check(camera, step)
    if detector.rows is not None:
        why = "further cameras see the target's markers; works: blobs, tags or raw"
        raise ParameterError.excluded("detector", detector.kind, why=why)
    check_detected(eye.target, detector, scenario.law)
    most_m = MOST_MOUNT_M if eye.rigid else MOST_PLACE_M
    check_length("camera.mount", camera.mount.T, most_m)
    if not eye.stands and eye.target.on_gripper:
        why = "on the flange it sees a target in the gripper always alike"
        raise ParameterError.fixed("on", "world", "flange", why=why)
    if not eye.rigid and not isinstance(eye.robot, Arm):
        words = (
            f"must be flange for robot {eye.robot.kind},"
            " which does not know its place in the room; an arm does"
        )
        raise ParameterError("on", words, "world")


def _check_pair(scenario: Scenario, eye: OtherCamera) -> None:
    """Refuse a pair whose pictures are not taken at the same times, or whose lenses lie in one
    place, for depths by triangulation.
    """
    own = scenario.camera
    for name in ("rate_hz", "latency_s"):
        wanted = getattr(own, name)
        found = getattr(eye.camera, name)
        if found != wanted:
            field = f"cameras.{eye.name}.camera.{name}"
            words = (
                f"{wanted:g}, as camera.{name} is:"
                " depths are triangulated from pictures of the same time"
            )
            raise ParameterError.bound(field, "equal to", words, found)
    baseline = own.mount.T[:3, 3] - eye.camera.mount.T[:3, 3]
    if np.linalg.norm(baseline) < LEAST_BASELINE_M:
        raise ParameterError("law.depth.camera", "must name a camera at another place", eye.name)
