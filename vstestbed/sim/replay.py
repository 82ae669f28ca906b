"""A recorded run again: images from any camera, since the log has all poses, and the least time
that its physics and images take.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

from vstestbed.camera import Image, Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.imaging.chain import Chain
from vstestbed.imaging.sensor import NO_DRIFT, Drift, ImageNoise
from vstestbed.sim.base import SceneDescription, SceneState
from vstestbed.sim.render.image_sensor import ImageSensor
from vstestbed.sim.render.pictures import bare_renderer, outside_view, servo_renderer
from vstestbed.sim.render.still import StillView, half_tangents, pixels_per_radian
from vstestbed.sim.scene.follow import FixedView, FollowCamera, Things
from vstestbed.sim.scene.joint_chain import names_of
from vstestbed.sim.scene.meshes import Pane, Solid, panes, solids, texels_of
from vstestbed.sim.scene.overview import LEAST_REACH
from vstestbed.sim.scene.scene import Scene
from vstestbed.targets.base import Target

__all__ = ["FREE", "Replay", "Rerendering", "measure_baseline"]

FILM_SHADOW_PX = 2048  # shadow map of the outside view: half of MuJoCo's default

FILM_SLICES = 20
FILM_STACKS = 12
FILM_QUADS = 2
"""Facets of round geoms in it: a cylinder of 40 px deviates from its circle by .25 px. MuJoCo's 28,
16 and 4 make twice the work, which for a base with 36 rollers was a third of an image's time.
"""


FREE = 0.74  # Share of the outside view's width, from the left, without an inset
OUTSIDE_ASPECT = 0.95  # width over height of the view that `outside_view` fits
FLOOR = (64, 84, 108), (56, 75, 98)
"""The two colours of the floor in films: light arms, dark cars and lines of any hue stand out from
a slate blue.
"""
SKY = 0.62, 0.69, 0.78  # factors of the sky's colours in films, before which light lines stand out
FLOOR_M = 80.0  # half of the floor's edge in films [m]: its end is not in the picture
AMBIENT = 0.40
KEY = 0.72
FILL = 0.22
"""Brightness of the lights in films: more from one side than the servo camera's, so that edges
between faces show.
"""


class Replay:
    """Renders a recorded run on a stage of its own, so that filming does not affect the run.

    The servo camera is shown without noise, and through its lens, exposure, sensor and stream as
    they are at rest (`Imaging.clean`). Raises EnvironmentLackError: OpenGL is asked for, and does
    not work here.

    Args:
        scene: of the run. shadows: render shadows in the outside views (three times the work).
            samples: multisampling of them, for smooth edges.
        share: size of the servo camera's images as a share of its own (see `servo_renderer`).
        view: where the camera `overview` stands; None: it follows the robot.
    """

    def __init__(
        self,
        scene: SceneDescription,
        shadows: bool = True,
        samples: int = 0,
        share: float = 1.0,
        view: FixedView | None = None,
    ):
        self._parts = scene
        self._stage = Scene(scene, samples=samples)
        quality = self._stage.model.vis.quality
        quality.shadowsize = FILM_SHADOW_PX
        quality.numslices = FILM_SLICES
        quality.numstacks = FILM_STACKS
        quality.numquads = FILM_QUADS
        _repaint(self._stage.model)
        self._shadows = shadows
        self._share = share
        self._things = Things(self._stage.model)
        self._follow: FollowCamera | None = None
        self._view = view
        self._seen: tuple[float, Image] | None = None
        self._own: dict[str, tuple[Scene, Callable[[], Image]]] = {}
        self._lenses = {"eye": scene.camera} | {other.name: other.camera for other in scene.others}
        self._views: dict[str, tuple[StillView, Perspective]] = {}

    def of_target(self, target: Target) -> Replay:
        """Another replay, of the same scene with this target, whose servo camera gives images of
        the same size; it is to be closed.
        """
        parts = replace(self._parts, target=target, others=())
        return Replay(parts, self._shadows, share=self._share)

    @property
    def cameras(self) -> list[str]:
        """Names of the cameras that pictures can be taken from."""
        return names_of(self._stage.model, "cam")

    def picture(
        self,
        camera: str,
        size: tuple[int, int],
        state: SceneState,
        T_world_goal: Array | None = None,
    ) -> Image:
        """One picture (H, W, 3) uint8 of a size (width, height); the servo camera `eye` and further
        cameras have lenses of their own, and `share` of their size whatever `size` says.

        `overview` follows the robot from picture to picture, so that it, the target and
        T_world_goal, the servo camera's goal pose (4, 4), are in sight. Raises ParameterError:
        there is no such camera.
        """
        if camera not in self.cameras:
            raise ParameterError.choice("--camera", self.cameras, camera)
        if camera in self._lenses:
            stage, view = self._own_lens(camera)
            stage.place(*state)
            image = view()
            self._seen = (state.t, image) if camera == "eye" else self._seen
            return image
        if camera not in self._views:
            self._views[camera] = self._outside(camera, *size)
        self._stage.place(*state)
        if camera == "overview" and self._view is not None:
            self._view.place(self._stage, self._things)
        elif camera == "overview":
            if self._follow is None:
                aspect = size[0] / size[1]
                self._follow = FollowCamera(self._stage, self._things, aspect, FREE)
            self._follow.place(state.t, T_world_goal)
        return self._views[camera][0].full_image()

    def _outside(self, camera: str, width: int, height: int) -> tuple[StillView, Perspective]:
        view = outside_view(self._stage, camera, width, height, self._parts.camera, self._shadows)
        fovy_deg = float(self._stage.model.camera(camera).fovy[0])
        lens = Perspective(width=width, height=height, fovy_deg=fovy_deg)
        return StillView(view.full_image, self._stage.data, camera, lens.f, view.part), lens

    @property
    def solids(self) -> list[Solid]:
        """The visible geoms as triangles, fixed to bodies; `body_poses` places them."""
        return solids(self._stage.model)

    @property
    def panes(self) -> list[Pane]:
        """The pictures in the scene."""
        return panes(self._stage.model)

    @property
    def body_names(self) -> list[str]:
        """Names of all bodies, by number."""
        return self._stage.body_names

    def body_poses(
        self, t: float, T_world_target: Array, q: Array, T_world_camera: Array
    ) -> tuple[Array, Array]:
        """Positions (B, 3) [m] and quaternions (B, 4), wxyz, of all bodies in a state; valid until
        the next call.
        """
        self._stage.place(t, T_world_target, q, T_world_camera)
        return self._stage.body_poses

    def outside_view(self, t: float, T_world_goal: Array | None) -> tuple[Array, Array, float]:
        """A view from outside of the last placed state that shows robot, target and goal.

        Returns T_world_camera (4, 4), the point (3,) that it looks at, and its vertical field of
        view [rad].
        """
        # others keep the composed view, which shows the way there is
        if T_world_goal is not None or self._parts.robot.base == "fixed":
            FollowCamera(self._stage, self._things, OUTSIDE_ASPECT, 1.0).place(t, T_world_goal)
        T = self._stage.pose_of("overview")
        middle = self._things.points(self._stage.data).reshape(-1, 3).mean(axis=0)
        fovy = math.radians(float(self._stage.model.camera("overview").fovy[0]))
        return T, T[:3, 3] + T[:3, 2] * float((middle - T[:3, 3]) @ T[:3, 2]), fovy

    def seen(self, t: float) -> Image | None:
        """The last picture of the servo camera, if it is that of a time [s];
        not to be drawn into.
        """
        return self._seen[1] if self._seen is not None and self._seen[0] == t else None

    def sight(self, camera: str) -> tuple[Perspective, Array]:
        """Lens and pose T_world_camera (4, 4) of the last picture from a camera outside, for what
        is drawn over it.
        """
        return self._views[camera][1], self._stage.pose_of(camera)

    def body(self) -> Array:
        """Points (G, 16, 3) in the world whose convex hulls are the robot's geoms in the last
        picture from outside.
        """
        return self._things.points(self._stage.data)[self._things.own]

    def _own_lens(self, eye: str) -> tuple[Scene, Callable[[], Image]]:
        """A stage with the quality of the servo camera, or of a further one, built when first asked
        for.
        """
        if eye in self._own:
            return self._own[eye]
        lens = self._lenses[eye]
        stage = Scene(self._parts, samples=lens.multisampling)
        if (imaging := lens.imaging(None)) is not None:
            drawn_by = servo_renderer(stage, lens, eye=eye)

            def imaged() -> Image:
                images = drawn_by.images(with_depth=imaging.needs_depth)
                (image,) = imaging.clean(float(stage.data.time), images, drawn_by.depth)
                assert image is not None
                return image

            view = imaged
        else:
            drawn_by = servo_renderer(stage, lens, share=self._share, eye=eye)
            f = self._share * pixels_per_radian(lens)
            # what is out of sight may cast shadows
            sides = None if lens.shadows else half_tangents(lens)
            view = StillView(drawn_by.full_image, stage.data, eye, f, sides=sides).full_image
        self._own[eye] = stage, view
        return stage, view

    def close(self) -> None:
        """Free the OpenGL contexts."""
        self._stage.close()
        for stage, _ in self._own.values():
            stage.close()


def _repaint(model: mujoco.MjModel) -> None:
    """Colours and lights of films, which must not be those of the servo camera: they show robots,
    and to that camera markers.
    """
    floor = texels_of(model, model.texture("floor").id)
    first = (floor == floor[0, 0]).all(axis=-1, keepdims=True)
    floor[:] = np.where(first, *np.array(FLOOR, np.uint8))
    # scenery may have brought its own
    if "sky" in names_of(model, "tex"):
        sky = texels_of(model, model.texture("sky").id)
        sky[:] = np.rint(sky * np.array(SKY)).astype(np.uint8)
    model.geom("floor").size[:2] = FLOOR_M
    key = model.light("key")
    fill = model.light("fill")
    key.diffuse[:] = KEY
    fill.diffuse[:] = FILL
    fill.ambient[:] = AMBIENT
    model.vis.map.shadowclip = LEAST_REACH / model.stat.extent


class Rerendering:
    """Takes the servo camera's pictures of a recorded run again, each drawn anew, in the order in
    which the run took them.

    A picture is of the instant of its time stamp: it lacks the motion blur of an exposure
    (`timing.exposure_s`), the skew of a rolling shutter (`camera.readout_s`) and the flicker of the
    light. Noise and drift are those of the run, whose generator draws once for each picture; lens,
    exposure, sensor and stream likewise. Raises EnvironmentLackError: a picture is needed that only
    OpenGL can draw, and it does not work here.

    Args:
        scene: of the run.
        image_sigma, rng: noise of the pictures [grey levels] and its generator as at the beginning
            of the run. drift: of its gains.
        imaging_rng: generator of the image sensor's noise, likewise.
    """

    def __init__(
        self,
        scene: SceneDescription,
        image_sigma: float = 0.0,
        rng: np.random.Generator | None = None,
        drift: Drift = NO_DRIFT,
        imaging_rng: np.random.Generator | None = None,
    ):
        camera = scene.camera
        self._stage = Scene(replace(scene, others=()), samples=camera.multisampling)
        drawn_by = servo_renderer(self._stage, camera, image_sigma > 0)
        noise = ImageNoise(image_sigma, rng)
        chain = Chain(camera.imaging(imaging_rng), noise, drift)
        self._sensor = ImageSensor(self._stage, drawn_by, chain)

    def picture(self, t: float, T_world_target: Array, q: Array, T_world_camera: Array) -> Image:
        """The picture of a state at a time [s], (H, W, 3) uint8 RGB; a copy."""
        self._stage.place(t, T_world_target, q, T_world_camera)
        image = self._sensor.with_own(self._sensor.capture(t)).image
        assert image is not None  # whole, and with the own image of a lens that has panels
        return image.copy()

    @property
    def body_names(self) -> list[str]:
        """Names of all bodies, by number."""
        return self._stage.body_names

    @property
    def body_poses(self) -> tuple[Array, Array]:
        """Positions (B, 3) [m] and quaternions (B, 4), wxyz, of all bodies in the last picture;
        valid until the next one.
        """
        return self._stage.body_poses

    def close(self) -> None:
        """Free the OpenGL context."""
        self._stage.close()


# Lower bound of a run's cost: the same physics steps and the same raw images, nothing else.
def measure_baseline(
    parts: SceneDescription,
    steps_per_frame: int,
    ctrl: Array,
    q: Array,
    T_world_camera: Array,
    pictures: bool,
) -> tuple[float, float]:
    """Wall times of a recorded run's controls with plain `mj_step`, and of its views with plain
    renders [s].

    Ray casting renders whole images here, so that a run, which renders windows, may cost less.

    Args:
        parts: the scene. steps_per_frame: physics steps between frames.
        ctrl: actuator controls of each frame (frames, nu); q: joint angles of each frame (frames,
            n).
        T_world_camera: camera poses (frames, 4, 4), which place the free camera.
        pictures: whether the run rendered at all; of several faces of a cube, only those with a
            marker in them are.
    """
    stage = Scene(parts, samples=parts.camera.multisampling)
    picture = bare_renderer(stage, parts.camera) if pictures else None
    target = parts.target.T_world_start
    stage.place(0.0, target, q[0], T_world_camera[0])
    stage.rest()
    mujoco.mj_forward(stage.model, stage.data)
    physics = render = 0.0
    for frame in range(len(ctrl)):
        if parts.robot.body is None:
            stage.place(0.0, target, q[frame], T_world_camera[frame])
        p_camera = parts.target.seen_from(inverse(target) @ T_world_camera[frame])
        began = time.perf_counter()
        if picture is not None:
            picture(p_camera)
        rendered = time.perf_counter()
        if parts.robot.body is not None:
            stage.data.ctrl[stage.at.ctrl] = ctrl[frame]
            for _ in range(steps_per_frame):
                mujoco.mj_step(stage.model, stage.data)
            physics += time.perf_counter() - rendered
        render += rendered - began
    stage.close()
    return physics, render
