"""The comparison's page and figures, from folders of runs that never happened."""

from __future__ import annotations

import re
import zlib
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.report.comparison.comparisons import build
from tests.report.html import Reader, checked
from vstestbed.core.errors import OutputError
from vstestbed.report.canvas import DPI
from vstestbed.report.comparison import page as comparison_page
from vstestbed.report.comparison.figures import read_series
from vstestbed.report.comparison.page import Drawing, write_comparison_report
from vstestbed.report.comparison.results import DEFAULT_METRICS, ComparisonResults
from vstestbed.report.comparison.statistics import success_rate
from vstestbed.report.marks import number

FAILING = {
    ("slow", 0): "timed_out",
    ("slow", 5): "timed_out",
    ("fast", 3): "target_lost",
    ("fast", 7): "crashed",
}
FIGURES = [
    "Error over time",
    "Success over time",
    "Error of single runs",
    "All runs in numbers",
    "Performance profiles",
    "Paired differences",
]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, pl.DataFrame]:
    """A comparison of two controllers, 12 seeds each, of which four runs fail and one was done
    twice, and its report.
    """
    folder = tmp_path_factory.mktemp("comparison")
    frame = build(folder, {"slow": 0.8, "fast": 1.6}, 12, FAILING)
    again = (pl.col("scenario") == "slow") & (pl.col("seed") == 4)
    frame = frame.with_columns(pl.when(again).then(2).otherwise("attempts").alias("attempts"))
    (folder / "runs/slow/base/0/end.png").write_bytes(b"\x89PNG picture")
    (folder / "comparison.mp4").write_bytes(b"a film")
    path = write_comparison_report(
        folder,
        ComparisonResults(frame, description="Two <gains>."),
        command="vstestbed compare slow fast --seeds 12",
        film=folder / "comparison.mp4",
        drawing=Drawing(paper=True),
    )
    assert path == folder / "report.html"
    return folder, frame


@pytest.fixture(scope="module")
def page(built: tuple[Path, pl.DataFrame]) -> str:
    return (built[0] / "report.html").read_text(encoding="utf-8")


def test_the_page_stands_alone_and_has_it_all(page: str) -> None:
    reader = checked(page)
    assert reader.figures == FIGURES
    for words in (
        "Two <gains>.",
        "fast and slow, no verdict: fast reached the goal from 10 of 12 starts, slow from 10",
        "2 controllers, 12 seeds, 24 runs",
        "4 runs of 24 did not reach the goal",
        "The same seed, side by side",
        "vstestbed compare slow fast --seeds 12",
        "0 to 11",
        "mujoco 3.17.0",
    ):
        assert words in reader.text
    assert "data:video/mp4;base64," in page and "prefers-color-scheme: dark" in page
    assert "#010203" not in page and "#a1b2c3" not in page


def test_the_table_agrees_with_numpy(built: tuple[Path, pl.DataFrame], page: str) -> None:
    text = checked(page).text
    frame = built[1]
    for name in ("slow", "fast"):
        rows = frame.filter(pl.col("scenario") == name)
        rate = success_rate(10, 12)
        assert f"{name} 83 % [{100 * rate.low:.0f}, {100 * rate.high:.0f}] 10 of 12" in text
        for column, every_run, scale in (
            ("path_ratio", False, 1),
            ("final_position_error_m", True, 1e3),
            ("peak_speed_mps", False, 1),
        ):
            used = (rows if every_run else rows.filter("success"))[
                column
            ].drop_nulls().to_numpy() * scale
            q1, median, q3 = (number(float(q)) for q in np.quantile(used, [0.25, 0.5, 0.75]))
            assert f"{median} [{q1}, {q3}]{f' n = {len(used)}' if len(used) < 12 else ''}" in text
    assert "12.5 [12.5, 12.5]" in text  # saturated, in percent


def test_the_primary_difference_agrees_with_numpy(
    built: tuple[Path, pl.DataFrame], page: str
) -> None:
    """Over all seeds: a run that failed counts with the limit, 10 s."""
    times = pl.when("success").then("time_to_converge_s").otherwise(10.0)
    wide = built[1].with_columns(times.alias("time")).pivot("scenario", index="seed", values="time")
    mean = float((wide["fast"] - wide["slow"]).mean())  # pyright: ignore[reportArgumentType]
    text = checked(page).text
    assert f"−{number(-mean)} [" in text and "Against fast Measured image error [px]" in text
    assert "0 p = 1 only this 2, only other 2, both 8, neither 0" in text
    assert "Caution: 2 of 12 runs of slow failed and count with their limit of time" in text


