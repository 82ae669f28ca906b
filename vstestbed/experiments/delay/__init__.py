"""Gain limit over delay: the gain at which the visual servo loop becomes unstable, measured and in theory."""

from vstestbed.experiments.delay.folder import write
from vstestbed.experiments.delay.lag import Lag
from vstestbed.experiments.delay.measure import Limit, find_limits

__all__ = ["Lag", "Limit", "find_limits", "write"]
