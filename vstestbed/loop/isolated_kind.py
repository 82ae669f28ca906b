"""The plugin that adds the law `isolated`, which is there for judges alone: it is none of the words
of a scenario.
"""

from vstestbed.laws import LAWS
from vstestbed.loop.isolated import Isolated

LAWS.add(Isolated)
