"""The lead vehicle, which carries the target along a route, with path following by its true place."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from vstestbed.core.planar import place_of, relative
from vstestbed.robots import Mount
from vstestbed.robots.reading import Reading
from vstestbed.sim.scene.indices import StateIndices
from vstestbed.sim.scene.stage import Stage

PERIOD_S = 0.01
"""Period of the path following [s], that of a car's onboard servos."""
CROSS_GAIN, HEADING_GAIN = 1.5, 2.5
"""Gains of lateral offset [1/m^2] and heading error [1/m], overdamped: poles -1 and -1.5 [1/m]. The offset decays within some 1.6 m."""


class LeadVehicle:
    """Drives the target's vehicle: w = v (curvature - CROSS_GAIN offset - HEADING_GAIN (heading - route's)).

    That is linear feedback along the path: offset'' + HEADING_GAIN offset' + CROSS_GAIN offset = 0 by arc length.

    Args:
        stage: the scene with the vehicle under `leader/`.

    Reference: Samson 1995, path following in arc length, doi:10.1109/9.362899.
    """

    def __init__(self, stage: Stage):
        motion = stage.parts.target.carrier
        if motion is None or stage.leader is None or stage.parts.leader is None:
            raise TypeError("no vehicle carries the target")
        self._stage, self._motion, self._root = stage, motion, stage.leader
        self._robot = stage.parts.leader
        self._mount = Mount.of(np.eye(4))
        self._at = StateIndices.of(stage.model, self._robot, "leader/")
        self._memory: Any = self._robot.begin()
        self._s = motion.from_m
        self.steps = max(1, round(PERIOD_S / stage.parts.step))

    def drive(self, dt: float) -> None:
        """One period dt [s] of the path following."""
        place = place_of(self._root.pose(self._stage.data))
        route = self._motion.route
        # Near its last arc length, since the route may cross itself: .5 m is far more than it drives in a period.
        self._s, _ = route.nearest(place[:2], around=self._s, reach=0.5)
        x, y, heading, curvature = route.at(self._s)
        _, offset, turn = relative(np.array([x, y, heading]), place)
        v = self._motion.speed_mps
        # curvature / (1 - curvature offset) is that of the parallel on which it drives; bounded near the centre of the bend.
        w = v * (curvature / max(1 - curvature * offset, 0.1) - CROSS_GAIN * offset - HEADING_GAIN * math.sin(turn))
        twist = np.array([v, 0.0, 0.0, 0.0, 0.0, w])
        data = self._stage.data
        reading = Reading(data.qpos[self._at.qpos], data.qvel[self._at.qvel])
        setpoint = self._robot.allocate(twist, reading, self._mount, dt).setpoint
        self._memory, data.ctrl[self._at.ctrl] = self._robot.actuate(self._memory, setpoint, reading, dt)
