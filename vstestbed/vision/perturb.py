"""Perturbations (`noise.perturb: [...]`) of pictures as the camera delivers them, or of measured
pixels, each from streams of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Image, Images
from vstestbed.core.quantity import PositivePixels, PositiveTime, TighterBounds, check_range
from vstestbed.core.registry import Contract, Registry
from vstestbed.core.spec import spec
from vstestbed.imaging.sensor import GREY

# weights of red, green and blue in the grey of a colour (ITU-R BT.601)
LUMA = np.array([0.299, 0.587, 0.114], np.float32)
Share = Annotated[float, Ge(0), Le(1)]
Probability = Annotated[float, Ge(0), Lt(1)]


class PerturbationBase:
    """A nuisance: its parameters are frozen in the object. By default nothing is drawn once a run,
    and nothing changed.

    Attributes:
        changes: `picture`, `pixels` (measured marker coordinates), or both. Where pictures are
            changed they are always rendered whole, so that no number depends on where the detector
            looks.
    """

    kind: Any  # the word in a scenario: a field of each
    changes: ClassVar[tuple[str, ...]] = ("picture",)

    def begin(self, rng: np.random.Generator) -> Any:
        """What is drawn once a run, for `picture` and `pixels`."""
        return None

    def picture(self, state: Any, image: Image, t: float, rng: np.random.Generator) -> Image:
        """The picture (H, W, 3) uint8 RGB of time t [s], changed; `image` is a copy that may be
        written to.

        rng: of this picture. Of a camera with panels each is changed by itself, with the same
            random numbers.
        """
        return image

    def pixels(self, state: Any, uv: Array, t: float, rng: np.random.Generator) -> Array:
        """Measured coordinates uv (N, 2) [px] of time t [s], changed; NaN for a marker that is not
        seen.
        """
        return uv


@spec
class Erasing(PerturbationBase):
    """Random erasing: with a probability, a rectangle of each picture is replaced; a marker in it
    is lost or wrongly measured.

    Its area is S = U(area) W H, its ratio of height to width r = U(aspect, 1/aspect), its place
    uniform; a rectangle that does not fit is drawn again.

    Args:
        probability: probability that a picture is changed [1].
        area: smallest and largest share of the picture that is replaced [1].
        aspect: smallest ratio of the rectangle's height to its width, the largest is its inverse
            [1].
        fill: one `grey` level, drawn for each rectangle, or a `random` level for each channel of
            each pixel.

    Reference: Zhong, Zheng, Kang, Li & Yang 2020, doi:10.1609/aaai.v34i07.7000 (there the area is
    .02 to .4, and aspect .3).
    """

    kind: Literal["erasing"] = "erasing"
    probability: Share = 0.5
    area: Annotated[tuple[Annotated[float, Gt(0), Lt(1)], ...], Len(2, 2)] = (0.02, 0.1)
    aspect: Annotated[float, Gt(0.01), Le(1)] = 0.3
    fill: Literal["grey", "random"] = "grey"
    tries: ClassVar[int] = 100

    def __post_init__(self) -> None:
        check_range(self, "area")

    def picture(self, state: None, image: Image, t: float, rng: np.random.Generator) -> Image:
        if rng.random() >= self.probability:
            return image
        height, width = image.shape[:2]
        for _ in range(self.tries):
            least, most = self.area
            ratio = rng.uniform(self.aspect, 1 / self.aspect)
            area = rng.uniform(least, most) * width * height
            h = round(np.sqrt(area * ratio))
            w = round(np.sqrt(area / ratio))
            if 0 < h < height and 0 < w < width:
                v = rng.integers(height - h + 1)
                u = rng.integers(width - w + 1)
                size = 1 if self.fill == "grey" else (h, w, 3)
                image[v : v + h, u : u + w] = rng.integers(0, 256, size, dtype=np.uint8)
                return image
        return image


@spec
class ColorJitter(PerturbationBase):
    """Colour jitter: random brightness b, contrast c and saturation s, each U(1 - x, 1 + x) of its
    x.

    I' = b (s (I_c - Y_c) + Y_c),  I_c = c (I - 128) + 128,

    with the grey Y of a colour by ITU-R BT.601; clipped to 0 to 255.

    Args:
        brightness, contrast, saturation: largest relative change x of it [1].
        each: whether they are drawn once a `run`, or anew for each `picture`.
    """

    kind: Literal["color_jitter"] = "color_jitter"
    brightness: Probability = 0.2
    contrast: Probability = 0.2
    saturation: Probability = 0.2
    each: Literal["run", "picture"] = "run"

    def begin(self, rng: np.random.Generator) -> Array:
        """Factors b, c, s of the run (3,)."""
        return self._factors(rng)

    def picture(self, state: Array, image: Image, t: float, rng: np.random.Generator) -> Image:
        b, c, s = (state if self.each == "run" else self._factors(rng)).astype(np.float32)
        contrasted = c * (image.astype(np.float32) - np.float32(GREY)) + np.float32(GREY)
        grey = (contrasted @ LUMA)[..., None]
        changed = b * (s * (contrasted - grey) + grey) + np.float32(0.5)
        return np.clip(changed, 0, 255).astype(np.uint8)

    def _factors(self, rng: np.random.Generator) -> Array:
        return 1.0 + rng.uniform(-1, 1, 3) * (self.brightness, self.contrast, self.saturation)


@spec
class Shadow(PerturbationBase):
    """A soft shadow that moves over the picture, again and again: of a band, or of a blob.

    I' = I (1 - darkness s(d)), with d the distance from the band's middle line or the blob's centre
    in widths W of the picture: s falls from 1 to 0 between d = (width - edge)/2 and (width +
    edge)/2, as 3x^2 - 2x^3. In `period_s` the shadow moves once from beyond one side of the picture
    to beyond the other. Its direction, its place at t = 0 and a blob's distance from the picture's
    middle, at most W/4, are drawn once a run. (`world.plates` with `camera.shadows` cast shadows on
    things.)

    Args:
        shape: `band` or `blob`.
        darkness: share of the light that it takes in its middle [1].
        width: of the band, or diameter of the blob, in widths of the picture [1].
        edge: how wide its soft edge is, in widths of the picture [1].
        period_s: from one crossing to the next [s].
    """

    kind: Literal["shadow"] = "shadow"
    shape: Literal["band", "blob"] = "band"
    darkness: Share = 0.6
    width: Annotated[float, Gt(0), Le(2)] = 0.3
    edge: Annotated[float, Gt(0), Le(1)] = 0.1
    period_s: PositiveTime = 4.0

    def begin(self, rng: np.random.Generator) -> Array:
        """Direction [rad], place at the start as a share of the way, and distance from the middle,
        (3,).
        """
        return rng.random(3) * [2 * np.pi, 1, 0.5] - [0, 0, 0.25]

    def picture(self, state: Array, image: Image, t: float, rng: np.random.Generator) -> Image:
        height, width = image.shape[:2]
        angle, begun, beside = state
        reach = (np.hypot(1, height / width) + self.width + self.edge) / 2
        at = reach * (2 * ((t / self.period_s + begun) % 1) - 1)
        x = ((np.arange(width, dtype=np.float32) - (width - 1) / 2) / width)[None]
        y = ((np.arange(height, dtype=np.float32) - (height - 1) / 2) / width)[:, None]
        c = np.float32(np.cos(angle))
        s = np.float32(np.sin(angle))
        far = np.abs(c * x + s * y - np.float32(at))
        if self.shape == "blob":
            far = np.hypot(far, c * y - s * x - np.float32(beside))
        inside = np.clip(((self.width + self.edge) / 2 - far) / self.edge, 0, 1)
        light = 1 - self.darkness * inside * inside * (3 - 2 * inside)
        return (image * light[..., None].astype(np.float32) + np.float32(0.5)).astype(np.uint8)


@spec
class Outliers(PerturbationBase):
    """Gross errors of measured coordinates, as of a marker taken for another thing: displaced
    uniformly within a disc.

    Args:
        probability: probability of such an error, of each marker in each picture [1].
        radius_px: radius of the disc [px].

    Reference: Comport, Marchand & Chaumette 2006, doi:10.1109/TRO.2006.870666 (servoing that is
    robust to outliers).
    """

    kind: Literal["outliers"] = "outliers"
    probability: Share = 0.05
    radius_px: Annotated[PositivePixels, TighterBounds(le=1e4)] = 20.0
    changes: ClassVar[tuple[str, ...]] = ("pixels",)

    def pixels(self, state: None, uv: Array, t: float, rng: np.random.Generator) -> Array:
        hit = rng.random(len(uv)) < self.probability
        r = self.radius_px * np.sqrt(rng.random(len(uv)))
        a = rng.uniform(0, 2 * np.pi, len(uv))
        return uv + np.where(hit[:, None], np.column_stack([r * np.cos(a), r * np.sin(a)]), 0.0)


CONTRACT = Contract(
    PerturbationBase, base=PerturbationBase, words={"changes": ("picture", "pixels")}
)
PERTURBATIONS = Registry("perturbation", Erasing, ColorJitter, Shadow, Outliers, contract=CONTRACT)


Drawn = tuple[PerturbationBase, Any, np.random.Generator]
"""A perturbation, what was drawn once a run for it, and its generator."""


class Perturbed:
    """The perturbations of one run, in the order in which they act, with what was drawn for it from
    the scenario's stream.
    """

    def __init__(self, kinds: Sequence[PerturbationBase], rng: np.random.Generator):
        n = len(kinds)
        # independent: what is drawn once a run, for pictures, for pixels
        streams = rng.spawn(3 * n)
        self._pictures: list[Drawn] = []
        self._pixels: list[Drawn] = []
        for i, kind in enumerate(kinds):
            state = kind.begin(streams[i])
            if "picture" in kind.changes:
                self._pictures.append((kind, state, streams[n + i]))
            if "pixels" in kind.changes:
                self._pixels.append((kind, state, streams[2 * n + i]))

    @property
    def on_pixels(self) -> bool:
        """Whether measured coordinates are changed."""
        return bool(self._pixels)

    def next_picture(self) -> Callable[[float, Images], Images]:
        """What changes the next picture: a function of its time [s] and its panels' images, the
        same however often it is called.
        """
        drawn = [(kind, state, int(rng.integers(2**63))) for kind, state, rng in self._pictures]

        def changed(t: float, images: Images) -> Images:
            for kind, state, seed in drawn:
                images = tuple(
                    None if i is None else _picture(kind, state, i.copy(), t, seed) for i in images
                )
            return images

        return changed

    def pixels(self, uv: Array, t: float) -> Array:
        """Measured coordinates (N, 2) [px] of time t [s], changed."""
        for kind, state, rng in self._pixels:
            after = np.asarray(kind.pixels(state, uv.copy(), t, rng), dtype=float)
            if after.shape != uv.shape:
                raise ParameterError.returned(
                    f"noise.perturb: {kind.kind}", "pixels", f"an array {uv.shape}", after.shape
                )
            uv = after
        return uv


def _picture(kind: PerturbationBase, state: Any, image: Image, t: float, seed: int) -> Image:
    wanted = f"{image.shape} uint8"
    after = kind.picture(state, image, t, np.random.default_rng(seed))
    found = type(after).__name__
    if isinstance(after, np.ndarray):
        found = f"{after.shape} {after.dtype}"
    if found != wanted:
        raise ParameterError.returned(
            f"noise.perturb: {kind.kind}", "picture", f"an image {wanted}", found
        )
    return after
