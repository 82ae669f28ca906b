"""The contract of an effect: what it changes in a robot's model, what it does while a run lasts,
what it writes into the log.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from annotated_types import Len
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.core.registry import Contract, Registry

if TYPE_CHECKING:
    import mujoco

__all__ = [
    "ASSETS",
    "EFFECTS",
    "MOTOR",
    "RANGE_GROUP",
    "Actor",
    "Effect",
    "EffectBase",
    "Four",
    "Further",
    "RobotBody",
    "RobotModel",
    "Sensors",
    "StateIndices",
    "Vector",
    "places_of",
]

Indices = NDArray[np.int_]
Vector = tuple[float, float, float]
Four = tuple[float, float, float, float]  # of rotors front, right, back, left
Sensors = Mapping[str, list[float]]  # readings by name, perfect ones of MuJoCo
ASSETS = "assets"  # folder, in a scene, of the files in memory
RANGE_GROUP = 5  # geoms that range finders alone meet, which nothing draws
# before the name of a joint: that of the joint of its motor, where an effect has parted the two
MOTOR = "rotor_"


@dataclass(frozen=True)
class StateIndices:
    """Indices of one robot's quantities in the state of a scene that may hold two robots.

    Attributes:
        qpos, qvel: of its measured joints, in the order of `Robot.joints`, in `data.qpos` and
            `data.qvel`.
        motor_qpos, motor_qvel: of what its encoders read and its servos turn: `rotor_<joint>`,
            which an effect has added, else the joint.
        ctrl: of its actuators, in the order of `Robot.actuators`, in `data.ctrl`; a slice, which is
            quicker, where they adjoin.
        act: of those actuators that have an activation (an integrating servo, a rotor), in
            `data.act`.
    """

    qpos: Indices
    qvel: Indices
    motor_qpos: Indices
    motor_qvel: Indices
    ctrl: Indices | slice
    act: Indices

    @classmethod
    def of(
        cls, model: mujoco.MjModel, joints: Sequence[str], actuators: Sequence[str], prefix: str
    ) -> StateIndices:
        """The indices of the robot under a prefix (`robot/`, `leader/`)."""
        named = {model.joint(i).name for i in range(model.njnt)}
        links = [prefix + joint for joint in joints]
        motors = []
        for joint, link in zip(joints, links, strict=True):
            motor = f"{prefix}{MOTOR}{joint}"
            motors.append(motor if motor in named else link)
        numbers = np.array([model.actuator(prefix + name).id for name in actuators], dtype=int)
        activations = model.actuator_actadr[numbers]
        ctrl = model.actuator_ctrladr[numbers]
        if len(ctrl) and (np.diff(ctrl) == 1).all():
            ctrl = slice(int(ctrl[0]), int(ctrl[-1]) + 1)
        act = activations[activations >= 0]  # MuJoCo's -1: an actuator without one
        return cls(*places_of(model, links), *places_of(model, motors), ctrl, act)


def places_of(model: mujoco.MjModel, names: Sequence[str]) -> tuple[Indices, Indices]:
    """Where joints of one degree of freedom (n,) are in qpos and in qvel, by their names."""
    # By name, not by number: attached models are renumbered, and a joint's number is not its place
    # in qpos once a free joint, which takes seven places, comes before it.
    found = [model.joint(name) for name in names]
    qpos = [joint.qposadr[0] for joint in found]
    qvel = [joint.dofadr[0] for joint in found]
    return np.array(qpos, dtype=int), np.array(qvel, dtype=int)


@dataclass
class RobotModel:
    """A robot while its scene is composed, before it is attached to it.

    Attributes:
        spec: its own model, in which names have no prefix.
        scene: the scene, with the geom `floor`.
        compiled: its file's model compiled without effects, in which all orientations are
            quaternions.
        joints, actuators: names of those that the robot uses.
        flange: the body that carries the camera.
        T_body_flange: pose of the flange in it (4, 4); an effect may replace it.
        carried: the share of a body's weight that the drives' gravity compensation carries [1].
        assets: files in memory that an effect adds to the scene, by their paths.
    """

    spec: mujoco.MjSpec
    scene: mujoco.MjSpec
    compiled: Callable[[], mujoco.MjModel]
    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    flange: mujoco.MjsBody
    T_body_flange: Array
    carried: float
    assets: dict[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class RobotBody:
    """A robot in the running scene, where all its names have the prefix `robot/`. It is the truth:
    an effect is no part of the controller.

    Attributes:
        model, data: MuJoCo's. They are this run's alone, and an actor may change the model while it
            lasts: `actuator_forcerange` is the largest torque of a drive, which current loops keep
            as well.
        at: where its joints and actuators are.
        step_s: of the physics [s].
        joints, actuators: names without the prefix.
        motor_forces: those of the actors that are `of_motors`; `motor_torque` adds them.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    at: StateIndices
    step_s: float
    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    motor_forces: list[Array] = field(default_factory=list)

    def motor_torque(self) -> Array:
        """Torques (n,) of the motors in the last physics step, referred to the joints [Nm, N]:
        those of the log's `tau_<joint>`.
        """
        tau: Array = self.data.qfrc_actuator[self.at.motor_qvel]
        for force in self.motor_forces:
            tau = tau + force[self.at.motor_qvel]
        return tau


