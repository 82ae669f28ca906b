"""What of an arm's file, or of scenery, can be used, and what is missing, for `doctor FILE.xml`."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose
from vstestbed.core.named_files import place_of_file
from vstestbed.effects.base import places_of
from vstestbed.robots.arm import INNER, unit_scale
from vstestbed.robots.chain import JointChain
from vstestbed.robots.mjcf import WIND_UP_M, WIND_UP_RAD, servo_gains
from vstestbed.sim.scene.joint_chain import (
    before,
    compiled,
    drivers,
    inertia_at,
    joint_chain,
    joints_to,
    names_of,
    pulled,
)
from vstestbed.sim.scene.model_files import speeds_in
from vstestbed.sim.scene.scenery import check_scenery, examine_scenery

OF_SPEED = "velocity", "position"  # drives that take speeds
# Postures that are drawn, and how many of them, the best first, are looked at more closely
DRAWS = 400
TRIED = 100
DISTANCES_M = 0.6, 0.45, 0.3
MOUNTS_M = 0.05, 0.1, 0.2
"""Distances of the target from the camera at the goal, and of the camera from the flange; the first
with a good posture are taken [m].
"""
# How far each joint is from the goal's posture at the start: of a hinge [deg], of a joint that
# slides [m]
APART_DEG = 4.0
APART_M = 0.02
CLEAR_M = 0.1  # height over the floor under which no joint, camera or marker shall be [m]
SPEED = 1.0
SLIDE_SPEED = 0.25
SPEED_UP_S = 0.25
"""Speed limits of such a scenario [rad/s], [m/s], and the time in which its servos must be able to
reach them [s].
"""


@dataclass(frozen=True)
class Posture:
    """Where a scenario begins.

    Attributes:
        q: joint positions (n,) [rad, m]. mount, distance: of the camera from the flange, and of the
            target from the camera at the goal [m]. T_world_target: (4, 4).
        floor_z: height of a floor under all of it [m].
    """

    q: Array
    mount: float
    distance: float
    T_world_target: Array
    floor_z: float


class ArmFile:
    """The arm of a file, with the joints before a flange, in any posture q (n,)."""

    def __init__(self, file: str, flange: str, chain: JointChain):
        self.file = file
        self.flange = flange
        self.chain = chain
        self._model = compiled(file)
        self._places, self._dofs = places_of(self._model, chain.names)

    def at(self, q: Array) -> mujoco.MjData:
        """The file's model in a posture."""
        data = mujoco.MjData(self._model)
        data.qpos[self._places] = q
        mujoco.mj_forward(self._model, data)
        return data

    def touching(self, q: Array) -> str:
        """The bodies that touch in a posture: `base and link`; "" for none."""
        data = self.at(q)
        if not data.ncon:
            return ""
        numbers = self._model.geom_bodyid[data.contact.geom[0]]
        return " and ".join(self._model.body(i).name or "a body without a name" for i in numbers)

    def torques(self) -> list[float]:
        """Largest torques (n,) [Nm, N]: the file's, and where it has none twice what weight,
        friction and a start within SPEED_UP_S ask for.

        Weight and inertia are the largest ones of TRIED postures.
        """
        chain = self.chain
        M = np.zeros((self._model.nv, self._model.nv))
        weight = np.zeros(len(chain.names))
        inertia = np.zeros(len(chain.names))
        for q in _drawn(chain)[:TRIED]:
            data = self.at(q)
            mujoco.mj_fullM(self._model, data, M)
            weight = np.maximum(weight, np.abs(data.qfrc_bias[self._dofs]))
            inertia = np.maximum(inertia, M.diagonal()[self._dofs])
        speeds = np.where(chain.slides, SLIDE_SPEED, SPEED)
        guess = 2 * (weight + chain.friction + inertia * speeds / SPEED_UP_S)
        return [
            float(f"{most:.2g}" if np.isinf(given) else f"{given:g}")
            for most, given in zip(guess, chain.torque, strict=True)
        ]

    def placed(
        self, q: Array, mount: float = MOUNTS_M[0], distance: float = DISTANCES_M[0]
    ) -> Posture:
        """A target before the camera in a neighbouring posture, the goal's, which the arm so
        reaches also with few joints.
        """
        chain = self.chain
        apart = np.where(chain.slides, APART_M, np.radians(APART_DEG))
        apart[1::2] *= -1
        goal = np.clip(q + apart, *chain.limits.T)
        T_world_target = chain.kinematics(goal)[0] @ Pose(xyz=(0, 0, mount + distance)).T
        # the first one may be in the foot
        moving = [self._model.joint(name).bodyid[0] for name in chain.names[1:]]
        flange = chain.kinematics(q)[0][2, 3]
        lowest = float(
            min(*self.at(q).xpos[moving, 2], flange, T_world_target[2, 3] - distance / 4)
        )
        floor_z = 0.0 if lowest > CLEAR_M else float(np.floor(lowest * 10) / 10 - 0.5)
        return Posture(q, mount, distance, T_world_target, floor_z)

    def sees(self, posture: Posture) -> bool:
        """Whether nothing is between the camera and the target's middle and corners."""
        eye = (self.chain.kinematics(posture.q)[0] @ Pose(xyz=(0, 0, posture.mount)).T)[:3, 3]
        corners = np.array([[0, 0], [1, 1], [1, -1], [-1, 1], [-1, -1]]) * posture.distance / 6
        points = np.column_stack([corners, np.zeros(5), np.ones(5)])
        ways = points @ posture.T_world_target[:3].T - eye
        return bool((before(self._model, self.at(posture.q), eye, ways) < 0).all())


