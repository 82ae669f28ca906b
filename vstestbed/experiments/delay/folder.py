"""Result files of a delay study: tables, figures, page, each complete or not at all."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import polars as pl

from vstestbed.core.files import write_whole, writing
from vstestbed.experiments.delay.measure import Limit
from vstestbed.loop.theory import NO_LAG, locus
from vstestbed.report.studies.delay import Branches, write_page

BEYOND = 1.3
"""The root locus is drawn up to this many times the gain limit."""


def write(folder: Path, limits: Sequence[Limit], name: str, command: str = "") -> Path:
    """Write `delay.csv`, `.parquet`, `.json` (with every joint's lag), `.png`, `.pdf` and `report.html`; returns the page's path.

    Raises:
        OutputError, EnvironmentLackError: a file cannot be written.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    rows = [limit.row() for limit in limits]
    table, parquet = pl.DataFrame(rows, infer_schema_length=None), io.BytesIO()
    table.write_parquet(parquet)
    write_whole(folder / "delay.parquet", parquet.getvalue())
    write_whole(folder / "delay.csv", table.write_csv())
    lags = [row | {"lags": [asdict(lag) for lag in limit.lags]} for row, limit in zip(rows, limits, strict=True)]
    write_whole(folder / "delay.json", json.dumps(lags, indent=1) + "\n")
    return write_page(folder, name, rows, [branches(limit) for limit in limits], command)


def branches(limit: Limit) -> Branches:
    """Root locus of one delay, with the measured lag of the joint that becomes unstable first, if the robot has joints."""
    first = next((lag.shares for lag in limit.lags if lag.joint == limit.joint), NO_LAG)
    end = limit.g_lag or limit.g_theory
    gains = np.linspace(1e-6, BEYOND * end, 400)  # not from 0, where all poles but one coincide at the origin
    at_limit = locus(limit.delay_frames, np.array([limit.g]), first)[0]
    return Branches(limit.delay_frames, locus(limit.delay_frames, gains, first), at_limit)
