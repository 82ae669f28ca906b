"""The image sensor: exposures of one or several images (motion blur), noise and drift; an exposure
can be drawn again, whole.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import (
    Camera,
    DepthImage,
    DepthSensor,
    Panel,
    Perspective,
    Picture,
    Regions,
    Window,
)
from vstestbed.core.geometry import Array, Images, pixel_grid
from vstestbed.imaging.chain import Chain, Change
from vstestbed.imaging.shutter import Contribution, Rows, RowWeight
from vstestbed.sim.base import Renderer
from vstestbed.sim.scene.scene import Scene
from vstestbed.vision.colour import noise_rows

Sum = Array | NDArray[np.float32]


class PixelRows:
    """In which row of the camera's own picture each pixel is, which says when it is exposed.

    Of a lens with panels each pixel of a panel is exposed with the row of the camera's own picture
    that shows the same direction.

    camera: the lens. noisy: noise will be added: the rows from which detectors estimate its level
    are always drawn.
    """

    def __init__(self, camera: Camera, noisy: bool):
        self._camera = camera
        self._noisy = noisy

    @cached_property
    def _in_panels(self) -> tuple[NDArray[np.intp], ...] | None:
        """The nearest rows (h, w) of the pixels of each panel; None for a camera whose only panel
        is its own picture.
        """
        panels = self._camera.panels
        return None if panels[0].lens is self._camera else tuple(map(self._rows, panels))

    def _rows(self, panel: Panel) -> NDArray[np.intp]:
        rays = panel.ray(pixel_grid(panel.lens.width, panel.lens.height))
        v = self._camera.project(rays)[..., 1]
        return np.clip(np.rint(np.nan_to_num(v)), 0, self._camera.height - 1).astype(np.intp)

    def weights(self, weight: RowWeight) -> tuple[RowWeight, ...]:
        """The weights of the pixels of each panel, (h, 1, 1) or (h, w, 1); a weight of the whole
        picture as it is.
        """
        if not isinstance(weight, np.ndarray):
            return (weight,) * len(self._camera.panels)
        if self._in_panels is None:
            return (weight[:, None, None],)
        return tuple(weight[v][..., None] for v in self._in_panels)

    def needed(
        self, regions: Regions | None, weights: tuple[RowWeight, ...]
    ) -> tuple[Regions | None, Rows | None]:
        """Regions of interest and rows, None for everything, without what has no weight; weights:
        of the pixels of each panel.
        """
        if not isinstance(weights[0], np.ndarray):
            return regions, None
        if self._in_panels is None:
            return regions if regions is None else self._asked(regions), band(weights[0])
        asked = self._asked(regions)
        return tuple(
            windows if part.any() else ()
            for windows, part in zip(asked, map(np.asarray, weights), strict=True)
        ), None

    def _asked(self, regions: Regions | None) -> Regions:
        lenses = [panel.lens for panel in self._camera.panels]
        if regions is None:
            return tuple(((0, 0, lens.width, lens.height),) for lens in lenses)
        asked: list[tuple[Window, ...]] = []
        for windows, lens in zip(regions, lenses, strict=True):
            if windows and self._noisy:
                windows += tuple((0, v, lens.width, v + 1) for v in noise_rows(lens.height))
            asked.append(windows)
        return tuple(asked)


def band(weight: Array) -> Rows:
    """First row with a weight (H, ...), and the one after the last; (0, 1) where no row has any."""
    rows = np.flatnonzero(weight.reshape(len(weight), -1).any(axis=1))
    return (int(rows[0]), int(rows[-1]) + 1) if len(rows) else (0, 1)


class MotionBlur:
    """Weighted mean of the images rendered while the shutter is open.

    Grey levels are averaged as they are, that is, they are taken to be linear in the light. Weights
    of rows must add up to 1 in each row.

    whole: all images are complete.
    """

    def __init__(self) -> None:
        self.whole = True
        self._total: float | None = 0.0
        self._sums: list[Sum | None] = []

    def add(self, images: Images, weights: tuple[RowWeight, ...], whole: bool) -> None:
        """Add the images of all panels, each with its weight, see `PixelRows.weights`."""
        if not self._sums:
            self._sums = [None] * len(images)
        for i, (image, weight) in enumerate(zip(images, weights, strict=True)):
            if image is not None:
                self._sums[i] = self._added(self._sums[i], image, weight)
        one = weights[0]
        if isinstance(one, np.ndarray):
            self._total = None
        elif self._total is not None:
            self._total += one
        self.whole = self.whole and whole

    def _added(self, before: Sum | None, image: NDArray[np.uint8], weight: RowWeight) -> Sum:
        if not isinstance(weight, np.ndarray):
            part = image * np.float64(weight)
            return part if before is None else before + part
        total = np.zeros(image.shape, np.float32) if before is None else before
        top, bottom = band(weight)
        total[top:bottom] += image[top:bottom] * weight[top:bottom].astype(np.float32)
        return total

    def mean(self) -> Images:
        """The mean of each panel's images; None for a panel without any."""
        total = 1.0 if self._total is None else self._total
        return tuple(
            None if s is None else np.clip(s / total + 0.5, 0, 255).astype(np.uint8)
            for s in self._sums
        )


