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
    pulled,
)
from vstestbed.sim.scene.model_files import speeds_in
from vstestbed.sim.scene.scenery import check_scenery, examine_scenery

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
        flange: what carries the camera. q: joint positions (n,) [rad, m].
        mount, distance: of the camera from the flange, and of the target from the camera at the
            goal [m]. T_world_target: (4, 4).
        floor_z: height of a floor under all of it [m].
    """

    flange: str
    q: Array
    mount: float
    distance: float
    T_world_target: Array
    floor_z: float


def first_scenario(file: str, chain: JointChain, start: Posture) -> str:
    """A scenario as YAML that runs as it is: guessed limits of speed and torque, the camera at the
    flange, a square before it.
    """
    target = Pose.of(start.T_world_target)
    own = speeds_in(place_of_file(file))
    speeds = [
        own.get(name, SLIDE_SPEED if slides else SPEED)
        for name, slides in zip(chain.names, chain.slides, strict=True)
    ]
    random = "{q_deg: 5, slide_m: 0.02}" if chain.slides.any() else "{q_deg: 5}"
    q = np.where(chain.slides, start.q, np.degrees(start.q))
    side = start.distance / 3
    radius = start.distance / 50
    pose = f"{{xyz: {_listed(target.xyz, 4)}, rpy_deg: {_listed(target.rpy_deg, 3)}}}"
    lines = [
        (
            "# limits of speed and torque that the file lacks are guessed:"
            " the maker's data sheet has them"
        ),
        "robot:",
    ]
    lines += ["  kind: mjcf", f"  file: {_quoted(file)}", f"  flange: {_quoted(start.flange)}"]
    lines += ["  actuation: velocity", f"  speed_limits: {_listed(speeds, 3)}"]
    if not np.isfinite(chain.torque).all():
        lines += [f"  torque_limits: {_listed(torques(file, chain), 6)}"]
    lines += [f"  start: {{nominal: {{q_deg: {_listed(q, 3)}}}, random: {random}}}"]
    lines += [
        f"camera: {{kind: perspective, fovy_deg: 60, mount: {{xyz: [0, 0, {start.mount:g}]}}}}"
    ]
    lines += [
        f"target: {{kind: square, side: {side:.3g}, pose: {pose},"
        f" marker: {{kind: disc, radius: {radius:.2g}}}}}"
    ]
    lines += [
        "law: {kind: ibvs, gain: 0.8}",
        f"goal: {{T_camera_target: {{xyz: [0, 0, {start.distance:g}]}}}}",
    ]
    lines += ["stop: {duration_s: 30, converged: {error_px: 0.3, hold_s: 0.5}}"]
    return "\n".join([*lines, f"world: {{floor_z: {start.floor_z:g}}}"] if start.floor_z else lines)


def _quoted(text: str) -> str:
    return (
        text
        if re.fullmatch(r"[A-Za-z_/][\w./:+-]*", text)
        else json.dumps(text, ensure_ascii=False)
    )


def _listed(numbers: Iterable[float], digits: int) -> str:
    return f"[{', '.join(f'{round(float(x), digits) + 0.0:.10g}' for x in numbers)}]"


def first_posture(file: str, flange: str, chain: JointChain) -> Posture:
    """The posture with the largest manipulability in which nothing touches, nothing is under the
    floor, and the camera's view is free.

    The measure is the smallest singular value of the Jacobian, lengths in the arm's own unit, which
    the damping of `resolved_rate` needs large. Of DRAWS random postures, the same ones at each
    call, all joints in the central INNER part of their ranges, the first joint in its middle. Where
    none is so, the floor is put under the best one.

    Reference: Klein & Blaho 1987, doi:10.1177/027836498700600206.
    """
    drawn = _drawn(chain)
    scale = unit_scale(chain.unit_m)[:, None]
    least = [np.linalg.svd(scale * chain.kinematics(q)[1], compute_uv=False)[-1] for q in drawn]
    best = drawn[np.argsort(least)[::-1][:TRIED]]
    # as the scenario will have them
    ranked = np.where(chain.slides, best.round(3), np.radians(np.degrees(best).round(0)))
    apart = [q for q in ranked if not touching(file, chain, q)] or [ranked[0]]
    seen = (
        posture for posture in _views(file, flange, chain, apart) if _sees(file, chain, posture)
    )
    return next(seen, _placed(file, flange, chain, apart[0], MOUNTS_M[0], DISTANCES_M[0]))


def _views(file: str, flange: str, chain: JointChain, apart: list[Array]) -> Iterator[Posture]:
    """Views from postures (n,), the best first: those over a floor at z = 0, then with the floor
    put lower.
    """
    for distance, mount, q in itertools.product(DISTANCES_M, MOUNTS_M, apart):
        posture = _placed(file, flange, chain, q, mount, distance)
        if posture.floor_z == 0:
            yield posture
    yield from (_placed(file, flange, chain, q, MOUNTS_M[0], DISTANCES_M[0]) for q in apart)


def torques(file: str, chain: JointChain) -> list[float]:
    """Largest torques (n,) [Nm, N]: the file's, and where it has none twice what weight, friction
    and a start within SPEED_UP_S ask for.

    Weight and inertia are the largest ones of TRIED postures.
    """
    model = compiled(file)
    data, places, dofs = mujoco.MjData(model), *places_of(model, chain.names)
    M = np.zeros((model.nv, model.nv))
    weight = np.zeros(len(dofs))
    inertia = np.zeros(len(dofs))
    for q in _drawn(chain)[:TRIED]:
        data.qpos[places] = q
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, M)
        weight = np.maximum(weight, np.abs(data.qfrc_bias[dofs]))
        inertia = np.maximum(inertia, M.diagonal()[dofs])
    guess = 2 * (
        weight + chain.friction + inertia * np.where(chain.slides, SLIDE_SPEED, SPEED) / SPEED_UP_S
    )
    return [
        float(f"{most:.2g}" if np.isinf(given) else f"{given:g}")
        for most, given in zip(guess, chain.torque, strict=True)
    ]


def _drawn(chain: JointChain) -> Array:
    """Random postures (DRAWS, n) in the central part of each range, 150 degrees to both sides for a
    joint that turns without end.
    """
    endless = np.radians([-150.0, 150.0])
    limits = np.where(np.isfinite(chain.limits), chain.limits, endless)
    middle = limits.mean(axis=1)
    half = INNER / 2 * np.ptp(limits, axis=1)
    return middle + half * np.random.default_rng(0).uniform(-1, 1, (DRAWS, len(middle))) * (
        np.arange(len(middle)) > 0
    )


def _placed(
    file: str, flange: str, chain: JointChain, q: Array, mount: float, distance: float
) -> Posture:
    """A target before the camera at a neighbouring posture, the goal's, which the arm so reaches
    also with few joints.
    """
    apart = np.where(chain.slides, APART_M, np.radians(APART_DEG))
    apart[1::2] *= -1
    goal = np.clip(q + apart, *chain.limits.T)
    T_world_target = chain.kinematics(goal)[0] @ Pose(xyz=(0, 0, mount + distance)).T
    model, data = _at(file, chain, q)
    # the first one may be in the foot
    moving = [model.joint(name).bodyid[0] for name in chain.names[1:]]
    heights = [
        *data.xpos[moving, 2],
        chain.kinematics(q)[0][2, 3],
        T_world_target[2, 3] - distance / 4,
    ]
    lowest = float(min(heights))
    floor_z = 0.0 if lowest > CLEAR_M else float(np.floor(lowest * 10) / 10 - 0.5)
    return Posture(flange, q, mount, distance, T_world_target, floor_z)


def _at(file: str, chain: JointChain, q: Array) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The file's model at a posture."""
    model = compiled(file)
    data = mujoco.MjData(model)
    data.qpos[places_of(model, chain.names)[0]] = q
    mujoco.mj_forward(model, data)
    return model, data


