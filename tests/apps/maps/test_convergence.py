"""Convergence maps: what makes one, its cells, the command and its folder."""

import json
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.shortcuts import Here
from vstestbed.apps.maps.convergence import RunEnding, Study
from vstestbed.cli.app import main
from vstestbed.core.errors import ParameterError
from vstestbed.scenario.load import load
from vstestbed.studies.comparison import Comparison, chosen
from vstestbed.studies.pools import WorkerLostError

AXES = {"calibration.depth_factor": (0.5, 1.0), "law.gain": (1.0, 2.0)}


def test_the_bundled_maps_are_maps():
    for name, cells in (("depth_error", 42), ("calibration_error", 45)):
        study = Study(chosen([name], {}, {}))
        x, y = study.comparison.axes.values()
        assert len(x) * len(y) == cells
        laws = study.comparison.cases["law"]
        assert list(laws) == [
            "point",
            "polar",
            "PBVS",
            "2.5D",
            *(("measured",) if name == "calibration_error" else ()),
        ]
        for law in laws.values():  # the farthest corner of each map can be flown
            corner = {path: values[-1] for path, values in study.comparison.axes.items()}
            assert (
                load(
                    study.comparison.base[0], dict(study.comparison.set) | law | corner
                ).calibration.goal
                == "shown"
            )


def test_what_makes_no_map_is_refused():
    for axes, seeds, words in (
        ({"law.gain": (1.0, 2.0)}, 1, "axes must be two"),
        (AXES, None, "seeds must be given"),
    ):
        with pytest.raises(ParameterError, match=words):
            Study(Comparison(base=("ibvs_book",), axes=axes, seeds=seeds))


def test_a_cell_counts_its_own_runs():
    study = Study(Comparison(base=("ibvs_book",), axes=AXES, seeds=2))
    ended = []
    for job in study.runs:
        good = job.controller.values["law.gain"] == 2.0 or job.seed == 0
        ended.append(
            (
                job,
                RunEnding("converged" if good else "target_lost", good, 1.0, 0.25 if good else 9.0),
            )
        )
    ((_, share, others, away_m),) = study.maps(ended)
    np.testing.assert_array_equal(share, [[0.5, 0.5], [1.0, 1.0]])  # rows: the second axis
    assert others.tolist() == [["target_lost"] * 2, ["", ""]]
    np.testing.assert_array_equal(away_m, 0.25)


def test_command_leaves_its_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "map"
    words = [
        "sweep",
        "ibvs_book",
        "pbvs_book",
        "--seeds",
        "1",
        "--jobs",
        "1",
        "--out",
        str(out),
        "--json",
    ]
    words += ["--set", "detector={kind: oracle, field_of_view: unlimited}", "--set", "law.gain=1"]
    # A goal told in metres and depths seen double: a picture is reached all the same, a pose is
    # not.
    words += ["--vary", "calibration.depth_factor=1,2", "--vary", "camera.rate_hz=10,20"]
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["scenario"], row["calibration.depth_factor"], row["outcome"]) for row in rows] == [
        ("ibvs_book", "1", "converged"),
        ("ibvs_book", "1", "converged"),
        ("ibvs_book", "2", "converged"),
        ("ibvs_book", "2", "converged"),
        ("pbvs_book", "1", "converged"),
        ("pbvs_book", "1", "converged"),
        ("pbvs_book", "2", "local_minimum"),
        ("pbvs_book", "2", "local_minimum"),
    ]
    names = {
        "convergence.csv",
        "convergence.parquet",
        "convergence.png",
        "convergence.svg",
        "convergence.pdf",
        "report.html",
    }
    assert {p.name for p in out.iterdir()} == names
    assert len(pl.read_parquet(out / "convergence.parquet")) == 8
    page = (out / "report.html").read_text()
    assert "Share of 1 seeds" in page and "pbvs_book: median distance" in page


def outcomes(study: Study, folder: Path) -> list[str]:
    """Of its runs, in the order of the plan."""
    found: dict[int, str] = {}
    study.run_all(folder, 1, lambda place, job, ending: found.update({place: ending.outcome}))
    return [found[place] for place in range(len(study.runs))]


def test_a_start_that_cannot_be_drawn_ends_its_run_and_not_the_sweep(
    quick: Path, tmp_path: Path, here: None
):
    """It ended the sweep with exit 2; a comparison counts it."""
    away = {"robot.start.random": {"xyz": [0, 0, 0], "rpy_deg": [0, 0, 0]}}
    axes = {"robot.start.nominal.xyz": ([0.1, -0.05, 0], [3, 0, 0]), "law.gain": (3.0, 6.0)}
    assert (
        outcomes(Study(Comparison(base=(str(quick),), set=away, axes=axes, seeds=1)), tmp_path)
        == ["converged"] * 2 + ["crashed"] * 2
    )


def test_a_run_that_kills_its_worker_costs_that_run_alone(
    quick: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """As where it takes all memory; the sweep ended with a traceback of the broken pool."""
    tries: dict[str, int] = {}

    class Deadly(Here):
        """Every request with the run at the larger gain of seed 0 is lost."""

        def submit(self, request):
            tries[request.folder] = tries.get(request.folder, 0) + 1
            if (
                "more" not in request.folder
                and "law.gain=6.0,camera.rate_hz=20.0/0" not in request.folder
            ):
                return super().submit(request)
            lost: Future[object] = Future()
            lost.set_exception(WorkerLostError("its worker process died"))
            return lost

        def tries(self, request):
            return tries[request.folder]

    monkeypatch.setattr("vstestbed.apps.maps.convergence.pool_of", lambda *_: Deadly())
    axes = {"law.gain": (3.0, 6.0), "camera.rate_hz": (20.0, 25.0)}
    assert outcomes(Study(Comparison(base=(str(quick),), axes=axes, seeds=1)), tmp_path) == [
        "converged"
    ] * 2 + ["crashed", "converged"]
    assert max(tries.values()) == 2
