"""Coloured markers: blobs segmented by chroma, identified by hue, tracked in windows, corrected for
perspective bias.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations, compress, product
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from vstestbed.camera import Camera, Panel, Picture, Regions, Window
from vstestbed.core.geometry import Array, inverse, lengths, transform
from vstestbed.core.quantity import Pixels, PositiveAngle, TighterBounds
from vstestbed.core.spec import spec
from vstestbed.targets.base import Target
from vstestbed.vision.base import (
    Detection,
    DetectorBase,
    Move,
    TruthView,
    window_round,
    windows_round,
)
from vstestbed.vision.colour import (
    Blob,
    Region,
    Rim,
    find_blobs,
    mixes_colours,
    noise_level,
)
from vstestbed.vision.pnp import solve_pose_from_rays, three_ray_poses

# Perspective bias: the centroid of a marker's image is not the image of its centre (discs and
# spheres).

# corners of the polygon that approximates an outline: its bias and area are then right to 1e-4
CORNERS = 32
# Closed polygon with the area of the unit circle: cosines and sines, shape (CORNERS + 1,) each.
_ANGLE = np.arange(CORNERS + 1) * (2 * math.pi / CORNERS)
_SWELL = math.sqrt(2 * math.pi / (CORNERS * math.sin(2 * math.pi / CORNERS)))
_COS = _SWELL * np.cos(_ANGLE)
_SIN = _SWELL * np.sin(_ANGLE)


class Outlines(NamedTuple):
    """Images of N markers: centroids less the images of their centres (N, 2) [px], areas (N,)
    [px^2], images of the centres (N, 2) [px].
    """

    bias: Array
    area: Array
    centre: Array


def centre_bias(camera: Camera, target: Target, T_camera_target: Array) -> Outlines:
    """Centroid of each marker's image relative to the image of its centre, the image's area, and
    that of the centre.

    The rim (of a disc: across its normal; of a sphere: the circle where the rays touch it, centre
    p (d^2 - r^2)/d^2, radius r sqrt(1 - r^2/d^2), d = |p|) is projected as a polygon; with its
    corners q_i relative to the image of the centre,

    a_i = q_i x q_i+1,  area = |sum a_i|/2,  bias = sum (q_i + q_i+1) a_i / (3 sum a_i).

    This holds for any lens. Where the lens does not see a whole rim the result is NaN. In closed
    form for a pinhole and a disc: Heikkila & Silven 1997, doi:10.1109/CVPR.1997.609468.
    """
    points = target.points
    radius = target.marker.radius
    with np.errstate(invalid="ignore", divide="ignore"):
        if not target.marker.height_m:  # flat
            rims = _disc_rims(points.tobytes(), target.normals.tobytes(), radius)
            p = transform(T_camera_target, rims).reshape(len(points), -1, 3)
        else:
            p = _sphere_rims(transform(T_camera_target, points), radius)
        return _of_rims(camera, p)


def _of_rims(camera: Camera, p: Array) -> Outlines:
    uv = camera.project(p)
    q = uv[:, 1:] - uv[:, :1]
    here = q[:, :-1]
    there = q[:, 1:]
    a = here[..., 0] * there[..., 1] - here[..., 1] * there[..., 0]
    twice_area = np.add.reduce(a, axis=1)
    bias = np.einsum("nik,ni->nk", here + there, a) / (3 * twice_area[:, None])
    return Outlines(bias, 0.5 * np.abs(twice_area), uv[:, 0])


def ball_bias(camera: Camera, radius: float, centroid: Array, area: Array) -> Array:
    """The bias (N, 2) [px] of balls from centroids (N, 2) [px] and areas (N,) [px^2], which give
    their distances; NaN stays NaN.
    """
    bias = np.zeros_like(centroid)
    reach = np.full(len(area), 10 * radius)
    with np.errstate(invalid="ignore", divide="ignore"):
        # distance and bias then have converged to 1e-4 (balls of 2 to 60 px, to 65 degrees off
        # axis)
        for _ in range(5):
            p = camera.ray(centroid - bias) * reach[:, None]
            bias, expected, _ = _of_rims(camera, _sphere_rims(p, radius))
            # The area falls with the square of the distance; never closer than the ball's own
            # surface.
            reach = np.maximum(reach * np.sqrt(expected / area), 1.01 * radius)
    return bias


@lru_cache(maxsize=256)
def _disc_rims(points: bytes, normals: bytes, radius: float) -> Array:
    """Each disc's centre and rim in the target's frame, (N (CORNERS + 2), 3), from points and
    normals (N, 3) as bytes, for the cache.
    """
    centre = np.frombuffer(points).reshape(-1, 1, 3)
    across = np.array([_across(*n) for n in np.frombuffer(normals).reshape(-1, 3).tolist()])
    rim = centre + radius * (_COS[:, None] * across[:, :1] - _SIN[:, None] * across[:, 1:])
    return np.concatenate([centre, rim], axis=1).reshape(-1, 3)


def _sphere_rims(p: Array, radius: float) -> Array:
    """Centres of spheres, and the circles of tangency of the camera's rays, shape (N, CORNERS + 2,
    3); NaN from inside.
    """
    d2 = np.einsum("ni,ni->n", p, p)
    shrink = 1 - radius**2 / d2
    rho = radius * np.sqrt(shrink)
    across = np.array([_across(*ray) for ray in (p / np.sqrt(d2)[:, None]).tolist()])
    out = np.empty((len(p), CORNERS + 2, 3))
    out[:, 0] = p
    rim = _COS[:, None] * across[:, :1]
    rim += _SIN[:, None] * across[:, 1:]
    rim *= rho[:, None, None]
    np.add((p * shrink[:, None])[:, None], rim, out=out[:, 1:])
    return out


def _across(
    x: float, y: float, z: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Two unit vectors across a ray (Duff et al. 2017, JCGT 6(1)); in plain floats, a quarter of
    numpy's time for some five markers.
    """
    sign = math.copysign(1.0, z)  # the branch without a singularity at z = -1
    a = -1 / (sign + z)
    b = x * y * a
    return (1 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)


