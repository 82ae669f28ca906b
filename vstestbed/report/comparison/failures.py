"""Failed runs of a comparison, grouped by outcome and reason, with commands that repeat them and pictures of their ends."""

from __future__ import annotations

import re
import shlex
from collections import defaultdict
from dataclasses import dataclass
from html import escape
from itertools import zip_longest
from pathlib import Path
from typing import Final

from vstestbed.report.comparison.columns import ComparisonResults
from vstestbed.report.comparison.summary_text import runs
from vstestbed.report.html.template import data_url

PICTURES: Final = 24
PICTURE_BYTES: Final = 4_000_000
"""Most pictures in the gallery, and most bytes of all of them: they are embedded in the page."""
LISTED: Final = 300
"""Most failed runs whose commands are listed."""
SEEDS: Final = 20
"""Most seeds of a controller that are named with one kind of failure."""
ERRORS: Final = 24
ERROR_CHARACTERS: Final = 4000
"""Most crashed runs whose `error.txt` is shown, and the length of its end that is shown."""


@dataclass(frozen=True)
class Failure:
    """A run that did not reach the goal; place: its folder."""

    controller: str
    seed: int
    outcome: str
    reason: str
    place: Path

    @property
    def command(self) -> str:
        """The command that repeats the run, from the directory in which the comparison was started."""
        return f"vstestbed run {shlex.quote((self.place / 'scenario.yaml').as_posix())}"

    @property
    def kind(self) -> tuple[str, str]:
        """Outcome, and the reason with its numbers masked: reasons that differ in numbers only are one kind of failure."""
        return self.outcome, re.sub(r"\d[\d.e+-]*", "#", self.reason)  # numbers such as times and pixels


def failures(folder: Path, comparison: ComparisonResults) -> list[Failure]:
    """All runs without success, by controller and seed."""
    found = []
    for controller in comparison.controllers:
        for row in controller.runs.filter(~controller.success).iter_rows(named=True):
            outcome, reason = str(row.get("outcome") or "no outcome"), str(row.get("reason") or "")
            found.append(Failure(controller.label, int(row["seed"]), outcome, reason, folder / str(row["folder"])))
    return found


def section(folder: Path, comparison: ComparisonResults) -> str:
    """The section of the page on failed runs, and on runs that were repeated because their worker process died."""
    failed = failures(folder, comparison)
    kinds: dict[tuple[str, str], list[Failure]] = defaultdict(list)
    for failure in failed:
        kinds[failure.kind].append(failure)
    groups = sorted(kinds.values(), key=len, reverse=True)
    # tracebacks of every kind of crash in turn, since there is room for only a few
    with_error = {id(f) for f in _in_turn([g for g in groups if g[0].outcome == "crashed"], ERRORS)}
    with_command = {id(f) for f in _in_turn(groups, LISTED)}
    listed = "".join(_group(group, with_command, with_error) for group in groups)
    those = "them" if len(failed) <= LISTED else f"{LISTED} of them, every kind in turn,"
    words = f"{runs(len(failed))} of {len(comparison.table)} did not reach the goal; "
    words += f"each line opens to the commands that run {those} again."
    if not failed:
        words = f"All {runs(len(comparison.table))} reached the goal."
    return f'<section><h2>Failures</h2><p class="soft">{words}</p>{listed}{_gallery(groups)}{_repeated(comparison)}</section>'


def _group(group: list[Failure], with_command: set[int], with_error: set[int]) -> str:
    """One kind of failure: number of runs, seeds of each controller, and, folded, each run's command."""
    outcome, first = group[0].outcome.replace("_", " ").capitalize(), group[0].reason
    same = all(f.reason == first for f in group)
    reason = first if same else f"{first}, and the like"
    seeds: dict[str, list[str]] = defaultdict(list)
    for failure in group:
        seeds[failure.controller].append(str(failure.seed))
    who = "; ".join(f"{name}: seed{'s' * (len(s) > 1)} {_some(s)}" for name, s in seeds.items())
    head = f'<b>{escape(outcome)}</b> {runs(len(group))}: {escape(reason)}<br><span class="soft">{escape(who)}</span>'
    shown = "".join(_run(f, same, id(f) in with_error) for f in group if id(f) in with_command)
    return f'<details class="failure"><summary>{head}</summary>{shown}</details>'


def _some(seeds: list[str]) -> str:
    """The seeds, of many the first ones and the number of the others."""
    more = len(seeds) - SEEDS
    return ", ".join(seeds[:SEEDS]) + (f" and {more:,} more" if more > 0 else "")


def _run(failure: Failure, same: bool, with_error: bool) -> str:
    reason = "" if same else f": {escape(failure.reason)}"
    error = _error(failure.place) if with_error else ""
    return f"<p>{escape(failure.controller)}, seed {failure.seed}{reason}<br><code>{escape(failure.command)}</code></p>{error}"


def _error(place: Path) -> str:
    try:
        text = (place / "error.txt").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    return f"<pre>{escape(text[-ERROR_CHARACTERS:].strip())}</pre>"


def _in_turn(groups: list[list[Failure]], most: int) -> list[Failure]:
    """Up to `most` failures, one of each group in turn, so that a frequent kind does not hide a rare one."""
    return [f for row in zip_longest(*groups) for f in row if f is not None][:most]


def _gallery(groups: list[list[Failure]]) -> str:
    """The last pictures of failed runs (`end.png`), every kind of failure in turn."""
    with_picture = [[f for f in group if (f.place / "end.png").is_file()] for group in groups]
    room, pictures = PICTURE_BYTES, []
    for failure in _in_turn(with_picture, PICTURES):
        size = (failure.place / "end.png").stat().st_size
        if size > room:
            continue  # a smaller one may still fit
        room -= size
        source = data_url("image/png", (failure.place / "end.png").read_bytes())
        words = escape(f"{failure.controller}, seed {failure.seed}: {failure.outcome.replace('_', ' ')}")
        pictures.append(f'<figure><img src="{source}" alt="{words}" loading="lazy"><figcaption>{words}</figcaption></figure>')
    total = sum(map(len, with_picture))
    if not total:
        return ""
    some = f" ({len(pictures)} of {total}, every kind in turn)" if len(pictures) < total else ""
    return f'<h2>How they ended{some}</h2><div class="gallery">{"".join(pictures)}</div>'


def _repeated(comparison: ComparisonResults) -> str:
    """The runs that took a second attempt, because their worker process died in the first."""
    if "attempts" not in comparison.table.columns:
        return ""
    repeated = [
        f"<li>{escape(c.label)}, seed {row['seed']} ({escape(str(row['outcome']).replace('_', ' '))})</li>"
        for c in comparison.controllers
        for row in c.runs.iter_rows(named=True)
        if (row["attempts"] or 1) > 1
    ]
    if not repeated:
        return ""
    return f'<h2>Done again</h2><p>Its worker died once; done again:</p><ul class="runs again">{"".join(repeated)}</ul>'
