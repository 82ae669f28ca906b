"""Builds the plant of a scenario, and the files of its scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vstestbed.camera import Camera, Perspective
from vstestbed.imaging.sensor import NO_DRIFT, Drift, ImageNoise
from vstestbed.sim.base import IdealPlant, OtherEye, Plant, SceneDescription, Viewpoint
from vstestbed.targets import Target
from vstestbed.targets.motion import Path
from vstestbed.timing.setpoints import SetpointBuffer
from vstestbed.vision.perturb import Perturbed

if TYPE_CHECKING:
    from vstestbed.sim.render.image_sensor import ImageSensor
    from vstestbed.sim.scene.scene import Scene

__all__ = ["PictureSetup", "build_plant", "scene_files"]


class PictureSetup(NamedTuple):
    """What becomes of a camera's pictures.

    needs_image, needs_truth: whether its detector works on pictures, on truth. image_sigma, rng:
    noise [grey levels] and its generator.
    depth_rng, imaging_rng: generators of the noise of the depth camera and of the image sensor
    (`camera.sensor`). drift: of the camera's gains. perturbed: further changes of the pictures;
    None for none.
    """

    needs_image: bool
    needs_truth: bool
    image_sigma: float = 0.0
    rng: np.random.Generator | None = None
    depth_rng: np.random.Generator | None = None
    imaging_rng: np.random.Generator | None = None
    drift: Drift = NO_DRIFT
    perturbed: Perturbed | None = None


NO_PICTURES = PictureSetup(needs_image=False, needs_truth=False)
NO_OTHERS: Mapping[str, PictureSetup] = {}


def build_plant(
    scene: SceneDescription,
    pictures: PictureSetup = NO_PICTURES,
    *,
    sensor_rng: np.random.Generator | None = None,
    motion_rng: np.random.Generator | None = None,
    setpoints: SetpointBuffer | None = None,
    others: Mapping[str, PictureSetup] = NO_OTHERS,
) -> tuple[Plant, str]:
    """The plant, and the name of its renderer ("none" without pictures).

    Robots with a body are simulated by MuJoCo. The ideal camera needs MuJoCo only for pictures, or
    for occlusion by plates and scenery.
    Raises EnvironmentLackError: a picture is needed that only OpenGL can draw, and it does not work
    here.

    Args:
        pictures, others: of the servo camera, and of the further ones by name (`Plant.others`);
            none where nothing is said.
        sensor_rng, motion_rng: generators of the robot's sensor noise, and of a target's random
            walk.
        setpoints: of the run; None: each command acts at once, until the next.
    """
    stage = eye = None
    renderer = "none"
    if scene.simulated or any(one.needs_image for one in (pictures, *others.values())):
        # Here, and in the functions below: a run with the ideal camera and the oracle starts
        # without loading any renderer.
        from vstestbed.sim.scene.scene import Scene

        others_samples = (view.camera.multisampling for view in scene.others)
        stage = Scene(scene, samples=max(0, scene.camera.multisampling, *others_samples))
        if pictures.needs_image:
            eye, renderer = _sensor(stage, scene.camera, "eye", pictures)
    path = _path(scene.target, motion_rng)
    setpoints = setpoints or scene.setpoints()
    if stage is None or scene.robot.body is None:
        plant: Plant = IdealPlant(scene, stage, eye, path, setpoints)
    else:
        from vstestbed.sim.plant import MujocoPlant

        rng = _given(sensor_rng)
        plant = MujocoPlant(stage, eye, pictures.needs_truth, rng, path, setpoints)
    for view in scene.others:
        plant.others[view.name] = _other_eye(plant, view, others.get(view.name, NO_PICTURES), stage)
    return plant, renderer


def _path(target: Target, rng: np.random.Generator | None) -> Path | None:
    return target.path(_given(rng)) if target.motion.by_itself else None


def _other_eye(
    plant: Plant, view: Viewpoint, pictures: PictureSetup, stage: Scene | None
) -> OtherEye:
    sensor = None
    if stage is not None and pictures.needs_image:
        sensor, _ = _sensor(stage, view.camera, view.name, pictures)
    return OtherEye(plant, view, plant.target, sensor, pictures.needs_truth)


def _sensor(
    stage: Scene, camera: Camera, eye: str, pictures: PictureSetup
) -> tuple[ImageSensor, str]:
    """The sensor of a camera of a stage, and the name of what draws its images."""
    from vstestbed.imaging.chain import Chain
    from vstestbed.sim.render.image_sensor import DepthCamera, ImageSensor
    from vstestbed.sim.render.pictures import servo_renderer

    # With a rolling shutter bands of rows are drawn: the sensor itself adds the rows from which the
    # noise is estimated.
    noisy = pictures.image_sigma > 0 and not camera.readout_s
    drawn_by = servo_renderer(stage, camera, noisy, eye=eye)
    depth = None
    if isinstance(camera, Perspective) and camera.depth_sensor is not None:
        depth = DepthCamera(camera, camera.depth_sensor, _given(pictures.depth_rng))
    changed = None if pictures.perturbed is None else pictures.perturbed.next_picture
    chain = Chain(
        camera.imaging(pictures.imaging_rng),
        ImageNoise(pictures.image_sigma, pictures.rng),
        pictures.drift,
        changed,
    )
    return ImageSensor(stage, drawn_by, chain, depth, camera), drawn_by.name


def _given(rng: np.random.Generator | None) -> np.random.Generator:
    """A generator; that of seed 0 where none is given."""
    return rng or np.random.default_rng(0)


def scene_files(scene: SceneDescription) -> tuple[str, dict[str, bytes]]:
    """The compiled scene as MJCF, and the asset files that it names, by their paths relative to it.

    Its keyframe `start` is the whole state in which a run begins, with what the servos have
    integrated to carry the load; its numbers have all digits. With the controls of the log MuJoCo
    alone does what the run did. Raises UnreachableError: motors that cannot hold the start.
    """
    from vstestbed.core.geometry import quaternion_wxyz
    from vstestbed.sim.plant import MujocoPlant
    from vstestbed.sim.scene.compose import compose
    from vstestbed.sim.scene.meshes import TARGET_GROUP
    from vstestbed.sim.scene.model_files import exact_xml
    from vstestbed.sim.scene.scene import Scene

    robot = scene.robot
    if robot.body is None:
        spec = compose(scene)
        T = robot.flange_pose(robot.configuration())
        body = spec.body("robot/camera")
        body.pos = T[:3, 3]
        body.quat = quaternion_wxyz(T[:3, :3])
    else:
        stage = Scene(scene)
        spec = stage.spec
        state = stage.data
        plant = MujocoPlant(stage, None, False, _given(None), _path(scene.target, None))
        own = {
            "qpos": state.qpos,
            "act": state.act,
            "ctrl": state.ctrl,
            "mpos": state.mocap_pos,
            "mquat": state.mocap_quat,
        }
        spec.add_key(name="start", **{name: values.flatten() for name, values in own.items()})
        plant.close()
    for geom in spec.geoms:
        if geom.group == TARGET_GROUP:  # MuJoCo's viewer shows groups 0 to 2 by itself
            geom.group = 0
    spec.compile()
    return exact_xml(spec), dict(spec.assets)
