"""LeRobot datasets, read by polars and av as the format's version 3.0 lays them out, and by LeRobot
itself in a study.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import av
import numpy as np
import polars as pl
import pytest

import vstestbed as vs
from vstestbed.apps.export import lerobot
from vstestbed.apps.export.lerobot import (
    level_counts,
    picture_statistics,
    statistics,
    together,
    write_dataset,
)
from vstestbed.core.errors import ParameterError
from vstestbed.report.recorded_run import RecordedRun, opened

KEY = "observation.image"


@pytest.fixture(scope="module")
def dataset(folders: list[Path], home: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both runs as a dataset."""
    return write_dataset(opened(folders), tmp_path_factory.mktemp("lerobot") / "ds", within=home)


def info_of(dataset: Path) -> dict[str, Any]:
    return json.loads((dataset / "meta/info.json").read_text())


def episodes_of(dataset: Path) -> list[dict[str, Any]]:
    return pl.read_parquet(dataset / "meta/episodes/*/*.parquet").to_dicts()


def path_of(dataset: Path, episode: dict[str, Any], kind: str) -> Path:
    """The file of an episode's data, or video, by the paths that info.json gives."""
    info, of = info_of(dataset), "data" if kind == "data" else f"videos/{KEY}"
    where = {"chunk_index": episode[f"{of}/chunk_index"], "file_index": episode[f"{of}/file_index"]}
    return dataset / info[f"{kind}_path"].format(video_key=KEY, **where)


def frame_at(path: Path, t: float) -> np.ndarray:
    """The picture of a video at a time, (H, W, 3) RGB."""
    with av.open(str(path)) as film:
        for frame in film.decode(video=0):
            if abs(frame.time - t) < 1e-4:  # LeRobot's tolerance
                assert frame.colorspace == 6  # BT.601, said in the file for those who ask
                return frame.to_ndarray(format="rgb24")  # as LeRobot reads it, without asking
    raise AssertionError(f"no frame at {t}")


def test_one_text_for_all_episodes(folders: list[Path], tmp_path: Path) -> None:
    made = write_dataset(opened(folders[:1]), tmp_path / "ds", task="look at the discs")
    assert pl.read_parquet(made / "meta/tasks.parquet")["task"].to_list() == ["look at the discs"]
    assert episodes_of(made)[0]["tasks"] == ["look at the discs"]


def test_info_describes_what_is_there(dataset: Path) -> None:
    info = info_of(dataset)
    assert (
        info["codebase_version"] == "v3.0" and info["fps"] == 25 and info["robot_type"] == "puma560"
    )
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"], info["splits"]) == (
        2,
        16,
        1,
        {"train": "0:2"},
    )
    data = pl.read_parquet(dataset / "data/*/*.parquet")
    features = info["features"]
    assert set(data.columns) == {
        name for name, feature in features.items() if feature["dtype"] != "video"
    }
    for name in data.columns:
        shape = features[name]["shape"]
        assert data[name].dtype == (
            lerobot.TYPES[features[name]["dtype"]]
            if shape == [1]
            else pl.Array(pl.Float32, shape[0])
        )
        assert features[name]["names"] is None or len(features[name]["names"]) == shape[0]
    assert features[KEY]["shape"] == [240, 322, 3] and features[KEY]["info"]["video.fps"] == 25
    assert (
        features["action"]["names"][0] == "vx [1 m/s]"
        and features["observation.state"]["names"][5] == "joint_6 [rad]"
    )
    assert data["index"].to_list() == list(range(16))
    assert data["frame_index"].to_list() == 2 * list(range(8))
    assert data["episode_index"].to_list() == [0] * 8 + [1] * 8
    np.testing.assert_allclose(data["timestamp"], np.tile(np.arange(8) / 25, 2), atol=1e-7)


def test_each_frame_of_the_videos_is_the_picture_of_its_row(
    dataset: Path, folders: list[Path]
) -> None:
    for folder, episode in zip(folders, episodes_of(dataset), strict=True):
        frames = list(RecordedRun.of(folder).frames())
        assert (
            episode["length"]
            == len(frames)
            == episode["dataset_to_index"] - episode["dataset_from_index"]
        )
        began = episode[f"videos/{KEY}/from_timestamp"]
        assert episode[f"videos/{KEY}/to_timestamp"] == pytest.approx(began + len(frames) / 25)
        for k, frame in enumerate(frames):
            found = frame_at(path_of(dataset, episode, "video"), began + k / 25)
            assert found.shape == (240, 322, 3)
            off = np.abs(found[:, :321].astype(float) - frame.picture)
            # coded, with colour at half the size; a picture of another frame, or blue for red, is
            # further off
            assert off.mean() < 4
            # in the middle of each marker, away from its rim
            for u, v in np.round(frame.state.uv).astype(int):
                np.testing.assert_allclose(
                    found[v - 1 : v + 2, u - 1 : u + 2].mean((0, 1)), frame.picture[v, u], atol=16
                )


