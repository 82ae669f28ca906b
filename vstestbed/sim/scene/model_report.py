"""What of an arm's file, or of scenery, can be used, and what is missing, for `doctor FILE.xml`."""

from __future__ import annotations

import re
from collections.abc import Iterator

import mujoco
import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.named_files import place_of_file
from vstestbed.robots.chain import JointChain
from vstestbed.robots.mjcf import WIND_UP_M, WIND_UP_RAD, servo_gains
from vstestbed.sim.scene.first_scenario import TRIED, first_posture, first_scenario, touching
from vstestbed.sim.scene.joint_chain import compiled, inertia_at, joint_chain, own_gains
from vstestbed.sim.scene.scenery import check_scenery, examine_scenery

FLANGE_NAME = re.compile(r"flange|attach|wrist|tool|tcp|hand|grip|end_?eff|(^|_)eef?(_|$)", re.IGNORECASE)
"""Words by which files name the end of an arm."""

EXCLUDE = 'leave the pair out by <contact><exclude body1="..." body2="..."/></contact> in the file'

ARM, MEND = "an arm stands on a fixed base and has 2 to 7 hinges and slides before its flange", "correct it in the file"

Line = tuple[str, bool, str, str]
"""What was examined, whether it can be used, what was found, a remedy."""


def examine_model(file: str) -> Iterator[Line]:
    """Examine a model for both of its uses, as the arm of robot `mjcf` and as scenery (`world.scenery`), and what stands against each.

    Of an arm: flanges, joints, torque limits, servos with their gains and their wind-up by friction, and a scenario to begin with.

    Raises:
        ParameterError: the file is not there.
    """
    path = place_of_file(file)
    try:
        model = compiled(file)
    except ParameterError as error:
        found, _, remedy = error.problem.rpartition("; ")
        yield "model", False, found, remedy
        return
    parts = (model.njnt, "joint"), (model.nu, "actuator"), (model.nsite, "site"), (model.ngeom, "geom"), (model.nmesh, "mesh")
    yield "model", True, ", ".join(f"{n} {word}{'' if n == 1 else 'es' if word == 'mesh' else 's'}" for n, word in parts), ""
    usable, refused = _flanges(file, model)
    against = _against_scenery(file)
    if against and not usable:
        yield "as an arm", False, refused, _remedy(refused)
        yield "as scenery", False, *against
    elif usable:
        yield from _as_arm(file, model, usable, path.read_text(errors="replace").splitlines())
        yield "as scenery", True, f"no: {against[0]}" if against else "yes", ""
    else:
        yield "as an arm", True, f"no: {refused}", ""
        for what, found in examine_scenery(file):
            yield what, True, found, ""
        yield "as scenery", True, f"world: {{scenery: {file}}}", ""


def _remedy(refused: str) -> str:
    """What would make an arm of a file that is none: a mistake in its numbers is corrected there."""
    return MEND if ": file must" in refused else ARM


def _as_arm(file: str, model: mujoco.MjModel, usable: dict[str, JointChain], lines: list[str]) -> Iterator[Line]:
    """What robot `mjcf` makes of a file."""
    flange = likely_flange(model, usable)
    yield "as an arm", True, f"robot: {{kind: mjcf}}, for instance with flange: {flange}", ""
    for name, chain in usable.items():
        yield "flange", True, f"{name}: {', '.join(chain.names)}", ""
    chain = usable[flange]
    start = first_posture(file, flange, chain)
    yield from _of_joints(chain, lines)
    yield from _of_servos(file, model, chain, start.q)
    if found := touching(file, chain, start.q):
        yield "contact", False, f"{found} touch, in the best of {TRIED} postures, too", f"{EXCLUDE}; a run with a contact ends as collided"
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
    """The sites and bodies that can be the flange of an arm, with the joints before each; and why others cannot, in words."""
    usable: dict[str, JointChain] = {}
    refusals: dict[str, list[str]] = {}
    for name in _ends(model):
        try:
            usable[name] = joint_chain(file, name, ())
        except ParameterError as error:
            refusals.setdefault(f"{error.field} {error.problem}", []).append(name)
    if not model.njnt:
        return {}, "it has no joints"
    return usable, "; ".join(f"{', '.join(names)}: {words}" for words, names in refusals.items()) or "no site and no body has a name"


def _ends(model: mujoco.MjModel) -> list[str]:
    """Names that could be a flange: the sites, the bodies that carry no other body, and the one at which an arm ends."""
    parents = set(model.body_parentid.tolist())
    leaves = {i for i in range(1, model.nbody) if i not in parents} | ({_trunk_end(model)} - {0})
    names = [*(model.site(i).name for i in range(model.nsite)), *(model.body(i).name for i in sorted(leaves))]
    return list(dict.fromkeys(name for name in names if name))


