"""The laws that work alone; `switched`, which is made of them, joins them in the package."""

from __future__ import annotations

from vstestbed.core.spec import OneOf
from vstestbed.laws.base import LAW_CONTRACT
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
from vstestbed.laws.uncalibrated import Uncalibrated

LAWS = OneOf(
    "law",
    IBVS,
    Partitioned,
    PBVS,
    Hybrid,
    QP,
    Predictive,
    Uncalibrated,
    PoseController,
    Pursuit,
    LineFollowing,
    Photometric,
    Policy,
    contract=LAW_CONTRACT,
)
