"""Whether a loop that did not reach its goal swings or grows: from the commands and errors of the
last half of its run.

A loop with too high a gain for its sampling and delay commands back and forth: commands are
opposite after half a period, and alike after a whole one. Other loops that take long are not like
that:

- a slow approach has no period, and its error falls;
- a swing that decays is stable, only badly damped;
- pixel noise at the goal gives commands that are not alike from one period to the next;
- stick-slip of a joint with friction does not either (0.1 to 0.6, measured, against 0.8 to 1.0),
  and is of less than a pixel or two;
- a loop that follows a target which itself goes to and fro has the target's period.

A gain far too high has no clean period: limits of law and robot shorten the commands, and the
camera loses markers every few frames. Such a loop is known by its gain, near or over the limit of
theory, and by commands that stay large, turn round often and lead nowhere, while the error does not
fall.

The limit of the gain and the period at it are those of `gain_limit` and `swing_frames`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from functools import lru_cache
from itertools import islice, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse, rigid_error
from vstestbed.laws import Law
from vstestbed.laws.base import AdaptiveGain, ConstantGain
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.base import Log as Columns
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.metrics import TWIST, Figures

__all__ = [
    "NO_LAG",
    "LastPart",
    "Poles",
    "Stability",
    "closed_form",
    "gain_limit",
    "loop_shares",
    "reversal",
    "roots",
    "sentence",
    "swing",
    "swing_frames",
    "window",
]

# Discrete-time model of the visual servo loop with dead time and actuator lag: poles and gain
# limit.
#
# Near the goal the loop decouples into one scalar loop per direction of the error, whatever the
# feature: L cancels against its pseudo-inverse. With the error s, g = gain * period and d frames of
# dead time
#
#     s(k+1) = s(k) - g sum_j b_j s(k - d - j),
#
# where b_j is the share of a one-frame command that the robot executes in the j-th frame after it
# (its impulse response): b = (1) is a robot without lag, b = (1 - a, a) lags by a frames. The
# characteristic polynomial is z^(n+1) - z^n + g sum_j b_j z^(n-d-j), n = d + len(b) - 1.


Poles = NDArray[np.complexfloating]

NO_LAG = (1.0,)  # impulse response of a robot without lag


def closed_form(delay_frames: float) -> float:
    """The largest stable g = gain * period of a robot without lag: 2 sin(pi / (2 (2 d + 1))).

    There a pair of poles crosses the unit circle at pi / (2 d + 1): the loop oscillates with a
    period of 2 (2 d + 1) frames.
    Reference: Levin & May 1976, A note on difference-delay equations,
    doi:10.1016/0040-5809(76)90043-5.
    """
    return 2 * math.sin(math.pi / (2 * (2 * delay_frames + 1)))


def loop_shares(led: bool, late_frames: float) -> tuple[float, ...]:
    """Impulse response of a loop without lag of the robot, whose commands are led to, by a ramp or
    smoothly, and whose pictures are old. A led command is executed half in its own frame and half
    in the next one: the poles cross the unit circle at the angle pi / (2 (d + 1)), at g = 2
    tan(pi / (4 (d + 1))). To lead costs half a period: for small angles the limit is (pi / 2) /
    delay with a delay of d + 1/2 frames for commands that are held, and of d + 1 here.
    late_frames: age of a picture when it is complete, beside the delay [frames]: half its exposure
    and half its readout, as its time stamp is their middle. A command for a picture e frames older
    acts as one in 1 - e of the frame, and e of the next.
    """
    whole, part = divmod(late_frames, 1.0)
    late = [0.0] * int(whole) + ([1 - part, part] if part else [1.0])
    return tuple(np.convolve(late, (0.5, 0.5) if led else (1.0,)).tolist())


def swing_frames(delay_frames: float) -> int:
    """Period of the oscillation at the gain limit of a robot without lag [frames]; about that, of a
    part of a frame.
    """
    return math.ceil(2 * (2 * delay_frames + 1))


def polynomial(g: float, delay_frames: float, shares: Sequence[float] = NO_LAG) -> Array:
    """Coefficients of the characteristic polynomial, highest power first, shape (n + 2,). Of a
    delay of d + f frames with 0 < f < 1 a command begins at f of a frame: it is executed with 1 - f
    of each share in that frame, and with f in the next one.
    """
    whole, part = divmod(delay_frames, 1.0)
    d = int(whole)
    b = np.convolve(shares, (1 - part, part)) if part else np.asarray(shares, dtype=float)
    out = np.zeros(d + len(b) + 1)
    out[0], out[1] = 1.0, -1.0
    out[1 + d :] += g * b
    return out


def roots(g: float, delay_frames: float, shares: Sequence[float] = NO_LAG) -> Poles:
    """Poles of the loop in the z plane, complex, shape (n + 1,), by decreasing magnitude."""
    found = np.roots(polynomial(g, delay_frames, shares)).astype(complex)
    return found[np.argsort(-np.abs(found))]


@lru_cache(maxsize=256)
def gain_limit(delay_frames: float, shares: tuple[float, ...] = NO_LAG) -> float:
    """The g at which a pole first leaves the unit circle, to 1e-9; equals `closed_form` for a robot
    without lag.
    Raises ParameterError: the loop is stable at no gain, since the shares do not add up to more
    than 0.
    """
    if sum(shares) <= 0:
        raise ParameterError.bound(
            "shares", ">", "0 in sum", list(shares), why="else no gain makes the error smaller"
        )

    def unstable(g: float) -> bool:
        return bool(np.abs(roots(g, delay_frames, shares)[0]) > 1)

    # upwards in steps of 5 %, since only the first crossing counts; then bisection
    high = 1e-3
    while not unstable(high):
        high *= 1.05
    low = high / 1.05
    while high - low > 1e-10:
        middle = (low + high) / 2
        low, high = (low, middle) if unstable(middle) else (middle, high)
    return (low + high) / 2


FEWEST, MOST = 24, 2048
"""Frames that are looked at: with fewer, chance makes a period; with more a log of a day would not
be kept in constant memory.
"""
PERIODS = 4  # how many periods of a swing must fit in the frames that are looked at
ALIKE, OPPOSITE = 0.75, -0.45
"""Cosine between the commands of a swing and those a period later, and at most that of commands in
between; -0.5 for three frames.
"""
LEAST_PX, LEAST_LIMITS = 1.0, 5.0
"""Error under which a loop stands at its goal, where friction and noise move it [px]; of grey
levels, by the goal's limit [1].
"""
KEPT, KEPT_LIMITED = 0.9, 0.5
"""Share of its size that a swing keeps from the first third of the frames to the last, else it
decays; the second of a swing that the limits of law and robot hold: its size changes from one
period to the next (measured: by 0.7 to 1.4).
"""
LIMITED, LIMITED_SHARE = 0.999, 0.05
"""A command scaled under this is limited; a swing of whose commands so many are is held by the
limits.
"""
# difference from the period of the goal's own motion up to which a swing is that motion [1]
SAME_PERIOD = 0.2
NEAR_LIMIT, FAR_FROM_GOAL = 0.25, 0.25
"""Least gain, of the limit of theory, and least error, of that at the start, of a loop that goes to
and fro without a period: the lag of an arm without delay leaves it about half of that limit.
"""
HELD_SHARE, NET_SHARE, TURNS = 0.5, 0.3, 4
"""Of such a loop: least share of limited commands (measured: 0.84 to 1), largest share of the way
that it gets on (measured: 0.04 to 0.25; a slow approach: 1), and least number of times that its
command turns round.
"""
GREW = 2.0  # growth of an error that does not swing, over the frames, so that it counts as one


def period(x: Array) -> float:
    """Frames after which x (n, m) comes back, in between being opposite; 0 where it does not.

    With r(k) = sum_j x_j . x_(j+k) / sqrt(sum |x_j|^2 sum |x_(j+k)|^2) it is the first peak of r
    over ALIKE with an r under OPPOSITE before it. Normalised so, swings that grow or decay have r =
    1 after a period, too. A period that is no whole number of frames may have its peak after
    several: it is divided by the number of valleys before it.
    """
    r = [1.0]
    for k in range(1, len(x) // PERIODS + 2):
        a, b = x[:-k], x[k:]
        size = math.sqrt(float(np.vdot(a, a)) * float(np.vdot(b, b)))
        r.append(float(np.vdot(a, b)) / size if size > 0 else 0.0)
        if k > 2 and r[-2] >= max(ALIKE, r[-1]) and min(r) <= OPPOSITE:
            return (k - 1) / sum(r[i - 1] > r[i] <= r[i + 1] for i in range(1, k - 1))
    return 0.0


class LastPart(NamedTuple):
    """The last half of a run, n frames. error: in the image (n,) [px], or of a law of grey levels;
    NaN where nothing was measured. limited: commands that limits of law or robot shortened (n,).
    reference: of the goal in the world (n, m).
    away: true distance [m] and angle [rad] of the camera from its goal, in the first frame and in
    the last (2, 2).
    """

    t: Array
    error: Array
    twist: Array
    limited: NDArray[np.bool_]
    reference: Array
    away: Array

    def at(self, frames: Any) -> LastPart:
        """Some of the frames; `away` stays that of all."""
        return self._replace(
            t=self.t[frames],
            error=self.error[frames],
            twist=self.twist[frames],
            limited=self.limited[frames],
            reference=self.reference[frames],
        )


def swings(part: LastPart, least: float) -> float:
    """Period of a swing that does not decay, in frames; 0 for none. least: error that counts."""
    third = len(part.t) // 3
    x = part.twist
    if not _median(part.error[-third:]) >= least:
        return 0.0
    moves = bool(np.ptp(part.reference, axis=0).any())
    if moves:  # the swing is about the motion that the target, or the way, asks for
        x = x - x.mean(axis=0)
    held = float(np.mean(part.limited[-third:])) > LIMITED_SHARE
    kept = KEPT_LIMITED if held else KEPT
    if np.linalg.norm(x[-third:]) < kept * np.linalg.norm(x[:third]):
        return 0.0
    found = period(x)
    if moves:
        of_goal = period(part.reference - part.reference.mean(axis=0))
        if of_goal and abs(of_goal - found) <= SAME_PERIOD * found:
            return 0.0
    return found


def turns(x: Array) -> int:
    """How often commands x (n, m) turn round:
    become OPPOSITE to what they were when they last did.
    """
    found = 0
    before = np.zeros(x.shape[1])
    for each in x:
        size = float(np.linalg.norm(each) * np.linalg.norm(before))
        turned = size > 0 and float(each @ before) <= OPPOSITE * size
        found += turned
        if turned or not before.any():
            before = each
    return found


def to_and_fro(part: LastPart, least: float, share: float, first_error: float) -> int:
    """How often the command turns round, of a loop with too high a gain that has no clean period; 0
    for another. Only frames with a measurement count: in the others the law rests. Over the limit
    of theory the commands need not be limited.
    part: as for `swings`. least: error that counts. share: gain over the limit of theory [1].
    first_error: at the start of the run.
    """
    known = part.at(np.isfinite(part.error))
    third = len(known.t) // 3
    if share < NEAR_LIMIT or len(known.t) < FEWEST or np.ptp(part.reference, axis=0).any():
        return 0
    x = known.twist
    large = share > 1 or float(np.mean(known.limited)) >= HELD_SHARE
    decays = np.linalg.norm(x[-third:]) < KEPT_LIMITED * np.linalg.norm(x[:third])
    far = max(least, KEPT_LIMITED * _median(known.error[:third]), FAR_FROM_GOAL * first_error)
    if not large or decays or _median(known.error[-third:]) < far:
        return 0
    net = np.linalg.norm(x.sum(axis=0))
    way = np.linalg.norm(x, axis=1).sum()
    found = turns(x)
    return found if found >= TURNS and net <= NET_SHARE * way else 0


def _median(error: Array) -> float:
    known = error[np.isfinite(error)]
    return float(np.median(known)) if len(known) else math.nan


def grows(part: LastPart, least: float) -> bool:
    """Whether error and command grow all the time, and the camera truly leaves its goal, which
    stands still.
    """
    stands = not np.ptp(part.reference, axis=0).any()
    leaves = (part.away[1] > part.away[0]).any()
    if not (stands and leaves and np.isfinite(part.error).all()):
        return False
    errors = [float(np.median(each)) for each in np.array_split(part.error, 4)]
    quarters = np.array_split(part.twist, 4)
    ordered = [float(np.linalg.norm(each)) / math.sqrt(len(each)) for each in quarters]
    rises = all(b > a for a, b in pairwise(errors))
    error_grew = errors[-1] > max(least, GREW * errors[0])
    return rises and error_grew and ordered[-1] > LIMITED * ordered[0]


def sentence(scenario: Scenario, part: LastPart, first_error: float) -> str:
    """How the loop is unstable, by what numbers, and what would help; "" for one that is not. part:
    of the last half of its run. Where that does not tell, its last quarter may: a loop that grows
    until it loses a marker begins again.
    """
    last_quarter = part.at(slice(len(part.t) // 2, None))
    return _how(scenario, part, first_error) or _how(scenario, last_quarter, first_error)


def _how(scenario: Scenario, part: LastPart, first_error: float) -> str:
    if len(part.t) < FEWEST:
        return ""
    least, unit = _least(scenario)
    third = len(part.t) // 3
    early = _median(part.error[:third])
    late = _median(part.error[-third:])
    over = f"over the last {part.t[-1] - part.t[0]:.3g} s"
    grew = f"grew from {early:.3g} to {late:.3g} {unit}"
    how = grew if late > GREW * early else f"stayed at about {late:.3g} {unit}"
    frames = 0.0 if math.isnan(part.error[-1]) else swings(part, least)
    if frames:
        reversed_ = reversal(frames, scenario.camera.period)
        return f"{over} the command {reversed_}, and the error {how}; {_cause(scenario)}"
    if late > first_error and grows(part, least):
        return f"{over} the error {grew}, and the command with it; {_cause(scenario)}"
    turned = to_and_fro(part, least, _share_of_limit(scenario), first_error)
    if not turned:
        return ""
    known = np.isfinite(part.error)
    words = f"{over} the command turned round {turned} times"
    limited = np.mean(part.limited[known])
    if limited > LIMITED_SHARE:
        words += f", at its limits in {limited:.0%} of the frames"
    if not known.all():
        words += f", {np.mean(~known):.0%} of the frames had no measurement"
    return f"{words}, and the error {how}; {_cause(scenario)}".replace("%", " %")


def _least(scenario: Scenario) -> tuple[float, str]:
    """The error under which a loop stands at its goal, and its unit."""
    limit = scenario.stop.converged.error_grey
    return (LEAST_PX, "px") if limit is None else (LEAST_LIMITS * limit, "grey levels")


def reversal(frames: float, period_s: float | None = None) -> str:
    """A swing in words, by its period in frames; period_s: of a frame [s], if the time is to be
    told.
    """
    half = frames / 2
    if half == 1:
        return "reversed in every frame"
    time = f" ({half * period_s:.2g} s)" if period_s else ""
    return f"reversed every {half:.3g} frames{time}"


def _gain(law: Law[Any]) -> tuple[float | None, bool]:
    """The gain of a law at its goal [1/s], None where it has none or several; and whether commands
    are minus gain times the error.
    """
    while hasattr(law, "law"):  # of a program round a law
        law = law.law  # pyright: ignore[reportAttributeAccessIssue] - it has one
    gain = None if hasattr(law, "gain_z") else getattr(law, "gain", None)
    proportional = law.feedforward.kind == "none"
    if isinstance(gain, ConstantGain):
        return gain.value, proportional
    if isinstance(gain, AdaptiveGain):
        return gain.at_zero, proportional
    return (gain if isinstance(gain, float | int) else None), False


def _delay_s(scenario: Scenario) -> float:
    camera = scenario.camera
    timing = scenario.timing
    picture_s = (timing.first_s(camera) + camera.readout_s) / 2
    return camera.latency_s + timing.command_latency_s + picture_s


def _limit(scenario: Scenario) -> float:
    """The gain a frame over which a loop with the scenario's delay, without lag, is unstable."""
    led = scenario.timing.interpolation != "hold"
    return gain_limit(0, loop_shares(led, _delay_s(scenario) / scenario.camera.period))


