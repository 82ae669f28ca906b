"""Files that a scenario names: beside it, absolute, or inside an installed package."""

from __future__ import annotations

import importlib.util
import re
from importlib import metadata
from pathlib import Path

from vstestbed.core.errors import ParameterError

ENDINGS = re.compile(r"\.(onnx|xml|mjcf|urdf|png|jpe?g|stl|obj|json)$|\.py:\w+$", re.IGNORECASE)
"""The end of a value of a field of FILE_FIELDS: a network, a model, a picture, a solid, a function in a Python file."""
FILE_FIELDS = "file", "scenery", "picture", "texture"
"""Fields that name a file; the blocks `scenery` and `picture` may be their file's name alone."""
PACKAGE = "package:"


def absolute_file(file: str, folder: Path) -> str:
    """A file's name without reference to the folder; one inside a package (`package:NAME/path`) as it is."""
    if file.startswith(PACKAGE):
        return file
    try:
        path = Path(file).expanduser()
    except RuntimeError:  # `~nobody`: there is no such user
        path = Path(file)
    return str((folder / path).absolute())


def is_there(path: Path) -> bool:
    """Whether a path is a file; no for one that cannot be the name of any, such as one that is too long."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def place_of_file(file: str) -> Path:
    """The path of a file named absolutely or inside a package, which is not imported.

    Raises:
        ParameterError: the package is not installed, or the file is not there.
    """
    path = Path(file)
    if file.startswith(PACKAGE):
        name, _, inside = file.removeprefix(PACKAGE).partition("/")
        if not (name and inside):
            raise ParameterError("file", "must be package:NAME/path, the name by which Python imports the package and a file in it", file)
        try:
            found = importlib.util.find_spec(name)
        except (ImportError, ValueError):  # its parent is not there, or it is no name of a package
            found = None
        if found is None or not found.submodule_search_locations:
            raise ParameterError("file", _no_package(name, inside), file)
        path = Path(found.submodule_search_locations[0]) / inside
    if not is_there(path):
        where = f" ({path})" if file.startswith(PACKAGE) else ""  # of others `file` is the path
        words = "give its path: absolute, or relative to the scenario's file (with --set to this folder)"
        raise ParameterError("file", f"is not there{where}; {words}", file)
    return path


def _no_package(name: str, inside: str) -> str:
    """Why there is no package of a name that holds a file, and what to write: a distribution is often imported by another name."""
    try:
        files = [path.as_posix() for path in metadata.distribution(name).files or ()]
    except (metadata.PackageNotFoundError, ValueError):
        remedy = f"pip install --no-deps {name}, if that is its name there (only its files are read), or give the file's path"
        return f"names the package {name}, which is not installed; {remedy}"
    package, at = _inside(files, inside)
    if not package:
        return f"names the distribution {name}, which is installed and has no such package; give the file's path"
    dotted = package.replace("/", ".")
    return f"names the distribution {name}, which is installed, and is imported as {dotted}; write {PACKAGE}{dotted}/{at}"


def _inside(files: list[str], inside: str) -> tuple[str, str]:
    """The folder of the package, of a distribution's files, that holds the end of a path, and the file's place in it; "" for none.

    It is the outermost folder with an __init__.py, since packages of several distributions may share a namespace.
    """
    packages = sorted((path.removesuffix("/__init__.py") for path in files if path.endswith("/__init__.py")), key=len)
    there = next((path for path in files if path.endswith(f"/{inside}")), "")
    package = next((one for one in packages if not there or there.startswith(f"{one}/")), "")
    return package, there.removeprefix(f"{package}/") or "PATH"


def kept_at(source: Path, what: str = "target") -> str:
    """Where a run's folder keeps the file that its target was made from, or another `what`."""
    return f"assets/{what}/{source.name}"
