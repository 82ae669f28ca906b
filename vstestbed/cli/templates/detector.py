"""The detector my_detector, from a picture to the markers' pixels.

    pytest my_detector.py
    vstestbed run ibvs_book --plugin my_detector.py --set detector=my_detector

It takes the centre of a marker's hue. A learned one loads its network in `init` and asks it in
`detect`; weights belong into the fields.
"""

from typing import ClassVar, Literal

import numpy as np

import vstestbed as vs
import vstestbed.testing


@vs.DETECTORS.add
@vs.spec
class MyDetector(vs.DetectorBase):
    """The mean of all pixels of each marker's hue, weighted by their chroma.

    Args:
        chroma: least difference of the largest and the smallest channel [grey levels].
    """

    kind: Literal["my_detector"] = "my_detector"  # its word in a scenario
    chroma: int = 60
    needs_image: ClassVar[bool] = True
    needs_truth: ClassVar[bool] = False  # only the oracle may have it
    markers: ClassVar[tuple[str, ...]] = ("disc", "sphere")  # the kinds that it can see; empty: any

    def init(self):
        """The state before the first picture: a network, a track, nothing."""
        return

    def regions_of_interest(self, state, camera, target):
        """Regions of interest of the next picture, which saves rendering; None: all of it."""
        return

    def detect(self, state, picture, view, camera, target, rng):
        """The next state, and uv (N, 2) [px] of the markers, whose hues are `target.hues_deg`
        [deg]; NaN for one that is not found.

        picture.images: (H, W, 3) uint8 RGB of each panel of the camera (one, but for spherical);
        the first pixel's centre is (0, 0).
        """
        if picture is None or picture.image is None:
            raise vs.errors.ParameterError("picture", "is missing: detector my_detector needs one")
        chroma = np.ptp(picture.image, axis=2)
        v, u = np.nonzero(chroma >= self.chroma)
        # seen along the grey axis
        hue = np.degrees(np.angle(picture.image[v, u] @ np.exp(1j * np.radians([0, 120, 240]))))
        uv = np.full((len(target.hues_deg), 2), np.nan)
        for i, wanted in enumerate(target.hues_deg):
            own = np.abs((hue - wanted + 180) % 360 - 180) < min(15.0, 180 / len(uv))
            if own.any():
                uv[i] = np.average(np.column_stack([u, v])[own], axis=0, weights=chroma[v, u][own])
        return state, vs.Detection(uv=uv)


def test_my_detector():
    """It finds the markers of a rendered picture, and none in an empty one."""
    vstestbed.testing.check_detector(MyDetector())
