"""Reads an arm's joints from its MJCF or URDF file into plain numbers; says what cannot be used;
makes one file of arm and platform.
"""

from __future__ import annotations

import functools
import hashlib
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.files import make_folder, write_whole
from vstestbed.core.named_files import model_path, place_of_file
from vstestbed.effects.base import places_of
from vstestbed.effects.body import Change, reshape
from vstestbed.robots.chain import JointChain, Load
from vstestbed.sim.scene.model_files import (
    MOST_KG,
    cannot_compile,
    check_options,
    files_in,
    read_model,
)

MOST_JOINTS = 7
MOST_INERTIA = 1e12  # of a body, about its own centre [kg m^2]
# beyond this distance from its target a camera has diverged (`endings.divergence.FAR_M`)
MOST_ARM_M = 200.0
WORDS = {
    int(mujoco.mjtJoint.mjJNT_FREE): "a free joint",
    int(mujoco.mjtJoint.mjJNT_BALL): "a ball joint",
}


@functools.lru_cache(maxsize=8)
def compiled(file: str) -> mujoco.MjModel:
    """The model of a file on its own. Raises ParameterError: `file` is not there, or MuJoCo cannot
    compile it.
    """
    path = place_of_file(file)
    try:
        spec = read_model(path)
        check_options(spec, path)
        model = spec.compile()
    except ParameterError:
        raise
    except (ValueError, mujoco.FatalError) as error:
        raise cannot_compile(error, path, "an MJCF or URDF file") from None
    _check_masses(model, path)
    return model


def _check_masses(model: mujoco.MjModel, path: Path) -> None:
    """Refuse masses that no robot has, of bodies that move: of shapes and densities each of which
    might be.
    """
    for body in np.flatnonzero(model.body_weldid).tolist():
        mass = float(model.body_mass[body])
        inertia = float(model.body_inertia[body].max())
        if not (mass <= MOST_KG and inertia <= MOST_INERTIA):
            words = (
                f"gives the body {model.body(body).name or body} a mass of {mass:.3g} kg and an"
                f" inertia of up to {inertia:.3g} kg m^2, and at most {MOST_KG:g} kg and"
                f" {MOST_INERTIA:g} kg m^2 can be; correct its shapes or densities there"
            )
            raise ParameterError("file", words, str(path))


@functools.lru_cache(maxsize=8)
def joint_chain(file: str, flange: str, names: tuple[str, ...]) -> JointChain:
    """The joints from the root to a flange.

    file: the model's. flange: one of its sites or bodies. names: the joints, in their order; () for
    all between root and flange. Raises
    ParameterError: `file`, `flange` or `joints`, with what would work.
    """
    model = compiled(file)
    if (at := flange_in(model, flange)) is None:
        raise ParameterError.unknown(
            "flange", "site and no body of the file", _ends_of(model), flange
        )
    body, T_body_flange = at
    joints = joints_to(model, body)
    found = tuple(model.joint(i).name for i in joints)
    _check(model, flange, joints, found, names)
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[joints]] = 0.0
    mujoco.mj_kinematics(model, data)
    T_world_body = placed(data.xpos[body], data.xmat[body])
    _check_length(np.array([*data.xanchor[joints], T_world_body[:3, 3]]), flange)
    bounded = model.jnt_limited[joints].astype(bool)[:, None]
    return JointChain(
        names=found,
        slides=model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE,
        axes=data.xaxis[joints].copy(),
        anchors=data.xanchor[joints].copy(),
        T_0=T_world_body @ T_body_flange,
        limits=np.where(bounded, model.jnt_range[joints], [-np.inf, np.inf]),
        torque=_torque(model, joints),
        friction=model.dof_frictionloss[model.jnt_dofadr[joints]].copy(),
        drives=tuple(_drive(model, i) for i in joints),
    )