def test_rows_hold_the_run(dataset: Path, folders: list[Path]) -> None:
    data = pl.read_parquet(dataset / "data/*/*.parquet")
    for i, folder in enumerate(folders):
        run = RecordedRun.of(folder)
        log, rows = (
            dict(zip(run.log.columns, run.log.table.T, strict=True)),
            data.filter(pl.col("episode_index") == i),
        )
        # no limits: 1 is 1 m/s
        np.testing.assert_allclose(rows["action"].to_numpy()[:, 0], log["cmd_vx"], rtol=1e-6)
        np.testing.assert_allclose(
            rows["observation.state"].to_numpy()[:, 5], log["q_joint_6"], rtol=1e-6
        )
        np.testing.assert_allclose(rows["markers"].to_numpy()[:, 3], log["v_1"], rtol=1e-6)
        np.testing.assert_array_equal(rows["sim_time"], log["t"])
        assert (
            rows["next.done"].to_list() == [False] * 7 + [True] and not rows["next.success"].any()
        )


def test_statistics_are_those_of_the_data(dataset: Path, folders: list[Path]) -> None:
    stats = json.loads((dataset / "meta/stats.json").read_text())
    data = pl.read_parquet(dataset / "data/*/*.parquet")
    assert set(stats) == set(info_of(dataset)["features"])
    action = data["action"].to_numpy().astype(float)
    for name, expected in (
        ("min", action.min(0)),
        ("max", action.max(0)),
        ("mean", action.mean(0)),
        ("std", action.std(0)),
    ):
        np.testing.assert_allclose(stats["action"][name], expected, rtol=1e-5, atol=1e-9)
    assert stats["action"]["count"] == [16] and np.shape(stats[KEY]["mean"]) == (3, 1, 1)
    pictures = (
        np.array([frame.picture for folder in folders for frame in RecordedRun.of(folder).frames()])
        / 255
    )
    np.testing.assert_allclose(
        np.ravel(stats[KEY]["mean"]), pictures.mean(axis=(0, 1, 2)), atol=1e-9
    )
    np.testing.assert_allclose(np.ravel(stats[KEY]["std"]), pictures.std(axis=(0, 1, 2)), atol=1e-9)
    np.testing.assert_allclose(np.ravel(stats[KEY]["max"]), pictures.max(axis=(0, 1, 2)), atol=1e-9)
    first = episodes_of(dataset)[0]
    np.testing.assert_allclose(
        first["stats/action/q50"], np.median(action[:8], axis=0), rtol=1e-5, atol=1e-9
    )


def test_statistics_of_parts_are_those_of_the_whole() -> None:
    rng = np.random.default_rng(0)
    parts = [rng.normal(i, 1 + i, (n, 2)) for i, n in enumerate((5, 20, 3))]
    whole, found = statistics(np.concatenate(parts)), together([statistics(part) for part in parts])
    for name in ("min", "max", "mean", "std", "count"):
        np.testing.assert_allclose(found[name], whole[name])
    images = rng.integers(0, 256, (2, 40, 30, 3)).astype(np.uint8)
    two = picture_statistics(sum(map(level_counts, images)), 2)
    np.testing.assert_allclose(
        two["q10"].ravel() * 255, np.quantile(images, 0.1, axis=(0, 1, 2), method="inverted_cdf")
    )


def test_episodes_know_their_task_run_and_outcome(dataset: Path) -> None:
    episodes = episodes_of(dataset)
    task = vs.load("arm_ibvs").description
    assert [e["tasks"] for e in episodes] == [[task], [task]]
    assert [
        (e["vstestbed/run"], e["vstestbed/seed"], e["vstestbed/outcome"]) for e in episodes
    ] == [
        ("runs/0", 0, "timed_out"),
        ("runs/1", 1, "timed_out"),
    ]
    assert pl.read_parquet(dataset / "meta/tasks.parquet").to_dicts() == [
        {"task_index": 0, "task": task}
    ]
    about = json.loads((dataset / "meta/vstestbed.json").read_text())
    assert about["pictures"] == [
        "redrawn from the log at the camera's rate and size, with the run's noise of 2 grey levels"
    ]
    assert about["agent_pos_without"] == []


