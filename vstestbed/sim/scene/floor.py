"""What the floor looks like."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Gt, Le, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.quantity import Narrower, PositiveLength
from vstestbed.core.spec import spec
from vstestbed.targets.picture_file import picture_name, place_of_picture, read_rgb


@spec
class Floor:
    """The surface of the floor, in place of the room's matte grey checker; scenery that has a floor of its own shows that.

    Rays compute the highlight in every pixel; OpenGL at the corners of a grid of 0.05 m, between which it interpolates, and for which
    the floor is drawn for 10 m about the origin in place of 20 m. Of a picture of 640 x 480 in software OpenGL (6.5 ms) gloss or windows
    take 12 ms more, a mirror 1.5 ms; by rays (115 ms) gloss takes 15 ms, a window 45 ms more. A texture costs nothing measurable.

    Args:
        texture: a picture that covers the floor in tiles: a PNG or JPEG file, or a bundled texture as of target `picture`, such as
            `texture:brick`; none: the room's checker. Where r, g and b differ by 60 grey levels the detectors `blobs` and `lines` may
            take parts of it for markers; e.g. `texture:brick`.
        tile_m: width of one tile along x; its height follows from the picture [m].
        albedo: by which the colours of the texture are multiplied [1].
        gloss: share of a lamp's light that the floor mirrors as a highlight (h . n)^`sharpness`, h halfway between the directions to the
            lamp and to the camera [1].
        sharpness: exponent of the highlight, which falls to a half at acos(2^(-1/sharpness)) from the mirror direction, as angle of h:
            10 degrees at 45 [1].
        mirror: by which the mirrored picture of what stands on the floor is multiplied and added to its colour; the sky is not mirrored.
            It needs OpenGL, and rays refuse it [1].

    Reference: Blinn 1977, doi:10.1145/563858.563893.
    """

    texture: str | None = None
    tile_m: Annotated[PositiveLength, Narrower(ge=0.01)] = 1.0
    albedo: Annotated[float, Gt(0), Le(1)] = 1.0
    gloss: Annotated[float, Ge(0), Le(1)] = 0.0
    sharpness: Annotated[float, Ge(1), Le(128)] = 45.0
    mirror: Annotated[float, Ge(0), Lt(1)] = 0.0

    def __post_init__(self) -> None:
        """Read the texture, and remember where it is."""
        if self.texture is not None:
            try:
                object.__setattr__(self, "texture", picture_name(self.texture))  # frozen; a run remembers where its picture is
                read_rgb(place_of_picture(self.texture))
            except ParameterError as error:
                raise ParameterError("texture", error.problem, error.found) from None
