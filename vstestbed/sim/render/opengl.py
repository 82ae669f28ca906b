"""Pictures of a stage: the kept dm_control camera, and the servo camera's picture through its lens."""

from __future__ import annotations

import time
from typing import Literal

import cv2
import numpy as np
from dm_control.mujoco import wrapper

from vstestbed.camera import Camera, Image, Look, Perspective, Window
from vstestbed.core.errors import EnvironmentLackError
from vstestbed.sim.lens.cube import cube_of, drawn_for
from vstestbed.sim.lens.pinhole import resampling_maps
from vstestbed.sim.render import gl_probe as gl
from vstestbed.sim.render.noise import noisy
from vstestbed.sim.render.window import PartCamera, part_round
from vstestbed.sim.scene.compose import LENS_GROUP
from vstestbed.sim.scene.stage import Stage


class View:
    """One camera of a stage, kept; `picture` renders what it sees now.

    Args:
        stage: the scene.
        camera: name in the scene (`eye`, `overview`, ...).
        width, height: size of the picture [px].
        shadows: draw shadows.
        style: `own` is what the servo camera sees (what encloses the lens left out); `outside` shows everything.

    Raises:
        EnvironmentLackError: no OpenGL here.
    """

    def __init__(self, stage: Stage, camera: str, width: int, height: int, shadows: bool, style: Literal["own", "outside"]):
        gl.require()
        vis = stage.model.vis.global_
        vis.offwidth, vis.offheight = max(vis.offwidth, width), max(vis.offheight, height)
        if not shadows:
            stage.model.vis.quality.shadowsize = 0  # the context would reserve its depth map
        try:
            self._camera = PartCamera(stage.physics, height, width, camera_id=camera)
            self._option = wrapper.MjvOption()
            self._option.geomgroup[:] = 1
            self._option.geomgroup[LENS_GROUP] = style == "outside"
            self._option.sitegroup[:] = 0
            self._flags = {"shadow": shadows, "reflection": False}
            self.renderer = ""
            contexts = stage.physics.fitting_contexts()
            if contexts is None or contexts.gl is None or contexts.mujoco is None:
                raise EnvironmentLackError("no OpenGL context", gl.REMEDY)
            with contexts.gl.make_current() as context:
                self.renderer = context.call(gl.renderer_string)
        except Exception as error:  # EGL, PyOpenGL and MuJoCo raise half a dozen types when a driver is broken
            raise EnvironmentLackError(f"OpenGL does not work here: {error}", gl.REMEDY) from error

    def picture(self) -> Image:
        """The picture now, (H, W, 3) uint8 RGB, a copy of its own."""
        return np.ascontiguousarray(self.raw())

    def raw(self, window: Window | None = None) -> Image:
        """The picture as the kept camera gives it: a view of its own buffer, overwritten by the next one.

        window: the part of it that is wanted; the rest is black.
        """
        self._camera.window = window
        return self._camera.render(scene_option=self._option, render_flag_overrides=self._flags)


class Eye:
    """The servo camera's picture through its lens, with sensor noise.

    A pinhole lens is drawn as it is, a distorted one resampled from a pinhole picture. A lens with panels gives them. Any
    other is put together from the faces of a cube round it, of which only those are drawn that somebody looks at.

    Args:
        stage: the scene. camera: the lens. image_sigma: standard deviation of the noise of each channel, in grey levels
        (of 255). rng: where the noise comes from.

    Attributes:
        renderer: what draws. spent_s: wall time spent on pictures [s]. whole: whether the last pictures show all there is.
    """

    def __init__(self, stage: Stage, camera: Camera, image_sigma: float = 0.0, rng: np.random.Generator | None = None):
        drawn = drawn_for(camera)
        self._maps = resampling_maps(camera, drawn[0]) if isinstance(camera, Perspective) else None
        self._cube = None if isinstance(camera, Perspective) else cube_of(camera)
        self._panels = len(camera.panels)
        self._size = camera.width, camera.height
        # where a lens bends the picture, or noise is estimated from all of it, a part is not enough
        self._parts = self._maps is None and image_sigma == 0
        self._sigma, self._rng = image_sigma, rng
        self._views = [View(stage, p.name, p.width, p.height, camera.shadows, "own") for p in drawn]
        self.renderer = self._views[0].renderer
        self.spent_s = 0.0
        self.whole = True

    def picture(self) -> Image:
        """The camera's own picture now, (H, W, 3) uint8 RGB, its own for good; a lens with panels is drawn for it all around."""
        if self._cube is not None and self._panels > 1:
            return self._cube.compose(dict(enumerate(image for image in self.glimpse() if image is not None)))
        return np.ascontiguousarray(self.glimpse()[0])

    def glimpse(self, look: Look | None = None, clean: bool = False) -> tuple[Image | None, ...]:
        """The pictures now, one a panel; they may lie in the renderer's buffer, and then hold only until the next ones.

        look: where somebody is going to look; a panel with no window is left out, any other is drawn whole, but for
        faces of the cube without a part in its windows, which are black. Of a pinhole lens's picture the rectangle round
        all windows is drawn, the rest is black. clean: without noise.
        """
        start = time.perf_counter()
        if self._cube is None:
            window = part_round(look[0], *self._size) if look is not None and self._parts else None
            images = (self._resampled(self._views[0].raw(window)),)
            self.whole = window is None
        elif self._panels > 1:
            images = tuple(view.raw() if look is None or look[i] else None for i, view in enumerate(self._views))
            self.whole = look is None or all(look)
        else:
            faces = range(len(self._views)) if look is None else self._cube.needed(look[0])
            images = (self._cube.compose({i: self._views[i].raw() for i in faces}),)
            self.whole = len(faces) == len(self._views)
        if not clean:
            images = tuple(None if image is None else self.grained(image) for image in images)
        self.spent_s += time.perf_counter() - start
        return images

    def grained(self, image: Image) -> Image:
        """A clean picture with the sensor's noise."""
        return noisy(image, self._sigma, self._rng)

    def _resampled(self, image: Image) -> Image:
        """A drawn picture through a distorted lens; the same where there is no distortion."""
        if self._maps is None:
            return image
        still = np.ascontiguousarray(image)
        return np.asarray(cv2.remap(still, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)
