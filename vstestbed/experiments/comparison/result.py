"""The table of a comparison as its caller gets it; it shows its result in a notebook."""

from __future__ import annotations

from pathlib import Path

import polars as pl

from vstestbed.experiments.comparison.plan import Comparison
from vstestbed.report.comparison.baseline import BaselineChanges


class ComparisonTable(pl.DataFrame):
    """A polars table, one row per run; what is computed from it is an ordinary table.

    Attributes:
        folder: of the comparison. comparison: what was compared.
        baseline: what changed against an earlier comparison; None where none was named.
    """

    folder: Path
    comparison: Comparison
    baseline: BaselineChanges | None

    @classmethod
    def of(cls, table: pl.DataFrame, folder: Path, comparison: Comparison, baseline: BaselineChanges | None = None) -> ComparisonTable:
        """The table of a comparison's folder."""
        made = cls(table)
        made.folder, made.comparison, made.baseline = folder, comparison, baseline
        return made

    def _repr_html_(self, **as_polars: bool) -> str:
        """Who is better, the controllers' numbers and their differences, where a Jupyter notebook shows the table."""
        from vstestbed.report.comparison.page import comparison_cell

        return comparison_cell(self.folder, self, self.comparison.varied, self.comparison.metrics)
