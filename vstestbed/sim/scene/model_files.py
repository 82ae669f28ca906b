"""Meshes and textures of a robot's file, or of scenery, carried into the scene, so that a run's
folder holds all of it.
"""

from __future__ import annotations

import ctypes
import math
import re
from pathlib import Path
from typing import Any
from xml.dom import expatbuilder
from xml.etree import ElementTree

import mujoco

from vstestbed.core.errors import ParameterError, short
from vstestbed.core.foreign import foreign, of_field
from vstestbed.core.named_files import is_there, model_path
from vstestbed.effects.base import ASSETS
from vstestbed.targets.picture import as_png

JPEG = ".jpg", ".jpeg"


def lay_picture(
    scene: mujoco.MjSpec, paint: mujoco.MjsMaterial, name: str, file: str, png: bytes
) -> None:
    """Lay a picture in memory on a material of the scene, as a texture of a name and as a file
    among the scene's assets.
    """
    scene.texturedir = ASSETS
    scene.assets = {**scene.assets, f"{ASSETS}/{file}": png}
    scene.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=file)
    paint.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def carry_files(
    model: mujoco.MjSpec, file: Path, scene: mujoco.MjSpec, prefix: str
) -> dict[str, bytes]:
    """The files that a model refers to, under names of their own, for the scene's assets;
    keyframes, which fit no other scene, go.

    model: of the file, not attached yet. prefix: of its names in the scene (`robot/`).
    """
    for key in list(model.keys):
        model.delete(key)
    taken: dict[str, bytes] = {}
    for things, folder in files_in(model):
        for thing in things:
            if thing.file:
                thing.file = _carried(file, folder, thing.file, taken, prefix)
    for texture in model.textures:
        texture.cubefiles = [
            _carried(file, model.texturedir, face, taken, prefix) for face in texture.cubefiles
        ]
    if taken:
        model.meshdir = model.texturedir = scene.meshdir = scene.texturedir = ASSETS
    return taken


def files_in(model: mujoco.MjSpec) -> list[tuple[Any, str]]:
    """What in a model may be a file, with the folder of such files."""
    return [
        (model.meshes, model.meshdir),
        (model.textures, model.texturedir),
        (model.hfields, model.meshdir),
    ]


def files_read(path: Path) -> list[Path]:
    """The files that MuJoCo reads with a model: what it includes, meshes, textures, height fields,
    skins; none of what it cannot read.
    """
    names = _included(path)
    try:
        model = read_model(path)
    except (OSError, ValueError):  # it is no model, or a run with it is refused, and says why
        return names
    return names + _named_in(model, path)


def _named_in(model: mujoco.MjSpec, path: Path) -> list[Path]:
    """The files that the spec of a model's file names."""
    names = list[Path]()
    for things, folder in (*files_in(model), (model.skins, model.meshdir)):
        names += [path.parent / folder / thing.file for thing in things if thing.file]
    for texture in model.textures:
        names += [path.parent / model.texturedir / face for face in texture.cubefiles if face]
    return names


def _are_regular(names: list[Path], path: Path) -> None:
    """Refuse what is there and no regular file: of a pipe MuJoCo would read for ever. What is not
    there it tells itself.
    """
    for name in names:
        with foreign(path, "names of files", of_field("file")):
            irregular = name.exists() and not name.is_file()
        if irregular:
            raise ParameterError(
                "file",
                f"names {name}, which is not a regular file; put a regular file there",
                str(path),
            )


MOST = {
    "replicate": 10_000,
    "composite": 10_000,
    "flexcomp": 10_000,
    "texture": 1 << 26,
    "hfield": 1 << 24,
    "size": 1 << 32,
}
COUNTS = {
    "count",
    "width",
    "height",
    "nrow",
    "ncol",
    "memory",
    "nuserdata",
    "nconmax",
    "njmax",
    "nstack",
    "nkey",
}
"""Attributes of these elements that say how much there is: of an element their product may be as
above, of nested copies that of all.
"""
COUNTED = re.compile(
    rf"""</replicate|<({"|".join(MOST)})((?:\s+[\w:.-]+\s*=\s*(?:"[^"]*"|'[^']*'))*)\s*(/?)"""
)
ATTRIBUTE = re.compile(r"""([\w:.-]+)\s*=\s*["']([^"']*)""")
UNITS = {unit: 1 << 10 * (i + 1) for i, unit in enumerate("KMGTPE")}