def first_scenario(arm: ArmFile, start: Posture) -> str:
    """A scenario as YAML that runs as it is: guessed limits of speed and torque, the camera at the
    flange, a square before it.
    """
    chain = arm.chain
    target = Pose.of(start.T_world_target)
    own = speeds_in(place_of_file(arm.file))
    guessed: list[float] = np.where(chain.slides, SLIDE_SPEED, SPEED).tolist()
    speeds = [own.get(name, speed) for name, speed in zip(chain.names, guessed, strict=True)]
    torques = ""
    if not np.isfinite(chain.torque).all():
        torques = f"\n  torque_limits: {_listed(arm.torques(), 6)}"
    random = "{q_deg: 5, slide_m: 0.02}" if chain.slides.any() else "{q_deg: 5}"
    q = np.where(chain.slides, start.q, np.degrees(start.q))
    side = start.distance / 3
    marker = f"{{kind: disc, radius: {start.distance / 50:.2g}}}"
    pose = f"{{xyz: {_listed(target.xyz, 4)}, rpy_deg: {_listed(target.rpy_deg, 3)}}}"
    world = f"\nworld: {{floor_z: {start.floor_z:g}}}" if start.floor_z else ""
    return f"""\
# limits of speed and torque that the file lacks are guessed: the maker's data sheet has them
robot:
  kind: mjcf
  file: {_quoted(arm.file)}
  flange: {_quoted(arm.flange)}
  actuation: velocity
  speed_limits: {_listed(speeds, 3)}{torques}
  start: {{nominal: {{q_deg: {_listed(q, 3)}}}, random: {random}}}
camera: {{kind: perspective, fovy_deg: 60, mount: {{xyz: [0, 0, {start.mount:g}]}}}}
target: {{kind: square, side: {side:.3g}, pose: {pose}, marker: {marker}}}
law: {{kind: ibvs, gain: 0.8}}
goal: {{T_camera_target: {{xyz: [0, 0, {start.distance:g}]}}}}
stop: {{duration_s: 30, converged: {{error_px: 0.3, hold_s: 0.5}}}}{world}"""


def _quoted(text: str) -> str:
    plain = re.fullmatch(r"[A-Za-z_/][\w./:+-]*", text)
    return text if plain else json.dumps(text, ensure_ascii=False)


def _listed(numbers: Iterable[float], digits: int) -> str:
    return f"[{', '.join(f'{round(float(x), digits) + 0.0:.10g}' for x in numbers)}]"


