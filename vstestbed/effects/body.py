"""What other physical parameters change in a robot's MJCF file, as plain data; `sim/scene/attach.py` applies it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Factors = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Set:
    """Sets a field of one element; of an array field the first `len(value)` entries.

    kind: of the element (`body`, `geom`, ...). name, field: as MuJoCo's MjSpec calls them. value: in the unit of the file.
    """

    kind: Literal["body", "geom", "joint", "site", "actuator"]
    name: str
    field: str
    value: float | tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Scale:
    """Multiplies a field of all elements of a kind, of the geoms or joints of one body, or of one body or actuator.

    kind, field: as in `Set`. factor: of all entries, or one for each of the first. of: the body, or the actuator; "" for all.
    """

    kind: Literal["body", "geom", "joint", "actuator"]
    field: str
    factor: float | tuple[float, ...]
    of: str = ""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Stretches the geoms of a body about its origin, p -> factors p + shift: places, sizes of boxes, vertices of meshes, no radii.

    body: its name. factors: along x, y, z. shift: along x, y, z [m].
    """

    body: str
    factors: Factors
    shift: Factors = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Couple:
    """Sets the polynomial by which one joint follows another (`equality/joint`).

    joint: the one that follows. coefficients: (5,), of powers 0 to 4.
    """

    joint: str
    coefficients: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Loosen:
    """Play between a joint and all that follow it: they follow a new joint `<joint>_output`, which is free within the play.

    joint: the one that moves them. width: of the play, from one end to the other [rad].
    """

    joint: str
    width: float


Change = Set | Scale | Stretch | Couple | Loosen
