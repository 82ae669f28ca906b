"""A picture of one's own as the target: a photograph, a poster, a printed page."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import cached_property
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from annotated_types import Ge, Gt, Le, Len
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Pixel, PositiveLength
from vstestbed.core.spec import spec
from vstestbed.targets.base import Target
from vstestbed.targets.picture_file import PictureFile, picture_name, place_of_picture, read_picture, read_rgb, texture_of
from vstestbed.targets.points import BOARD_MARGIN
from vstestbed.targets.surfaces import Sheet


@spec
class PictureTarget(Target):
    """A picture on a board, in z = 0 about the origin, upright for a camera that faces it: x to its right, y down.

    Its markers are its corners, in the order of `Square`, or points in it. They are drawn over it; with `draw_markers: false` they
    are those that the picture itself shows: `marker` then says what they look like, so that the detector finds them (tags of that
    family and size, numbered from `first_id` in the order of the points; discs of that radius, with the hues 0, 360/n, ...), or
    nothing is to be seen there, which the oracle does not mind.

    Args:
        file: a PNG or JPEG file, absolute, relative to the scenario's file, or `package:NAME/path`; or a bundled one: `texture:poster`
            (structure at all scales), `texture:leaves` (the same, and no part comes twice), `texture:brick`, `texture:text`, `texture:flat`
            (hardly any structure) or `texture:repetitive` (tiles that are all the same). Above 2048 px a side it is reduced.
        width: width of the picture [m]; its height follows from the file.
        at_px: marker points in the picture, (u, v) in pixels of the file [px], the centre of the first one (0, 0); none: its corners.
        draw_markers: draw markers over the picture; false: it shows them itself.
        lit: shaded by the scene's lights, else of constant brightness.
        albedo: by which the colours of the file are multiplied [1].
        gloss: share of a light that its surface mirrors as a highlight; 0 is matte paper, 1 a picture behind varnish [1]. The room's
            own light gives one of 38 grey levels at most, `world.light` one as bright as its lamp.
    """

    kind: Literal["picture"] = "picture"
    file: str
    width: PositiveLength
    at_px: Annotated[tuple[Pixel, ...], Len(0, 24)] = ()
    draw_markers: bool = True
    lit: bool = True
    albedo: Annotated[float, Gt(0), Le(1)] = 1.0
    gloss: Annotated[float, Ge(0), Le(1)] = 0.0
    one_sided: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Read the picture; refuse points beyond it, and markers that overlap."""
        object.__setattr__(self, "file", picture_name(self.file))  # frozen; a run remembers where its picture is
        if self.pad:
            raise ParameterError("pad", "has no place behind a picture, which has a board of its own; works: target square or points")
        found = self._found
        for i, (u, v) in enumerate(self.at_px):
            if not (-0.5 <= u <= found.width - 0.5 and -0.5 <= v <= found.height - 0.5):
                raise ParameterError(f"at_px.{i}", f"must be in the picture, which has {found.width} x {found.height} px", [u, v])
        if self.gloss and not self.lit:
            raise ParameterError("gloss", "must be 0 with lit: false, where no light acts on the picture", self.gloss)
        self._check_markers()

    @cached_property
    def _found(self) -> PictureFile:
        return read_picture(self.source)

    @property
    def source(self) -> Path:
        """The picture's file."""
        return place_of_picture(self.file)

    def repainted(self, change: Callable[[NDArray[np.uint8]], NDArray[np.uint8]]) -> Self:
        """The same target with its picture changed: of the file's pixels (H, W, 3), red first, those that are drawn. `source` stays."""
        other = copy(self)
        other.__dict__["_found"] = texture_of(change(read_rgb(self.source))[..., ::-1])  # frozen; what `_found` else reads from the file
        return other

    @property
    def height(self) -> float:
        """Of the picture [m]."""
        return self.width * self._found.height / self._found.width

    @cached_property
    def points(self) -> Array:
        """The picture's corners, (-,-), (+,-), (+,+), (-,+), or the points `at_px`, in the target frame, shape (N, 3) [m]."""
        if not self.at_px:
            x, y = self.width / 2, self.height / 2
            return np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]])
        found = self._found
        off = np.array(self.at_px) + 0.5 - [found.width / 2, found.height / 2]
        return np.column_stack([off * self.width / found.width, np.zeros(len(off))])

    @property
    def sheet(self) -> Sheet:
        """The picture."""
        return Sheet(self.width, self.height, self._found.png, self._found.share, self.lit, self.gloss, self.albedo)

    @property
    def shows_markers(self) -> bool:
        """Whether markers are drawn over the picture."""
        return self.draw_markers

    @property
    def board_half_m(self) -> tuple[float, float]:
        """As large as the picture; where drawn markers reach beyond it, `BOARD_MARGIN` marker radii beyond their edges."""
        half = np.array([self.width, self.height]) / 2
        if self.draw_markers:
            out = np.abs(self.points[:, :2]).max(axis=0) + self.marker.radius
            half = np.where(out > half, out + BOARD_MARGIN * self.marker.radius, half)
        return float(half[0]), float(half[1])
