"""Metrics and monitors that a scenario adds: the numbers, the reports, and what is refused."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

import numpy as np
import polars as pl
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.endings.monitors import MONITORS, KeepOut
from vstestbed.report.comparison.results import DEFAULT_METRICS, shown_by_default
from vstestbed.report.run.page import rows
from vstestbed.studies.comparison.plan import Comparison
from vstestbed.tasks.metrics import METRICS, CommandVariation, ErrorIntegrals, Metric

FAST = {"detector": "oracle", "camera.rate_hz": 25.0}
BOTH = {"metrics": ["error_integrals", "command_variation"]}


def test_integrals_of_a_known_error():
    """e = 4 exp(-t): the integrals of e, e^2 and t e from 0 to 10 are 4, 8 and 4, but for the rest
    beyond 10 s.
    """
    t = np.arange(0, 10, 1e-3)
    e = 4 * np.exp(-t)
    e[100:150] = np.nan  # a gap is bridged
    found = ErrorIntegrals().figures({"t": t, "error_px": e}, None)
    assert found == pytest.approx({"iae_px_s": 4, "ise_px2_s": 8, "itae_px_s2": 4}, abs=5e-3)


def test_integrals_of_a_target_never_seen():
    log = {"t": np.arange(3.0), "error_px": np.full(3, np.nan)}
    assert ErrorIntegrals().figures(log, None) == {
        "iae_px_s": None,
        "ise_px2_s": None,
        "itae_px_s2": None,
    }


def test_variation_of_a_known_command():
    steps = np.zeros((5, 6))
    steps[:, 0], steps[:, 5] = [0, 3, 3, 0, 0], [0, 0, 1, 0, 1]
    log = {
        f"cmd_{name}": steps[:, i] for i, name in enumerate(("vx", "vy", "vz", "wx", "wy", "wz"))
    }
    assert CommandVariation().figures(log, None) == {
        "command_variation_mps": 6.0,
        "command_variation_radps": 3.0,
    }


def test_they_follow_the_figures_of_every_run_and_are_in_the_report():
    plain = vs.run(vs.load("ibvs_book", FAST)).summary()
    summary = vs.run(vs.load("ibvs_book", FAST | BOTH)).summary()
    own = [name for name in summary if name not in plain]
    assert own == [*ErrorIntegrals.titles, *CommandVariation.titles]
    assert {
        name: plain[name] for name in ("path_length_m", "final_error_px")
    }.items() <= summary.items()
    assert "Integral of the squared error" in [title for title, _, _ in rows(summary)]
    assert not any("Integral" in title for title, _, _ in rows(plain))


def test_a_comparison_shows_them_with_their_titles():
    assert Metric.named("ise_px2_s").label == "Integral of the squared error [px² s]"
    assert shown_by_default(pl.DataFrame({"iae_px_s": [1.0]})) == (*DEFAULT_METRICS, "iae_px_s")
    grey = pl.DataFrame({"final_error_px": [None, None], "final_error_grey": [0.3, 0.4]})
    assert shown_by_default(grey) == (
        *(name for name in DEFAULT_METRICS if name != "final_error_px"),
        "final_error_grey",
    )
    both = pl.DataFrame({"final_error_px": [None, 0.1], "final_error_grey": [0.3, None]})
    assert shown_by_default(both) == (*DEFAULT_METRICS, "final_error_grey")
    assert Comparison(base=("quick",), metrics=("iae_px_s",)).metrics == ("iae_px_s",)
    with pytest.raises(ParameterError, match=r"metrics must be one of sim_time_s, .*iae_px_s"):
        Comparison(base=("quick",), metrics=("iae",))


def test_a_name_that_is_taken_is_refused(own_kinds):
    @METRICS.add
    @vs.spec
    class Thief:
        """It calls its figure as every run does."""

        kind: Literal["thief"] = "thief"
        titles: ClassVar[Mapping[str, tuple[str, str]]] = {"frames": ("Frames", "")}

        def figures(self, log, setup):
            raise NotImplementedError

    with pytest.raises(
        ScenarioError,
        match=r"metrics.0: of kind thief has a figure 'frames', which every run has already",
    ):
        vs.load("ibvs_book", FAST | {"metrics": ["thief"]})
    with pytest.raises(
        ScenarioError,
        match=r"metrics.1: of kind error_integrals has a figure 'iae_px_s', which metrics.0 has",
    ):
        vs.load("ibvs_book", FAST | {"metrics": ["error_integrals", "error_integrals"]})


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ({"three": "3"}, "figures must return three as a number or None"),
        ({"tree": 3}, "must give three"),
        (3, "three"),
    ],
)
def test_figures_that_are_none_are_said(own_kinds, found, words):
    @METRICS.add
    @vs.spec
    class Wrong:
        """Its figures are not its titles."""

        kind: Literal["wrong_figures"] = "wrong_figures"
        titles: ClassVar[Mapping[str, tuple[str, str]]] = {"three": ("Three", "")}

        def figures(self, log, setup):
            return found

    recording = vs.run(
        vs.load("ibvs_book", FAST | {"metrics": ["wrong_figures"], "stop.duration_s": 0.2})
    )
    with pytest.raises(
        ParameterError, match=f"metrics: wrong_figures {words}|wrong_figures.*{words}"
    ):
        recording.summary()


class TestKeepOut:
    def test_the_box_ends_a_run(self):
        box = {"kind": "keep_out", "corner": [-1, -1, 0.5], "opposite": [1, 1, -0.5]}
        recording = vs.run(vs.load("ibvs_book", FAST | {"monitors": [box]}))
        inside = np.abs(recording["cam_z"]) <= 0.5
        assert recording.outcome is (vs.Outcome.collided if inside.any() else recording.outcome)
        assert inside[-1] and not inside[:-1].any()
        assert recording.reason.startswith("the camera entered the forbidden box at x ")

    def test_a_box_beside_the_way_changes_nothing(self):
        box = {"kind": "keep_out", "corner": [50, 50, 50], "opposite": [51, 51, 51]}
        with_box, without = (
            vs.run(vs.load("ibvs_book", FAST | more)) for more in ({"monitors": [box]}, {})
        )
        assert with_box.outcome is without.outcome is vs.Outcome.converged
        assert np.array_equal(with_box.table, without.table, equal_nan=True)

    def test_a_box_without_volume_is_refused(self):
        with pytest.raises(ParameterError, match="must differ from `corner`"):
            KeepOut(corner=(0, 0, 0), opposite=(1, 0, 1))


def test_a_monitor_with_a_wrong_verdict_is_said(own_kinds):
    @MONITORS.add
    @vs.spec
    class Chatty:
        """It gives no outcome."""

        kind: Literal["chatty"] = "chatty"

        def monitor(self, setup):
            return self

        def update(self, frame):
            return "stop"

    with pytest.raises(
        ParameterError,
        match=(
            r"monitors: chatty update must return None"
            r" or \(Outcome, reason\)|chatty.*Outcome, reason"
        ),
    ):
        vs.run(vs.load("ibvs_book", FAST | {"monitors": ["chatty"]}))
