"""Natural features: key points matched between the goal's picture and this one, in place of
markers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, cast

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Picture
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, homogeneous
from vstestbed.core.lazy import cv2
from vstestbed.core.quantity import PositivePixels, check_ordered
from vstestbed.core.registry import Registry, kind_of
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal
from vstestbed.targets.base import Target
from vstestbed.vision.base import Detection, DetectorBase, TruthView, goal_of_points, points_of
from vstestbed.vision.local_features import (
    KEYPOINTS,
    Extractor,
    Features,
    Matcher,
    Sift,
    brightness,
    extracted,
    matched,
    mutual_matches,
)


@spec
class NoTracking:
    """Every picture is matched with the goal's."""

    kind: Literal["none"] = "none"


@spec
class Klt:
    """Points are followed from picture to picture by pyramidal Lucas-Kanade, there and back again.

    Of every `redetect_every`-th picture, and where fewer than `keep` points are left, key points
    are matched with the goal's again: points that were followed stay, and empty rows are filled.

    Args:
        redetect_every: pictures from one matching with the goal's picture to the next [1].
        keep: points below which they are matched again at once [1]; none: half of the detector's
            `best`, but not under `least`; e.g. `12`.
        window_px: side of the window round each point [px].
        astray_px: largest distance of a point, followed there and back again, from where it was
            [px].

    References: Lucas & Kanade 1981; Bouguet 2000, Pyramidal implementation of the Lucas Kanade
    feature tracker; Kalal, Mikolajczyk & Matas 2010, doi:10.1109/ICPR.2010.675 (there and back
    again).
    """

    kind: Literal["klt"] = "klt"
    redetect_every: Annotated[int, Ge(1), Le(100_000)] = 10
    keep: Annotated[int, Ge(3), Le(200)] | None = None
    window_px: Annotated[int, Ge(5), Le(101)] = 21
    astray_px: PositivePixels = 0.5


TRACKS = Registry("track", NoTracking, Klt, default="none")
Tracking = Annotated[NoTracking | Klt, TRACKS]


