"""A picture of one's own as the target: a photograph, a poster, a printed page."""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable
from copy import copy
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from annotated_types import Len
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.lazy import cv2, quiet
from vstestbed.core.named_files import absolute_file, folder, place_of_file
from vstestbed.core.quantity import Pixel, PositiveLength, PositiveShare, Share
from vstestbed.core.spec import spec
from vstestbed.targets.base import BOARD_MARGIN, Target, in_plane

__all__ = [
    "SHARE",
    "TEXTURE",
    "PictureTarget",
    "as_png",
    "decoded",
    "picture_name",
    "place_of_picture",
    "read_rgb",
    "read_tile",
    "textures",
    "whole",
]

MOST_PX = 2048  # longest side of a texture, with its margin [px]
# The margin is two sixteenths of the texture, one for the edges on each side: OpenGL repeats
# textures, and without it a picture's right edge would shine through at its left edge, from afar
# most.
MARGIN = 16
# of the texture's width and height that the picture takes up, without the margin
SHARE = 1 - 2 / MARGIN
KINDS = (".png", ".jpg", ".jpeg")
TEXTURE = "texture:"  # before the name of a bundled texture, in place of a file's
Picture = NDArray[np.uint8]  # pixels (H, W, 3)
# a PNG file, and width and height [px] of the picture that it was made of
Texture = tuple[bytes, tuple[int, int]]


def textures() -> dict[str, Path]:
    """The file of each bundled texture, by its name."""
    return {
        path.stem: path
        for path in sorted((folder("models") / "textures").iterdir())
        if path.suffix in KINDS
    }


def picture_name(file: str) -> str:
    """A picture's name that does not depend on the folder: its absolute path, `package:NAME/path`,
    or `texture:NAME` as it is.
    """
    if file.startswith(TEXTURE):
        if file.removeprefix(TEXTURE) not in textures():
            names = ", ".join(f"{TEXTURE}{name}" for name in textures())
            raise ParameterError.unknown("file", "bundled texture", f"there are {names}", file)
        return file
    if not file.lower().endswith(KINDS):
        raise ParameterError(
            "file",
            f"must be a picture, FILE.png or FILE.jpg, or {TEXTURE}NAME ({', '.join(textures())})",
            file,
        )
    return absolute_file(file, Path.cwd())


def place_of_picture(file: str) -> Path:
    """The path of a picture of a name by `picture_name`; ParameterError where it is not there."""
    return (
        textures()[file.removeprefix(TEXTURE)] if file.startswith(TEXTURE) else place_of_file(file)
    )


def read_rgb(path: Path) -> Picture:
    """Pixels (H, W, 3) of a PNG or JPEG file, red first, as of `decoded`,
    at the file's own size.
    """
    return np.ascontiguousarray(decoded(path)[..., ::-1])


@functools.lru_cache(maxsize=8)
def read_picture(path: Path, written_ns: int) -> Texture:
    """A PNG or JPEG file, last written at a time [ns], as a texture, its pixels as of `decoded`."""
    return texture_of(decoded(path))


def texture_of(image: Picture) -> Texture:
    """The texture of a picture's pixels (H, W, 3), blue first.

    It has a margin at its right and below that repeats the outermost pixels, of the right (lower)
    edge and then, since textures repeat themselves, of the left (upper) one.
    """
    height, width = image.shape[:2]
    for axis in (0, 1):
        image = _stretched(image, axis)
    return _png(image), (width, height)


def read_tile(path: Path, albedo: float) -> Texture:
    """A PNG or JPEG file as a texture that is repeated, without a margin, its colours multiplied by
    `albedo`.

    Each side has a power of two of pixels: the smaller copies of the texture are then halves of
    each other.
    """
    image = decoded(path)
    height, width = image.shape[:2]
    sides = [min(MOST_PX, max(MARGIN, 1 << (n - 1).bit_length())) for n in (width, height)]
    image = _resized(image, *sides)
    shaded = np.rint(image.astype(np.float32) * np.float32(albedo)).astype(np.uint8)
    return _png(shaded), (width, height)


def as_png(path: Path) -> bytes:
    """A picture file as PNG, the only kind that MuJoCo reads."""
    return _png(decoded(path))


def _png(image: Picture) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def _resized(image: Picture, width: int, height: int) -> Picture:
    """An image (H, W, 3) of another size [px]; itself where it has that size."""
    size = width, height
    now = image.shape[1], image.shape[0]
    if size == now:
        return image
    how = cv2.INTER_AREA if size < now else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, size, interpolation=how), np.uint8)


def _stretched(image: Picture, axis: int) -> Picture:
    """An image (H, W, 3) made longer, so that with its margin it has a power of two of pixels along
    an axis; MOST_PX at the most.

    Of another number of pixels, the smaller copies of a texture are not the halves of each other,
    and what is in them is shifted.
    """
    shape = list(image.shape[:2])
    side = MARGIN
    while side < MOST_PX and side * SHARE < shape[axis]:
        side *= 2
    edge = side // MARGIN
    shape[axis] = side - 2 * edge
    height, width = shape
    image = _resized(image, width, height)
    margins = [(0, 0), (0, 0), (0, 0)]
    margins[axis] = (edge, edge)
    return np.roll(np.pad(image, margins, mode="edge"), -edge, axis)


def whole(raw: Picture) -> bool:
    """Whether the chunks of a PNG end within it; True of other files. Over a chunk of claimed
    gigabytes OpenCV 5.0 hangs.
    """
    at = 8
    if raw[:8].tobytes() != b"\x89PNG\r\n\x1a\n":
        return True
    while at + 12 <= len(raw):
        length, name = struct.unpack_from(">I4s", raw.data, at)
        at += 12 + length
        if name == b"IEND":
            return at <= len(raw)
    return False


