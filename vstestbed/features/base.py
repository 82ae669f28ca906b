"""The contract of a feature: three functions of leading axes, no state."""

from __future__ import annotations

from typing import Protocol

from vstestbed.geometry import Array


class Feature(Protocol):
    """A feature s(x) of N image points, with s_dot = L v for a still target and v the camera's twist in its own frame."""

    @property
    def kind(self) -> str:
        """The feature's word in a scenario."""
        ...

    def measure(self, xy: Array) -> Array:
        """Feature vector s (..., k N) of normalised points xy (..., N, 2)."""
        ...

    def interaction(self, xy: Array, depth: Array) -> Array:
        """Interaction matrix L (..., k N, 6) at xy (..., N, 2) with depth (..., N) [m]."""
        ...

    def error(self, s: Array, s_star: Array) -> Array:
        """Error e (..., k N): s - s*, angles wrapped where the feature has them."""
        ...