def _ends_of(model: mujoco.MjModel) -> str:
    """What could be a flange, in words: the sites, or the bodies of a file without sites."""
    kind = "bodies"
    _, *there = names_of(model, "body")  # the first is the world
    if model.nsite:
        kind = "sites"
        there = names_of(model, "site")
    if not there:
        return "it has none"
    known = ", ".join(filter(None, there))
    return f"its {kind}: {known}" if known else f"its {kind} have no names"


@functools.lru_cache(maxsize=64)
def inertia_at(
    file: str, joints: tuple[str, ...], q: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """The mass matrix (n, n) of joints at positions q [rad, m], and what of its diagonal are
    rotors, the armature (n,) [kg m^2, kg].
    """
    model = compiled(str(model_path(file)))
    data = mujoco.MjData(model)
    places, dofs = places_of(model, joints)
    data.qpos[places] = q
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    return M[np.ix_(dofs, dofs)], model.dof_armature[dofs].copy()


class Masses:
    """Masses of an arm on its own (`robots.chain.ArmDynamics`), by recursive Newton-Euler and the
    composite rigid body algorithm.

    file, flange, joints, load: as of `dynamics`.
    """

    def __init__(self, file: str, flange: str, joints: tuple[str, ...], load: Load | None):
        spec = read_model(place_of_file(file))
        if load is not None:
            mass, *com, edge = load
            found = flange_in(compiled(file), flange)
            assert found is not None  # the arm was made with it
            T = found[1]
            body = flange_body(spec, flange).add_body(name="load", pos=T[:3, :3] @ com + T[:3, 3])
            body.mass = mass
            body.inertia = [mass * edge**2 / 6] * 3
            body.explicitinertial = True
            body.ipos = np.zeros(3)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._places, self._dofs = places_of(self._model, joints)
        self._full = np.zeros((self._model.nv, self._model.nv))
        self._tau = np.zeros(self._model.nv)

    def inverse(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """See `robots.chain.ArmDynamics`."""
        model = self._model
        data = self._data
        self._place(q)
        data.qvel[self._dofs] = qd
        data.qacc[self._dofs] = qdd
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 1, self._tau)
        return self._tau[self._dofs] + model.dof_armature[self._dofs] * qdd

    def mass(self, q: np.ndarray) -> np.ndarray:
        """See `robots.chain.ArmDynamics`."""
        self._place(q)
        mujoco.mj_crb(self._model, self._data)
        mujoco.mj_fullM(self._model, self._data, self._full)
        return self._full[np.ix_(self._dofs, self._dofs)]

    def _place(self, q: np.ndarray) -> None:
        self._data.qpos[self._places] = q
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)


def dynamics(file: str, flange: str, joints: tuple[str, ...], load: Load | None) -> Masses:
    """The masses of an arm by its file, with a load at its flange."""
    return Masses(str(model_path(file)), flange, joints, load)


def names_of(
    model: mujoco.MjModel, kind: Literal["body", "jnt", "geom", "site", "cam", "tex"]
) -> list[str]:
    """Names of all bodies, joints, geoms, ... of a model, by their numbers; "" for none."""
    return [getattr(model, kind)(i).name for i in range(getattr(model, f"n{kind}"))]


def placed(xyz: np.ndarray, R: np.ndarray) -> np.ndarray:
    """A pose (4, 4) of a place (3,) and a rotation (9,) or (3, 3)."""
    T = np.eye(4)
    T[:3, :3] = R.reshape(3, 3)
    T[:3, 3] = xyz
    return T


def turned(quat: np.ndarray) -> np.ndarray:
    """MuJoCo's rotation (3, 3) of a quaternion, wxyz."""
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, quat)
    return R.reshape(3, 3)


