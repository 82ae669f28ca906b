"""The command `new`: one file for a kind of one's own, which runs as it is."""

from __future__ import annotations

import importlib.util
import keyword
import re
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from vstestbed.core.errors import OutputError, ParameterError

news = typer.Typer()
TEMPLATES = Path(__file__).parent / "templates"


class NewKind(str, Enum):
    """What `new` has a file for; the value is the name of its template."""

    law = "law"
    feature = "feature"
    robot = "robot"
    detector = "detector"
    keypoints = "keypoints"
    lens = "lens"
    target = "target"
    motion = "motion"
    metric = "metric"
    noise = "noise"
    monitor = "monitor"
    task = "task"


ROOM_OF = {"keypoints": "keypoints", "lens": "cameras", "noise": "perturbations", "task": "goals"}
"""The room (`scenario.validation.KINDS`) of a kind, where it is not the plural of its word."""


@news.command("new")
def new(
    kind: Annotated[NewKind, typer.Argument(help="What to write.")],
    name: Annotated[str, typer.Argument(help="Its word in a scenario, such as my_law.")],
    out: Annotated[Path | None, typer.Option(metavar="FILE.py", help="The file. [default: NAME.py]")] = None,
) -> None:
    """Write a commented file for a kind of one's own, with its test; it runs as it is."""
    path = out or Path(f"{name}.py")
    _check_name(kind, name)
    _check_file(path, out)
    text = text_of(kind.value, name, str(path))
    from vstestbed.core.files import make_parents, write_whole

    write_whole(make_parents(path), text)
    typer.echo(f"{path} runs as it is. Next:")
    for command in commands_of(text):
        typer.echo(f"  {command}")
    if importlib.util.find_spec("pytest") is None:
        typer.echo("pytest is not installed here; pip install pytest", err=True)


def text_of(kind: str, name: str, path: str) -> str:
    """The file of a kind's template under another name: the word, the class, and the file in its commands."""
    camel, quoted = "".join(part.capitalize() for part in name.split("_")), f'"{path}"' if " " in path else path
    text = (TEMPLATES / f"{kind}.py").read_text(encoding="utf-8").replace(f"my_{kind}.py", quoted)
    return text.replace(f"my_{kind}", name).replace(f"My{kind.capitalize()}", camel)


def commands_of(text: str) -> list[str]:
    """The commands in the docstring of a template: its lines that are indented."""
    return [line.strip() for line in text.split('"""')[1].splitlines() if line.startswith("    ")]


def _check_name(kind: NewKind, name: str) -> None:
    """Refuse a name that is no word of Python, or that a bundled kind has.

    Raises:
        ParameterError: it says what would be valid.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name):
        raise ParameterError("NAME", f"must be a word in small letters, digits and _, such as my_{kind.value}", name)
    from vstestbed.scenario.validation import KINDS  # after the cheap check: it imports the whole package

    members = KINDS[ROOM_OF.get(kind.value, f"{kind.value}s")].members
    if name in members:
        raise ParameterError("NAME", f"is bundled already ({kind.value}); take another, such as my_{name}", name)


def _check_file(path: Path, given: Path | None) -> None:
    """Refuse a file that is there, and one whose name Python finds elsewhere; given: with --out.

    Raises:
        ParameterError, OutputError: it says what would work.
    """
    if path.suffix != ".py" or not path.stem.isidentifier() or keyword.iskeyword(path.stem):
        raise ParameterError("--out", f"must be a Python file, such as {re.sub(r'[^0-9A-Za-z_]', '_', path.stem) or 'my'}_.py", str(path))
    if path.exists() or path.is_symlink():
        raise OutputError(path, "is there already, and is not written over", "give another name, or --out FILE.py")
    _check_module(path, "NAME" if given is None else "--out")


def _check_module(path: Path, option: str) -> None:
    """Refuse a file that pytest could not import, since Python finds another of its name first; option: that gave the name."""
    if (taken := importlib.util.find_spec(path.stem)) is not None:
        other = f"{path.stem}_2" if path.stem.startswith("my_") else f"my_{path.stem}"
        words = f"is the name of a module that Python finds already ({taken.origin}), and pytest would import that in its place"
        raise ParameterError(option, f"{words}; take another, such as {other}", path.stem)
