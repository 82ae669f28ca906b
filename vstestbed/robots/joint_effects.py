"""What the drives of an arm's joints lack of ideal ones: stiff gears without play, smooth torque, exact encoders, torque at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le, Len
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Frequency, OneForAll, PositiveTime
from vstestbed.core.spec import spec

Springs = Annotated[tuple[Annotated[float, Ge(0), Le(1e9)], ...], Len(0, 7), OneForAll()]
Torques = Annotated[tuple[Annotated[float, Ge(0), Le(1e6)], ...], Len(1, 7), OneForAll()]
SmallAngles = Annotated[tuple[Annotated[float, Ge(0), Le(10)], ...], Len(1, 7), OneForAll()]
Cycles = Annotated[tuple[Annotated[float, Ge(0), Le(1e6)], ...], Len(1, 7), OneForAll()]
Counts = Annotated[tuple[Annotated[int, Ge(0), Le(2**31)], ...], Len(1, 7), OneForAll()]
MilliSeconds = Annotated[float, Ge(0), Le(0.1)]


def each(field: str, given: Sequence[float], slides: NDArray[np.bool_], turns: bool = True) -> Array:
    """A value for each joint (n,): one that is given alone holds for all hinges, and of an angle (`turns`) not for joints that slide.

    Raises:
        ParameterError: another number of values, or an angle for a joint that slides.
    """
    n = len(slides)
    if len(given) not in (1, n):
        raise ParameterError(field, f"must be one value for all joints, or {n}, one for each", list(given))
    values = np.resize(np.array(given, dtype=float), n)
    if not turns:
        return values
    if len(given) == n and values[slides].any():
        raise ParameterError(field, "must be 0 for a joint that slides", list(given))
    return np.where(slides, 0.0, values)


@spec
class Gears:
    """Elastic gears with play: a joint is two masses, the rotor of its motor and the link, with a spring and a damper between them.

    J theta'' = tau - f,  M(q) q'' + ... = f,  f = k s + c (theta' - q'),  s = theta - q beyond the play: 0 within +-b/2, with
    the rotor's inertia J (the armature of the file, times the squared gear ratio), its angle theta on the joint's side, and
    c = k damping_s. Motor, its friction, servo and encoder are on the rotor's side, as in industrial arms; the camera is behind the
    spring. A link alone, of inertia M, vibrates at sqrt(k/M) before a rotor that stands and at sqrt(k (1/J + 1/M)) before a free one,
    with the damping ratio w damping_s / 2 at w. The damping acts within the play, too, as that of the lubricant.

    The stiffness of `strain_wave` grows with the torque, in stages: k is its first one, and s bends at the stages' ends.

    Reference: Spong 1987, Modeling and control of elastic joint robots, doi:10.1115/1.3143860.

    Args:
        stiffness_nmprad: stiffness k of each joint, one for all or one for each; 0: rigid (N/m where the joint slides); default: that of
            `robot.strain_wave` [Nm/rad]; e.g. `[25000, 25000, 10000, 0, 0, 0]`.
        damping_s: c / k of all joints [s].
        backlash_deg: b, the whole play of each joint, as its link moves before a rotor that stands, one for all or one for each [deg].
    """

    stiffness_nmprad: Springs = ()
    damping_s: MilliSeconds = 0.0005
    backlash_deg: SmallAngles = (0.0,)

    def play(self, k: Array, slides: NDArray[np.bool_]) -> Array:
        """Play (n,) [rad] of joints of stiffness k (n,), of which some slide; one that is given alone holds for the elastic ones.

        Raises:
            ParameterError: another number of values, or play in a rigid joint.
        """
        play = np.radians(each("gears.backlash_deg", self.backlash_deg, slides))
        if len(self.backlash_deg) > 1 and play[k == 0].any():
            words = "must be 0 for a rigid joint; works: a stiffness for it in gears.stiffness_nmprad"
            raise ParameterError("gears.backlash_deg", words, list(self.backlash_deg))
        return np.where(k > 0, play, 0.0)


@spec
class Ripple:
    """Cogging of the motors, a torque that depends on the rotor's angle theta alone, and the ripple of the torque that they give.

    tau = (1 + share sin(cycles theta)) tau_servo + cogging_nm sin(cycles theta), all on the joint's side of the gears.

    Reference: Jahns & Soong 1996, Pulsating torque minimization techniques for permanent magnet AC motor drives,
    doi:10.1109/41.491356.

    Args:
        cogging_nm: amplitude of the cogging torque of each joint, one for all or one for each [Nm]; e.g. `0.5`.
        share: ripple of the torque as a share of it [1].
        cycles: cycles in a turn of the joint: those in a turn of the motor times the gear ratio, one for all or one for each [1].
    """

    cogging_nm: Torques = (0.0,)
    share: Annotated[float, Ge(0), Le(0.5)] = 0.0
    cycles: Cycles = (600.0,)


@spec
class Encoders:
    """What the encoders read: the angle in whole counts, with the error of a graduation that is not centred on its shaft.

    q = c round(p / c),  p = theta + e sin(turns theta),  c = 2 pi / counts;  q' = c round(p' window_s / c) / window_s: the counts of a
    window, as counters measure speed. e [rad] is the eccentricity over the graduation's radius, divided by `turns`. The servos have
    the angle without these errors. Joints that slide are read exactly.

    The kinematic error of a strain wave gear between an encoder on the motor and the link has the same form: twice in a turn of the
    motor, so that `turns` is twice the ratio (Tuttle & Seering 1996, doi:10.1109/70.499819), with half of the catalogue's positioning
    accuracy as e.

    Args:
        counts: in a turn of the joint, those in a turn of the encoder times `turns`, one for all or one for each; 0: no steps [1].
        eccentricity_deg: e, amplitude of the error on the joint's side, one for all or one for each [deg].
        turns: of the encoder in a turn of the joint: 1 on the joint, the gear ratio on the motor; one for all or one for each [1].
        window_s: in which counts are a speed [s].
    """

    counts: Counts = (0,)
    eccentricity_deg: SmallAngles = (0.0,)
    turns: Cycles = (1.0,)
    window_s: PositiveTime = 0.01

    def read(self, q: Array, qd: Array, slides: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Measured positions and velocities (n,) each of joints at q, qd (n,) [rad, rad/s]."""
        e, N = np.radians(each("encoders.eccentricity_deg", self.eccentricity_deg, slides)), each("encoders.turns", self.turns, slides)
        p, pd = q + e * np.sin(N * q), qd * (1 + e * N * np.cos(N * q))
        counts = each("encoders.counts", self.counts, slides)
        step = 2 * np.pi / np.where(counts > 0, counts, 1.0)
        speed_step = step / self.window_s
        return np.where(counts > 0, step * np.round(p / step), p), np.where(counts > 0, speed_step * np.round(pd / speed_step), pd)


@spec
class CurrentLoops:
    """Current loops: the motor's torque follows the servo's with a lag of the first order and a delay.

    tau' = (u(t - delay_s) - tau) 2 pi bandwidth_hz, with the servo's torque u within its limits. The servo then is a sampled one, at
    the physics step, of 1 ms at most. Its velocity loop has a crossover at kv over the rotor's inertia; where lag, delay and sampling
    take its phase margin, it oscillates.

    Args:
        bandwidth_hz: at which the torque has fallen by 3 dB [Hz].
        delay_s: between the servo's torque and the motor's, in whole physics steps [s].
    """

    bandwidth_hz: Frequency = 500.0
    delay_s: MilliSeconds = 0.0
