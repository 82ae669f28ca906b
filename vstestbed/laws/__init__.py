"""Control laws: what the camera saw, in; a velocity, out. A law never touches a simulator."""

from vstestbed.core.spec import OneOf
from vstestbed.laws.base import LAW_CONTRACT, Command, Law, LawBase
from vstestbed.laws.hybrid import Hybrid
from vstestbed.laws.ibvs import IBVS
from vstestbed.laws.line_following import LineFollowing
from vstestbed.laws.partitioned import Partitioned
from vstestbed.laws.pbvs import PBVS
from vstestbed.laws.policy import Policy
from vstestbed.laws.pose_controller import PoseController
from vstestbed.laws.pursuit import Pursuit
from vstestbed.laws.uncalibrated import Uncalibrated

LAWS = OneOf("law", IBVS, Partitioned, PBVS, Hybrid, Uncalibrated, PoseController, Pursuit, LineFollowing, Policy, contract=LAW_CONTRACT)

__all__ = [
    "IBVS",
    "LAWS",
    "PBVS",
    "Command",
    "Hybrid",
    "Law",
    "LawBase",
    "LineFollowing",
    "Partitioned",
    "Policy",
    "PoseController",
    "Pursuit",
    "Uncalibrated",
]