def first_posture(arm: ArmFile) -> Posture:
    """The posture with the largest manipulability in which nothing touches, nothing is under the
    floor, and the camera's view is free.

    The measure is the smallest singular value of the Jacobian, lengths in the arm's own unit, which
    the damping of `resolved_rate` needs large. Of DRAWS random postures, the same ones at each
    call, all joints in the central INNER part of their ranges, the first joint in its middle. Where
    none is so, the floor is put under the best one.

    Reference: Klein & Blaho 1987, doi:10.1177/027836498700600206.
    """
    chain = arm.chain
    drawn = _drawn(chain)
    scale = unit_scale(chain.unit_m)[:, None]
    least = [np.linalg.svd(scale * chain.kinematics(q)[1], compute_uv=False)[-1] for q in drawn]
    best = drawn[np.argsort(least)[::-1][:TRIED]]
    # as the scenario will have them
    ranked = np.where(chain.slides, best.round(3), np.radians(np.degrees(best).round(0)))
    apart = [q for q in ranked if not arm.touching(q)] or [ranked[0]]
    return next(filter(arm.sees, _views(arm, apart)), arm.placed(apart[0]))


def _views(arm: ArmFile, apart: list[Array]) -> Iterator[Posture]:
    """Views from postures (n,), the best first: those over a floor at z = 0, then with the floor
    put lower.
    """
    for distance, mount, q in itertools.product(DISTANCES_M, MOUNTS_M, apart):
        posture = arm.placed(q, mount, distance)
        if posture.floor_z == 0:
            yield posture
    yield from map(arm.placed, apart)


def _drawn(chain: JointChain) -> Array:
    """Random postures (DRAWS, n) in the central part of each range, 150 degrees to both sides for a
    joint that turns without end.
    """
    endless = np.radians([-150.0, 150.0])
    limits = np.where(np.isfinite(chain.limits), chain.limits, endless)
    half = INNER / 2 * np.ptp(limits, axis=1)
    half[0] = 0
    share = np.random.default_rng(0).uniform(-1, 1, (DRAWS, len(limits)))
    return limits.mean(axis=1) + half * share


FLANGE_NAME = re.compile(
    r"flange|attach|wrist|tool|tcp|hand|grip|end_?eff|(^|_)eef?(_|$)", re.IGNORECASE
)
"""Words by which files name the end of an arm."""

EXCLUDE = 'leave the pair out by <contact><exclude body1="..." body2="..."/></contact> in the file'

ARM = "an arm stands on a fixed base and has 2 to 7 hinges and slides before its flange"
MEND = "correct it in the file"

# what was examined, whether it can be used, what was found, a remedy
Line = tuple[str, bool, str, str]


def examine_model(file: str) -> Iterator[Line]:
    """Examine a model for both of its uses, as the arm of robot `mjcf` and as scenery
    (`world.scenery`), and what stands against each.

    Of an arm: flanges, joints, torque limits, servos with their gains and their wind-up by
    friction, and a scenario to begin with. Raises ParameterError: the file is not there.
    """
    place_of_file(file)
    try:
        model = compiled(file)
    except ParameterError as error:
        found, _, remedy = error.problem.rpartition("; ")
        yield "model", False, found, remedy
        return
    parts = (
        (model.njnt, "joint", "joints"),
        (model.nu, "actuator", "actuators"),
        (model.nsite, "site", "sites"),
        (model.ngeom, "geom", "geoms"),
        (model.nmesh, "mesh", "meshes"),
    )
    counts = [f"{n} {one if n == 1 else several}" for n, one, several in parts]
    yield "model", True, ", ".join(counts), ""
    usable, refused = _flanges(file, model)
    against = _against_scenery(file)
    if against and not usable:
        yield "as an arm", False, refused, MEND if ": file must" in refused else ARM
        yield "as scenery", False, *against
    elif usable:
        yield from _as_arm(file, model, usable)
        yield "as scenery", True, f"no: {against[0]}" if against else "yes", ""
    else:
        yield "as an arm", True, f"no: {refused}", ""
        for what, found in examine_scenery(file):
            yield what, True, found, ""
        yield "as scenery", True, f"world: {{scenery: {file}}}", ""