def _is_of_a_size(path: Path) -> None:
    """Refuse a file that asks for more than a machine has, before MuJoCo makes it, which neither
    stops nor says why. Raises ParameterError: `file`.
    """
    nested = [1.0]
    for found in COUNTED.finditer(_uncommented(path)):
        element, attributes, empty = found.groups()
        if element is None:
            nested = nested[:-1] or [1.0]
            continue
        total = _asked_by(attributes, path)
        if element == "replicate":
            total *= nested[-1]
        if not total <= MOST[element]:
            words = (
                f"asks for {total:.3g} by <{element}{short(attributes)[1:-1]}>,"
                f" at most {MOST[element]:.3g} are made; make it smaller"
            )
            raise ParameterError("file", words, str(path))
        if element == "replicate" and not empty:
            nested.append(total)


def _asked_by(attributes: str, path: Path) -> float:
    """How much the attributes of an element ask for: the product of their counts."""
    total = 1.0
    counts = [value for name, value in ATTRIBUTE.findall(attributes) if name in COUNTS]
    with foreign(path, "numbers that say how much there is", of_field("file")):
        for number in " ".join(counts).split():
            total *= max(float(number.rstrip("KMGTPE")), 1.0) * UNITS.get(number[-1], 1)
    return total


NAME = re.compile(r"""\bname\s*=\s*["']([^"']*)""")
ELEMENT_WITH = re.compile(r"""<([\w:.-]+)((?:\s+[\w:.-]+\s*=\s*(?:"[^"]*"|'[^']*'))+)""")
# The largest numbers of a robot's file: of larger ones sums lose the rest, and products overflow.
MOST_M = 1e6  # of a length [m]
MOST_KG = 1e9  # of a mass [kg] and an inertia [kg m^2]
MOST_ELSE = 1e16  # of all others, in whatever unit
LARGEST = {
    **dict.fromkeys(("pos", "xyz", "fromto", "size", "radius", "length"), (MOST_M, " m")),
    **dict.fromkeys(("mass", "density", "armature"), (MOST_KG, " kg")),
    **dict.fromkeys(("diaginertia", "fullinertia"), (MOST_KG, " kg m^2")),
    **dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), (MOST_KG, " kg m^2")),
}
"""By the attribute; others are at most MOST_ELSE."""
LIMITS = {
    "range",
    "ctrlrange",
    "forcerange",
    "actrange",
    "actuatorfrcrange",
    "lower",
    "upper",
    "effort",
    "velocity",
    "acceleration",
    "deceleration",
    "jerk",
    "soft_lower_limit",
    "soft_upper_limit",
}
"""Attributes of which an infinite or huge number means that there is no limit."""


def _has_real_numbers(path: Path) -> None:
    """Refuse numbers that no robot has, which MuJoCo takes: not finite, or absurdly large.
    Raises ParameterError: `file`, with the element and the attribute.
    """
    text = _uncommented(path)
    names = set(NAME.findall(text))  # which may be `nan`, or look like a number
    after = ""
    for found in ELEMENT_WITH.finditer(text):
        element, attributes = found.groups()
        given = dict(ATTRIBUTE.findall(attributes))
        where = f"<{element}>{after}"
        if "name" in given:
            where = f"<{element}> {given['name']}"
            after = f" after {element} {given['name']}"
        for attribute, value in given.items():
            if value not in names and (wrong := _wrong_number(element, attribute, value)):
                line = text.count("\n", 0, found.start()) + 1
                words = (
                    f"has {attribute}={short(value)} in {where}, line {line},"
                    f" and {wrong}; correct it there"
                )
                raise ParameterError("file", words, str(path))


def _wrong_number(element: str, attribute: str, value: str) -> str:
    """What is wrong with the numbers of an attribute; "" where they are right, or it has none."""
    try:
        numbers = [float(word) for word in value.split()]
    except ValueError:
        return ""
    if any(map(math.isnan, numbers)):
        return "all its numbers must be finite"
    if attribute in LIMITS:
        return ""
    if any(map(math.isinf, numbers)):
        return "all its numbers must be finite"
    of = element if (element, attribute) == ("mass", "value") else attribute
    most, unit = LARGEST.get(of, (MOST_ELSE, ""))
    largest = max(map(abs, numbers), default=0.0)
    return f"at most {most:g}{unit} can be" if largest > most else ""


HARMLESS = {
    "WARMSTART",
    "SENSOR",
    "MIDPHASE",
    "EULERDAMP",
    "AUTORESET",
    "NATIVECCD",
    "MULTICCD",
    "ISLAND",
    "ENERGY",
    "FWDINV",
    "SLEEP",
}
"""Flags that change no motion here: of reports, of speed, and of an integrator that the scene does
not take over.
"""


