"""Measured gain limit: bisection over closed-loop runs near the goal."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from scipy.linalg import expm

from vstestbed.core.errors import ParameterError
from vstestbed.core.files import write_json, write_table
from vstestbed.core.geometry import Array, exp, inverse
from vstestbed.core.outcome import Outcome
from vstestbed.laws import Law
from vstestbed.laws.base import TwistLimits
from vstestbed.laws.points import Visibility
from vstestbed.loop.session import run, uninterrupted
from vstestbed.loop.stability import (
    NO_LAG,
    Poles,
    closed_form,
    gain_limit,
    loop_shares,
    roots,
    swing_frames,
)
from vstestbed.report.studies import Branches, write_delay
from vstestbed.robots import Robot
from vstestbed.robots.arm import Arm
from vstestbed.scenario.noise import Noise
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import Plant
from vstestbed.sim.build import build_plant
from vstestbed.sim.plant import LinearArm, linear_arm
from vstestbed.tasks.metrics import TWIST
from vstestbed.tasks.stop import Converged, Stop
from vstestbed.vision import Oracle

EXCITED, SETTLING, ROUNDS = 10, 4, 4
"""Periods for which a joint is excited; how many of them pass before its motion is used
(transient); iterations of the frequency.
"""
LEAST_W = (
    0.05  # a joint that does not follow a swing of this frequency follows none [rad per frame]
)


@dataclass(frozen=True)
class Lag:
    """Response of one joint to a sinusoidal velocity command.

    Attributes:
        joint: name of the joint. shares: (b_0, b_1) [1]. swing_s: period of the excitation, that of
            the loop at its gain limit [s].
        lag_s: phase lag of the motion at that period, as a time [s]. gain: amplitude ratio of
            motion to command [1].
    """

    joint: str
    shares: tuple[float, float]
    lag_s: float
    gain: float
    swing_s: float


def measure_lags(scenario: Scenario, delay_frames: float, off: float) -> list[Lag]:
    """Measure the response of each joint of an arm at the frequency at which the loop oscillates at
    its gain limit.

    One joint after the other gets the velocity command u(k) = off gain cos(w k), held over each
    frame (or led to, with `timing.interpolation`), and (q(k+1) - q(k)) / period = b_0 u(k) + b_1
    u(k-1) is fitted by least squares. Two numbers describe a linear actuator at one frequency; for
    a joint with friction they are its describing function at this amplitude. w and gain are those
    at which the loop with these b becomes unstable, found by ROUNDS iterations; w is at most 0.9
    pi, since at pi b_0 and b_1 cannot be distinguished.

    scenario: of an arm; its start is the configuration about which the joints move. delay_frames:
    d. off: amplitude of each joint [rad].
    """
    # neither images nor true poses are needed: the encoders are the measurement
    interpolator = scenario.timing.interpolator(*scenario.clock)
    scene = scenario.scene
    plant, _ = build_plant(scene, setpoints=scene.setpoints(interpolator=interpolator))
    try:
        return [
            _lag_of(plant, name, i, scenario.camera.period, delay_frames, off)
            for i, name in enumerate(scenario.robot.joints)
        ]
    finally:
        plant.close()


def _lag_of(
    plant: Plant, name: str, joint: int, period: float, delay_frames: float, off: float
) -> Lag:
    # first guess: a robot without lag
    w, g, b = math.pi / (2 * delay_frames + 1), closed_form(delay_frames), (1.0, 0.0)
    for _ in range(ROUNDS):
        w = min(w, 0.9 * math.pi)
        while sum(b := _shares(plant, joint, period, w, off * g / period)) <= 0 and w > LEAST_W:
            # so fast a swing the joint answers by moving against it: the loop swings more slowly
            w /= 2
        g = gain_limit(delay_frames, b)
        w = abs(float(np.angle(roots(g, delay_frames, b)[0])))
    w = min(w, 0.9 * math.pi)
    response = b[0] + b[1] * np.exp(-1j * w)
    return Lag(
        name,
        b,
        float(-np.angle(response) / w * period),
        float(np.abs(response)),
        2 * math.pi / w * period,
    )


def _shares(plant: Plant, joint: int, period: float, w: float, speed: float) -> tuple[float, float]:
    """(b_0, b_1) of one joint under a sinusoidal command of frequency w [rad per frame] and
    amplitude `speed` [rad/s]; then it rests.
    """
    frames, first = (math.ceil(n * 2 * math.pi / w) for n in (EXCITED, SETTLING))
    command, q = speed * np.cos(w * np.arange(frames)), np.empty(frames + 1)
    for k in range(frames):
        q[k] = plant.reading().q[joint]
        plant.apply(np.where(np.arange(len(plant.reading().q)) == joint, command[k], 0.0))
        plant.advance(plant.steps_per_frame)
    q[frames] = plant.reading().q[joint]
    plant.apply(np.zeros(len(plant.reading().q)))
    plant.advance(5 * plant.steps_per_frame)  # the next joint begins with the arm at rest
    # the third takes up a constant drift
    A = np.column_stack([command[first:], command[first - 1 : -1], np.ones(frames - first)])
    b = np.linalg.lstsq(A, (np.diff(q) / period)[first:], rcond=None)[0]
    return float(b[0]), float(b[1])


# Linear model of the visual servo loop of an arm: gain limit with its servos, its coupled inertia
# and its elastic joints.
#
# Near the goal, with the joints' positions as the error, the law commands the speeds v(k) = -g / T
# q(k - d), held for a period T, and the arm answers as `sim.linear.LinearArm`, whose links the
# camera sees and whose rotors the servos turn. It is sampled exactly; the poles are those of the
# loop over x = (z, z', r) and the d positions that are under way. Of a delay of d + f frames with
# 0 < f < 1 a command begins at f of a frame, before which the last one holds. Coulomb friction,
# which damps small motions, is left out.
#
# References: Spong 1987, doi:10.1115/1.3143860 (the plant); Franklin, Powell & Workman, Digital
# Control of Dynamic Systems (zero-order hold; a delay of part of a period).
FIRST, FACTOR, FINE, MOST = 1e-3, 1.02, 1e-6, 1e3
"""The first crossing is sought upwards from this g in steps of this factor, up to MOST, then by
bisection to this share.
"""


def sampled(arm: LinearArm, period_s: float) -> tuple[Array, Array]:
    """(A, B) of x(k+1) = A x(k) + B v(k), x = (z, z', r), with v held over a period."""
    N, n = arm.motors.shape
    b, inverse = arm.motors, np.linalg.inv(arm.mass)
    states = 2 * N + n
    A, B = np.zeros((states, states)), np.zeros((states, n))
    A[:N, N : 2 * N] = np.eye(N)
    A[N : 2 * N, :N] = -inverse @ (arm.spring + b @ np.diag(arm.kp) @ b.T)
    A[N : 2 * N, N : 2 * N] = -inverse @ (arm.damper + b @ np.diag(arm.kv) @ b.T)
    A[N : 2 * N, 2 * N :] = inverse @ b @ np.diag(arm.kp)
    B[N : 2 * N] = inverse @ b @ np.diag(np.where(arm.integrates, 0.0, arm.kv))
    B[2 * N :] = np.diag(np.where(arm.integrates, 1.0, 0.0))
    both = np.asarray(expm(np.block([[A, B], [np.zeros((n, states + n))]]) * period_s), dtype=float)
    return both[:states, :states], both[:states, states:]


def linear_gain_limit(arm: LinearArm, delay_frames: float, period_s: float) -> float | None:
    """The g = gain * period at which a pole first leaves the unit circle; delay_frames: also a part
    of a frame.

    None where none does up to MOST, at which an error of one is answered by a thousand a picture:
    servos whose speeds are ordered and that do not integrate follow without delay, so that such a
    model has no limit.
    """
    F, G = _loop(arm, delay_frames, period_s)

    def unstable(g: float) -> bool:
        return bool(np.abs(np.linalg.eigvals(F + g * G)).max() > 1 + 1e-9)

    high = FIRST
    while not unstable(high):
        high *= FACTOR
        if high > MOST:
            return None
    low = high / FACTOR
    while high - low > FINE * high:
        middle = (low + high) / 2
        low, high = (low, middle) if unstable(middle) else (middle, high)
    return (low + high) / 2


def _loop(arm: LinearArm, delay_frames: float, period_s: float) -> tuple[Array, Array]:
    """(F, G): the loop's matrix is F + g G, over x and the last positions q (n,) that are under
    way.
    """
    whole, part = divmod(delay_frames, 1.0)
    delay = int(whole)
    A, B = sampled(arm, period_s)
    states, n = B.shape
    kept = delay + (part > 0)
    F = np.zeros((states + kept * n,) * 2)
    G = np.zeros_like(F)
    F[:states, :states] = A
    if kept:
        F[states : states + n, :n] = np.eye(n)
        F[states + n :, states:-n] = np.eye((kept - 1) * n)
    late = np.zeros_like(B)
    # the last command holds until this one comes: x(k+1) = A x(k) + late v(k-1) + (B - late) v(k)
    if part:
        early = sampled(arm, part * period_s)[1]
        late = sampled(arm, (1 - part) * period_s)[0] @ early
        G[:states, _seen(delay + 1, states, n)] = -late / period_s
    G[:states, _seen(delay, states, n)] += -(B - late) / period_s
    return F, G


def _seen(age: int, states: int, n: int) -> slice:
    """Where the loop's vector has the positions (n,) of `age` frames ago."""
    return slice(states + (age - 1) * n, states + age * n) if age else slice(0, n)


HALVINGS = 9  # bisections of a bracket of 0.5 to 1.5 times the prediction: 0.2 % of it remains
# a run lasts this many periods of the oscillation at the limit, and 40 frames more in which other
# modes decay
SWINGS = 16
OFF, OFF_WITH_FRICTION = 1e-5, 0.02
"""Offset from the goal at the start of a run: along each axis [m], and about each axis or in each
joint [rad]. Small enough for the loop to be linear and its actuators unsaturated, while the
oscillation grows by GROWN too; for joints with friction large enough for the motion to dominate
friction.
"""
SMALLER, LINEAR = 0.01, 0.05
"""A law counts as linear whose command changes with the offset, down to this share of it, but for
this share.
"""
GROWN = 20.0
"""Growth of the error that counts as unstable whatever follows; so do actuators that still saturate
in the second half of the run.
"""
MOST_FRAMES = 50  # the longest delay of a study [frames]
MOST_G = 8.0
"""A loop that is stable at this gain * period has no limit that matters: two are deadbeat control
with overshoot of the whole error.
"""
# a run whose error has fallen to this share of its start is stable, however friction or rounding
# move what is left
SETTLED = 0.01
UNSATURATED = 0.999
# The error did not oscillate: the run came to rest.
CALM = (Outcome.converged, Outcome.local_minimum)


@dataclass(frozen=True)
class Limit:
    """The gain limit at one delay.

    Attributes:
        delay_frames: d, also a part of a frame. latency_s: the same delay [s].
        gain: largest stable gain, measured [1/s]; g: gain * period [1]; of an `unlimited` loop,
            which no gain up to MOST_G makes unstable, the largest one that was tried.
        g_theory: g of a robot without lag, with the exposure, readout and interpolation of the
            scenario. g_lag: g with the measured lag of the joint that becomes unstable first; None
            for a robot without joints, and for elastic ones.
        g_linear: g of the linear arm with its servos and the elasticity of its gears; None for a
            robot without joints.
        lags: lag of each joint at the frequency of the limit. runs: number of runs that the search
            took.
    """

    delay_frames: float
    latency_s: float
    gain: float
    g: float
    g_theory: float
    g_lag: float | None
    lags: tuple[Lag, ...]
    runs: int
    unlimited: bool = False
    g_linear: float | None = None

    @property
    def first(self) -> Lag | None:
        """The lag of the joint with the lowest predicted gain limit; None for a robot without
        joints.
        """
        return min(
            self.lags, key=lambda lag: gain_limit(self.delay_frames, lag.shares), default=None
        )

    def row(self) -> dict[str, float | int | str | None]:
        """The limit as a row of the table."""
        first = self.first
        linear = (
            {}
            if self.g_linear is None
            else {"g_linear": self.g_linear, "measured_to_linear": self.g / self.g_linear}
        )
        return {
            "delay_frames": self.delay_frames,
            "latency_s": self.latency_s,
            "gain_limit": self.gain,
            "g_measured": self.g,
            "g_theory": self.g_theory,
            "measured_to_theory": self.g / self.g_theory,
            "g_with_lag": self.g_lag,
            "measured_to_lag": None if self.g_lag is None else self.g / self.g_lag,
            "joint": None if first is None else first.joint,
            "joint_lag_s": None if first is None else first.lag_s,
            "joint_gain": None if first is None else first.gain,
            "runs": self.runs,
            "unlimited": self.unlimited,
            **linear,
        }


def by_the_oracle(scenario: Scenario) -> Scenario:
    """The scenario as it is measured: exact pixels, a picture without border, no noise, and a law
    without limits on the twist.

    Raises ParameterError: the law is not supported.
    """
    law, names = scenario.law, _fields_of(scenario.law)
    plain = {
        "limits": TwistLimits(),
        "smooth_start_s": 0.0,
        "smoothing_s": 0.0,
        "visibility": Visibility(),
        "gain": 2.0,
    }
    return replace(
        scenario,
        # only those fields that this law has
        law=replace(law, **{name: value for name, value in plain.items() if name in names}),
        noise=Noise(),
        # exact pixels, and no target lost: only dynamics and delay count
        detector=Oracle(field_of_view="unlimited"),
        camera=replace(scenario.camera, latency_s=0.0),
        stop=Stop(duration_s=60.0, converged=Converged(error_px=0.01, hold_s=0.0)),
    )


def prepared(scenario: Scenario) -> Scenario:
    """The scenario as it is measured (`by_the_oracle`), at its goal.

    The goal configuration of an arm comes from a run of its own with ideal actuators.

    Raises ParameterError: robot or law are not supported, or the run does not reach its goal.
    """
    scenario = scenario.resolved
    settled = by_the_oracle(scenario)
    if scenario.noise != settled.noise:
        logging.getLogger("vstestbed").warning(
            "the gain limit is that without the scenario's noise, which is switched off"
        )
    if settled.robot.body is None:
        T = scenario.T_world_goal @ inverse(scenario.camera.mount.T)
        return replace(settled, robot=settled.robot.started_at(T.ravel()))
    if settled.robot.base != "fixed":
        why = "the limit of a loop that answers in all six directions alike is what is found"
        raise ParameterError.fixed("robot.kind", "free or puma560", settled.robot.kind, why=why)
    if isinstance(settled.robot, Arm) and settled.robot.controller.takes_wrench:
        why = (
            "servos of speeds are in the loop whose limit is found,"
            " and this controller is told forces besides"
        )
        raise ParameterError.fixed(
            "robot.controller",
            "velocity or computed_torque",
            settled.robot.controller.kind,
            why=why,
        )
    robot = settled.robot.idealised() if isinstance(settled.robot, Arm) else settled.robot
    flown = uninterrupted(run(replace(settled, robot=robot)))
    if not flown.outcome.success:
        raise ParameterError(
            "scenario",
            f"must reach its goal without delay, at a gain of 2 1/s; {flown.outcome.value}",
        )
    q = np.array([flown[f"q_{joint}"][-1] for joint in settled.robot.joints])
    return replace(settled, robot=settled.robot.started_at(q))


def _fields_of(law: Law[Any]) -> set[str]:
    """The names of a law's fields. Raises ParameterError: it works on whole pictures, or has no
    single gain.
    """
    if "image" in law.inputs:
        words = (
            "works on whole pictures, and the loop is measured by the oracle's markers;"
            " use a law of markers"
        )
        raise ParameterError("law.kind", f"{law.kind} {words}: ibvs, pbvs, hybrid or predictive")
    names = {field.name for field in fields(law)}
    if "gain" not in names or "gain_z" in names:
        raise ParameterError(
            "law.kind",
            "must have one gain for all directions: ibvs, pbvs, hybrid or predictive",
            law.kind,
        )
    return names


def displaced(at_goal: Scenario, share: float = 1.0) -> Scenario:
    """The scenario started at a small offset from its goal in all directions; share: of that
    offset.
    """
    signs = share * np.array([1.0, -1.0, 1.0, -1.0, 1.0, 1.0])  # all six directions are displaced
    robot = at_goal.robot
    if robot.body is None:
        T = robot.flange_pose(robot.configuration()) @ exp(OFF * signs)
        return replace(at_goal, robot=robot.started_at(T.ravel()))
    q = robot.configuration()
    return replace(at_goal, robot=robot.started_at(q + _off(robot) * np.resize(signs, len(q))))


def _warn_unless_linear(at_goal: Scenario) -> None:
    """Say so where the law's gain depends on the error already at this offset: the limit is that of
    swings of this size.
    """
    one_frame = replace(at_goal, stop=replace(at_goal.stop, duration_s=at_goal.camera.period))
    first = {share: uninterrupted(run(displaced(one_frame, share))) for share in (1.0, SMALLER)}
    sizes = {
        share: float(np.linalg.norm([log[f"cmd_{name}"][0] for name in TWIST]))
        for share, log in first.items()
    }
    gain = sizes[1.0] * SMALLER / sizes[SMALLER] if sizes[SMALLER] else math.nan
    if abs(gain - 1) > LINEAR:
        words = (
            "the law's gain depends on the error:"
            " at the offset from which the limit is measured it is %.3g of that at the goal itself"
        )
        logging.getLogger("vstestbed").warning(
            words + "; the limit holds for swings of that size, not for smaller ones", gain
        )


def _off(robot: Robot) -> float:
    return (
        OFF_WITH_FRICTION
        if robot.body and robot.body.actuation and robot.body.actuation.friction
        else OFF
    )


def growth(at_start: Scenario, gain: float, delay_frames: float) -> float:
    """Growth of the oscillation over the second half of a run from `displaced`, at a gain [1/s];
    above 1 the loop is unstable.
    """
    swing, period = max(swing_frames(delay_frames), 4), at_start.camera.period
    frames = SWINGS * swing + 40
    scenario = replace(
        at_start,
        law=replace(at_start.law, gain=gain),
        camera=replace(at_start.camera, latency_s=delay_frames * period),
        # a hold time of the whole run: reaching the goal does not end it
        stop=Stop(
            duration_s=frames * period, converged=Converged(error_px=1e-9, hold_s=frames * period)
        ),
    )
    recording = uninterrupted(run(scenario))
    size = recording["error_px"]
    if not recording.outcome.success and not recording.outcome.out_of_time:
        return 0.0 if recording.outcome in CALM else math.inf
    half = len(size) // 2
    if np.nanmax(size) > GROWN * size[0] or (recording["scale"][half:] < UNSATURATED).any():
        return math.inf
    # peak over one period at the beginning and at the end of the second half
    early, late = np.nanmax(size[half : half + swing]), np.nanmax(size[-swing:])
    return float(late / early) if late > SETTLED * size[0] else 0.0


def _must_take(law: Law[Any], gain: float) -> None:
    """Refuse a law that does not take a gain that the search must try."""
    try:
        replace(law, gain=gain)
    except ParameterError as error:
        raise ParameterError(
            "law.gain",
            f"{error.problem}: the gain limit is beyond what law {law.kind} takes",
            round(gain, 4),
        ) from None


def find_limit(at_goal: Scenario, delay_frames: float) -> Limit:
    """The gain limit at one delay, by bisection."""
    period = at_goal.camera.period
    robot = at_goal.robot
    g_linear = None
    # the linear arm has no commands that are led to
    if robot.joints and at_goal.timing.interpolation == "hold":
        late = delay_frames + _late_frames(at_goal)
        g_linear = linear_gain_limit(linear_arm(robot), late, period)
    elastic = any(effect.springs(np.zeros(len(robot.joints))) for effect in robot.acting)
    # at a resonance two shares of a command do not describe a joint
    lags = () if elastic else _lags(at_goal, delay_frames)
    theory = _theory(at_goal, delay_frames)
    g_lag = min((gain_limit(delay_frames, lag.shares) for lag in lags), default=None)
    # the bracket is centred on the better prediction
    expected = theory if g_lag is None else g_lag
    if elastic and g_linear is not None:
        expected = min(expected, g_linear)
    g, count, unlimited = _bisected(displaced(at_goal), delay_frames, expected)
    return Limit(
        delay_frames,
        delay_frames * period,
        g / period,
        g,
        theory,
        g_lag,
        lags,
        count,
        unlimited,
        g_linear,
    )


def _bisected(at_start: Scenario, delay_frames: float, expected: float) -> tuple[float, int, bool]:
    """The gain a picture [1] from which a loop grows, how many gains were tried, and whether none
    up to MOST_G makes it grow; then the gain is the largest that was tried. expected: by theory.
    """
    period = at_start.camera.period

    def grows(g: float) -> bool:
        return growth(at_start, g / period, delay_frames) > 1

    low, high = 0.5 * expected, 1.5 * expected
    # a bracket without the limit would make the bisection converge to one of its ends
    _must_take(at_start.law, low / period)
    if grows(low):
        words = (
            f"is still unstable at {low / period:.3g} 1/s with {delay_frames} frames of delay,"
            " half of what is expected"
        )
        raise ParameterError("law.gain", words)
    _must_take(at_start.law, high / period)
    count = 2
    # a law that predicts is stable beyond the theory of one that does not
    while not grows(high):
        low, high = high, 2 * high
        count += 1
        _must_take(at_start.law, high / period)
        if high > MOST_G:
            return low, count, True
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        count += 1
        if grows(middle):
            high = middle
        else:
            low = middle
    return (low + high) / 2, count, False


def _lags(at_goal: Scenario, delay_frames: float) -> tuple[Lag, ...]:
    """Those of a robot with joints, and of its pictures; interpolation is in the measured ones."""
    if not at_goal.robot.joints:
        return ()
    late = loop_shares(False, _late_frames(at_goal))
    lags = measure_lags(at_goal, delay_frames, _off(at_goal.robot))
    return tuple(
        replace(lag, shares=tuple(np.convolve(lag.shares, late).tolist())) if len(late) > 1 else lag
        for lag in lags
    )


def _late_frames(at_goal: Scenario) -> float:
    """Age of a picture when its command acts, beside its latency [frames]: half its exposure and
    readout, and the command's latency.
    """
    late = (
        at_goal.timing.first_s(at_goal.camera) + at_goal.camera.readout_s
    ) / 2 + at_goal.timing.command_latency_s
    return late / at_goal.camera.period


def _theory(at_goal: Scenario, delay_frames: float) -> float:
    """The g of a robot without lag."""
    shares = loop_shares(at_goal.timing.interpolation != "hold", _late_frames(at_goal))
    whole = int(delay_frames)
    return (
        closed_form(whole)
        if shares == NO_LAG and whole == delay_frames
        else gain_limit(delay_frames, shares)
    )


def delays_of(scenario: Scenario, frames: Sequence[int]) -> list[float]:
    """The delays [frames] of a study: the scenario's own latency first, where it has one, then
    those of `frames` that differ from it.
    """
    if bad := [d for d in frames if not 0 <= d <= MOST_FRAMES]:
        raise ParameterError.bound("--frames", "within", f"0 to {MOST_FRAMES}", bad[0])
    latency, period = scenario.camera.latency_s, scenario.camera.period
    own = round(latency / period, 9)
    if own > MOST_FRAMES:
        most = f"{MOST_FRAMES * period:g} s, which are {MOST_FRAMES} frames at {1 / period:g} Hz"
        raise ParameterError.bound("camera.latency_s", "at most", most, latency)
    return [own, *(d for d in frames if d != own)] if own else list(frames)


def find_limits(
    scenario: Scenario,
    frames: Sequence[int],
    on_limit: Callable[[Limit], None] = lambda limit: None,
) -> list[Limit]:
    """The gain limit at each of the delays of `delays_of`; `on_limit` is called with each as it is
    found.
    """
    delays = delays_of(scenario, frames)
    at_goal, limits = prepared(scenario), []
    _warn_unless_linear(at_goal)
    for d in delays:
        limits.append(find_limit(at_goal, int(d) if d == int(d) else d))
        on_limit(limits[-1])
    return limits


# Result files of a delay study: tables, figures, page, each complete or not at all.
BEYOND = 1.3  # the root locus is drawn up to this many times the gain limit


def locus(delay_frames: float, gains: Array, shares: Sequence[float] = NO_LAG) -> Poles:
    """The poles for each g of `gains` (m,), complex, shape (m, n + 1), each branch continued from
    one gain to the next.
    """
    out = np.array([roots(float(g), delay_frames, shares) for g in gains])
    for before, now in pairwise(out):
        left = list(now)  # greedy assignment to the nearest pole
        for i, pole in enumerate(before):
            now[i] = left.pop(int(np.argmin(np.abs(np.array(left) - pole))))
    return out


def write(folder: Path, limits: Sequence[Limit], name: str, command: str = "") -> Path:
    """Write `delay.csv`, `.parquet`, `.json` (with every joint's lag), `.png`, `.pdf` and
    `report.html`; returns the page's path.
    """
    rows = [limit.row() for limit in limits]
    write_table(folder / "delay", pl.DataFrame(rows, infer_schema_length=None))
    lags = [
        row | {"lags": [asdict(lag) for lag in limit.lags]}
        for row, limit in zip(rows, limits, strict=True)
    ]
    write_json(folder / "delay.json", lags)
    return write_delay(folder, name, rows, [branches(limit) for limit in limits], command)


def branches(limit: Limit) -> Branches:
    """Root locus of one delay, with the measured lag of the joint that becomes unstable first, if
    the robot has joints.
    """
    first = NO_LAG if limit.first is None else limit.first.shares
    end = limit.g_lag or limit.g_theory
    # not from 0, where all poles but one coincide at the origin
    gains = np.linspace(1e-6, BEYOND * end, 400)
    at_limit = locus(limit.delay_frames, np.array([limit.g]), first)[0]
    return limit.delay_frames, locus(limit.delay_frames, gains, first), at_limit
