"""Delay: the gain at which a visual servo goes unstable, measured beside what theory says."""

from vstestbed.delay.folder import write
from vstestbed.delay.lag import Lag
from vstestbed.delay.measure import Limit, find_limits

__all__ = ["Lag", "Limit", "find_limits", "write"]
