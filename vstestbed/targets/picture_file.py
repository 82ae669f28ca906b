"""Picture files: read, and made into textures."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.core.assets import folder
from vstestbed.core.errors import ParameterError
from vstestbed.core.named_files import absolute_file, place_of_file

MOST_PX = 2048
"""Longest side of a texture, with its margin [px]."""
MARGIN = 16
"""The margin is two sixteenths of the texture, one for the edges on each side: OpenGL repeats textures, and without it a picture's right
edge would shine through at its left edge, from afar most."""
MOST_BYTES = 64_000_000
KINDS = (".png", ".jpg", ".jpeg")
TEXTURE = "texture:"
"""Before the name of a bundled texture, in place of a file's."""


@dataclass(frozen=True)
class PictureFile:
    """A picture: its size in the file [px], and its texture as `Sheet` has it."""

    width: int
    height: int
    png: bytes
    share: tuple[float, float]


def textures() -> dict[str, Path]:
    """The file of each bundled texture, by its name."""
    return {path.stem: path for path in sorted((folder("models") / "textures").iterdir()) if path.suffix in KINDS}


def picture_name(file: str) -> str:
    """A picture's name that does not depend on the folder: its absolute path, `package:NAME/path`, or `texture:NAME` as it is.

    Raises:
        ParameterError: `file` names no kind of picture, or no bundled texture.
    """
    if file.startswith(TEXTURE):
        if file.removeprefix(TEXTURE) not in textures():
            names = ", ".join(f"{TEXTURE}{name}" for name in textures())
            raise ParameterError("file", f"names no bundled texture; there are {names}", file)
        return file
    if not file.lower().endswith(KINDS):
        raise ParameterError("file", f"must be a picture, FILE.png or FILE.jpg, or {TEXTURE}NAME ({', '.join(textures())})", file)
    return absolute_file(file, Path.cwd())


def place_of_picture(file: str) -> Path:
    """The path of a picture of a name by `picture_name`.

    Raises:
        ParameterError: it is not there.
    """
    return textures()[file.removeprefix(TEXTURE)] if file.startswith(TEXTURE) else place_of_file(file)


def read_picture(path: Path) -> PictureFile:
    """A PNG or JPEG file, upright as its EXIF data says, in 8 bits a channel; what is transparent is white.

    Raises:
        ParameterError: `file` is no picture, or too large.
    """
    return _read(path, path.stat().st_mtime_ns)


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """Pixels (H, W, 3) of a PNG or JPEG file, red first, as `read_picture` reads them, at the file's own size.

    Raises:
        ParameterError: `file` is no picture.
    """
    return np.ascontiguousarray(decoded(path)[..., ::-1])


@functools.lru_cache(maxsize=8)
def _read(path: Path, changed: int) -> PictureFile:
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise ParameterError("file", f"has {size / 1e6:.0f} MB; a picture may have {MOST_BYTES / 1e6:.0f}: save it smaller", str(path))
    return texture_of(decoded(path))


def texture_of(image: NDArray[np.uint8]) -> PictureFile:
    """The texture of a picture's pixels (H, W, 3), blue first."""
    height, width = image.shape[:2]
    for axis in (0, 1):
        image = _stretched(image, axis)
    return PictureFile(width, height, cv2.imencode(".png", image)[1].tobytes(), (1 - 2 / MARGIN, 1 - 2 / MARGIN))


def read_tile(path: Path, albedo: float) -> PictureFile:
    """A PNG or JPEG file as a texture that is repeated, without a margin, its colours multiplied by `albedo`.

    Each side has a power of two of pixels: the smaller copies of the texture are then halves of each other.

    Raises:
        ParameterError: `file` is no picture.
    """
    image = decoded(path)
    height, width = image.shape[:2]
    size = tuple(min(MOST_PX, max(MARGIN, 1 << (n - 1).bit_length())) for n in (width, height))
    if size != (width, height):
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA if size < (width, height) else cv2.INTER_CUBIC)
    shaded = np.rint(image.astype(np.float32) * np.float32(albedo)).astype(np.uint8)
    return PictureFile(width, height, cv2.imencode(".png", shaded)[1].tobytes(), (1.0, 1.0))


def as_png(path: Path) -> bytes:
    """A picture file as PNG, the only kind that MuJoCo reads.

    Raises:
        ParameterError: `file` is no picture.
    """
    return cv2.imencode(".png", decoded(path))[1].tobytes()


def _stretched(image: NDArray[np.uint8], axis: int) -> NDArray[np.uint8]:
    """An image (H, W, 3) made longer, so that with its margin it has a power of two of pixels along an axis; MOST_PX at the most.

    Of another number of pixels, the smaller copies of a texture are not the halves of each other, and what is in them is shifted.
    """
    n = image.shape[axis]
    side = MARGIN
    while side < MOST_PX and side * (1 - 2 / MARGIN) < n:
        side *= 2
    edge = side // MARGIN
    long = side - 2 * edge
    size = (long, image.shape[0]) if axis == 1 else (image.shape[1], long)
    if n != long:
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA if long < n else cv2.INTER_CUBIC), np.uint8)
    margins = [(0, 0), (0, 0), (0, 0)]
    margins[axis] = (edge, edge)
    return np.roll(np.pad(image, margins, mode="edge"), -edge, axis)


def decoded(path: Path) -> NDArray[np.uint8]:
    """The pixels (H, W, 3) of a picture file, blue first, upright as its EXIF data says; what is transparent is white.

    Raises:
        ParameterError: `file` is no picture.
    """
    raw = np.frombuffer(path.read_bytes(), np.uint8)
    try:
        plain = cv2.imdecode(raw, cv2.IMREAD_COLOR)
        full = cv2.imdecode(raw, cv2.IMREAD_UNCHANGED) if len(raw) and raw[0] == 0x89 else None  # of PNG, which alone has transparency
    except cv2.error as error:  # empty, or more pixels than OpenCV reads
        plain, full, why = None, None, " ".join(str(error.err).split())
    else:
        why = "it is damaged, or another kind of file"
    if plain is None:
        raise ParameterError("file", f"cannot be read as a picture ({why}); works: a PNG or JPEG file", str(path))
    image = np.asarray(plain, np.uint8)
    if full is None or full.ndim < 3 or full.shape[2] != 4:
        return image
    top = 255 if full.dtype == np.uint8 else 65535
    alpha = full[..., 3:].astype(np.float32) / top
    return np.rint(full[..., :3].astype(np.float32) * (255 / top) * alpha + 255 * (1 - alpha)).astype(np.uint8)
