"""What a real lens does to the light besides projecting it: vignetting, lateral chromatic aberration, defocus."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositiveLength
from vstestbed.core.spec import spec

Shift = Annotated[float, Ge(-20), Le(20)]


@spec
class Defocus:
    """A thin lens of aperture A = f / N, f its focal length and N its f-number, focused at z_f: a point at depth z becomes a disc of

    c = A |z - z_f| / z  f / (z_f - f)

    on the sensor, its circle of confusion. The sensor is f z_f / (z_f - f) behind the lens, which the camera's focal length in pixels
    f_px, as calibrated at this focus, stands for: in pixels c = A f_px |1/z - 1/z_f|, whatever the size of a pixel. Nothing is added for
    diffraction.

    Args:
        focus_m: depth z_f of what is in focus [m]; e.g. `0.5`.
        f_number: N, focal length over diameter of the aperture [1]; e.g. `1.4`.
        focal_length_m: f of the lens [m]; by default the camera's `focal_length_m`, and needed for a camera given by its field of view;
            e.g. `0.008`.

    Reference: Potmesil & Chakravarty 1982, doi:10.1145/357299.357300 (the circle of confusion of a thin lens in rendered pictures).
    """

    focus_m: PositiveLength
    f_number: Annotated[float, Gt(0.3), Le(1000)]
    focal_length_m: PositiveLength | None = None

    def circle_px(self, z: NDArray[np.float32], f_px: float, focal_length_m: float) -> NDArray[np.float32]:
        """Diameter [px] of the disc of a point at depths z (H, W) [m], inf for the sky; negative beyond the focus.

        f_px: the camera's focal length [px]. focal_length_m: the lens's [m].
        """
        with np.errstate(divide="ignore"):
            nearer = 1 / z - np.float32(1 / self.focus_m)
        return np.asarray(focal_length_m / self.f_number * f_px * nearer, np.float32)


@spec
class Optics:
    """The errors of a lens, of a picture whose values are linear in the light: defocus, then lateral colour, then vignetting.

    At r, the distance from the principal point in units of that of the picture's farthest corner, and theta, the angle between a
    pixel's ray and the optical axis:

    brightness    (1 - vignetting r^2), and with `cos4` cos^4 theta times that: the natural one of a lens whose aperture is seen aslant
    red, blue     are magnified about the principal point by 1 + red_px / R and 1 + blue_px / R, R being the corner's distance [px]
    defocus       each point a disc as large as its depth makes it, seen in the whole picture

    Defocus is composed of layers of depth, from far to near, each blurred by the mean disc of its pixels; these differ from their layer's
    by at most 0.25 px + 5 % of the diameter. What the sharp surface in front hides cannot be seen through its blurred edge: there the
    layer behind is continued. The depth is that of the exposure's middle. A disc is at most as large as a quarter of the picture's height.

    Cost of a picture of 640 x 480 on one core of a small server: vignetting 2 ms, lateral colour 3 ms, defocus 40 ms where discs have up
    to 4 px and 110 ms where they have up to 25 px (the start of `arm_ibvs`, with a target before a floor).

    Args:
        vignetting: share of the light that is lost in the picture's farthest corner [1]; e.g. `0.4`.
        cos4: the natural vignetting; only with `perspective`.
        red_px, blue_px: how much further out than green red and blue are in that corner [px]; e.g. `0.6`.
        defocus: the thin lens; None for a pinhole, in which everything is sharp. Only with `perspective`.

    Reference: Kolb, Mitchell & Hanrahan 1995, doi:10.1145/218380.218463 (the cos^4 law, vignetting and depth of field of a lens).
    """

    vignetting: Annotated[float, Ge(0), Lt(1)] = 0.0
    cos4: bool = False
    red_px: Shift = 0.0
    blue_px: Shift = 0.0
    defocus: Defocus | None = None

    def check(self, flat: bool, focal_length_m: float | None) -> None:
        """Refuse what the camera's lens cannot have.

        flat: it is a perspective lens. focal_length_m: the camera's [m]; None where it has a field of view instead.

        Raises:
            ParameterError: it names the field, and what would work.
        """
        for field, given in (("cos4", self.cos4), ("defocus", self.defocus is not None)):
            if given and not flat:
                words = "is for camera perspective: wide lenses are made to have neither its cos^4 law nor a depth of field to speak of"
                raise ParameterError(f"optics.{field}", words)
        if self.defocus is not None:
            _check_focus(self.defocus, focal_length_m)

    def shading(self, r: Array, cosine: Array) -> NDArray[np.float32]:
        """Brightness (H, W) [1] at distances r (H, W) [corner's distance] and cosines (H, W) of the angle from the axis."""
        mechanical = 1 - self.vignetting * r * r
        return np.asarray(mechanical * cosine**4 if self.cos4 else mechanical, np.float32)

    @property
    def shades(self) -> bool:
        """Whether brightness depends on the place."""
        return self.cos4 or self.vignetting > 0


def _check_focus(defocus: Defocus, focal_length_m: float | None) -> None:
    """Refuse a lens without a focal length or with two, and a focus that no image is formed of."""
    given = defocus.focal_length_m
    if given is None and focal_length_m is None:
        words = "is needed in metres, as the camera is given by its field of view; or give camera.focal_length_m and camera.pixel_size_m"
        raise ParameterError("optics.defocus.focal_length_m", words)
    if given is not None and focal_length_m is not None:
        raise ParameterError("optics.defocus.focal_length_m", "says the same as camera.focal_length_m; leave it out", given)
    f = given or focal_length_m or 0.0
    if defocus.focus_m <= f:
        raise ParameterError("optics.defocus.focus_m", f"must be farther than the focal length, {f:g} m", defocus.focus_m)
