"""Charts as SVG: what is drawn where, and the numbers along the axes."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tests.report.html import checked
from vstestbed.core.geometry import Array
from vstestbed.report.chart import Chart, log_ticks, numerals, ticks


def paths(chart: Chart) -> list[list[Array]]:
    """The pieces of each curve in the first panel, each (n, 2) in tenths of a point."""
    body = re.findall(r"<svg x=.*?</svg>", chart.svg("Chart"))[0]
    return [
        [np.cumsum(_pairs(piece), axis=0) for piece in d.split("M")[1:]]
        for d in re.findall(r'<path d="([^"]*)"', body)
    ]


def _pairs(piece: str) -> Array:
    return np.reshape([int(n) for n in re.findall(r"-?\d+", piece.replace("h0", ""))], (-1, 2))


def box(chart: Chart) -> tuple[float, float]:
    """Width and height of the first panel [pt]."""
    width, height = re.findall(
        r'<svg x="[\d.]+" y="[\d.]+" width="([\d.]+)" height="([\d.]+)"', chart.svg("Chart")
    )[0]
    return float(width), float(height)


def test_a_curve_lies_where_its_values_are() -> None:
    chart = Chart(3.0)
    (panel,) = chart.panels
    panel.xlim, panel.ylim = (0, 2), (-1, 1)
    panel.plot([0, 1, 2], [-1, 0.5, 1])
    width, height = box(chart)
    ((line,),) = paths(chart)
    np.testing.assert_allclose(
        line, [[0, 10 * height], [5 * width, 2.5 * height], [10 * width, 0]], atol=1.5
    )


def test_gaps_stay_and_a_single_value_is_a_dot() -> None:
    chart = Chart(3.0)
    chart.panels[0].plot(np.arange(6.0), [1, 2, np.nan, 3, np.nan, np.nan])
    chart.panels[0].plot([2.0, 3], [np.nan, 2])
    (first, second), _ = paths(chart)
    assert len(first) == 2 and len(second) == 1  # which round ends make a dot of the line's width
    assert re.search(r'<path d="M\d+ \d+m-15 0a15 15', chart.svg("Chart"))


def test_many_points_are_few_where_the_line_is_straight_and_no_peak_is_lost() -> None:
    y = np.zeros(40_000)
    y[12_345] = 1.0
    chart = Chart(3.0)
    chart.panels[0].plot(np.arange(40_000.0), y)
    ((line,),) = paths(chart)
    assert len(line) < 8
    # margins of a twentieth to each side
    assert np.ptp(line[:, 1]) == pytest.approx(10 * box(chart)[1] / 1.1, abs=2)


def test_an_infinite_coordinate_is_the_border() -> None:
    chart = Chart(3.0)
    chart.panels[0].plot([0, 1], [5, 7])
    chart.panels[0].plot([0.5, 0.5], [-np.inf, np.inf])
    _, (rule,) = paths(chart)
    np.testing.assert_allclose(rule[:, 1], [10 * box(chart)[1], 0], atol=1)


def test_a_logarithmic_axis_has_equal_steps_and_gaps_for_what_is_not_positive() -> None:
    chart = Chart(3.0)
    chart.panels[0].log = True
    chart.panels[0].plot(np.arange(6.0), [1, 0.01, 0.1, 0.0, -1, 1])
    first, second = paths(chart)[0]
    drop, rise = np.diff(first[:, 1])
    assert drop == pytest.approx(-2 * rise, abs=2) and len(second) == 1


def test_a_unit_is_as_long_both_ways_on_equal_scale() -> None:
    chart = Chart()
    (panel,) = chart.panels
    panel.equal, panel.xlim, panel.ylim = True, (0, 3), (2, 0)
    for chart.height in (100, 300, 900):
        width, height = box(chart)
        assert width / 3 == pytest.approx(height / 2, abs=0.1)
    panel.plot([0, 3], [0, 0])
    assert paths(chart)[0][0][0, 1] == 0  # y downwards, as given


def test_the_legend_has_each_name_once_and_as_it_stands() -> None:
    chart = Chart(3.0, 2)
    for panel in chart.panels:
        panel.plot([0, 1], [0, 1], label="a<b $1$", linestyle=":")
        panel.area((0, 1), (0, 1), "#d03040", 0.16, "lost")
    reader = checked(chart.svg("A & B"))
    assert list(chart.legend()) == ["a<b $1$", "lost"]
    assert reader.figures == ["A & B"] and reader.text.count("a<b $1$") == 1


def test_numbers_along_an_axis() -> None:
    for low, high, most, numbers in (
        (0, 17, 8, "0.0 2.5 5.0 7.5 10.0 12.5 15.0"),
        (-0.04, 0.021, 3, "−0.025 0.000"),
        (0, 640, 7, "0 100 200 300 400 500 600"),
        (-2e-5, 3e-5, 3, "−2×10⁻⁵ 0 2×10⁻⁵"),
        (1e6, 3.2e6, 3, "10⁶ 2×10⁶ 3×10⁶"),
        (0.9991, 1.0009, 4, "0.9995 1.0000 1.0005"),
    ):
        assert " ".join(numerals(ticks(low, high, most))) == numbers


@pytest.mark.parametrize(
    ("low", "high", "at"),
    [
        (0.05, 200, [0.1, 1, 10, 100]),
        (1e-9, 1, [1e-9, 1e-6, 1e-3, 1]),
        (3, 30, [5, 10, 20]),
        (1.15, 1.4, [1.2, 1.3, 1.4]),
    ],
)
def test_numbers_along_a_logarithmic_axis(low: float, high: float, at: list[float]) -> None:
    np.testing.assert_allclose(log_ticks(low, high, 3), at)


@pytest.mark.parametrize("log", [False, True])
@pytest.mark.parametrize(
    "values", [[1.0, 1e308, -1e308], [1e-320, 1.0, 1e308], [np.nan, np.inf, 1e308]]
)
def test_numbers_of_a_damaged_log_are_drawn(values: list[float], log: bool):
    chart = Chart(2.0)
    (panel,) = chart.panels
    panel.log = log
    panel.plot([0, 1, 2], values, color="#000")
    assert "<path" in chart.svg("Chart") and "inf" not in chart.svg("Chart")