def check_options(spec: mujoco.MjSpec, path: Path) -> None:
    """Refuse options of a robot's model that a scene would lose, and that change how it moves.
    Others are taken over (`attach.py`), or are of the solver, which is the scene's. Raises
    ParameterError: `file`.
    """
    option = spec.option
    plain = mujoco.MjSpec().option
    lost = [
        name
        for name in ("gravity", "wind")
        if tuple(getattr(option, name)) != tuple(getattr(plain, name))
    ]
    for bits, value in (
        (mujoco.mjtDisableBit, option.disableflags),
        (mujoco.mjtEnableBit, option.enableflags),
    ):
        for name, bit in bits.__members__.items():
            _, _, flag = name.partition("_")
            if flag and flag not in HARMLESS and value & int(bit):
                lost.append(f"flag {flag.lower()}")
    if lost:
        words = (
            f"sets the option {lost[0]}, which is not taken over, and changes how the robot moves;"
            " remove it from the file"
        )
        raise ParameterError("file", words, str(path))


def _included(path: Path) -> list[Path]:
    """The files that a model includes, and those that these include, all from the model's folder;
    comments include none.
    """
    names = list[Path]()
    waiting = [path]
    while waiting:
        for name in INCLUDE.findall(_uncommented(waiting.pop())):
            if path.parent / name not in names:
                names.append(path.parent / name)
                waiting += filter(is_there, names[-1:])
    return names


def take_jpeg(model: mujoco.MjSpec, file: Path) -> None:
    """The textures of a model in `file` that are JPEG files, which MuJoCo does not read, as PNG
    among the model's assets, to compile it.

    Raises ParameterError: one is no picture.
    """
    for number, texture in enumerate(model.textures):
        path = file.parent / model.texturedir / texture.file
        if path.suffix.lower() in JPEG and path.is_file():
            texture.file = f"{number}_{path.stem}.png"
            asset = str(Path(model.texturedir) / texture.file)
            model.assets = {**model.assets, asset: as_png(path)}


LIBRARY = re.compile(r"(lib)?mujoco\.(so|dll|dylib|\d)")
LONG = re.compile(r"-?\d+\.\d{9,}(e[-+]\d+)?")


def exact_xml(spec: mujoco.MjSpec) -> str:
    """A compiled spec as MJCF with all digits of its numbers.

    MuJoCo writes six: with a step of 1/510 s, or drawn masses, the file would be another system.
    Its library has a function for more, which its Python does not have; without it, they are six.
    """
    folder = Path(mujoco.__file__).parent
    library = ctypes.CDLL(str(next(path for path in folder.iterdir() if LIBRARY.match(path.name))))
    digits = getattr(library, "_mjPRIVATE__set_xml_precision", lambda _: None)
    digits(17)
    try:
        return LONG.sub(lambda number: repr(float(number[0])), spec.to_xml())
    finally:
        digits(6)


def _carried(file: Path, folder: str, name: str, taken: dict[str, bytes], prefix: str) -> str:
    """Take up a file that a model in `file` refers to;
    its name in the scene's assets, "" for none.
    """
    if not name:
        return ""
    path = model_path(str(file)).parent / folder / name
    own = path.name
    if jpeg := path.suffix.lower() in JPEG:
        own = path.with_suffix(".png").name
    # its end: file systems take 255 bytes, of which its own name may have all
    new = f"{prefix.strip('/')}_{len(taken)}_{own[-60:]}"
    taken[f"{ASSETS}/{new}"] = as_png(path) if jpeg else path.read_bytes()
    return new


PARSING = re.compile(
    (
        r"XML parse error \d+:\s*Error=(?:XML_)?(?:ERROR_)?(\w+).*?Line"
        r" number=(\d+)(?:.*?XMLElement name=(\w+))?"
    ),
    re.DOTALL,
)
LINE = re.compile(r",?\s*line (\d+)\s*$")
ELEMENT = re.compile(r"\s*Element (?:name )?'([^']*)'(?:, id \d+)?\s*$")
BEGINS = re.compile(r"^(?:XML )?Error:\s*(?:Schema violation:\s*)?")
# How MuJoCo says that a file is of another format, such as SDF
FOREIGN = "could not find decoder", "Unrecognized XML model type"
MISSING = re.compile(r"Error opening file '([^']*)'")


