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

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from vstestbed.camera import Camera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse, rigid_error, skew, transform
from vstestbed.vision.pnp import solve_pose

LEAST_VIEWS = 3
# RMS of the views' turns about some axis under which nothing is known about it [deg]
PARALLEL_DEG = 2.0
PARTS = 5  # of the views, each left out in its turn


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

    def errors(self, T_camera_board: Array, camera: Camera) -> Array:
        """By how much the corners (n, 2) are off those of a pose (4, 4) of the board [px]."""
        return camera.project(transform(T_camera_board, self.points)) - self.uv


def motions(views: Sequence[View], in_hand: bool) -> tuple[Array, Array]:
    """A and B (m, 4, 4) of all pairs of views."""
    G, T = _poses(views, in_hand)
    i, j = np.triu_indices(len(views), 1)
    return np.linalg.inv(G[j]) @ G[i], T[j] @ np.linalg.inv(T[i])


def _poses(views: Sequence[View], in_hand: bool) -> tuple[Array, Array]:
    """G and T (n, 4, 4) of the views."""
    flange = np.array([v.T_base_flange for v in views])
    return flange if in_hand else inverse(flange), np.array([v.T_camera_board for v in views])


def posed(R: Array, t: Array) -> Array:
    """The pose (4, 4) of a rotation and a place."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def _translation(R: Array, A: Array, B: Array) -> Array:
    """X (4, 4) of its rotation: (R_A - I) t = R t_B - t_A, by least squares."""
    C = (A[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    d = (B[:, :3, 3] @ R.T - A[:, :3, 3]).ravel()
    t: Array = np.asarray(np.linalg.lstsq(C, d, rcond=None)[0], dtype=float)
    return posed(R, t)


def tsai(A: Array, B: Array) -> Array:
    """Tsai & Lenz 1989, doi:10.1109/70.34770: P = 2 sin(angle/2) axis, skew(P_A + P_B) P' = P_B -
    P_A, P = 2 P' / sqrt(1 + P'^2).
    """
    pa = 2 * _quaternions(A)[:, 1:]
    pb = 2 * _quaternions(B)[:, 1:]
    p = np.linalg.lstsq(skew(pa + pb).reshape(-1, 3), (pb - pa).ravel(), rcond=None)[0]
    p = 2 * p / np.sqrt(1 + p @ p)
    R = (1 - p @ p / 2) * np.eye(3) + (np.outer(p, p) + np.sqrt(4 - p @ p) * skew(p)) / 2
    return _translation(R, A, B)


def park(A: Array, B: Array) -> Array:
    """Park & Martin 1994, doi:10.1109/70.326576: R = (M^T M)^-1/2 M^T, M = sum of log(R_B)
    log(R_A)^T.
    """
    a = Rotation.from_matrix(A[:, :3, :3]).as_rotvec()
    b = Rotation.from_matrix(B[:, :3, :3]).as_rotvec()
    return _translation(_nearest(a.T @ b), A, B)


def horaud(A: Array, B: Array) -> Array:
    """Horaud & Dornaika 1995, doi:10.1177/027836499501400301: the unit quaternion with the least
    |q_A q - q q_B|.
    """
    D = _product(_quaternions(A), left=True) - _product(_quaternions(B), left=False)
    q = np.linalg.eigh(np.einsum("nij,nik->jk", D, D))[1][:, 0]
    return _translation(Rotation.from_quat(q, scalar_first=True).as_matrix(), A, B)


def andreff(A: Array, B: Array) -> Array:
    """Andreff, Horaud & Espiau 1999, doi:10.1109/IM.1999.805374: linear in R and t at once, by
    Kronecker products; R the nearest rotation.
    """
    C = []
    d = []
    for a, b in zip(A, B, strict=True):
        R = a[:3, :3]
        of_rotation = [np.eye(9) - np.kron(R, b[:3, :3]), np.zeros((9, 3))]
        of_place = [np.kron(np.eye(3), b[:3, 3]), np.eye(3) - R]
        C.append(np.block([of_rotation, of_place]))
        d += [np.zeros(9), a[:3, 3]]
    x = np.linalg.lstsq(np.vstack(C), np.concatenate(d), rcond=None)[0]
    return posed(_nearest(x[:9].reshape(3, 3)), x[9:])


def daniilidis(A: Array, B: Array) -> Array:
    """Daniilidis 1999, doi:10.1177/02783649922066213: unit dual quaternions, rotation and
    translation at once.
    """
    a, ad = _dual(A)
    b, bd = _dual(B)

    def rows(p: Array, q: Array) -> Array:
        return np.concatenate([(p - q)[:, 1:, None], skew((p + q)[:, 1:])], axis=2)

    S = np.block([[rows(a, b), np.zeros((len(A), 3, 4))], [rows(ad, bd), rows(a, b)]])
    x1, x2 = np.linalg.svd(S.reshape(-1, 8))[2][-2:]
    (u1, v1), (u2, v2) = np.split(x1, 2), np.split(x2, 2)
    # (q, q') = l (s x1 + x2) with |q| = 1 and no scalar part of q conj(q'): a square equation of s
    roots = np.roots([u1 @ v1, u1 @ v2 + u2 @ v1, u2 @ v2]).real
    s = max(roots, key=lambda s: np.linalg.norm(s * u1 + u2))
    q, qd = np.split((s * x1 + x2) / np.linalg.norm(s * u1 + u2), 2)
    t = 2 * (_product(qd[None], left=True)[0] @ (q * [1, -1, -1, -1]))[1:]
    return posed(Rotation.from_quat(q, scalar_first=True).as_matrix(), t)


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
    v = q[:, 1:]
    M = np.zeros((len(q), 4, 4))
    M[:, 0, 1:] = -v
    M[:, 1:, 0] = v
    M[:, 1:, 1:] = skew(v) if left else -skew(v)
    return M + q[:, 0, None, None] * np.eye(4)


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
    """What a hand-eye calibration found, in hand or in the room.

    X: T_flange_camera in hand, T_base_camera in the room (4, 4). fixed: what does not move,
    T_base_board or T_flange_board (4, 4).
    sigma: standard deviations of X by the bundle adjustment: of its place along its own axes (3,)
    [m], of its rotation about them (3,) [rad].
    methods: X by each closed form. rms_px: of all corners, by each view's pose from X.
    """

    in_hand: bool
    X: Array
    fixed: Array
    sigma: tuple[Array, Array]
    methods: dict[str, Array]
    rms_px: float

    @property
    def poses(self) -> dict[str, Array]:
        """X by each method, the bundle adjustment's first."""
        return {"bundle adjustment": self.X, **self.methods}

    def off(self, true: Array) -> dict[str, tuple[float, float]]:
        """By how much each of `poses` is off the true one [mm, deg]."""
        errors = {name: rigid_error(X, true) for name, X in self.poses.items()}
        return {name: (1e3 * d, math.degrees(a)) for name, (d, a) in errors.items()}

    def board_in(self, view: View) -> Array:
        """T_camera_board (4, 4) of a view, by X and the flange's pose."""
        return chained(self.X, self.fixed, view.T_base_flange, self.in_hand)


