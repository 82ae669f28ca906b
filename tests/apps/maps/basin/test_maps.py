"""Maps of basins of attraction: their grid, what they leave, and the command."""

from __future__ import annotations

import json
import math
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import vstestbed as vs
from vstestbed.apps.maps.basin import Axis, laws, starts
from vstestbed.cli.app import main
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose, inverse
from vstestbed.studies import basin
from vstestbed.studies.batch import ideal, start_of, started_at
from vstestbed.studies.comparison import chosen

FAST = {"law.gain": 1.0, "detector": {"kind": "oracle", "field_of_view": "unlimited"}}
"""A tenth a step with ibvs_book's ten pictures a second."""


def test_a_grid_in_the_frame_of_the_goal_camera():
    s = ideal(vs.load("ibvs_book", FAST))
    poses = starts(s, Axis("x", -1, 1, 3), Axis("yaw", 0, 90, 2), {"z": -2.0, "roll": 10.0})
    # The other coordinates are the start's own: the camera at (1, 1, -3), its goal at (0, 0, 2),
    # both looking along z.
    expected = Pose(xyz=(-1, 1, -2), rpy_deg=(10, 0, 90)).T
    assert inverse(poses[3] @ inverse(s.goal_view.T_camera_target)) == pytest.approx(
        expected, abs=1e-12
    )
    assert starts(s, Axis("x", 1, 2, 2), Axis("y", 1, 2, 2), {})[0] == pytest.approx(
        start_of(s), abs=1e-12
    )


def test_what_a_grid_refuses():
    for words, x, y, at in (
        ("--x and --y has x twice", "x", "x", {}),
        ("--at must be one of z, roll, pitch, yaw, got 'y'", "x", "y", {"y": 1}),
        ("--at must be one of", "x", "y", {"depth": 1}),
        ("--at z must be finite, got nan", "x", "y", {"z": math.nan}),
    ):
        with pytest.raises(ParameterError, match=words):
            starts(ideal(vs.load("ibvs_book")), Axis(x, 0, 1, 2), Axis(y, 0, 1, 2), at)


def test_points_retreat_to_infinity_only_near_the_half_turn():
    s = ideal(vs.load("ibvs_book", FAST))
    made = basin.basin(
        "points", s, Axis("yaw", 0, 180, 19), Axis("x", -0.5, 0.5, 3), {"y": 0, "z": 0}, check=8
    )
    ends = made.endings.reshape(3, 19)
    assert (ends[:, :14] == "converged").all()  # up to 130 degrees
    assert (ends[:, -1] == "diverged").all()
    assert made.checked == 8 + len(basin.ON_AXIS_DEG) and made.disagreements == ()
    times = made.time_to_converge_s.reshape(3, 19)
    assert np.isfinite(times[:, :14]).all() and np.isnan(times[:, -1]).all()


def test_a_comparison_names_its_laws():
    found = laws(chosen(["canonical"], {"camera.rate_hz": 5}, {}))
    assert [label for label, _ in found][:3] == ["points", "points_desired", "points_mean"]
    assert len(found) == 15 and all(s.camera.rate_hz == 5 for _, s in found)
    found = laws(chosen(["ibvs_book"], {}, {"law.interaction": ("current", "mean")}), "unlimited")
    assert [label for label, _ in found] == ["interaction=current", "interaction=mean"]


def test_maps_that_would_be_the_same_are_refused():
    varied = {"robot.actuation": ("ideal", "industrial")}
    with pytest.raises(
        ParameterError,
        match=(
            "`actuation=industrial` would make the same map as `actuation=ideal`:"
            " its cameras are ideal"
        ),
    ):
        laws(chosen(["arm_ibvs"], {}, varied))
    with pytest.raises(
        ParameterError, match="`friction, points` would make the same map as `dynamics, points`"
    ):
        laws(chosen(["realism"], {}, {}))


def told_of(caplog: pytest.LogCaptureFixture, name: str, **more: Any) -> str:
    caplog.clear()
    laws(chosen([name], {path.replace("__", "."): value for path, value in more.items()}, {}))
    assert len(caplog.records) <= 1
    return caplog.text.partition("leave out ")[2].partition(";")[0]


def test_what_a_map_leaves_out_is_told_in_one_sentence(caplog: pytest.LogCaptureFixture):
    assert told_of(caplog, "ibvs_book") == ""
    effects = {
        "camera__readout_s": 0.02,
        "camera__sensor": {},
        "noise__pixel_sigma_px": 1,
        "timing__exposure_s": 0.01,
    }
    assert (
        told_of(caplog, "ibvs_book", **effects)
        == "camera.readout_s, camera.sensor, noise.pixel_sigma_px, timing.exposure_s"
    )
    lab = told_of(caplog, "arm_ibvs", robot__realism="lab", camera__latency_s=0.04)
    assert lab.startswith(
        "the dynamics and limits of robot puma560, robot.realism, camera.latency_s"
    )
    arm = told_of(caplog, "arm_ibvs", robot__encoders__counts=8192)
    assert arm.startswith("the dynamics and limits of robot puma560, robot.encoders")


