"""A robot's own velocities as its controller knows them: the model now, how far they led since the last picture, what was ordered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.loop.command_history import CommandHistory
from vstestbed.loop.exposure import Arrival, Exposure
from vstestbed.robots import Mount, Reading, Robot
from vstestbed.robots.orders import Order
from vstestbed.robots.own_model import OwnModel
from vstestbed.robots.setpoints import Between


class OwnRates:
    """Makes `Observation.robot`, and keeps the velocities that were ordered.

    Args:
        robot: the robot. period_s: time between pictures [s]. between: how it goes from one order to the next.
    """

    def __init__(self, robot: Robot, period_s: float, between: Between = "hold"):
        self._robot, self._period_s = robot, period_s
        self._between: Between = between
        self._ordered: CommandHistory | None = None
        self._last = np.zeros(0)
        self._J = np.zeros((6, 0))

    def model(self, last: Exposure, shot: Exposure, now: Arrival, mount: Mount) -> OwnModel:
        """What the controller knows of its robot when a picture has arrived.

        last, shot: the last exposure and this one. mount: of the camera now.
        """
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
