"""The nuisance my_noise: in the picture, or of the measured pixels.

    pytest my_noise.py
    vstestbed run ibvs_book --plugin my_noise.py --set "noise.perturb=[my_noise]"

It is salt and pepper: a share of the pixels is black or white, others in each picture.
"""

from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Le

import vstestbed as vs
import vstestbed.testing


@vs.PERTURBATIONS.add
@vs.spec
class MyNoise(vs.PerturbationBase):
    """Each pixel is black or white with a probability.

    Args:
        share: probability of each pixel [1].
    """

    kind: Literal["my_noise"] = "my_noise"  # its word in a scenario
    share: Annotated[float, Ge(0), Le(1)] = 0.001
    changes: ClassVar[tuple[str, ...]] = ("picture",)  # or ("pixels",), for the method `pixels`

    def picture(self, state, image, t, rng):
        """The picture (H, W, 3) uint8 RGB of time t [s], changed; `state` is what `begin` has drawn
        once for the run.
        """
        hit = rng.random(image.shape[:2]) < self.share
        # `image` is a copy, which may be written to
        image[hit] = np.where(rng.random((hit.sum(), 1)) < 0.5, 0, 255)
        return image


def test_my_noise():
    """It changes pictures, and the same seed changes them in the same way."""
    vstestbed.testing.check_noise(MyNoise())
