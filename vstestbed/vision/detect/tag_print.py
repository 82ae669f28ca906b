"""Printed tags: images of each family's tags, for the textures of the scene."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.targets.markers import Marker, Tag

PX_PER_MODULE = 16
"""Texels along a module: a power of two, so that the edges stay between texels at every level of OpenGL's mipmap."""


@lru_cache
def dictionary(family: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of a family of tags."""
    kind, _, name = family.partition("_")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{name}" if kind == "apriltag" else f"DICT_{name.upper()}"))


def tag_picture(tag: Tag, number: int, px: int = PX_PER_MODULE) -> NDArray[np.uint8]:
    """A tag with its quiet zone of one module, `px` pixels a module: 0 and 255, shape (px (modules + 2),) * 2."""
    black = cv2.aruco.generateImageMarker(dictionary(tag.family), number, tag.modules * px)
    return np.pad(np.asarray(black, np.uint8), px, constant_values=255)


def tag_png(tag: Tag, number: int) -> bytes:
    """The same as a PNG file."""
    return cv2.imencode(".png", tag_picture(tag, number))[1].tobytes()


def printed(marker: Marker, i: int) -> tuple[str, bytes]:
    """Name and PNG file of what is printed on marker i of a target.

    Raises:
        TypeError: nothing is.
    """
    if not isinstance(marker, Tag):  # the one marker with a print; the picture comes from OpenCV, which targets do without
        raise TypeError(f"nothing is printed on a {marker.kind}")
    number = marker.first_id + i
    return f"{marker.family}_{number}", tag_png(marker, number)
