"""What a robot measures of itself: its joints and MJCF sensors, through its own instruments' noise."""

from __future__ import annotations

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.robots.reading import Reading
from vstestbed.sim.scene.stage import Stage


class SensorReader:
    """Reads a robot's joints and MJCF sensors; the same reading until time passes, so that noise is drawn once an instant.

    Args:
        stage: the scene. rng: where noise comes from.
    """

    def __init__(self, stage: Stage, rng: np.random.Generator):
        self._stage, self._rng = stage, rng
        self._robot = stage.parts.robot
        self._sensors = []
        for name in self._robot.sensors:
            sensor = stage.model.sensor(f"robot/{name}")
            self._sensors.append((name, slice(sensor.adr[0], sensor.adr[0] + sensor.dim[0])))
        self._read_at = -1
        self._reading: Reading | None = None

    def joints(self) -> tuple[Array, Array]:
        """True joint positions and speeds (n,) each."""
        data = self._stage.data
        return data.qpos[self._stage.at.qpos], data.qvel[self._stage.at.qvel]

    def restart(self) -> None:
        """Forget the last reading."""
        self._read_at = -1

    def read(self, step: int) -> Reading:
        """What the robot's instruments tell at a physics step."""
        if step != self._read_at or self._reading is None:
            q, qd = self.joints()
            data = self._stage.data.sensordata
            sensors = {name: data[where].copy() for name, where in self._sensors}
            self._reading, self._read_at = self._robot.measured(q, qd, sensors, self._rng), step
        return self._reading
