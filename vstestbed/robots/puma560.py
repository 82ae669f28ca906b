"""Puma 560: its joint chain, limits and servos.

The base frame stands on the floor; the flange is the wrist's centre. Dynamics, gears and friction
are in `models/puma560.xml`.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.effects.joints import CurrentLoops, Encoders, Gears, Ripple
from vstestbed.effects.links import GeometryError
from vstestbed.robots.allocation import Actuation
from vstestbed.robots.arm import Arm, ArmStart, Positions
from vstestbed.robots.chain import JointChain
from vstestbed.robots.realism import Presets

JOINT_LIMITS = np.radians(
    [[-160, 160], [-45, 225], [-225, 45], [-110, 170], [-100, 100], [-266, 266]]
)
"""[rad], (6, 2). Source: Corke's Robotics Toolbox, model puma560."""
SPEED_LIMITS = np.array([1.92, 1.51, 2.40, 5.34, 5.09, 5.74])
"""[rad/s]. Source: Corke 1996, Visual Control of Robots, Table 2.21: where the amplifiers' voltage
saturates.
"""
SHOULDER, UPPER_ARM, OFFSET, ELBOW, FOREARM = 0.67183, 0.4318, 0.15005, 0.0203, 0.4318
"""d_1 (the shoulder's height over the floor, 26.45 inch, as in Corke's Robotics Toolbox), a_2, d_3,
a_3 and d_4 of the standard Denavit-Hartenberg table [m]. Reference: Corke & Armstrong-Helouvry
1994, doi:10.1109/ROBOT.1994.351360.
"""
_WRIST = UPPER_ARM + ELBOW, -OFFSET, SHOULDER + FOREARM

CHAIN = JointChain(
    names=tuple(f"joint_{i}" for i in range(1, 7)),
    slides=np.zeros(6, dtype=bool),
    # At q = 0 the upper arm lies along x, and the forearm stands up.
    axes=np.array([[0, 0, 1.0], [0, -1, 0], [0, -1, 0], [0, 0, 1], [0, -1, 0], [0, 0, 1]]),
    anchors=np.array(
        [[0, 0, SHOULDER], [0, 0, SHOULDER], [UPPER_ARM, 0, SHOULDER], _WRIST, _WRIST, _WRIST]
    ),
    T_0=np.array([[1, 0, 0, _WRIST[0]], [0, 1, 0, _WRIST[1]], [0, 0, 1, _WRIST[2]], [0, 0, 0, 1]]),
    limits=JOINT_LIMITS,
)
"""Written out, so that a controller of the real arm runs without MuJoCo; a test holds it against
the table and against the file.
"""

GEAR_RATIOS = (62.6111, 107.815, 53.7063, 76.0364, 71.923, 76.686)
"""Turns of the motor in one of the joint [1]. Source: Corke & Armstrong-Helouvry 1994, as in
`models/puma560.xml`.
"""


MOTOR_TORQUES = (97.6, 186.4, 89.4, 24.2, 20.1, 21.3)
"""Largest torques of the motors at the joints [Nm], as in `models/puma560.xml`."""


def _worn(
    k: float, play_deg: float, share: float, counts: int, off_deg: float
) -> dict[str, object]:
    """Blocks of a preset: stiffness of joints 1 and 2, play of the elastic joints, cogging and
    ripple as a share of the largest torque, counts in a turn of a motor and eccentricity of its
    encoder.
    """
    return {
        "gears": Gears(stiffness_nmprad=(k, k, 0.4 * k, 0.0, 0.0, 0.0), backlash_deg=(play_deg,)),
        "ripple": Ripple(
            cogging_nm=tuple(round(share * torque / 2, 3) for torque in MOTOR_TORQUES),
            share=share,
            cycles=tuple(round(6 * ratio, 1) for ratio in GEAR_RATIOS),
        ),
        "encoders": Encoders(
            counts=tuple(round(counts * ratio) for ratio in GEAR_RATIOS),
            eccentricity_deg=tuple(round(off_deg / ratio, 6) for ratio in GEAR_RATIOS),
            turns=GEAR_RATIOS,
        ),
    }


PRESETS: Presets = {
    "lab": {
        **_worn(k=40_000.0, play_deg=0.005, share=0.01, counts=4000, off_deg=0.05),
        "drives": CurrentLoops(bandwidth_hz=500.0),
        "geometry_error": GeometryError(sigma_m=3e-4, sigma_deg=0.02),
    },
    "field": {
        **_worn(k=25_000.0, play_deg=0.02, share=0.02, counts=1000, off_deg=0.2),
        "drives": CurrentLoops(bandwidth_hz=200.0, delay_s=1e-3),
        "geometry_error": GeometryError(sigma_m=1e-3, sigma_deg=0.1),
    },
}
"""Chosen, within what catalogues state for gears of such torques: strain wave gears of sizes 20 and
25 have 16000 to 57000 Nm/rad (Harmonic Drive LLC, CSF and CSG), planetary gears for 100 Nm 29000 to
33000 Nm/rad and up to 8 arc minutes of play (Beckhoff AG3210, NP025). The Puma's own are spur and
bevel gears, whose play can be adjusted. `models/README.md` says more. Six cycles of cogging in a
turn of a motor; encoders on the motors.
"""

ACTUATIONS = {
    "ideal": Actuation("ideal", friction=False, gravity_compensated=True),
    "industrial": Actuation("industrial", friction=True, gravity_compensated=False),
    "raw": Actuation("raw", friction=True, gravity_compensated=True),
}
"""`ideal`: stiff and frictionless; `industrial`: velocity loop with integral action; `raw`:
proportional velocity loop, in which friction leaves a steady-state error.
"""


@spec
class PumaStart(ArmStart):
    """Joint angles at the start.

    Args:
        nominal: joint angles at the start of a run without a seed.
    """

    nominal: Positions = Positions(q_deg=(0.0, 45.0, -180.0, 0.0, 45.0, -45.0))


@spec
class Puma560(Arm):
    """The Puma 560 with a camera at its flange, driven by joint velocities.

    Args:
        actuation: `ideal`, `industrial` (default) or `raw`: which servo amplifiers the joints have.
        start: joint angles at the start; the textbook's by default (its +180 deg of joint 3 is -180
            here, within the limits).
        avoid_limits: gain of joint-limit avoidance [1/s], by which joints in the outer fifth of
            their range move back towards its middle in the null space of the law (`law.redundant`);
            0: none.
    """

    kind: Literal["puma560"] = "puma560"
    actuation: Literal["ideal", "industrial", "raw"] = "industrial"
    start: PumaStart = PumaStart()
    avoid_limits: Annotated[float, Ge(0), Le(10)] = 0.0
    presets = PRESETS
    file = "puma560.xml"
    chain = CHAIN
    joints = CHAIN.names
    joint_speeds = SPEED_LIMITS
    unit_m: ClassVar[float] = UPPER_ARM  # pyright: ignore[reportIncompatibleMethodOverride] - a constant

    def __post_init__(self) -> None:
        self._check()

    @property
    def largest_torques(self) -> Array:
        return np.array(MOTOR_TORQUES)

    @property
    def servo_set(self) -> Actuation:
        """The servo amplifiers of the chosen actuation."""
        return ACTUATIONS[self.actuation]