def decoded(path: Path) -> Picture:
    """The pixels (H, W, 3) of a picture file, blue first, upright as its EXIF data says; what is
    transparent is white.

    Raises ParameterError: `file` is no picture.
    """
    raw = np.frombuffer(path.read_bytes(), np.uint8)
    plain = None
    full = None
    why = "it is damaged, or another kind of file"
    try:
        with quiet():
            if whole(raw):
                plain = cv2.imdecode(raw, cv2.IMREAD_COLOR)
            if plain is not None and raw[0] == 0x89:  # a PNG, which alone has transparency
                full = cv2.imdecode(raw, cv2.IMREAD_UNCHANGED)
    except cv2.error as error:  # empty, or more pixels than OpenCV reads
        plain = None
        why = " ".join(str(error.err).split())
    if plain is None:
        raise ParameterError.unreadable("file", why, "a PNG or JPEG file", str(path))
    image = np.asarray(plain, np.uint8)
    if full is None or full.ndim < 3 or full.shape[2] != 4:
        return image
    top = 255 if full.dtype == np.uint8 else 65535
    alpha = full[..., 3:].astype(np.float32) / top
    colour = full[..., :3].astype(np.float32) * (255 / top)
    return np.rint(colour * alpha + 255 * (1 - alpha)).astype(np.uint8)


@spec
class PictureTarget(Target):
    """A picture on a board, in z = 0 about the origin, upright for a camera that faces it: x to its
    right, y down.

    Its markers are its corners, in the order of `Square`, or points in it. They are drawn over it;
    with `draw_markers: false` they are those that the picture itself shows: `marker` then says what
    they look like, so that the detector finds them (tags of that family and size, numbered from
    `first_id` in the order of the points; discs of that radius, with the hues 0, 360/n, ...).

    Args:
        file: a PNG or JPEG file, absolute, relative to the scenario's file, or `package:NAME/path`;
            or a bundled one: `texture:poster` (structure at all scales), `texture:leaves` (the
            same, and no part comes twice), `texture:brick`, `texture:text`, `texture:flat` (hardly
            any structure), `texture:repetitive` (tiles that are all the same), `texture:alphabet`,
            `texture:objects` (one nut again and again), `texture:faint`, `texture:small_print` or
            `texture:clutter`. Above 2048 px a side it is reduced.
        width: width of the picture [m]; its height follows from the file.
        at_px: marker points in the picture, (u, v) in pixels of the file [px], the centre of the
            first one (0, 0); none: its corners.
        draw_markers: draw markers over the picture; false: it shows them itself.
        lit: shaded by the scene's lights, else of constant brightness.
        albedo: by which the colours of the file are multiplied [1].
        gloss: share of a light that its surface mirrors as a highlight; 0 is matte paper, 1 a
            picture behind varnish [1]. The room's own light gives one of 38 grey levels at most,
            `world.light` one as bright as its lamp.
    """

    kind: Literal["picture"] = "picture"
    file: str
    width: PositiveLength
    at_px: Annotated[tuple[Pixel, ...], Len(0, 24)] = ()
    draw_markers: bool = True
    lit: bool = True
    albedo: PositiveShare = 1.0
    gloss: Share = 0.0
    one_sided = True

    def __post_init__(self) -> None:
        # frozen; a run remembers where its picture is
        object.__setattr__(self, "file", picture_name(self.file))
        if self.pad:
            raise ParameterError.only_for(
                "pad", "target square or points; a picture has a board of its own"
            )
        width, height = self._texture[1]
        for i, (u, v) in enumerate(self.at_px):
            if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
                raise ParameterError.bound(
                    f"at_px.{i}", "within", f"the picture, which has {width} x {height} px", [u, v]
                )
        if self.gloss and not self.lit:
            raise ParameterError.fixed(
                "gloss",
                "0",
                self.gloss,
                where="with lit: false, where no light acts on the picture",
            )
        self._check_markers()

    @cached_property
    def _texture(self) -> Texture:
        return read_picture(self.source, self.source.stat().st_mtime_ns)

    @property
    def png(self) -> bytes:
        """The picture as a PNG file, with a margin (`texture_of`)."""
        return self._texture[0]

    @property
    def source(self) -> Path:
        return place_of_picture(self.file)

    def repainted(self, change: Callable[[Picture], Picture]) -> Self:
        """The same target with its picture changed: of the file's pixels (H, W, 3), red first,
        those that are drawn. `source` stays.
        """
        other = copy(self)
        # frozen; else it is read from the file
        other.__dict__["_texture"] = texture_of(change(read_rgb(self.source))[..., ::-1])
        return other

    @property
    def height(self) -> float:
        """Of the picture [m]."""
        width, height = self._texture[1]
        return self.width * height / width

    @cached_property
    def points(self) -> Array:
        """The picture's corners, (-,-), (+,-), (+,+), (-,+), or the points `at_px`, in the target
        frame, shape (N, 3) [m].
        """
        if not self.at_px:
            x = self.width / 2
            y = self.height / 2
            return np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]])
        width, height = self._texture[1]
        off = np.array(self.at_px) + 0.5 - [width / 2, height / 2]
        return in_plane(off * self.width / width)

    @property
    def sheet(self) -> Self:
        return self

    @property
    def board_half_m(self) -> tuple[float, float]:
        """As large as the picture; where drawn markers reach beyond it, `BOARD_MARGIN` marker radii
        beyond their edges.
        """
        half = np.array([self.width, self.height]) / 2
        if self.draw_markers:
            out = np.abs(self.points[:, :2]).max(axis=0) + self.marker.radius
            half = np.where(out > half, out + BOARD_MARGIN * self.marker.radius, half)
        return float(half[0]), float(half[1])
