"""What apps use of the kernel: names that its modules export, as a plugin of anybody could."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import vstestbed

TOP = Path(vstestbed.__file__).parents[1]
APPS = TOP / "vstestbed" / "apps"


def file_of(module: str) -> Path | None:
    """The file of a module of the package; None where the name is no module's."""
    path = TOP.joinpath(*module.split("."))
    for file in (path / "__init__.py", path.with_suffix(".py")):
        if file.is_file():
            return file
    return None


def used(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """(module, name) of what a module takes from the kernel: imported names, also within functions,
    and attributes of imported modules.
    """
    modules: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            modules |= {alias.asname: alias.name for alias in node.names if alias.asname}
        if not isinstance(node, ast.ImportFrom) or node.module is None:
            continue
        for alias in node.names:
            inner = f"{node.module}.{alias.name}"
            if node.module.startswith("vstestbed") and file_of(inner):
                modules[alias.asname or alias.name] = inner
            else:
                yield node.module, alias.name
    for node in ast.walk(tree):
        if not isinstance(node, ast.Attribute) or not isinstance(node.value, ast.Name):
            continue
        if node.value.id in modules:
            yield modules[node.value.id], node.attr


def exported(file: Path) -> set[str]:
    """The names in a module's `__all__`."""
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return set(ast.literal_eval(node.value))
    return set()


def test_apps_use_what_the_kernel_exports():
    uses: dict[str, set[str]] = {}
    for file in APPS.rglob("*.py"):
        for module, name in used(ast.parse(file.read_text(encoding="utf-8"))):
            if module.startswith("vstestbed") and not module.startswith("vstestbed.apps"):
                uses.setdefault(module, set()).add(name)
    assert len(uses) > 50
    lacking: dict[str, list[str]] = {}
    for module, names in uses.items():
        file = file_of(module)
        assert file is not None, module
        if missing := names - exported(file):
            lacking[module] = sorted(missing)
    assert lacking == {}, "export it there, or do without"


def test_what_is_used_is_found():
    text = """
from vstestbed.core import files, shares as s
from vstestbed.core.spec import spec as to_spec
import vstestbed.core.errors as e
def f():
    from vstestbed.core.planar import _hidden
    return files.a, s.b, e.c, x.files.d
"""
    assert sorted(used(ast.parse(text))) == [
        ("vstestbed.core.errors", "c"),
        ("vstestbed.core.files", "a"),
        ("vstestbed.core.planar", "_hidden"),
        ("vstestbed.core.shares", "b"),
        ("vstestbed.core.spec", "spec"),
    ]


DECLARED = {("ros", "identify")}
"""Of two apps the one that uses the other; the contract in pyproject.toml names the import."""


def test_apps_do_not_know_each_other_but_for_those_that_say_so():
    """Also within functions, and in places that are given as texts, which no linter sees."""
    found: set[tuple[str, str]] = set()
    for file in APPS.rglob("*.py"):
        app = file.relative_to(APPS).parts[0]
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            places: list[str] = []
            if isinstance(node, ast.ImportFrom):
                places = [f"{node.module}.{alias.name}" for alias in node.names]
            elif isinstance(node, ast.Import):
                places = [alias.name for alias in node.names]
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                places = [node.value]
            for place in places:
                if place.startswith("vstestbed.apps."):
                    other = place.removeprefix("vstestbed.apps.").replace(":", ".").split(".")[0]
                    found |= {(app, other)} if other != app else set()
    assert found == DECLARED
