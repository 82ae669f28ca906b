"""Excitation: each velocity of a robot in turn to one side, to the other and back, by which the image Jacobian is measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Gt, Le

from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositivePixels, PositiveTime
from vstestbed.core.spec import spec
from vstestbed.laws.image_jacobian import MotionSums
from vstestbed.robots.own_model import OwnModel

FIRST = 0.01
"""The speed that is tried first [rad/s, m/s], or less where the limits ask for it: slow for any robot and picture."""
GROWTH = 2.0
"""Factor on the speed from frame to frame, until the picture moves."""
VISIBLE = 0.2
"""Share of the amplitude from which on the motion in the picture tells how much a velocity moves the markers: well over `RETURNED_PX`, the
rest of the way of the velocity before."""
SLOWEST = 4.0
"""A leg is given up after this many times the time that it should take, latency included: a velocity that the markers do not show."""
NEAREST = 0.02
"""Distance kept from a joint's limit [rad, m]."""
RETURNED_PX = 2.0
"""The way back is over at this distance from its start [px]."""
APPROACH = 4.0
"""The way back ends by an approach with this time constant [periods], which a servo can follow."""
OUT, OVER, BACK = range(3)
LEGS = {OUT: 1.0, OVER: 2.0, BACK: 1.0}
"""Length of each leg: to one side, over to the other, and back."""


@dataclass(frozen=True, slots=True)
class Excited:
    """How far an excitation is.

    Attributes:
        uv: markers (N, 2) [px] at its start; with a target that moves, in the last picture.
        x: displacement since its start (m,), of the robot and, with a target that moves, of time.
        samples: all that was measured. turn: of the velocity that moves, with time (2 columns), where the target may move, too.
        known: motion of the markers per unit of each velocity (m,) [px], 0 where it is unknown.
        uv_before, x_before: markers and displacement of the velocity that moves when its turn began.
        which: its number. leg: out, over or back. side: sign of the way out. speed: its magnitude. pixels: motion of the markers per
            unit of it [px], 0 where it is not known yet. elapsed_s: since the leg began.
    """

    uv: Array
    x: Array
    samples: MotionSums
    turn: MotionSums
    known: Array
    uv_before: Array
    x_before: float = 0.0
    which: int = 0
    leg: int = OUT
    side: float = 0.0
    speed: float = 0.0
    pixels: float = 0.0
    elapsed_s: float = 0.0