# Data association: which blob is which marker where several have its hue, by the pose of the target
# that explains them.
Positioned = tuple[int, Blob]  # index of the camera's panel, and a blob in it
Found = Positioned | None  # a marker's; None: not found
Candidates = list[list[Positioned]]  # for each marker the blobs of its hue
# a pose (4, 4), the blobs that it may explain, and how many of them it must explain
Hypothesis = tuple[Array, Candidates, int]

# candidates of one marker, and markers whose candidates make hypotheses: at most 4^4
MOST_OF_A_HUE = 4
SEEDS = 4


def allowed_px(uv: Array) -> float:
    """Distance from the predicted marker beyond which a blob is another object, in an image of
    markers at uv (N, 2) [px].

    It is far more than the detection's error, and more than the distortion of a target by a lens
    some percent out of calibration.
    """
    # in plain floats, which are quicker for so few
    seen = [(u, v) for u, v in uv.tolist() if math.isfinite(u)]
    return max([3.0, *(0.03 * (max(side) - min(side)) for side in zip(*seen, strict=True))])


def assign_blobs(
    candidates: Candidates, camera: Camera, target: Target, previous: Array | None
) -> list[Found]:
    """One blob for each marker, None where none fits, from the blobs of each marker's hue in a
    camera of one panel.

    Hypothesise and verify, as in RANSAC but exhaustively: every combination of blobs (uncut and
    large ones first) of the markers with the fewest candidates gives a pose. The pose that explains
    most blobs by position and area wins, each blob weighted by how well it fits. Four blobs must
    agree with a pose, or three near the previous pose (4, 4): three blobs have a pose wherever they
    are, so only continuity tells them from others. Fewer than three markers determine no pose: then
    the first candidate, or the one nearest to the last pose, is taken.
    """
    few = [
        sorted(c, key=lambda f: (f[1].whole, f[1].area), reverse=True)[:MOST_OF_A_HUE]
        for c in candidates
    ]
    association = _Association(few, camera, target, previous)
    if len(_present(few)) < 3 or max(map(len, few)) < 2:
        return association.without_pose()
    return (
        association.best(association.of_four_or_near())
        or association.best(association.of_three())
        or [None] * len(few)
    )