def touching(file: str, chain: JointChain, q: Array) -> str:
    """The bodies that touch at a posture (n,): `base and link`; "" for none."""
    model, data = _at(file, chain, q)
    if not data.ncon:
        return ""
    bodies = [model.body(model.geom_bodyid[g]).name for g in data.contact.geom[0]]
    return " and ".join(body or "a body without a name" for body in bodies)


def _sees(file: str, chain: JointChain, posture: Posture) -> bool:
    """Whether nothing is between the camera and the target's middle and corners."""
    model, data = _at(file, chain, posture.q)
    eye = (chain.kinematics(posture.q)[0] @ Pose(xyz=(0, 0, posture.mount)).T)[:3, 3]
    size = posture.distance / 6
    points = [
        [x, y, 0, 1]
        for x, y in ((0, 0), (size, size), (size, -size), (-size, size), (-size, -size))
    ]
    return bool((before(model, data, eye, points @ posture.T_world_target[:3].T - eye) < 0).all())


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
    path = place_of_file(file)
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
        yield from _as_arm(file, model, usable, path.read_text(errors="replace").splitlines())
        yield "as scenery", True, f"no: {against[0]}" if against else "yes", ""
    else:
        yield "as an arm", True, f"no: {refused}", ""
        for what, found in examine_scenery(file):
            yield what, True, found, ""
        yield "as scenery", True, f"world: {{scenery: {file}}}", ""


