"""Sensor readings of a robot: joints and MJCF sensors, with the noise of its sensor model."""

from __future__ import annotations

from typing import Any

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.sim.scene.disturbed import Disturbed
from vstestbed.sim.scene.stage import Stage

NONE = np.zeros(0)


class SensorReader:
    """Reads a robot's joints and MJCF sensors, once for each physics step.

    Args:
        stage: the scene. rng: generator of the noise. disturbed: adds to what the sensors meet; None for nothing.
    """

    def __init__(self, stage: Stage, rng: np.random.Generator, disturbed: Disturbed | None = None):
        self._robot, self._data, self._values = stage.parts.robot, stage.data, stage.data.sensordata
        self._at = stage.at if self._robot.joints else None
        self._noise, self._disturbed = self._robot.noise(rng), disturbed
        self._sensors = []
        for name in self._robot.sensors:
            sensor = stage.model.sensor(f"robot/{name}")
            self._sensors.append((name, slice(sensor.adr[0], sensor.adr[0] + sensor.dim[0])))
        self._read_at = -1
        self._reading: Any = None

    def joints(self) -> tuple[Array, Array]:
        """True joint positions and speeds (n,) each."""
        at, data = self._at, self._data
        return (NONE, NONE) if at is None else (data.qpos[at.qpos], data.qvel[at.qvel])

    def _motors(self) -> tuple[Array, Array]:
        """True positions and speeds (n,) each of what the encoders are on."""
        at, data = self._at, self._data
        return (NONE, NONE) if at is None else (data.qpos[at.motor_qpos], data.qvel[at.motor_qvel])

    def restart(self) -> None:
        """Forget the last reading."""
        self._read_at = -1

    def read(self, step: int) -> Any:
        """What the sensors read at a physics step (`Robot.measured`)."""
        # Cached: a second reading of the same instant must not draw other noise, which could be averaged out.
        if step != self._read_at:
            values = self._values.tolist()
            sensors = {name: values[where] for name, where in self._sensors}
            if self._disturbed is not None:
                sensors = self._disturbed.felt(sensors)
            self._reading, self._read_at = self._robot.measured(*self._motors(), sensors, self._noise), step
        return self._reading