def before(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    eye: np.ndarray,
    ways: np.ndarray,
    slack: float = 0.0,
    left_out: tuple[int, ...] = (),
) -> np.ndarray:
    """The geom that hides each of the points eye + ways (N, 3) from an eye (3,), shape (N,); -1 for
    none, and where a point is NaN.

    slack: a geom that the ray hits less than this before the point does not hide it [m]. left_out:
    groups of geoms that hide nothing.
    """
    groups = np.ones(6, dtype=np.uint8)
    geom = np.zeros(1, dtype=np.int32)
    found = np.full(len(ways), -1)
    groups[list(left_out)] = 0
    reach = np.linalg.norm(ways, axis=1)
    for i in np.flatnonzero(np.isfinite(reach)):
        way = ways[i] / max(reach[i], 1e-9)
        distance = mujoco.mj_ray(model, data, eye, way, groups, 1, -1, geom)
        if 0 <= distance < reach[i] - slack:
            found[i] = geom[0]
    return found


def flange_in(model: mujoco.MjModel, flange: str) -> tuple[int, np.ndarray] | None:
    """The body that carries the flange, a site or a body, and the flange's pose (4, 4) in it; None
    where the model has neither.

    As the compiler has it: a spec keeps an orientation as the file writes it (quat, euler,
    axisangle, xyaxes, zaxis), and its `quat` is the identity where the file writes another of
    these.
    """
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, flange)
    if site >= 0:
        T_body_flange = placed(model.site_pos[site], turned(model.site_quat[site]))
        return int(model.site_bodyid[site]), T_body_flange
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, flange)
    return (body, np.eye(4)) if body > 0 else None


def flange_body(spec: mujoco.MjSpec, name: str) -> mujoco.MjsBody:
    """The body that carries the camera: that of the site of this name, or the body itself."""
    site = spec.site(name)
    return site.parent if site else spec.body(name)


def joints_to(model: mujoco.MjModel, body: int) -> list[int]:
    """The joints from the root to a body."""
    joints: list[int] = []
    while body > 0:
        first = int(model.body_jntadr[body])
        n = int(model.body_jntnum[body])
        joints = [*range(first, first + n), *joints]
        body = int(model.body_parentid[body])
    return joints


def _check(
    model: mujoco.MjModel,
    flange: str,
    joints: list[int],
    found: tuple[str, ...],
    names: tuple[str, ...],
) -> None:
    for i, name in zip(joints, found, strict=True):
        if (word := WORDS.get(int(model.jnt_type[i]))) is not None:
            words = (
                f"must be hinges and slides, and {name or 'one of them'} is {word}:"
                " an arm stands on a base that is fixed in the world"
            )
            raise ParameterError("joints", words)
    if names and names != found:
        words = f"must be those between the root and {flange}, in their order: {', '.join(found)}"
        raise ParameterError("joints", words, list(names))
    if not 2 <= len(found) <= MOST_JOINTS:
        raise ParameterError.count(
            "flange", f"after 2 to {MOST_JOINTS}", f"joints, and {flange} is after {len(found)}"
        )
    if not all(found):
        words = f"joint {found.index('') + 1} of them has no name"
        raise ParameterError("file", f"must name each joint before {flange}; {words}")
    for i, name in zip(joints, found, strict=True):
        _check_numbers(model, i, name)
    _check_free(model, joints)


def _check_length(places: np.ndarray, flange: str) -> None:
    """Refuse an arm whose lengths are not in metres.
    places: of its joints and its flange, (n + 1, 3) [m].
    """
    length = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
    if length > MOST_ARM_M:
        words = (
            f"must have at most {MOST_ARM_M:g} m from the first joint to {flange}, and has"
            f" {length:.4g} m: lengths are in metres, and these look like millimetres"
        )
        raise ParameterError("file", words)


def _check_free(model: mujoco.MjModel, joints: list[int]) -> None:
    """Refuse constraints of the file that couple the arm's joints, with one another or with what
    stands: each is moved by itself here. Those of a gripper, beyond the flange or beside it, stay.
    """
    works = "works: the file without it, or a flange before these joints"
    for i in np.flatnonzero(model.eq_active0).tolist():
        if names := _names(model, _coupled(model, i), joints):
            kind = mujoco.mjtEq(model.eq_type[i]).name.removeprefix("mjEQ_").lower()
            of = "joint, such as a URDF's <mimic>" if kind == "joint" else kind
            words = f"(equality {of}), and each joint of an arm is moved by itself here"
            raise ParameterError("file", f"couples {', '.join(names)} {words}; {works}")
    for i in np.flatnonzero(model.tendon_limited).tolist():
        if names := _names(model, _spanned(model, i), joints):
            words = (
                f"by the range of tendon {model.tendon(i).name or i},"
                " and each joint of an arm has a range of its own here"
            )
            raise ParameterError("file", f"limits {', '.join(names)} {words}; {works}")


