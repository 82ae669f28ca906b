"""Kinds of local features (`KEYPOINTS`): what finds key points in a picture, or matches two
pictures by itself.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from vstestbed.camera import Image
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.lazy import cv2
from vstestbed.core.registry import Contract, Registry
from vstestbed.core.spec import spec

# (M, D): floats, compared by their Euclidean distance, or uint8, whose bits are compared (Hamming
# distance)
Descriptors = NDArray[Any]
Most = Annotated[int, Ge(10), Le(10_000)]
ORB_SCALE = 1.2  # ratio of one level of ORB's pyramid to the next


class Extractor:
    """A kind that describes the key points of one picture; those of two pictures are matched by
    their descriptors.
    """

    kind: Any  # the word in a scenario

    @abstractmethod
    def extract(self, image: Image) -> tuple[Array, Descriptors]:
        """Key points of a picture (H, W, 3) uint8 RGB: pixels uv (M, 2), the centre of the first
        pixel (0, 0), and descriptors (M, D).
        """
        ...


class Matcher:
    """A kind that matches two pictures by itself, as learned matchers do."""

    kind: Any

    @abstractmethod
    def match(self, goal_image: Image, image: Image) -> tuple[Array, Array, Array]:
        """Pixels uv_goal (M, 2) and uv (M, 2) of the same points, and how unlike each pair is (M,):
        the smallest are used first.
        """
        ...


Features = Extractor | Matcher


class _Either(Contract):
    """Demands `extract` or `match`; of a class with both, `match` is used."""

    def check(self, member: type) -> None:
        found = [
            protocol
            for name, protocol in (("extract", Extractor), ("match", Matcher))
            if hasattr(member, name)
        ]
        if not found:
            words = (
                "lacks extract(image), which gives (uv, descriptors), or match(goal_image, image),"
                " which gives (uv_goal, uv, distance)"
            )
            raise ParameterError(member.__name__, words)
        for protocol in found:
            Contract(protocol).check(member)


@spec
class Sift(Extractor):
    """SIFT: maxima of differences of Gaussians, described by histograms of gradients; 128 numbers
    each.

    OpenCV's first octave is by default half a pixel aside; here it is drawn in place
    (`enable_precise_upscale`), which leaves 0.01 px.

    Args:
        most: number of key points kept, those of the highest contrast [1].
        contrast: least contrast of a key point, as a share of black to white [1].

    Reference: Lowe 2004, doi:10.1023/B:VISI.0000029664.99615.94.
    """

    kind: Literal["sift"] = "sift"
    most: Most = 1000
    contrast: Annotated[float, Gt(0), Lt(1)] = 0.04

    def extract(self, image: Image) -> tuple[Array, Descriptors]:
        """Key points (M, 2) [px] and descriptors (M, 128) float32."""
        sift = cv2.SIFT.create(
            nfeatures=self.most, contrastThreshold=self.contrast, enable_precise_upscale=True
        )
        points, descriptors = sift.detectAndCompute(brightness(image), None)
        return _pixels(points), _rows(descriptors, 128, np.float32)


@spec
class Orb(Extractor):
    """ORB: corners of a pyramid, described by 256 comparisons of brightness. The fastest, with
    places good to about a pixel.

    Args:
        most: number of key points kept, the best corners [1].

    Reference: Rublee, Rabaud, Konolige & Bradski 2011, doi:10.1109/ICCV.2011.6126544.
    """

    kind: Literal["orb"] = "orb"
    most: Most = 1000

    def extract(self, image: Image) -> tuple[Array, Descriptors]:
        """Key points (M, 2) [px] and descriptors (M, 32) uint8."""
        points, descriptors = cv2.ORB.create(self.most, ORB_SCALE).detectAndCompute(
            brightness(image), None
        )
        level = ORB_SCALE ** np.array([p.octave for p in points], dtype=float)
        # The centre of pixel k of a level is at (k + 1/2) scale - 1/2, and OpenCV gives k scale.
        return _pixels(points) + 0.5 * (level - 1)[:, None], _rows(descriptors, 32, np.uint8)


@spec
class Akaze(Extractor):
    """AKAZE: maxima in a scale space that keeps edges, described by comparisons of brightness and
    gradients; 486 bits.

    OpenCV 5 has it in the package opencv-contrib-python-headless alone, which replaces
    opencv-python-headless.

    Args:
        most: number of key points kept, those of the highest response [1].
        threshold: least response of a key point [1].

    Reference: Alcantarilla, Nuevo & Bartoli 2013, doi:10.5244/C.27.13.
    """

    kind: Literal["akaze"] = "akaze"
    most: Most = 1000
    threshold: Annotated[float, Gt(0), Lt(1)] = 0.001

    def __post_init__(self) -> None:
        if self._create is None:
            why = (
                "this OpenCV lacks it; use sift or orb,"
                " or install opencv-contrib-python-headless in place of opencv-python-headless"
            )
            raise ParameterError.excluded("", "akaze", why=why)

    def extract(self, image: Image) -> tuple[Array, Descriptors]:
        """Key points (M, 2) [px] and descriptors (M, 61) uint8."""
        points, descriptors = self._create(
            threshold=self.threshold, max_points=self.most
        ).detectAndCompute(brightness(image), None)
        return _pixels(points), _rows(descriptors, 61, np.uint8)

    @property
    def _create(self) -> Any:
        return getattr(getattr(cv2, "xfeatures2d", None), "AKAZE_create", None)


def brightness(image: Image) -> NDArray[np.uint8]:
    """A picture's brightness (H, W) uint8."""
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)