def _exp(d: Array) -> Array:
    """Poses (n, 4, 4) of small displacements (n, 6): translation and rotation vector."""
    T = np.tile(np.eye(4), (len(d), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(d[:, 3:]).as_matrix()
    T[:, :3, 3] = d[:, :3]
    return T


def chained(X: Array, fixed: Array, G: Array, in_hand: bool) -> Array:
    """T_camera_board (..., 4, 4) of flange poses G (..., 4, 4)."""
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
    bundle = _Bundle(views, camera, in_hand, pixel_sigma, joint_sigma)
    starts = [(X, _fixed(X, views, in_hand)) for X in methods.values() if np.isfinite(X).all()]
    X, fixed = min(starts, key=lambda start: bundle.rms_px(*start))
    return bundle.solve(X, fixed, methods)


def _fixed(X: Array, views: Sequence[View], in_hand: bool) -> Array:
    """What does not move, as the views see it on the mean."""
    G, T = _poses(views, in_hand)
    found = G @ X @ T
    R = Rotation.from_matrix(found[:, :3, :3]).mean().as_matrix()
    return posed(R, found[:, :3, 3].mean(axis=0))


@dataclass
class _Bundle:
    """The residuals of a bundle adjustment, all views at once. Parameters: displacements of X and
    of `fixed` (6,) each in their own frames, then the errors of each view's joints.
    """

    views: Sequence[View]
    camera: Camera
    in_hand: bool
    pixel_sigma: float
    joint_sigma: float

    def __post_init__(self) -> None:
        self._G = np.array([v.T_base_flange for v in self.views])
        self._J = np.array([v.J for v in self.views])
        self._points = np.concatenate([v.points for v in self.views])
        self._uv = np.concatenate([v.uv for v in self.views])
        corners = [len(v.uv) for v in self.views]
        self._whose = np.repeat(np.arange(len(corners)), corners)

    def errors(self, X: Array, fixed: Array, G: Array) -> Array:
        """Errors of the corners (n, 2) [px], by flange poses G; large where the lens does not see
        one.
        """
        T = chained(X, fixed, G, self.in_hand)[self._whose]
        uv = self.camera.project(transform(T, self._points[:, None])[:, 0])
        return np.nan_to_num(uv - self._uv, nan=1e3)

    def rms_px(self, X: Array, fixed: Array) -> float:
        """The RMS of all errors by the flange poses as they were read."""
        return float(np.sqrt((self.errors(X, fixed, self._G) ** 2).mean()))

    def solve(self, X: Array, fixed: Array, methods: dict[str, Array]) -> HandEye:
        """The least squares from a start."""
        n, _, k = self._J.shape

        def moved(x: Array) -> tuple[Array, Array]:
            of_X, of_fixed = _exp(x[:12].reshape(2, 6))
            return X @ of_X, fixed @ of_fixed

        def residuals(x: Array) -> Array:
            flange = np.einsum("nij,nj->ni", self._J, x[12:].reshape(n, k))
            errors = self.errors(*moved(x), self._G @ _exp(flange))
            return np.concatenate([errors.ravel() / self.pixel_sigma, x[12:] / self.joint_sigma])

        found = least_squares(
            residuals,
            np.zeros(12 + n * k),
            jac_sparsity=self._pattern(n, k),
            x_scale="jac",
            method="trf",
            tr_solver="lsmr",
        )
        J = found.jac.toarray()
        cov = np.linalg.pinv(J.T @ J)[:6, :6]
        place, turn = np.split(np.sqrt(np.maximum(np.diag(cov), 0)), 2)
        a, b = moved(found.x)
        return HandEye(self.in_hand, a, b, (place, turn), methods, self.rms_px(a, b))

    def _pattern(self, n: int, k: int) -> Array:
        """Which residuals depend on which parameters."""
        of_corner = np.repeat(np.eye(n, dtype=int)[self._whose], k, axis=1)
        corners = np.hstack([np.ones((len(of_corner), 12), dtype=int), of_corner])
        joints = np.eye(n * k, 12 + n * k, 12, dtype=int)
        return np.vstack([np.repeat(corners, 2, axis=0), joints])


def turns(views: Sequence[View]) -> tuple[Array, Array]:
    """By how much the flange turns from view to view: the RMS of all pairs about three axes across
    each other, least first (3,) [deg], and these axes in the flange's frame (3, 3), one a row.
    """
    A, _ = motions(views, True)
    w = Rotation.from_matrix(A[:, :3, :3]).as_rotvec()
    values, axes = np.linalg.eigh(w.T @ w / len(w))
    return np.degrees(np.sqrt(np.maximum(values, 0))), axes.T


def held_out(
    views: Sequence[View], camera: Camera, in_hand: bool, pixel_sigma: float, joint_sigma: float
) -> Array:
    """Each view predicted by a calibration of the others: its corners' RMS error [px], and the
    board's place [m] and turn [rad] against what the view itself says, (views, 3); NaN where the
    others are too few.
    """
    found = np.full((len(views), 3), np.nan)
    for part in range(min(PARTS, len(views))):
        kept = [v for i, v in enumerate(views) if i % PARTS != part]
        try:
            made = calibrate(kept, camera, in_hand, pixel_sigma, joint_sigma)
        except ParameterError:
            continue
        for i in range(part, len(views), PARTS):
            v = views[i]
            T = made.board_in(v)
            rms = np.sqrt((v.errors(T, camera) ** 2).mean())
            found[i] = rms, *rigid_error(T, v.T_camera_board)
    return found


def joint_jacobian(pose: Callable[[Array], Array], q: Array) -> Array:
    """The flange's twist in its own frame (6, n) by the speed of each joint, of its pose by joints
    q (n,): central differences.
    """
    h = 1e-6
    T = inverse(pose(q))
    J = np.zeros((6, len(q)))
    for i, step in enumerate(h * np.eye(len(q))):
        ahead = T @ pose(q + step)
        behind = T @ pose(q - step)
        J[:3, i] = ahead[:3, 3] - behind[:3, 3]
        J[3:, i] = Rotation.from_matrix(ahead[:3, :3] @ behind[:3, :3].T).as_rotvec()
    return J / (2 * h)


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