class Actor:
    """What an effect does while a run lasts. The plant calls those methods that a subclass has of
    its own.

    Attributes:
        with_controller: call `act` once in each period of the robot's onboard controller, just
            before the controller runs. Else it is called before each physics step.
        force: generalised forces of this effect, an array (nv,) [Nm, N] of its own, in force until
            it is changed; the plant adds those of all effects. A force F and a torque at a point of
            a body: `self.force[:] = 0`, then
            `mujoco.mj_applyFT(model, data, F, torque, point, body, self.force)`. MuJoCo's own
            `xfrc_applied` belongs to pushes by hand and to tyres. None: it applies none.
        of_motors: `force` is the torque of the motors, which the log's `tau_<joint>` then has
            beside MuJoCo's actuators.
    """

    with_controller: ClassVar[bool] = False
    of_motors: ClassVar[bool] = False
    force: Any = None

    def start(self) -> None:
        """The robot is at its start, in equilibrium."""

    def act(self, t: float, dt: float) -> None:
        """Set `force` for the next dt [s] from the time t [s] on; also while vehicles settle on
        their springs before the start.
        """

    def driven(self, orders: Sequence[float], dt: float) -> Sequence[float]:
        """What reaches the actuators (nu,) of an onboard controller's orders (nu,), for its next
        period of dt [s].
        """
        return orders

    def felt(self, sensors: dict[str, list[float]]) -> dict[str, list[float]]:
        """What the robot's sensors meet: the perfect readings by name, with what the effect adds to
        them. It is called once per instant.
        """
        return sensors

    def row(self) -> Sequence[float]:
        """Values of the effect's `columns` at the present instant."""
        return ()


class Effect:
    """An imperfection of a robot's body or its drives; by default it does nothing.

    columns: of the log, with the values of `Actor.row`; no two effects of a robot may have the
    same.
    uneven: the ground is no plane, and tilts the robot that stands on it.
    """

    columns: ClassVar[tuple[str, ...]] = ()
    uneven: ClassVar[bool] = False

    @property
    def longest_step_s(self) -> float:
        """The longest physics step that it allows [s]."""
        return np.inf

    def check(self, joints: tuple[str, ...]) -> None:
        """Refuse what does not fit a robot with these joints, when a scenario is loaded;
        ParameterError names the field.
        """

    def edit(self, robot: RobotModel) -> None:
        """Change the robot's model when the scene is composed. ParameterError where its file does
        not allow it.
        """

    def settle(self, body: RobotBody, load: Array) -> None:
        """Put what it has added into equilibrium, under what gravity asks of each degree of
        freedom, load (nv,) [Nm, N].

        It may change the load: the servos start with it.
        """

    def actor(self, body: RobotBody, rng: np.random.Generator) -> Actor | None:
        """What it does in one run; None where nothing. rng: a stream of its own."""
        return None

    def springs(self, load: Array) -> tuple[Array, Array] | None:
        """Stiffness and damping (n,) between each motor and its joint, for small motions about a
        load (n,) [Nm]; None without springs.
        """
        return None

    def remedy(self, body: RobotBody, weight: Array, holds: Array) -> tuple[str, str, float] | None:
        """What would work where the load by weight (n,) is more than a joint holds (n,) [Nm, N];
        None for an effect that adds no weight.

        Returns the field, in words what to give there, and its present value.
        """
        return None


EffectBase = Effect
EFFECTS = Registry("effect", contract=Contract(Effect, Effect))
"""Kinds of further effects of a robot, in its list `effects`; those of the package are blocks of
the robots that have them.
"""
Further = Annotated[tuple[Annotated[Effect, EFFECTS], ...], Len(0, 20)]
