"""The scenario's wind, written into MuJoCo's medium as time passes."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from vstestbed.sim.scene.world import Wind


class WindField:
    """Mean and gusts by the clock, turbulence u with du = -u dt/T + sigma sqrt(2/T) dW, discretised exactly.

    Args:
        wind: parameters. model: receives it as `opt.wind`. rng: generator of the turbulence.
    """

    def __init__(self, wind: Wind, model: mujoco.MjModel, rng: np.random.Generator):
        self._wind, self._model, self._rng = wind, model, rng
        # Drawn from the stationary distribution: started at 0, turbulence would take some correlation times to reach its size.
        self._rough = rng.standard_normal(3) * wind.turbulence_mps if wind.turbulence_mps else np.zeros(3)
        self.blow(0.0, 0.0)

    def blow(self, t: float, dt: float) -> None:
        """Set the wind at time t [s], dt [s] after the last call."""
        wind = self._wind
        if wind.turbulence_mps and dt > 0:
            keep = math.exp(-dt / wind.turbulence_s)
            fresh = wind.turbulence_mps * math.sqrt(1 - keep * keep)
            self._rough = keep * self._rough + fresh * self._rng.standard_normal(3)
        self._model.opt.wind[:] = wind.at(t) + self._rough
