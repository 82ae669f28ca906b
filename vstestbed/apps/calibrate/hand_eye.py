"""Hand-eye calibration: where the camera sits on the flange, or in the room, from views of a board
and the robot's poses.

With the flange at T_base_flange and the board at T_camera_board, what does not move is in hand
T_base_board = T_base_flange X T_camera_board, X = T_flange_camera; in the room, with the board on
the flange, T_flange_board = T_base_flange^-1 X T_camera_board, X = T_base_camera. Two views give A
X = X B, with A = G_j^-1 G_i, B = T_j T_i^-1, where G is T_base_flange in hand and its inverse in
the room, and T is T_camera_board.

The five closed forms are those that OpenCV 4 has; the wheels of OpenCV 5.0 have none of them. The
bundle adjustment is what they start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from vstestbed.camera import Camera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse, rigid_error, skew
from vstestbed.vision.pnp import solve_pose

LEAST_VIEWS = 3
PARALLEL_DEG = (
    2.0  # RMS of the views' turns about some axis under which nothing is known about it [deg]
)


class View(NamedTuple):
    """A picture of the board.

    name: of the picture. T_base_flange: (4, 4) by the robot's readings. points, uv: the corners
    seen, in the board's frame (n, 3) [m] and in the picture (n, 2) [px]. T_camera_board: (4, 4) by
    these corners alone. J: what the flange's twist (6, k) in its own frame is by errors of the k
    joints [m/rad, 1]; or a unit matrix, of a robot whose poses alone are known.
    """

    name: str
    T_base_flange: Array
    points: Array
    uv: Array
    T_camera_board: Array
    J: Array


def motions(views: Sequence[View], in_hand: bool) -> tuple[Array, Array]:
    """A and B (m, 4, 4) of all pairs of views."""
    G = np.array([v.T_base_flange if in_hand else inverse(v.T_base_flange) for v in views])
    T = np.array([v.T_camera_board for v in views])
    i, j = np.triu_indices(len(views), 1)
    return np.linalg.inv(G[j]) @ G[i], T[j] @ np.linalg.inv(T[i])


def _translation(R: Array, A: Array, B: Array) -> Array:
    """X (4, 4) of its rotation: (R_A - I) t = R t_B - t_A, by least squares."""
    C, d = (A[:, :3, :3] - np.eye(3)).reshape(-1, 3), (B[:, :3, 3] @ R.T - A[:, :3, 3]).ravel()
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, np.linalg.lstsq(C, d, rcond=None)[0]
    return X


def tsai(A: Array, B: Array) -> Array:
    """Tsai & Lenz 1989, doi:10.1109/70.34770: P = 2 sin(angle/2) axis, skew(P_A + P_B) P' = P_B -
    P_A, P = 2 P' / sqrt(1 + P'^2).
    """
    pa, pb = (2 * _quaternions(M)[:, 1:] for M in (A, B))
    p = np.linalg.lstsq(skew(pa + pb).reshape(-1, 3), (pb - pa).ravel(), rcond=None)[0]
    p = 2 * p / np.sqrt(1 + p @ p)
    R = (1 - p @ p / 2) * np.eye(3) + (np.outer(p, p) + np.sqrt(4 - p @ p) * skew(p)) / 2
    return _translation(R, A, B)


def park(A: Array, B: Array) -> Array:
    """Park & Martin 1994, doi:10.1109/70.326576: R = (M^T M)^-1/2 M^T, M = sum of log(R_B)
    log(R_A)^T.
    """
    a, b = (Rotation.from_matrix(M[:, :3, :3]).as_rotvec() for M in (A, B))
    return _translation(_nearest(a.T @ b), A, B)


def horaud(A: Array, B: Array) -> Array:
    """Horaud & Dornaika 1995, doi:10.1177/027836499501400301: the unit quaternion with the least
    |q_A q - q q_B|.
    """
    qa, qb = _quaternions(A), _quaternions(B)
    D = _product(qa, left=True) - _product(qb, left=False)
    q = np.linalg.eigh(np.einsum("nij,nik->jk", D, D))[1][:, 0]
    return _translation(Rotation.from_quat(q, scalar_first=True).as_matrix(), A, B)


def andreff(A: Array, B: Array) -> Array:
    """Andreff, Horaud & Espiau 1999, doi:10.1109/IM.1999.805374: linear in R and t at once, by
    Kronecker products; R the nearest rotation.
    """
    rows = []
    for a, b in zip(A, B, strict=True):
        Ra, Rb, tb = a[:3, :3], b[:3, :3], b[:3, 3]
        rows += [
            np.hstack([np.eye(9) - np.kron(Ra, Rb), np.zeros((9, 3))]),
            np.hstack([np.kron(np.eye(3), tb), np.eye(3) - Ra]),
        ]
    C, d = np.vstack(rows), np.concatenate([np.concatenate([np.zeros(9), a[:3, 3]]) for a in A])
    x = np.linalg.lstsq(C, d, rcond=None)[0]
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = _nearest(np.asarray(x[:9], dtype=float).reshape(3, 3)), x[9:]
    return X


def daniilidis(A: Array, B: Array) -> Array:
    """Daniilidis 1999, doi:10.1177/02783649922066213: unit dual quaternions, rotation and
    translation at once.
    """
    (a, ad), (b, bd) = _dual(A), _dual(B)
    zero = np.zeros((len(A), 3, 1))
    top = np.concatenate(
        [(a - b)[:, 1:, None], skew(a[:, 1:] + b[:, 1:]), zero, np.zeros((len(A), 3, 3))], axis=2
    )
    low = np.concatenate(
        [
            (ad - bd)[:, 1:, None],
            skew(ad[:, 1:] + bd[:, 1:]),
            (a - b)[:, 1:, None],
            skew(a[:, 1:] + b[:, 1:]),
        ],
        axis=2,
    )
    V = np.linalg.svd(np.concatenate([top, low], axis=1).reshape(-1, 8))[2]
    (u1, v1), (u2, v2) = (np.split(v, 2) for v in V[-2:])
    # q = l1 [u1 v1] + l2 [u2 v2] with |q| = 1 and no scalar part of q conj(q'): a square of s =
    # l1 / l2
    s = np.roots([u1 @ v1, u1 @ v2 + u2 @ v1, u2 @ v2]).real
    value = [r * r * (u1 @ u1) + 2 * r * (u1 @ u2) + u2 @ u2 for r in s]
    best = int(np.argmax(value))
    l2 = np.sqrt(1 / value[best])
    q, qd = s[best] * l2 * u1 + l2 * u2, s[best] * l2 * v1 + l2 * v2
    X = np.eye(4)
    X[:3, :3] = Rotation.from_quat(q, scalar_first=True).as_matrix()
    conjugate = q * [1, -1, -1, -1]
    X[:3, 3] = 2 * (_product(qd[None], left=True)[0] @ conjugate)[1:]
    return X


METHODS: dict[str, Callable[[Array, Array], Array]] = {
    "tsai": tsai,
    "park": park,
    "horaud": horaud,
    "andreff": andreff,
    "daniilidis": daniilidis,
}


def _quaternions(M: Array) -> Array:
    """Unit quaternions (n, 4), w first and not negative, of poses (n, 4, 4)."""
    return Rotation.from_matrix(M[:, :3, :3]).as_quat(canonical=True, scalar_first=True)


def _product(q: Array, left: bool) -> Array:
    """Matrices (n, 4, 4) of quaternions q (n, 4): p -> q p where `left`, else p -> p q."""
    w, v = q[:, 0, None, None], q[:, 1:]
    M = np.zeros((len(q), 4, 4))
    M[:, 0, 1:], M[:, 1:, 0] = -v, v
    M[:, 1:, 1:] = skew(v) if left else -skew(v)
    return M + w * np.eye(4)


def _dual(M: Array) -> tuple[Array, Array]:
    """Real and dual part (n, 4) of the dual quaternions of poses: q' = t q / 2."""
    q = _quaternions(M)
    t = np.concatenate([np.zeros((len(M), 1)), M[:, :3, 3]], axis=1)
    return q, 0.5 * (_product(t, left=True) @ q[..., None])[..., 0]