@dataclass(frozen=True, slots=True)
class _Association:
    few: Candidates
    camera: Camera
    target: Target
    previous: Array | None

    def without_pose(self) -> list[Found]:
        """The first blob of each marker, or the one nearest to where the last pose has it."""
        if self.previous is None:
            return [c[0] if c else None for c in self.few]
        uv = self._predicted(self.previous)
        return [
            min(c, key=lambda f: _away(f[1], uv[i]), default=None) for i, c in enumerate(self.few)
        ]

    def best(self, hypotheses: Iterator[Hypothesis]) -> list[Found] | None:
        """The blobs that the best hypothesis explains; None where none explains enough of them."""
        best = 0.0
        found = None
        for T, blobs, least in hypotheses:
            # from behind it shows no markers: it is the mirror image of a right match
            if self.target.one_sided and inverse(T)[2, 3] >= 0:
                continue
            score, chosen = self._explained(blobs, T)
            if score > best and len(chosen) - chosen.count(None) >= least:
                best = score
                found = chosen
        return found

    def of_four_or_near(self) -> Iterator[Hypothesis]:
        """Poses of the four markers with the fewest blobs, and of three whose blobs lie near the
        last pose's.
        """
        seeds = sorted(_present(self.few), key=lambda i: len(self.few[i]))[:SEEDS]
        if len(seeds) > 3:
            for T in self._poses(seeds, self.few):
                yield T, self.few, 4
        if self.previous is None:
            return
        uv = self._predicted(self.previous)
        # round a marker under the last pose [px], by the target's size
        radius = max(15.0, 0.15 * float(np.ptp(uv, axis=0).max()))
        near = [[f for f in c if _away(f[1], uv[i]) <= radius] for i, c in enumerate(self.few)]
        for three in combinations(_present(near)[:SEEDS], 3):
            for T in self._poses(list(three), near):
                yield T, near, 3

    def of_three(self) -> Iterator[Hypothesis]:
        """Poses of three blobs anywhere: where three markers are all that is seen, and continue a
        pose or are the whole target.
        """
        present = _present(self.few)
        if len(present) == 3 and (self.previous is not None or len(self.target.points) == 3):
            for T in self._poses(present, self.few):
                yield T, self.few, 3

    def _predicted(self, previous: Array) -> Array:
        return self.camera.project(transform(previous, self.target.points))

    def _poses(self, which: list[int], candidates: Candidates) -> Iterator[Array]:
        points = self.target.points[which]
        for some in product(*(candidates[i] for i in which)):
            rays = self.camera.ray(np.array([(b.u, b.v) for _, b in some]))
            if len(which) == 3 and self.previous is None:
                yield from three_ray_poses(rays, points)
            elif (T := solve_pose_from_rays(rays, points, self.previous)) is not None:
                yield T

    def _explained(self, candidates: Candidates, T: Array) -> tuple[float, list[Found]]:
        """Score of a pose, sum over markers of max(0, 1 - distance / allowed), and the blob of each
        marker that it explains.
        """
        bias, area, centre = centre_bias(self.camera, self.target, T)
        uv = centre + bias
        allowed = allowed_px(uv)
        chosen = []
        score = 0.0
        for i, some in enumerate(candidates):
            # Not balls of another size elsewhere in the scene; a cut one may have any area.
            like = [f for f in some if not f[1].whole or abs(np.log(f[1].area / area[i])) <= 0.3]
            fitting = [(f, _away(f[1], uv[i])) for f in like]
            f, distance = min(fitting, key=lambda g: g[1], default=(None, np.inf))
            chosen.append(f if distance <= allowed else None)
            score += max(0.0, 1 - distance / allowed)
        return score, chosen


def _present(candidates: Candidates) -> list[int]:
    return [i for i, c in enumerate(candidates) if c]


def _away(blob: Blob, uv: Array) -> float:
    return float(np.hypot(blob.u - uv[0], blob.v - uv[1]))


# Tracking of blobs over a camera's panels: search windows around predicted blobs, handover between
# panels.

# blobs are measured so far beyond their mask's box [px], which may touch the window in which they
# were searched
MEASURED_PX = 2
# Two blobs of one hue, in overlapping panels, are one marker seen twice where their rays are under
# 3 degrees apart.
SAME_MARKER_COSINE = math.cos(math.radians(3))


@dataclass(frozen=True, slots=True)
class BlobsState:
    """State of the blob detector, of N markers.

    Attributes:
        blobs: each marker's blob in the last picture; None for a lost one. moves: last known move
            of each blob [px]; zero at first.
        T_camera_target: last known pose of the target (4, 4). bias: perspective bias in the last
            picture (N, 2) [px].
        panels: index of the panel in which each marker will be searched; blob and move are in that
            panel's pixels.
    """

    blobs: tuple[Blob | None, ...] = ()
    moves: tuple[Move, ...] = ()
    T_camera_target: Array | None = None
    bias: Array | None = None
    panels: tuple[int, ...] = ()


def windows(state: BlobsState, camera: Camera, margin: int) -> list[Window] | None:
    """A window around each marker's predicted blob, in its panel; None where one is lost or a whole
    search is faster.
    """
    boxes = [b.box if b else None for b in state.blobs]
    return windows_round(boxes, state.moves, camera, margin, state.panels)


