"""Draw the bundled textures again: `python models/textures/make.py [NAME ...] [--to FOLDER]`; the
same pixels for the same OpenCV.

Small differences are OpenCV's: its letters and its JPEG change by a grey level or two between
versions.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from drawing import leaves, page, poster, things, walls
from drawing.canvas import Image

HERE = Path(__file__).resolve().parent
SEED = 21
QUALITY = 90
ENDINGS = {"repetitive": "png"}
"""Of a picture that repeats itself, PNG is smaller than JPEG, and all its parts stay the same."""
DRAWN: dict[str, Callable[[np.random.Generator], Image]] = {
    "poster": poster.draw,
    "brick": walls.brick,
    "text": page.draw,
    "flat": walls.flat,
    "repetitive": walls.repetitive,
    "leaves": leaves.draw,
    "alphabet": things.alphabet,
    "objects": things.objects,
    "faint": things.faint,
    "small_print": things.small_print,
    "clutter": things.clutter,
}


def drawn(name: str) -> np.ndarray:
    """A texture (H, W, 3) uint8, blue first, as it is before its file is compressed."""
    image = DRAWN[name](np.random.default_rng([SEED, list(DRAWN).index(name)]))
    return np.rint(image[..., ::-1] * 255).astype(np.uint8)


def main() -> None:
    """Write them as JPEG files without subsampled colours, or as PNG."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("names", nargs="*", default=list(DRAWN), help="which; all by default")
    asked.add_argument("--to", type=Path, default=HERE, help="folder")
    given = asked.parse_args()
    jpeg = [
        cv2.IMWRITE_JPEG_QUALITY,
        QUALITY,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    ]
    png = [
        cv2.IMWRITE_PNG_COMPRESSION,
        9,
        cv2.IMWRITE_PNG_STRATEGY,
        cv2.IMWRITE_PNG_STRATEGY_FILTERED,
    ]
    for name in given.names:
        ending = ENDINGS.get(name, "jpg")
        path = given.to / f"{name}.{ending}"
        if not cv2.imwrite(str(path), drawn(name), png if ending == "png" else jpeg):
            raise OSError(f"{path} cannot be written")
        print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