def _names(model: mujoco.MjModel, some: set[int], joints: list[int]) -> list[str]:
    """Names of those joints that are among some."""
    return [model.joint(i).name for i in joints if i in some]


def pulled(model: mujoco.MjModel, joints: list[int]) -> dict[str, list[str]]:
    """The tendons that act with a force of their own on some of these joints, with the names of
    these: springs, dampers, friction, rotors. A run keeps them; a law and its model know nothing.
    """
    found: dict[str, list[str]] = {}
    strong = np.abs(model.tendon_stiffness) + np.abs(model.tendon_damping)
    strong += np.abs(model.tendon_frictionloss) + np.abs(model.tendon_armature)
    for i in np.flatnonzero(strong).tolist():
        if names := _names(model, _spanned(model, i), joints):
            found[model.tendon(i).name or str(i)] = names
    return found


def _coupled(model: mujoco.MjModel, equality: int) -> set[int]:
    """The joints that an equality does not leave free: those that follow another one, and those of
    a closed loop.
    """
    kind = mujoco.mjtEq(model.eq_type[equality])
    one = int(model.eq_obj1id[equality])
    other = int(model.eq_obj2id[equality])
    if kind == mujoco.mjtEq.mjEQ_JOINT:
        return {one}  # the other one moves it
    if kind == mujoco.mjtEq.mjEQ_TENDON:
        return _spanned(model, one) | (_spanned(model, other) if other >= 0 else set())
    if kind not in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
        return set()
    if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
        one = int(model.site_bodyid[one])
        other = int(model.site_bodyid[other])
    # what moves both changes nothing between them
    return set(joints_to(model, one)) ^ set(joints_to(model, other))


def _spanned(model: mujoco.MjModel, tendon: int) -> set[int]:
    """The joints that change a tendon's length: those that a fixed one combines, and those between
    the bodies along which a spatial one runs.
    """
    first = model.tendon_adr[tendon]
    of = slice(first, first + model.tendon_num[tendon])
    found = set[int]()
    before = list[set[int]]()
    for kind, thing in zip(
        model.wrap_type[of].tolist(), model.wrap_objid[of].tolist(), strict=True
    ):
        if kind == mujoco.mjtWrap.mjWRAP_JOINT:
            found.add(thing)
        elif kind == mujoco.mjtWrap.mjWRAP_SITE:
            before.append(set(joints_to(model, int(model.site_bodyid[thing]))))
        elif kind in (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER):
            before.append(set(joints_to(model, int(model.geom_bodyid[thing]))))
    # what moves all of them changes nothing between them
    return found | (set.union(*before) - set.intersection(*before) if before else set())


def _check_numbers(model: mujoco.MjModel, joint: int, name: str) -> None:
    """Refuse what MuJoCo passes over: a range with its ends exchanged, which is none to it, and
    friction or inertia under zero.
    """
    dof = model.jnt_dofadr[joint]
    low, high = model.jnt_range[joint].tolist()
    if low > high:
        words = f"a range from its lower to its upper end, got {low:.4g} to {high:.4g}"
        raise ParameterError("file", f"must give {name} {words}")
    # Damping may be: of the Panda's joint 6 it was identified as -0.013 Nm s/rad.
    for word in ("armature", "frictionloss"):
        value = getattr(model, f"dof_{word}")[dof]
        if value < 0:
            raise ParameterError("file", f"must give {name} {word} of 0 or more, got {value:g}")


def drivers(model: mujoco.MjModel, joint: int) -> list[int]:
    """The actuators that act on a joint alone."""
    alone = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    return np.flatnonzero(alone & (model.actuator_trnid[:, 0] == joint)).tolist()