def regions_of(state: BlobsState, camera: Camera, margin: int) -> Regions | None:
    """Regions of interest, in each panel, of the next detection; None for everything."""
    own = windows(state, camera, margin + MEASURED_PX)
    if own is None:
        return None
    if len(camera.panels) == 1:
        return (tuple(own),)
    out: list[list[Window]] = [[] for _ in camera.panels]
    for blob, move, home in zip(state.blobs, state.moves, state.panels, strict=True):
        if blob is None:
            return None
        lens = camera.panels[home].lens
        # so that a marker a little outside of its predicted window is still rendered
        wide = margin + 0.1 * lens.width
        # In its own panel and, near the border, in every other that sees it.
        near = _slack(blob, move, lens) < wide
        for panel in range(len(camera.panels)) if near else [home]:
            seen = seen_from(blob, move, home, panel, camera)
            if seen is None:
                continue
            window = window_round(seen[0].box, seen[1], camera.panels[panel].lens, wide)
            if window is not None:
                out[panel].append(window)
    return tuple(map(tuple, out))


def moves_of(
    state: BlobsState, blobs: list[Blob | None], panels: list[int], camera: Camera
) -> tuple[Move, ...]:
    """Displacement of each blob since the last picture [px]; the last known one of a blob that was
    not seen then, or is not now.

    Zero where none is known in the panel in which the blob is now.
    """
    if not state.blobs:
        return ((0.0, 0.0),) * len(blobs)
    out: list[Move] = []
    for last, move, before, blob, panel in zip(
        state.blobs, state.moves, state.panels, blobs, panels, strict=True
    ):
        if before != panel:
            move = (0.0, 0.0)
            seen = seen_from(last, move, before, panel, camera) if last else None
            last = seen[0] if seen else None
        out.append((blob.u - last.u, blob.v - last.v) if last and blob else move)
    return tuple(out)


def hand_over(state: BlobsState, camera: Camera, margin: int) -> BlobsState:
    """The same with each blob that nears its panel's border in the panel where it will be farthest
    from a border.
    """
    blobs = list(state.blobs)
    moves = list(state.moves)
    panels = list(state.panels)
    last = zip(state.blobs, state.moves, state.panels, strict=True)
    for i, (blob, move, home) in enumerate(last):
        if blob is None:
            continue
        most = _slack(blob, move, camera.panels[home].lens)
        if most >= margin + max(abs(move[0]), abs(move[1])) / 2:
            continue
        for panel in range(len(camera.panels)):
            seen = seen_from(blob, move, home, panel, camera)
            if seen is not None and _slack(*seen, camera.panels[panel].lens) > most:
                most = _slack(*seen, camera.panels[panel].lens)
                blobs[i], moves[i] = seen
                panels[i] = panel
    return replace(state, blobs=tuple(blobs), moves=tuple(moves), panels=tuple(panels))


def seen_from(
    blob: Blob, move: Move, panel: int, other: int, camera: Camera
) -> tuple[Blob, Move] | None:
    """A blob and its move in another panel's pixels; None where the blob's prediction lies outside
    of that other panel.
    """
    if other == panel:
        return blob, move
    there = camera.panels[other]
    left, top, right, bottom = (side - 0.5 for side in blob.box)
    corners = [(left, top), (right, top), (left, bottom), (right, bottom)]
    px = np.array([(blob.u, blob.v), (blob.u + move[0], blob.v + move[1]), *corners])
    uv = there.project(camera.panels[panel].ray(px))
    if not (np.isfinite(uv).all() and there.lens.inside(uv[1:2]).all()):
        return None
    left, top = np.floor(uv[2:].min(axis=0) + 0.5).astype(int).tolist()
    right, bottom = np.ceil(uv[2:].max(axis=0) + 0.5).astype(int).tolist()
    u, v = uv[0].tolist()
    du, dv = (uv[1] - uv[0]).tolist()
    return replace(blob, u=u, v=v, box=(left, top, right, bottom)), (du, dv)


def _slack(blob: Blob, move: Move, lens: Camera) -> float:
    """Least distance of the predicted blob's box from the image's border [px]; negative where it
    reaches beyond.
    """
    left, top, right, bottom = blob.box
    du, dv = move
    return min(left + du, top + dv, lens.width - right - du, lens.height - bottom - dv)


def largest(found: list[Positioned], camera: Camera) -> Found:
    """Of the blobs of one hue, each with its panel, the largest, blobs that are not cut first; in
    panels by solid angle.

    A pinhole image enlarges the area of what lies at an angle a off the axis by 1 / cos^3 a. Of a
    marker that is seen in two panels the blob nearer to its panel's axis is taken.
    """
    if len(camera.panels) == 1 or not found:
        return max(found, key=lambda f: (f[1].whole, f[1].area), default=None)
    rays = [camera.panels[p].ray(np.array([b.u, b.v])) for p, b in found]
    cosines: list[float] = []
    ranks: list[tuple[bool, float]] = []
    for (p, blob), ray in zip(found, rays, strict=True):
        cosine = float(ray @ camera.panels[p].R_camera_panel[:, 2])
        cosines.append(cosine)
        ranks.append((blob.whole, blob.area * cosine**3))
    best = ranks.index(max(ranks))
    panel, most = found[best]
    same: list[int] = []
    for i, (p, blob) in enumerate(found):
        alike = p != panel and blob.whole == most.whole
        if alike and rays[i] @ rays[best] > SAME_MARKER_COSINE:
            same.append(i)
    return found[max([*same, best], key=lambda i: cosines[i])]


