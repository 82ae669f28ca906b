"""How often a verdict is wrong: the study's kept counts, as tables of a page and its figure.

python -m tests.long.verdict_worlds      # counts again, some minutes
python -m docs.build.verdicts            # draws the figure
"""

from __future__ import annotations

from pathlib import Path

import polars as pl

KEPT = Path(__file__).parents[1] / "kept"
FIGURE = Path(__file__).parents[1] / "media" / "verdicts.png"
FEW = 5  # starts, with which there is no verdict
WRONG = ("wrong_1", "wrong_2", "wrong_3")
POWER = "abcde"


class Verdicts:
    """The counts of `tests/long/verdict_worlds.py`, in percent."""

    def __init__(self):
        self.cells = pl.read_csv(KEPT / "verdicts.csv")
        counts = (*WRONG, "any_verdict", "any_sooner", "a", "b", "trade", "sooner_b")
        self._shares = self.cells.with_columns(
            (100 * pl.col(name) / pl.col("draws")).alias(name) for name in counts
        )
        self._judged = self._shares.filter(
            pl.col("what").is_in(["fixed", "random", "many"]), pl.col("n") > FEW
        )

    @property
    def draws(self) -> int:
        """Simulated comparisons, of all cells that must not be wrong."""
        return int(self._judged["draws"].sum())

    @property
    def counts(self) -> tuple[int, int]:
        """Cells, and draws of each at least."""
        return len(self._judged), min(self._judged["draws"].to_list())

    @property
    def starts(self) -> list[int]:
        """The numbers of starts."""
        return sorted(self._judged["n"].unique().to_list())

    @property
    def kinds(self) -> list[str]:
        """The generators."""
        return self._judged["kind"].unique(maintain_order=True).to_list()

    def cells_of(self, kind: str) -> int:
        """Number of cells of a generator."""
        return len(self._judged.filter(kind=kind))

    def most(self, kind: str, wrong: int) -> float:
        """Largest share of one of the three kinds of wrong."""
        return max(self._of(kind)[WRONG[wrong - 1]].to_list())

    def over_all(self, kind: str = "") -> float:
        """Share of wrong verdicts over all cells: kinds 2 and 3 added, since all of kind 1 are of
        kind 3.
        """
        shares = self._of(kind).select(pl.col("wrong_2") + pl.col("wrong_3")).to_series().to_list()
        return sum(shares) / len(shares)

    def largest(self, kind: str = "", n: int | None = None) -> float | None:
        """Largest share of wrong verdicts of any kind; None: no cell."""
        those = self._of(kind) if n is None else self._of(kind).filter(n=n)
        return max(those.select(pl.max_horizontal(WRONG)).to_series().to_list(), default=None)

    def largest_cell(self) -> dict[str, object]:
        """The cell in which most are wrong."""
        return (
            self._judged.with_columns(most=pl.max_horizontal(WRONG))
            .sort("most")
            .row(-1, named=True)
        )

    def with_few(self) -> tuple[int, int]:
        """Simulated comparisons of five starts, and those of them with a verdict or a trade."""
        few = self.cells.filter(n=FEW)
        return int(few["draws"].sum()), int((few["any_verdict"] + few["trade"]).sum())

    def equal(self, laws: int, column: str) -> float:
        """Of equal laws: the largest share with any verdict (`any_verdict`), or with any word on
        who is sooner (`any_sooner`).
        """
        return max(self._judged.filter(pl.col("equal"), pl.col("laws") == laws)[column].to_list())

    def power(self, letter: str, n: int, column: str = "b") -> float:
        """Share in which the better one is called better; `sooner_b`: sooner."""
        found = self._shares.filter(what="power", name=self.power_name(letter), n=n)
        return found[column].item()

    def power_name(self, letter: str) -> str:
        """What flies in a cell of the power."""
        cells = self._shares.filter(what="power", kind="power")
        return cells["name"].unique(maintain_order=True).to_list()[POWER.index(letter)]

    def trade(self, n: int, column: str) -> float:
        """Of the true trade: share of `a`, `b`, `trade`."""
        return self._shares.filter(kind="a true trade", n=n)[column].item()

    def without_limit(self, n: int) -> float:
        """Share of wrong verdicts by a metric without a largest value."""
        return self._shares.filter(what="outside", n=n)["b"].item()

    def intervals(self) -> list[tuple[str, list[int], list[float], list[float]]]:
        """Of each distribution: numbers of starts, coverage and power of Student's t."""
        table = pl.read_csv(KEPT / "intervals.csv")
        found = []
        for name in table["differences"].unique(maintain_order=True):
            rows = table.filter(differences=name)
            covered, power = (
                (100 * rows[column] / rows["draws"]).to_list() for column in ("covered", "found")
            )
            found.append((name, rows["n"].to_list(), covered, power))
        return found

    def _of(self, kind: str) -> pl.DataFrame:
        return self._judged.filter(kind=kind) if kind else self._judged


def draw(place: Path = FIGURE) -> None:
    """The power over the number of starts, and the wrong share of each cell by generator."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    found = Verdicts()
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(11, 4.6), constrained_layout=True, width_ratios=(1, 1.25)
    )
    starts = [n for n in found.starts if n >= 10]
    for letter in POWER:
        left.plot(
            starts,
            [found.power(letter, n) for n in starts],
            "o-",
            label=f"{letter}: {found.power_name(letter)}",
        )
    left.set(
        xscale="log",
        xlabel="starts",
        ylabel="called better [%]",
        ylim=(-2, 142),
        yticks=range(0, 101, 20),
    )
    left.set_xticks(starts, [str(n) for n in starts])
    left.minorticks_off()
    left.legend(loc="upper left", fontsize=7.5)
    kinds = found.kinds[::-1]
    for at, kind in enumerate(kinds):
        cells = found._of(kind).select(pl.max_horizontal(WRONG)).to_series().to_list()
        heights = [at + 0.14 * (i % 5 - 2) for i in range(len(cells))]
        right.plot(cells, heights, ".", color="tab:blue", alpha=0.35, markersize=5)
    right.axvline(5, color="tab:red", linewidth=1)
    right.set(xlabel="wrong verdicts [%]; a dot: a world and a number of starts", xlim=(-0.1, 5.4))
    right.set_yticks(range(len(kinds)), kinds)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(place, dpi=118)
    plt.close(figure)


if __name__ == "__main__":
    draw()
