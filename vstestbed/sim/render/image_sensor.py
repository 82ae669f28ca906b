"""The image sensor: exposures of one or several images (motion blur), noise and drift; an exposure can be drawn again, whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

from vstestbed.camera import DepthImage, Look, Picture
from vstestbed.core.geometry import Array
from vstestbed.sim.base import Renderer
from vstestbed.sim.render.depth_camera import DepthCamera
from vstestbed.sim.render.imaging import Imaging
from vstestbed.sim.render.noise import NO_DRIFT, Drift, ImageNoise, PictureNoise
from vstestbed.sim.scene.stage import Stage
from vstestbed.vision.perturb import Images, Perturbed


class ImageSensor:
    """Takes the servo camera's pictures of a stage.

    A picture of which only regions of interest were drawn keeps the scene's state at each of its images, so that the whole
    picture can be drawn afterwards, of the same exposure and with the same noise.

    Args:
        stage: the scene, in its state at the time of each call.
        renderer: renders the images.
        noise: of the sensor; None for none. drift: of its gains. perturbed: further changes of the finished picture; None for none.
        depth: the depth camera, whose pictures are always whole; None without one.
        imaging: lens, exposure, sensor and stream, which likewise take whole pictures; None where none of them changes any.
    """

    def __init__(
        self,
        stage: Stage,
        renderer: Renderer,
        noise: ImageNoise | None = None,
        drift: Drift = NO_DRIFT,
        perturbed: Perturbed | None = None,
        depth: DepthCamera | None = None,
        imaging: Imaging | None = None,
    ):
        self._model, self._data = stage.model, stage.data
        self._renderer, self._noise, self._drift = renderer, noise or ImageNoise(), drift
        self._depth, self._imaging = depth, imaging
        self._reads_depth = depth is not None or (imaging is not None and imaging.needs_depth)
        self._always_whole = self._reads_depth or imaging is not None
        self._true_depth: DepthImage | None = None
        self._states: list[mujoco.MjData] = []
        self._present: mujoco.MjData | None = None
        self._perturbed = perturbed or Perturbed((), np.random.default_rng(0))
        self._blur, self._latest = MotionBlur(), (PictureNoise(0.0, None), self._perturbed.next_picture())

    @property
    def spent_s(self) -> float:
        """Wall time spent on images so far [s]."""
        return self._renderer.spent_s

    def capture(self, t: float, look: Look | None = None) -> Picture:
        """A picture of an instant, with time stamp t [s]; valid until the next one.

        look: regions of interest; None for everything. A copy of a picture of which only they were drawn can be completed until
        the next such picture is taken.
        """
        look = None if self._always_whole else look
        images = self._render(look, with_depth=True)
        self._keep_state(0, look)
        return self._picture(t, images, self._renderer.whole, (1.0,))

    def clean(self, t: float) -> Picture:
        """A whole picture of the present scene without noise; a copy that the caller may keep. The noise of later pictures is the same."""
        images, depth = self._renderer.images(with_depth=self._reads_depth), self._depth
        if self._imaging is not None:
            images = self._imaging.clean(t, images, self._renderer.depth)
        return Picture(t, images, depth=None if depth is None else depth.clean(self._renderer.depth)).copy()

    def with_own(self, picture: Picture) -> Picture:
        """A picture just taken with the camera's own image: of a lens with panels the present scene, sharp, with the picture's noise."""
        if picture.image is not None:
            return picture
        drawn = self._developed(picture.t, (self._renderer.full_image(),), *self._latest)
        return replace(picture, own=drawn.images[0])

    def expose(self, weight: float, look: Look | None = None, middle: bool = False) -> None:
        """Add an image of the present scene to the running exposure, with a share `weight`; `look` is the same for all its images.

        middle: it is the one whose depth counts: a mean of depths would be a place at which nothing is.
        """
        look = None if self._always_whole else look
        self._blur.add(self._render(look, middle), weight, self._renderer.whole)
        self._keep_state(len(self._blur.weights) - 1, look)

    def developed(self, t: float) -> Picture:
        """The picture of all images added since the last one, with time stamp t [s]; valid as `capture`'s."""
        blur, self._blur = self._blur, MotionBlur()
        return self._picture(t, blur.mean(), blur.whole, tuple(blur.weights))

    def _render(self, look: Look | None, with_depth: bool) -> Images:
        """The images now; with their depth where it is asked for."""
        with_depth = with_depth and self._reads_depth
        images = self._renderer.images(look, with_depth)
        if with_depth:
            self._true_depth = self._renderer.depth
        return images

    def _keep_state(self, number: int, look: Look | None) -> None:
        """Keep the scene's state at an exposure's image of that number, if a part of it may have been left out."""
        if look is None:
            return
        if number == len(self._states):
            self._states.append(mujoco.MjData(self._model))
        mujoco.mj_copyData(self._states[number], self._model, self._data)

    def _picture(self, t: float, clean: Images, whole: bool, weights: tuple[float, ...]) -> Picture:
        drawn = self._latest = self._noise.next(), self._perturbed.next_picture()

        def draw_whole() -> Picture:
            return self._developed(t, self._drawn_again(weights), *drawn)

        made = self._developed(t, clean, *drawn) if self._imaging is None else self._imaged(t, clean, self._imaging)
        if self._depth is not None:
            made = replace(made, depth=self._depth.measured(self._true_depth))
        return made if whole else Picture(t, made.images, whole, draw_whole)

    def _imaged(self, t: float, clean: Images, imaging: Imaging) -> Picture:
        """The picture through lens, exposure and sensor, with the scenario's own noise, and through the stream."""
        made = self._developed(t, imaging.taken(t, clean, self._true_depth), *self._latest)
        return replace(made, images=imaging.streamed(made.images))

    def _developed(self, t: float, clean: Images, noise: PictureNoise, change: Callable[[float, Images], Images]) -> Picture:
        made = self._drift.of(Picture(t, noise.added(clean)))
        return replace(made, images=change(t, made.images))

    def _drawn_again(self, weights: tuple[float, ...]) -> Images:
        """The whole images of the exposure whose states are kept. The scene's own state is put back as it was, bit by bit."""
        model, data, blur, images = self._model, self._data, MotionBlur(), ()
        self._present = self._present or mujoco.MjData(model)
        mujoco.mj_copyData(self._present, model, data)
        try:
            for weight, state in zip(weights, self._states, strict=False):
                mujoco.mj_copyData(data, model, state)
                images = self._renderer.images()
                if len(weights) > 1:
                    blur.add(images, weight, whole=True)
        finally:
            mujoco.mj_copyData(data, model, self._present)
        return images if len(weights) == 1 else blur.mean()


class MotionBlur:
    """Weighted mean of the images rendered while the shutter is open.

    Grey levels are averaged as they are, that is, they are taken to be linear in the light.

    Attributes:
        weights: of the images added so far. whole: all of them are complete.
    """

    def __init__(self) -> None:
        self.weights: list[float] = []
        self.whole = True
        self._sums: list[Array | None] = []

    def add(self, images: Images, weight: float, whole: bool) -> None:
        """Add the images of all panels."""
        if not self._sums:
            self._sums = [None] * len(images)
        for i, image in enumerate(images):
            if image is not None:
                part, before = image * np.float64(weight), self._sums[i]
                self._sums[i] = part if before is None else before + part
        self.weights.append(weight)
        self.whole = self.whole and whole

    def mean(self) -> Images:
        """The mean of each panel's images; None for a panel without any."""
        total = sum(self.weights)
        return tuple(None if s is None else np.clip(s / total + 0.5, 0, 255).astype(np.uint8) for s in self._sums)
