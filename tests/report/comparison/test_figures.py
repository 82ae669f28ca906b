"""Figures over all runs: errors of different units share no axis."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import polars as pl

from tests.report.comparison.comparisons import build
from vstestbed.report.canvas import publish, save, style
from vstestbed.report.comparison.figures import (
    Data,
    differences,
    distributions,
    each_run,
    medians,
    read_series,
)
from vstestbed.report.comparison.page import _measured
from vstestbed.report.comparison.pairs import pairs
from vstestbed.report.comparison.results import ComparisonResults

PICTURE = (
    "target: {kind: picture, file: texture:poster, width: 0.4, pose: {xyz: [0, 0, 1.2]},"
    " draw_markers: false}"
)
GREY = {
    "target: {kind: square, side: 0.4, pose: {xyz: [0, 0, 1.2]}}": PICTURE,
    "detector: oracle": "detector: none",
    "law: {kind: ibvs, gain: 1}": "law: photometric",
}


def of_pictures(folder: Path, name: str, limit: float) -> None:
    """Turn the runs of a scenario into those of a law that compares pictures: 10 grey levels for
    each pixel.
    """
    for run in (folder / "runs" / name / "base").iterdir():
        text = (run / "resolved.yaml").read_text()
        for old, new in GREY.items():
            assert old in text
            text = text.replace(old, new)
        (run / "resolved.yaml").write_text(f"{text}stop: {{converged: {{error_grey: {limit}}}}}\n")
        log = pl.read_parquet(run / "log.parquet")
        log.with_columns(error_grey=10 * pl.col("error_px"), error_px=pl.lit(np.nan)).write_parquet(
            run / "log.parquet"
        )


def read(folder: Path, frame: pl.DataFrame) -> Data:
    comparison = ComparisonResults(frame)
    return read_series(folder, comparison, measured=_measured(folder, comparison, ()))


def test_pixels_and_grey_levels_have_panels_of_their_own(tmp_path: Path) -> None:
    frame = build(tmp_path, {"a": 0.8, "grey": 1.6, "b": 1.0}, 2)
    of_pictures(tmp_path, "grey", 0.4)
    data = read(tmp_path, frame)
    upper, lower = medians(data, 6.0).axes
    assert [axes.get_ylabel() for axes in (upper, lower)] == [
        "RMS error [px]",
        "RMS difference\n[grey levels]",
    ]
    assert [[words.get_text() for words in axes.texts] for axes in (upper, lower)] == [
        ["0.2 px"],
        ["0.4 grey levels"],
    ]
    assert upper.get_ylim()[1] < 300 < lower.get_ylim()[1]
    with style():
        a, grey, b = each_run(data, 7.0).axes[:3]
    assert a.get_ylim() == b.get_ylim() != grey.get_ylim()
    assert [axes.get_ylabel() for axes in (a, grey)] == [
        "RMS error [px]",
        "RMS difference\n[grey levels]",
    ]
    # the median of b is in the panel of a, and none in that of the grey levels
    assert len(grey.lines) == len(a.lines) - 1


def test_laws_of_pictures_alone_share_the_axis_of_grey_levels(tmp_path: Path) -> None:
    frame = build(tmp_path, {"one": 0.8, "two": 1.6}, 2)
    of_pictures(tmp_path, "one", 0.4)
    of_pictures(tmp_path, "two", 0.5)
    data = read(tmp_path, frame)
    (axes,) = medians(data, 6.0).axes
    assert axes.get_ylabel() == "RMS difference\n[grey levels]"
    assert not axes.texts  # they differ in their limits
    assert np.isfinite(data.errors[0]).all()


def test_a_threshold_above_all_errors_is_inside_the_axes(tmp_path: Path) -> None:
    data = read(tmp_path, build(tmp_path, {"a": 0.8, "b": 1.0}, 2))
    for errors in data.errors:
        errors *= 1e-6
    with style(), warnings.catch_warnings():
        warnings.simplefilter("error")
        figure = medians(data, 3.5)
        figure.canvas.draw()  # refused with a warning where words outside leave the axes no room
    assert figure.axes[0].get_ylim()[1] > 0.2


def test_names_that_no_font_has_are_drawn_without_a_warning(tmp_path: Path) -> None:
    data = read(tmp_path, build(tmp_path, {"a\x01b": 0.8, "law.gain mine 中": 1.0}, 2))
    assert data.labels[0] == r"a\x01b"
    with style(), warnings.catch_warnings():
        warnings.simplefilter("error")
        assert save(medians(data, 3.5), tmp_path / "names.pdf").is_file()
        assert "中" in publish(medians(data, 3.5), "m", "medians")


def test_a_metric_that_no_run_has_makes_no_panel(tmp_path: Path) -> None:
    frame = build(tmp_path, {"slow": 0.8, "fast": 1.6}, 6)
    data = read_series(
        tmp_path, ComparisonResults(frame, (), ("path_ratio", "tracking_rms_px", "peak_speed_mps"))
    )
    assert [m.name for m in data.shown] == ["path_ratio", "peak_speed_mps"]
    with style():
        assert sum(axes.get_visible() for axes in distributions(data, 5.0).axes) == 2


def test_metrics_without_a_pair_make_no_figure_of_differences(tmp_path: Path) -> None:
    """Nobody reaches the goal: of the pairs the time to the goal alone has numbers, and it is not
    among the metrics that are shown.
    """
    frame = build(
        tmp_path, {"slow": 0.8, "fast": 1.6}, 6, {("slow", seed): "timed_out" for seed in range(6)}
    )
    comparison = ComparisonResults(frame, (), ("path_ratio",))
    found = pairs(comparison)
    assert found[0].differences["time_to_goal_s"].n == 6
    with style():
        assert differences(read_series(tmp_path, comparison, found), 5.0) is None


def test_long_names_are_inside_the_figure(tmp_path: Path) -> None:
    data = read(
        tmp_path,
        build(tmp_path, {"ibvs, interaction=desired": 0.8, "ibvs, interaction=current": 1.0}, 6),
    )
    with style():
        text = publish(distributions(data, 3.4), "d", "names")
    left = [
        float(x) for x in re.findall(r'translate\((-?[\d.]+) [\d.]+\)">(?:ibvs|interaction)', text)
    ]
    assert len(left) > 1 and min(left) >= 0, left