def followed(klt: Klt, before: NDArray[np.uint8], now: NDArray[np.uint8], uv: Array) -> Array:
    """Where points uv (K, 2) are in the picture now, by the brightness (H, W) before and now; NaN
    where they are lost, or were.
    """
    known = np.isfinite(uv).all(axis=1)
    out = np.full(uv.shape, np.nan)
    if not known.any():
        return out
    size = klt.window_px, klt.window_px
    start = uv[known].astype(np.float32)[:, None]
    # Three levels of the pyramid besides the picture itself: a window reaches 2^3 times as far.
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        before, now, start, start.copy(), winSize=size, maxLevel=3
    )
    # Back from where it began: a point that is another now does not stay there.
    back, returned, _ = cv2.calcOpticalFlowPyrLK(
        now,
        before,
        there,
        start.copy(),
        winSize=size,
        maxLevel=1,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    aside = np.linalg.norm((back - start)[:, 0], axis=1)
    height, width = now.shape
    inside = ((there[:, 0] >= 0) & (there[:, 0] <= [width - 1, height - 1])).all(axis=1)
    kept = (found.ravel() > 0) & (returned.ravel() > 0) & (aside < klt.astray_px) & inside
    out[known] = np.where(kept[:, None], there[:, 0], np.nan)
    return out


Pairs = Array  # places in the goal's picture and in this one, (2, M, 2) [px]


def those(pairs: Pairs, which: NDArray[np.bool_], first: int) -> tuple[Pairs, int]:
    """The pairs for which `which` (M,) holds, and how many of the first ones are among them."""
    return pairs[:, which], int(np.count_nonzero(which[:first]))


# Places of matches below a pixel: each point's patch of the goal's picture, laid over this one.
HALF = 10  # half the side of a patch, without its middle [px of the goal's picture]
ROUNDS = 8  # most Gauss-Newton steps
SETTLED_PX = 0.005  # the step under which none follows [px]
ALIKE = 0.8  # least correlation of a patch with the goal's [1]
# least of the smaller eigenvalue of a patch's normal equations, as a share of the larger one: an
# edge alone is no place
TEXTURE = 1e-3


def smooth(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """A picture (H, W) as `refined` takes it: not filtered, interpolation between pixels would add
    a bias.
    """
    return cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 0.8)


def refined(
    goal: NDArray[np.float32], image: NDArray[np.float32], uv_goal: Array, uv: Array, A: Array
) -> Array:
    """Places (K, 2) at which the patches round uv_goal (K, 2) of the goal's picture are found; NaN
    where not alike, or cut by a border.

    Minimises over d the squared difference of I(uv + A (x + d)) and I*(uv_goal + x) over the
    patch's pixels x, both less their mean and over their standard deviation, so that brightness and
    contrast may differ: Gauss-Newton with the goal's gradient (inverse compositional Lucas-Kanade).
    Pictures (H, W) as of `smooth`; A: d uv / d uv_goal (K, 2, 2) of the map between them at each
    point.
    Reference: Baker & Matthews 2004, doi:10.1023/B:VISI.0000011205.11775.fd.
    """
    side = np.arange(-HALF, HALF + 1.0)
    x = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    there = uv_goal[:, None] + x
    template, contrast = _normalised(_sampled(goal, there))
    by_uv = [(_sampled(goal, there + s) - _sampled(goal, there - s)) / 2 for s in np.eye(2)]
    gradient = np.stack(by_uv, -1)
    gradient = gradient - gradient.mean(axis=1, keepdims=True)
    normal = gradient.mT @ gradient
    least, most = np.linalg.eigvalsh(normal).T
    # textured: with structure in both directions
    usable = (
        (least > np.maximum(TEXTURE * most, 1e-3))
        & np.isfinite(A).all(axis=(1, 2))
        & np.isfinite(uv).all(axis=1)
    )
    normal[~usable] = np.eye(2)
    over = np.einsum("kij,pj->kpi", np.where(usable[:, None, None], A, np.eye(2)), x)
    A = np.where(usable[:, None, None], A, 0.0)
    start = np.where(usable[:, None], uv, 0.0)
    at = start.copy()
    alike = np.zeros(len(uv))
    for _ in range(ROUNDS):
        patch, _ = _normalised(_sampled(image, at[:, None] + over))
        alike = np.mean(patch * template, axis=1)
        right = np.einsum("kpi,kp->ki", gradient, (patch - template) * contrast[:, None])
        step = (A @ np.linalg.solve(normal, right[..., None]))[..., 0]
        at = at - step
        if np.abs(step).max(initial=0.0) < SETTLED_PX:
            break
    usable &= _inside(goal, there) & _inside(image, at[:, None] + over)
    # farther away it has found something else
    found = usable & (alike > ALIKE) & (np.linalg.norm(at - start, axis=1) < 3.0)
    return np.where(found[:, None], at, np.nan)


def whole(image: NDArray[Any], uv_goal: Array, uv: Array, A: Array) -> NDArray[np.bool_]:
    """Which patches (K,) lie wholly in both pictures, of the size (H, W) of `image`; uv_goal, uv
    and A as of `refined`.
    """
    corners = HALF * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return _inside(image, uv_goal[:, None] + corners) & _inside(
        image, uv[:, None] + np.einsum("kij,pj->kpi", A, corners)
    )


def _sampled(image: NDArray[np.float32], uv: Array) -> Array:
    """Brightness (K, P) at uv (K, P, 2), linear between pixels (OpenCV rounds to a 32nd of one);
    outside, that of the border.
    """
    height, width = image.shape
    u = np.clip(uv[..., 0], 0, width - 1.001)
    v = np.clip(uv[..., 1], 0, height - 1.001)
    i = u.astype(np.intp)
    j = v.astype(np.intp)
    a = u - i
    b = v - j
    k = j * width + i
    flat = image.ravel()
    top = flat[k] * (1 - a) + flat[k + 1] * a
    return top * (1 - b) + (flat[k + width] * (1 - a) + flat[k + width + 1] * a) * b


def _inside(image: NDArray[Any], uv: Array) -> NDArray[np.bool_]:
    size = np.array([image.shape[1], image.shape[0]]) - 1
    return np.asarray(((uv >= 0) & (uv <= size)).all(axis=(1, 2)))


def _normalised(patches: Array) -> tuple[Array, Array]:
    """Patches (K, P) less their mean and over their standard deviation (K,), and that; a flat one
    stays zero.
    """
    off = patches - patches.mean(axis=1, keepdims=True)
    contrast = np.sqrt(np.mean(off**2, axis=1))
    return off / np.maximum(contrast, 1e-6)[:, None], contrast


# The homography between two views of one plane, robust against wrong matches, for any lens with one
# image.
# a homography has eight unknowns; one that fewer pairs agree with may be a chance
LEAST_INLIERS = 8


def map_derivatives(camera: Camera, H: Array, uv_goal: Array) -> Array:
    """How the homography H of rays, r ~ H r*, turns, stretches and shears the picture at uv_goal
    (K, 2): d uv / d uv_goal (K, 2, 2).
    """
    steps = 0.5 * np.eye(2)  # [px]
    # (K, 2 directions, 2)
    ahead = camera.project(camera.ray(uv_goal[:, None] + steps) @ H.T)
    back = camera.project(camera.ray(uv_goal[:, None] - steps) @ H.T)
    return (ahead - back).mT


def planar_map(
    camera: Camera, uv_goal: Array, uv: Array, within_px: float
) -> tuple[Array, NDArray[np.bool_]] | None:
    """The homography H (3, 3) of rays with which the most pairs uv_goal (M, 2), uv (M, 2) agree,
    and which do (M,); None where too few do.

    It maps the rays of a plane's points in the goal's picture to those in another, r ~ H r*.

    By random samples and a local optimisation of the best (LO-RANSAC with truncated squares), in
    the picture of a camera without distortion. Pairs agree if they are within `within_px` of the
    map there, at the scale of the picture's middle [px].
    Reference: Chum, Matas & Kittler 2003, doi:10.1007/978-3-540-45243-0_31; Torr & Zisserman 2000,
    doi:10.1006/cviu.1999.0832.
    """
    f = _px_per_unit(camera)
    a = camera.normalise(uv_goal)
    b = camera.normalise(uv)
    usable = np.isfinite(a[:, 0]) & np.isfinite(b[:, 0])
    if np.count_nonzero(usable) < LEAST_INLIERS:
        return None
    method = cv2.UsacParams()
    method.threshold = within_px
    method.confidence = 0.9999
    method.maxIterations = 5000
    method.randomGeneratorState = 1  # a seed, so that a run repeats
    # in pixels: of smaller numbers it loses its way
    H, mask = cv2.findHomography(f * a[usable], f * b[usable], method)
    if H is None or mask is None or np.count_nonzero(mask) < LEAST_INLIERS:
        return None
    agree = np.zeros(len(a), dtype=bool)
    agree[usable] = mask.ravel() > 0
    # Its sign is the one that leaves the points in front of the camera.
    H = H / np.array([[1, 1, f], [1, 1, f], [1 / f, 1 / f, 1]])
    ahead = homogeneous(a[agree]) @ H[2]
    return H * np.sign(np.median(ahead)), agree


def of_one_motion(
    camera: Camera, uv_goal: Array, uv: Array, within_px: float
) -> NDArray[np.bool_] | None:
    """Which pairs uv_goal (M, 2), uv (M, 2) obey r' E r* = 0 for one essential matrix E, to
    within_px of its lines; None with under five. OpenCV's RANSAC over the five-point algorithm
    (Nister 2004, doi:10.1109/TPAMI.2004.17), confidence 0.999.
    """
    a = camera.normalise(uv_goal)
    b = camera.normalise(uv)
    usable = np.isfinite(a[:, 0]) & np.isfinite(b[:, 0])
    if np.count_nonzero(usable) < 5:
        return None
    f = _px_per_unit(camera)
    _, mask = cv2.findEssentialMat(
        f * a[usable], f * b[usable], np.diag([f, f, 1.0]), cv2.RANSAC, 0.999, within_px
    )
    agree = np.zeros(len(a), dtype=bool)
    agree[usable] = False if mask is None else mask.ravel() > 0
    return agree


def _px_per_unit(camera: Camera) -> float:
    """Pixels per unit of the normalised coordinates at the middle of the picture."""
    middle = camera.project(np.array([[0.0, 0.0, 1.0], [0.01, 0.0, 1.0], [0.0, 0.01, 1.0]]))
    return float(np.linalg.norm(middle[1:] - middle[0], axis=1).mean() / 0.01)


def spread_out(uv: Array, most: int, first: int = 0) -> NDArray[np.intp]:
    """Indices of at most `most` of the points uv (M, 2): the `first` ones, then always the farthest
    from all chosen, in this order.
    """
    chosen = list(range(min(first, most)))
    far = np.full(len(uv), np.inf)
    for k in chosen:
        far = np.minimum(far, np.sum((uv - uv[k]) ** 2, axis=1))
    while len(chosen) < min(most, len(uv)):
        k = int(np.argmax(far))
        if far[k] <= 0:
            break
        chosen.append(k)
        far = np.minimum(far, np.sum((uv - uv[k]) ** 2, axis=1))
    return np.array(chosen, dtype=np.intp)


@dataclass(frozen=True, slots=True)
class Slots:
    """K rows of points that are matched with the goal's picture.

    Attributes:
        uv_goal, uv: where each is in the goal's picture and in this one (K, 2) [px]; NaN in an
            empty row.
        ids: number of the point in each row (K,), -1 in an empty row; a point that comes to a row
            gets a new one, `next_id`.
    """

    uv_goal: Array
    uv: Array
    ids: NDArray[np.intp]
    next_id: int = 0

    @classmethod
    def empty(cls, rows: int) -> Slots:
        """No points yet."""
        return cls(np.full((rows, 2), np.nan), np.full((rows, 2), np.nan), np.full(rows, -1))

    @property
    def taken(self) -> NDArray[np.bool_]:
        """Which rows have a point (K,)."""
        return self.ids >= 0

    @property
    def pairs(self) -> Pairs:
        """The places of the points in both pictures."""
        return np.stack([self.uv_goal, self.uv])[:, self.taken]

    def placed(self, uv_goal: Array, uv: Array) -> Slots:
        """The rows with these M <= K points (M, 2) in place of the present ones.

        Those that are there already, by their place in the goal's picture, keep their row and
        number; the others come into free rows.
        """
        rows = {
            tuple(place): k for k, place in enumerate(self.uv_goal.tolist()) if self.ids[k] >= 0
        }
        made = Slots.empty(len(self.ids))
        at = np.array([rows.get(tuple(place), -1) for place in uv_goal.tolist()], dtype=np.intp)
        ids = np.where(at >= 0, self.ids[at], -1)
        free = iter(np.setdiff1d(np.arange(len(self.ids)), at).tolist())
        next_id = self.next_id
        for m in np.flatnonzero(at < 0).tolist():
            at[m] = next(free)
            ids[m] = next_id
            next_id += 1
        made.uv_goal[at] = uv_goal
        made.uv[at] = uv
        made.ids[at] = ids
        return replace(made, next_id=next_id)

    def moved(self, uv: Array) -> Slots:
        """The same points at uv (K, 2); those with NaN leave their rows."""
        stays = self.taken & np.isfinite(uv).all(axis=1)
        uv_goal = np.where(stays[:, None], self.uv_goal, np.nan)
        uv = np.where(stays[:, None], uv, np.nan)
        return Slots(uv_goal, uv, np.where(stays, self.ids, -1), self.next_id)


@dataclass(frozen=True, slots=True)
class KeypointsState:
    """State of the detector in a run to one goal.

    Attributes:
        goal: the goal view, with its picture. smooth: its brightness, as the patches are taken from
            it. slots: the reported points.
        learned: the goal picture's key points uv (R, 2) and descriptors (R, D); None of features
            that match pictures themselves.
        last: brightness of the last picture, where points are followed from there; since: pictures
            since the last matching.
    """

    goal: Goal
    learned: tuple[Array, NDArray[Any]] | None
    smooth: NDArray[np.float32]
    slots: Slots
    last: NDArray[np.uint8] | None = None
    since: int = 0


@spec
class Keypoints(DetectorBase):
    """Points of the scene itself, found again by their surroundings: no markers are needed, and the
    target's are not looked for.

    The points are others in every picture, so the detection holds the goal's view of the points in
    its `best` rows; empty rows are NaN. Where fewer than `least` are found, nothing is reported,
    and the law rests, or coasts where it can.

    - Key points of both pictures (`features`) are matched by their descriptors, if each is the
      other's nearest.
    - With `ransac: homography` those pairs count that agree with one plane, with `essential` those
    that agree with one motion of the camera before a still scene.
    - The best of them, or well spread ones, are chosen.
    - With `subpixel` the patch round each point of the goal's picture is laid over this one, with
    its scale, turn and perspective from the homography: 0.02 px in place of 0.1 (SIFT) to 1 px
    (ORB). Patches that are not alike, or cut by a border, are replaced.

    Depths in the goal's view are those of the target's plane, or of a depth camera. Of points
    beyond the target, such as the floor's, the plane's are wrong, hence `within: board`.

    Args:
        features: what finds, describes and matches key points: `sift`, `orb`, `akaze`, or a
            plugin's.
        best: most points that are reported, the number of rows [1].
        least: fewest points that are reported; with fewer nothing is seen [1]. With
            `ransac: homography` eight must agree with one plane besides, of which `best` are
            reported.
        choose: which of the matched points: the `distance` of whose descriptors is least, or those
            that are `spread` over the picture.
        ratio: a match counts only if its distance is under this share of the distance to the second
            nearest [1]; none: all mutual matches count; e.g. `0.8`.
        ransac: which matches count: those on one plane (`homography`), those that obey the epipolar
            constraint of one motion (`essential`), or all (`none`).
        ransac_px: how far a match may be from where the homography maps it, or from its epipolar
            line [px].
        subpixel: measure places below a pixel by patches; needs eight matches on one plane, without
            which places stay as they are.
        within: which part of the goal's picture is used: all of it (`picture`), or that which shows
            the target's board (`board`).
        track: whether points are followed from picture to picture, and matched again now and then:
            `none` or `klt`.
    """

    kind: Literal["keypoints"] = "keypoints"
    features: Annotated[Features, KEYPOINTS] = Sift()
    best: Annotated[int, Ge(3), Le(200)] = 24
    least: Annotated[int, Ge(3), Le(200)] = 4
    choose: Literal["distance", "spread"] = "spread"
    ratio: Annotated[float, Gt(0), Lt(1)] | None = None
    ransac: Literal["homography", "essential", "none"] = "homography"
    ransac_px: PositivePixels = 2.0
    subpixel: bool = True
    within: Literal["picture", "board"] = "picture"
    track: Tracking = NoTracking()
    needs_image: ClassVar[bool] = True
    needs_goal: ClassVar[bool] = True
    changing = True

    def __post_init__(self) -> None:
        check_ordered(self, "least", "best")
        if isinstance(self.track, Klt) and (self.track.keep or 0) > self.best:
            raise ParameterError.bound(
                "track.keep", "at most", f"best = {self.best}", self.track.keep
            )
        if self.ratio is not None and self._extractor is None:
            words = (
                "compares descriptors,"
                f" and features {self.features.kind} match pictures by themselves; leave it out"
            )
            raise ParameterError("ratio", words, self.ratio)

    @property
    def _extractor(self) -> Extractor | None:
        """The features, if they describe key points; None of those that match pictures by
        themselves.
        """
        return None if hasattr(self.features, "match") else cast(Extractor, self.features)

    @property
    def rows(self) -> int:
        """As many as `best`."""
        return self.best

    @property
    def fleeting(self) -> bool:
        """Without tracking, others are found in every picture."""
        return isinstance(self.track, NoTracking)

    def begin(self, goal: Goal, camera: Camera, target: Target) -> KeypointsState:
        """The goal picture's key points. Raises ParameterError: it has no picture, or too few key
        points; or the target has no board.
        """
        if goal.image is None:
            raise ParameterError.missing(
                "goal.image", "detector keypoints compares with the picture taken at the goal"
            )
        if self.within == "board" and target.board_half_m is None:
            words = f"board with target {kind_of(type(target))}, which has none"
            raise ParameterError.excluded("detector.within", words, works="picture")
        learned = None
        if self._extractor is not None:
            uv, descriptors = extracted(self._extractor, goal.image.image)
            there = self._usable(goal, target, uv)
            usable = int(np.count_nonzero(there))
            if usable < self._matching:
                raise ParameterError("detector.features", self._too_few(len(uv), usable))
            learned = uv[there], descriptors[there]
        return KeypointsState(
            goal, learned, smooth(brightness(goal.image.image)), Slots.empty(self.best)
        )

    @property
    def _matching(self) -> int:
        """Fewest key points of the goal's picture that must match: `least`, and as many as tell a
        plane where one is asked for.
        """
        return max(self.least, LEAST_INLIERS) if self.ransac == "homography" else self.least

    def _too_few(self, found: int, usable: int) -> str:
        plane = self._matching > self.least
        wanted = f"least = {self.least} key points or more"
        if plane:
            wanted = f"{self._matching} key points or more, as many as tell a plane,"
        words = f"must find {wanted} in the goal's picture: {self.features.kind} finds {found}"
        if found < self._matching:
            otherwise = ", or ransac: none" if plane and found >= self.least else ""
            return f"{words}; use a target with more texture{otherwise}"
        if self.within == "board":
            return (
                f"{words}, of which {usable} lie on the target's board;"
                " use a goal that shows it larger, or within: picture"
            )
        return (
            f"{words}, of which {usable} have a depth there;"
            " use a goal that shows more of the target's plane, or a depth camera"
        )

    def _usable(self, goal: Goal, target: Target, uv: Array) -> NDArray[np.bool_]:
        """Which points uv (M, 2) of the goal's picture have a depth, and lie on the target's board
        where only those are asked for.
        """
        if len(uv) == 0:
            return np.zeros(0, dtype=bool)
        p = points_of(goal_of_points(goal, uv))
        there = np.asarray(np.isfinite(p).all(axis=1))
        half = target.board_half_m
        if self.within == "board" and half is not None:
            with np.errstate(invalid="ignore"):
                there &= (np.abs(p[:, :2]) <= half).all(axis=1)
        return there

    def detect(
        self,
        state: KeypointsState,
        picture: Picture | None,
        view: TruthView | None,
        camera: Camera,
        target: Target,
        rng: np.random.Generator,
    ) -> tuple[KeypointsState, Detection]:
        """Matched pixels (K, 2), NaN in empty rows, and the goal's view of the same points."""
        image = None if picture is None else picture.completed().image
        if image is None:
            raise ParameterError.missing("picture", "detector keypoints needs one whole picture")
        if not isinstance(state, KeypointsState):
            raise ParameterError.fixed("state", "that of `begin`, which learns the goal's picture")
        dim = brightness(image)
        slots = self._followed(state, dim, camera)
        since = state.since + 1
        why = ""
        if slots is None or self._due(slots, since):
            kept = np.empty((2, 0, 2)) if slots is None else slots.pairs
            pairs = self._matches(state, image, target)
            found, agreeing = self._chosen(state, pairs, kept, dim, camera)
            slots = state.slots.placed(*found)
            since = 0
            why = self._why(pairs.shape[1], agreeing, found.shape[1])
        if np.count_nonzero(slots.taken) < self.least:
            # its points: a law that coasts knows what it saw there
            slots = replace(state.slots, uv=np.full(slots.uv.shape, np.nan))
        last = dim if isinstance(self.track, Klt) else None
        state = replace(state, slots=slots, last=last, since=since)
        goal = goal_of_points(state.goal, slots.uv_goal)
        return state, Detection(slots.uv, goal=goal, ids=slots.ids, why=why)

    def _why(self, matching: int, agreeing: int, measured: int) -> str:
        """Why nothing is reported though points match;
        "" where too few do, or enough are measured.
        """
        if measured >= self.least or matching < max(self.least, LEAST_INLIERS):
            return ""
        plane = "motion" if self.ransac == "essential" else "plane"
        words = (
            f"detector keypoints: {matching} points match the goal's picture,"
            f" of which {agreeing} agree with one {plane}"
        )
        if agreeing < self.least:
            return (
                f"{words}: the target may have too little texture, or parts that look alike,"
                " or show too little of itself"
            )
        return (
            f"{words}; of those tried the patches of {measured} are found,"
            f" fewer than least = {self.least}: the others are cut by the border or not alike;"
            " subpixel: false does without patches"
        )

    def _due(self, slots: Slots, since: int) -> bool:
        assert isinstance(self.track, Klt)
        keep = max(self.least, self.best // 2) if self.track.keep is None else self.track.keep
        return since >= self.track.redetect_every or int(np.count_nonzero(slots.taken)) < keep

    def _followed(self, state: KeypointsState, dim: Image, camera: Camera) -> Slots | None:
        if state.last is None or not isinstance(self.track, Klt):
            return None
        slots = state.slots.moved(followed(self.track, state.last, dim, state.slots.uv))
        there = slots.taken
        pairs = slots.pairs
        found = self._plane(camera, pairs)
        agree = self._agreeing(camera, pairs, found)
        uv = slots.uv.copy()
        if agree is not None:  # with too few for a plane or a motion, those that were followed stay
            uv[np.flatnonzero(there)[~agree]] = np.nan
        if found is not None and self.subpixel:
            uv[there] = self._refined(state, pairs[0], uv[there], dim, camera, found[0])
        return slots.moved(uv)

    def _plane(self, camera: Camera, pairs: Pairs) -> tuple[Array, NDArray[np.bool_]] | None:
        """The homography of the pairs and which agree with it, where `ransac` or `subpixel` need
        one.
        """
        if self.ransac == "homography" or self.subpixel:
            return planar_map(camera, pairs[0], pairs[1], self.ransac_px)
        return None

    def _agreeing(
        self, camera: Camera, pairs: Pairs, plane: tuple[Array, NDArray[np.bool_]] | None
    ) -> NDArray[np.bool_] | None:
        """Which of the pairs `ransac` keeps (M,); None where they are too few to tell."""
        if self.ransac == "none":
            return np.ones(len(pairs[0]), dtype=bool)
        if self.ransac == "essential":
            return of_one_motion(camera, pairs[0], pairs[1], self.ransac_px)
        return None if plane is None else plane[1]

    def _matches(self, state: KeypointsState, image: Image, target: Target) -> Pairs:
        if self._extractor is not None and state.learned is not None:
            uv, descriptors = extracted(self._extractor, image)
            i, j, _ = mutual_matches(state.learned[1], descriptors, self.ratio)
            return np.stack([state.learned[0][i], uv[j]])
        assert state.goal.image is not None
        uv_goal, uv, distance = matched(cast(Matcher, self.features), state.goal.image.image, image)
        order = np.argsort(distance, kind="stable")
        order = order[self._usable(state.goal, target, uv_goal)[order]]
        return np.stack([uv_goal, uv])[:, order]

    def _chosen(
        self, state: KeypointsState, pairs: Pairs, kept: Pairs, dim: Image, camera: Camera
    ) -> tuple[Pairs, int]:
        """The pairs that are reported: those that were followed, then others by distance or spread;
        and how many there were to choose.
        """
        first = kept.shape[1]
        new = ~(pairs[0][:, None] == kept[0]).all(axis=2).any(axis=1)
        pairs = np.concatenate([kept, pairs[:, new]], axis=1)
        found = self._plane(camera, pairs)
        agree = self._agreeing(camera, pairs, found)
        if agree is None:
            agree = np.zeros(len(pairs[0]), dtype=bool)
        pairs, first = those(pairs, agree, first)
        agreeing = pairs.shape[1]
        if found is None or not self.subpixel:
            return self._best(pairs, first, self.best), agreeing
        H = found[0]
        uncut = whole(dim, pairs[0], pairs[1], map_derivatives(camera, H, pairs[0]))
        pairs, first = those(pairs, uncut, first)
        return self._measured(state, pairs, first, dim, camera, H), agreeing

    def _measured(
        self, state: KeypointsState, pairs: Pairs, first: int, dim: Image, camera: Camera, H: Array
    ) -> Pairs:
        """The best pairs whose patches are found; where some are not, the next ones are tried in
        their place, up to a limit.
        """
        # more than are reported, since some are not found; a plane needs eight that agree
        tried = max(round(1.5 * self.best), 16)
        most = 4 * tried
        while True:
            some = self._best(pairs, first, tried)
            uv = self._refined(state, some[0], some[1], dim, camera, H)
            there = np.flatnonzero(np.isfinite(uv[:, 0]))[: self.best]
            if len(there) == self.best or len(some[0]) < tried or tried >= most:
                return np.stack([some[0], uv])[:, there]
            tried *= 2

    def _best(self, pairs: Pairs, first: int, most: int) -> Pairs:
        """At most `most` of the pairs, which are in the order of their distance; the `first` ones
        are among them.
        """
        if self.choose == "spread":
            return pairs[:, spread_out(pairs[0], most, first)]
        return pairs[:, :most]

    def _refined(
        self, state: KeypointsState, uv_goal: Array, uv: Array, dim: Image, camera: Camera, H: Array
    ) -> Array:
        """Places (M, 2) below a pixel; NaN where the pictures are not alike, or a patch has slipped
        off the plane.
        """
        found = refined(state.smooth, smooth(dim), uv_goal, uv, map_derivatives(camera, H, uv_goal))
        if self.ransac != "homography":
            return found
        better = planar_map(camera, uv_goal, found, within_px=0.25)
        return found if better is None else np.where(better[1][:, None], found, np.nan)
