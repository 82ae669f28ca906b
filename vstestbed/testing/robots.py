"""What every robot must do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.registry import Contract, Registry
from vstestbed.features import ThetaU
from vstestbed.robots import Mount, Robot
from vstestbed.robots.allocation import differs
from vstestbed.robots.base import Reading

# difference by which a configuration is moved [rad or m]: the quotient then has 9 digits
STEP = 1e-6
HUGE = 1e4  # factor on a twist that no real robot can make
# A mount with all coordinates, of a camera over the floor that looks along x.
OVER_FLOOR = np.array([[0, 0, 1, 0.1], [-1, 0, 0, -0.05], [0, -1, 0, 0.4], [0, 0, 0, 1]])


def check_contract(registry: Registry, member: object) -> None:
    """Refuse a kind that lacks what each of its registry must have."""
    assert registry.contract is not None
    registry.contract.check(type(member))


def must_refuse(build: Callable[[], object], words: str) -> None:
    """Raise AssertionError with these words where a call raises no ParameterError."""
    try:
        build()
    except ParameterError:
        return
    raise AssertionError(words)


def check_robot(robot: Robot, T_flange_camera: Array | None = None, seed: int = 0) -> None:
    """A robot's motions agree with its kinematics, for any mount (4, 4); its allocation stays
    within limits, its start is where it says.
    """
    Contract(Robot, base=Robot).check(type(robot))
    rng = np.random.default_rng(seed)
    mount = Mount.of(OVER_FLOOR if T_flange_camera is None else T_flange_camera)
    _check_start(robot, rng)
    _check_motions(robot, mount)
    _check_allocation(robot, mount, rng)
    if len(robot.joints) == robot.configuration().size:
        _check_joints(robot, mount, rng)


def _check_start(robot: Robot, rng: np.random.Generator) -> None:
    configuration = robot.configuration()
    same = robot.started_at(configuration)
    error = np.abs(robot.flange_pose(same.configuration()) - robot.flange_pose(configuration)).max()
    assert error < 1e-9, (
        f"{robot.kind}: started_at(configuration()) must stand where it stood,"
        f" it is {error:.2g} off"
    )
    n = len(robot.start_joints())
    joints = len(robot.joints)
    assert n == joints, (
        f"{robot.kind}: start_joints() must have one angle for each of its {joints} joints, got {n}"
    )
    if robot.start.random is None:
        must_refuse(
            lambda: robot.randomised(rng),
            f"{robot.kind}: without a random block randomised() must raise ParameterError",
        )


def _check_motions(robot: Robot, mount: Mount) -> None:
    """The motions lie in what finite differences of the flange's pose show to be possible; all of
    it, of a robot with joints.
    """
    q = robot.start_joints()
    basis = robot.motion_basis(mount, q)
    assert basis.shape[0] == 6, (
        f"{robot.kind}: motion_basis must have shape (6, n), got {basis.shape}"
    )
    rank = np.linalg.matrix_rank(basis)
    assert rank == basis.shape[1], (
        f"{robot.kind}: motion_basis must have independent columns,"
        f" {basis.shape[1]} have rank {rank}; six of a redundant arm are np.eye(6)"
    )
    possible = mount.to_camera @ _twists(robot, robot.configuration())
    outside = basis - possible @ np.linalg.lstsq(possible, basis, rcond=1e-9)[0]
    worst = float(np.abs(outside).max())
    assert worst < 1e-4, (
        f"{robot.kind}: motion_basis has a motion"
        f" that its flange_pose does not make (by {worst:.2g})"
    )
    if robot.base == "fixed" and robot.joints:  # a camera without mass may leave some out
        reach = np.linalg.matrix_rank(possible, tol=1e-4)
        assert rank >= reach, (
            f"{robot.kind}: its joints make {reach} independent twists, motion_basis has {rank}"
        )


def _twists(robot: Robot, q: Array) -> Array:
    """Flange twists (6, m), (v, w) in the flange's frame, of each coordinate of the configuration,
    by central differences.
    """
    if q.size == 16:  # a flat pose: what moves anywhere
        return np.eye(6)
    T = robot.flange_pose(q)
    columns = []
    for i in range(len(q)):
        step = STEP * (np.arange(len(q)) == i)
        before = robot.flange_pose(q - step)
        after = robot.flange_pose(q + step)
        turn = ThetaU().measure(before[:3, :3].T @ after[:3, :3])
        v = T[:3, :3].T @ (after[:3, 3] - before[:3, 3])
        columns.append(np.concatenate([v, T[:3, :3].T @ before[:3, :3] @ turn]) / (2 * STEP))
    return np.array(columns).T


def _check_joints(robot: Robot, mount: Mount, rng: np.random.Generator) -> None:
    """Of an arm, whose configuration is its joint angles: away from the start too, twists measured
    and made are those of its joints.
    """
    for _ in range(5):
        q = robot.configuration() + rng.uniform(-0.2, 0.2, len(robot.joints))
        J = mount.to_camera @ _twists(robot, q)
        dq = rng.normal(0, 0.1, len(q))
        dt = 1e-4
        before = Reading(q - dq * dt / 2, dq)
        now = Reading(q + dq * dt / 2, dq)
        measured = robot.measured_twist(before, now, dt, np.zeros(6), mount)
        error = float(np.abs(measured - J @ dq).max())
        assert error < 1e-4, (
            f"{robot.kind}: measured_twist differs by {error:.2g} from what its"
            " joints do by flange_pose"
        )
        basis = robot.motion_basis(mount, q)
        outside = float(np.abs(J - basis @ np.linalg.lstsq(basis, J, rcond=1e-9)[0]).max())
        assert outside < 1e-4, (
            f"{robot.kind}: at another configuration its joints make a twist (by {outside:.2g})"
            " that motion_basis lacks"
        )
        made = robot.allocate(J @ dq, Reading(q, np.zeros_like(q)), mount, 0.04)
        if made.setpoint.shape == q.shape:
            error = float(np.abs(made.twist - J @ made.setpoint).max())
            assert error < 1e-4, (
                f"{robot.kind}: allocate says a twist"
                f" that its setpoint does not make (by {error:.2g})"
            )


def _check_allocation(robot: Robot, mount: Mount, rng: np.random.Generator) -> None:
    """What an allocation says that it makes lies in the motions; it is never more than was asked
    for, and limits hold.
    """
    reading = _reading(robot)
    basis = robot.motion_basis(mount, reading.q)
    for _ in range(20):
        twist = basis @ rng.normal(0, 0.05, basis.shape[1])
        made = robot.allocate(twist, reading, mount, 0.04)
        assert np.isfinite(made.setpoint).all(), (
            f"{robot.kind}: a setpoint must be finite, got {made.setpoint}"
        )
        assert -1e-12 <= made.scale <= 1 + 1e-12, (
            f"{robot.kind}: scale must be in [0, 1], got {made.scale}"
        )
        left = made.twist - basis @ np.linalg.lstsq(basis, made.twist, rcond=None)[0]
        assert np.abs(left).max() < 1e-6, (
            f"{robot.kind}: allocate says that it makes a twist which motion_basis does not have"
        )
        named = made.limit or not differs(made.twist, twist)
        assert named, (
            f"{robot.kind}: a command that is shortened or turned must name its limit,"
            f" {twist} became {made.twist}"
        )
        _check_limits(robot, mount, twist)
    rest = robot.allocate(np.zeros(6), reading, mount, 0.04)
    assert np.abs(rest.twist).max() < 1e-9, (
        f"{robot.kind}: a command to rest must be rest, it makes {rest.twist}"
    )


def _check_limits(robot: Robot, mount: Mount, twist: Array) -> None:
    """Beyond its limits an allocation names them,
    and its setpoint does not grow with the command.
    """
    reading = _reading(robot)
    many = robot.allocate(HUGE * twist, reading, mount, 0.04)
    assert bool(many.limit) == (many.scale < 1 - 1e-9), (
        f"{robot.kind}: a command that is scaled must name its limit"
    )
    if many.limit:
        more = robot.allocate(10 * HUGE * twist, reading, mount, 0.04)
        assert np.abs(more.setpoint).max() <= 1.01 * np.abs(many.setpoint).max(), (
            f"{robot.kind}: beyond its limits the setpoint must not grow with the command"
        )


def _reading(robot: Robot) -> Reading:
    q = robot.start_joints()
    return Reading(q, np.zeros_like(q))