def _as_arm(
    file: str, model: mujoco.MjModel, usable: dict[str, JointChain], lines: list[str]
) -> Iterator[Line]:
    """What robot `mjcf` makes of a file."""
    flange = likely_flange(model, usable)
    yield "as an arm", True, f"robot: {{kind: mjcf}}, for instance with flange: {flange}", ""
    for name, chain in usable.items():
        yield "flange", True, f"{name}: {', '.join(chain.names)}", ""
    chain = usable[flange]
    start = first_posture(file, flange, chain)
    yield from _of_joints(chain, lines)
    yield from _of_servos(file, model, chain, start.q)
    for name, joints in pulled(model, [model.joint(joint).id for joint in chain.names]).items():
        found = f"{name}: pulls at {', '.join(joints)}, as its file has it; laws do not know of it"
        yield "tendon", True, found, ""
    if found := touching(file, chain, start.q):
        words = f"{found} touch, in the best of {TRIED} postures, too"
        yield "contact", False, words, f"{EXCLUDE}; a run with a contact ends as collided"
    words = "one to begin with; as a file my_arm.yaml it is run by `vstestbed run my_arm.yaml`"
    yield "scenario", True, f"{words}:\n{first_scenario(file, chain, start)}", ""


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
    return usable, "; ".join(
        f"{', '.join(names)}: {words}" for words, names in messages.items()
    ) or "no site and no body has a name"


def _ends(model: mujoco.MjModel) -> list[str]:
    """Names that could be a flange: the sites, the bodies that carry no other body, and the one at
    which an arm ends.
    """
    parents = set(model.body_parentid.tolist())
    leaves = {i for i in range(1, model.nbody) if i not in parents} | ({_trunk_end(model)} - {0})
    names = [
        *(model.site(i).name for i in range(model.nsite)),
        *(model.body(i).name for i in sorted(leaves)),
    ]
    return list(dict.fromkeys(name for name in names if name))


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
    end = _trunk_end(model)
    carriers = {body := end}
    while body > 0:
        carriers.add(body := int(model.body_parentid[body]))
    trunk = {model.joint(i).name for i in range(model.njnt) if int(model.jnt_bodyid[i]) in carriers}
    sites = {model.site(i).name: int(model.site_bodyid[i]) for i in range(model.nsite)}

    def rank(name: str) -> tuple[bool, int, bool, bool, int]:
        joints = usable[name].names
        named = FLANGE_NAME.search(name) is not None
        return (
            set(joints) == trunk,
            len(joints),
            named,
            name in sites,
            sites[name] if name in sites else model.body(name).id,
        )

    return max(usable, key=rank)