class DepthCamera:
    """Draws one number from its generator for each picture; the noise is a function of that number
    and of the true depth alone.

    camera: the lens. sensor: what it measures. rng: source of the noise.
    """

    def __init__(self, camera: Perspective, sensor: DepthSensor, rng: np.random.Generator):
        self._camera = camera
        self._sensor = sensor
        self._rng = rng

    @cached_property
    def _lens(self) -> tuple[Array, float]:
        """Normalised coordinates of the pixels (H, W, 2), and the focal length [px], of the lens
        that measures.
        """
        grid = pixel_grid(self._camera.width, self._camera.height)
        lens = self._sensor.lens
        if lens is not None:
            return (grid - lens.centre) / lens.f, lens.f
        return self._camera.normalise(grid.reshape(-1, 2)).reshape(grid.shape), self._camera.f

    def measured(self, true: DepthImage | None) -> DepthImage | None:
        """The depth picture (H, W) [m] of the true depths (H, W) [m] of the next picture, NaN in
        holes.
        """
        seed = int(self._rng.integers(2**63))
        if true is None:
            return None
        return self._sensor.measured(true, *self._lens, np.random.default_rng(seed))

    def clean(self, true: DepthImage | None) -> DepthImage | None:
        """The same without noise, as the mean of many pictures at rest would be; nothing is drawn
        for it.
        """
        return None if true is None else self._sensor.measured(true, *self._lens, None)


@contextlib.contextmanager
def lamps_at(model: mujoco.MjModel, brightness: float) -> Iterator[None]:
    """All lights of a scene at a share of their brightness, for as long as something is drawn."""
    if brightness == 1:
        yield
        return
    lights = model.light_ambient, model.light_diffuse, model.light_specular
    before = [light.copy() for light in lights]
    try:
        for light in lights:
            light *= brightness
        yield
    finally:
        for light, own in zip(lights, before, strict=True):
            light[:] = own


INSTANT: Contribution = ((1.0, 1.0),)  # the only image of a picture of an instant