# From blobs to marker centres: perspective bias corrected, blobs that do not fit the pose rejected.

# error of a blob's area by rounding to pixels, three standard deviations [px^2] (drawn ellipses of
# 2 to 8 px radius)
AREA_NOISE_PX = 3.5
# sum over three markers of |log(area / predicted)|: the right pose of rendered discs has under .05,
# most others over .6
SURPRISE = 0.15
_NOT_WHOLE = Blob(math.nan, math.nan, math.nan, math.nan, (0, 0, 0, 0), whole=False)


class MarkerFit:
    """Fits one picture's blobs by a pose of the target; pixels are those of the panel in which each
    blob was found.

    Args:
        panels: index of the panel of each marker's blob, N of them. edge: error of a blob's border,
            inwards or outwards [px].
        area_tolerance: largest relative difference between a blob's area and the predicted one.
    """

    def __init__(
        self, camera: Camera, target: Target, panels: list[int], area_tolerance: float, edge: float
    ):
        self._camera = camera
        self._target = target
        self._tolerance = area_tolerance
        self._edge = edge
        # The panels in which markers are, each with which they are, (N,) bool; None for a camera
        # with one panel, its own picture.
        self._of: list[tuple[Panel, NDArray[np.bool_]]] | None = None
        if len(camera.panels) > 1:
            of = np.array(panels)
            self._of = [(camera.panels[panel], of == panel) for panel in set(panels)]
        self.outliers = np.zeros(len(target.points), dtype=bool)
        """Which blobs are no markers of this target: they lie far from where the pose of the others
        predicts them, (N,).
        """

    def centres(
        self, blobs: list[Blob | None], state: BlobsState, correct: bool
    ) -> tuple[Array, Array | None, Array]:
        """Marker centres (N, 2) in the camera's own pixels, the pose (4, 4), and the perspective
        bias (N, 2) in the panels'.

        Args:
            blobs: of each marker; None where none was found. state: the last picture, whose bias
                and pose start the iteration.
            correct: subtract the bias from the centres.
        """
        whole = [b if b and b.whole else _NOT_WHOLE for b in blobs]
        centroid = np.array([(b.u, b.v) for b in whole])
        area = np.array([b.area for b in whole])
        assumed = np.zeros_like(centroid) if state.bias is None else state.bias
        T, bias = self._fitted(centroid, area, assumed, state.T_camera_target)
        if T is None:
            bias = self._bias_without_pose(centroid, area, bias, state.T_camera_target)
        uv = centroid - bias if correct else centroid
        if self._of is not None:
            uv = self._camera.project(self._rays(uv))
        return uv, T, bias

    def _fitted(
        self, centroid: Array, area: Array, assumed: Array, previous: Array | None
    ) -> tuple[Array | None, Array]:
        """The pose (4, 4) that fits the markers, None where there is none, and their bias (N, 2)
        [px].

        Alternates between the pose from the centroids less the assumed bias and the bias under that
        pose. Rejected markers become NaN in `centroid` (N, 2) and `area` (N,), in place.
        """
        T = self._pose(centroid - assumed, area, previous)
        for _ in range(len(centroid) + 3):  # one pose for each rejected marker, and three
            if T is None:
                break
            expected = self._expected(T)
            bias = expected.bias
            worst, misfit = self._worst(area, expected.area)
            outlier = self._outlier(centroid, expected, area, previous, misfit)
            if outlier is not None:
                worst, T, assumed = outlier
                centroid[worst] = area[worst] = np.nan
                continue
            if misfit > 1:
                centroid[worst] = area[worst] = np.nan
            elif not np.abs(bias - assumed).max() > 0.02:
                # Under .02 px another round would change it by a tenth of that. "not >", so that
                # the NaN of lost markers ends the loop.
                break
            assumed = bias
            T = self._pose(centroid - assumed, area, T if previous is None else previous)
        return T, assumed

    def _bias_without_pose(
        self, centroid: Array, area: Array, assumed: Array, previous: Array | None
    ) -> Array:
        """Bias (N, 2) [px] of markers too few for a pose: of balls by their size, of discs under
        the last pose.
        """
        radius = self._target.marker.radius
        if not self._target.marker.height_m:
            return assumed if previous is None else self._expected(previous).bias
        if self._of is None:
            bias = ball_bias(self._camera, radius, centroid, area)
        else:
            bias = np.zeros_like(centroid)
            for panel, mine in self._of:
                bias[mine] = ball_bias(panel.lens, radius, centroid[mine], area[mine])
        return np.where(np.isfinite(bias), bias, 0.0)

    def _outlier(
        self,
        centroid: Array,
        expected: Outlines,
        area: Array,
        previous: Array | None,
        misfit: float,
    ) -> tuple[int, Array, Array] | None:
        """The blob that is not this target's, with the pose and bias of the others; None where the
        pose of all explains them.

        Leave one out: that blob is dropped without which the others fit best, by position and,
        since three points always have a pose, by area. Four blobs of which one is another object
        hardly have a pose that fits their areas, too.
        """
        if self._of is not None:
            return None
        seen = np.flatnonzero(np.isfinite(centroid[:, 0]))
        if len(seen) < 4:
            return None
        allowed = allowed_px(centroid)
        if misfit <= 1 and _off(centroid, expected)[seen].max() <= allowed:
            return None
        best = math.inf
        found = None
        for i in seen.tolist():
            others = centroid.copy()
            left = area.copy()
            others[i] = left[i] = np.nan
            pose = self._of_others(others - expected.bias, left, previous)
            if pose is None:
                continue
            there = self._expected(pose)
            surprise = float(np.nanmean(np.abs(np.log(left / there.area)))) / SURPRISE
            score = surprise + float(np.nanmax(_off(others, there))) / allowed
            if score < best:
                best = score
                found = i, pose, there
        if found is None:
            return None
        index, pose, there = found
        self.outliers[index] = _off(centroid, there)[index] > allowed
        return index, pose, there.bias

    def _of_others(self, uv: Array, area: Array, previous: Array | None) -> Array | None:
        seen = np.isfinite(uv[:, 0])
        pose = self._pose(uv, area, previous)
        if np.count_nonzero(seen) > 3 or (
            pose is not None and self._surprise(pose, area) < SURPRISE
        ):
            return pose
        return self._first_of_three(self._rays(uv[seen]), area)

    def _surprise(self, T: Array, area: Array) -> float:
        return float(np.nansum(np.abs(np.log(area / self._expected(T).area))))

    def _expected(self, T_camera_target: Array) -> Outlines:
        if self._of is None:
            return centre_bias(self._camera, self._target, T_camera_target)
        n = len(self._target.points)
        out = Outlines(np.full((n, 2), np.nan), np.full(n, np.nan), np.full((n, 2), np.nan))
        for panel, mine in self._of:
            T = T_camera_target.copy()
            T[:3] = panel.R_camera_panel.T @ T[:3]
            in_panel = centre_bias(panel.lens, self._target, T)
            for all_of_them, there in zip(out, in_panel, strict=True):
                all_of_them[mine] = there[mine]
        return out

    def _rays(self, uv: Array) -> Array:
        if self._of is None:
            return self._camera.ray(uv)
        rays = np.empty((len(uv), 3))
        for panel, mine in self._of:
            rays[mine] = panel.ray(uv[mine])
        return rays

    def _pose(self, uv: Array, area: Array, previous: Array | None) -> Array | None:
        """The pose (4, 4) from the images of the centres (N, 2) [px];
        None with fewer than three.
        """
        seen = np.isfinite(uv[:, 0])
        rays = self._rays(uv)[seen]
        points = self._target.points[seen]
        if len(points) < 3:
            return None
        if len(points) == 3 and previous is None:
            return self._first_of_three(rays, area)
        return solve_pose_from_rays(rays, points, previous)

    def _first_of_three(self, rays: Array, area: Array) -> Array | None:
        """Of the poses that three rays (3, 3) leave, the one that fits the areas (N,) best; None if
        even that does not fit.
        """
        poses = three_ray_poses(rays, self._target.points[np.isfinite(area)])
        best = min(poses, key=lambda T: self._surprise(T, area), default=None)
        return best if best is not None and self._surprise(best, area) < SURPRISE else None

    def _worst(self, area: Array, expected: Array) -> tuple[int, float]:
        """Index of the area (N,) farthest from the predicted one, and that difference over the one
        allowed; NaN areas are skipped.
        """
        worst = 0
        most = -1.0
        # A loop in Python: on these few numbers it is quicker than NumPy.
        for i, (a, e) in enumerate(zip(area.tolist(), expected.tolist(), strict=True)):
            if math.isnan(a):
                continue
            allowed = self._tolerance * e + AREA_NOISE_PX + self._edge * 2 * math.sqrt(math.pi * e)
            misfit = math.inf if math.isnan(e) else abs(a - e) / allowed
            if misfit > most:
                worst = i
                most = misfit
        return worst, most


