"""An arm's true links in its model: displaced where its geometry is wrong, with the load at its
flange.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Le, Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, quaternion_wxyz
from vstestbed.core.quantity import Mass, Position, PositiveLength
from vstestbed.core.spec import spec
from vstestbed.effects.base import Effect, RobotBody, RobotModel

PAYLOAD = "payload"
Offsets = Annotated[tuple[Pose, ...], Len(0, 7)]


@spec
class GeometryError(Effect):
    """The true geometry of the arm differs from the one that it computes with: the next joint, or
    the flange, is displaced on its link.

    T_i = A_i(q_i) D_i, with the nominal motion A_i of joint i and the displacement D_i in the frame
    of its link (of the Puma, standard Denavit-Hartenberg frame i: errors of a and alpha are those
    along and about x, those of d and theta along and about z of frame i - 1, D_i = A_i(0)^-1 Tz(dd)
    Rz(dtheta) A_i(0)). To first order the flange's twist error is sum Ad(T_i,flange^-1) d_i, with
    T_i,flange from behind link i's displacement to the flange.

    Reference: Hayati & Mirmirani 1985, Improving the absolute positioning accuracy of robot
    manipulators, Journal of Robotic Systems 2(4), 397-413.

    Args:
        sigma_m: standard deviation of each link's displacement along each of its axes [m]; drawn
            with the scenario's seed.
        sigma_deg: the same about each axis [deg].
        offsets: the displacement of each link, x, y, z and roll, pitch, yaw, where it is not drawn;
            e.g. `[{xyz: [0.001, 0, 0]}, {}, {}, {}, {}, {rpy_deg: [0, 0, 0.1]}]`.
    """

    sigma_m: Annotated[float, Ge(0), Le(0.1)] = 0.0
    sigma_deg: Annotated[float, Ge(0), Le(10)] = 0.0
    offsets: Offsets = ()

    def __post_init__(self) -> None:
        if self.draws and self.offsets:
            words = "with sigma_m or sigma_deg > 0, which draw them, also those of a preset"
            raise ParameterError.fixed(
                "offsets", "empty", where=words, works="both 0 beside the list"
            )

    @property
    def draws(self) -> bool:
        """Whether displacements are drawn."""
        return self.sigma_m > 0 or self.sigma_deg > 0

    def drawn(self, n: int, rng: np.random.Generator) -> GeometryError:
        """With displacements of n links listed that are drawn from `rng`; itself where both sigmas
        are 0.
        """
        if not self.draws:
            return self
        xyz = np.round(self.sigma_m * rng.standard_normal((n, 3)), 9).tolist()
        rpy_deg = np.round(self.sigma_deg * rng.standard_normal((n, 3)), 9).tolist()
        drawn = [Pose(xyz=p, rpy_deg=a) for p, a in zip(xyz, rpy_deg, strict=True)]
        return GeometryError(offsets=tuple(drawn))

    def displacements(self, n: int) -> Array | None:
        """D_i (n, 4, 4); None without any. Raises ParameterError: another number of links."""
        if not self.offsets:
            return None
        if len(self.offsets) != n:
            raise ParameterError.count(
                "geometry_error.offsets", n, "items, one for each link", len(self.offsets)
            )
        return np.array([pose.T for pose in self.offsets])

    def edit(self, robot: RobotModel) -> None:
        """Displace the body of each joint but the first by D of the link before it, in the frame of
        that link, and the flange.

        Raises ParameterError: the file has a joint whose place cannot be changed alone.
        """
        import mujoco

        compiled = robot.compiled()
        displaced = self.displacements(len(robot.joints))
        if displaced is None:
            return
        for name, D in zip(robot.joints[1:], displaced[:-1], strict=True):
            body = robot.spec.joint(name).parent
            where = "is inside a <frame>" if body.frame is not None else ""
            if len(body.joints) > 1:
                where = "shares its body with another joint"
            if where:
                words = (
                    f"cannot displace {name}, which {where} in the file;"
                    " works: a body for each joint"
                )
                raise ParameterError("robot.geometry_error", words)
            number = compiled.jnt_bodyid[compiled.joint(name).id]
            R = np.zeros(9)
            T = np.eye(4)
            mujoco.mju_quat2Mat(R, compiled.body_quat[number])
            T[:3, :3] = R.reshape(3, 3)
            T[:3, 3] = compiled.body_pos[number]
            T = D @ T
            body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
            body.pos = T[:3, 3]
            body.quat = quaternion_wxyz(T[:3, :3])
        robot.T_body_flange = displaced[-1] @ robot.T_body_flange


@spec
class Payload(Effect):
    """A load at the flange: a cube of uniform density that touches nothing.

    A start at which the weight asks more of a joint than its motor and friction hold is refused.

    Args:
        mass_kg: its mass [kg]; e.g. `1.5`.
        com_m: its centre in the flange's frame [m].
        edge_m: length of its edges [m]; its moments of inertia are mass_kg edge_m^2 / 6.
        declared: whether the gravity compensation of the drives, where they have one, carries it.
    """

    mass_kg: Mass
    com_m: Position = (0.0, 0.0, 0.1)
    edge_m: PositiveLength = 0.1
    declared: bool = True

    def edit(self, robot: RobotModel) -> None:
        """A body without geoms at the flange."""
        T = robot.T_body_flange
        at = T[:3, :3] @ np.array(self.com_m) + T[:3, 3]
        body = robot.flange.add_body(
            name=PAYLOAD, pos=at, quat=quaternion_wxyz(T[:3, :3]), mass=self.mass_kg
        )
        body.inertia = [self.mass_kg * self.edge_m**2 / 6] * 3
        body.explicitinertial = True
        body.ipos = np.zeros(3)
        body.gravcomp = robot.carried if self.declared else 0.0

    def remedy(self, body: RobotBody, weight: Array, holds: Array) -> tuple[str, str, float]:
        """The largest payload m that the motors hold there: |without + m a_kilogram| <= holds in
        every joint.
        """
        import mujoco

        # What a kilogram asks of each joint: -J^T g, with the Jacobian J of its centre.
        model = body.model
        J = np.zeros((3, body.model.nv))
        mujoco.mj_jacBodyCom(model, body.data, J, None, model.body(f"robot/{PAYLOAD}").id)
        a_kilogram = -(J.T @ model.opt.gravity)[body.at.qvel]
        without = weight - self.mass_kg * a_kilogram
        if (np.abs(without) > holds).any():
            works = "another start, for it falls without a payload, too"
        else:
            with np.errstate(divide="ignore", invalid="ignore"):
                room = (holds - np.sign(a_kilogram) * without) / np.abs(a_kilogram)
            most = float(np.nanmin(np.where(a_kilogram == 0, np.inf, room)))
            # three digits; rounded up it would be too much
            unit = 10.0 ** (np.floor(np.log10(most)) - 2)
            works = f"at most {np.floor(most / unit) * unit:.3g} kg here"
        return "robot.payload.mass_kg", works, self.mass_kg