class ImageSensor:
    """Takes one camera's pictures of a stage.

    A picture of which only regions of interest were drawn keeps the scene's state at each of its
    images, so that the whole picture can be drawn afterwards, of the same exposure and with the
    same noise.

    Args:
        stage: the scene, in its state at the time of each call. renderer: renders the images.
        chain: what becomes of them; with lens, exposure, sensor or stream pictures are always
            whole.
        depth: the depth camera, whose pictures are always whole; None without one. camera: whose
            pictures; None: the servo camera.
    """

    def __init__(
        self,
        stage: Scene,
        renderer: Renderer,
        chain: Chain,
        depth: DepthCamera | None = None,
        camera: Camera | None = None,
    ):
        self._stage = stage
        self._model = stage.model
        self._data = stage.data
        self._renderer = renderer
        self._chain = chain
        self._depth = depth
        self._reads_depth = depth is not None or chain.needs_depth
        self._always_whole = self._reads_depth or chain.whole
        self._true_depth: DepthImage | None = None
        self._imaged_s = 0.0
        self._states: list[mujoco.MjData] = []
        self._rows = PixelRows(camera or stage.parts.camera, chain.noisy)
        self._exposed: list[Contribution] = []
        self._blur = MotionBlur()
        self._change: Change = lambda t, images, depth: images  # of the last picture
        self._of_now = True  # whether the last picture is of the scene as it is

    @property
    def spent_s(self) -> float:
        """Wall time spent on images so far, with lens, sensor and stream [s]."""
        return self._renderer.spent_s + self._imaged_s

    def capture(self, t: float, regions: Regions | None = None) -> Picture:
        """A picture of an instant, with time stamp t [s]; see `Plant.capture`."""
        regions = None if self._always_whole else regions
        images = self._render(regions, with_depth=True)
        self._keep_state(0, regions)
        self._of_now = True
        return self._picture(t, images, self._renderer.whole, [INSTANT])

    def clean(self, t: float) -> Picture:
        """A whole picture of the present scene without noise; a copy that the caller may keep. The
        noise of later pictures is the same.
        """
        images = self._renderer.images(with_depth=self._reads_depth)
        images = self._chain.clean(t, images, self._renderer.depth)
        depth = None if self._depth is None else self._depth.clean(self._renderer.depth)
        return Picture(t, images, depth=depth).copy()

    def with_own(self, picture: Picture) -> Picture:
        """A picture just taken with the camera's own image beside the parts, or the panels, that
        detectors work on: whole, of the same exposure; of a lens with panels the present scene,
        sharp. It has the picture's noise.
        """
        if picture.image is not None:
            return picture
        kept = picture.copy()  # more is drawn into the same memory
        if len(picture.images) == 1 and not self._of_now:
            return replace(kept, own=picture.completed().images[0])
        (own,) = self._change(picture.t, (self._renderer.full_image(),), self._true_depth)
        return replace(kept, own=own)

    def exposure_s(self, t: float) -> float | None:
        """Exposure time of the next picture [s], as the camera will have it at a time t [s]; None
        where nothing changes its pictures.
        """
        if self._chain.imaging is None:
            return None
        return self._chain.imaging.exposure_s(
            t, lambda: (self._renderer.images(with_depth=self._reads_depth), self._renderer.depth)
        )

    def expose(
        self, weight: float | Contribution, regions: Regions | None = None, middle: bool = False
    ) -> None:
        """Add the present scene to the running exposure, with its weight or contribution; `regions`
        is the same in the whole exposure.

        middle: it is the one whose depth counts: a mean of depths would be a place at which nothing
            is.
        """
        regions = None if self._always_whole else regions
        # a weight alone: under the mean light
        contribution = weight if isinstance(weight, tuple) else ((1.0, weight),)
        self._add(self._blur, contribution, regions, middle)
        self._keep_state(len(self._exposed), regions)
        self._exposed.append(contribution)

    def developed(self, t: float) -> Picture:
        """The picture of all images added since the last one, with time stamp t [s]; valid as
        `capture`'s.
        """
        blur, exposed = self._blur, self._exposed
        self._blur = MotionBlur()
        self._exposed = []
        self._of_now = False
        return self._picture(t, blur.mean(), blur.whole, exposed)

    def _add(
        self,
        blur: MotionBlur,
        contribution: Contribution,
        regions: Regions | None,
        with_depth: bool,
    ) -> None:
        for i, (brightness, weight) in enumerate(contribution):
            weights = self._rows.weights(weight)
            by_rows = isinstance(weight, np.ndarray)
            deep = with_depth and i == 0 and self._reads_depth
            with lamps_at(self._model, brightness):
                images = self._render(*self._rows.needed(regions, weights), with_depth=deep)
            # What was left out of an image for want of weight is not missing in the mean.
            blur.add(images, weights, regions is None if by_rows else self._renderer.whole)

    def _render(
        self, regions: Regions | None, rows: Rows | None = None, *, with_depth: bool
    ) -> Images:
        """The images now; with their depth, of everything, where it is asked for."""
        with_depth = with_depth and self._reads_depth
        images = self._renderer.images(regions, with_depth, rows)
        if with_depth:
            self._true_depth = self._renderer.depth
        return images

    def _keep_state(self, number: int, regions: Regions | None) -> None:
        """Keep the scene's state at an exposure's image of that number, if a part of it may have
        been left out.
        """
        if regions is None:
            return
        if number == len(self._states):
            self._states.append(mujoco.MjData(self._model))
        mujoco.mj_copyData(self._states[number], self._model, self._data)

    def _picture(
        self, t: float, clean: Images, whole: bool, exposed: list[Contribution]
    ) -> Picture:
        change = self._chain.next()

        def developed(images: Images) -> Picture:
            return Picture(t, change(t, images, self._true_depth))

        self._change = change
        begun = time.perf_counter()
        made = developed(clean)
        if self._chain.imaging:
            made = replace(made, exposed=self._chain.imaging.exposed)
            self._imaged_s += time.perf_counter() - begun
        if self._depth is not None:
            made = replace(made, depth=self._depth.measured(self._true_depth))
        if not whole:
            made = replace(
                made, whole=False, draw_whole=lambda: developed(self._drawn_again(exposed))
            )
        return made

    def _drawn_again(self, exposed: list[Contribution]) -> Images:
        """The whole images of the exposure whose states are kept. The scene's own state is put back
        as it was, bit by bit.
        """
        blur = MotionBlur()
        with self._stage.kept():
            for contribution, state in zip(exposed, self._states, strict=False):
                mujoco.mj_copyData(self._data, self._model, state)
                if contribution is INSTANT:
                    return self._renderer.images()
                self._add(blur, contribution, None, with_depth=False)
        return blur.mean()