def test_the_tables_are_there_for_a_paper(built: tuple[Path, pl.DataFrame]) -> None:
    latex, markdown = ((built[0] / f"tables.{end}").read_text() for end in ("tex", "md"))
    for begin, end in ((r"\begin{table}", r"\end{table}"), (r"\toprule", r"\bottomrule")):
        assert latex.count(begin) == latex.count(end) == markdown.count("\n|---|")
    rows = [line for line in latex.splitlines() if line.endswith(r"\\")]
    assert rows and not any(re.search(r"(?<!\\)[%_#]|[^\x00-\x7f]", row) for row in rows)
    for text in re.findall(r"\n\n((?:\|.*\n)+)", markdown):
        assert (
            len({line.count(" | ") for line in text.splitlines() if not line.startswith("|--")})
            == 1
        )


def test_cells_carry_what_they_sort_by(page: str) -> None:
    table = page[page.index("<table", page.index("<h2>Controllers")) :].partition("</table>")[0]
    heads = len(re.findall(r'<th scope="col" aria-sort="none"><button type="button">', table))
    assert heads == 2 + len(DEFAULT_METRICS)
    rows = re.findall(r"<tr>(.*?)</tr>", table)[1:]
    values = [re.findall(r'data-value="([^"]*)"', row) for row in rows]
    assert [len(v) for v in values] == [heads, heads]
    assert [v[0] for v in values] == ["slow", "fast"]
    assert float(values[0][1]) == pytest.approx(10 / 12, abs=1e-8)


def test_failures_are_listed_with_seeds_and_commands(
    built: tuple[Path, pl.DataFrame], page: str
) -> None:
    text = checked(page).text
    assert "Timed out 2 runs:" in text and "slow: seeds 0, 5" in text
    assert "Target lost 1 run: too few markers for 1 s" in text and "fast: seed 3" in text
    assert (
        "Crashed 1 run: ValueError: the law broke" in text
        and "Traceback: <ValueError>: the law broke" in text
    )
    for name, seed in FAILING:
        assert (
            f"vstestbed run {(built[0] / f'runs/{name}/base/{seed}/scenario.yaml').as_posix()}"
            in text
        )
    assert page.count("<code>vstestbed run") == 4
    reasons = built[1].filter(pl.col("outcome") == "timed_out")["reason"].to_list()
    # the numbers differ
    assert all(
        f"slow, seed {seed}: {reason}" in text for seed, reason in zip((0, 5), reasons, strict=True)
    )
    assert "Its worker died once; done again: slow, seed 4 (converged)" in text


def test_commands_are_quoted_for_a_shell() -> None:
    assert (
        comparison_page.rerun_command(Path("my runs/a&b/0"))
        == "vstestbed run 'my runs/a&b/0/scenario.yaml'"
    )


def test_figures_are_files_for_a_paper(built: tuple[Path, pl.DataFrame]) -> None:
    place = built[0] / "figures"
    # of two axes, of three
    plots = [plot for plot in comparison_page.PLOTS if plot[0] not in ("grid", "matrix")]
    assert sorted(p.name for p in place.iterdir()) == sorted(
        f"{n}.{end}" for n, *_ in plots for end in ("pdf", "png", "svg")
    )
    for name, _, columns, _ in plots:
        pdf, png = (place / f"{name}.pdf").read_bytes(), (place / f"{name}.png").read_bytes()
        assert pdf.startswith(b"%PDF-") and pdf.rstrip().endswith(b"%%EOF")
        assert b"/FontFile2" in pdf and b"/Type3" not in pdf  # letters are embedded whole
        box = re.search(rb"/MediaBox \[\s*0 0 ([\d.]+) ([\d.]+)", pdf)
        assert box is not None
        assert float(box[1]) == pytest.approx(72 * comparison_page.COLUMN_IN[columns])
        assert float(box[2]) < 72 * 9  # as high as a page at most
        assert png.startswith(b"\x89PNG")
        assert int.from_bytes(png[16:20], "big") == round(DPI * comparison_page.COLUMN_IN[columns])
        # vectors, no picture of them
        assert b"/XObject << >>" in pdf or not re.search(rb"/Subtype /Image", pdf)


