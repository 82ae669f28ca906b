"""Closed loops through lenses that see sideways and behind: from rendered pixels to the goal, with
log and films.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import vstestbed as vs
from tests.conftest import Ended
from tests.shortcuts import one_quick
from vstestbed.core.errors import VstestbedError
from vstestbed.core.outcome import Outcome
from vstestbed.tasks.frame import Frame


def test_markers_behind_the_camera_come_to_the_goal_view():
    scenario = vs.load("spherical_behind", {"law.gain": 1.0, "camera.rate_hz": 10})
    T_camera_target = (
        np.linalg.inv(scenario.robot.flange_pose(scenario.robot.configuration()))
        @ scenario.target.pose.T
    )
    assert (scenario.target.points @ T_camera_target[2, :3] + T_camera_target[2, 3] < 0).all()
    images: list[object] = []

    class Look:
        def frame(self, frame: Frame) -> None:
            images.append(frame.image)

    r = vs.run(scenario, [Look()])
    assert r.outcome is Outcome.converged
    assert not r["lost"].any()
    assert r["position_error_m"][-1] < 0.02
    assert images == [None] * len(images)  # six panels are no picture of the camera's own
    theta = np.array([r[f"theta_{i}"] for i in range(4)])
    assert theta[:, 0].min() > 2
    assert theta[:, -1].max() < 0.6
    phi = np.array([r[f"phi_{i}"] for i in range(4)])
    f = scenario.camera.f
    for i in range(4):  # both beside the pixels of the camera's own, azimuthal picture
        np.testing.assert_allclose(r[f"u_{i}"], 319.5 + f * theta[i] * np.cos(phi[i]), atol=1e-6)
        np.testing.assert_allclose(r[f"v_{i}"], 319.5 + f * theta[i] * np.sin(phi[i]), atol=1e-6)


def test_no_perspective_camera_can_start_there():
    lens = {"camera": {"kind": "perspective", "fovy_deg": 120}, "law.feature.kind": "point"}
    r = vs.run(vs.load("spherical_behind", lens))
    assert r.outcome is Outcome.target_lost
    assert r["lost"].all()


def test_the_books_spherical_flight():
    r = vs.run(vs.load("spherical_book"))
    assert r.outcome is Outcome.converged
    assert not r["lost"].any()
    assert r["position_error_m"][-1] < 0.02


@pytest.mark.parametrize(
    "camera",
    one_quick(
        {"kind": "fisheye", "width": 480, "height": 480, "fov_deg": 185},
        {"kind": "catadioptric", "width": 480, "height": 480, "xi": 0.8, "fov_deg": 200},
    ),
    ids=lambda c: c["kind"],
)
def test_a_wide_lens_with_an_image_plane(camera: dict[str, object]):
    changes = {
        "camera": {**camera, "rate_hz": 10},
        "law.feature.kind": "polar",
        "law.interaction": "mean",
        "law.gain": 1.5,
        "target.marker.radius": 0.09,
    }
    r = vs.run(vs.load("spherical_book", changes))
    assert r.outcome is Outcome.converged
    assert not r["lost"].any()
    assert "theta_0" not in r.columns
    true = np.column_stack([r[f"{a}_true_{i}"] for i in range(4) for a in "uv"])
    seen = np.column_stack([r[f"{a}_{i}"] for i in range(4) for a in "uv"])
    assert np.median(np.abs(seen - true)) < 0.1


def test_the_arm_with_a_fisheye():
    r = vs.run(vs.load("arm_fisheye", {"law.gain": 1.0, "stop.converged.error_px": 0.12}))
    assert r.outcome is Outcome.converged
    assert r["position_error_m"][-1] < 0.003
    assert "theta_0" not in r.columns


def test_the_same_run_has_the_same_bytes():
    tables = [
        vs.run(vs.load("spherical_behind", {"stop.duration_s": 0.5})).table.tobytes()
        for _ in range(2)
    ]
    assert tables[0] == tables[1]


def test_goals_that_a_lens_or_a_law_cannot_have():
    behind = {"goal.T_camera_target.xyz": [0, 0, -2]}
    assert vs.load("spherical_book", behind).goal_view.uv.shape == (4, 2)
    with pytest.raises(
        VstestbedError, match="behind the camera, where law ibvs has no image plane to work in"
    ):
        vs.load("spherical_book", {**behind, "law.feature": "point"})
    with pytest.raises(VstestbedError, match="outside the 640 x 640 picture"):
        vs.load(
            "spherical_book", {**behind, "camera": {"kind": "fisheye", "width": 640, "height": 640}}
        )
    sideways = {"goal.T_camera_target.xyz": [2, 0, 0.2], "target.side": 0.3}
    assert vs.load(
        "spherical_book", {**sideways, "camera": {"kind": "fisheye", "width": 640, "height": 640}}
    )


def test_random_starts_have_the_target_in_view_all_around():
    for seed in range(5):
        s = vs.load("spherical_book").randomised(seed)
        p = np.linalg.inv(s.robot.flange_pose(s.robot.configuration())) @ s.target.pose.T
        assert s.camera.whole(
            s.target.points @ p[:3, :3].T + p[:3, 3], s.target.marker.radius
        ).all()


@pytest.mark.study
def test_films_and_a_film_again(command: Callable[..., Ended], tmp_path: Path):
    import av

    ended = command(
        "run",
        "spherical_behind",
        "--set",
        "stop.duration_s=0.2",
        "--video",
        "both",
        "--out",
        tmp_path / "r",
    )
    assert ended.code == 3
    log = pl.read_parquet(tmp_path / "r" / "log.parquet")
    assert {"theta_3", "phi_3"} <= set(log.columns)
    again = command("render", tmp_path / "r", "--camera", "eye", "--out", tmp_path / "again.mp4")
    assert again.code == 0
    frames = []
    for film in (tmp_path / "r" / "camera.mp4", tmp_path / "again.mp4"):
        with av.open(film) as container:
            frames.append([f.to_ndarray(format="rgb24") for f in container.decode(video=0)])
    # every second one, the last one, and a second for the end
    pictures = -(-len(log) // 2) + 1 + 12
    assert [len(f) for f in frames] == [pictures] * 2
    assert frames[0][0].shape == (680, 640, 3)  # the picture, and the line of numbers
    np.testing.assert_array_equal(frames[0], frames[1])
    # drawn ahead too, where no marker is and the detector did not look
    assert frames[0][0][320, 320].min() > 60
