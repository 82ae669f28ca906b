"""Conditions of the pages' numbers: read from scenarios, and said beside every table and in every
section of exercises and results.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from docs.build.conditions import LINE, conditions, conditions_line
from docs.build.kept import REPOSITORY, Kept
from docs.build.marks import parts
from docs.build.pages import environment

FOLDERS = [REPOSITORY / "docs" / "exercises", REPOSITORY / "docs" / "results"]
MEASURED = sorted(
    page.relative_to(REPOSITORY) for folder in FOLDERS for page in folder.glob("*.md")
)
NO_RUNS = {
    "docs/results/verdicts.md": "its comparisons are simulated: no robot and no camera is in them"
}
HEADING = re.compile(r"^#+ .*$", re.MULTILINE)
CODE = re.compile(r"^ {4}.*$|^```.*?^```|`[^`]*`|\]\([^)]*\)|<[^>]*>", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])(\d+\.\d+|\d+ of \d+|\d+ (%|mm|cm|px|ms|N|deg|degrees)(?!\w))")
"""A number that was measured, or is a setting: decimals, shares, numbers with a unit."""
OF_THE_RUN = {"scenario", "seed", "task", "amount"}
"""Columns that say which run it is; the columns of what is varied stand before `seed`."""


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("run ibvs_book", "pictures; ideal camera"),
        ("run ibvs_book --set detector=oracle", "oracle with border; ideal camera"),
        (
            "run arm_book --set detector='{kind: oracle, field_of_view: unlimited}'",
            "oracle without border; ideal servos",
        ),
        ("run arm_ibvs --set robot.realism=lab", "pictures; dynamics (`lab`)"),
        ("compare canonical", "oracle without border; ideal camera"),
        ("compare latency", "oracle with border (0.05 px of noise); dynamics"),
        ("compare latency --set detector=blobs --set noise.pixel_sigma_px=0", "pictures; dynamics"),
        (
            "compare realism",
            "oracle with border (in part 0.1 px of noise); ideal camera, ideal servos or dynamics",
        ),
        ("compare realism_omni", "oracle with border; dynamics (in part `lab` or `field`)"),
        (
            "compare arm_ibvs --vary detector=oracle,blobs",
            "oracle with border or pictures; dynamics",
        ),
        # whatever the scenario's detector
        (
            "gain-limit arm_ibvs --set robot.realism=field",
            "oracle without border; dynamics (`field`)",
        ),
        ("sweep depth_error", "oracle without border; ideal camera"),
        (
            "basin canonical --x x=-2:2 --y yaw=-180:180 --field-of-view limited",
            "oracle with border; ideal camera",
        ),
    ],
)
def test_conditions_are_those_of_the_scenarios_that_a_command_flies(
    command: str, words: str
) -> None:
    assert conditions(command) == words


def test_a_line_has_an_entry_for_each_that_differs() -> None:
    assert (
        conditions_line("run ibvs_book", "run pbvs_book") == "*Conditions: pictures; ideal camera.*"
    )
    line = conditions_line("run ibvs_book", "run arm_ibvs", "run pbvs_book")
    assert (
        line
        == "*Conditions: `run ibvs_book`, `run pbvs_book`: pictures; ideal camera. `run arm_ibvs`:"
        " pictures; dynamics.*"
    )
    many = conditions_line("run arm_ibvs", "run ibvs_book", "run pbvs_book", "run polar_book")
    assert many == "*Conditions: pictures; ideal camera. `run arm_ibvs`: pictures; dynamics.*"


def test_of_what_is_not_flown_no_conditions_are_invented() -> None:
    with pytest.raises(ValueError, match=r"flies is not known .* known: basin, compare"):
        conditions("doctor")
    with pytest.raises(ValueError, match="`vstestbed fly` is no command; known: basin"):
        conditions("fly arm_ibvs")
    with pytest.raises(ValueError, match="give one or more"):
        conditions_line()


class Row(dict[str, Any]):
    """A result that notes when one of its measured values is read."""

    def __init__(self, values: dict[str, Any], command: str, read: list[str]):
        super().__init__(values)
        names = list(values)
        self._names = OF_THE_RUN | set(
            names[: names.index("seed")]
            if "seed" in names and command.startswith(("compare", "sweep"))
            else ()
        )
        self._command, self._read = command, read

    def _note(self, name: str) -> None:
        if name not in self._names:
            self._read.append(self._command)

    def __getitem__(self, name: str) -> Any:
        self._note(name)
        return super().__getitem__(name)

    def get(self, name: str, default: Any = None) -> Any:
        self._note(name)
        return super().get(name, default)

    def __iter__(self) -> Iterator[str]:
        """As of a table that is laid out whole."""
        self._read.append(self._command)
        return super().__iter__()


class Noted(Kept):
    """Kept results whose values note their command as they are read."""

    def __init__(self) -> None:
        super().__init__(may_run=False)
        self.read: list[str] = []

    def __call__(self, command: str) -> Any:
        found = super().__call__(command)
        if isinstance(found, dict):
            return Row(found, command, self.read)
        return [Row(row, command, self.read) for row in found]


@dataclass(frozen=True)
class Shown:
    """A page's text, and the commands whose values are read with the place in the text where they
    are.
    """

    text: str
    read: list[tuple[int, str]]

    @classmethod
    def of(cls, page: Path) -> Shown:
        """A page as it is filled."""
        kept, text, read = Noted(), "", list[tuple[int, str]]()
        source = (REPOSITORY / page).read_text(encoding="utf-8")
        for _, words in parts(source, environment(kept)):
            read += [(len(text), command) for command in dict.fromkeys(kept.read)]
            kept.read.clear()
            text += words
        return cls(text, read)

    def between(self, start: int, end: int) -> set[str]:
        """The commands whose values are read for a part of the text."""
        return {command for place, command in self.read if start <= place < end}


def sections(text: str) -> Iterator[tuple[str, int, int]]:
    """The sections of a page, from a heading to the next one of any level: heading, start, end."""
    found = list(HEADING.finditer(text))
    for i, one in enumerate(found):
        yield one[0], one.start(), found[i + 1].start() if i + 1 < len(found) else len(text)


def without_conditions(shown: Shown) -> Iterator[str]:
    """The sections and tables of a page whose numbers have no conditions, in words."""
    for heading, start, end in sections(shown.text):
        words = shown.text[start:end]
        for command in sorted(shown.between(start, end)):
            if conditions(command) not in words:
                yield f"{heading}: numbers of `{command}`"
        stated = LINE in words or "<!-- no run:" in words
        if (
            not stated
            and not shown.between(start, end)
            and NUMBER.search(CODE.sub("", words.partition("\n")[2]))
        ):
            yield (
                f"{heading}: numbers of no command;"
                " say under('run ...') of what was flown, or no run: and why"
            )
    for table in re.finditer(r"^\|.*\n(?:\|.*\n)+", shown.text, re.MULTILINE):
        first = table[0].partition("\n")[0]
        read = shown.between(table.start(), table.end())
        before = shown.text[: table.start()]
        given = before.rpartition("\n\n")[2].startswith("<!-- given:")
        if not read and (given or not NUMBER.search(table[0])):
            continue
        heading, start, end = [one for one in sections(shown.text) if one[1] < table.start()][-1]
        beside = [
            re.sub(r"^<!-- given.*-->\n", "", before, flags=re.MULTILINE)
            .rstrip()
            .rpartition("\n")[2],
            shown.text[table.end() :].lstrip().partition("\n")[0],
        ]
        if "<!-- no run:" in shown.text[start:end]:
            continue
        if not any(one.startswith(LINE) for one in beside) and "conditions" not in first:
            yield f"{heading}: table `{first[:60]}`"


TABLE = "| law | error [px] |\n|---|---|\n| points | 0.12 |\n"
ARM = "run arm_ibvs"  # from pictures, with dynamics


@pytest.mark.parametrize(
    ("text", "read", "missing"),
    [
        (f"# A\n\n{TABLE}\n{conditions_line(ARM)}\n", [ARM], 0),
        (f"# A\n\n{TABLE}\n", [ARM], 2),  # neither the section nor the table
        (f"# A\n\n{TABLE}\n", [], 2),  # typed by hand, it needs them as well
        (f"# A\n\n{TABLE}\nWords.\n\n{conditions_line(ARM)}\n", [ARM], 1),  # not beside the table
        (f"# A\n\n{TABLE}\n{conditions_line('run ibvs_book')}\n", [ARM], 1),  # those of another run
        (f"# A\n\n{TABLE}\n# B\n\n{conditions_line(ARM)}\n", [ARM], 2),  # in another section
        ("# A\n\nThe error is 0.12 px.\n", [], 1),
        ("# A\n\nAs in section 3, `gain: 0.12`.\n", [], 0),  # code is no result
    ],
)
def test_the_check_finds_numbers_without_their_conditions(
    text: str, read: list[str], missing: int
) -> None:
    assert (
        len(list(without_conditions(Shown(text, [(text.index("|"), command) for command in read]))))
        == missing
    )


@pytest.mark.parametrize("page", MEASURED, ids=lambda page: page.stem)
def test_every_number_and_every_table_has_its_conditions(page: Path) -> None:
    if page.as_posix() in NO_RUNS:
        assert not Shown.of(page).read, f"{page} reads runs: it is none of NO_RUNS any more"
        return
    missing = list(without_conditions(Shown.of(page)))
    assert not missing, "\n".join(
        [
            f"{page}: these have no conditions (say them by <!-- build: under(...) -->):",
            *missing,
        ]
    )
