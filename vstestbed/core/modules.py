"""Python files of others, loaded as modules: plugins, and policies."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import traceback
from pathlib import Path
from types import ModuleType

# The import of ONNX Runtime alone, also by a plugin or a policy, starts telemetry, which keeps a database in the user's cache.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")


def module_of(path: Path) -> ModuleType | None:
    """The module that has been loaded from a file, under whatever name."""
    target = path.resolve()
    for module in list(sys.modules.values()):
        file = getattr(module, "__file__", None)
        if isinstance(file, str) and file.endswith((path.name, target.name)) and Path(file).resolve() == target:
            return module
    return None


def load_file(path: Path) -> ModuleType:
    """The module of a file, loaded if it is not yet. Its folder joins Python's path, at the end, for what the file imports.

    Raises:
        ImportError: it is no Python file. Whatever the file raises while it is loaded.
    """
    if (known := module_of(path)) is not None:
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


def is_file_module(name: str) -> bool:
    """Whether a module's name is one that `load_file` gives."""
    return "@" in name


def line_of(error: BaseException, name: str, path: Path | None) -> str:
    """FILE:LINE where an error was raised in a file: the last line of it that was at work; `name` where it has no part in it."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    lines = [f"{f.filename}:{f.lineno}" for f in frames if path is not None and Path(f.filename).resolve() == path.resolve()]
    return lines[-1] if lines else name