def _as_arm(file: str, model: mujoco.MjModel, usable: dict[str, JointChain]) -> Iterator[Line]:
    """What robot `mjcf` makes of a file."""
    flange = likely_flange(model, usable)
    yield "as an arm", True, f"robot: {{kind: mjcf}}, for instance with flange: {flange}", ""
    for name, chain in usable.items():
        yield "flange", True, f"{name}: {', '.join(chain.names)}", ""
    chain = usable[flange]
    arm = ArmFile(file, flange, chain)
    start = first_posture(arm)
    yield from _of_joints(arm)
    yield from _of_servos(arm, model, start.q)
    for name, joints in pulled(model, [model.joint(joint).id for joint in chain.names]).items():
        found = f"{name}: pulls at {', '.join(joints)}, as its file has it; laws do not know of it"
        yield "tendon", True, found, ""
    if found := arm.touching(start.q):
        words = f"{found} touch, in the best of {TRIED} postures, too"
        yield "contact", False, words, f"{EXCLUDE}; a run with a contact ends as collided"
    words = "one to begin with; as a file my_arm.yaml it is run by `vstestbed run my_arm.yaml`"
    yield "scenario", True, f"{words}:\n{first_scenario(arm, start)}", ""


def _against_scenery(file: str) -> tuple[str, str] | None:
    """What stands against a file as scenery, and what would work; None where it can be used."""
    try:
        check_scenery(file, np.eye(4), 0.0)
    except ParameterError as error:
        problem, _, remedy = error.problem.partition("; ")
        return problem, remedy
    return None


def _flanges(file: str, model: mujoco.MjModel) -> tuple[dict[str, JointChain], str]:
    """The sites and bodies that can be the flange of an arm, with the joints before each; and why
    others cannot, in words.
    """
    usable: dict[str, JointChain] = {}
    messages: dict[str, list[str]] = {}
    for name in _ends(model):
        try:
            usable[name] = joint_chain(file, name, ())
        except ParameterError as error:
            messages.setdefault(f"{error.field} {error.problem}", []).append(name)
    if not model.njnt:
        return {}, "it has no joints"
    refused = [f"{', '.join(names)}: {words}" for words, names in messages.items()]
    return usable, "; ".join(refused) or "no site and no body has a name"


def _ends(model: mujoco.MjModel) -> dict[str, tuple[bool, int]]:
    """What could be a flange: the sites, the bodies that carry no other body, and the one at which
    an arm ends. By its name whether it is a site, and the number of its body.
    """
    parents = set(model.body_parentid.tolist())
    leaves = {i for i in range(1, model.nbody) if i not in parents} | ({_trunk_end(model)} - {0})
    sites = zip(names_of(model, "site"), model.site_bodyid.tolist(), strict=True)
    ends = {name: (True, body) for name, body in sites}
    for i in sorted(leaves):
        ends.setdefault(model.body(i).name, (False, i))
    ends.pop("", None)
    return ends


def _trunk_end(model: mujoco.MjModel) -> int:
    """The body with the last joint before the joints branch, as they do at a gripper's fingers; 0
    where they branch at the root.
    """
    moves = model.body_jntnum > 0
    for body in range(model.nbody - 1, 0, -1):  # children come after their parents
        moves[model.body_parentid[body]] |= moves[body]
    here = last = 0
    while True:
        further = np.flatnonzero((model.body_parentid == here) & moves)
        further = further[further > here]  # the world is its own parent
        if len(further) != 1:
            return last
        here = int(further[0])
        last = here if model.body_jntnum[here] else last


