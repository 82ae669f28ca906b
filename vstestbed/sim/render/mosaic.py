"""A mosaic of colour filters: one colour in each pixel of the sensor, the other two interpolated from its neighbours."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.camera.sensor_noise import SensorNoise

CODES = {
    "linear": {
        "rggb": cv2.COLOR_BayerRGGB2RGB,
        "grbg": cv2.COLOR_BayerGRBG2RGB,
        "gbrg": cv2.COLOR_BayerGBRG2RGB,
        "bggr": cv2.COLOR_BayerBGGR2RGB,
    },
    "edge_aware": {
        "rggb": cv2.COLOR_BayerRGGB2RGB_EA,
        "grbg": cv2.COLOR_BayerGRBG2RGB_EA,
        "gbrg": cv2.COLOR_BayerGBRG2RGB_EA,
        "bggr": cv2.COLOR_BayerBGGR2RGB_EA,
    },
}


class Mosaic:
    """The filters before a sensor's pixels, and their inverse as far as there is one.

    Args:
        pattern: colours of the first two pixels of the first row, and of the second row. demosaic: `linear` or `edge_aware`.
    """

    def __init__(self, pattern: str, demosaic: str):
        self._code, self._filters = CODES[demosaic][pattern], ["rgb".index(colour) for colour in pattern]

    def sampled(self, light: NDArray[np.float32]) -> NDArray[np.float32]:
        """The light (H, W) that passes the filters, of light (H, W, 3)."""
        passed = np.empty(light.shape[:2], np.float32)
        for i, channel in enumerate(self._filters):
            part = slice(i // 2, None, 2), slice(i % 2, None, 2)
            passed[part] = light[(*part, channel)]
        return passed

    def filled(self, numbers: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Numbers of all three colours (H, W, 3) from those of the pixels (H, W)."""
        return np.asarray(cv2.demosaicing(numbers, self._code), np.uint16)


def mosaic_of(sensor: SensorNoise | None) -> Mosaic | None:
    """The mosaic of a sensor; None for one that measures all colours in each pixel."""
    return None if sensor is None or sensor.mosaic == "none" else Mosaic(sensor.mosaic, sensor.demosaic)