def _nearest(M: Array) -> Array:
    """The rotation nearest to a matrix (3, 3)."""
    U, _, Vt = np.linalg.svd(M)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt


@dataclass(frozen=True)
class HandEye:
    """What a hand-eye calibration found.

    X: T_flange_camera in hand, T_base_camera in the room (4, 4). fixed: what does not move,
    T_base_board or T_flange_board (4, 4).
    sigma: standard deviations of X by the bundle adjustment: of its place along its own axes (3,)
    [m], of its rotation about them (3,) [rad].
    methods: X by each closed form. rms_px: of all corners, by each view's pose from X.
    """

    X: Array
    fixed: Array
    sigma: tuple[Array, Array]
    methods: dict[str, Array]
    rms_px: float


def _exp(d: Array) -> Array:
    """Poses (n, 4, 4) of small displacements (n, 6): translation and rotation vector."""
    T = np.tile(np.eye(4), (len(d), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = Rotation.from_rotvec(d[:, 3:]).as_matrix(), d[:, :3]
    return T


def chained(X: Array, fixed: Array, G: Array, in_hand: bool) -> Array:
    """T_camera_board (n, 4, 4) of flange poses G (n, 4, 4)."""
    return np.linalg.inv(G @ X) @ fixed if in_hand else inverse(X) @ G @ fixed


def calibrate(
    views: Sequence[View],
    camera: Camera,
    in_hand: bool = True,
    pixel_sigma: float = 0.1,
    joint_sigma: float = 1e-4,
) -> HandEye:
    """The camera's pose by all five closed forms, and by a bundle adjustment from the best of them:
    least squares of the corners' errors over `pixel_sigma`, X, what does not move, and the errors
    of each view's joints over `joint_sigma` [rad].

    Raises ParameterError: too few views, or views that all turn about the same axis.
    """
    if len(views) < LEAST_VIEWS:
        raise ParameterError.count(
            "views", f"{LEAST_VIEWS} or more", "pictures in which the board is seen", len(views)
        )
    spread, axes = turns(views)
    if spread[1] < PARALLEL_DEG:
        axis = np.round(axes[2], 2).tolist()
        words = (
            f"turn about one axis of the flange alone, {axis}: the place along it is not known;"
            " turn about another one by 20 degrees"
        )
        raise ParameterError("views", words)
    A, B = motions(views, in_hand)
    methods = {name: method(A, B) for name, method in METHODS.items()}
    G, bundle = (
        np.array([v.T_base_flange for v in views]),
        _Bundle(views, camera, in_hand, pixel_sigma, joint_sigma),
    )
    starts = {
        name: (X, _fixed(X, views, in_hand)) for name, X in methods.items() if np.isfinite(X).all()
    }
    costs = {
        name: float((bundle.errors(chained(*start, G, in_hand)) ** 2).mean())
        for name, start in starts.items()
    }
    X, fixed = starts[min(costs, key=lambda name: costs[name])]
    return bundle.solve(X, fixed, methods)


def _fixed(X: Array, views: Sequence[View], in_hand: bool) -> Array:
    """What does not move, as the views see it on the mean."""
    found = np.array(
        [
            (v.T_base_flange if in_hand else inverse(v.T_base_flange)) @ X @ v.T_camera_board
            for v in views
        ]
    )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = (
        Rotation.from_matrix(found[:, :3, :3]).mean().as_matrix(),
        found[:, :3, 3].mean(axis=0),
    )
    return T


class _Bundle:
    """The residuals of a bundle adjustment, all views at once. Parameters: displacements of X and
    of `fixed` (6,) each in their own frames, then the errors of each view's joints.
    """

    def __init__(
        self,
        views: Sequence[View],
        camera: Camera,
        in_hand: bool,
        pixel_sigma: float,
        joint_sigma: float,
    ):
        self._camera, self._in_hand, self._pixel, self._joint = (
            camera,
            in_hand,
            pixel_sigma,
            joint_sigma,
        )
        self._G, self._J = (
            np.array([v.T_base_flange for v in views]),
            np.array([v.J for v in views]),
        )
        self._whose = np.concatenate([np.full(len(v.uv), i) for i, v in enumerate(views)])
        self._points, self._uv = (
            np.concatenate([v.points for v in views]),
            np.concatenate([v.uv for v in views]),
        )

    def errors(self, T_camera_board: Array) -> Array:
        """Errors of the corners (n, 2) [px] of poses (views, 4, 4); large where the lens does not
        see one.
        """
        T = T_camera_board[self._whose]
        uv = self._camera.project(np.einsum("nij,nj->ni", T[:, :3, :3], self._points) + T[:, :3, 3])
        return np.nan_to_num(uv - self._uv, nan=1e3)

    def solve(self, X: Array, fixed: Array, methods: dict[str, Array]) -> HandEye:
        """The least squares from a start."""
        n, k = len(self._G), self._J.shape[2]

        def parts(x: Array) -> tuple[Array, Array, Array]:
            d = _exp(x[:12].reshape(2, 6))
            return X @ d[0], fixed @ d[1], x[12:].reshape(n, k)

        def residuals(x: Array) -> Array:
            a, b, joints = parts(x)
            G = self._G @ _exp(np.einsum("nij,nj->ni", self._J, joints))
            return np.concatenate(
                [
                    (self.errors(chained(a, b, G, self._in_hand)) / self._pixel).ravel(),
                    x[12:] / self._joint,
                ]
            )

        found = least_squares(
            residuals,
            np.zeros(12 + n * k),
            jac_sparsity=self._pattern(n, k),
            x_scale="jac",
            method="trf",
            tr_solver="lsmr",
        )
        a, b, _ = parts(found.x)
        J = found.jac.toarray()
        cov = np.linalg.pinv(J.T @ J)[:6, :6]
        deviations = np.sqrt(np.maximum(np.diag(cov), 0))
        rms = float(np.sqrt((self.errors(chained(a, b, self._G, self._in_hand)) ** 2).mean()))
        return HandEye(a, b, (deviations[:3], deviations[3:]), methods, rms)

    def _pattern(self, n: int, k: int) -> Array:
        """Which residuals depend on which parameters."""
        rows = np.repeat(self._whose, 2)
        S = np.zeros((len(rows) + n * k, 12 + n * k), dtype=int)
        S[: len(rows), :12] = 1
        for i in range(n):
            S[np.flatnonzero(rows == i)[:, None], 12 + i * k + np.arange(k)] = 1
        S[len(rows) + np.arange(n * k), 12 + np.arange(n * k)] = 1
        return S


def turns(views: Sequence[View]) -> tuple[Array, Array]:
    """By how much the flange turns from view to view: the RMS of all pairs about three axes across
    each other, least first (3,) [deg], and these axes in the flange's frame (3, 3), one a row.
    """
    A, _ = motions(views, True)
    w = Rotation.from_matrix(A[:, :3, :3]).as_rotvec()
    values, axes = np.linalg.eigh(w.T @ w / len(w))
    return np.degrees(np.sqrt(np.maximum(values, 0))), axes.T


def held_out(
    views: Sequence[View],
    camera: Camera,
    in_hand: bool,
    pixel_sigma: float,
    joint_sigma: float,
    parts: int = 5,
) -> Array:
    """Each view predicted by a calibration of the others: its corners' RMS error [px], and the
    board's place [m] and turn [rad] against what the view itself says, (views, 3); NaN where the
    others are too few.
    """
    found = np.full((len(views), 3), np.nan)
    for part in range(min(parts, len(views))):
        out = np.arange(len(views)) % min(parts, len(views)) == part
        kept = [v for v, gone in zip(views, out, strict=True) if not gone]
        try:
            made = calibrate(kept, camera, in_hand, pixel_sigma, joint_sigma)
        except ParameterError:
            continue
        for i in np.flatnonzero(out).tolist():
            v = views[i]
            T = chained(made.X, made.fixed, v.T_base_flange[None], in_hand)[0]
            uv = camera.project(v.points @ T[:3, :3].T + T[:3, 3])
            found[i] = np.sqrt(((uv - v.uv) ** 2).mean()), *rigid_error(T, v.T_camera_board)
    return found


def joint_jacobian(pose: Callable[[Array], Array], q: Array) -> Array:
    """The flange's twist in its own frame (6, n) by the speed of each joint, of its pose by joints
    q (n,): central differences.
    """
    J, T, step = np.zeros((6, len(q))), inverse(pose(q)), 1e-6
    for i in range(len(q)):
        ends = [T @ pose(q + side * step * np.eye(len(q))[i]) for side in (1, -1)]
        J[:3, i] = (ends[0][:3, 3] - ends[1][:3, 3]) / (2 * step)
        J[3:, i] = Rotation.from_matrix(ends[0][:3, :3] @ ends[1][:3, :3].T).as_rotvec() / (
            2 * step
        )
    return J


def seen_from(points: Array, uv: Array, camera: Camera) -> Array:
    """T_camera_board (4, 4) of a board's corners in one picture. Raises ParameterError: they
    determine no pose.
    """
    if (T := solve_pose(camera.normalise(uv), points)) is None:
        raise ParameterError(
            "points",
            "determine no pose of the board in a picture: they lie on a line, or behind the camera",
        )
    return T