def likely_flange(model: mujoco.MjModel, usable: dict[str, JointChain]) -> str:
    """Which of the usable ends carries the camera: at the end of the trunk, named as a flange, a
    site rather than a body, farthest out.

    The trunk are the joints before they branch. Where no end is at its end, the one with the most
    joints.
    """
    trunk = {model.joint(i).name for i in joints_to(model, _trunk_end(model))}
    ends = _ends(model)

    def rank(name: str) -> tuple[bool, int, bool, bool, int]:
        joints = usable[name].names
        named = FLANGE_NAME.search(name) is not None
        return set(joints) == trunk, len(joints), named, *ends[name]

    return max(usable, key=rank)


def _of_joints(arm: ArmFile) -> Iterator[Line]:
    """Ranges, torque limits and drives of the joints, each with its line where something is
    missing.
    """
    chain = arm.chain
    lines = place_of_file(arm.file).read_text(errors="replace").splitlines()
    for i, name in enumerate(chain.names):
        missing = [] if np.isfinite(chain.torque[i]) else ["no torque limit (actuatorfrcrange)"]
        drive = chain.drives[i]
        if drive not in OF_SPEED:
            missing.append(f"a {drive} actuator" if drive else "no actuator")
        note = ""
        if missing:
            wanted = re.compile(rf'<joint\b[^>]*\bname="{re.escape(name)}"')
            numbers = [number for number, line in enumerate(lines, 1) if wanted.search(line)]
            # none: it is in a file that this one includes
            where = f", line {numbers[0]}" if numbers else ""
            note = f" [{'; '.join(missing)}{where}]"
        yield "joint", True, f"{name}: {_span(chain, i)}{note}", ""


def _of_servos(arm: ArmFile, model: mujoco.MjModel, q: Array) -> Iterator[Line]:
    """The gains of the servos that `actuation: velocity` adds for a start at q (n,), and of the
    file's own, with friction's effect.
    """
    chain = arm.chain
    M, _ = inertia_at(arm.file, chain.names, tuple(q.tolist()))
    for i, (name, m) in enumerate(zip(chain.names, M.diagonal().tolist(), strict=True)):
        friction = float(chain.friction[i])
        slides = bool(chain.slides[i])
        gains = _gains(*servo_gains(m, friction, slides), friction, slides)
        yield "servo", True, f"{name}: {gains}, added by actuation: velocity", ""
        if chain.drives[i] in OF_SPEED:
            (servo,) = drivers(model, model.joint(name).id)
            # the joint's damping not counted
            kp, kv = (-model.actuator_biasprm[servo, 1:3]).tolist()
            gains = _gains(kp, kv, friction, slides)
            yield "servo", True, f"{name}: {gains}, its own, used by actuation: file", ""


def _gains(kp: float, kv: float, friction: float, slides: bool) -> str:
    """Gains of a servo in words, and how far friction winds it up before the joint moves, with a
    warning where that is much.
    """
    force, length = ("N", "m") if slides else ("Nm", "rad")
    gains = f"kp {kp:.4g} {force}/{length}, " * (kp > 0) + f"kv {kv:.4g} {force} s/{length}"
    if not friction:
        return gains
    if kp == 0:
        return f"{gains}; it does not move under {friction / kv:.2g} {length}/s"
    size, unit = (1e3, "mm") if slides else (float(np.degrees(1.0)), "deg")
    most = size * (WIND_UP_M if slides else WIND_UP_RAD)
    found = size * friction / kp
    words = f"{gains}; friction of {friction:.3g} {force} winds it up by {found:.2g} {unit}"
    if found > 1.01 * most:
        words += f" (WARNING: over {most:g} {unit} the joint begins late and turns back late)"
    return words


def _span(chain: JointChain, i: int) -> str:
    low, high = chain.limits[i].tolist()
    torque = float(chain.torque[i])
    if chain.slides[i]:
        span = f"slide, {low:.4g} to {high:.4g} m" if np.isfinite(low) else "slide, without end"
        unit = "N"
    else:
        span = f"hinge, {np.degrees(low):.4g} to {np.degrees(high):.4g} deg"
        if not np.isfinite(low):
            span = "hinge, turns without end"
        unit = "Nm"
    return f"{span}, at most {torque:.4g} {unit}" if np.isfinite(torque) else span
