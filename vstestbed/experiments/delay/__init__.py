"""Gain limit over delay: the gain at which the visual servo loop becomes unstable, measured and in theory."""

from vstestbed.studies.delay import Lag, Limit, find_limits, write

__all__ = ["Lag", "Limit", "find_limits", "write"]
