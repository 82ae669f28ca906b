"""The noise block of a scenario."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Lt

from vstestbed.camera import Image
from vstestbed.core.errors import ParameterError
from vstestbed.core.quantity import Pixels, Sigma, TighterBounds
from vstestbed.core.registry import kind_of
from vstestbed.core.spec import spec
from vstestbed.imaging.sensor import Drift
from vstestbed.targets import Target
from vstestbed.vision.perturb import PERTURBATIONS, PerturbationBase, Perturbed

__all__ = ["Noise", "TargetNoise"]

GreySigma = Annotated[Sigma, TighterBounds(le=255)]
Kinds = tuple[Annotated[PerturbationBase, PERTURBATIONS], ...]


@spec
class TargetNoise:
    """Changes of the target's own picture, drawn once a run: a poster that has faded or is partly
    covered since the goal was taught.

    The picture of the goal shows it unchanged, and so does the file that a detector of the target's
    picture has learned. With `noise.perturb` the pictures of the camera change instead, each anew:
    a rectangle on a poster stays where it is on it, one in a picture moves. Both are called
    perturbed in the literature. It costs some 0.5 s when a run begins, and nothing in a picture.

    Args:
        image_sigma: standard deviation of Gaussian noise on each channel of each pixel of the file,
            of 0 to 255, added last [grey levels]; e.g. `12.75`.
        perturb: kinds of `noise.perturb` that change pictures, as they are at t = 0, in this order;
            e.g. `[{kind: erasing}]`.
    """

    image_sigma: GreySigma = 0.0
    perturb: Kinds = ()

    @property
    def none(self) -> bool:
        """Whether nothing is changed."""
        return self.image_sigma == 0 and not self.perturb

    def check(self, target: Target) -> None:
        """Refuse it for a target without a picture of its own, and kinds that change no picture."""
        if self.none:
            return
        if not hasattr(target, "repainted"):
            words = (
                f"changes the target's own picture, and a {kind_of(type(target))} has none;"
                " works: target picture, or noise.perturb"
            )
            raise ParameterError("noise.target", words)
        for i, kind in enumerate(self.perturb):
            if "picture" not in kind.changes:
                able = [
                    word
                    for word, member in PERTURBATIONS.members.items()
                    if "picture" in member.changes
                ]
                words = (
                    "changes measured pixels, and here the target's picture is changed;"
                    f" works: {', '.join(able)}"
                )
                raise ParameterError(f"noise.target.perturb.{i}", words, kind.kind)

    def on(self, target: Target, rng: np.random.Generator) -> Target:
        """The target with its picture as a run shows it; rng: of the run's stream for it."""
        if self.none:
            return target
        kinds, grains = rng.spawn(2)
        change = Perturbed(self.perturb, kinds).next_picture()

        def changed(image: Image) -> Image:
            (perturbed,) = change(0.0, (image,))
            assert perturbed is not None
            if not self.image_sigma:
                return perturbed
            grain = grains.standard_normal(image.shape, dtype=np.float32) * np.float32(
                self.image_sigma
            )
            return np.clip(perturbed + grain + np.float32(0.5), 0, 255).astype(np.uint8)

        able: Any = target  # see `check`
        return able.repainted(changed)


@spec
class Noise:
    """Sensor noise, and changes of what is looked at.

    Args:
        image_sigma: standard deviation of Gaussian noise on each channel of the picture, of 0 to
            255 [grey levels]. Its effect on a measured coordinate depends on the detector: with
            `blobs` and its `grey` moments, a standard deviation of about .0025 px per grey level
            for discs of 8 px radius. Under 1 it has hardly any effect, above 20 markers get lost;
            e.g. `2`.
        pixel_sigma_px: standard deviation of Gaussian noise added to each measured coordinate, for
            every detector [px]; e.g. `0.1`.
        dropout: probability that a detected marker is not reported, for every detector [1]; e.g.
            `0.05`.
        drift: slow drift of the picture's brightness and colour.
        perturb: further kinds of noise, of the finished picture or of measured coordinates, in this
            order (`vision.perturb`).
        target: changes of the target's own picture, drawn once a run.
    """

    image_sigma: GreySigma = 0.0
    pixel_sigma_px: Pixels = 0.0
    dropout: Annotated[float, Ge(0), Lt(1)] = 0.0
    drift: Drift = Drift()
    perturb: Kinds = ()
    target: TargetNoise = TargetNoise()

    @property
    def on_pictures(self) -> bool:
        """Whether a perturbation changes pictures."""
        return any("picture" in kind.changes for kind in self.perturb)

    def draws(self, pictures: bool, points: bool) -> bool:
        """Whether a seed makes a difference; pictures: some are looked at, points: some are
        measured.
        """
        on_pixels = (
            self.pixel_sigma_px > 0
            or self.dropout > 0
            or any("pixels" in kind.changes for kind in self.perturb)
        )
        return (points and on_pixels) or (
            pictures and (self.image_sigma > 0 or self.on_pictures or not self.target.none)
        )
