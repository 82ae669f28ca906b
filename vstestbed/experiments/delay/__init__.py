"""Delay: the gain at which a visual servo goes unstable, measured beside what theory says."""

from vstestbed.experiments.delay.folder import write
from vstestbed.experiments.delay.lag import Lag
from vstestbed.experiments.delay.measure import Limit, find_limits

__all__ = ["Lag", "Limit", "find_limits", "write"]
