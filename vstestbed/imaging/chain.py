"""From the rendered picture to the camera's: lens, exposure, sensor; and the stream to the
computer.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Protocol

import numpy as np

from vstestbed.core.geometry import DepthImage, Image, Images
from vstestbed.core.lazy import cv2
from vstestbed.imaging.exposure import SKIP, ExposureControl, ExposureLoop, ExposureSetting
from vstestbed.imaging.optics import LensEffects
from vstestbed.imaging.sensor import NO_DRIFT, Drift, Floats, ImageNoise, SensorNoise, plain
from vstestbed.imaging.stream import VideoStream, round_trip

__all__ = ["Chain", "Change", "Imaging", "scaled"]

Change = Callable[[float, Images, DepthImage | None], Images]
"""From the time [s], the images of all panels, and the true depths (H, W) [m] where they count, to
new images.
"""


class _Camera(Protocol):
    """What is asked of a camera here."""

    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def period(self) -> float: ...
    @property
    def rate_hz(self) -> float: ...
    @property
    def exposure(self) -> ExposureControl | None: ...
    @property
    def sensor(self) -> SensorNoise | None: ...
    @property
    def stream(self) -> VideoStream | None: ...


class Imaging:
    """A camera's lens, exposure, sensor and stream, in the order in which light passes them. It has
    a state: each run has its own.

    Its random numbers are two: the fixed pattern first, then one seed for each picture.

    Attributes:
        exposed: exposure of the picture last taken; None without `camera.exposure`.

    Args:
        camera: whose pictures they are. lens: its errors. rng: of the sensor's noise.
    """

    def __init__(self, camera: _Camera, lens: LensEffects | None, rng: np.random.Generator):
        sensor = camera.sensor
        self._lens = lens
        self._control = camera.exposure
        self._sensor = sensor
        self._rng = rng
        # whether the true depth of each pixel is asked for
        self.needs_depth = lens is not None and lens.needs_depth
        self._pattern = None
        black = 0.0
        if sensor is not None:
            self._pattern = sensor.pattern((camera.width, camera.height), rng)
            black = sensor.black
        self._exposure = ExposureLoop(camera.exposure, camera.period, black)
        self._fresh_trip = functools.partial(round_trip, camera.stream, camera.rate_hz)
        self._trip = self._fresh_trip()
        self.exposed: ExposureSetting | None = None

    def exposure_s(self, t: float, drawn: Callable[[], tuple[Images, DepthImage | None]]) -> float:
        """Exposure time of the run's next picture [s], known before it is taken.

        drawn: images and true depths now; a camera that has settled looks at them before its first
            picture.
        """
        metered = functools.cache(lambda: self._metered(self._light(*drawn())))
        return self._exposure.setting(t, lambda setting: metered()(setting)).time_s

    def taken(self, t: float, images: Images, depth: DepthImage | None) -> Images:
        """The next picture of the run as the sensor gives it, taken at a time t [s]; depth: true
        ones (H, W) [m].
        """
        light = self._light(images, depth)
        setting = self._exposure.setting(t, self._metered(light))
        self.exposed = None if self._control is None else setting
        rng = None
        if self._sensor is not None:
            rng = np.random.default_rng(int(self._rng.integers(2**63)))
        image = self._read(light, setting, rng)
        self._exposure.saw(image)
        return (image,)

    def streamed(self, images: Images) -> Images:
        """The next picture of the run as the computer has it."""
        return tuple(None if image is None else self._trip(image) for image in images)

    def clean(self, t: float, images: Images, depth: DepthImage | None) -> Images:
        """A picture as the camera would give it at rest, as the mean of many; what the run's
        pictures will be is not changed by it.
        """
        light = self._light(images, depth)
        setting = self._exposure.settled(t, self._metered(light))
        return (self._fresh_trip()(self._read(light, setting, None)),)

    def _light(self, images: Images, depth: DepthImage | None) -> Floats:
        (image,) = images
        assert image is not None  # a camera with one picture, always whole
        return image.astype(np.float32) if self._lens is None else self._lens.of(image, depth)

    def _read(
        self, light: Floats, setting: ExposureSetting, rng: np.random.Generator | None
    ) -> Image:
        if self._sensor is None:
            return plain(light, setting)
        return self._sensor.read(light, setting, self._pattern, rng)

    def _metered(self, light: Floats) -> Callable[[ExposureSetting], Image]:
        """What exposure control looks at before the first picture: a part of the pixels, without
        their noise.
        """
        part = light[::SKIP, ::SKIP]
        sensor = self._sensor
        if sensor is None:
            return functools.partial(plain, part)
        return lambda setting: sensor.upper(sensor.converted(part, setting, None, None))


class Chain:
    """All changes of a rendered picture on its way to the detector.

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
        self.imaging = imaging
        self._noise = noise or ImageNoise()
        self._drift = drift
        self._changed = changed
        self.noisy = self._noise.acts
        self.whole = imaging is not None
        self.needs_depth = imaging is not None and imaging.needs_depth

    def next(self) -> Change:
        """What becomes of the next picture; noise and changes are the same however often they are
        applied to it.
        """
        noised = self._noise.next()
        changed = self._changed() if self._changed else None
        imaging = self.imaging

        def developed(t: float, images: Images, depth: DepthImage | None) -> Images:
            if imaging:
                images = imaging.taken(t, images, depth)
            images = self._drift.of(noised(images), t)
            if changed:
                images = changed(t, images)
            return imaging.streamed(images) if imaging else images

        return developed

    def clean(self, t: float, images: Images, depth: DepthImage | None) -> Images:
        """A picture as the mean of many at rest;
        what later pictures will be is not changed by it.
        """
        return self.imaging.clean(t, images, depth) if self.imaging else images


def scaled(image: Image, size: tuple[int, int]) -> Image:
    """The image at a size (width, height); itself if it has that size."""
    if image.shape[1::-1] == size:
        return image
    # the mean of pixels where they become fewer, as INTER_AREA has it; it would show blocks where
    # they become more
    way = cv2.INTER_AREA if image.shape[1] > size[0] else cv2.INTER_LINEAR
    return cv2.resize(image, size, interpolation=way)
