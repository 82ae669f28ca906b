"""Plugins: Python files and modules that add kinds. To load a scenario runs the code of the plugins
that it names.

A plugin is named by its file (`laws/mine.py`) or as a module (`mylab.laws`). A file gets a module
name of its own, made from its path, so that files of one name in different folders are different
plugins, and one file is loaded once in a process.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from vstestbed.core.errors import PluginError
from vstestbed.core.named_files import (
    ENDINGS,
    FILE_FIELDS,
    absolute_file,
    is_there,
    line_of,
    load_file,
    module_of,
)
from vstestbed.core.registry import REGISTRIES, Registry, undone_on_error
from vstestbed.scenario.yaml_marks import FROM_OPTION, FROM_PYTHON, Marks, place_of

__all__ = [
    "HOMES",
    "absolute",
    "absolute_files",
    "is_file_name",
    "load_named",
    "load_plugins",
    "registries",
    "registry",
    "relative_files",
]

HOMES = {
    "robots": "vstestbed.robots",
    "cameras": "vstestbed.camera",
    "effects": "vstestbed.effects",
    "targets": "vstestbed.targets",
    "markers": "vstestbed.targets.markers",
    "motions": "vstestbed.targets.motion",
    "detectors": "vstestbed.vision",
    "keypoints": "vstestbed.vision",
    "features": "vstestbed.features",
    "laws": "vstestbed.laws",
    "gains": "vstestbed.laws.base",
    "depths": "vstestbed.features.depth",
    "feedforwards": "vstestbed.laws.feedforward",
    "projections": "vstestbed.laws.ibvs",
    "goals": "vstestbed.tasks",
    "views": "vstestbed.tasks",
    "routes": "vstestbed.targets.route",
    "metrics": "vstestbed.tasks.metrics",
    "monitors": "vstestbed.endings.monitors",
    "perturbations": "vstestbed.vision.perturb",
    "distributions": "vstestbed.scenario.distributions",
}
"""The module of each registry that plugins extend, in which it has its name in capitals; imported
when somebody asks for it.
"""
_installed: list[str] = []  # registries whose entry points are loaded


def registry(name: str) -> Registry:
    """The registry of a name: `laws`."""
    return getattr(importlib.import_module(HOMES[name]), name.upper())


def registries() -> dict[str, Registry]:
    """All registries that plugins extend, by name."""
    return {name: registry(name) for name in HOMES}


def load_plugins(names: Sequence[str]) -> tuple[str, ...]:
    """Load plugins, which register their kinds, and the entry points of installed packages.
    names: files, relative to the current folder, and modules, searched on Python's path and in the
    current folder. Returns the names under which they are found again from any folder: absolute
    files, and modules.
    Raises PluginError: a plugin is not there or cannot be imported, or a class breaks its
    registry's contract.
    """
    _load_installed()
    return _load_given(names)


def _load_given(names: Sequence[str]) -> tuple[str, ...]:
    if names:
        registries()  # all are there before a plugin begins, which may fail: `undone_on_error`
    return tuple(dict.fromkeys(_loaded(name, Path.cwd(), "--plugin", ()) for name in names))


def load_named(plain: dict[str, Any], marks: Marks, file: str, given: Sequence[str] = ()) -> None:
    """Load the plugins that a file's mapping names under `plugins`, and those given beside it, each
    of which also takes the place of a file of the same name that is not there any more;
    `plain["plugins"]` then holds them all. Raises PluginError: see `load_plugins`.
    """
    if len(_installed) < len(HOMES):
        _load_installed()
    beside = _load_given(given)
    named = plain.get("plugins") or []
    if not isinstance(named, list) or not all(isinstance(name, str) for name in named):
        return  # the validation of the field says so
    found = []
    for i, name in enumerate(named):
        where = place_of(("plugins", i), marks, file)
        folder = Path(file).absolute().parent
        if where in (FROM_OPTION[()], FROM_PYTHON[()]):
            folder = Path.cwd()
        found.append(_loaded(name, folder, where, beside, f"plugins.{i}"))
    if found or beside:
        plain["plugins"] = list(dict.fromkeys([*found, *beside]))


def is_file_name(name: str) -> bool:
    """Whether a plugin is named by its file, not as a module."""
    return name.endswith(".py") or "/" in name or "\\" in name


def absolute(name: str, folder: Path) -> str:
    """The name of a plugin without reference to the folder; modules as they are."""
    return absolute_file(name, folder) if is_file_name(name) else name


def absolute_files(value: Any, folder: Path, key: str = "") -> Any:
    """A scenario's or a comparison's plain values, with the files that they name without reference
    to the folder.
    """
    if isinstance(value, Mapping):
        return {name: absolute_files(inner, folder, str(name)) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(absolute_files(inner, folder, key) for inner in value)
    if key.rpartition(".")[2] in FILE_FIELDS and isinstance(value, str) and ENDINGS.search(value):
        return absolute_file(value, folder)
    return value


def relative_files(value: Any, folder: Path, key: str = "") -> Any:
    """A scenario's plain values, with its plugins and files (`file`, `texture`) in the folder, or
    below it, named relative to it.
    """
    if isinstance(value, dict):
        return {name: relative_files(inner, folder, name) for name, inner in value.items()}
    if isinstance(value, list):
        return [relative_files(inner, folder, key) for inner in value]
    if key in ("file", "texture", "plugins") and isinstance(value, str):
        path = Path(value)
        if path.is_absolute() and path.is_relative_to(folder):
            return path.relative_to(folder).as_posix()
    return value


def _loaded(name: str, folder: Path, where: str, beside: Sequence[str], field: str = "") -> str:
    """Load a plugin; returns the name under which it is found again. folder: to which a file's name
    is relative. where, field: for messages. beside: plugins that are loaded already, one of which
    may be this one in its new place.
    """
    if is_file_name(name):
        path = Path(absolute(name, folder))
    else:
        path = Path.cwd() / f"{name}.py"
        if _origin(name) not in (None, path.resolve()) or not is_there(path):
            return _load_module(name, where, beside, field)
    if not is_there(path):
        return _moved(path.stem, beside, where, f"{path} is not there", f"PLACE/{path.name}", field)
    known = module_of(path)
    before = _members()
    with _loading(str(path), path), undone_on_error():
        module = load_file(path)
    if known is None and _members() == before:
        del sys.modules[module.__name__]  # to be read again when it is corrected
        remedy = f"write @vs.LAWS.add (ROBOTS, TARGETS, ...) and @vs.spec above {_class_in(module)}"
        raise PluginError(str(path), "adds no kind", remedy, field)
    # by its own name, too, so that an import of it does not load the file again
    if not is_file_name(name):
        sys.modules.setdefault(name, module)
    return str(path)


def _class_in(module: ModuleType) -> str:
    for value in vars(module).values():
        if isinstance(value, type) and value.__module__ == module.__name__:
            return f"its class {value.__name__}"
    return "a class in it"


def _members() -> int:
    return sum(len(registry.members) for registry in REGISTRIES)


def _load_module(name: str, where: str, beside: Sequence[str], field: str) -> str:
    origin = _origin(name)
    here = str(Path.cwd())
    if origin is None and name not in sys.modules and here not in sys.path:
        # at the end: a file here named like an installed package must not replace it
        sys.path.append(here)
        importlib.invalidate_caches()
        origin = _origin(name)
    if origin is None and name not in sys.modules:
        words = f"there is no module {name!r} on Python's path or in the current folder"
        return _moved(name.rpartition(".")[2], beside, where, words, "FILE.py", field)
    if origin is None or module_of(origin) is None:
        with _loading(name, origin), undone_on_error():
            importlib.import_module(name)
    return name


def _origin(name: str) -> Path | None:
    """The file of a module; None for one that is not found, or that has no file."""
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError, TypeError, AttributeError):
        # its package is not there, or it is no name of a module
        return None
    if spec is not None and spec.origin and spec.has_location:
        return Path(spec.origin).resolve()
    return None


def _moved(
    stem: str, beside: Sequence[str], where: str, found: str, remedy: str, field: str
) -> str:
    """The plugin of this name among those given beside, which are in a new place. Raises
    PluginError: there is none.
    """
    for name in beside:
        own = Path(name).stem if is_file_name(name) else name.rpartition(".")[2]
        if own == stem:
            return name
    remedy = f"put it there, or give its place with --plugin {remedy}"
    raise PluginError(where, found, remedy, field)


def _load_installed() -> None:
    # once: every call reads the metadata of all packages
    offered: Any = importlib.metadata.entry_points()
    if any(offered.select(group=f"vstestbed.{name}") for name in HOMES):
        for name, kinds in registries().items():
            with _loading(f"an installed plugin of vstestbed.{name}", None), undone_on_error():
                kinds.load_entry_points(offered)
    _installed[:] = HOMES


@contextmanager
def _loading(name: str, path: Path | None) -> Iterator[None]:
    """Turn whatever a plugin raises while it is imported, which is code of others, into a
    PluginError with its file and line.
    """
    try:
        yield
    except SystemExit as error:
        words = f"ends Python with sys.exit({error.code!r}) when it is imported"
        raise PluginError(line_of(error, name, path), words) from error
    except Exception as error:
        words = f"cannot be imported ({type(error).__name__}: {error})"
        raise PluginError(line_of(error, name, path), words) from error
