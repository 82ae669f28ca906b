"""An arm's true links in its model: displaced where its geometry is wrong, with the load at its flange."""

from __future__ import annotations

import mujoco
import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, quaternion_wxyz
from vstestbed.robots.link_errors import Payload
from vstestbed.robots.mechanics import Mechanics


def displace_links(model: mujoco.MjSpec, compiled: mujoco.MjModel, mechanics: Mechanics) -> None:
    """Displace the body of each joint but the first by D of the link before it, in the frame of that link; the flange is `add_robot`'s.

    Args:
        model: to be changed. compiled: the same, compiled, which has all orientations as quaternions.

    Raises:
        ParameterError: the file has a joint whose place cannot be changed alone.
    """
    assert mechanics.links is not None
    for name, D in zip(mechanics.joints[1:], mechanics.links[:-1], strict=True):
        body = model.joint(name).parent
        if len(body.joints) > 1 or body.frame is not None:
            where = "shares its body with another joint" if len(body.joints) > 1 else "is inside a <frame>"
            raise ParameterError("robot.geometry_error", f"cannot displace {name}, which {where} in the file; works: a body for each joint")
        number = compiled.jnt_bodyid[compiled.joint(name).id]
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, compiled.body_quat[number])
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R.reshape(3, 3), compiled.body_pos[number]
        T = D @ T
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        body.pos, body.quat = T[:3, 3], quaternion_wxyz(T[:3, :3])


def add_payload(flange: mujoco.MjsBody, name: str, T_body_flange: Array, payload: Payload, carried: float) -> None:
    """A body without geoms at the flange, called `name`.

    Args:
        flange: the body that carries the flange, at T_body_flange (4, 4) in it.
        carried: the share of its weight that the drives' compensation carries.
    """
    at = T_body_flange[:3, :3] @ np.array(payload.com_m) + T_body_flange[:3, 3]
    body = flange.add_body(name=name, pos=at, quat=quaternion_wxyz(T_body_flange[:3, :3]), mass=payload.mass_kg)
    body.inertia, body.explicitinertial = [payload.mass_kg * payload.edge_m**2 / 6] * 3, True
    body.ipos = np.zeros(3)
    body.gravcomp = carried if payload.declared else 0.0