def force_limits(model: mujoco.MjModel, joints: Sequence[int] | np.ndarray) -> np.ndarray:
    """Largest torque of each joint [Nm, N]: the lower of its own limit and that of the actuators on
    it; infinite without both.
    """
    torque = np.full(len(joints), np.inf)
    for k, i in enumerate(joints):
        if model.jnt_actfrclimited[i]:
            torque[k] = model.jnt_actfrcrange[i, 1]
        for a in drivers(model, i):
            if model.actuator_forcelimited[a]:
                most = abs(model.actuator_gear[a, 0]) * model.actuator_forcerange[a, 1]
                torque[k] = min(torque[k], most)
    return torque


def _torque(model: mujoco.MjModel, joints: list[int]) -> np.ndarray:
    """`force_limits`, or what a motor's largest control makes of it, where that is lower."""
    torque = force_limits(model, joints)
    for k, i in enumerate(joints):
        for a in drivers(model, i):
            motor = model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE
            if motor and model.actuator_ctrllimited[a]:
                gain = abs(model.actuator_gear[a, 0]) * model.actuator_gainprm[a, 0]
                torque[k] = min(torque[k], gain * model.actuator_ctrlrange[a, 1])
    return torque


def _drive(model: mujoco.MjModel, joint: int) -> str:
    """The file's actuator of a joint: `velocity`, `position`, `motor`, `two`; "" for none."""
    there = drivers(model, joint)
    if len(there) != 1:
        return "two" if there else ""
    (a,) = there
    _, kp, kv = model.actuator_biasprm[a, :3]
    affine = model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE
    integrates = model.actuator_dyntype[a] == mujoco.mjtDyn.mjDYN_INTEGRATOR
    if not affine or model.actuator_gear[a, 0] != 1:
        return "motor"
    if kp == 0:
        return "velocity" if kv < 0 and not integrates else "motor"
    return "velocity" if integrates else "position"


def _make_absolute(spec: mujoco.MjSpec, parent: Path) -> None:
    """The paths of a model's files, of one in a folder, for a file elsewhere."""
    for things, folder in files_in(spec):
        for thing in things:
            if thing.file:
                thing.file = str((parent / folder / thing.file).resolve())
    spec.meshdir = spec.texturedir = ""


# An arm on a platform as one model: the file that both become together.
ON_DECK = "battery", "scanner", "scanner_cap"  # what stands on the platform where the arm will
PREFIX = "arm_"  # of all names of the arm in the model of both


@functools.lru_cache(maxsize=8)
def mounted(
    platform: str, changes: tuple[Change, ...], arm: str, place: tuple[float, float, float]
) -> str:
    """The path of an MJCF file of a platform with an arm on it, among the temporary files, where it
    stays; its name is that of its content.

    platform, arm: their files. changes: of the platform. place: of the arm's base in the platform's
    frame [m]. The platform has no actuators there; those of the arm keep the word before their
    names by which profiles of servos are chosen.
    """
    file = place_of_file(str(model_path(arm)))
    base = read_model(model_path(platform))
    reshape(base, changes)
    for thing in [*base.actuators, *(geom for geom in base.geoms if geom.name in ON_DECK)]:
        base.delete(thing)
    upper = read_model(file)
    _make_absolute(upper, file.parent)
    for key in list(upper.keys):
        upper.delete(key)
    actuators = [(actuator, actuator.name) for actuator in upper.actuators]
    base.attach(upper, prefix=PREFIX, frame=base.body("base").add_frame(pos=place))
    for actuator, whole in actuators:
        profile, _, name = whole.partition("_")
        actuator.name = f"{profile}_{PREFIX}{name}" if name else whole
    base.modelname = "mounted"
    base.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    base.compile()
    text = base.to_xml()
    folder = Path(tempfile.gettempdir()) / "vstestbed_mounted"
    path = folder / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.xml"
    if not path.is_file():
        make_folder(folder)
        write_whole(path, text)
    return str(path)
