"""The quadrotor in the world, flown by its own stack:
MuJoCo round `Quadrotor`, as a plant does it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.robots.attitude import Imu
from vstestbed.robots.flight import Instruments
from vstestbed.robots.flight_sensors import Flow
from vstestbed.robots.quadrotor import Flight, FlightPose, FlightStart, Quadrotor

MODELS = Path(__file__).parents[2] / "models"
AIR = 1.184
DT = 0.001
QUIET = Imu(
    gyro_sigma_radps=0, gyro_bias_radps=(0, 0, 0), accel_sigma_mps2=0, accel_bias_mps2=(0, 0, 0)
)


def perfect(height: float = 10.0, **given: object) -> Quadrotor:
    """A craft whose instruments do not err, so that a loop's own response shows."""
    start = FlightStart(nominal=FlightPose(xyz=(0, 0, height)))
    return Quadrotor(**({"imu": QUIET, "velocity": Flow(sigma_mps=0), "start": start} | given))


@dataclass(frozen=True)
class Log:
    """The truth, one row a control step: t (n,); position, velocity (world), level velocity, body
    rates, roll-pitch-yaw (n, 3); ctrl (n, 4); and the memory on board.
    """

    t: Array
    position: Array
    velocity: Array
    level: Array
    rates: Array
    rpy: Array
    ctrl: Array
    state: list[Flight]

    @property
    def tilt(self) -> Array:
        """Angle between the craft's z and the world's [rad]."""
        return np.arccos(np.clip(np.cos(self.rpy[:, 0]) * np.cos(self.rpy[:, 1]), -1, 1))


class Flown:
    """A craft in flight; `fly` goes on from where it is."""

    def __init__(self, robot: Quadrotor, seed: int = 0):
        self.robot, self.body, self.sense, self.state = (
            robot,
            robot.body,
            robot.instruments(np.random.default_rng(seed)),
            robot.begin(),
        )
        world = mujoco.MjSpec.from_file(str(MODELS / "world.xml"))
        world.option.timestep, world.option.density = DT, AIR
        craft = mujoco.MjSpec.from_file(str(MODELS / robot.body.file))
        craft.option.timestep, craft.option.density = DT, AIR
        world.attach(craft, prefix="robot/", frame=world.worldbody.add_frame())
        self.model = world.compile()
        self.data = mujoco.MjData(self.model)
        x, y, z, yaw = robot.configuration()
        self.data.qpos[:] = [x, y, z, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
        self.data.act[:] = self.data.ctrl[:] = robot.body.rest_ctrl
        mujoco.mj_forward(self.model, self.data)

    @property
    def R(self) -> Array:
        """R_world_base (3, 3), true."""
        return self.data.body("robot/base").xmat.reshape(3, 3)

    def reading(self) -> Instruments:
        """What the craft measures now."""
        sensors = {
            name: self.data.sensor(f"robot/{name}").data.tolist() for name in self.body.sensors
        }
        return self.sense(np.zeros(0), np.zeros(0), sensors)

    def tilt(self, roll: float, pitch: float = 0.0) -> None:
        """Put the craft at a tilt [rad], which its filter knows."""
        c, s, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
        R = np.array([[cp, sp * s, sp * c], [0, c, -s], [-sp, cp * s, cp * c]])
        mujoco.mju_mat2Quat(self.data.qpos[3:7], R.ravel())
        mujoco.mj_forward(self.model, self.data)
        self.state = self.state._replace(
            attitude=self.state.attitude._replace(up=tuple(R[2].tolist()))
        )

    def step(self) -> None:
        """One physics step, sensors of the new instant."""
        mujoco.mj_step2(self.model, self.data)
        mujoco.mj_step1(self.model, self.data)

    def fly(
        self, order: object, duration: float, wind: Callable[[float], object] | None = None
    ) -> Log:
        """Fly for a time [s] under a setpoint (4,); wind (3,) [m/s] as a function of time."""
        setpoint, rows, state = np.asarray(order, dtype=float), [], []
        for k in range(round(duration / DT)):
            if wind is not None:
                self.model.opt.wind[:] = wind(k * DT)
            self.state, self.data.ctrl[:] = self.robot.actuate(
                self.state, setpoint, self.reading(), DT
            )
            self.step()
            rows.append(self._row())
            state.append(self.state)
        a = np.array(rows)
        return Log(
            np.arange(1, len(a) + 1) * DT,
            a[:, :3],
            a[:, 3:6],
            a[:, 6:9],
            a[:, 9:12],
            a[:, 12:15],
            a[:, 15:],
            state,
        )

    def _row(self) -> list[float]:
        R, (vx, vy, vz) = self.R, self.data.qvel[:3].tolist()
        yaw = np.arctan2(R[1, 0], R[0, 0])
        c, s = np.cos(yaw), np.sin(yaw)
        rpy = [np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(max(-1.0, min(1.0, R[2, 0]))), yaw]
        level = [c * vx + s * vy, c * vy - s * vx, vz]
        return [*self.data.qpos[:3], vx, vy, vz, *level, *self.data.qvel[3:], *rpy, *self.data.ctrl]


@dataclass(frozen=True)
class Response:
    """A step response: 10 to 90 % rise [s], overshoot and final error as parts of the step, time to
    stay within 5 % [s].
    """

    rise: float
    overshoot: float
    error: float
    settled: float

    @classmethod
    def of(cls, t: Array, y: Array, step: float) -> Response:
        """Of a recorded output y (n,) that went from 0 towards `step`."""
        y = y / step
        outside = np.nonzero(np.abs(y - 1) > 0.05)[0]
        rise = float(t[np.argmax(y > 0.9)] - t[np.argmax(y > 0.1)])
        return cls(
            rise,
            float(y.max() - 1),
            float(y[-1] - 1),
            float(t[outside[-1]]) if len(outside) else 0.0,
        )
