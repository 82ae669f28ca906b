"""Results of the commands that the pages show, kept in `docs/kept/`: a page is rendered from them
without a run.
"""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from vstestbed.core.files import write_whole

REPOSITORY = Path(__file__).resolve().parents[2]
FOLDER = REPOSITORY / "docs" / "kept"
DIGITS = 5
"""Significant digits that are kept of a number: more than any page shows, fewer than another
machine's OpenGL may change.
"""
UNSTEADY = re.compile(
    r"^(folder|wall_time_s|processor_s|real_time_factor|attempts|reason|machine)$|^(time_ms|versions)\b"
)
"""Columns that differ from run to run, or say nothing that a page shows."""
WORDS = {"run": ["--quiet", "--video", "none"], "compare": ["--quiet", "--no-film"], "bench": []}
"""What is added to a command, by its first word; `--quiet` to all others."""
Row = Mapping[str, Any]


class KeptError(RuntimeError):
    """A command of a page failed, or has no kept result."""


def measured(command: str) -> Any:
    """What a command prints as JSON now, run in an empty folder as a user runs it: `run arm_ibvs`,
    `compare arm_laws`, `bench --all`.

    Files of the repository are named from its folder:
    `run arm_insert --plugin tests/examples/pressing.py`.

    Raises:
        KeptError: the command failed; with its words.
    """
    given = [
        str(REPOSITORY / word) if (REPOSITORY / word).is_file() else word
        for word in shlex.split(command)
    ]
    words = [sys.executable, "-m", "vstestbed", *given, "--json", *WORDS.get(given[0], ["--quiet"])]
    with tempfile.TemporaryDirectory() as empty:
        done = subprocess.run(words, cwd=empty, capture_output=True, text=True, check=False)
    if not done.stdout.strip():
        raise KeptError(f"vstestbed {command}: exit {done.returncode}\n{done.stderr}")
    found = json.loads(done.stdout)
    return steady(found["runs"] if given[0] == "compare" else found)


def steady(value: Any) -> Any:
    """A result without what differs from run to run, its numbers rounded."""
    if isinstance(value, dict):
        return {key: steady(inner) for key, inner in value.items() if not UNSTEADY.search(key)}
    if isinstance(value, list):
        return [steady(inner) for inner in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


class Kept:
    """Results by command; those that are missing, or asked for again, are measured and kept.

    Args:
        again: says of a command whether to measure it again. may_run: whether commands may be run
            at all.
    """

    def __init__(self, again: Callable[[str], bool] = lambda _: False, may_run: bool = True):
        self._again, self._may_run = again, may_run
        self.used: set[str] = set()

    def __call__(self, command: str) -> Any:
        """The result of a command, as `vstestbed COMMAND --json` prints it.

        Raises:
            KeptError: the command failed, or it has no kept result and may not be run.
        """
        place = place_of(command)
        first, known = command not in self.used, place.is_file()
        self.used.add(command)
        if known and not (first and self._again(command)):
            return read(place)
        if not self._may_run:
            raise KeptError(
                f"`vstestbed {command}` has no result in {place.parent.name}/: python -m docs.build"
            )
        sys.stderr.write(f"vstestbed {command}\n")
        keep(command, measured(command))
        return read(place)


def place_of(command: str) -> Path:
    """The file of a command's result, named after it."""
    return FOLDER / f"{re.sub(r'[^a-z0-9.=-]+', '_', command.lower()).strip('_')[:120]}.json"


def keep(command: str, result: Any) -> None:
    """Write a command's result into its file."""
    FOLDER.mkdir(exist_ok=True)
    write_whole(place_of(command), _text(command, _columns(result)))


def _text(command: str, result: Any) -> str:
    """JSON with a line for each column, so that a change of one is a line of a diff."""
    if not (isinstance(result, dict) and "columns" in result):
        return json.dumps({"command": command, "result": result}, indent=1) + "\n"
    lines = ",\n".join(
        f"{json.dumps(name)}: {json.dumps(column)}" for name, column in result["columns"].items()
    )
    return f'{{"command": {json.dumps(command)}, "result": {{"columns": {{\n{lines}\n}}}}}}\n'


def _columns(result: Any) -> Any:
    """Rows of one shape as columns, which takes a fifth of the room; columns that are empty in all
    rows are left out.
    """
    if not (isinstance(result, list) and result and all(isinstance(row, dict) for row in result)):
        return result
    names = dict.fromkeys(name for row in result for name in row)
    columns = {name: [row.get(name) for row in result] for name in names}
    return {
        "columns": {
            name: column
            for name, column in columns.items()
            if any(value is not None for value in column)
        }
    }


def read(place: Path) -> Any:
    """The result in a file, a table as rows."""
    result = json.loads(place.read_text(encoding="utf-8"))["result"]
    if not (isinstance(result, dict) and "columns" in result):
        return result
    columns = result["columns"]
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