def _trunk_end(model: mujoco.MjModel) -> int:
    """The body with the last joint before the joints branch, as they do at a gripper's fingers; 0 where they branch at the root."""
    moves = model.body_jntnum > 0
    for body in range(model.nbody - 1, 0, -1):  # children come after their parents
        moves[model.body_parentid[body]] |= moves[body]
    here = last = 0
    while len(further := [b for b in range(here + 1, model.nbody) if model.body_parentid[b] == here and moves[b]]) == 1:
        (here,) = further
        last = here if model.body_jntnum[here] else last
    return last


def likely_flange(model: mujoco.MjModel, usable: dict[str, JointChain]) -> str:
    """Which of the usable ends carries the camera: at the end of the trunk, named as a flange, a site rather than a body, farthest out.

    The trunk are the joints before they branch. Where no end is at its end, the one with the most joints.
    """
    end = _trunk_end(model)
    trunk = {model.joint(i).name for i in range(model.njnt) if _carries(model, int(model.jnt_bodyid[i]), end)}
    sites = {model.site(i).name: int(model.site_bodyid[i]) for i in range(model.nsite)}

    def rank(name: str) -> tuple[bool, int, bool, bool, int]:
        joints, named = usable[name].names, FLANGE_NAME.search(name) is not None
        return set(joints) == trunk, len(joints), named, name in sites, sites[name] if name in sites else model.body(name).id

    return max(usable, key=rank)


def _carries(model: mujoco.MjModel, body: int, end: int) -> bool:
    """Whether a body is another one, or between it and the root."""
    while end > body:
        end = int(model.body_parentid[end])
    return end == body


def _of_joints(chain: JointChain, lines: list[str]) -> Iterator[Line]:
    """Ranges, torque limits and drives of the longest chain's joints, each with its line where something is missing."""
    for i, name in enumerate(chain.names):
        missing = _missing(chain, i)
        where = f", line {line}" if missing and (line := _line_of(name, lines)) else ""
        note = f" [{'; '.join(missing)}{where}]" if missing else ""
        yield "joint", True, f"{name}: {_span(chain, i)}{note}", ""


def _of_servos(file: str, model: mujoco.MjModel, chain: JointChain, q: Array) -> Iterator[Line]:
    """The gains of the servos that `actuation: velocity` adds for a start at q (n,), and of the file's own, with friction's effect."""
    for i, (name, m) in enumerate(zip(chain.names, inertia_at(file, chain.names, tuple(q.tolist())), strict=True)):
        friction, slides = float(chain.friction[i]), bool(chain.slides[i])
        yield "servo", True, f"{name}: {_gains(*servo_gains(m, friction, slides), friction, slides)}, added by actuation: velocity", ""
        if chain.drives[i] in ("velocity", "position"):
            kp, kv = own_gains(model, model.joint(name).id)
            yield "servo", True, f"{name}: {_gains(kp, kv, friction, slides)}, its own, used by actuation: file", ""


def _gains(kp: float, kv: float, friction: float, slides: bool) -> str:
    """Gains of a servo in words, and how far friction winds it up before the joint moves, with a warning where that is much."""
    force, length = ("N", "m") if slides else ("Nm", "rad")
    gains = f"kp {kp:.4g} {force}/{length}, " * (kp > 0) + f"kv {kv:.4g} {force} s/{length}"
    if kp == 0:
        return f"{gains}; it does not move under {friction / kv:.2g} {length}/s" if friction else gains
    size, unit = (1e3, "mm") if slides else (float(np.degrees(1.0)), "deg")
    most = size * (WIND_UP_M if slides else WIND_UP_RAD)
    found = size * friction / kp
    warning = f" (WARNING: over {most:g} {unit} the joint begins late and turns back late)" if found > 1.01 * most else ""
    return f"{gains}; friction of {friction:.3g} {force} winds it up by {found:.2g} {unit}{warning}" if friction else gains


def _span(chain: JointChain, i: int) -> str:
    """Kind, range and torque limit of a joint."""
    slides, torque = bool(chain.slides[i]), float(chain.torque[i])
    low, high = (chain.limits[i] * (1.0 if slides else np.degrees(1.0))).tolist()
    spans = f"{low:.4g} to {high:.4g} {'m' if slides else 'deg'}" if np.isfinite(low) else "without end" if slides else "turns without end"
    strength = f", at most {torque:.4g} {'N' if slides else 'Nm'}" if np.isfinite(torque) else ""
    return f"{'slide' if slides else 'hinge'}, {spans}{strength}"


def _missing(chain: JointChain, i: int) -> list[str]:
    """What the file does not say about a joint, in words."""
    drive = chain.drives[i]
    missing = [] if np.isfinite(chain.torque[i]) else ["no torque limit (actuatorfrcrange)"]
    return missing if drive in ("velocity", "position") else [*missing, f"a {drive} actuator" if drive else "no actuator"]


def _line_of(joint: str, lines: list[str]) -> int:
    """The line of a file that names a joint; 0 where another file that it includes does."""
    wanted = re.compile(rf'<joint\b[^>]*\bname="{re.escape(joint)}"')
    return next((number for number, line in enumerate(lines, start=1) if wanted.search(line)), 0)