@spec
class Excitation:
    """The motion by which an uncalibrated law measures its image Jacobian before it servoes, and again where it makes no progress.

    A velocity begins slowly, and grows until the markers move. From then on it is so fast that its way of twice the amplitude takes
    `time_s`, and it turns where the markers are expected half the amplitude from where they began, pictures and commands that are
    underway included; also where a joint nears its limit, or a marker is lost. The two sides cancel the curvature of the markers' ways.

    Args:
        amplitude_px: mean way of the markers from one side to the other [px].
        time_s: time for one velocity [s]; a robot's limits may make it longer.
        speed_share: largest share of a velocity's own limit [1].
    """

    amplitude_px: PositivePixels = 20.0
    time_s: PositiveTime = 0.4
    speed_share: Annotated[float, Gt(0), Le(1)] = 0.2

    def begin(self, uv: Array, columns: int, known: Array) -> Excited:
        """Before its first motion.

        Args:
            uv: markers (N, 2) [px]. columns: of the image Jacobian. known: motion of the markers per unit of each (m,) [px], 0: unknown.
        """
        return Excited(
            uv, np.zeros(columns), MotionSums.none(len(uv), columns), MotionSums.none(len(uv), 2), known, uv, pixels=float(known[0])
        )

    def step(self, state: Excited, uv: Array, moved: Array, robot: OwnModel) -> tuple[Excited, Array | None]:
        """One frame: the next state, and the velocities (n,) to order; None when all have moved.

        Args:
            state: so far. uv: markers (N, 2) [px]. moved: displacement (m,) since the last picture, the robot's first. robot: its own.
        """
        state = self._sampled(state, uv, moved, len(robot.names))
        state = replace(state, elapsed_s=state.elapsed_s + robot.since_s, pixels=self._pixels(state, uv, len(robot.names)))
        while state.which < len(robot.names) and self._leg_ends(state, uv, robot):
            state = _next_leg(state, uv)
        if state.which == len(robot.names):
            return state, None
        return self._ordered(state, robot)

    def retreat(self, state: Excited, moved: Array, robot: OwnModel) -> tuple[Excited, Array]:
        """A frame that shows too few markers: back to where the velocity's turn began and they were in sight, by the robot's sensors.

        Args and result are those of `step`.
        """
        uv = state.uv if len(state.x) == len(robot.names) else np.full_like(state.uv, np.nan)  # of a target that moves: what comes next
        return self._ordered(replace(state, uv=uv, x=state.x + moved, leg=BACK), robot)

    def _sampled(self, state: Excited, uv: Array, moved: Array, n: int) -> Excited:
        """The state with one more sample: since the start, where noise counts least, or from picture to picture, where a target moves."""
        x = state.x + moved
        if len(x) == n:
            return replace(state, x=x, samples=state.samples.with_one(x, uv - state.uv))
        y = uv - state.uv
        turn = state.turn.with_one(moved[[state.which, n]], y)
        return replace(state, x=x, samples=state.samples.with_one(moved, y), turn=turn, uv=uv)

    def _pixels(self, state: Excited, uv: Array, n: int) -> float:
        """Mean motion of the markers per unit of the velocity that moves [px]; as before where it is too small to tell."""
        x = abs(float(state.x[state.which]) - state.x_before)
        if state.leg != OUT or x == 0:
            return state.pixels
        if len(state.x) == n:
            per_unit = np.linalg.norm(uv - state.uv_before, axis=1) / x
        else:
            per_unit = np.linalg.norm(state.turn.jacobian()[:, :, 0], axis=1)
        per_unit = per_unit[np.isfinite(per_unit)]
        if not len(per_unit) or per_unit.mean() * x < VISIBLE * self.amplitude_px:
            return state.pixels
        return float(per_unit.mean())

    def _leg_ends(self, state: Excited, uv: Array, robot: OwnModel) -> bool:
        """Whether the velocity that moves has come far enough, cannot go on, or takes too long."""
        if state.elapsed_s > SLOWEST * (LEGS[state.leg] * self.time_s / 4 + robot.underway_s):
            return True
        ahead = _ahead(state, robot)
        if state.leg == BACK:
            # Also in the picture, or the rest of this way would count as the next velocity's.
            return max(abs(ahead), abs(float(robot.underway[state.which]))) * state.pixels <= RETURNED_PX
        side = _side(state, robot)
        lost = side * ahead > 0 and not np.isfinite(uv[np.isfinite(state.uv_before[:, 0])]).all()
        return lost or side * ahead * state.pixels >= self.amplitude_px / 2 or _room(state.which, side, robot) <= NEAREST

    def _ordered(self, state: Excited, robot: OwnModel) -> tuple[Excited, Array]:
        """The velocities to order."""
        i, side = state.which, _side(state, robot)
        most = self.speed_share * float(robot.speed[i])
        speed = max(state.speed, min(FIRST, most))
        if state.pixels:
            speed = 2 * self.amplitude_px / (self.time_s * state.pixels)
        elif state.speed and abs(state.x[i] - state.x_before) >= abs(robot.underway[i]):
            speed = GROWTH * speed  # not before the picture has shown what was ordered
        state = replace(state, speed=min(speed, most), side=side if state.leg == OUT else state.side)
        rates = np.zeros(len(robot.names))
        if state.leg == BACK:
            rates[i] = np.clip(-_ahead(state, robot) / (APPROACH * robot.period_s), -state.speed, state.speed)
        else:
            rates[i] = side * state.speed
        return state, rates


def _next_leg(state: Excited, uv: Array) -> Excited:
    """The next side, or the next velocity."""
    if state.leg < BACK:
        return replace(state, leg=state.leg + 1, elapsed_s=0.0)
    which = state.which + 1
    if which == len(state.x):
        return replace(state, which=which)  # all have moved
    before = float(state.x[which])
    return replace(
        state,
        which=which,
        leg=OUT,
        side=0.0,
        speed=state.speed / 4,
        pixels=float(state.known[which]),
        elapsed_s=0.0,
        uv_before=uv,
        x_before=before,
    )


def _ahead(state: Excited, robot: OwnModel) -> float:
    """Displacement of the velocity that moves, since its turn began, when this frame's command will take effect."""
    return float(state.x[state.which] - state.x_before + robot.underway[state.which])


def _side(state: Excited, robot: OwnModel) -> float:
    """The direction of this leg; at first to where a joint has more room."""
    i = state.which
    side = state.side or (1.0 if _room(i, 1.0, robot) >= _room(i, -1.0, robot) else -1.0)
    return side if state.leg == OUT else -side


def _room(i: int, side: float, robot: OwnModel) -> float:
    """Distance of a velocity's position from its limit on one side [rad, m]."""
    return float(robot.high[i] - robot.q[i] if side > 0 else robot.q[i] - robot.low[i])
