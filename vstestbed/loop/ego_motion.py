"""What the controller knows of its robot's own motion while a picture was under way."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vstestbed.camera import Picture
from vstestbed.core.geometry import Array, inverse
from vstestbed.robots import Mount, Reading, Robot
from vstestbed.robots.allocation import Order
from vstestbed.robots.arm import Arm
from vstestbed.robots.own_model import OwnModel
from vstestbed.scenario.scenario import Scenario
from vstestbed.timing.setpoints import Mode, Profile
from vstestbed.vision.base import TruthView

__all__ = ["CommandHistory", "Exposure", "OwnRates", "believed_mount", "mount_at", "start_basis"]


class Exposure(NamedTuple):
    """A picture, with the robot's sensor reading at its exposure. t: of the exposure's middle [s].
    picture: None where no detector asks for one. view: the truth for an oracle; None for every
    other detector.
    """

    number: int
    t: float
    picture: Picture | None
    reading: Reading
    view: TruthView | None = None


# Commands that are kept. The oldest time asked for is that of the last exposure but one, a few
# commands ago.
REMEMBERED = 500


class CommandHistory:
    """The velocities ordered so far (size,), each in force from its time on until the next one.
    mode: how the robot goes from one to the next (`setpoints.Profile`), in the time `over_s`.
    Arrays are kept, not copied.
    """

    def __init__(self, size: int = 6, mode: Mode = "hold", over_s: float = 0.0) -> None:
        self._mode: Mode = mode
        self._over_s = over_s
        rest = np.zeros(size)
        first = 0.0, Profile(mode, rest, rest, rest, over_s), rest
        self._commands: deque[tuple[float, Profile, Array]] = deque([first], maxlen=REMEMBERED)

    def add(self, t: float, twist: Array) -> None:
        """Velocities (size,) are in force from t [s] on, in place of all that were to be from then
        on; before the first one it rested.
        """
        while len(self._commands) > 1 and t < self._commands[-1][0]:
            self._commands.pop()
        since, before, way = self._commands[-1]
        if t <= since:
            profile = Profile(self._mode, before.before, before.start, twist, self._over_s)
            self._commands[-1] = t, profile, way
            return
        after = t - since
        # of a command that is held it stays zero
        slope = before.slope(after) if before.duration else before.start
        profile = Profile(self._mode, before.at(after), slope, twist, self._over_s)
        self._commands.append((t, profile, way + before.way(after)))

    def displacement(self, t: float) -> Array:
        """Their integral until t, (size,) [m, rad]."""
        for since, profile, way in reversed(self._commands):
            if since <= t:
                return way + profile.way(t - since)
        return self._commands[0][2]


def mount_at(scenario: Scenario, mount: Mount, q: Array) -> Mount:
    """The camera's mount; eye to hand, the camera's pose relative to the flange at the joints q
    (n,).
    """
    if not scenario.target.on_gripper:
        return mount
    return Mount.facing(inverse(scenario.robot.flange_pose(q)) @ mount.T_flange_camera)


def believed_mount(scenario: Scenario) -> Mount:
    """The mount of a scenario's camera as the robot knows it."""
    return Mount.of(scenario.believed_camera.mount.T)


def start_basis(scenario: Scenario) -> Array:
    """The camera twists (6, n) of the robot's motions at its start, as the robot knows them."""
    robot = scenario.robot
    return robot.motion_basis(believed_mount(scenario), robot.start_joints())


class OwnRates:
    """Makes `Observation.robot`, and keeps the velocities that were ordered,
    one each `period_s`.
    """

    def __init__(self, robot: Robot, period_s: float, mode: Mode = "hold"):
        self._robot = robot
        self._period_s = period_s
        self._mode: Mode = mode
        self._ordered: CommandHistory | None = None
        self._last = np.zeros(0)
        self._J = np.zeros((6, 0))

    def model(
        self, last: Exposure, shot: Exposure, t: float, t_cmd: float, reading: Reading, mount: Mount
    ) -> OwnModel:
        """What the controller knows of its robot when a picture has arrived, after the exposures
        `last` and `shot`. t, t_cmd, reading: as of `Controller.arrive`.
        """
        model = self._robot.own_model(reading, mount)
        if self._ordered is None:
            self._last = np.zeros(len(model.names))
            self._ordered = CommandHistory(len(model.names), self._mode, self._period_s)
        self._J = model.J
        moved = self._displacement(last.t, last.reading, shot.t, shot.reading, mount)
        underway = self._displacement(shot.t, shot.reading, t, reading, mount)
        coming = self._ordered.displacement(t_cmd) - self._ordered.displacement(t)
        return replace(
            model,
            moved=moved,
            since_s=shot.t - last.t,
            underway=underway + coming,
            coming=coming,
            underway_s=t_cmd - shot.t,
            ordered=self._last,
            period_s=self._period_s,
        )

    def _displacement(
        self, since: float, before: Reading, until: float, after: Reading, mount: Mount
    ) -> Array:
        """How far the velocities have led (n,) between two readings; as ordered where the robot has
        no sensors of its motion.
        """
        assert self._ordered is not None
        ordered = self._ordered.displacement(until) - self._ordered.displacement(since)
        duration = until - since
        if duration <= 0:
            return np.zeros(len(ordered))
        if isinstance(self._robot, Arm):
            return after.q - before.q
        twist = self._robot.measured_twist(
            before, after, duration, self._J @ ordered / duration, mount
        )
        return _solved(self._robot.motion_basis(mount, after.q), twist * duration)

    def order(self, t_cmd: float, order: Order) -> None:
        """An order takes effect at t_cmd [s]."""
        if self._ordered is not None:
            rates = _solved(self._J, order.twist) if order.rates is None else order.rates
            self._last = rates
            self._ordered.add(t_cmd, rates)


def _solved(J: Array, twist: Array) -> Array:
    """The smallest velocities along the columns of J that make a twist, by least squares."""
    return np.asarray(np.linalg.lstsq(J, twist, rcond=None)[0], dtype=float)
