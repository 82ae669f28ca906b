"""Noise as image sensors have it: the linear model of the EMVA standard 1288."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Image, Images
from vstestbed.core.lazy import cv2
from vstestbed.core.quantity import PositiveTime
from vstestbed.core.spec import spec
from vstestbed.imaging.exposure import ExposureSetting

Floats = NDArray[np.float32]
Numbers = NDArray[np.uint16]
GREY = 128.0  # the grey level that a change of contrast leaves as it is
WHITE = 255.0  # value of a picture's white
FEW = 30.0
"""Electrons under which their number is drawn from Poisson's distribution; above, from the normal
one of the same mean and variance, whose skewness differs by less than 0.19 and which takes a fifth
of the time.
"""
FixedPattern = tuple[Floats, Floats]
"""What differs from pixel to pixel of a camera: offset of the dark signal (H, W, 3) [e-], response
relative to the mean (H, W, 3) [1].
"""
Electrons = Annotated[float, Ge(0), Le(1e6)]
Full = Annotated[float, Gt(0), Le(1e6)]
Share = Annotated[float, Ge(0), Lt(1)]


@spec
class SensorNoise:
    """The linear model of EMVA 1288, in electrons: the quantum efficiency, which makes them of
    photons, is in the light already.

    A pixel collects on average

    mu_e = (1 + prnu n_r) white_e * value / 255 * light * time / nominal_s

    electrons, value being the rendered one. With the gain g of `camera.exposure`, the number n_e of
    Poisson's distribution (shot noise) and n_d of the normal one,

    y = round(K g (min(n_e + dark_noise_e n_d, full_well_e) + dsnu_e n_o) + black_level_dn),

    clipped to 0 and 2^bits - 1. n_o and n_r are normal numbers, drawn once for each pixel of the
    camera from the scenario's seed. The variance of a pixel in time is that of the photon transfer
    curve,

    sigma_y^2 = K^2 dark_noise_e^2 + 1/12 + K (mu_y - mu_dark)   [DN^2] at g = 1.

    The picture has the upper 8 of the bits. Each of its colours is a sensor of its own, unless
    there is a `mosaic`: then each pixel has one colour, as cameras with one chip have it, with its
    noise, and the other two are interpolated by OpenCV before the upper bits are taken. Linear
    interpolation makes noise of neighbours alike: the mean variance is 9/16 of a pixel's in red and
    blue and 5/8 in green, the correlation with the next pixel 2/3 and 2/5. At edges colours are
    fringed; a disc's centroid keeps its mean place, and that of a red one of 7 px radius, of which
    one pixel in four sees most, scatters by 0.04 px with its place between the pixels. White
    balance is perfect. Fringes change the shapes of small blobs: of arm_ibvs's discs, 8 px in
    radius, the detector `blobs` rejects two of four, which are found from 16 px on; `tags` finds
    all four corners within 0.03 px.
    Row noise, defect pixels, dark current and its dependence on temperature are left out.

    The defaults of `full_well_e` and `dark_noise_e` are those of a Sony IMX250, a global shutter
    CMOS sensor with pixels of 3.45 um: they have a largest signal-to-noise ratio, 10
    log10(full_well_e), of 40.2 dB and a dynamic range of 71.0 dB with a converter of 12 bits, where
    40.3 and 71.2 dB were measured after EMVA 1288 (MATRIX VISION, mvBlueFOX3-2051, technical
    documentation). `dsnu_e` and `prnu` are chosen: under the temporal noise of one picture, of 2.3
    e- in the dark and 1 % at saturation, so that the pattern shows in means of pictures alone. Cost
    of a picture of 640 x 480: 13 ms; where most pixels collect fewer than 30 electrons 75 ms; with
    a mosaic a third of it, as there is a third of the numbers.

    Args:
        full_well_e: saturation capacity [e-].
        white_e: electrons of a rendered white at the nominal exposure; default `full_well_e`. Fewer
            make a dark scene, whose picture is as bright as before only with more gain, and noisier
            [e-]; e.g. `1000`.
        gain_dn_per_e: K, overall system gain [DN/e-]; default: `white_e` becomes the largest
            number; e.g. `0.4`.
        dark_noise_e: standard deviation of the temporal dark noise, which includes that of reading
            [e-].
        dsnu_e: standard deviation of the dark signal over the pixels [e-].
        prnu: standard deviation of the response over the pixels, relative to its mean [1].
        bits: of the converter [1].
        black_level_dn: the converter's number without light [DN].
        mosaic: colours of the filters on the first two pixels of the first row, and of the second
            row (Bayer); `none`: each pixel measures all three.
        demosaic: how the other two are interpolated: `linear`, or `edge_aware`, green along the
            direction in which it changes less.

    References: EMVA Standard 1288, release 4.0 Linear, 2021; Janesick 2007, Photon Transfer,
    doi:10.1117/3.725073; Bayer 1976, Color imaging array, US patent 3971065.
    """

    full_well_e: Full = 10500.0
    white_e: Full | None = None
    gain_dn_per_e: Annotated[float, Gt(0), Le(1e4)] | None = None
    dark_noise_e: Electrons = 2.3
    dsnu_e: Electrons = 0.6
    prnu: Annotated[float, Ge(0), Lt(0.2)] = 0.005
    bits: Annotated[int, Ge(8), Le(16)] = 8
    black_level_dn: Annotated[float, Ge(0), Le(65535)] = 0.0
    mosaic: Literal["none", "rggb", "grbg", "gbrg", "bggr"] = "none"
    demosaic: Literal["linear", "edge_aware"] = "edge_aware"

    def __post_init__(self) -> None:
        if self.black_level_dn > self.largest_dn / 2:
            limit = f"half of the largest number, {self.largest_dn}"
            raise ParameterError.bound("black_level_dn", "at most", limit, self.black_level_dn)

    @property
    def largest_dn(self) -> int:
        """The converter's largest number."""
        return 2**self.bits - 1

    @property
    def white(self) -> float:
        """Electrons of a rendered white at the nominal exposure."""
        return self.full_well_e if self.white_e is None else self.white_e

    @property
    def K(self) -> float:
        """Overall system gain [DN/e-]."""
        if self.gain_dn_per_e is not None:
            return self.gain_dn_per_e
        return (self.largest_dn - self.black_level_dn) / self.white

    @property
    def black(self) -> float:
        """Level of a picture without light [grey levels of 255]."""
        return self.black_level_dn / 2 ** (self.bits - 8)

    def pattern(self, size: tuple[int, int], rng: np.random.Generator) -> FixedPattern:
        """The fixed pattern of one camera with pictures of a size (W, H) [px]; behind a mosaic its
        arrays are (H, W).
        """
        shape = size[::-1] if self.mosaic != "none" else (*size[::-1], 3)
        offset, response = (rng.standard_normal(shape, dtype=np.float32) for _ in range(2))
        return offset * np.float32(self.dsnu_e), 1 + response * np.float32(self.prnu)

    def read(
        self,
        light: Floats,
        setting: ExposureSetting,
        pattern: FixedPattern | None,
        rng: np.random.Generator | None,
    ) -> NDArray[np.uint8]:
        """The picture (H, W, 3) of the light (H, W, 3) [0 to 255 of the rendered picture].

        pattern: None for equal pixels. rng: of this picture; None for the mean of many.
        """
        if self.mosaic == "none":
            return self.upper(self.converted(light, setting, pattern, rng))
        numbers = self.converted(self.filtered(light), setting, pattern, rng)
        return self.upper(self.demosaiced(numbers))

    def upper(self, numbers: Numbers) -> NDArray[np.uint8]:
        """The upper 8 bits of the converter's numbers."""
        return (numbers >> (self.bits - 8)).astype(np.uint8)

    def converted(
        self,
        light: Floats,
        setting: ExposureSetting,
        pattern: FixedPattern | None,
        rng: np.random.Generator | None,
    ) -> Numbers:
        """The converter's numbers (H, W, 3) [DN]; arguments as of `read`; behind a mosaic all of
        them (H, W).
        """
        electrons = light * np.float32(self.white / WHITE * setting.collected)
        if pattern is not None:
            electrons *= pattern[1]
        if rng is not None:
            electrons = noisy(electrons, self.dark_noise_e, rng)
        np.minimum(electrons, np.float32(self.full_well_e), out=electrons)
        if pattern is not None:
            electrons += pattern[0]
        electrons *= np.float32(self.K * setting.gain)
        electrons += np.float32(self.black_level_dn + 0.5)
        return np.clip(electrons, 0, self.largest_dn + 0.5).astype(np.uint16)

    def filtered(self, light: Floats) -> Floats:
        """The light (H, W) that passes the filters of the mosaic, of light (H, W, 3)."""
        passed = np.empty(light.shape[:2], np.float32)
        for i, colour in enumerate(self.mosaic):
            part = slice(i // 2, None, 2), slice(i % 2, None, 2)
            passed[part] = light[(*part, "rgb".index(colour))]
        return passed

    def demosaiced(self, numbers: Numbers) -> Numbers:
        """Numbers of all three colours (H, W, 3) from those of the pixels (H, W)."""
        way = "_EA" if self.demosaic == "edge_aware" else ""
        conversion = getattr(cv2, f"COLOR_Bayer{self.mosaic.upper()}2RGB{way}")
        return cv2.demosaicing(numbers, conversion)


def noisy(electrons: Floats, dark_noise_e: float, rng: np.random.Generator) -> Floats:
    """The electrons (H, W, 3) that are read where so many are expected: shot noise, and dark noise
    of a standard deviation [e-].
    """
    normal = rng.standard_normal(electrons.shape, dtype=np.float32)
    read = normal * np.sqrt(electrons + np.float32(dark_noise_e**2))
    read += electrons
    few = electrons < FEW
    if few.any():
        read[few] = rng.poisson(electrons[few]) + np.float32(dark_noise_e) * normal[few]
    return read


def plain(light: Floats, setting: ExposureSetting) -> NDArray[np.uint8]:
    """The picture (H, W, 3) of a sensor without noise, of the light (H, W, 3) [0 to 255 of the
    rendered picture].
    """
    value = light * np.float32(setting.collected * setting.gain) + np.float32(0.5)
    return np.clip(value, 0, WHITE).astype(np.uint8)


@spec
class Drift:
    """Slow drift of the sensor's gains, with a = 2 pi t / period_s:

    red   (1 + brightness sin a) (1 + color cos a)
    green (1 + brightness sin a)
    blue  (1 + brightness sin a) (1 - color cos a)

    then the contrast of all, I' = (1 + contrast sin a) (I - 128) + 128. Values beyond 0 to 255 are
    clipped.

    Args:
        brightness: largest relative change of all channels [1]; e.g. `0.2`.
        color: largest relative change of red, and the opposite one of blue [1]; e.g. `0.1`.
        contrast: largest relative change of the contrast [1]; e.g. `0.2`.
        period_s: period of all of them [s].
    """

    brightness: Share = 0.0
    color: Share = 0.0
    contrast: Share = 0.0
    period_s: PositiveTime = 10.0

    def gains(self, t: float) -> tuple[float, float, float]:
        """Gains of red, green and blue at time t [s]."""
        a = 2 * math.pi * t / self.period_s
        all_three = 1 + self.brightness * math.sin(a)
        red = self.color * math.cos(a)
        return all_three * (1 + red), all_three, all_three * (1 - red)

    def of(self, images: Images, t: float) -> Images:
        """The pictures with the gains of their time t [s]; the same object where nothing drifts."""
        if self.brightness == self.color == self.contrast == 0:
            return images
        return tuple(None if image is None else self._of_image(image, t) for image in images)

    def _of_image(self, image: Image, t: float) -> Image:
        # A lookup table of 256 entries for each channel is quicker than arithmetic on every pixel.
        c = 1 + self.contrast * math.sin(2 * math.pi * t / self.period_s)
        tables = [
            np.clip(c * np.arange(256) * gain + (1 - c) * GREY + 0.5, 0, 255).astype(np.uint8)
            for gain in self.gains(t)
        ]
        return np.stack([table[image[..., i]] for i, table in enumerate(tables)], axis=-1)


NO_DRIFT = Drift()


class ImageNoise:
    """Gaussian noise of an image sensor, drawn anew for each picture.

    sigma: standard deviation on each channel [grey levels of 255]. rng: source of the noise; None
    for none.
    """

    def __init__(self, sigma: float = 0.0, rng: np.random.Generator | None = None):
        self._sigma = sigma
        self._rng = rng if sigma > 0 else None
        self.acts = self._rng is not None

    def next(self) -> Callable[[Images], Images]:
        """Adds the noise of the next picture to its panels' images (H, W, 3), rounded and clipped;
        the same objects where there is none.

        It is a function of pixel and panel alone, whichever of them are drawn, and however often.
        """
        if self._rng is None:
            return lambda images: images
        seed = int(self._rng.integers(2**63))
        return lambda images: tuple(
            image if image is None else self._added(image, (seed, i))
            for i, image in enumerate(images)
        )

    def _added(self, image: Image, seed: tuple[int, int]) -> Image:
        noise = np.random.default_rng(seed).standard_normal(image.shape, dtype=np.float32)
        noise *= np.float32(self._sigma)
        return np.clip(image + noise + 0.5, 0, 255).astype(np.uint8)
