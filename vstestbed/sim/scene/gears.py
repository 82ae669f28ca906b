"""Elastic gears in an arm's model: a rotor beside each elastic joint, and a spring with play and damping between the two."""

from __future__ import annotations

import mujoco

from vstestbed.robots.mechanics import Mechanics

ROTOR = "rotor_"
"""Before the name of a joint: that of its rotor."""
ROTOR_KG, ROTOR_KGM2 = 1e-6, 1e-9
"""Mass and inertia of the rotor's body, which MuJoCo asks for. The rotor's true inertia is the armature of its hinge: it counts for its own
turning alone. As the inertia of a body the squared gear ratio would be in it for all joints before it, too, where the motor's rotor counts
as it is (Spong 1987, assumption 2, doi:10.1115/1.3143860)."""


def add_rotors(model: mujoco.MjSpec, mechanics: Mechanics) -> None:
    """Divide each elastic joint into rotor and link: armature, friction, torque limit and actuators go to the rotor's side.

    A fixed tendon of length theta - q is the spring; its rest lengths from -b/2 to b/2 are the play b.
    """
    springs = zip(mechanics.joints, mechanics.stiffness.tolist(), mechanics.damping.tolist(), mechanics.play.tolist(), strict=True)
    for name, stiffness, damping, play in springs:
        if stiffness > 0:
            _add_rotor(model, name)
            spring = model.add_tendon(name=f"gear_{name}", springlength=[-play / 2, play / 2])
            spring.stiffness[0], spring.damping[0] = stiffness, damping
            spring.wrap_joint(f"{ROTOR}{name}", 1.0)
            spring.wrap_joint(name, -1.0)


def _add_rotor(model: mujoco.MjSpec, name: str) -> None:
    """The rotor of a joint, turning about the joint's own axis on the same parent."""
    link = model.joint(name)
    body = link.parent.parent.add_body(name=f"{ROTOR}{name}", pos=link.parent.pos, quat=link.parent.quat, mass=ROTOR_KG)
    body.inertia, body.explicitinertial = [ROTOR_KGM2] * 3, True
    body.ipos = link.pos  # on the axis: its weight turns nothing
    _copy_orientation(link.parent, body)
    rotor = body.add_joint(name=f"{ROTOR}{name}", type=link.type, pos=link.pos, axis=link.axis, armature=link.armature)
    rotor.damping, rotor.frictionloss = link.damping, link.frictionloss
    rotor.solref_friction, rotor.solimp_friction = link.solref_friction, link.solimp_friction
    rotor.actfrclimited, rotor.actfrcrange = link.actfrclimited, link.actfrcrange
    rotor.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    link.armature, link.frictionloss, link.damping = 0.0, 0.0, [0.0] * len(link.damping)
    link.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
    for actuator in model.actuators:
        if actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT and actuator.target == name:
            actuator.target = rotor.name


def _copy_orientation(source: mujoco.MjsBody, body: mujoco.MjsBody) -> None:
    """A body's orientation as its file writes it: as a quaternion, as Euler angles, ..."""
    for field in ("type", "axisangle", "euler", "xyaxes", "zaxis"):
        setattr(body.alt, field, getattr(source.alt, field))
