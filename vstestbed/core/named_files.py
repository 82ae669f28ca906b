"""Files that a scenario names: beside it, absolute, or inside an installed package."""

from __future__ import annotations

import importlib.util
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from types import ModuleType

from vstestbed.core.errors import OutputError, ParameterError
from vstestbed.core.foreign import MOST_BYTES, foreign, of_field, plain_file

__all__ = [
    "CALIBRATED",
    "ENDINGS",
    "FILE_FIELDS",
    "absolute_file",
    "bundled_comparisons",
    "bundled_labs",
    "bundled_scenarios",
    "folder",
    "is_there",
    "kept_at",
    "line_of",
    "load_file",
    "model_path",
    "module_of",
    "named_file",
    "place_of_file",
]

ENDINGS = re.compile(
    r"\.(onnx|xml|mjcf|urdf|png|jpe?g|stl|obj|json|ya?ml)$|\.py:\w+$", re.IGNORECASE
)
"""The end of a value of a field of FILE_FIELDS: a network, a model, a picture, a solid, a
calibration, a function in a Python file.
"""
CALIBRATED = "intrinsics", "mount", "calibration", "realism"
"""Fields that the name of a file may stand for, which is read with the scenario: of a calibration,
of a robot's imperfections.
"""
FILE_FIELDS = "file", "scenery", "picture", "texture", *CALIBRATED
"""Fields that name a file; the blocks `scenery` and `picture` may be their file's name alone."""
PACKAGE = "package:"


def absolute_file(file: str, folder: Path) -> str:
    """A file's name without reference to the folder; one inside a package (`package:NAME/path`) as
    it is.
    """
    if file.startswith(PACKAGE):
        return file
    try:
        path = Path(file).expanduser()
    except RuntimeError:  # `~nobody`: there is no such user
        path = Path(file)
    return str((folder / path).absolute())


def is_there(path: Path) -> bool:
    """Whether a path is a file; no for one that cannot be the name of any, such as one that is too
    long.
    """
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _is_no_folder(path: Path) -> bool:
    """Whether a path is there and no folder: a file, a pipe, a socket, a device."""
    try:
        return path.exists() and not path.is_dir()
    except (OSError, ValueError):
        return False


def place_of_file(file: str) -> Path:
    """The path of a file named absolutely or inside a package, which is not imported;
    ParameterError where it is not there.
    """
    path = Path(file)
    if file.startswith(PACKAGE):
        name, _, inside = file.removeprefix(PACKAGE).partition("/")
        if not (name and inside):
            form = (
                "package:NAME/path, the name by which Python imports the package and a file in it"
            )
            raise ParameterError.form("file", form, file)
        try:
            found = importlib.util.find_spec(name)
        except (ImportError, ValueError):  # its parent is not there, or it is no name of a package
            found = None
        if found is None or not found.submodule_search_locations:
            raise ParameterError("file", _no_package(name, inside), file)
        path = Path(found.submodule_search_locations[0]) / inside
    if not _is_no_folder(path):
        where = f" ({path})" if file.startswith(PACKAGE) else ""  # of others `file` is the path
        words = (
            "give its path: absolute,"
            " or relative to the scenario's file (with --set to this folder)"
        )
        raise ParameterError("file", f"is not there{where}; {words}", file)
    return plain_file(path, "a regular file, and a smaller one", refusal=of_field("file"))


@contextmanager
def named_file(field: str, file: str, works: str, most_bytes: int = MOST_BYTES) -> Iterator[Path]:
    """The path of a plain file that a field names. Whatever is wrong with it, and whatever a
    library raises that reads it in the block, is a ParameterError of the field.
    """
    refusal = of_field(field, file)
    try:
        path = place_of_file(absolute_file(file, Path.cwd()))
    except ParameterError as error:
        raise ParameterError(field, error.problem, file) from None
    plain_file(path, works, most_bytes, refusal)
    with foreign(path, works, refusal):
        yield path