def test_points_of_a_detectors_own_are_told_and_refused_where_the_corners_do_not_stand_for_them(
    caplog: pytest.LogCaptureFixture,
):
    assert "the points that detector keypoints finds" in told_of(caplog, "arm_keypoints")
    for name in ("camera_cns", "camera_keypoints", "camera_vitvs"):
        with pytest.raises(
            ParameterError,
            match=(
                r"^detector\.kind keypoints finds points of its own in"
                r" pictures.*sweep and compare --vary"
            ),
        ):
            laws(chosen([name], {}, {}))


def test_a_target_that_moves_has_no_map():
    for name, kind in (("arm_track_circle", "circle"), ("arm_eye_to_hand", "held")):
        with pytest.raises(
            ParameterError, match=f"target.motion must be still in a batch, got '{kind}'"
        ):
            laws(chosen([name], {}, {}))


def run(*words: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(w) for w in words])
    return int(ended.value.code or 0)


def test_the_command_leaves_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "map"
    words = [
        "basin",
        "ibvs_book",
        "--set",
        "law.gain=1",
        "--x",
        "x=-1:1",
        "--y",
        "yaw=-180:180",
        "--at",
        "z=-1",
        "--at",
        "y=0",
        "--n",
        12,
    ]
    code = run(
        *words,
        "--vary",
        "law.interaction=current,desired",
        "--check",
        5,
        "--field-of-view",
        "unlimited",
        "--out",
        out,
        "--json",
    )
    assert code == 0
    told = json.loads(capsys.readouterr().out)
    assert told == json.loads((out / "basin.json").read_text())
    assert [t["label"] for t in told] == ["interaction=current", "interaction=desired"]
    assert all(
        t["starts"] == 144 and t["checked"] == t["agreeing"] == 5 + len(basin.ON_AXIS_DEG)
        for t in told
    )
    assert sum(told[0]["shares"].values()) == pytest.approx(1)
    assert (
        told[0]["x"] == {"name": "x", "low": -1.0, "high": 1.0, "n": 12, "unit": "m"}
        and told[0]["y"]["unit"] == "deg"
    )
    assert {name: one["value"] for name, one in told[0]["fixed"].items()} == pytest.approx(
        {"y": 0, "z": -1, "roll": 0, "pitch": 0}, abs=1e-9
    )
    assert told[0]["fixed"]["roll"]["unit"] == "deg" and told[0]["field_of_view"] == "unlimited"
    table = pl.read_parquet(out / "basin.parquet")
    assert len(table) == 288
    assert {
        "law",
        "x",
        "yaw",
        "outcome",
        "steps",
        "time_to_converge_s",
    } <= set(table.columns)
    assert (
        table.filter(pl.col("outcome") != "converged")["time_to_converge_s"].null_count()
        == (table["outcome"] != "converged").sum()
    )
    assert (out / "basin.png").read_bytes()[:4] == b"\x89PNG"
    assert (out / "basin.pdf").read_bytes()[:4] == b"%PDF"
    page = (out / "report.html").read_text()
    assert (
        "in the frame of its goal; y 0 m, z -1 m, roll 0 deg, pitch 0 deg." in page
        and "; unlimited field of view" in page
    )
    assert "interaction=desired" in page and "data:image/png;base64" in page
    assert not list(out.glob("*.part"))
    assert run(*words, "--out", out) == 2
    assert "exists and is not an empty folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--x", "x=-1", "--y", "y=0:1"), "--x needs the form NAME=LOW:HIGH"),
        (
            ("--x", "depth=0:1", "--y", "y=0:1"),
            "--x must be one of x, y, z, roll, pitch, yaw, got 'depth'",
        ),
        (("--x", "x=1:0", "--y", "y=0:1"), "x needs the form low:high with low < high"),
        (("--x", "x=0:1", "--y", "y=0:1", "--at", "z"), "--at needs the form NAME=VALUE"),
        (("--x", "x=0:1", "--y", "y=0:1", "--at", "z=1", "--at", "z=2"), "--at has z twice"),
        (
            ("--x", "x=0:1", "--y", "y=0:1", "--set", "law.depth=estimate"),
            "law.depth may not be estimate in a batch",
        ),
    ],
)
def test_mistakes_are_told(
    words: tuple[str, ...], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert run("basin", "ibvs_book", *words, "--out", tmp_path / "map") == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "map").exists()