def _share_of_limit(scenario: Scenario) -> float:
    """The law's gain over that limit [1]; 0 for a law that has not one gain."""
    gain, _ = _gain(scenario.law)
    return 0.0 if gain is None else gain * scenario.camera.period / _limit(scenario)


def _cause(scenario: Scenario) -> str:
    """Sampling, gain and delay in numbers; where the theory of the loop applies, its limit, and
    what would help.
    """
    camera = scenario.camera
    T = camera.period
    delay_s = _delay_s(scenario)
    delay = f"a delay of {delay_s:g} s ({delay_s / T:.3g} frames)" if delay_s else "no delay"
    gain, proportional = _gain(scenario.law)
    if gain is None:
        return (
            f"it is sampled at {camera.rate_hz:g} Hz with {delay};"
            " try lower gains, a higher rate, or less latency"
        )
    said = (
        f"a gain of {gain:.4g} 1/s at {camera.rate_hz:g} Hz is {gain * T:.4g} a frame, with {delay}"
    )
    if not proportional:
        return f"{said}; try a lower gain, a higher rate, or less latency"
    limit = _limit(scenario)
    bound = f"{limit:.4g} a frame ({limit / T:.4g} 1/s)"
    if gain * T > limit:
        helps = "or the delay" if delay_s else "or raise the rate"
        return (
            f"{said}: without lag a loop with that delay is unstable over {bound};"
            f" lower law.gain, {helps}"
        )
    rest = (
        "we do not know what makes the difference"
        " (the lag and the limits of the robot, the calibration, the noise)"
    )
    helps = "less delay" if delay_s else "a higher rate"
    return (
        f"{said}: without lag it would be stable up to {bound}, and {rest};"
        f" try a lower law.gain, or {helps}"
    )


