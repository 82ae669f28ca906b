"""The target's pose from its marker pixels: perspective-n-point, with the mirror pose of planar
targets considered.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, lru_cache
from itertools import combinations, permutations, product
from typing import Any, Literal

import numpy as np

from vstestbed.core.geometry import Array, exp, inverse, lengths, skew, turn_between, unit_of
from vstestbed.core.lazy import cv2
from vstestbed.vision.homography import homography

__all__ = [
    "looking_along",
    "solve_pose",
    "solve_pose_from_rays",
    "three_ray_poses",
    "unit_for",
]

# The two poses of a planar target: infinitesimal plane-based pose estimation (IPPE), which has no
# degenerate frontal view.
PLANE_ROUNDING = 1e-12  # elements and singular values below this share of the largest are rounding


def planar_poses(xy: Array, points: Array) -> list[Array]:
    """Both poses T_camera_target (4, 4) of N >= 4 coplanar points (N, 3) [m]; none where they
    determine no homography.

    H ~ [J | v] maps the plane to the image near the points' middle: v is the image of the middle, J
    (2, 2) the derivative there. With R_v the shortest rotation from the optical axis to v's ray,
    and B = [1 | -v] R_v its derivative in the image (first two columns),

    B^-1 J = s1 u1 v1^T + s2 u2 v2^T   (singular values),   1/s1 = depth along the ray,
    R = R_v [[B^-1 J / s1], [+-sqrt(1 - (s2/s1)^2) v2^T]]
    (first two columns; the third is their cross product).

    The two signs are the mirror poses, which become one where the plane is orthogonal to the ray.
    (OpenCV's IPPE takes the root of 1 minus a squared column, which rounding makes negative in such
    a view: NaN at one roll in seven. It also loses poses near a half turn.)
    Reference: Collins & Bartoli 2014, section 4, doi:10.1007/s11263-014-0725-5.
    """
    flat, R_target_plane = _plane(np.ascontiguousarray(points, dtype=float).tobytes())
    H = homography(flat, xy, PLANE_ROUNDING)
    if H is None or abs(H[2, 2]) <= PLANE_ROUNDING * np.abs(H).max():
        return []
    H = H / H[2, 2]
    v = H[:2, 2]
    x, y, z = np.array([*v, 1.0]) / np.sqrt(1 + v @ v)
    R_v = np.array(
        [
            [1 - x * x / (1 + z), -x * y / (1 + z), x],
            [-x * y / (1 + z), 1 - y * y / (1 + z), y],
            [-x, -y, z],
        ]
    )
    A = np.linalg.solve(R_v[:2, :2] - v[:, None] * R_v[2, :2], H[:2, :2] - v[:, None] * H[2, :2])
    (s1, s2), Vt = np.linalg.svd(A)[1:]
    if not s1 > 0:
        return []
    tilt = np.sqrt((1 - s2 / s1) * (1 + s2 / s1)) * Vt[1]
    columns = np.empty((2, 3, 2))
    columns[:, :2] = A / s1
    columns[0, 2] = tilt
    columns[1, 2] = -tilt
    R = np.array([_rotation_of(R_v @ both) for both in columns]) @ R_target_plane.T
    # Translations by least squares: x (r_z p + t_z) = r_x p + t_x, and alike for y.
    p = points @ R.transpose(0, 2, 1)
    A = np.zeros((len(xy), 2, 3))
    A[:, 0, 0] = A[:, 1, 1] = 1.0
    A[:, :, 2] = -xy
    A = A.reshape(-1, 3)
    t = np.linalg.solve(A.T @ A, A.T @ (xy * p[..., 2:] - p[..., :2]).reshape(2, -1).T).T
    T = np.zeros((2, 4, 4))
    T[:, :3, :3] = R
    T[:, :3, 3] = t
    T[:, 3, 3] = 1.0
    return list(T)


def _rotation_of(columns: Array) -> list[list[float]]:
    """The rotation, three rows, of given first two columns (3, 2)."""
    (a, d), (b, e), (c, f) = columns.tolist()
    return [[a, d, b * f - c * e], [b, e, c * d - a * f], [c, f, a * e - b * d]]


@lru_cache(maxsize=4096)
def _plane(points: bytes) -> tuple[Array, Array]:
    """Coplanar points (N, 3), as bytes for the cache, in their plane (N, 2) about their middle [m],
    and R_target_plane (3, 3).
    """
    p = np.frombuffer(points).reshape(-1, 3)
    p = p - p.mean(axis=0)
    axes = np.linalg.svd(p)[2]
    axes[2] *= np.linalg.det(axes)  # right-handed
    return p @ axes[:2].T, axes.T


# Pose of markers in all directions around the camera, which no pinhole image holds: from rays
# alone.
ROUNDS = 20  # most Gauss-Newton steps; five suffice from the pose a frame ago
SETTLED = 1e-11  # converged when a step is smaller than this [unit, rad]
# least distance of a marker from the camera [unit]: a guess may put one at its centre, where it has
# no direction
AT_THE_LENS = 1e-9
# a pose whose angular errors have a larger root mean square than this [rad] is no solution
RAYS_FIT = 0.05


def unit_for(points: Array) -> float:
    """The unit of length [m] for points (N, 3) [m] (`unit_of`): OpenCV's solvers have tolerances of
    their own.
    """
    return unit_of(float(lengths(points - points.mean(axis=0)).max()))


def resized(T: Array, factor: float) -> Array:
    """A pose (4, 4) with its translation times a factor."""
    T = T.copy()
    T[:3, 3] *= factor
    return T


def _in_unit(
    unit: float,
    solve: Callable[..., Array | None],
    seen: Array,
    points: Array,
    previous: Array | None,
) -> Array | None:
    """What a solver finds with lengths in a unit [m]."""
    before = None if previous is None else resized(previous, 1 / unit)
    found = solve(seen, points / unit, before)
    return None if found is None else resized(found, unit)


def solve_pose_all_round(rays: Array, points: Array, previous: Array | None = None) -> Array | None:
    """Pose T_camera_target (4, 4) that minimises the angles between unit rays d (N, 3) and points p
    (N, 3) [m]; None where none fits.

    Iterated from the previous pose; without one (N >= 4), from each of the 24 rotations R of a
    cube, with the translation that solves sum (I - d d^T) (R p + t) = 0 (Lu, Hager & Mjolsness
    2000, doi:10.1109/34.862199).
    """
    if (unit := unit_for(points)) != 1.0:
        return _in_unit(unit, solve_pose_all_round, rays, points, previous)
    if previous is not None:
        T, error = _refined(rays, points, previous)
        if error < RAYS_FIT:
            return T
    if len(rays) < 4:
        return None
    found = [_refined(rays, points, _placed(rays, points, R)) for R in _turns()]
    T, error = min(found, key=lambda f: f[1])
    return T if error < RAYS_FIT else None


@cache
def _turns() -> list[Array]:
    pairs = product(permutations(np.eye(3), 2), (1, -1), (1, -1))
    return [np.stack([a * x, b * y, a * b * np.cross(x, y)], axis=1) for (x, y), a, b in pairs]


def _placed(rays: Array, points: Array, R: Array) -> Array:
    """The pose (4, 4) of a given rotation whose translation fits the rays best."""
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    T = np.eye(4)
    T[:3, :3] = R
    turned = points @ R.T
    T[:3, 3] = np.linalg.lstsq(
        across.sum(axis=0), -(across @ turned[:, :, None])[..., 0].sum(axis=0), rcond=1e-9
    )[0]
    return T


def angular_errors(across: Array, p: Array, dp: Array) -> tuple[Array, Array, Any]:
    """Unit vectors (N, 3) along points p (N, 3), their components across rays (N, 3), and the
    Jacobian (N, 3, k) of these by the k numbers of which dp (N, 3, k) is that of p.

    across: I - d d^T of each ray d (N, 3, 3).
    """
    reach = np.maximum(lengths(p), AT_THE_LENS)
    unit = p / reach
    dunit = (dp - unit[:, :, None] * (unit[:, None] @ dp)) / reach[:, :, None]
    return unit, (across @ unit[:, :, None])[..., 0], across @ dunit


def _refined(rays: Array, points: Array, T: Array) -> tuple[Array, float]:
    """The pose after Gauss-Newton on SE(3) from T, T <- exp(x) T, and the root mean square of its
    angles [rad].
    """
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    error = math.inf
    for _ in range(ROUNDS):
        p = points @ T[:3, :3].T + T[:3, 3]
        dp = np.concatenate([np.broadcast_to(np.eye(3), (len(p), 3, 3)), -skew(p)], axis=2)
        unit, e, J = angular_errors(across, p, dp)
        cosine = np.sum(unit * rays, axis=1)
        error = math.sqrt(float(np.mean(np.arccos(np.clip(cosine, -1, 1)) ** 2)))
        # Least squares of minimum norm: directions that the markers leave open do not move.
        x = np.linalg.lstsq(J.reshape(-1, 6), -e.ravel(), rcond=1e-9)[0]
        size = float(np.abs(x).max())
        # steps are limited to a unit and 1 rad, beyond which the linearisation is void
        T = exp(x / max(1.0, size)) @ T
        if size < SETTLED:
            break
    return T, error


_K = np.eye(3)
_EYE = np.eye(4)
# A refined previous pose is accepted if its reprojection error is below STANDS times the image
# points' spread (a mirror pose that fits as well is indistinguishable from the right one) and below
# MIRRORED times its cube: a mirror pose is a local minimum only if the plane's tilt is larger than
# about the spread, with an error of some spread^2 x tilt; 1.5 spread^3 was the least of 3000 views
# nearly frontal.
STANDS = 1e-3
MIRRORED = 0.4
# ... and nearer to the previous pose (radians plus share of the distance), from where few
# iterations converge to rounding
CONTINUES = 0.2
# a mirror pose whose reprojection error is larger by this factor is rejected, whatever the previous
# pose
CLEARLY_WORSE = 6.0
# of the up to four poses of three markers, one farther than this from the last (as of CONTINUES) is
# rejected
SAME_SCENE = 0.5
WIDE = 0.2  # least z of a unit ray (78 degrees off axis) for which the solvers are given x/z, y/z
# a pose whose reprojection error exceeds this share of the image points' spread is no solution
FITS = 0.5
ROUNDING = 1e-12  # reprojection errors (normalised) that differ by this are equal
_SETTLED = (3, 30, 1e-14)  # EPS + COUNT
"""The refinement ends after as many steps or with one this small. OpenCV's default, single
precision, would stop on the way from a tilted previous pose to a far frontal view, where each step
only halves the tilt.
"""
# collinear; collinear but for one point; coplanar; in space
Layout = Literal["line", "line and one", "plane", "space"]
_START_VECTOR = np.array([[0.0], [0.0], [1.0]])
_START = exp(np.array([0, 0, 0, 0, 0, 1.0]))[:3, :3]
# reprojection error [rms of one coordinate] of a pose (4, 4) that a solver found, and the pose
_Candidate = tuple[float, Array]


def solve_pose(xy: Array, points: Array, previous: Array | None = None) -> Array | None:
    """Pose T_camera_target (4, 4) from N >= 3 points and their normalised image coordinates; None
    where they leave it open.

    Minimises sum |xy_i - project(T p_i)|^2, starting from the previous pose and, where that leads
    to no good fit, from
    - IPPE for coplanar points (N >= 4), with both of its poses: the better fit where it is clearly
      better, else the one nearer to `previous`;
    - SQPnP for points in space (N >= 4), and P3P where its pose is behind the camera, as in one
      near view of a hundred;
    - P3P for points of which all but one are collinear: they determine no homography, which IPPE
      starts from, and SQPnP finds a local minimum in one view of fourteen. Of the poses of three of
      the points, the one that all fit best;
    - P3P for three points: the pose nearest to `previous`, None without one.
    A pose with a point behind the camera is no solution, nor is one that leaves half of the image's
    spread unexplained.
    Collinear points have none. The refinement is kept where it fits better.

    Args:
        xy: normalised, undistorted coordinates (N, 2). points: the same markers in the target frame
            (N, 3) [m].
        previous: the pose a frame ago (4, 4).
    References: Collins & Bartoli 2014, doi:10.1007/s11263-014-0725-5 (IPPE); Terzakis & Lourakis
    2020, doi:10.1007/978-3-030-58452-8_28 (SQPnP); Ke & Roumeliotis 2017, doi:10.1109/CVPR.2017.491
    (AP3P); refinement as virtual visual servoing: Marchand, Uchiyama & Spindler 2016,
    doi:10.1109/TVCG.2015.2513408.
    """
    if len(points) < 3:
        return None
    xy = np.ascontiguousarray(xy, dtype=float)
    points = np.ascontiguousarray(points, dtype=float)
    shape = _layout(points)
    if shape == "line":
        return None
    if (unit := unit_for(points)) != 1.0:
        return _in_unit(unit, solve_pose, xy, points, previous)
    if len(points) == 3:
        if previous is None:
            return None
        steps = [(_step(T, previous, points), T) for T in _three(xy, points)]
        nearest, T = min(steps, key=lambda s: s[0], default=(math.inf, None))
        return None if nearest > SAME_SCENE else T
    return _of_many(xy, points, shape, previous)


def _of_many(xy: Array, points: Array, shape: Layout, previous: Array | None) -> Array | None:
    """`solve_pose` for four points and more: track the previous pose; where it does not fit,
    search.
    """
    spread = _spread(xy)
    if previous is not None:
        T, error = _refine(xy, points, previous)
        fits = error < min(STANDS * spread, MIRRORED * spread**3)
        if fits and _step(T, previous, points) < CONTINUES:
            return T
    solutions = [c for c in _candidates(xy, points, shape) if c[0] < FITS * spread]
    if not solutions:
        return None
    least, best = _preferred(solutions, previous, points)
    T, error = _refine(xy, points, best)
    return T if error <= least + ROUNDING else best


def _preferred(solutions: list[_Candidate], previous: Array | None, points: Array) -> _Candidate:
    """The best fit or, of several that fit about as well, the one nearest to the previous pose."""
    best = min(solutions, key=lambda c: c[0])
    if previous is None:
        return best
    rivals = [c for c in solutions if c[0] <= CLEARLY_WORSE * best[0]]
    if len(rivals) == 1:
        return best
    return min(rivals, key=lambda c: _step(c[1], previous, points))


def solve_pose_from_rays(rays: Array, points: Array, previous: Array | None = None) -> Array | None:
    """`solve_pose` for any lens: from unit rays (N, 3) in the camera frame, which may point
    sideways or backwards.

    Rays too far off axis for x/z, y/z are rotated to a virtual camera that looks along their mean:
    T_camera_target = R_camera_virtual T_virtual_target. Where no such view holds them all:
    `solve_pose_all_round`.
    """
    if len(rays) < 3:
        return None
    view = _pinhole(rays)
    if view is None:
        if _layout(points) == "line":
            return None
        return solve_pose_all_round(rays, points, previous)
    xy, T = view
    if T is None:
        return solve_pose(xy, points, previous)
    if previous is not None:
        previous = inverse(T) @ previous
    found = solve_pose(xy, points, previous)
    return None if found is None else T @ found


def three_ray_poses(rays: Array, points: Array) -> list[Array]:
    """All poses (4, 4), at most four, of three points (3, 3) [m] on three rays (3, 3); none unless
    a virtual camera sees them.
    """
    view = None if _layout(points) == "line" else _pinhole(rays)
    if view is None:
        return []
    xy, T = view
    return _three(xy, points) if T is None else [T @ found for found in _three(xy, points)]


def _pinhole(rays: Array) -> tuple[Array, Array | None] | None:
    """Normalised coordinates (N, 2) of rays (N, 3) in a pinhole camera that sees them all; None
    where there is none.

    It is the camera itself, or a virtual one at the same position that looks along the rays' mean:
    then with T_camera_virtual (4, 4).
    """
    if rays[:, 2].min() > WIDE:
        return rays[:, :2] / rays[:, 2:], None
    mean = rays.mean(axis=0)
    if np.linalg.norm(mean) < WIDE:
        return None
    T = np.eye(4)
    T[:3, :3] = looking_along(mean)
    turned = rays @ T[:3, :3]
    return (turned[:, :2] / turned[:, 2:], T) if turned[:, 2].min() > WIDE else None


def _candidates(xy: Array, points: Array, shape: Layout) -> list[_Candidate]:
    solvers = {
        "line and one": (_from_three,),
        "plane": (planar_poses,),
        "space": (_from_space, _from_three),
    }[shape]
    for solver in solvers:
        found = [(_misfit(T, xy, points), T) for T in solver(xy, points)]
        if any(math.isfinite(error) for error, _ in found):
            return found
    return []


def _from_space(xy: Array, points: Array) -> list[Array]:
    found, rotations, translations, _ = cv2.solvePnPGeneric(
        points, xy, _K, None, flags=cv2.SOLVEPNP_SQPNP
    )
    return [_matrix(r, t) for r, t in zip(rotations, translations, strict=True)] if found else []


def _from_three(xy: Array, points: Array) -> list[Array]:
    """The poses of three of the points, those that span the largest triangle."""
    triples = np.array(list(combinations(range(len(points)), 3)))
    a, b, c = np.moveaxis(points[triples], 1, 0)
    chosen = triples[np.linalg.norm(np.cross(b - a, c - a), axis=1).argmax()]
    return _three(xy[chosen], points[chosen])


def _refine(xy: Array, points: Array, T: Array) -> tuple[Array, float]:
    """The pose refined by virtual visual servoing, and its reprojection error; infinite with a
    point behind the camera.

    A rotation vector is exact to rounding only away from 0 and from a half turn (OpenCV's is 0
    below 1e-5 rad), hence the points are rotated first such that the refinement starts at one
    radian.
    """
    turn = _START.T @ T[:3, :3]
    turned = points @ turn.T
    turn_vector, translation = cv2.solvePnPRefineVVS(
        turned, xy, _K, None, _START_VECTOR.copy(), T[:3, 3:].copy(), _SETTLED
    )
    refined = _matrix(turn_vector, translation)
    error = _misfit(refined, xy, turned)
    refined[:3, :3] = refined[:3, :3] @ turn
    return refined, error


def _misfit(T: Array, xy: Array, points: Array) -> float:
    """Reprojection error of a pose, rms of one coordinate;
    infinite with a point behind the camera.
    """
    p = points @ T[:3, :3].T
    p += T[:3, 3]
    z = p[:, 2:]
    residual = p[:, :2] / z
    residual -= xy
    return math.sqrt(np.vdot(residual, residual) / xy.size) if (z > 0).all() else math.inf


def _spread(xy: Array) -> float:
    """Rms distance of the image coordinates (N, 2) from their mean, of one coordinate."""
    d = xy - np.add.reduce(xy) / len(xy)
    return math.sqrt(np.vdot(d, d) / xy.size)


def _three(xy: Array, points: Array) -> list[Array]:
    """The poses (4, 4), at most four, of three points, all in front of the camera."""
    _, rotations, translations = cv2.solveP3P(points, xy, _K, None, flags=cv2.SOLVEPNP_AP3P)
    poses = [_matrix(r, t) for r, t in zip(rotations, translations, strict=True)]
    return [T for T in poses if np.isfinite(T).all() and (points @ T[2, :3] > -T[2, 3]).all()]


def _step(T: Array, previous: Array, points: Array) -> float:
    """Distance between two poses: the angle [rad] plus the way of the points' middle as a share of
    its distance from the camera.
    """
    middle = _middle(points.tobytes())
    now = (T @ middle).tolist()
    before = (previous @ middle).tolist()
    return turn_between(T, previous) + math.dist(now, before) / math.hypot(*now[:3])


def _matrix(rotation_vector: Array, translation: Array) -> Array:
    T = _EYE.copy()
    T[:3, :3] = cv2.Rodrigues(rotation_vector)[0]
    T[:3, 3:] = translation
    return T


def looking_along(direction: Array) -> Array:
    """Rotation R_camera_virtual (3, 3) whose third column is the direction."""
    z = direction / np.linalg.norm(direction)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


@lru_cache(maxsize=4096)
def _middle(points: bytes) -> Array:
    return np.append(np.frombuffer(points).reshape(-1, 3).mean(axis=0), 1.0)


def _layout(points: Array) -> Layout:
    return _layout_of(np.ascontiguousarray(points).tobytes())


@lru_cache(maxsize=4096)
def _layout_of(points: bytes) -> Layout:
    """The layout of points (N, 3), given as bytes, which can be hashed: the same few subsets of
    markers recur at every frame.
    """
    p = np.frombuffer(points).reshape(-1, 3)
    s = _extent(p)
    if _flat(s, 1):
        return "line"
    if len(p) > 3 and not _flat(s, 2):
        return "space"
    if any(_flat(_extent(np.delete(p, i, axis=0)), 1) for i in range(len(p))):
        return "line and one"
    return "plane"


def _extent(points: Array) -> Array:
    """Singular values (3,) [m] of points (N, 3) about their mean: their extent along their
    principal axes.
    """
    return np.linalg.svd(points - points.mean(axis=0), compute_uv=False).astype(float)


def _flat(extent: Array, axis: int) -> bool:
    return bool(extent[axis] <= 1e-6 * extent[0])
