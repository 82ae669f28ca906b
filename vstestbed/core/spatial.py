"""Poses and twists as the field writes them in Python: spatialmath's SE3, SE2 and Twist3, in and
out.

Spatialmath takes .8 s to import. What is given is recognised by its class, which the caller has
imported; what is returned imports it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError

if TYPE_CHECKING:
    from spatialmath import SE3, Twist3

Array = NDArray[np.float64]
# largest entry of R^T R - I of a rotation: one that is written with six digits has some 1e-6
RIGID = 1e-6
LEVEL = 1e-9  # largest height [m] and tilt [rad] on the floor


def class_of(value: object) -> str:
    """The name of the spatialmath class of a value; "" where it is of none."""
    return type(value).__name__ if type(value).__module__.partition(".")[0] == "spatialmath" else ""


def is_matrix(value: object) -> bool:
    """Whether a value stands for a pose or a place as a matrix: an array, or an object of
    spatialmath.
    """
    return isinstance(value, np.ndarray) or class_of(value) != ""


def pose_matrix(value: Any, name: str = "") -> Array:
    """The homogeneous matrix (4, 4) of an SE3 of one pose, or of an array that is one. name: the
    parameter's, for messages.
    Raises ParameterError: several poses, a place in the plane (SE2), a rotation alone, a matrix
    that is no rigid motion.
    """
    kind = class_of(value)
    if kind == "SE2":
        words = (
            "is a place in the plane (SE2), and here a pose in space belongs;"
            " its SE3() lifts it to height 0"
        )
        raise ParameterError(name, words)
    if kind not in ("", "SE3"):
        words = (
            f"must be a pose (SE3), got {_a(kind)}; SE3.Rt(R, [x, y, z]) has a rotation and a place"
        )
        raise ParameterError(name, words)
    return _rigid(value, 4, "a pose: an SE3, or a homogeneous matrix (4, 4)", name)


def floor_place(value: Any, name: str = "") -> tuple[float, float, float]:
    """Place and heading (x [m], y [m], heading [deg]) of an SE2 (or its (3, 3)), or of an SE3 (or
    its (4, 4)) that stands on the floor.
    Raises ParameterError: several places, a pose off the floor, a matrix that is no rigid motion.
    """
    if class_of(value) == "SE2" or (np.shape(value) == (3, 3) and not class_of(value)):
        T = _rigid(value, 3, "a place: an SE2, or a homogeneous matrix (3, 3)", name)
        return tidy(T[0, 2], 15), tidy(T[1, 2], 15), heading_of(T)
    (x, y, z), heading = upright(value, name)
    if abs(z) > LEVEL:
        raise ParameterError.fixed(name, "at height 0", f"z = {z:.3g} m", where="on the floor")
    return x, y, heading


def heading_of(T: Array) -> float:
    """The heading [deg] of the x axis of a matrix (3, 3) or (4, 4), without the last digits of
    rounding.
    """
    return tidy(math.degrees(math.atan2(T[1, 0], T[0, 0])), 12)


def upright(value: Any, name: str = "") -> tuple[list[float], float]:
    """Position [m] and heading [deg] of a pose whose z axis points up. Raises ParameterError: it is
    tilted; see `pose_matrix`.
    """
    T = pose_matrix(value, name)
    if max(abs(T[0, 2]), abs(T[1, 2])) > LEVEL or T[2, 2] < 0:
        axis = T[:3, 2].round(3).tolist()
        words = (
            "must be upright, turned about the world's z axis alone;"
            f" the z axis of this pose is {axis}"
        )
        raise ParameterError(name, words)
    return tidy_position(T), heading_of(T)


def tidy_position(T: Array) -> list[float]:
    """The translation of a pose (4, 4) [m] without the last digits of rounding, which nobody wants
    to read in YAML.
    """
    return [tidy(x, 15) for x in T[:3, 3].tolist()]


def twist_numbers(value: Any, name: str = "command") -> Any:
    """The numbers (6,) of a Twist3, S = (v, w); any other value as it is. ParameterError for
    several twists, or another object.
    """
    kind = class_of(value)
    if not kind:
        return value
    if kind != "Twist3":
        raise ParameterError(name, f"must be a twist (Twist3) or numbers, got {_a(kind)}")
    if len(value) != 1:
        why = "take one of them, as twists[0]"
        raise ParameterError.count(name, "one", "twist", len(value), why=why)
    return np.asarray(value.S, dtype=float)


def as_se3(T: Array) -> SE3:
    """Poses (n, 4, 4) as one spatialmath object of n poses."""
    from spatialmath import SE3

    return SE3(list(T), check=False) if len(T) else SE3.Empty()


def as_twist3(S: Array) -> Twist3:
    """Twists (n, 6) in the order (v, w) as one spatialmath object of n twists."""
    from spatialmath import Twist3

    return Twist3(list(S), check=False) if len(S) else Twist3.Empty()


def _one(value: Any, size: int, wanted: str, name: str) -> Array:
    kind = class_of(value)
    if kind and len(value) != 1:
        why = "take one of them, as poses[0]"
        raise ParameterError.count(name, "one", "pose", len(value), why=why)
    try:
        T = np.array(value.A if kind else value, dtype=float)
    except (TypeError, ValueError):
        T = np.zeros(0)
    if T.shape != (size, size):
        words = f"must be {wanted}, got {type(value).__name__}"
        if T.size:
            words += f" of shape {T.shape}"
        raise ParameterError(name, words)
    return T


def _rigid(value: Any, size: int, wanted: str, name: str) -> Array:
    """The matrix (size, size) of a rigid motion that a value is. wanted: what it must be."""
    T = _one(value, size, wanted, name)
    n = size - 1
    if not np.isfinite(T).all():
        raise ParameterError.infinite(name, "a pose with other numbers")
    off = float(np.abs(T[:n, :n].T @ T[:n, :n] - np.eye(n)).max())
    if off > RIGID:
        words = (
            f"is no rigid motion: its axes are not perpendicular unit vectors (off by {off:.2g});"
            f" SE{n}.norm() makes them so"
        )
        raise ParameterError(name, words)
    if np.linalg.det(T[:n, :n]) < 0:
        words = "is no rigid motion: it mirrors (its axes are left-handed); reverse one of them"
        raise ParameterError(name, words)
    if np.abs(T[n] - np.eye(size)[n]).max() > LEVEL:
        words = f"must end with the row {'0 ' * n}1; perhaps it is the transpose of a pose"
        raise ParameterError(name, words)
    return T


def tidy(x: float, digits: int) -> float:
    """A number without the last digits of rounding: with 12 digits 90 for 90.00000000000001
    degrees, which moves a pose less than 1e-14.
    """
    return round(float(x), digits) + 0.0  # -0.0 becomes 0.0


def _a(kind: str) -> str:
    return f"an {kind}" if kind[0] in "SAEIO" else f"a {kind}"
