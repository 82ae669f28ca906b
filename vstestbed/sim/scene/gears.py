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

    A fixed tendon of length theta - q is the spring; its rest lengths from -b/2 to b/2 are the play b. Each stage of a stiffness that
    grows is a tendon more, whose rest lengths reach to the stage's beginning.
    """
    for i, name in enumerate(mechanics.joints):
        if mechanics.rotors is not None:
            model.joint(name).armature = mechanics.rotors[i]
        if mechanics.stiffness[i] > 0:
            _add_rotor(model, name)
            play = mechanics.play[i] / 2
            _add_spring(model, name, "gear_", play, mechanics.stiffness[i], mechanics.damping[i])
            for j, (torsion, more) in enumerate([] if mechanics.stages is None else mechanics.stages[i].tolist(), start=2):
                _add_spring(model, name, f"gear_{j}_", play + torsion, more)


def _add_spring(model: mujoco.MjSpec, name: str, prefix: str, free: float, stiffness: float, damping: float = 0.0) -> None:
    """A spring between the rotor of a joint and its link, which acts where they differ by more than `free` [rad]."""
    spring = model.add_tendon(name=f"{prefix}{name}", springlength=[-free, free])
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