def _of_joints(chain: JointChain, lines: list[str]) -> Iterator[Line]:
    """Ranges, torque limits and drives of the longest chain's joints, each with its line where
    something is missing.
    """
    for i, name in enumerate(chain.names):
        missing = [] if np.isfinite(chain.torque[i]) else ["no torque limit (actuatorfrcrange)"]
        drive = chain.drives[i]
        if drive not in ("velocity", "position"):
            missing.append(f"a {drive} actuator" if drive else "no actuator")
        wanted = re.compile(rf'<joint\b[^>]*\bname="{re.escape(name)}"')
        # 0: in a file that it includes
        line = next(
            (number for number, line in enumerate(lines, start=1) if wanted.search(line)), 0
        )
        where = f", line {line}" if missing and line else ""
        note = f" [{'; '.join(missing)}{where}]" if missing else ""
        yield "joint", True, f"{name}: {_span(chain, i)}{note}", ""


def _of_servos(file: str, model: mujoco.MjModel, chain: JointChain, q: Array) -> Iterator[Line]:
    """The gains of the servos that `actuation: velocity` adds for a start at q (n,), and of the
    file's own, with friction's effect.
    """
    M, _ = inertia_at(file, chain.names, tuple(q.tolist()))
    for i, (name, m) in enumerate(zip(chain.names, M.diagonal().tolist(), strict=True)):
        friction = float(chain.friction[i])
        slides = bool(chain.slides[i])
        yield (
            "servo",
            True,
            (
                f"{name}: {_gains(*servo_gains(m, friction, slides), friction, slides)},"
                " added by actuation: velocity"
            ),
            "",
        )
        if chain.drives[i] in ("velocity", "position"):
            (servo,) = drivers(model, model.joint(name).id)
            # the joint's damping not counted
            kp, kv = (-model.actuator_biasprm[servo, 1:3]).tolist()
            yield (
                "servo",
                True,
                f"{name}: {_gains(kp, kv, friction, slides)}, its own, used by actuation: file",
                "",
            )


def _gains(kp: float, kv: float, friction: float, slides: bool) -> str:
    """Gains of a servo in words, and how far friction winds it up before the joint moves, with a
    warning where that is much.
    """
    force, length = ("N", "m") if slides else ("Nm", "rad")
    gains = f"kp {kp:.4g} {force}/{length}, " * (kp > 0) + f"kv {kv:.4g} {force} s/{length}"
    if kp == 0:
        return (
            f"{gains}; it does not move under {friction / kv:.2g} {length}/s" if friction else gains
        )
    size, unit = (1e3, "mm") if slides else (float(np.degrees(1.0)), "deg")
    most = size * (WIND_UP_M if slides else WIND_UP_RAD)
    found = size * friction / kp
    warning = (
        f" (WARNING: over {most:g} {unit} the joint begins late and turns back late)"
        if found > 1.01 * most
        else ""
    )
    return (
        f"{gains}; friction of {friction:.3g} {force} winds it up by {found:.2g} {unit}{warning}"
        if friction
        else gains
    )


def _span(chain: JointChain, i: int) -> str:
    slides = bool(chain.slides[i])
    torque = float(chain.torque[i])
    low, high = (chain.limits[i] * (1.0 if slides else np.degrees(1.0))).tolist()
    spans = (
        f"{low:.4g} to {high:.4g} {'m' if slides else 'deg'}"
        if np.isfinite(low)
        else "without end"
        if slides
        else "turns without end"
    )
    strength = f", at most {torque:.4g} {'N' if slides else 'Nm'}" if np.isfinite(torque) else ""
    return f"{'slide' if slides else 'hinge'}, {spans}{strength}"