def _off(centroid: Array, expected: Outlines) -> Array:
    return lengths(centroid - (expected.centre + expected.bias))[:, 0]


Place = tuple[int, Window]  # index of the camera's panel, and a window in it


@spec
class Blobs(DetectorBase):
    """Markers by colour: chroma mask, contours, moments; identified by the hue at the centroid.

    Tracking: a marker is searched in a window around its predicted position (constant velocity),
    and where it is not found there, in the whole image of the same exposure. In a camera with
    panels it is handed over to the next panel before it reaches a border. Of several blobs of one
    hue, those are taken that one pose of the target explains (`assign_blobs`).

    Measurement: the image of the marker's centre is the centroid less the perspective bias under
    the pose that the markers themselves give. A blob is rejected if it touches the image's border,
    if its shape is no ellipse, if its area differs from what the pose predicts (occlusion), or if
    it lies far from where the pose of the others predicts it. Of three markers without an earlier
    pose, the solution whose areas fit best is taken. With fewer than three, border and shape alone
    decide, and the bias is that of the last pose.

    Noise: its level is estimated from the image (`noise_level`: 0 for a rendered one without
    noise). From a standard deviation of about 1 grey level, blobs are segmented in the smoothed
    image, and with `grey` moments edge pixels are weighted by their measured chroma: centroids of 2
    cm discs at 1 m scatter by .01, .02 and .05 px for 2, 8 and 20 grey levels. Above 20, markers
    begin to be missed; from about 30 on, noise itself may be taken for a marker.

    Args:
        chroma: max - min of r, g, b (0..255) above which a pixel belongs to a marker [grey levels];
            scenes keep everything else below it.
        hue_tolerance_deg: largest difference to the marker's hue; never more than half the step
            between two markers' hues.
        least_area_px: least area of a blob; smaller ones are noise [px^2].
        moments: `binary` weights each pixel 0 or 1; `grey` by coverage, which is finer in images
            with multisampling and the same in images with neither multisampling nor noise, whose
            markers are of one colour up to the edge.
        correct_centre: subtract the perspective bias from the centroid.
        area_tolerance: largest relative difference between a blob's area and the predicted one [1].
        window_margin_px: margin of a window around the predicted blob, besides half of its last
            move [px].

    Reference: Corke 2017, Robotics, Vision & Control, sections 13.1 and 15.2 (blobs, moments,
    visual servoing with them).
    """

    kind: Literal["blobs"] = "blobs"
    chroma: Annotated[int, Ge(1), Lt(255)] = 60
    hue_tolerance_deg: Annotated[PositiveAngle, TighterBounds(le=180)] = 15.0
    least_area_px: Annotated[Pixels, TighterBounds(ge=1)] = 9.0
    moments: Literal["binary", "grey"] = "grey"
    correct_centre: bool = True
    area_tolerance: Annotated[float, Gt(0), Lt(1)] = 0.06
    window_margin_px: Annotated[int, Ge(2), Le(8192)] = 8
    needs_image: ClassVar[bool] = True
    markers: ClassVar[tuple[str, ...]] = ("disc", "sphere")

    def init(self) -> BlobsState:
        """Nothing seen yet."""
        return BlobsState()

    def regions_of_interest(
        self, state: BlobsState, camera: Camera, target: Target
    ) -> Regions | None:
        """Windows around the predicted markers, in a camera with panels also across the seams; None
        where a marker is lost.
        """
        return regions_of(state, camera, self.window_margin_px) if state.blobs else None

    def detect(
        self,
        state: BlobsState,
        picture: Picture | None,
        view: TruthView | None,
        camera: Camera,
        target: Target,
        rng: np.random.Generator,
    ) -> tuple[BlobsState, Detection]:
        """Marker centres (N, 2) [px] in one picture, NaN where not seen, and the pose (4, 4) where
        it can be solved.
        """
        picture = self._given(picture)
        noise = _noise_levels(picture)
        found = self._track(picture, noise, state, camera, target)
        if found is None:
            picture = picture.completed()
            noise = _noise_levels(picture)
            found = self._search(picture, noise, state, camera, target)
        blobs = [f[1] if f else None for f in found]
        # A marker that is not found stays in the panel in which it was seen last, at first 0.
        panels = [
            f[0] if f else last
            for f, last in zip(found, state.panels or (0,) * len(found), strict=True)
        ]
        edge = _edge_px(found, noise, camera)
        markers = MarkerFit(camera, target, panels, self.area_tolerance, edge)
        uv, T, bias = markers.centres(blobs, state, self.correct_centre)
        for i in np.flatnonzero(markers.outliers):
            blobs[i] = None  # not tracked: its window would follow the wrong object
        kept = T if T is not None else state.T_camera_target
        moves = moves_of(state, blobs, panels, camera)
        after = BlobsState(tuple(blobs), moves, kept, bias, tuple(panels))
        if len(camera.panels) > 1:
            after = hand_over(after, camera, self.window_margin_px)
        return after, Detection(uv=uv, T_camera_target=T)

    def _blobs_in(
        self, places: list[Place], picture: Picture, noise: list[float], camera: Camera
    ) -> list[list[Blob]]:
        regions: list[Region] = []
        for panel, window in places:
            image = picture.images[panel]
            assert image is not None
            level = noise[panel]
            mixed = mixes_colours(camera.panels[panel].lens) or (
                level > 0 and self.moments == "binary"
            )
            rim: Rim = self.moments if mixed else "sharp"
            regions.append(Region(image, window, rim, level))
        found = find_blobs(regions, self.chroma, self.least_area_px)
        for (panel, _), blobs in zip(places, found, strict=True):
            lens = camera.panels[panel].lens
            # noise makes blobs outside of a wide lens's image circle, too, where a pixel has no ray
            if blobs and not lens.sees_all:
                rays = lens.ray(np.array([(blob.u, blob.v) for blob in blobs]))
                blobs[:] = compress(blobs, np.isfinite(rays[:, 0]))
        return found

    def _track(
        self,
        picture: Picture,
        noise: list[float],
        state: BlobsState,
        camera: Camera,
        target: Target,
    ) -> list[Found] | None:
        """Each marker's blob from a window of its own; None where one is lost and the whole image
        must be searched.
        """
        own = windows(state, camera, self.window_margin_px)
        if own is None or any(picture.images[panel] is None for panel in state.panels):
            return None
        places = list(zip(state.panels, own, strict=True))
        found: list[Found] = []
        by_marker = self._blobs_in(places, picture, noise, camera)
        for hue, last, move, (panel, window), blobs in zip(
            target.hues_deg, state.blobs, state.moves, places, by_marker, strict=True
        ):
            if last is None:
                return None
            u = last.u + move[0]
            v = last.v + move[1]
            alike = [b for b in blobs if self._has_hue(b, hue, target)]
            blob = min(alike, key=lambda b: math.hypot(b.u - u, b.v - v), default=None)
            if blob is None or _may_go_on(blob, window, panel, camera):
                return None
            found.append((panel, blob))
        return found

    def _search(
        self,
        picture: Picture,
        noise: list[float],
        state: BlobsState,
        camera: Camera,
        target: Target,
    ) -> list[Found]:
        """Each marker's blob in the whole image: of those of its hue the one that the geometry
        explains; with panels the largest.
        """
        everywhere: list[Positioned] = []
        # One by one: a panel is too large for the time of a call to count.
        for i, image in enumerate(picture.images):
            if image is not None:
                whole = (0, 0, camera.panels[i].lens.width, camera.panels[i].lens.height)
                blobs = self._blobs_in([(i, whole)], picture, noise, camera)[0]
                everywhere += [(i, blob) for blob in blobs]
        by_marker = [
            [f for f in everywhere if self._has_hue(f[1], hue, target)] for hue in target.hues_deg
        ]
        if len(camera.panels) == 1 and max(map(len, by_marker)) > 1:
            return assign_blobs(by_marker, camera, target, state.T_camera_target)
        return [largest(some, camera) for some in by_marker]

    def _has_hue(self, blob: Blob, hue_deg: float, target: Target) -> bool:
        tolerance = min(self.hue_tolerance_deg, target.hue_gap_deg / 2)
        return abs((blob.hue_deg - hue_deg + 180) % 360 - 180) <= tolerance


def _noise_levels(picture: Picture) -> list[float]:
    return [0.0 if image is None else noise_level(image) for image in picture.images]


def _edge_px(found: Sequence[Found], noise: list[float], camera: Camera) -> float:
    """Error of the border of a smoothed, shaded blob [px] (rendered balls of 5 px radius and more);
    a clean, sharp image has exact colours.
    """
    noisy = any(noise[f[0]] > 0 for f in found if f)
    return 0.15 if noisy or mixes_colours(camera.panels[0].lens) else 0.0


def _may_go_on(blob: Blob, window: Window, panel: int, camera: Camera) -> bool:
    """Whether a blob may go on beyond an edge of the window in which it was found, or in another
    panel, which may have the whole of one at the image's border.
    """
    lens = camera.panels[panel].lens
    left, top, right, bottom = blob.box
    return (
        left <= window[0] > 0
        or top <= window[1] > 0
        or right >= window[2] < lens.width
        or bottom >= window[3] < lens.height
        or (len(camera.panels) > 1 and _slack(blob, (0.0, 0.0), lens) <= 0)
    )
