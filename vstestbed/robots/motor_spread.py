"""Motors and rotors of a quadrotor that are not alike."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Le, Len

from vstestbed.core.spec import spec
from vstestbed.robots.rotors import Four, QuadrotorParameters

Factors = Annotated[tuple[Annotated[float, Ge(0.2), Le(2)], ...], Len(4, 4)]
MOST_SIGMAS = 3.0
"""A drawn factor is off by at most so many standard deviations."""


@spec
class MotorSpread:
    """Rotors off from one another: thrust b f_i w^2, and a largest w^2 of l_i times the limit; the flight loops take them as alike.

    At hover the weaker rotor of a pair turns faster, f_front w_front^2 = f_back w_back^2, and both pairs have the same sum of w^2, as
    their drag torques cancel; the flight loops find this trim by their integrals in the first seconds. A motor that saturates early
    leaves less torque about one axis. Factors are drawn from the run's seed unless they are listed. The default sigmas are chosen.

    Args:
        thrust_sigma: standard deviation of a rotor's thrust coefficient, as a share of it [1].
        limit_sigma: standard deviation of what is missing of a motor's limit of w^2, as a share of it; no limit is higher [1].
        thrust: the four factors f of front, right, back and left [1]; none draws them; e.g. `[1.03, 1, 0.98, 1]`.
        limit: the four factors l [1]; none draws them; e.g. `[1, 0.95, 1, 1]`.
    """

    thrust_sigma: Annotated[float, Ge(0), Le(0.2)] = 0.01
    limit_sigma: Annotated[float, Ge(0), Le(0.2)] = 0.01
    thrust: Factors | None = None
    limit: Factors | None = None

    @property
    def draws(self) -> bool:
        """Whether factors are drawn."""
        return (self.thrust is None and self.thrust_sigma > 0) or (self.limit is None and self.limit_sigma > 0)

    def drawn(self, rng: np.random.Generator) -> tuple[Four, Four]:
        """The factors f and l (4,) of a run."""
        off = np.clip(rng.standard_normal((2, 4)), -MOST_SIGMAS, MOST_SIGMAS)
        f = 1.0 + self.thrust_sigma * off[0] if self.thrust is None else np.array(self.thrust)
        limit = 1.0 - self.limit_sigma * np.abs(off[1]) if self.limit is None else np.array(self.limit)
        return _four(f), _four(limit)


def hover_squares(thrust: Four, craft: QuadrotorParameters) -> Four:
    """W (4,) of front, right, back and left at which rotors of these factors f (4,) hold the craft without torque about any axis.

    f_front W_front = f_back W_back, f_right W_right = f_left W_left, W_front + W_back = W_right + W_left = 2 S: with the harmonic means h
    of each pair's factors, S = 2 W_hover / (h_1 + h_2).
    """
    front, right, back, left = thrust
    one, other = 2 * front * back / (front + back), 2 * right * left / (right + left)
    double = 4 * craft.hover / (one + other)
    return (
        double * back / (front + back),
        double * left / (right + left),
        double * front / (front + back),
        double * right / (right + left),
    )


def _four(values: np.ndarray) -> Four:
    a, b, c, d = values.tolist()
    return a, b, c, d
