"""The pages, and what their marks (`docs/build/marks.py`) may call."""

from __future__ import annotations

import functools
from inspect import getmembers, isfunction
from pathlib import Path

import jinja2

import vstestbed as vs
from docs.build import parameters, render
from docs.build.conditions import conditions, conditions_line
from docs.build.kept import REPOSITORY, Kept
from docs.build.suite import Suite
from docs.build.verdicts import Verdicts
from vstestbed.loop.columns import column_texts
from vstestbed.tasks.metrics import KNOWN, RUN_COLUMNS, own_metrics

FOLDERS = ("docs", "scenarios", "models", "tests", "vstestbed")
"""Those with pages."""


def pages() -> list[Path]:
    """The pages, relative to the repository."""
    found = [*REPOSITORY.glob("*.md")]
    for folder in FOLDERS:
        found += (REPOSITORY / folder).rglob("*.md")
    return sorted(page.relative_to(REPOSITORY) for page in found)


def environment(kept: Kept) -> jinja2.Environment:
    """What marks may call: commands by their kept results, and all functions of `render.py`, as
    filters too, and of `parameters.py`.
    """
    made = jinja2.Environment(
        undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    functions = dict(getmembers(render, isfunction))
    made.filters |= functions | {
        "code": "`{}`".format,
        "g": parameters.plain,
        "n": render.number,
        "range": render.span,
    }
    made.globals |= dict(getmembers(parameters, isfunction)) | functions
    made.globals |= {
        "command": kept,
        "conditions": conditions,
        "grey_kb": (REPOSITORY / "scenarios" / "policies" / "grey.npz").stat().st_size / 1e3,
        "log_columns": column_texts,
        "model": parameters.model,
        "needed": functools.cache(vs.starts_needed),
        "run": lambda words: kept(f"run {words}"),
        "sentences": lambda command: render.sentences(kept(command), command),
        "suite": functools.cache(Suite),
        "summary_numbers": lambda: (*KNOWN.values(), *own_metrics().values()),
        "table_columns": RUN_COLUMNS.items,
        "under": conditions_line,
        "verdicts": functools.cache(Verdicts),
    }
    return made
