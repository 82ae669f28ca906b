"""The target's pose from its marker pixels: perspective-n-point, with the mirror pose kept in view."""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import combinations
from typing import Literal

import cv2
import numpy as np
from cv2.typing import MatLike

from vstestbed.core.geometry import Array, exp, inverse, rigid_error
from vstestbed.vision.all_round import solve_pose_all_round

_K, _EYE = np.eye(3), np.eye(4)
STANDS = 1e-3
"""A pose that continues the last one stands where its pixel error is under this share of the image points' spread: a mirror
pose that fits as well as that cannot be told from the right one."""
CONTINUES = 0.2
"""Farther from the last pose than this (radians plus share of the distance) it does not continue it; the refinement's few
rounds reach rounding from nearer."""
CLEARLY_WORSE = 6.0
"""Of two mirror poses, the one whose pixels fit this many times worse is out, whatever came before."""
SAME_SCENE = 0.5
"""Of the up to four poses that three markers leave, one farther than this from the last (radians plus share of the distance)
does not continue it."""
WIDE = 0.2
"""A ray with less than this of its unit length along z (78 degrees off axis) is not given to the solvers as x/z, y/z."""

FITS = 0.5
"""A pose whose pixel error is more than this share of the image points' spread is no solution."""
DOUBTFUL = 0.3
"""IPPE's poses with an error above this share of the spread may be nonsense out of a half turn."""
NEAR_HALF_TURN = 0.3
"""IPPE's rotations this near to a half turn [rad] are not relied upon; farther off its nonsense shows in the error."""
ROUNDING = 1e-12
"""Pixel errors (normalised) that differ by this are equal."""
_START_VECTOR = np.array([[0.0], [0.0], [1.0]])
_START = exp(np.array([0, 0, 0, 0, 0, 1.0]))[:3, :3]
_TURN = exp(np.array([0, 0, 0, 0.5, 0.7, 1.1]))


def solve_pose(xy: Array, points: Array, previous: Array | None = None) -> Array | None:
    """Pose T_camera_target (4, 4) from N >= 3 points and their normalised image coordinates; None where it cannot be told.

    Minimises sum |xy_i - project(T p_i)|^2, starting from the previous pose and, where that leads to no good fit, from
    - IPPE for coplanar points (N >= 4), both of its poses weighed: the better fit where it fits clearly better, else the
      one nearer to `previous`;
    - SQPnP for points in space (N >= 4);
    - P3P for points of which all but one lie on a line: they fix no homography, which IPPE starts from, and SQPnP finds a
      lesser minimum for one view in fourteen. The pose that three of them leave and the others fit best;
    - P3P for three points: the pose nearest to `previous`, None without one.
    A pose that puts a point behind the camera is no solution, nor is one that leaves half of the image's spread unexplained.
    Points on one line have none.

    IPPE hands its rotation out as a vector, which is lost near a half turn; where that may have happened the points are
    solved once more, turned. The refinement works on turned points at all times and is kept where it fits better.

    Args:
        xy: normalised, undistorted coordinates, shape (N, 2).
        points: the same markers in the target frame, shape (N, 3) [m].
        previous: the pose a frame ago, shape (4, 4).

    References: Collins & Bartoli 2014, doi:10.1007/s11263-014-0725-5 (IPPE); Terzakis & Lourakis 2020,
    doi:10.1007/978-3-030-58452-8_28 (SQPnP); Ke & Roumeliotis 2017, doi:10.1109/CVPR.2017.491 (AP3P); refinement as
    virtual visual servoing: Marchand, Uchiyama & Spindler 2016, doi:10.1109/TVCG.2015.2513408.
    """
    if len(points) < 3:
        return None
    xy, points = np.ascontiguousarray(xy, dtype=float), np.ascontiguousarray(points, dtype=float)
    shape = _layout(points.tobytes())
    if shape == "line":
        return None
    if len(points) == 3:
        return None if previous is None else _continue(_three(xy, points), previous)
    spread = _spread(xy)
    if previous is not None:
        T, error = _refine(xy, points, previous)
        if error < STANDS * spread and _step(T, previous) < CONTINUES:
            return T
    planar = shape == "plane"
    found = _from_three(xy, points) if shape == "line and one" else _candidates(xy, points, planar)
    if planar and any(_doubtful(error, angle, spread) for error, angle, _ in found):
        found += [(error, angle, T @ _TURN) for error, angle, T in _candidates(xy, points @ _TURN[:3, :3].T, planar)]
    fitting = [(error, T) for error, _, T in found if error < FITS * spread and _in_front(T, points)]
    if not fitting:
        return None
    least = min(fitting, key=_error)
    if previous is not None:
        rivals = [f for f in fitting if f[0] <= CLEARLY_WORSE * least[0]]
        least = rivals[0] if len(rivals) == 1 else min(rivals, key=lambda f: _step(f[1], previous))
    T, error = _refine(xy, points, least[1])
    return T if error <= least[0] + ROUNDING else least[1]