def test_a_start_that_the_simulation_ends_otherwise_is_listed(monkeypatch: pytest.MonkeyPatch):
    s = ideal(vs.load("ibvs_book", FAST))
    flown = basin.run
    monkeypatch.setattr(
        basin,
        "run",
        lambda one: flown(started_at(one, inverse(Pose(xyz=(0, 0, 2), rpy_deg=(0, 0, 180)).T))),
    )
    made = basin.basin(
        "points",
        s,
        Axis("x", -0.1, 0.1, 2),
        Axis("y", -0.1, 0.1, 2),
        {"z": -0.1, "yaw": 0},
        check=4,
    )
    assert made.checked == len(made.disagreements) == 4 + len(basin.ON_AXIS_DEG)
    assert {d.batch for d in made.disagreements} == {"converged"}
    assert {d.full for d in made.disagreements} <= {"diverged", "target_lost"}
    assert [d.on_axis_deg for d in made.disagreements] == [None] * 4 + list(basin.ON_AXIS_DEG)
    assert {(d.x, d.y) for d in made.disagreements[:4]} == {
        (x, y) for x in (-0.1, 0.1) for y in (-0.1, 0.1)
    }
    words = [d["words"] for d in made.summary()["disagreements"]]
    assert words[0].startswith("x ")
    assert words[-1].startswith("frontal, centred, turned by 113 deg: converged here, ")


@pytest.mark.parametrize(
    "law",
    [{"kind": "pbvs"}, {"kind": "ibvs"}, {"kind": "hybrid", "source": "model"}],
    ids=lambda law: law["kind"],
)
def test_frontal_centred_starts_end_as_in_the_time_loop(
    law: dict[str, str], monkeypatch: pytest.MonkeyPatch
):
    """There the batch, which has the true pose, once said `converged` of runs that rested for want
    of one.
    """
    s = ideal(vs.load("ibvs_book", {"law": {**law, "gain": 1.0}, "detector": FAST["detector"]}))
    flown, views = basin.run, []
    monkeypatch.setattr(basin, "run", lambda one: views.append(start_of(one)) or flown(one))
    assert list(basin._on_axis(s)) == []  # pyright: ignore[reportPrivateUsage]
    assert len(views) == len(basin.ON_AXIS_DEG)
    assert all(T[:2, 3] == pytest.approx(0, abs=1e-12) for T in views)
    assert all(
        T[2, :3] == pytest.approx([0, 0, 1], abs=1e-12) and T[2, 3] == pytest.approx(1)
        for T in views
    )
    # No pose is solved in those views: the check tells.
    monkeypatch.setattr("vstestbed.vision.pnp.planar_poses", lambda xy, points: [])
    assert [d.full for d in basin._on_axis(s)] == ["target_lost"] * len(basin.ON_AXIS_DEG)  # pyright: ignore[reportPrivateUsage]


@pytest.mark.study
@pytest.mark.parametrize("view", ["unlimited", "limited"])
def test_a_hundred_thousand_starts_of_every_law(view: str):
    """At gain x step = .1; 98 % of 200 spots end as in the time loop."""
    x, y, at = Axis("x", -2, 2, 316), Axis("yaw", -180, 180, 316), {"z": -1.0, "y": 0.0}
    for label, s in laws(chosen(["canonical"], {"camera.rate_hz": 5}, {}), view):
        made = basin.basin(label, s, x, y, at, check=200)
        print(view, json.dumps(made.summary()))
        assert made.summary()["gain_step"] == pytest.approx(0.1)
        assert len(made.disagreements) <= 4


PREDICTIVE = {
    "law": {"kind": "predictive", "gain": 2.0},
    "camera.rate_hz": 5.0,
    "detector": "oracle",
}


@pytest.mark.process
def test_a_law_that_is_asked_run_by_run_is_shared_among_workers(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    s, axes = (
        ideal(vs.load("ibvs_book", PREDICTIVE)),
        (Axis("x", -0.5, 0.5, 4), Axis("yaw", -40, 40, 4)),
    )
    shared = basin.basin("predictive", s, *axes, jobs=2, folder=tmp_path)
    alone = basin.basin("predictive", s, *axes)
    np.testing.assert_array_equal(shared.batch.outcome, alone.batch.outcome)
    np.testing.assert_allclose(shared.batch.T_camera_target, alone.batch.T_camera_target, atol=1e-9)
    assert "asked run by run: 16 starts take some" in caplog.text and not shared.interrupted


def test_after_an_interrupt_the_part_that_was_flown_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def one_part(pool: Any, work: Any, again: Any) -> Any:
        i, request = work[0]
        future: Any = Future()
        future.set_result(request.perform())
        yield i, request, future
        raise KeyboardInterrupt

    monkeypatch.setattr("vstestbed.studies.batch.completed", one_part)
    s = ideal(vs.load("ibvs_book", PREDICTIVE))
    found = basin.basin(
        "predictive",
        s,
        Axis("x", -0.5, 0.5, 8),
        Axis("yaw", 0, 40, 2),
        check=3,
        jobs=1,
        folder=tmp_path,
    )
    assert found.interrupted and found.checked == 0
    assert (found.endings == "interrupted").sum() == 14
    assert (found.endings == "converged").sum() == 2
    assert found.summary()["shares"] == {"converged": 1.0} and found.summary()["starts"] == 2
