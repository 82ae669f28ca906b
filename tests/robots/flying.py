"""The quadrotor in the world, flown by its own stack: MuJoCo around `Quadrotor`, as a plant would do it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from vstestbed.geometry import Array
from vstestbed.observation import Encoders
from vstestbed.robots.quadrotor import Flight, Imu, Quadrotor
from vstestbed.robots.groundspeed import Flow

MODELS = Path(__file__).parents[2] / "models"
PERFECT = Imu(gyro_sigma_radps=0, gyro_bias_radps=(0, 0, 0), accel_sigma_mps2=0, accel_bias_mps2=(0, 0, 0))
EXACT = Flow(sigma_mps=0)
AIR = 1.184


def compose(timestep: float = 0.001, density: float = AIR) -> mujoco.MjModel:
    """The craft in the world under `robot/`; sim/scene does the same."""
    world = mujoco.MjSpec.from_file(str(MODELS / "world.xml"))
    craft = mujoco.MjSpec.from_file(str(MODELS / "quadrotor.xml"))
    craft.option.timestep = world.option.timestep = timestep
    craft.option.density = world.option.density = density
    world.attach(craft, prefix="robot/", frame=world.worldbody.add_frame())
    return world.compile()


@dataclass(frozen=True)
class Log:
    """One row a control step: t (n,), position, world velocity, level velocity, body rates, roll-pitch-yaw, all (n, 3), ctrl (n, 4)."""

    t: Array
    position: Array
    velocity: Array
    level: Array
    rates: Array
    rpy: Array
    ctrl: Array
    memory: list[Flight]


class Flown:
    """A craft in flight; `fly` goes on from where it is."""

    def __init__(self, robot: Quadrotor, seed: int = 0, density: float = AIR):
        self.robot, self.model = robot, compose(density=density)
        self.data, self.rng, self.memory = mujoco.MjData(self.model), np.random.default_rng(seed), robot.begin()
        x, y, z, yaw = robot.configuration()
        self.data.qpos[:] = [x, y, z, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
        self.data.act[:] = self.data.ctrl[:] = robot.rest_ctrl()
        mujoco.mj_forward(self.model, self.data)
        self._slices = {
            name: slice(int(self.model.sensor(f"robot/{name}").adr[0]), int(self.model.sensor(f"robot/{name}").adr[0] + self.model.sensor(f"robot/{name}").dim[0]))
            for name in robot.sensors
        }

    def encoders(self) -> Encoders:
        """What the craft measures now."""
        raw = Encoders(np.zeros(0), np.zeros(0), {name: self.data.sensordata[at].copy() for name, at in self._slices.items()})
        return self.robot.measured(raw, self.rng)

    def turn(self, roll: float = 0.0, pitch: float = 0.0, known: bool = True) -> None:
        """Put the craft at a tilt [rad], which its filter knows or not."""
        yaw = self.robot.configuration()[3]
        R = _rz(yaw) @ _ry(pitch) @ _rx(roll)
        mujoco.mju_mat2Quat(self.data.qpos[3:7], R.ravel())
        mujoco.mj_forward(self.model, self.data)
        if known:
            self.memory = self.memory._replace(attitude=self.memory.attitude._replace(up=tuple(R[2].tolist())))

    def fly(self, setpoint: Array | Callable[[float], Array], duration: float, wind: Callable[[float], Array] | None = None) -> Log:
        """Fly for a time [s] under a setpoint (4,), or one that is a function of time; wind (3,) [m/s] likewise."""
        model, data, dt = self.model, self.data, 0.001
        rows: list[tuple[Array, ...]] = []
        memory: list[Flight] = []
        for k in range(round(duration / dt)):
            order = setpoint(k * dt) if callable(setpoint) else setpoint
            if wind is not None:
                model.opt.wind[:] = wind(k * dt)
            self.memory, data.ctrl[:] = self.robot.actuate(self.memory, np.asarray(order, dtype=float), self.encoders(), dt)
            mujoco.mj_step2(model, data)
            mujoco.mj_step1(model, data)
            rows.append(self._row())
            memory.append(self.memory)
        position, velocity, level, rates, rpy, ctrl = (np.array(column) for column in zip(*rows, strict=True))
        return Log(np.arange(1, len(rows) + 1) * dt, position, velocity, level, rates, rpy, ctrl, memory)

    def _row(self) -> tuple[Array, ...]:
        data = self.data
        R = data.body("robot/base").xmat.reshape(3, 3)
        yaw = np.arctan2(R[1, 0], R[0, 0])
        rpy = np.array([np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(np.clip(R[2, 0], -1, 1)), yaw])
        v = data.qvel[:3].copy()
        return data.qpos[:3].copy(), v, _rz(yaw).T @ v, data.qvel[3:].copy(), rpy, data.ctrl.copy()


def _rx(a: float) -> Array:
    return np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])


def _ry(a: float) -> Array:
    return np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])


def _rz(a: float) -> Array:
    return np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
