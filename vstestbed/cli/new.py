"""What `new` writes: a commented file for a kind of one's own, from a template."""

from __future__ import annotations

import importlib.util
import keyword
import re
from pathlib import Path

import typer

from vstestbed.core.errors import OutputError, ParameterError
from vstestbed.core.files import make_parents, write_whole
from vstestbed.scenario.plugins import registry

__all__ = ["REGISTRY_OF", "commands_of", "text_of", "write_new"]

REGISTRY_OF = {
    "keypoints": "keypoints",
    "lens": "cameras",
    "noise": "perturbations",
    "task": "goals",
}
"""The registry (`scenario.plugins.HOMES`) of a kind, where it is not the plural of its word."""


def write_new(kind: str, name: str, out: Path | None) -> None:
    """Write the file of a kind under a name of one's own, and say what to do with it.

    Raises ParameterError: no word, or a taken one. OutputError: the file is there already.
    """
    path = out or Path(f"{name}.py")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name):
        raise ParameterError.form(
            "NAME", f"of a word in small letters, digits and _, such as my_{kind}", name
        )
    if name in registry(REGISTRY_OF.get(kind, f"{kind}s")).members:
        raise ParameterError(
            "NAME", f"is bundled already ({kind}); take another, such as my_{name}", name
        )
    _must_be_free(path, "NAME" if out is None else "--out")
    text = text_of(kind, name, str(path))
    write_whole(make_parents(path), text)
    typer.echo(f"{path} runs as it is. Next:")
    for command in commands_of(text):
        typer.echo(f"  {command}")
    if importlib.util.find_spec("pytest") is None:
        typer.echo("pytest is not installed here; pip install pytest", err=True)


def _must_be_free(path: Path, said: str) -> None:
    """Refuse a file that is no module, is there already, or has the name of another module. said:
    where the name was given.
    """
    stem = path.stem
    if path.suffix != ".py" or not stem.isidentifier() or keyword.iskeyword(stem):
        works = f"{re.sub(r'[^0-9A-Za-z_]', '_', stem) or 'my'}_.py"
        raise ParameterError("--out", f"must be a Python file, such as {works}", str(path))
    if path.exists() or path.is_symlink():
        raise OutputError(
            path, "is there already, and is not written over", "give another name, or --out FILE.py"
        )
    if (taken := importlib.util.find_spec(stem)) is not None:
        other = f"{stem}_2" if stem.startswith("my_") else f"my_{stem}"
        words = (
            f"is the name of a module that Python finds already ({taken.origin}),"
            f" and pytest would import that in its place; take another, such as {other}"
        )
        raise ParameterError(said, words, stem)


def text_of(kind: str, name: str, path: str) -> str:
    """The file of a kind's template under another name: the word, the class, and the file in its
    commands.
    """
    camel, quoted = (
        "".join(part.capitalize() for part in name.split("_")),
        f'"{path}"' if " " in path else path,
    )
    text = (
        (Path(__file__).parent / "templates" / f"{kind}.py")
        .read_text(encoding="utf-8")
        .replace(f"my_{kind}.py", quoted)
    )
    return text.replace(f"my_{kind}", name).replace(f"My{kind.capitalize()}", camel)


def commands_of(text: str) -> list[str]:
    """The commands in the docstring of a template: its lines that are indented."""
    return [line.strip() for line in text.split('"""')[1].splitlines() if line.startswith("    ")]
