"""Control laws: what the camera saw, in; a velocity, out. A law never touches a simulator."""

from vstestbed.laws.base import LAW_CONTRACT, Command, Law, LawBase
from vstestbed.laws.error_law import ErrorLaw
from vstestbed.laws.hybrid import Hybrid
from vstestbed.laws.ibvs import IBVS
from vstestbed.laws.line_following import LineFollowing
from vstestbed.laws.partitioned import Partitioned
from vstestbed.laws.pbvs import PBVS
from vstestbed.laws.photometric import Photometric
from vstestbed.laws.policy import Policy
from vstestbed.laws.pose_controller import PoseController
from vstestbed.laws.predictive import Predictive
from vstestbed.laws.pursuit import Pursuit
from vstestbed.laws.qp import QP
from vstestbed.laws.switched import LAWS, Switched
from vstestbed.laws.uncalibrated import Uncalibrated

LAWS.add(Switched)

__all__ = [
    "IBVS",
    "LAWS",
    "LAW_CONTRACT",
    "PBVS",
    "QP",
    "Command",
    "ErrorLaw",
    "Hybrid",
    "Law",
    "LawBase",
    "LineFollowing",
    "Partitioned",
    "Photometric",
    "Policy",
    "PoseController",
    "Predictive",
    "Pursuit",
    "Switched",
    "Uncalibrated",
]
