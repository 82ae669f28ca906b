"""From the rendered picture to the camera's: lens, exposure, sensor; and the stream to the computer."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import DepthImage, Image, Images
from vstestbed.imaging.exposure import SKIP, ExposureControl, ExposureLoop, ExposureSetting
from vstestbed.imaging.optics import LensEffects, Optics, _Lens
from vstestbed.imaging.sensor import NO_DRIFT, Drift, FixedPattern, ImageNoise, Mosaic, SensorNoise, plain
from vstestbed.imaging.stream import VideoStream, round_trip

Floats = NDArray[np.float32]
Change = Callable[[float, Images, DepthImage | None], Images]
"""Of the images of all panels, taken at a time [s], with the true depths (H, W) [m] where they are needed."""


class _Imaged(_Lens, Protocol):
    """What is asked of a camera: its blocks, its rate [Hz] and period [s], and whether any block changes its pictures."""

    @property
    def rate_hz(self) -> float: ...
    @property
    def period(self) -> float: ...
    @property
    def optics(self) -> Optics | None: ...
    @property
    def exposure(self) -> ExposureControl | None: ...
    @property
    def sensor(self) -> SensorNoise | None: ...
    @property
    def stream(self) -> VideoStream | None: ...
    @property
    def imaged(self) -> bool: ...


class Imaging:
    """A camera's lens, exposure, sensor and stream, in the order in which light passes them. It remembers: one for each run.

    Its random numbers are two: the fixed pattern first, then one seed for each picture.

    Attributes:
        exposed: exposure of the picture last taken; None without `camera.exposure`.

    Args:
        camera: with `optics`, `exposure`, `sensor`, `stream`. rng: of the sensor's noise.
    """

    def __init__(self, camera: _Imaged, rng: np.random.Generator):
        self._camera, self._rng = camera, rng
        self._lens = None if camera.optics is None else LensEffects(camera, camera.optics)
        sensor = self._sensor = camera.sensor
        self._mosaic = None if sensor is None or sensor.mosaic == "none" else Mosaic(sensor.mosaic, sensor.demosaic)
        self._pattern: FixedPattern | None = None
        if self._sensor is not None:
            size = camera.height, camera.width
            self._pattern = self._sensor.pattern((*size, 3) if self._mosaic is None else size, rng)
        self._exposure = ExposureLoop(camera.exposure, camera.period, 0.0 if self._sensor is None else self._sensor.black)
        self._fresh_trip = lambda: round_trip(camera.stream, camera.rate_hz)
        self._trip = self._fresh_trip()
        self.exposed: ExposureSetting | None = None

    @property
    def needs_depth(self) -> bool:
        """Whether the true depth of each pixel is asked for."""
        return self._lens is not None and self._lens.needs_depth

    def exposure_s(self, t: float, drawn: Callable[[], tuple[Images, DepthImage | None]]) -> float:
        """Exposure time of the run's next picture [s], known before it is taken.

        drawn: images and true depths now; a camera that has settled looks at them before its first picture.
        """
        metered = functools.cache(lambda: self._metered(self._light(*drawn())))
        return self._exposure.setting(t, lambda setting: metered()(setting)).time_s

    def taken(self, t: float, images: Images, depth: DepthImage | None) -> Images:
        """The next picture of the run as the sensor gives it, taken at a time t [s]; depth: true ones (H, W) [m]."""
        light = self._light(images, depth)
        setting = self._exposure.setting(t, self._metered(light))
        self.exposed = None if self._camera.exposure is None else setting
        seed = None if self._sensor is None else int(self._rng.integers(2**63))
        image = self._read(light, setting, None if seed is None else np.random.default_rng(seed))
        self._exposure.saw(image)
        return (image,)

    def streamed(self, images: Images) -> Images:
        """The next picture of the run as the computer has it."""
        return tuple(None if image is None else self._trip(image) for image in images)

    def clean(self, t: float, images: Images, depth: DepthImage | None) -> Images:
        """A picture as the camera would give it at rest, as the mean of many; what the run's pictures will be is not changed by it."""
        light = self._light(images, depth)
        setting = self._exposure.settled(t, self._metered(light))
        return (self._fresh_trip()(self._read(light, setting, None)),)

    def _light(self, images: Images, depth: DepthImage | None) -> Floats:
        (image,) = images
        assert image is not None  # a camera with one picture, always whole
        return image.astype(np.float32) if self._lens is None else self._lens.of(image, depth)

    def _read(self, light: Floats, setting: ExposureSetting, rng: np.random.Generator | None) -> Image:
        if self._sensor is None:
            return plain(light, setting)
        if self._mosaic is None:
            return self._sensor.read(light, setting, self._pattern, rng)
        numbers = self._sensor.converted(self._mosaic.sampled(light), setting, self._pattern, rng)
        return self._sensor.upper(self._mosaic.filled(numbers))

    def _metered(self, light: Floats) -> Callable[[ExposureSetting], Image]:
        """What exposure control looks at before the first picture: a part of the pixels, without their noise."""
        part, sensor = light[::SKIP, ::SKIP], self._sensor
        return lambda setting: plain(part, setting) if sensor is None else sensor.read(part, setting, None, None)


def imaging_of(camera: _Imaged, rng: np.random.Generator | None) -> Imaging | None:
    """What changes the pictures of a camera; None where nothing does."""
    return Imaging(camera, rng or np.random.default_rng(0)) if camera.imaged else None


class Chain:
    """All that becomes of a rendered picture; `next` has it in the order in which light and numbers pass.

    imaging: lens, exposure, sensor and stream; None where the camera has none of them.
    noise, drift: of the scenario. changed: gives further changes of each next picture.
    """

    def __init__(
        self,
        imaging: Imaging | None = None,
        noise: ImageNoise | None = None,
        drift: Drift = NO_DRIFT,
        changed: Callable[[], Callable[[float, Images], Images]] | None = None,
    ):
        self.imaging, self._noise, self._drift, self._changed = imaging, noise or ImageNoise(), drift, changed
        self.noisy, self.whole = self._noise.acts, imaging is not None
        self.needs_depth = imaging is not None and imaging.needs_depth

    def next(self) -> list[Change]:
        """What becomes of the next picture, step by step; noise and changes are the same however often they are applied to it."""
        noised, changed, imaging = self._noise.next(), self._changed() if self._changed else None, self.imaging
        steps: list[Change | None] = [
            imaging.taken if imaging else None,
            lambda t, images, depth: noised(images),
            lambda t, images, depth: self._drift.of(images, t),
            (lambda t, images, depth: changed(t, images)) if changed else None,
            (lambda t, images, depth: imaging.streamed(images)) if imaging else None,
        ]
        return [step for step in steps if step is not None]

    def clean(self, t: float, images: Images, depth: DepthImage | None) -> Images:
        """A picture as the mean of many at rest; what later pictures will be is not changed by it."""
        return self.imaging.clean(t, images, depth) if self.imaging else images