def test_tables_for_latex_stand_on_their_side_where_they_are_wide(
    built: tuple[Path, pl.DataFrame],
) -> None:
    text = (built[0] / "tables.tex").read_text(encoding="utf-8")
    # LaTeX would take an interval for the argument of the line break
    assert not re.search(r"\\\\ *\[", text)
    flat = re.sub(r"\\begin\{tabular\}\[t\].*?\\end\{tabular\}", "", text)
    tables = re.findall(
        r"\\begin\{tabular\}\{(l+r*)\}\n\\toprule\n(.*?)\\bottomrule", flat, re.DOTALL
    )
    assert len(tables) > 4
    for columns, rows in tables:
        counts = {
            len(re.findall(r"(?<!\\)&", row)) for row in rows.splitlines() if row.endswith(r"\\")
        }
        assert counts == {len(columns) - 1}
    assert max(len(columns) for columns, _ in tables) <= 5


@pytest.mark.study
def test_the_gallery_is_limited(
    built: tuple[Path, pl.DataFrame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert '<img src="data:image/png;base64,' in (built[0] / "report.html").read_text()
    frame = build(
        tmp_path,
        {"a": 1.0},
        6,
        {("a", k): "timed_out" for k in range(5)} | {("a", 5): "target_lost"},
    )
    for k in range(6):
        (tmp_path / f"runs/a/base/{k}/end.png").write_bytes(bytes(100))
    monkeypatch.setattr(comparison_page, "PICTURES", 3)
    text = write_comparison_report(tmp_path, ComparisonResults(frame)).read_text()
    assert text.count("<img") == 3 and "How they ended (3 of 6, every kind in turn)" in text
    assert "a, seed 5: target lost" in checked(text).text  # the rare kind is not crowded out
    monkeypatch.setattr(comparison_page, "PICTURE_BYTES", 250)
    assert (
        write_comparison_report(tmp_path, ComparisonResults(frame)).read_text().count("<img") == 2
    )


@pytest.mark.study
def test_a_large_film_is_linked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = build(tmp_path, {"a": 1.0}, 1)
    (tmp_path / "comparison.mp4").write_bytes(b"large")
    monkeypatch.setattr(comparison_page, "FILM_BYTES", 4)
    text = write_comparison_report(
        tmp_path, ComparisonResults(frame), film=tmp_path / "comparison.mp4"
    ).read_text()
    assert Reader(text).references.count("comparison.mp4") == 2 and "data:video" not in text


@pytest.mark.study
def test_the_same_comparison_gives_the_same_bytes(
    built: tuple[Path, pl.DataFrame], tmp_path: Path
) -> None:
    folder, frame = built
    before = {p.name: zlib.crc32(p.read_bytes()) for p in (folder / "figures").iterdir()}
    page = write_comparison_report(folder, ComparisonResults(frame)).read_bytes()
    # figures drawn in other processes
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as workers:
        assert (
            write_comparison_report(
                folder, ComparisonResults(frame), drawing=Drawing(workers.submit)
            ).read_bytes()
            == page
        )
    after = {p.name: zlib.crc32(p.read_bytes()) for p in (folder / "figures").iterdir()}
    assert before == after


@pytest.mark.filterwarnings("error")
def test_nothing_but_crashes_still_has_a_report(tmp_path: Path) -> None:
    frame = build(
        tmp_path, {"a": 1.0, "b": 2.0}, 2, {(n, k): "crashed" for n in "ab" for k in range(2)}
    )
    reader = checked(write_comparison_report(tmp_path, ComparisonResults(frame)).read_text())
    assert reader.figures == FIGURES[:4]  # there is nothing else to draw
    assert (
        "4 runs of 4 did not reach the goal" in reader.text and "no run with a log" in reader.text
    )
    assert "b and a, no verdict: b reached the goal from 0 of 2 starts, a from 0" in reader.text


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("controllers", [1, 5, 9, pytest.param(30, marks=pytest.mark.study)])
@pytest.mark.study
def test_any_number_of_controllers(tmp_path: Path, controllers: int) -> None:
    frame = build(
        tmp_path,
        {f"a controller with a long name, number {k}": 1 + 0.2 * k for k in range(controllers)},
        2,
    )
    path = write_comparison_report(
        tmp_path, ComparisonResults(frame, (), ("time_to_converge_s", "time_ms.physics"))
    )
    reader = checked(path.read_text())
    matrix = ["Who is better"] if 1 < controllers < 30 else []
    assert reader.figures == [*FIGURES[:2], *matrix, *FIGURES[2:4]]  # two seeds tell nothing
    assert ("Paired differences" in reader.text) == (controllers > 1)
    assert "time_ms.physics" in reader.text


@pytest.mark.parametrize(
    ("effects", "laws", "figures"), [(2, 13, "first 24 of 26"), (13, 2, "grid stands for")]
)
def test_of_many_controllers_the_page_has_the_grid_or_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, effects: int, laws: int, figures: str
) -> None:
    """Two values of an axis make no grid. No log is read for the grid: there is none here."""
    drawn: list[tuple[str, int]] = []

    def note(data: comparison_page.Data, plot: int, place: None) -> str:
        drawn.append((comparison_page.PLOTS[plot][0], len(data.labels)))
        return ""

    monkeypatch.setattr(comparison_page, "_drawn", note)
    rows = [
        {
            "scenario": "s",
            "effect": f"e{effect}",
            "law": f"l{law}",
            "seed": seed,
            "folder": "none",
            "outcome": "converged",
            "success": True,
        }
        | {
            "time_to_converge_s": 5.0 + effect + seed,
            "reason": "",
            "sim_time_s": 9.0,
            "attempts": 1,
        }
        for effect in range(effects)
        for law in range(laws)
        for seed in range(2)
    ]
    text = write_comparison_report(
        tmp_path, ComparisonResults(pl.DataFrame(rows), ("effect", "law"))
    ).read_text(encoding="utf-8")
    assert figures in text
    assert drawn == (
        [("grid", 26)] if effects > 2 else [(plot[0], 24) for plot in comparison_page.PLOTS]
    )


def test_text_is_escaped(tmp_path: Path) -> None:
    frame = build(tmp_path, {"a": 1.0}, 2, {("a", 0): "timed_out"}).with_columns(
        pl.lit("<b>$x_1$</b>").alias("scenario"), pl.lit("<i>gone</i>").alias("reason")
    )
    text = checked(
        write_comparison_report(tmp_path, ComparisonResults(frame), command="a && <b>").read_text()
    ).text
    assert "<b>$x_1$</b>" in text and "<i>gone</i>" in text and "a && <b>" in text


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    frame = build(tmp_path, {"a": 1.0}, 1)
    (tmp_path / "figures").write_text("a file in the way")
    with pytest.raises(OutputError, match="figures"):
        write_comparison_report(tmp_path, ComparisonResults(frame), drawing=Drawing(paper=True))
    assert not (tmp_path / "report.html").exists()


@pytest.mark.study
def test_a_thousand_runs_fit_in_a_page(tmp_path: Path) -> None:
    kinds = ("timed_out", "target_lost", "converged", "crashed")
    failing = {(n, k): kinds[k % 4] for n in ("one", "two") for k in range(0, 250, 3)}
    frame = build(tmp_path, {"one": 0.8, "two": 1.0, "three": 1.2, "four": 1.6}, 250, failing)
    (tmp_path / "comparison.mp4").write_bytes(bytes(comparison_page.FILM_BYTES))
    for k in range(0, 250, 3):
        (tmp_path / f"runs/one/base/{k}/end.png").write_bytes(bytes(150_000))
    path = write_comparison_report(
        tmp_path, ComparisonResults(frame), film=tmp_path / "comparison.mp4"
    )
    assert path.stat().st_size < 20e6
    text = path.read_text()
    checked(text)
    # what is not film or picture, so that it opens at once
    assert len(re.sub(r"base64,[\w+/=]*", "", text)) < 4e6
    assert len(re.findall("<(?:use|path)", text)) < 25_000


def test_of_very_many_runs_the_page_shows_some_and_says_so(
    built: tuple[Path, pl.DataFrame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, frame = built
    monkeypatch.setattr("vstestbed.report.comparison.figures.SAMPLED", 0)
    monkeypatch.setattr("vstestbed.report.comparison.figures.LEAST_SAMPLED", 5)
    comparison = ComparisonResults(frame)
    series = read_series(folder, comparison)
    assert [e.shape[0] for e in series.errors] == [5, 5] and series.sampled == 5
    monkeypatch.setattr(comparison_page, "LISTED", 3)
    monkeypatch.setattr(comparison_page, "SEEDS", 1)
    found = comparison_page.failures(folder, comparison)
    assert (
        found["failed"],
        found["listed"],
        sum(len(kind["shown"]) for kind in found["kinds"]),
    ) == (4, 3, 3)
    assert "slow: seeds 0 and 1 more" in [kind["who"] for kind in found["kinds"]]
