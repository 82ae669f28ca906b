"""Control laws: what the camera saw, in; a velocity, out. A law never touches a simulator."""

from vstestbed.laws.base import Command, Law
from vstestbed.laws.ibvs import IBVS
from vstestbed.spec import OneOf

LAWS = OneOf("law", IBVS)

__all__ = ["IBVS", "LAWS", "Command", "Law"]