def _pixels(points: Any) -> Array:
    return np.array([p.pt for p in points], dtype=float).reshape(-1, 2)


def _rows(descriptors: Any, width: int, dtype: type) -> Descriptors:
    return np.empty((0, width), dtype) if descriptors is None else descriptors


def extracted(features: Extractor, image: Image) -> tuple[Array, Descriptors]:
    """`extract`, checked. Raises ParameterError: arrays of other shapes, or numbers that are not
    finite.
    """
    uv, descriptors = _arrays(features, "extract", features.extract(image), ("uv", "descriptors"))
    uv = _points(features, "extract", "uv", uv)
    if descriptors.ndim != 2 or len(descriptors) != len(uv):
        _refuse(
            features,
            "extract",
            f"descriptors of shape ({len(uv)}, D), a row for each point",
            descriptors.shape,
        )
    if descriptors.dtype != np.uint8:
        descriptors = descriptors.astype(np.float32)
        if not np.isfinite(descriptors).all():
            _refuse(features, "extract", "descriptors that are finite", "NaN or infinity")
    return uv, descriptors


def matched(features: Matcher, goal_image: Image, image: Image) -> tuple[Array, Array, Array]:
    """`match`, checked. Raises ParameterError: arrays of other shapes, or numbers that are not
    finite.
    """
    uv_goal, uv, distance = _arrays(
        features, "match", features.match(goal_image, image), ("uv_goal", "uv", "distance")
    )
    uv_goal = _points(features, "match", "uv_goal", uv_goal)
    uv = _points(features, "match", "uv", uv)
    if not len(uv_goal) == len(uv) == len(distance) or distance.ndim != 1:
        words = f"uv_goal, uv and distance of as many pairs, distance of shape ({len(uv)},)"
        _refuse(features, "match", words, (uv_goal.shape, uv.shape, distance.shape))
    if not np.isfinite(distance).all():
        _refuse(features, "match", "distances that are finite", "NaN or infinity")
    return uv_goal, uv, distance.astype(float)


def _arrays(
    features: Features, method: str, given: Any, names: tuple[str, ...]
) -> list[NDArray[Any]]:
    if not isinstance(given, tuple | list) or len(given) != len(names):
        _refuse(features, method, f"({', '.join(names)})", type(given).__name__)
    return [np.asarray(part) for part in given]


def _points(features: Features, method: str, name: str, uv: NDArray[Any]) -> Array:
    if uv.ndim != 2 or uv.shape[1] != 2:
        _refuse(features, method, f"{name} of shape (M, 2), pixels", uv.shape)
    if not np.isfinite(uv).all():
        _refuse(
            features,
            method,
            f"{name} that are finite; leave out points that were not found",
            "NaN or infinity",
        )
    return uv.astype(float)


def _refuse(features: Features, method: str, words: str, got: object) -> None:
    raise ParameterError.returned("detector.features", f"{method} of {features.kind}", words, got)


KEYPOINTS = Registry("keypoint", Sift, Orb, Akaze, contract=_Either(Extractor))
"""The kinds of local features; plugins are found under the entry-point group
`vstestbed.keypoints`.
"""


def mutual_matches(
    a: NDArray[Any], b: NDArray[Any], ratio: float | None = None
) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Pairs (i, j) of which a_i is the nearest to b_j and b_j the nearest to a_i, and their
    distances, the nearest pairs first.

    |a - b|^2 = |a|^2 + |b|^2 - 2 a.b by one product of matrices, five times as fast as OpenCV's
    matcher for SIFT. Its sums of integers (SIFT, bits) are exact in single precision, so that they
    do not depend on the machine.

    Args:
        a, b: descriptors (M, D) and (N, D), floats (Euclidean distance) or uint8 (number of
            differing bits).
        ratio: a pair counts only if it is nearer than this share of the distance to the second
            nearest in b (Lowe 2004, section 7.1, doi:10.1023/B:VISI.0000029664.99615.94); None: all
            count.
    """
    if len(a) == 0 or len(b) == 0:
        nothing = np.empty(0, dtype=np.intp)
        return nothing, nothing, np.empty(0)
    bits = a.dtype == np.uint8
    a = _numbers(a)
    b = _numbers(b)
    squared = np.einsum("ij,ij->i", a, a)[:, None] + np.einsum("ij,ij->i", b, b) - 2 * (a @ b.T)
    np.maximum(squared, 0, out=squared)
    nearest = squared.argmin(axis=1)
    back = squared.argmin(axis=0)
    i = np.flatnonzero(back[nearest] == np.arange(len(a)))
    j = nearest[i]
    distance = squared[i, j].astype(float)
    if not bits:
        distance = np.sqrt(distance)
    if ratio is not None and len(b) > 1:
        second = np.partition(squared[i], 1, axis=1)[:, 1].astype(float)
        kept = distance < ratio * (second if bits else np.sqrt(second))
        i = i[kept]
        j = j[kept]
        distance = distance[kept]
    order = np.argsort(distance, kind="stable")
    return i[order], j[order], distance[order]


def _numbers(descriptors: NDArray[Any]) -> NDArray[np.float32]:
    """Descriptors as single-precision numbers; bits as zeros and ones, of which the squared
    distance is the number that differ.
    """
    numbers = np.unpackbits(descriptors, axis=1) if descriptors.dtype == np.uint8 else descriptors
    return numbers.astype(np.float32)
