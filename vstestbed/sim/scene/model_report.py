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
from vstestbed.robots.mjcf import servo_gains
from vstestbed.sim.scene.joint_chain import compiled, inertia_at, joint_chain
from vstestbed.sim.scene.scenery import examine_scenery

Line = tuple[str, bool, str, str]
"""What was examined, whether it can be used, what was found, a remedy."""


def examine_model(file: str) -> Iterator[Line]:
    """Examine a model as the robot `mjcf` would use it: flanges, joints, torque limits, servos and their gains, and a block to begin with.

    A file without joints is examined as scenery (`world.scenery`).

    Raises:
        ParameterError: the file is not there.
    """
    path = place_of_file(file)
    try:
        model = compiled(file)
    except ParameterError as error:
        yield "model", False, error.problem, "correct the file; MuJoCo names the line"
        return
    if not model.njnt:
        for what, found in examine_scenery(file):
            yield what, True, found, ""
        yield "scenario", True, f"world: {{scenery: {file}}}", ""
        return
    yield "model", True, f"{model.njnt} joints, {model.nu} actuators, {model.nsite} sites, {model.nmesh} meshes", ""
    usable: list[tuple[str, JointChain]] = []
    refusals: dict[str, list[str]] = {}
    for name in _ends(model):
        try:
            usable.append((name, joint_chain(file, name, ())))
        except ParameterError as error:
            refusals.setdefault(f"{error.field} {error.problem}", []).append(name)
    for name, chain in usable:
        yield "flange", True, f"{name}: {', '.join(chain.names)}", ""
    if not usable:
        why = "; ".join(f"{', '.join(names)}: {words}" for words, names in refusals.items()) or "it has no bodies"
        yield "flange", False, why, "an arm stands on a fixed base and has 2 to 7 hinges and slides before its flange"
        return
    name, chain = max(usable, key=lambda found: len(found[1].names))
    yield from _of_joints(chain, path.read_text(errors="replace").splitlines())
    yield from _of_servos(file, chain)
    yield "scenario", True, _block(file, name, chain), ""


def _ends(model: mujoco.MjModel) -> list[str]:
    """Names that could be a flange: the sites, and the bodies that carry no other body."""
    parents = set(model.body_parentid.tolist())
    leaves = [model.body(i).name for i in range(1, model.nbody) if i not in parents]
    return [name for name in [*(model.site(i).name for i in range(model.nsite)), *leaves] if name]


def _of_joints(chain: JointChain, lines: list[str]) -> Iterator[Line]:
    """Ranges, torque limits and drives of the longest chain's joints, each with its line where something is missing."""
    for i, name in enumerate(chain.names):
        missing = _missing(chain, i)
        where = f", line {line}" if missing and (line := _line_of(name, lines)) else ""
        note = f" [{'; '.join(missing)}{where}]" if missing else ""
        yield "joint", True, f"{name}: {_span(chain, i)}{note}", ""


def _of_servos(file: str, chain: JointChain) -> Iterator[Line]:
    """The gains of the servos that `actuation: velocity` adds, at the start that the printed block has."""
    inertia = inertia_at(file, chain.names, tuple(_middle(chain).tolist()))
    for name, slides, m, friction in zip(chain.names, chain.slides, inertia, chain.friction, strict=True):
        (kp, kv), per = servo_gains(m, float(friction), bool(slides)), "N/m" if slides else "Nm/rad"
        yield "servo", True, f"{name}: kp {kp:.4g} {per}, kv {kv:.4g} {per.replace('/', ' s/')} (added by actuation: velocity)", ""


def _span(chain: JointChain, i: int) -> str:
    """Kind, range and torque limit of a joint."""
    slides, torque = bool(chain.slides[i]), float(chain.torque[i])
    low, high = (chain.limits[i] * (1.0 if slides else np.degrees(1.0))).tolist()
    spans = f"{low:.4g} to {high:.4g} {'m' if slides else 'deg'}" if np.isfinite(low) else "turns without end"
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


def _middle(chain: JointChain) -> Array:
    """The middle of each joint's range (n,) [rad, m], 0 of one that turns without end."""
    return np.where(np.isfinite(chain.limits), chain.limits, 0.0).mean(axis=1)


def _block(file: str, flange: str, chain: JointChain) -> str:
    """A robot's block of a scenario, with a start in the middle of each range."""
    middle = _middle(chain)
    start = np.where(chain.slides, middle, np.degrees(middle)).round(3).tolist()
    speeds = [0.25 if slides else 1.0 for slides in chain.slides]
    return f"robot: {{kind: mjcf, file: {file}, flange: {flange}, speed_limits: {speeds}, start: {{nominal: {{q_deg: {start}}}}}}}"
