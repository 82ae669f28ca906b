"""What the controller knows of its robot's own motion while a picture was under way."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from vstestbed.camera import Picture
from vstestbed.core.geometry import Array, inverse
from vstestbed.robots import Mount, Reading, Robot
from vstestbed.robots.allocation import Order
from vstestbed.robots.own_model import OwnModel
from vstestbed.scenario.scenario import Scenario
from vstestbed.timing.setpoints import Between, Blend
from vstestbed.vision.base import TruthView


@dataclass(frozen=True, slots=True)
class Exposure:
    """A picture, with the robot's sensor reading at its exposure. t: of the exposure's middle [s].
    picture: None where no detector asks for one. view: the truth for an oracle; None for every other detector.
    """

    number: int
    t: float
    picture: Picture | None
    reading: Reading
    view: TruthView | None = None


@dataclass(frozen=True, slots=True)
class Arrival:
    """Arrival of a picture: its time [s], when its command will reach the robot [s], and the robot's sensor reading now."""

    t: float
    t_cmd: float
    reading: Reading


REMEMBERED = 500
"""Orders that are kept. The oldest time asked for is that of the last exposure but one, a few orders ago."""


class CommandHistory:
    """The velocities ordered so far (size,), each in force from its time on until the next one.
    between: how the robot goes from one order to the next (`setpoints.Blend`), in the time `over_s`.
    """

    def __init__(self, size: int = 6, between: Between = "hold", over_s: float = 0.0) -> None:
        self._between: Between = between
        self._over_s, rest = over_s, np.zeros(size)
        first = 0.0, self._blend(rest, rest, rest), rest
        self._orders: deque[tuple[float, Blend, Array]] = deque([first], maxlen=REMEMBERED)

    def _blend(self, before: Array, slope: Array, twist: Array) -> Blend:
        return Blend(self._between, before, slope, twist, self._over_s)

    def add(self, t: float, twist: Array) -> None:
        """Velocities (size,) are in force from t [s] on, which is not before the last order; one of the same time takes its place."""
        twist = twist.copy()  # a cycle's, to which its reader may write
        since, before, way = self._orders[-1]
        if t <= since:
            self._orders[-1] = since, self._blend(before.before, before.start, twist), way
        else:
            after = t - since
            self._orders.append((t, self._blend(before.at(after), before.slope(after), twist), way + before.way(after)))

    def displacement(self, t: float) -> Array:
        """Their integral until t, (size,) [m, rad]."""
        for since, blend, way in reversed(self._orders):
            if since <= t:
                return way + blend.way(t - since)
        return self._orders[0][2]


def since_exposure(robot: Robot, mount: Mount, ordered: CommandHistory, shot: Exposure, now: Arrival) -> Array:
    """How far the camera has gone since an exposure (6,), in its own frame [m, rad]; mount: as it is now."""
    # Integrated commands stand in for a robot without sensors of its motion.
    moved, age = ordered.displacement(now.t) - ordered.displacement(shot.t), now.t - shot.t
    if age > 0:
        moved = robot.measured_twist(shot.reading, now.reading, age, moved / age, mount) * age
    return moved


def mount_at(scenario: Scenario, mount: Mount, q: Array) -> Mount:
    """The camera's mount; eye to hand, the camera's pose relative to the flange at the joints q (n,)."""
    if not scenario.target.on_gripper:
        return mount
    return Mount.facing(inverse(scenario.robot.flange_pose(q)) @ mount.T_flange_camera)


class OwnRates:
    """Makes `Observation.robot`, and keeps the velocities that were ordered, one each `period_s`."""

    def __init__(self, robot: Robot, period_s: float, between: Between = "hold"):
        self._robot, self._period_s = robot, period_s
        self._between: Between = between
        self._ordered: CommandHistory | None = None
        self._last = np.zeros(0)
        self._J = np.zeros((6, 0))

    def model(self, last: Exposure, shot: Exposure, now: Arrival, mount: Mount) -> OwnModel:
        """What the controller knows of its robot when a picture has arrived, after the exposures `last` and `shot`."""
        model = self._robot.own_model(now.reading, mount)
        if self._ordered is None:
            self._ordered, self._last = CommandHistory(n := len(model.names), self._between, self._period_s), np.zeros(n)
        self._J = model.J
        moved = self._displacement(last.t, last.reading, shot.t, shot.reading, mount)
        underway = self._displacement(shot.t, shot.reading, now.t, now.reading, mount)
        coming = self._ordered.displacement(now.t_cmd) - self._ordered.displacement(now.t)
        return replace(
            model,
            moved=moved,
            since_s=shot.t - last.t,
            underway=underway + coming,
            coming=coming,
            underway_s=now.t_cmd - shot.t,
            ordered=self._last,
            period_s=self._period_s,
        )

    def _displacement(self, since: float, before: Reading, until: float, after: Reading, mount: Mount) -> Array:
        """How far the velocities have led (n,) between two readings; as ordered where the robot has no sensors of its motion."""
        assert self._ordered is not None
        ordered, duration = self._ordered.displacement(until) - self._ordered.displacement(since), until - since
        if duration <= 0:
            return np.zeros(len(ordered))
        return self._robot.displacement(before, after, duration, self._J @ ordered / duration, mount)

    def order(self, t_cmd: float, order: Order) -> None:
        """An order takes effect at t_cmd [s]."""
        if self._ordered is not None:
            rates = order.rates
            if rates is None:
                rates = np.asarray(np.linalg.lstsq(self._J, order.twist, rcond=None)[0], dtype=float)
            self._last = rates.copy()
            self._ordered.add(t_cmd, rates)
