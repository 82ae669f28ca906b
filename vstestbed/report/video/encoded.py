"""Single pictures as files."""

from __future__ import annotations

import cv2
import numpy as np

from vstestbed.report.video.writer import Image

JPEG_QUALITY = 95
"""With colour at full size: a marker's rim keeps its hue."""


def png_of(image: Image) -> bytes:
    """A picture (H, W, 3) uint8 RGB as PNG."""
    return _encoded(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])


def jpeg_of(image: Image) -> bytes:
    """A picture (H, W, 3) uint8 RGB as JPEG."""
    full = int(cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
    return _encoded(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, full])


def _encoded(kind: str, image: Image, settings: list[int]) -> bytes:
    return np.asarray(cv2.imencode(kind, cv2.cvtColor(image, cv2.COLOR_RGB2BGR), settings)[1]).tobytes()
