"""What a real lens does to the light besides projecting it: vignetting, lateral chromatic
aberration, defocus.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, DepthImage, pixel_grid
from vstestbed.core.lazy import cv2
from vstestbed.core.quantity import PositiveLength
from vstestbed.core.spec import spec
from vstestbed.imaging.sensor import Floats

Shift = Annotated[float, Ge(-20), Le(20)]


@spec
class Defocus:
    """A thin lens of aperture A = f / N, f its focal length and N its f-number, focused at z_f: a
    point at depth z becomes a disc of

    c = A |z - z_f| / z  f / (z_f - f)

    on the sensor, its circle of confusion. The sensor is f z_f / (z_f - f) behind the lens, which
    the camera's focal length in pixels f_px, as calibrated at this focus, stands for: in pixels c =
    A f_px |1/z - 1/z_f|, whatever the size of a pixel. Nothing is added for diffraction.

    Args:
        focus_m: depth z_f of what is in focus [m]; e.g. `0.5`.
        f_number: N, focal length over diameter of the aperture [1]; e.g. `1.4`.
        focal_length_m: f of the lens [m]; by default the camera's `focal_length_m`, and needed for
            a camera given by its field of view; e.g. `0.008`.

    Reference: Potmesil & Chakravarty 1982, doi:10.1145/357299.357300 (the circle of confusion of a
    thin lens in rendered pictures).
    """

    focus_m: PositiveLength
    f_number: Annotated[float, Gt(0.3), Le(1000)]
    focal_length_m: PositiveLength | None = None

    def circle_px(
        self, z: NDArray[np.float32], f_px: float, focal_length_m: float
    ) -> NDArray[np.float32]:
        """Diameter [px] of the disc of a point at depths z (H, W) [m], inf for the sky; negative
        beyond the focus.

        f_px: the camera's focal length [px]. focal_length_m: the lens's [m].
        """
        with np.errstate(divide="ignore"):
            nearer = 1 / z - np.float32(1 / self.focus_m)
        return np.asarray(focal_length_m / self.f_number * f_px * nearer, np.float32)

    def check(self, focal_length_m: float | None) -> None:
        """Refuse a focal length that is given twice, or not at all, and a focus within it.
        focal_length_m: see `Optics.check`.
        """
        field = "optics.defocus.focal_length_m"
        given = self.focal_length_m
        if given is None and focal_length_m is None:
            words = (
                "is needed in metres, as the camera is given by its field of view;"
                " or give camera.focal_length_m and camera.pixel_size_m"
            )
            raise ParameterError(field, words)
        if given is not None and focal_length_m is not None:
            raise ParameterError.conflict(field, "camera.focal_length_m", given)
        f = given or focal_length_m or 0.0
        if self.focus_m <= f:
            limit = f"the focal length, {f:g} m"
            raise ParameterError.bound(
                "optics.defocus.focus_m", "farther than", limit, self.focus_m
            )


@spec
class Optics:
    """The errors of a lens, of a picture whose values are linear in the light: defocus, then
    lateral colour, then vignetting.

    At r, the distance from the principal point in units of that of the picture's farthest corner,
    and theta, the angle between a pixel's ray and the optical axis:

    brightness    (1 - vignetting r^2), and with `cos4` cos^4 theta times that: the natural one of a
                  lens whose aperture is seen aslant
    red, blue     are magnified about the principal point by 1 + red_px / R and 1 + blue_px / R, R
                  being the corner's distance [px]
    defocus       each point a disc as large as its depth makes it, seen in the whole picture

    Defocus is composed of layers of depth, from far to near, each blurred by the mean disc of its
    pixels; these differ from their layer's by at most 0.25 px + 5 % of the diameter. What the sharp
    surface in front hides cannot be seen through its blurred edge: there the layer behind is
    continued. The depth is that of the exposure's middle. A disc is at most as large as a quarter
    of the picture's height.

    Cost of a picture of 640 x 480 on one core of a small server: vignetting 2 ms, lateral colour 3
    ms, defocus 40 ms where discs have up to 4 px and 110 ms where they have up to 25 px (the start
    of `arm_ibvs`, with a target before a floor).

    Args:
        vignetting: share of the light that is lost in the picture's farthest corner [1]; e.g.
            `0.4`.
        cos4: the natural vignetting; only with `perspective`.
        red_px, blue_px: how much further out than green red and blue are in that corner [px]; e.g.
            `0.6`.
        defocus: the thin lens; None for a pinhole, in which everything is sharp. Only with
            `perspective`.

    Reference: Kolb, Mitchell & Hanrahan 1995, doi:10.1145/218380.218463 (the cos^4 law, vignetting
    and depth of field of a lens).
    """

    vignetting: Annotated[float, Ge(0), Lt(1)] = 0.0
    cos4: bool = False
    red_px: Shift = 0.0
    blue_px: Shift = 0.0
    defocus: Defocus | None = None

    def check(self, flat: bool, focal_length_m: float | None) -> None:
        """Refuse what the camera's lens cannot have.

        flat: it is a perspective lens. focal_length_m: the camera's [m]; None where it has a field
        of view instead. Raises ParameterError: it names the field, and what would work.
        """
        for field, given in (("cos4", self.cos4), ("defocus", self.defocus is not None)):
            if given and not flat:
                words = (
                    "camera perspective: wide lenses are made to have neither its cos^4 law nor a"
                    " depth of field to speak of"
                )
                raise ParameterError.only_for(f"optics.{field}", words)
        if self.defocus is not None:
            self.defocus.check(focal_length_m)


# discs of one layer differ by at most FINE_PX + COARSE of their diameter [px]
FINE_PX = 0.5
COARSE = 0.1
SHARP_PX = 0.3  # a disc of this diameter is one pixel [px]
SUBPIXELS = 8  # points along a pixel's side by which its share of a disc is measured
MOST = 0.25  # largest disc, as a share of the picture's height


class LensEffects:
    """Applies the errors of a camera's lens to its pictures.

    size: width and height of the picture [px]. centre: principal point (2,) [px]. ray: unit rays
    (..., 3) of pixels (..., 2).
    f_px, focal_length_m: focal length in pixels and, where the camera has it, in metres: for the
    defocus of a perspective camera.
    """

    def __init__(
        self,
        optics: Optics,
        size: tuple[int, int],
        centre: Array,
        ray: Callable[[Array], Array],
        f_px: float = 0.0,
        focal_length_m: float | None = None,
    ):
        self._optics = optics
        self._size = size
        self._centre = centre
        self._ray = ray
        self._f_px = f_px
        self._focal_length_m = focal_length_m
        self.needs_depth = optics.defocus is not None

    def of(self, image: NDArray[np.uint8], depth: DepthImage | None) -> Floats:
        """The light (H, W, 3) behind the lens of a rendered picture (H, W, 3) with the depths (H,
        W) [m] along the axis.
        """
        light = image.astype(np.float32)
        optics = self._optics
        if optics.defocus is not None and depth is not None:
            most = np.float32(MOST * self._size[1])
            focal_length_m = optics.defocus.focal_length_m or self._focal_length_m or 0.0
            light = defocused(
                light,
                np.clip(optics.defocus.circle_px(depth, self._f_px, focal_length_m), -most, most),
            )
        for channel, px in ((0, optics.red_px), (2, optics.blue_px)):
            if px:
                light[..., channel] = self._magnified(light[..., channel], px)
        if optics.cos4 or optics.vignetting > 0:
            light *= self._shading
        return light

    @cached_property
    def _radius_px(self) -> Floats:
        """Distance of each pixel from the principal point (H, W) [px]."""
        grid = np.asarray(pixel_grid(*self._size) - self._centre, np.float32)
        return np.hypot(grid[..., 0], grid[..., 1])

    @cached_property
    def _shading(self) -> Floats:
        r = self._radius_px / float(self._radius_px.max())
        brightness = 1 - self._optics.vignetting * r * r
        if self._optics.cos4:
            brightness = brightness * self._ray(pixel_grid(*self._size))[..., 2] ** 4
        return np.asarray(brightness, np.float32)[..., None]

    def _magnified(self, channel: Floats, px: float) -> Floats:
        """A colour (H, W) magnified about the principal point, so that the farthest corner moves
        out by `px`.
        """
        scale = 1 + px / float(self._radius_px.max())
        cx, cy = self._centre
        inverse = np.array([[1 / scale, 0, cx - cx / scale], [0, 1 / scale, cy - cy / scale]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size = channel.shape[1], channel.shape[0]
        return cv2.warpAffine(channel, inverse, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)


def defocused(light: Floats, circle_px: Floats) -> Floats:
    """A picture (H, W, 3) with each point as a disc of a diameter (H, W) [px], negative beyond the
    focus.

    Layers of similar discs, from far to near, are blurred with their masks, and laid one over the
    other:
    (C, A) <- (C (1 - a) + c, A (1 - a) + a); the picture is C / A.
    """
    step = COARSE / FINE_PX
    layer = np.rint(np.sign(circle_px) * np.log1p(step * np.abs(circle_px)) / COARSE).astype(
        np.int32
    )
    lowest = int(layer.min())
    flat = (layer - lowest).ravel()
    count = np.bincount(flat)
    size = np.bincount(flat, weights=np.abs(circle_px).ravel()) / np.maximum(count, 1)
    if np.count_nonzero(count) == 1:
        return _blurred(light, disc(float(size[count > 0][0])))
    height, width = layer.shape
    # The mask is a fourth colour: picture and mask are blurred in one go.
    laid = np.zeros((height, width, 4), np.float32)
    masked = np.ones((height, width, 4), np.float32)
    masked[..., :3] = light
    for i in np.flatnonzero(count):
        kernel = disc(float(size[i]))
        rows, columns = _window(layer == i + lowest, kernel.shape[0] // 2)
        own = (layer[rows, columns] == i + lowest)[..., None]
        part = _blurred(masked[rows, columns] * own, kernel)
        laid[rows, columns] *= 1 - part[..., 3:]
        laid[rows, columns] += part
    return laid[..., :3] / laid[..., 3:]


def disc(diameter_px: float) -> Floats:
    """A disc as a kernel (n, n) with sum 1: each pixel has the share of its area that the disc
    covers.
    """
    if diameter_px <= SHARP_PX:
        return np.ones((1, 1), np.float32)
    n = 2 * math.ceil((diameter_px - 1) / 2) + 1
    at = (np.arange(n * SUBPIXELS) + 0.5) / SUBPIXELS - n / 2
    inside = at * at + (at * at)[:, None] <= diameter_px**2 / 4
    shares = inside.reshape(n, SUBPIXELS, n, SUBPIXELS).sum(axis=(1, 3)).astype(np.float32)
    return shares / shares.sum()


def _blurred(image: Floats, kernel: Floats) -> Floats:
    """An image (H, W, ...) convolved with a kernel,
    continued beyond its border as it ends there.
    """
    if kernel.size == 1:
        return image
    # Of large kernels OpenCV multiplies Fourier transforms, which leaves -1e-20 where nothing
    # shines.
    return np.maximum(cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_REPLICATE), 0)


def _window(mask: NDArray[np.bool_], reach: int) -> tuple[slice, slice]:
    """The rows and columns round a mask (H, W), `reach` more on each side."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return (
        slice(max(0, rows[0] - reach), rows[-1] + 1 + reach),
        slice(max(0, columns[0] - reach), columns[-1] + 1 + reach),
    )