def _no_package(name: str, inside: str) -> str:
    """Why there is no package of a name that holds a file, and what to write: a distribution is
    often imported by another name.
    """
    from importlib import metadata  # here: `--help` imports this module

    try:
        files = [path.as_posix() for path in metadata.distribution(name).files or ()]
    except (metadata.PackageNotFoundError, ValueError):
        remedy = (
            f"pip install --no-deps {name}, if that is its name there (only its files are read),"
            " or give the file's path"
        )
        return f"names the package {name}, which is not installed; {remedy}"
    there = next((path for path in files if path.endswith(f"/{inside}")), "")
    package = _package_of(there, files)
    if not package:
        return (
            f"names the distribution {name}, which is installed and has no such package;"
            " give the file's path"
        )
    dotted = package.replace("/", ".")
    at = there.removeprefix(f"{package}/") or "PATH"
    return (
        f"names the distribution {name}, which is installed, and is imported as {dotted};"
        f" write {PACKAGE}{dotted}/{at}"
    )


def _package_of(file: str, files: list[str]) -> str:
    """The outermost folder with an __init__.py that holds a file of a distribution, since packages
    of several may share a namespace; of no file the outermost of all, and "" where there is none.
    """
    packages = [
        path.removesuffix("/__init__.py") for path in files if path.endswith("/__init__.py")
    ]
    for package in sorted(packages, key=len):
        if not file or file.startswith(f"{package}/"):
            return package
    return ""


def kept_at(source: Path, what: str = "target") -> str:
    """Where a run's folder keeps the file that its target was made from, or another `what`."""
    return f"assets/{what}/{source.name}"


_PACKAGE = Path(__file__).resolve().parent.parent


def folder(name: str) -> Path:
    """The folder `models`, `scenarios`, or `docs/guides`: `vstestbed/_data/<name>` in a wheel,
    `<checkout>/<name>` otherwise.
    """
    # The wheel's copy first: beside an installed package, a folder of this name would belong to
    # somebody else.
    for candidate in (_PACKAGE / "_data" / name, _PACKAGE.parent / name):
        if candidate.is_dir():
            return candidate
    raise OutputError(
        _PACKAGE, f"the folder {name}/ is missing from the installation", "install vstestbed again"
    )


def model_path(name: str) -> Path:
    """The MJCF file `name` in models/, or a robot's own by its whole path, or inside a package
    (`package:NAME/path`).
    """
    return place_of_file(name) if name.startswith(PACKAGE) else folder("models") / name


def bundled_scenarios() -> dict[str, Path]:
    """Path of every bundled scenario by its name, sorted."""
    return _listed(folder("scenarios"))


def bundled_comparisons() -> dict[str, Path]:
    """Path of every bundled comparison by its name, sorted."""
    return _listed(folder("scenarios") / "compare")


def bundled_labs() -> dict[str, Path]:
    """Path of every lab of the course by its name, sorted."""
    return _listed(folder("docs/course"))


def _listed(place: Path) -> dict[str, Path]:
    return dict(_files(place, place.stat().st_mtime_ns))  # the caller may change it


@lru_cache(maxsize=8)
def _files(place: Path, changed_ns: int) -> dict[str, Path]:
    # kept until a file comes or goes: a comparison loads hundreds of scenarios by their names
    return {p.stem: p for p in sorted(place.glob("*.yaml"))}


# Python files of others, loaded as modules: plugins, and policies. The import of ONNX Runtime
# alone, also by a plugin or a policy, starts telemetry, which keeps a database in the user's cache.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")


def module_of(path: Path) -> ModuleType | None:
    """The module that has been loaded from a file, under whatever name."""
    target = path.resolve()
    for module in list(sys.modules.values()):
        file = getattr(module, "__file__", None)
        if not isinstance(file, str) or not file.endswith((path.name, target.name)):
            continue
        if Path(file).resolve() == target:
            return module
    return None


def load_file(path: Path) -> ModuleType:
    """The module of a file, loaded if it is not yet. Its folder joins Python's path, at the end,
    for what the file imports.
    Raises ImportError: it is no Python file. Whatever the file raises while it is loaded.
    """
    if (known := module_of(path)) is not None:
        return known
    import hashlib  # here: `--help` imports this module

    # The same name in every process: workers unpickle the plugin's objects by it.
    name = f"{path.stem}@{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError("it is not a Python file; its name must end in .py")
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    # known before it runs: dataclasses look their module up
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def line_of(error: BaseException, name: str, path: Path | None) -> str:
    """FILE:LINE where an error was raised in a file: the last line of it that was at work; `name`
    where it has no part in it.
    """
    import traceback  # here: `--help` imports this module

    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}"
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if path is not None and Path(frame.filename).resolve() == path.resolve():
            return f"{frame.filename}:{frame.lineno}"
    return name
