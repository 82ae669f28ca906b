"""Builds the plant of a scenario, and the files of its scene."""

from __future__ import annotations

import math

import numpy as np

from vstestbed.camera import Camera, Perspective
from vstestbed.imaging.sensor import NO_DRIFT, Drift, ImageNoise
from vstestbed.robots import Robot
from vstestbed.robots.base import longest_step
from vstestbed.sim.base import Plant
from vstestbed.sim.scene.world import World
from vstestbed.targets.base import Target
from vstestbed.timing.clock import Clock
from vstestbed.timing.setpoints import Interpolator
from vstestbed.vision.perturb import Perturbed


def build_plant(
    robot: Robot,
    camera: Camera,
    target: Target,
    world: World,
    clock: Clock,
    *,
    needs_image: bool,
    needs_truth: bool,
    image_sigma: float = 0.0,
    rng: np.random.Generator | None = None,
    depth_rng: np.random.Generator | None = None,
    sensor_rng: np.random.Generator | None = None,
    motion_rng: np.random.Generator | None = None,
    imaging_rng: np.random.Generator | None = None,
    drift: Drift = NO_DRIFT,
    perturbed: Perturbed | None = None,
    order_s: float = math.inf,
    interpolator: Interpolator | None = None,
    plate_m: float = 0.0,
) -> tuple[Plant, str]:
    """The plant, and the name of its renderer ("none" without pictures).

    Robots with a body are simulated by MuJoCo. The ideal camera needs MuJoCo only for pictures, or for occlusion by plates and scenery.
    Raises EnvironmentLackError: a picture is needed that only OpenGL can draw, and it does not work here.

    Args:
        needs_image, needs_truth: whether the detector works on pictures, on truth.
        image_sigma, rng: noise of the pictures [grey levels] and its generator.
        depth_rng, sensor_rng, motion_rng: generators of the depth camera's noise, of the robot's sensor noise, of a target's random walk.
        imaging_rng: generator of the image sensor's noise (`camera.sensor`).
        drift: of the camera's gains. perturbed: further changes of the pictures; None for none.
        order_s: how long a command lasts before the robot stops [s]. interpolator: leads from one command to
            the next; None: at once.
        plate_m: edge of a plate in reserve, for `Plant.hold_plate`; 0 for none [m].
    """
    # Imports within functions: a run with the ideal camera and the oracle then starts without loading any renderer.
    from vstestbed.sim.base import SceneDescription
    from vstestbed.sim.ideal import IdealPlant

    step, steps_per_frame = clock.resolve(camera, longest_step(robot))
    parts = SceneDescription(robot, camera, target, world, step, plate_m=plate_m)
    ideal = robot.body is None
    path = target.path(_given(motion_rng)) if target.motion.by_itself else None
    may_hide = world.hides or (target.body is not None and not target.outlined)
    if ideal and not (needs_image or plate_m or may_hide):
        return IdealPlant(parts, steps_per_frame, None, None, path, order_s, interpolator), "none"
    from vstestbed.imaging.chain import Chain
    from vstestbed.sim.render.image_sensor import DepthCamera, ImageSensor
    from vstestbed.sim.render.pictures import servo_renderer
    from vstestbed.sim.scene.scene import Scene

    stage = Scene(parts, samples=camera.multisampling)
    eye, renderer = None, "none"
    if needs_image:
        # With a rolling shutter bands of rows are drawn: the sensor itself adds the rows from which the noise is estimated.
        drawn_by = servo_renderer(stage, camera, image_sigma > 0 and not camera.readout_s)
        depth = None
        if isinstance(camera, Perspective) and camera.depth_sensor is not None:
            depth = DepthCamera(camera, camera.depth_sensor, _given(depth_rng))
        changed = None if perturbed is None else perturbed.next_picture
        chain = Chain(camera.imaging(imaging_rng), ImageNoise(image_sigma, rng), drift, changed)
        eye, renderer = ImageSensor(stage, drawn_by, chain, depth), drawn_by.name
    if ideal:
        return IdealPlant(parts, steps_per_frame, stage, eye, path, order_s, interpolator), renderer
    from vstestbed.sim.plant import MujocoPlant

    return MujocoPlant(stage, steps_per_frame, eye, needs_truth, _given(sensor_rng), path, order_s, interpolator), renderer


def _given(rng: np.random.Generator | None) -> np.random.Generator:
    """A generator; that of seed 0 where none is given."""
    return rng or np.random.default_rng(0)


def scene_files(
    robot: Robot, camera: Camera, target: Target, world: World, clock: Clock, sights: tuple[tuple[float, float, float], ...] = ()
) -> tuple[str, dict[str, bytes]]:
    """The compiled scene as MJCF, and the asset files that it names, by their paths relative to it.
    Its keyframe `start` is the nominal start. sights: points that the outside view must show [m].
    """
    from vstestbed.core.geometry import quaternion_wxyz
    from vstestbed.sim.base import SceneDescription
    from vstestbed.sim.scene.compose import compose
    from vstestbed.sim.scene.scene import Scene

    parts = SceneDescription(robot, camera, target, world, clock.resolve(camera, longest_step(robot))[0], sights)
    if robot.body is None:
        spec, T = compose(parts), robot.flange_pose(robot.configuration())
        body = spec.body("robot/camera")
        body.pos, body.quat = T[:3, 3], quaternion_wxyz(T[:3, :3])
    else:
        stage = Scene(parts)
        spec = stage.spec
        stage.place(0.0, parts.T_world_target, *parts.start)
        stage.rest()
        spec.add_key(name="start", qpos=stage.data.qpos.copy(), act=stage.data.act.copy(), ctrl=stage.data.ctrl.copy())
        stage.close()
    spec.compile()
    return spec.to_xml(), dict(spec.assets)