def cannot_compile(error: Exception, path: Path, works: str) -> ParameterError:
    """The error for a file that MuJoCo does not compile.

    error: MuJoCo's. path: of the file. works: what would work, such as `an MJCF file`.

    Returns a ParameterError of `file`: FILE:LINE, where MuJoCo knows it, what is wrong, what would
    work.
    """
    text = " ".join(str(error).split()).rstrip(".")
    if parsed := PARSING.search(text):
        what, line, element = parsed.groups()
        near = f", near the element {element}" if element else ""
        words = f"it is not well-formed XML ({what.replace('_', ' ').lower()}{near})"
        line = _ends_at(path) if what == "PARSING" else int(line)
        return _told(_place(path, line), words, f"works: {works}")
    text = BEGINS.sub("", text)
    found = LINE.search(text)
    line = int(found[1]) if found else 0
    text = LINE.sub("", text)
    if named := MISSING.search(text):
        place = _place(path, line or line_with(named[1], path))
        words = f"it names the file {named[1]}, which is not there"
        return _told(place, words, "correct its name, or the folder it is in")
    words = ELEMENT.sub("", text).replace("attribute: '", "attribute '")
    if (found := ELEMENT.search(text)) and found[1]:
        words = f"{found[1]}: {words}"
    remedy = f"works: {works}" if words.startswith(FOREIGN) else "correct it there"
    return _told(_place(path, line), words, remedy)


def line_with(words: str, path: Path) -> int:
    """The first line of a file that has these words; 0 for none."""
    lines = enumerate(path.read_text(errors="replace").splitlines(), start=1)
    return next((number for number, text in lines if words in text), 0)


def _ends_at(path: Path) -> int:
    """The line where a file stops being XML, such as its last one where an element is not closed;
    MuJoCo tells the element's first.
    """
    try:
        ElementTree.parse(path)
    except ElementTree.ParseError as error:
        return error.position[0]
    return 1


def _told(place: str, words: str, remedy: str) -> ParameterError:
    return ParameterError("file", f"cannot be compiled by MuJoCo ({place}: {words}); {remedy}")


def _place(path: Path, line: int) -> str:
    """FILE:LINE; 0 for a line that is not known. A line may be that of an included file, which
    MuJoCo does not name.
    """
    if line and "<include" in path.read_text(errors="replace"):
        return f"{path}, line {line} there or in a file that it includes"
    return f"{path}:{line}" if line else str(path)


INCLUDE = re.compile(r"""<(?:include|model)\b[^>]*?\bfile\s*=\s*["']([^"']+)""")
ROOT = re.compile(r"\A\ufeff?(?:\s|<\?.*?\?>)*<robot\b[^>]*>", re.DOTALL)
"""The beginning of a URDF without its comments."""
XACRO = re.compile(r"<xacro:")
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
MESH = re.compile(r'(<mesh\b[^>]*\bfilename=")(package|file)://([^"]*)')
UNREADABLE = re.compile(
    r'<visual\b(?:(?!</visual>).)*\bfilename="[^"]*\.(?!stl"|obj")\w+"(?:(?!</visual>).)*</visual>',
    re.DOTALL | re.IGNORECASE,
)
"""What is to be seen by a mesh in a format that MuJoCo does not read (dae, glb)."""
KEEP = '<mujoco><compiler discardvisual="false" fusestatic="false"/></mujoco>'
"""MuJoCo by default throws away a URDF's `visual` shapes, and the names of links on fixed joints,
such as `tool0`.
"""
CONTACT_GROUP = 3


def _blank(part: re.Match[str]) -> str:
    """The empty lines in place of a part that is left out: MuJoCo's errors tell lines."""
    return "\n" * part[0].count("\n")


def _uncommented(path: Path) -> str:
    """The text of an XML file without its comments."""
    return COMMENT.sub(_blank, path.read_text(errors="replace"))


def read_model(path: Path) -> mujoco.MjSpec:
    """The spec of an MJCF or URDF file, as the file has it.

    Of a URDF, fixed links keep their names, a link shows its `visual` shapes, and its `collision`
    shapes only where it has no others. A `<mujoco>` block of its own counts instead. Meshes to look
    at of other formats than STL and OBJ are left out. Raises ValueError: MuJoCo's, for a file that
    it cannot read. ParameterError: `file`, where it is a xacro, names a package whose folder is not
    found, or a file that is no regular one.
    """
    included = _included(path)
    _are_regular(included, path)
    for each in (path, *included):
        if is_there(each):
            _is_of_a_size(each)
            _has_real_numbers(each)
    spec = _parsed(path)
    _are_regular(_named_in(spec, path), path)
    return spec


