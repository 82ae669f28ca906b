"""Results of a comparison beside its runs: the side-by-side film of one seed, and the report."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from vstestbed.core.shares import Call, at_once
from vstestbed.experiments.comparison.plan import Comparison
from vstestbed.scenario.yaml_marks import read_value

if TYPE_CHECKING:
    import polars

FILM = "comparison.mp4"
FILMS = ("overview.mp4", "camera.mp4")
"""Films of a run, from top to bottom of its column."""


def finish(folder: Path, comparison: Comparison, table: polars.DataFrame, stage: Callable[[str], None], call: Call | None = None) -> None:
    """Make film and report of the finished runs; nothing if there is none.

    Args:
        folder: the comparison's. comparison: its plan. table: of its runs. stage: called with what is being done.
        call: does shares of the work at the same time, in other processes.

    Raises:
        OutputError, EnvironmentLackError: a file cannot be written.
    """
    from vstestbed.report.comparison.columns import shown_by_default
    from vstestbed.report.comparison.page import write_comparison_report

    call = call or at_once
    if table.is_empty():
        return
    axes = comparison.varied
    if comparison.tasks:
        from vstestbed.report.comparison.tasks import write_task_report

        stage("writing the report")
        write_task_report(folder, table, axes, comparison.metrics, comparison.description, command_of(comparison), call)
        return
    stage("joining the films")
    film = call(_film, folder, table, axes)  # first: it takes longest
    stage("writing the report")
    metrics, command = comparison.metrics or shown_by_default(table), command_of(comparison)
    write_comparison_report(folder, table, axes, metrics, comparison.description, command, film, comparison.plugins, call)


def _film(folder: Path, table: polars.DataFrame, axes: tuple[str, ...]) -> Path | None:
    """Make `comparison.mp4`: the first filmed run of each controller, up to six controllers; None if there are no films."""
    from vstestbed.report.comparison.columns import ComparisonResults
    from vstestbed.report.video.side_by_side import MOST, Column, side_by_side

    columns = []
    for controller in ComparisonResults(table, axes).controllers[:MOST]:
        # crashed runs have no films
        run = next((row for row in controller.runs.iter_rows(named=True) if _films(folder / row["folder"])), None)
        if run is not None:
            # the time to converge, as everywhere; a run that does not has the time at which it ended
            time_s = run["sim_time_s"] if run["time_to_converge_s"] is None else run["time_to_converge_s"]
            ending = run["outcome"] if time_s is None else f"{run['outcome']} {time_s:.1f} s"
            columns.append(Column(controller.label, _films(folder / run["folder"]), ending, bool(run["success"])))
    return side_by_side(columns, folder / FILM) if columns else None


def _films(run: Path) -> tuple[Path, ...]:
    return tuple(run / name for name in FILMS if (run / name).is_file())


def command_of(comparison: Comparison) -> str:
    """The command line that repeats a comparison; cases and tasks have no options, so that they need the plan in its folder."""
    if comparison.cases or comparison.tasks:
        return "vstestbed compare comparison.yaml"
    names = [Path(name).stem if Path(name).suffix != ".yaml" else Path(name).name for name in comparison.base]
    words = ["vstestbed", "compare", *names, *(f"--plugin={name}" for name in comparison.plugins)]
    options = [("--set", f"{path}={_value(value)}") for path, value in comparison.set.items()]
    options += [("--vary", f"{path}={','.join(map(_value, values))}") for path, values in comparison.axes.items()]
    options += [] if comparison.seeds is None else [("--seeds", str(comparison.seeds))]
    return shlex.join(chain(words, *options))


def _value(value: object) -> str:
    """A value in YAML's flow style."""
    if isinstance(value, bool) or value is None:  # before numbers: bool is an int
        return {True: "true", False: "false", None: "null"}[value]
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    plain = str(value)  # quoted only where YAML would read it as something else, such as `on` or `1`
    return json.dumps(value) if isinstance(value, str) and read_value(f"[{plain}]") != [value] else plain
