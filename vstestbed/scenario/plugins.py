"""Plugins: Python files and modules that add kinds. To load a scenario runs the code of the plugins that it names.

A plugin is named by its file (`laws/mine.py`) or as a module (`mylab.laws`). A file gets a module name of its own, made from its
path, so that files of one name in different folders are different plugins, and one file is loaded once in a process.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from vstestbed.core.errors import PluginError
from vstestbed.core.spec import refresh_specs, undone_on_error
from vstestbed.scenario.validation import KINDS
from vstestbed.scenario.yaml_marks import Marks, place_of

_installed: list[str] = []  # rooms whose entry points are loaded


def load_plugins(names: Sequence[str]) -> tuple[str, ...]:
    """Load plugins, which register their kinds, and the entry points of installed packages; then rebuild the validators.

    Args:
        names: files, relative to the current folder, and modules, searched on Python's path and in the current folder.

    Returns:
        The names under which they are found again from any folder: absolute files, and modules.

    Raises:
        PluginError: a plugin is not there or cannot be imported, or a class breaks its room's contract.
    """
    _load_installed()
    return _load_given(names)


def _load_given(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(_loaded(name, Path.cwd(), "--plugin", ()) for name in names))


def load_named(plain: dict[str, Any], marks: Marks, file: str, given: Sequence[str] = ()) -> None:
    """Load the plugins that a mapping names under `plugins`, and those given beside it; `plain["plugins"]` then holds them all.

    Args:
        plain: the mapping of a YAML file, which is changed. marks, file: its positions and its name, as in `build`.
        given: as in `load_plugins`. Each also takes the place of a file of the same name that is not there any more.

    Raises:
        PluginError: see `load_plugins`.
    """
    if len(_installed) < len(KINDS):
        _load_installed()
    beside, named = _load_given(given), plain.get("plugins") or []
    if not isinstance(named, list) or not all(isinstance(name, str) for name in named):
        return  # the validation of the field says so
    found = []
    for i, name in enumerate(named):
        where = place_of(("plugins", i), marks, file)
        folder = Path.cwd() if where == "--set" else Path(file).absolute().parent
        found.append(_loaded(name, folder, where, beside, f"plugins.{i}"))
    if found or beside:
        plain["plugins"] = list(dict.fromkeys([*found, *beside]))


def is_file_name(name: str) -> bool:
    """Whether a plugin is named by its file, not as a module."""
    return name.endswith(".py") or "/" in name or "\\" in name


def absolute(name: str, folder: Path) -> str:
    """The name of a plugin without reference to the folder; modules as they are."""
    return str((folder / Path(name).expanduser()).absolute()) if is_file_name(name) else name


def _loaded(name: str, folder: Path, where: str, beside: Sequence[str], field: str = "") -> str:
    """Load a plugin; returns the name under which it is found again.

    Args:
        name: of the plugin. folder: to which a file's name is relative. where, field: where it is named, for messages.
        beside: plugins that are loaded already, one of which may be this one in its new place.
    """
    if is_file_name(name):
        path = Path(absolute(name, folder))
    else:
        path = Path.cwd() / f"{name}.py"
        if _origin(name) not in (None, path.resolve()) or not path.is_file():
            return _load_module(name, where, beside, field)
    if not path.is_file():
        return _moved(path.stem, beside) or _refuse(where, f"{path} is not there", f"PLACE/{path.name}", field)
    with _loading(str(path), path), undone_on_error():
        module = _load_file(path)
        refresh_specs()
    if not is_file_name(name):  # by its own name, too, so that an import of it does not load the file again
        sys.modules.setdefault(name, module)
    return str(path)


def _load_module(name: str, where: str, beside: Sequence[str], field: str) -> str:
    """Import a module by its name."""
    origin = _origin(name)
    if origin is None and name not in sys.modules and (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)  # at the end: a file here named like an installed package must not replace it
        importlib.invalidate_caches()
        origin = _origin(name)
    if origin is None and name not in sys.modules:
        words = f"there is no module {name!r} on Python's path or in the current folder"
        return _moved(name.rpartition(".")[2], beside) or _refuse(where, words, "FILE.py", field)
    if origin is None or _module_of(origin) is None:
        with _loading(name, origin), undone_on_error():
            importlib.import_module(name)
            refresh_specs()
    return name


def _origin(name: str) -> Path | None:
    """The file of a module; None for one that is not found, or that has no file."""
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError, TypeError, AttributeError):  # its package is not there, or it is no name of a module
        return None
    return Path(spec.origin).resolve() if spec is not None and spec.origin and spec.has_location else None


def _moved(stem: str, beside: Sequence[str]) -> str | None:
    """The plugin given beside a scenario that stands for one of this name, which is gone."""
    return next((name for name in beside if (Path(name).stem if is_file_name(name) else name.rpartition(".")[2]) == stem), None)


def _refuse(where: str, found: str, remedy: str, field: str) -> str:
    raise PluginError(where, found, f"put it there, or give its place with --plugin {remedy}", field)


def _module_of(path: Path) -> ModuleType | None:
    """The module that has been loaded from a file, under whatever name."""
    target = path.resolve()
    for module in list(sys.modules.values()):
        file = getattr(module, "__file__", None)
        if isinstance(file, str) and file.endswith((path.name, target.name)) and Path(file).resolve() == target:
            return module
    return None


def _load_file(path: Path) -> ModuleType:
    """The module of a file, loaded if it is not yet. Its folder joins Python's path, at the end, for what the file imports."""
    if (known := _module_of(path)) is not None:
        return known
    # The same name in every process: workers unpickle the plugin's objects by it.
    name = f"{path.stem}@{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError("it is not a Python file; its name must end in .py")
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    module = sys.modules[name] = importlib.util.module_from_spec(spec)  # known before it runs: dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _load_installed() -> None:
    """Register the kinds of installed packages' entry points."""
    offered: Any = importlib.metadata.entry_points()  # once: every call reads the metadata of all packages
    for room, kinds in KINDS.items():
        with _loading(f"an installed plugin of vstestbed.{room}", None), undone_on_error():
            kinds.load_entry_points(offered)
            refresh_specs()
    _installed[:] = KINDS


@contextmanager
def _loading(name: str, path: Path | None) -> Iterator[None]:
    """Turn whatever a plugin raises while it is imported, which is code of others, into a PluginError with its file and line."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except SystemExit as error:
        raise PluginError(_line(error, name, path), f"ends Python with sys.exit({error.code!r}) when it is imported") from error
    except Exception as error:
        raise PluginError(_line(error, name, path), f"cannot be imported ({type(error).__name__}: {error})") from error


def _line(error: BaseException, name: str, path: Path | None) -> str:
    """FILE:LINE where an error was raised in a plugin: the last line of its file that was at work."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    lines = [f"{f.filename}:{f.lineno}" for f in frames if path is not None and Path(f.filename).resolve() == path.resolve()]
    return lines[-1] if lines else name
