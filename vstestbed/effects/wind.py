"""Wind: the air's motion, written into MuJoCo's medium as time passes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Len

from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositiveTime, Speed, Time, Velocity
from vstestbed.core.spec import spec
from vstestbed.effects.base import Actor, Effect, RobotBody

if TYPE_CHECKING:
    import mujoco


@spec
class Gust:
    """A gust that comes and goes: v(t) = velocity/2 (1 - cos(2 pi (t - from)/duration)), the
    discrete gust of flight testing.

    Args:
        from_s, duration_s: when it begins, and how long it lasts [s].
        velocity_mps: at its peak, along world axes [m/s].

    Reference: MIL-F-8785C 1980, section 3.7.1.3 (a whole period of it).
    """

    from_s: Time
    duration_s: PositiveTime = 3.0
    velocity_mps: Velocity = (5.0, 0.0, 0.0)

    def at(self, t: float) -> Array:
        """Its velocity (3,) at a time [s]."""
        share = (t - self.from_s) / self.duration_s
        if not 0 < share < 1:
            return np.zeros(3)
        return np.array(self.velocity_mps) * (0.5 - 0.5 * math.cos(2 * math.pi * share))


@spec
class Wind(Effect):
    """The air's motion: a mean, gusts, and turbulence as a first-order Gauss-Markov process on each
    axis.

    Args:
        mean_mps: along world axes [m/s].
        gusts: added to the mean while they last.
        turbulence_mps: standard deviation of the turbulence [m/s].
        turbulence_s: its correlation time [s]: L/V of Dryden's longitudinal spectrum.

    Reference: Dryden's spectra as in MIL-F-8785C 1980; a hovering craft meets the longitudinal one
    at V = 0 only by the mean wind.
    """

    mean_mps: Velocity = (0.0, 0.0, 0.0)
    gusts: Annotated[tuple[Gust, ...], Len(0, 100)] = ()
    turbulence_mps: Speed = 0.0
    turbulence_s: PositiveTime = 1.0

    @property
    def still(self) -> bool:
        """No wind at all."""
        return not (any(self.mean_mps) or self.gusts or self.turbulence_mps)

    def at(self, t: float) -> Array:
        """Mean and gusts (3,) at a time [s]."""
        return sum((gust.at(t) for gust in self.gusts), np.array(self.mean_mps))

    def actor(self, body: RobotBody, rng: np.random.Generator) -> Actor | None:
        """The moving air; None for still air."""
        return None if self.still else WindField(self, body.model, rng)


class WindField(Actor):
    """Mean and gusts by the clock, turbulence u with du = -u dt/T + sigma sqrt(2/T) dW, discretised
    exactly.

    wind: parameters. model: receives it as `opt.wind`. rng: generator of the turbulence.
    """

    with_controller = True

    def __init__(self, wind: Wind, model: mujoco.MjModel, rng: np.random.Generator):
        self._wind = wind
        self._model = model
        self._rng = rng
        # Drawn from the stationary distribution: started at 0, turbulence would take some
        # correlation times to reach its size.
        self._rough = np.zeros(3)
        if wind.turbulence_mps:
            self._rough = rng.standard_normal(3) * wind.turbulence_mps
        self.act(0.0, 0.0)

    def act(self, t: float, dt: float) -> None:
        """Set the wind at time t [s], dt [s] after the last call."""
        wind = self._wind
        if wind.turbulence_mps and dt > 0:
            keep = math.exp(-dt / wind.turbulence_s)
            fresh = wind.turbulence_mps * math.sqrt(1 - keep * keep)
            self._rough = keep * self._rough + fresh * self._rng.standard_normal(3)
        self._model.opt.wind[:] = wind.at(t) + self._rough
