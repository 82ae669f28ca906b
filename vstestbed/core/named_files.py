"""Files that a scenario names: beside it, absolute, or inside an installed package."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

from vstestbed.core.errors import ParameterError

ENDINGS = re.compile(r"\.(onnx|xml|mjcf|urdf|png|jpe?g|stl|obj)$|\.py:\w+$", re.IGNORECASE)
"""The end of a value of a field of FILE_FIELDS: a network, a model, a picture, a solid, a function in a Python file."""
FILE_FIELDS = "file", "scenery"
"""Fields that name a file; the block `scenery` may be its file's name alone."""
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
        try:
            found = importlib.util.find_spec(name)
        except (ImportError, ValueError):  # its parent is not there, or it is no name of a package
            found = None
        if found is None or not found.submodule_search_locations:
            remedy = f"pip install --no-deps {name} (only its files are read), or give the file's path"
            raise ParameterError("file", f"names the package {name}, which is not installed; {remedy}", file)
        path = Path(found.submodule_search_locations[0]) / inside
    if not is_there(path):
        raise ParameterError("file", f"is not there ({path}); give its path, absolute or relative to the scenario's file", file)
    return path


def kept_at(source: Path) -> str:
    """Where a run's folder keeps the file that its target was made from."""
    return f"assets/target/{source.name}"
