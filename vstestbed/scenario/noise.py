"""The noise block of a scenario."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Lt

from vstestbed.core.quantity import Narrower, Pixels, Sigma
from vstestbed.core.spec import spec
from vstestbed.sim.render.noise import Drift
from vstestbed.vision.perturb import PERTURBATIONS, Perturbation


@spec
class Noise:
    """Sensor noise.

    Args:
        image_sigma: standard deviation of Gaussian noise on each channel of the picture, of 0 to 255 [grey levels]. Its effect on a
            measured coordinate depends on the detector: with `blobs` and its `grey` moments, a standard deviation of about .0025 px
            per grey level for discs of 8 px radius. Under 1 it has hardly any effect, above 20 markers get lost; e.g. `2`.
        pixel_sigma_px: standard deviation of Gaussian noise added to each measured coordinate, for every detector [px]; e.g. `0.1`.
        dropout: probability that a detected marker is not reported, for every detector [1]; e.g. `0.05`.
        drift: slow drift of the picture's brightness and colour.
        perturb: further kinds of noise, of the finished picture or of measured coordinates, in this order (`vision.perturb`).
    """

    image_sigma: Annotated[Sigma, Narrower(le=255)] = 0.0
    pixel_sigma_px: Pixels = 0.0
    dropout: Annotated[float, Ge(0), Lt(1)] = 0.0
    drift: Drift = Drift()
    perturb: tuple[Annotated[Perturbation, PERTURBATIONS], ...] = ()

    @property
    def on_pictures(self) -> bool:
        """Whether a perturbation changes pictures."""
        return any("picture" in kind.changes for kind in self.perturb)

    def draws(self, pictures: bool = True) -> bool:
        """Whether a seed makes a difference; pictures: the detector works on them."""
        on_pixels = self.pixel_sigma_px > 0 or any("pixels" in kind.changes for kind in self.perturb)
        return on_pixels or (pictures and (self.image_sigma > 0 or self.on_pictures))
