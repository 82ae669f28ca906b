"""The columns of a quadrotor's log."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.robots.attitude import level, to_body, to_level
from vstestbed.robots.flight_reading import FlightReading
from vstestbed.robots.robot_log import RobotLog, RobotState
from vstestbed.robots.supervisor import Supervisor

ESTIMATE = ("est_roll", "est_pitch", "est_vx", "est_vy", "est_vz", "est_wx", "est_wy", "est_wz")
REFERENCE = ("ref_roll", "ref_pitch", "ref_wx", "ref_wy", "ref_wz")
WIND = ("wind_x", "wind_y", "wind_z")


class FlightLog(RobotLog):
    """Estimates, references and rotor speeds of a flight.

    `est_roll`, `est_pitch` [rad], `est_vx`, `est_vy`, `est_vz` (level frame) [m/s], `est_wx`, `est_wy`, `est_wz` (body) [rad/s]: the
    craft's own estimate; `ref_roll`, ..., `ref_wz`: references from its velocity loop and its attitude loop; `wind_x`, ... true, in the
    world [m/s]; `speed_NAME`: true, of each rotor [rad/s]; `supervisor`: mode of the failsafe, 0 follows the law, 1 holds, 2 sinks,
    3 rotors off; of a craft with a battery `battery_v`, its voltage as measured [V].

    Args:
        supervisor: the craft's. rotors: names of its actuators. battery: whether it has one.
    """

    def __init__(self, supervisor: Supervisor, rotors: tuple[str, ...], battery: bool = False):
        super().__init__(supervisor)
        more = ("battery_v",) if battery else ()
        self.columns = (*ESTIMATE, *REFERENCE, *WIND, *(f"speed_{name}" for name in rotors), "supervisor", *more)

    def row(self, state: RobotState) -> Array:
        """Values at one exposure."""
        reading = state.reading
        assert isinstance(reading, FlightReading) and reading.tilt is not None
        roll, pitch = reading.tilt.tolist()
        # The level frame is the estimate's own: with the true tilt, an error of tilt would show as one of velocity, too.
        up = (-math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll))
        estimate = reading.estimate
        velocity = to_level(level(up), tuple(estimate.velocity.tolist()))
        loops = np.concatenate([estimate.rates, estimate.ref_tilt, estimate.ref_rates])
        speeds = np.sqrt(np.maximum(state.act, 0.0))  # activations are squared speeds
        row = [roll, pitch, *velocity, *loops, *state.wind, *speeds, self.supervisor.mode, reading.voltage_v]
        return np.array(row[: len(self.columns)])

    def proprioception(self, log: Mapping[str, Array]) -> dict[str, Array]:
        """Tilt and body twist; the velocity back from the estimate's level frame into body axes. The range is not in the log."""
        roll, pitch = log["est_roll"], log["est_pitch"]
        up = zip((-np.sin(pitch)).tolist(), (np.cos(pitch) * np.sin(roll)).tolist(), (np.cos(pitch) * np.cos(roll)).tolist(), strict=True)
        velocities = zip(*(log[f"est_v{axis}"].tolist() for axis in "xyz"), strict=True)
        body = np.array([to_body(level(z), v) for z, v in zip(up, velocities, strict=True)]).reshape(-1, 3)
        rates = {f"w{axis}": log[f"est_w{axis}"] for axis in "xyz"}
        return {"roll": roll, "pitch": pitch, **dict(zip(("vx", "vy", "vz"), body.T, strict=True)), **rates}