def _parsed(path: Path) -> mujoco.MjSpec:
    text = _uncommented(path)
    if (root := ROOT.search(text)) is None:
        return mujoco.MjSpec.from_file(str(path))
    if XACRO.search(text):
        raise ParameterError(
            "file",
            f"is a xacro, and no URDF yet; `xacro {path.name} > arm.urdf` writes one",
            str(path),
        )
    if "<mujoco" not in text:
        # in the same line: MuJoCo's errors tell lines
        text = text[: root.end()] + KEEP + text[root.end() :]
    text = UNREADABLE.sub(_blank, text)
    spec = mujoco.MjSpec.from_string(
        MESH.sub(lambda mesh: mesh[1] + _found(path, mesh[2], mesh[3]), text)
    )
    spec.meshdir = str(path.parent.resolve() / spec.meshdir)
    _limit_softly(spec, path)
    for body in spec.bodies:
        touch = [bool(geom.contype or geom.conaffinity) for geom in body.geoms]
        # shapes for contacts are left out of pictures where a link has others to be seen
        if not all(touch):
            for geom, touches in zip(body.geoms, touch, strict=True):
                geom.group = CONTACT_GROUP if touches else geom.group
    return spec


def speeds_in(path: Path) -> dict[str, float]:
    """The `velocity` limits of a URDF's joints by their names [rad/s, m/s], which MuJoCo does not
    read; {} for an MJCF file.
    """
    with foreign(path, "a URDF whose limits are numbers"):
        found = {
            name: float(limit.get("velocity") or 0) for name, limit in _of_joints(path, "limit")
        }
    return {name: speed for name, speed in found.items() if speed > 0}


def _of_joints(path: Path, element: str) -> list[tuple[str, dict[str, str]]]:
    """The attributes of an element of a URDF's joints, with the joints' names; [] for an MJCF
    file.
    """
    text = _uncommented(path)
    if ROOT.search(text) is None:
        return []
    # MuJoCo, too, reads names with prefixes that are not declared.
    joints = expatbuilder.parseString(text, namespaces=False).getElementsByTagName("joint")
    return [
        (joint.getAttribute("name"), dict(found.attributes.items()))
        for joint in joints
        for found in joint.getElementsByTagName(element)
    ]


SOFT = "soft_lower_limit", "soft_upper_limit"
"""Ends of the range in which a URDF's `<safety_controller>` keeps a joint, which MuJoCo does not
read. Without both, such as with `k_velocity` alone, it keeps none.
"""


def _limit_softly(spec: mujoco.MjSpec, path: Path) -> None:
    """Narrow the ranges of a URDF's joints to those that their safety controllers keep."""
    with foreign(path, "a URDF whose limits are numbers", of_field("file")):
        soft = [
            (spec.joint(name), [float(found[end]) for end in SOFT if end in found])
            for name, found in _of_joints(path, "safety_controller")
        ]
    for joint, ends in soft:
        if joint is not None and ends:
            joint.range = _narrowed(joint, ends, path)
            joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE


def _narrowed(joint: mujoco.MjsJoint, ends: list[float], path: Path) -> list[float]:
    """The range of a joint within the ends of another one [rad, m]."""
    low, high = joint.range.tolist()
    if low >= high:  # it turns without end
        low = -math.inf
        high = math.inf
    wanted = [max(low, ends[0]), min(high, ends[-1])]
    if len(ends) < len(SOFT) or not wanted[0] < wanted[1]:
        words = (
            f"must have a safety_controller of {joint.name} with {' below '.join(SOFT)}, within"
            f" its limits of {low:.4g} to {high:.4g}, and has"
            f" {' and '.join(f'{end:.4g}' for end in ends)}"
        )
        raise ParameterError("file", words, str(path))
    return wanted


def _found(path: Path, scheme: str, name: str) -> str:
    """The place of a mesh: of `package://NAME/rest` in the folder NAME beside the URDF or
    above it.
    """
    if scheme == "file":
        return name
    for folder in path.resolve().parents:
        for place in (folder / name, folder.parent / name):
            if place.is_file():
                return str(place)
    package = name.partition("/")[0]
    words = (
        f"names the mesh package://{name},"
        f" and no folder {package} with it is beside the file or above it"
    )
    raise ParameterError(
        "file",
        f"{words}; put the package's folder there, or write the mesh's path from the URDF's folder",
        str(path),
    )
