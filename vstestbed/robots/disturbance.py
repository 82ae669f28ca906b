"""What acts on a robot beside its actuators as its file has them: the contract between a robot's imperfections and the simulator.

The simulator gives the truth of the body, a `Disturbance` gives forces, what becomes of the orders to the actuators, and what the
sensors meet. The robot's own controller knows none of it. Plain floats: it is computed at the rate of the onboard controller.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

Vector = tuple[float, float, float]


class BodyState(NamedTuple):
    """The truth of a robot's base at one instant.

    Attributes:
        air: velocity of its origin against the air, base axes (3,) [m/s]. rates: angular velocity, base axes (3,) [rad/s].
        act: activations of its actuators (nu,).
        below: how far straight below each of the disturbance's `probes` something is, inf over nothing [m].
    """

    air: Vector
    rates: Vector
    act: Sequence[float]
    below: Sequence[float]


class Effort(NamedTuple):
    """What a disturbance does for one control period.

    Attributes:
        force, torque: on the base, about its origin, base axes (3,) [N, Nm]. orders: what reaches the actuators (nu,).
    """

    force: Vector
    torque: Vector
    orders: Sequence[float]


class Disturbance(Protocol):
    """The imperfections of one robot in one run; it has a memory.

    Attributes:
        probes: points in the base frame (k, 3) [m] below which the simulator measures the free height; () for none.
    """

    probes: Sequence[Vector]

    def act(self, state: BodyState, orders: Sequence[float], dt: float) -> Effort:
        """Force, torque and orders for the next control period of dt [s]; orders: of the robot's controller (nu,)."""
        ...

    def felt(self, sensors: dict[str, list[float]]) -> dict[str, list[float]]:
        """What the robot's sensors meet: the perfect readings by name, with what the disturbance adds to them. Once an instant."""
        ...