def solve_pose_from_rays(rays: Array, points: Array, previous: Array | None = None) -> Array | None:
    """`solve_pose` for any lens: from unit rays (N, 3) in the camera frame, also such as point sideways or back.

    Rays too far off axis for x/z, y/z are turned to a virtual camera that looks along their mean, solved there and
    turned back: T_camera_target = R_camera_virtual T_virtual_target. Where no such view holds them: `solve_pose_all_round`.
    """
    if len(rays) < 3:
        return None
    if rays[:, 2].min() > WIDE:
        return solve_pose(rays[:, :2] / rays[:, 2:], points, previous)
    T = _virtual(rays)
    if T is None:
        return None if _layout(np.ascontiguousarray(points).tobytes()) == "line" else solve_pose_all_round(rays, points, previous)
    turned = rays @ T[:3, :3]
    found = solve_pose(turned[:, :2] / turned[:, 2:], points, None if previous is None else inverse(T) @ previous)
    return None if found is None else T @ found


def three_ray_poses(rays: Array, points: Array) -> list[Array]:
    """All poses (4, 4), at most four, that put three points (3, 3) [m] on three rays (3, 3) within 78 degrees of one direction."""
    if _layout(np.ascontiguousarray(points).tobytes()) == "line":
        return []
    if rays[:, 2].min() > WIDE:
        return _three(rays[:, :2] / rays[:, 2:], points)
    T = _virtual(rays)
    if T is None:
        return []
    turned = rays @ T[:3, :3]
    return [T @ found for found in _three(turned[:, :2] / turned[:, 2:], points)]


def _virtual(rays: Array) -> Array | None:
    """T_camera_virtual (4, 4) of a camera at the same place that looks along the rays' mean; None where it does not see all."""
    mean = rays.mean(axis=0)
    if np.linalg.norm(mean) < WIDE:
        return None
    T = np.eye(4)
    T[:3, :3] = _looking_along(mean)
    return T if (rays @ T[:3, 2]).min() > WIDE else None


def _candidates(xy: Array, points: Array, planar: bool) -> list[tuple[float, float, Array]]:
    """Of each pose the solver finds: the error [rms of one coordinate], the length of the rotation vector, the pose (4, 4)."""
    flag = cv2.SOLVEPNP_IPPE if planar else cv2.SOLVEPNP_SQPNP
    found, rotations, translations, errors = cv2.solvePnPGeneric(points, xy, _K, None, flags=flag)
    if not found:
        return []
    return [(e, cv2.norm(r), _matrix(r, t)) for r, t, e in zip(rotations, translations, errors.ravel().tolist(), strict=True)]


def _from_three(xy: Array, points: Array) -> list[tuple[float, float, Array]]:
    """As `_candidates`, of the poses that three of the points leave: the three that span the largest triangle."""
    triples = np.array(list(combinations(range(len(points)), 3)))
    a, b, c = np.moveaxis(points[triples], 1, 0)
    chosen = triples[np.linalg.norm(np.cross(b - a, c - a), axis=1).argmax()]
    return [(_misfit(T, xy, points), 0.0, T) for T in _three(xy[chosen], points[chosen])]


def _error(candidate: tuple[float, Array]) -> float:
    return candidate[0]