def window(scenario: Scenario) -> int:
    """How many frames are looked at, of a run that takes its whole time; of a shorter one half of
    those that it has.
    """
    return int(min(max(scenario.stop.duration_s / scenario.camera.period / 2, FEWEST), MOST))


class Stability:
    """The last half of a run under way: it is asked where the run would end as `timed_out`."""

    def __init__(self, scenario: Scenario):
        self._scenario = scenario
        self._first = math.nan
        self._frames = 0
        # No frames: they hold pictures.
        self._last: deque[tuple[float, float, Array, float, Array, Array, Array]] = deque(
            maxlen=window(scenario)
        )
        self._grey = scenario.stop.converged.error_grey is not None

    def add(self, frame: Frame) -> None:
        """One more frame, whose command is the law's."""
        error = frame.command.error_grey if self._grey else frame.error.rms_px
        self._last.append(
            (
                frame.t,
                error,
                frame.command.twist,
                frame.allocation.scale * frame.command.scale,
                frame.goal.T_camera_target,
                frame.truth.T_world_target,
                frame.truth.T_world_camera,
            )
        )
        self._frames += 1
        if math.isnan(self._first):
            self._first = error

    def over_limit(self) -> str:
        """That the gain is over the limit of theory, in numbers; "" where it is not, and in a run
        without a measurement.
        """
        over = _gain(self._scenario.law)[1] and _share_of_limit(self._scenario) > 1
        return _cause(self._scenario) if over and not math.isnan(self._first) else ""

    def unstable(self, seen: bool = False) -> str:
        """How the loop is unstable, in words; "" where it is not. seen: how it was until the last
        frame with a measurement.
        """
        last = list(islice(self._last, max(0, len(self._last) - self._frames // 2), None))
        while seen and last and math.isnan(last[-1][1]):
            last.pop()
        if len(last) < FEWEST:
            return ""
        t, error, twist, scale, goal, target, camera = map(np.array, zip(*last, strict=True))
        at_goal = target[[0, -1]] @ inverse(goal[[0, -1]])
        away = np.array([rigid_error(camera[i], at_goal[i]) for i in (0, -1)])
        # A target in the gripper moves with the robot.
        moved = goal if self._scenario.target.on_gripper else np.concatenate([goal, target], axis=1)
        part = LastPart(t, error, twist, scale < LIMITED, moved.reshape(len(t), -1), away)
        return sentence(self._scenario, part, self._first)


LONG_SPANS = 2


def swing(scenario: Scenario, log: Columns) -> Figures:
    """Longest time for which the command swung without a break, with an error that counts, in whole
    spans of frames; none of a run whose command swung for fewer than LONG_SPANS of them. A span has
    room for PERIODS of the swing at the gain limit, of a robot that lags by a frame.
    """
    least, unit = _least(scenario)
    delay_frames = math.ceil(_delay_s(scenario) / scenario.camera.period - 1e-9)
    span = max(FEWEST, PERIODS * swing_frames(1 + delay_frames))
    error = log["error_px" if unit == "px" else "error_grey"]
    rows = np.column_stack([error, *(log[f"cmd_{name}"] for name in TWIST)])
    now: list[float] = []
    longest: list[float] = []
    for each in rows[: len(rows) // span * span].reshape(-1, span, 7):
        counts = np.isfinite(each).all() and np.median(each[:, 0]) >= least
        found = period(each[:, 1:]) if counts else 0.0
        now = [*now, found] if found else []
        longest = max(longest, now, key=len)
    if len(longest) < LONG_SPANS:
        return {}
    return {
        "swung_s": len(longest) * span * scenario.camera.period,
        "swing_frames": float(np.median(longest)),
    }