def test_large_files_are_divided_between_episodes(
    folders: list[Path], home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lerobot, "VIDEO_MB", 0.001)
    monkeypatch.setattr(lerobot, "DATA_MB", 0.0001)
    monkeypatch.setattr(lerobot, "EPISODES_IN_FILE", 1)
    monkeypatch.setattr(lerobot, "FILES_IN_CHUNK", 2)
    out = write_dataset(opened([*folders, folders[0]]), tmp_path / "ds", within=home)
    episodes = episodes_of(out)
    for kind, of in (("data", "data"), ("video", f"videos/{KEY}"), ("meta", "meta/episodes")):
        assert [(e[f"{of}/chunk_index"], e[f"{of}/file_index"]) for e in episodes] == [
            (0, 0),
            (0, 1),
            (1, 0),
        ], kind
    assert [e[f"videos/{KEY}/from_timestamp"] for e in episodes] == [0.0, 0.0, 0.0]
    for episode in episodes:
        rows = pl.read_parquet(path_of(out, episode, "data"))
        assert set(rows["episode_index"]) == {episode["episode_index"]}
        assert frame_at(path_of(out, episode, "video"), 7 / 25).shape == (240, 322, 3)


def test_runs_that_differ_in_what_a_frame_holds_are_refused(
    folders: list[Path], home: Path, tmp_path: Path
) -> None:
    other = home / "other"
    if not other.exists():
        other.mkdir()
        vs.run_into(
            other,
            vs.load("arm_ibvs", {"camera.width": 64, "camera.height": 48, "stop.duration_s": 0.04}),
            "none",
            report=False,
        )
    with pytest.raises(
        ParameterError,
        match=r"differ in observation\.image \(shape, rate or names\): runs/0 and other",
    ):
        write_dataset(opened([folders[0], other]), tmp_path / "ds", within=home)
    assert list(tmp_path.iterdir()) == []


READER = """
import json, sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.utils import dataset_to_policy_features
ds = LeRobotDataset(
    "local/runs", root=sys.argv[1], video_backend="pyav", delta_timestamps={"action": [0.0, 0.04]}
)
def pixel(item, i):
    u, v = item["markers"][2 * i : 2 * i + 2].round().int().tolist()
    return item["observation.image"][:, v, u] * 255
items = [ds[i] for i in range(len(ds))]
print(json.dumps({
    "episodes": ds.num_episodes,
    "images": [(item["observation.image"].mean(dim=(1, 2)) * 255).tolist() for item in items],
    "states": [item["observation.state"].tolist() for item in items],
    "reds": [pixel(item, 0).tolist() for item in items],
    "actions": [item["action"].tolist() for item in items],
    "tasks": sorted({item["task"] for item in items}),
    "done": [bool(item["next.done"]) for item in items],
    "features": sorted(dataset_to_policy_features(ds.features)),
}))
"""


@pytest.mark.process
@pytest.mark.study
def test_lerobot_itself_reads_it(dataset: Path, folders: list[Path], tmp_path: Path) -> None:
    python = os.environ.get("LEROBOT_PYTHON") or shutil.which("lerobot-python")
    if not python:
        pytest.skip(
            "LEROBOT_PYTHON names no Python with LeRobot"
            " (its torch and av are others than vstestbed's)"
        )
    environment = {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path), "PATH": os.environ["PATH"]}
    done = subprocess.run(
        [python, "-c", READER, str(dataset)],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.strip().splitlines()[-1])
    frames = [frame for folder in folders for frame in RecordedRun.of(folder).frames()]
    assert found["episodes"] == 2 and found["tasks"] == [vs.load("arm_ibvs").description]
    np.testing.assert_allclose(
        found["images"], [frame.picture.mean(axis=(0, 1)) for frame in frames], atol=4
    )
    # a single pixel, with noise, coded
    np.testing.assert_allclose(found["reds"], len(frames) * [[191, 0, 0]], atol=25)
    np.testing.assert_allclose(found["states"], [frame.state.q for frame in frames], atol=1e-6)
    np.testing.assert_allclose(
        [a[0][0] for a in found["actions"]], [frame.row["cmd_vx"] for frame in frames], atol=1e-6
    )
    assert found["done"] == 2 * [*[False] * 7, True]
    assert found["features"] == ["action", "observation.image", "observation.state"]