def _doubtful(error: float, angle: float, spread: float) -> bool:
    """True where the rotation is near a half turn, or came out of one as nonsense (nan, or a pose that does not fit)."""
    return not (error < DOUBTFUL * spread and abs(angle - math.pi) > NEAR_HALF_TURN)


def _refine(xy: Array, points: Array, T: Array) -> tuple[Array, float]:
    """The pose after virtual visual servoing from a given one, and its error; infinite where a point comes behind the camera.

    A rotation vector is exact to rounding only away from 0 and from a half turn (OpenCV's is 0 under 1e-5 rad), hence the
    points are turned beforehand so that the refinement starts at one radian.
    """
    turn = _START.T @ T[:3, :3]
    turned = points @ turn.T
    refined = _matrix(*cv2.solvePnPRefineVVS(turned, xy, _K, None, _START_VECTOR.copy(), T[:3, 3:].copy()))
    error = _misfit(refined, xy, turned)
    refined[:3, :3] = refined[:3, :3] @ turn
    return refined, error


def _misfit(T: Array, xy: Array, points: Array) -> float:
    """Rms error of one image coordinate under a pose; infinite where a point comes behind the camera."""
    p = points @ T[:3, :3].T
    p += T[:3, 3]
    z = p[:, 2:]
    residual = p[:, :2] / z
    residual -= xy
    return math.sqrt(np.vdot(residual, residual) / xy.size) if (z > 0).all() else math.inf


def _spread(xy: Array) -> float:
    """Rms distance of the image coordinates (N, 2) from their mean, of one coordinate."""
    d = xy - xy.sum(axis=0) / len(xy)
    return math.sqrt(np.vdot(d, d) / xy.size)


def _three(xy: Array, points: Array) -> list[Array]:
    _, rotations, translations = cv2.solveP3P(points, xy, _K, None, flags=cv2.SOLVEPNP_AP3P)
    poses = [_matrix(r, t) for r, t in zip(rotations, translations, strict=True)]
    return [T for T in poses if np.isfinite(T).all() and _in_front(T, points)]


def _continue(poses: list[Array], previous: Array) -> Array | None:
    """The pose nearest to the previous one, unless even that is another scene."""
    steps = [_step(T, previous) for T in poses]
    if not steps or min(steps) > SAME_SCENE:
        return None
    return poses[int(np.argmin(steps))]


def _step(T: Array, previous: Array) -> float:
    """How far apart two poses are: the angle [rad] plus the distance as a share of that to the target."""
    distance, angle = rigid_error(T, previous)
    return angle + distance / math.hypot(*previous[:3, 3].tolist())


def _matrix(rotation_vector: MatLike, translation: MatLike) -> Array:
    T = _EYE.copy()
    T[:3, :3] = cv2.Rodrigues(rotation_vector)[0]
    T[:3, 3:] = translation
    return T


def _in_front(T: Array, points: Array) -> bool:
    return bool((points @ T[2, :3] > -T[2, 3]).all())


def _looking_along(direction: Array) -> Array:
    """Rotation R_camera_virtual (3, 3) whose third column is the direction."""
    z = direction / np.linalg.norm(direction)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


@lru_cache(maxsize=4096)
def _layout(points: bytes) -> Literal["line", "line and one", "plane", "space"]:
    """How points (N, 3) lie, given as bytes so that the answer can be kept: the same few sets come back at each frame."""
    p = np.frombuffer(points).reshape(-1, 3)
    s = _extent(p)
    if _flat(s, 1):
        return "line"
    if len(p) > 3 and not _flat(s, 2):
        return "space"
    return "line and one" if any(_flat(_extent(np.delete(p, i, axis=0)), 1) for i in range(len(p))) else "plane"


def _extent(points: Array) -> Array:
    """Singular values (3,) [m] of points (N, 3) about their mean: how far they reach along their own three axes."""
    return np.linalg.svd(points - points.mean(axis=0), compute_uv=False).astype(float)


def _flat(extent: Array, axis: int) -> bool:
    return bool(extent[axis] <= 1e-6 * extent[0])
