"""Runs as a LeRobot dataset, format v3.0: each run an episode, many in a file; what a frame holds:
`lerobot_features`.

    meta/info.json, stats.json, tasks.parquet, episodes/chunk-000/file-000.parquet
    data/chunk-000/file-000.parquet
    videos/observation.image/chunk-000/file-000.mp4

`meta/vstestbed.json` says how the pictures were made; `meta/episodes` has for each episode its
run's folder, seed and outcome.

Source: https://huggingface.co/docs/lerobot/lerobot-dataset-v3
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from vstestbed.camera import Image
from vstestbed.core.errors import ParameterError
from vstestbed.core.files import make_folder, whole_folder, write_whole
from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome
from vstestbed.core.provenance import vstestbed_version
from vstestbed.laws.policy import MOST_PX, action_unit
from vstestbed.loop.ego_motion import believed_mount, mount_at, start_basis
from vstestbed.report.recorded_run import ExportFormat, ExportRequest, RecordedRun, unit_of_joint
from vstestbed.report.video.writer import DATASET, VideoWriter
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.judged import Reward, in_a_frame, potential
from vstestbed.tasks.metrics import TWIST

# What a LeRobot dataset holds of each frame: the observations, actions and ends of the scenario's
# environment (`vstestbed.apps.learn`).
#
# `observation.image` is what LeRobot makes of the environment's `pixels`, `observation.state` of
# its `agent_pos`; `markers`, `seen`, `goal` and `action` are the environment's own. A policy that
# is trained on them drives in it. Without a detector there are no markers, and their three features
# are left out: the format has none of no numbers.


IMAGE = "observation.image"
Features = dict[str, dict[str, Any]]
Numbers = dict[str, NDArray[Any]]  # Values of features by name, (frames, k) each
NUMBERS = {
    "sim_time": "float64",
    "next.reward": "float32",
    "next.done": "bool",
    "next.success": "bool",
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Features that are one number each, after the others."""
SENSOR_UNITS = dict.fromkeys(("odo_x", "odo_y", "range"), "m") | {
    name: "m/s" if name[0] == "v" else "rad/s" for name in TWIST
}
"""Of sensors that are no joints; the others measure angles."""


def features_of(scenario: Scenario, state: tuple[str, ...]) -> Features:
    """The features of a scenario's dataset as `meta/info.json` has them; state: names of what is
    known of the robot's own sensors.
    """
    camera = scenario.camera
    n = scenario.rows
    height = camera.height + camera.height % 2  # even, as films are
    width = camera.width + camera.width % 2
    info = {
        "video.height": height,
        "video.width": width,
        "video.codec": "h264",
        "video.pix_fmt": "yuv420p",
        "video.is_depth_map": False,
        "video.channels": 3,
        "has_audio": False,
        "video.fps": rate_of(scenario),
    }
    found: Features = {
        IMAGE: {
            "dtype": "video",
            "shape": [height, width, 3],
            "names": ["height", "width", "channels"],
            "info": info,
        }
    }
    if state:
        units = [_unit_of(name, scenario) for name in state]
        found["observation.state"] = _vector(_with_units(state, units))
    found["action"] = _vector(_action_names(scenario))
    if n:
        pixels = [f"{name} [px]" for name in _of_markers(n, "")]
        found["markers"] = _vector(pixels)
        found["seen"] = _vector([f"marker_{i}" for i in range(n)])
        found["goal"] = _vector(pixels)
    for name, dtype in NUMBERS.items():
        found[name] = {"dtype": dtype, "shape": [1], "names": None}
    return found


def _with_units(names: Iterable[str], units: Iterable[str]) -> list[str]:
    return [f"{name} [{unit}]" for name, unit in zip(names, units, strict=True)]


def _unit_of(sensor: str, scenario: Scenario) -> str:
    """The unit of one of the robot's own sensors."""
    if sensor in scenario.robot.joints:
        return unit_of_joint(sensor, scenario)
    return SENSOR_UNITS.get(sensor, "rad")


def numbers_of(run: RecordedRun) -> tuple[Numbers, tuple[str, ...]]:
    """The values of a run's frames, but for picture and counters; and the names of the entries of
    `observation.state`.

    A picture that never arrived has no frame: `timestamp` counts frames at the camera's rate,
    `sim_time` is when they were taken.
    """
    s = run.scenario
    uv = _of_markers(s.rows, "")
    goal = _of_markers(s.rows, "_goal")
    twist = [f"cmd_{name}" for name in TWIST]
    joints = {name: f"q_{name}" for name in s.robot.joints}
    columns = ["t", *uv, *goal, *twist, *joints.values(), *s.own_columns]
    log = {name: run.log[name] for name in columns}
    frames = len(log["t"])
    # what the log tells of the robot's own sensors, in the order of `agent_pos`: joints, and what
    # the robot's columns have
    own = s.robot.log(s.robot.supervisor(s.goal.lands, *s.stop.lost_after)).proprioception(log)
    known = {name: log[column] for name, column in joints.items()} | own
    state = {name: known[name] for name in s.robot.proprioception_names if name in known}
    found: Numbers = {}
    if state:
        found["observation.state"] = _side_by_side(state, state)
    found["action"] = actions(s, log)
    if uv:
        measured = _side_by_side(log, uv)
        found["markers"] = _pixels(measured)
        found["seen"] = np.isfinite(measured[:, ::2]).astype(float)
        found["goal"] = _pixels(_side_by_side(log, goal))
    last = np.arange(frames) == frames - 1
    found["sim_time"] = log["t"]
    found["next.reward"] = rewards(run)
    found["next.done"] = last
    found["next.success"] = last & run.success
    found["timestamp"] = np.arange(frames) / s.camera.rate_hz
    found["frame_index"] = np.arange(frames)
    return {name: values.reshape(frames, -1) for name, values in found.items()}, tuple(state)


def _of_markers(n: int, suffix: str) -> list[str]:
    """The columns of n markers' pixels."""
    return [f"{axis}{suffix}_{i}" for i in range(n) for axis in "uv"]


def _side_by_side(columns: Mapping[str, Array], names: Iterable[str]) -> Array:
    """Columns (T,) as an array (T, k)."""
    return np.stack([columns[name] for name in names], axis=1)


def rewards(run: RecordedRun) -> Array:
    """The environment's reward of its default settings from each frame to the next; at the last
    one, from there to the end.
    """
    s = run.scenario
    ended = run.summary is not None and not Outcome[run.outcome].out_of_time
    phi = []
    for row in run.log.frame().select("error_px", *s.own_columns).rows(named=True):
        judged = in_a_frame(s.goal.judged, s.stop, row)
        phi.append(potential(judged, int(row.get("view", 0)), len(s.goal_views)))
    last = np.arange(len(phi)) == len(phi) - 1
    after = np.append(phi[1:], phi[-1])
    of_steps = Reward("potential").of_step(np.array(phi), after, last & ended, last & run.success)
    return np.asarray(of_steps, dtype=float)


def actions(scenario: Scenario, log: dict[str, Array]) -> Array:
    """The commands along the robot's motions (of an arm under six joints those at the exposure), in
    [-1, 1]: u = pinv(basis) twist.
    """
    robot = scenario.robot
    mount = believed_mount(scenario)
    unit = action_unit(scenario.law.limits, start_basis(scenario))
    twists = _side_by_side(log, [f"cmd_{name}" for name in TWIST])
    joints = np.array([log[f"q_{name}"] for name in robot.joints]).reshape(-1, len(twists))
    found = []
    for twist, q in zip(twists, joints.T, strict=True):
        basis = robot.motion_basis(mount_at(scenario, mount, q), q)
        found.append(np.clip(np.linalg.pinv(basis) @ twist / unit, -1.0, 1.0))
    return np.array(found)


def _pixels(uv: Array) -> Array:
    """Pixels as a policy sees them (`laws.policy.observed`): 0 for a marker that is not seen."""
    return np.clip(np.nan_to_num(uv, nan=0.0), -MOST_PX, MOST_PX)


def _action_names(scenario: Scenario) -> list[str]:
    """Names of the motions, each with the velocity of an action of 1."""
    basis = start_basis(scenario)
    n = basis.shape[1]
    names = TWIST if n == 6 else [f"motion_{i}" for i in range(n)]
    turns = np.abs(basis[3:]).max(axis=0) > 1e-9
    most = action_unit(scenario.law.limits, basis)
    units = [f"{v:g} {'rad/s' if turn else 'm/s'}" for v, turn in zip(most, turns, strict=True)]
    return _with_units(names, units)


def _vector(names: list[str]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": [len(names)], "names": names}


def rate_of(scenario: Scenario) -> float:
    """The camera's rate [Hz], a whole number where it is one."""
    rate = scenario.camera.rate_hz
    return int(rate) if rate == int(rate) else rate


# Statistics of a dataset's features, by which LeRobot normalises: of each episode, and of all.
Statistics = dict[str, NDArray[Any]]  # min, max, mean, std, count, q01 ... q99 of a feature
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
SIDE_PX = 150  # Pictures are counted on a grid of about so many pixels along their shorter side


def statistics(values: NDArray[Any]) -> Statistics:
    """Of a feature's values (frames, k): shape (k,) each."""
    x = values.astype(float)
    found = {
        "min": x.min(axis=0),
        "max": x.max(axis=0),
        "mean": x.mean(axis=0),
        "std": x.std(axis=0),
        "count": np.array([len(x)]),
    }
    return found | {name: np.quantile(x, share, axis=0) for name, share in QUANTILES.items()}


def together(parts: list[Statistics]) -> Statistics:
    """Of several episodes; quantiles are the mean of the episodes', weighted by their frames, as
    LeRobot takes them.
    """
    counts = np.array([part["count"][0] for part in parts])

    def of_all(name: str) -> Array:
        return np.array([part[name] for part in parts])

    def mean(values: Array) -> Array:
        return np.average(values, axis=0, weights=counts)

    middle = mean(of_all("mean"))
    square = mean(of_all("std") ** 2 + of_all("mean") ** 2)
    found = {
        "min": of_all("min").min(axis=0),
        "max": of_all("max").max(axis=0),
        "mean": middle,
        "std": np.sqrt(np.maximum(square - middle**2, 0.0)),
        "count": of_all("count").sum(axis=0),
    }
    return found | {name: mean(of_all(name)) for name in QUANTILES}


def level_counts(image: Image) -> Array:
    """How often each grey level occurs in each channel of a picture (H, W, 3) uint8 RGB, on a
    coarse grid, shape (3, 256).
    """
    every = max(1, min(image.shape[:2]) // SIDE_PX)
    small = image[::every, ::every].reshape(-1, 3)
    return np.array([np.bincount(small[:, i], minlength=256) for i in range(3)], dtype=float)


def picture_statistics(counts: Array, pictures: int) -> Statistics:
    """Of so many pictures with these `level_counts` in all, as shares of 255, shape (3, 1,
    1) each.
    """
    share = counts / counts.sum(axis=1, keepdims=True)
    upto = share.cumsum(axis=1)
    grey = np.arange(256.0)
    mean = share @ grey
    found = {
        "min": (share > 0).argmax(axis=1),
        "max": 255 - (share[:, ::-1] > 0).argmax(axis=1),
        "mean": mean,
        "std": np.sqrt(np.maximum(share @ grey**2 - mean**2, 0.0)),
    }
    found |= {name: (upto >= q - 1e-12).argmax(axis=1) for name, q in QUANTILES.items()}
    of_channels = {name: (value / 255).reshape(3, 1, 1) for name, value in found.items()}
    return {**of_channels, "count": np.array([pictures])}


VERSION = "v3.0"
FILES_IN_CHUNK = 1000
DATA_MB = 100  # most megabytes of a file, unless one episode has more
VIDEO_MB = 200
EPISODES_IN_FILE = 1000
NUMBERED = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA = f"data/{NUMBERED}.parquet"
VIDEO = f"videos/{{video_key}}/{NUMBERED}.mp4"
EPISODES = f"meta/episodes/{NUMBERED}.parquet"
ARROW_NOTE = b"ARROW:schema"
TYPES = {"float32": pl.Float32, "float64": pl.Float64, "int64": pl.Int64, "bool": pl.Boolean}


def write_dataset(
    runs: Iterable[RecordedRun],
    out: Path,
    tick: Callable[[], None] = lambda: None,
    within: Path | None = None,
    task: str | None = None,
) -> Path:
    """Write runs as a dataset, which appears whole or not at all; one run is in memory at a time,
    and its pictures are not.

    Args:
        runs: of one robot, camera and number of markers. out: its folder. tick: called after each
            frame. within: the folder that the runs' folders are named relative to. task: what all
            episodes are to do, in words; None: each its scenario's description.

    ParameterError: the runs differ in what a frame holds. OutputError: `out` holds something
    already, or cannot be made.
    EnvironmentLackError: pictures cannot be drawn here, no H.264 encoder, no space.
    """
    with whole_folder(out) as folder, closing(DatasetWriter(folder, within, task)) as writer:
        for run in runs:
            writer.add(run, tick)
        writer.finish()
    return out


class DatasetWriter:
    """Writes a dataset into a folder episode by episode; within, task: see `write_dataset`."""

    def __init__(self, folder: Path, within: Path | None = None, task: str | None = None):
        self._folder = folder
        self._within = within
        self._task = task
        self._first: RecordedRun
        self._state: tuple[str, ...]
        self._features: Features = {}
        self._tasks: dict[str, int] = {}
        self._frames = self._episodes = self._in_film = 0
        self._data: list[pl.DataFrame] = []
        self._films: list[VideoWriter] = []
        self._rows: list[dict[str, Any]] = []
        self._files = {"data": 0, "episodes": 0}
        self._statistics: dict[str, Statistics] = {}
        self._taken: dict[str, None] = {}

    def add(self, run: RecordedRun, tick: Callable[[], None] = lambda: None) -> None:
        """Write a run as the next episode. ParameterError: its frames hold something else than
        those before.
        """
        numbers, state = numbers_of(run)
        self._check(run, state)
        n = len(numbers["timestamp"])
        task = self._task or run.scenario.description or run.scenario.name
        number = self._tasks.setdefault(task, len(self._tasks))
        numbers["episode_index"] = np.full((n, 1), self._episodes)
        numbers["index"] = np.arange(self._frames, self._frames + n)[:, None]
        numbers["task_index"] = np.full((n, 1), number)
        row: dict[str, Any] = {
            "episode_index": self._episodes,
            "tasks": [task],
            "length": n,
            "dataset_from_index": self._frames,
            "dataset_to_index": self._frames + n,
        }
        film = self._film(run)
        row |= _under("data", _place(self._files["data"]))
        row |= _under(f"videos/{IMAGE}", _place(len(self._films) - 1))
        row |= _under("meta/episodes", _place(self._files["episodes"]))
        row[f"videos/{IMAGE}/from_timestamp"] = float(self._in_film / film.rate)
        counts = np.zeros((3, 256))
        for frame in islice(run.frames(), n):  # a run that goes on may have more by now
            film.write(frame.picture)
            counts += level_counts(frame.picture)
            tick()
        self._in_film += n
        row[f"videos/{IMAGE}/to_timestamp"] = float(self._in_film / film.rate)
        row["vstestbed/run"] = run.place(self._within)
        row["vstestbed/seed"] = run.scenario.seed
        row["vstestbed/outcome"] = run.outcome
        found = {IMAGE: picture_statistics(counts, n)}
        found |= {name: statistics(values) for name, values in numbers.items()}
        for name, of in found.items():
            row |= _under(f"stats/{name}", _listed(of))
        self._add(numbers, row, found)
        self._taken[run.how_taken] = None

    def finish(self) -> None:
        """Write what waits, and what is known only at the end."""
        for film in self._films:
            film.close()
        self._write_data()
        self._write_episodes()
        scenario = self._first.scenario
        stats = {name: _listed(of) for name, of in self._statistics.items()}
        self._write_json("stats", stats)
        info = {
            "codebase_version": VERSION,
            "robot_type": scenario.robot.kind,
            "total_episodes": self._episodes,
            "total_frames": self._frames,
            "total_tasks": len(self._tasks),
            "chunks_size": FILES_IN_CHUNK,
            "data_files_size_in_mb": DATA_MB,
            "video_files_size_in_mb": VIDEO_MB,
            "fps": rate_of(scenario),
            "splits": {"train": f"0:{self._episodes}"},
            "data_path": DATA,
            "video_path": VIDEO,
            "features": self._features,
        }
        self._write_json("info", info)
        state = "of the robot's own sensors, as the log has them; of joints the true positions"
        sensors = scenario.robot.proprioception_names
        about = {
            "vstestbed": vstestbed_version(),
            "pictures": list(self._taken),
            "videos": "H.264, yuv420p by BT.601, crf 20",
            "agent_pos_without": [name for name in sensors if name not in self._state],
            "state": state,
        }
        self._write_json("vstestbed", about)
        tasks = pl.DataFrame({"task_index": list(self._tasks.values()), "task": list(self._tasks)})
        self._write_parquet("meta/tasks.parquet", tasks, {"pandas": json.dumps(_INDEXED_BY_TASK)})

    def close(self) -> None:
        """Discard the video that is not finished; harmless after `finish`."""
        for film in self._films:
            film.abort()

    def _check(self, run: RecordedRun, state: tuple[str, ...]) -> None:
        """Refuse a run whose frames hold something else."""
        features = features_of(run.scenario, state)
        if not self._features:
            self._first = run
            self._features = features
            self._state = state
            return
        both = (self._first, run)
        kinds = [r.scenario.robot.kind for r in both]
        names = self._features | features
        wrong = [name for name in names if self._features.get(name) != features.get(name)]
        if wrong:
            what = f"{wrong[0]} (shape, rate or names)"
        elif kinds[0] != kinds[1]:
            what = f"robots ({' and '.join(kinds)})"
        else:
            return
        places = " and ".join(r.place(self._within) for r in both)
        words = f"holds runs that differ in {what}: {places}; a dataset's frames are all alike"
        raise ParameterError("DIR", words)

    def _film(self, run: RecordedRun) -> VideoWriter:
        """The video that takes the next episode."""
        if not self._films or self._films[-1].bytes > VIDEO_MB * 1e6:
            for film in self._films:
                film.close()
            path = self._folder / VIDEO.format(video_key=IMAGE, **_place(len(self._films)))
            make_folder(path.parent)
            self._films.append(VideoWriter(path, run.scenario.camera.rate_hz, DATASET))
            self._in_film = 0
        return self._films[-1]

    def _add(self, numbers: Numbers, row: dict[str, Any], found: dict[str, Statistics]) -> None:
        """An episode is complete."""
        columns = [
            _series(name, numbers[name], feature)
            for name, feature in self._features.items()
            if name != IMAGE
        ]
        self._data.append(pl.DataFrame(columns))
        self._rows.append(row)
        for name, of in found.items():
            before = self._statistics.get(name)
            self._statistics[name] = of if before is None else together([before, of])
        self._episodes += 1
        self._frames += row["length"]
        if sum(part.estimated_size() for part in self._data) > DATA_MB * 1e6 / 2:
            self._write_data()
        if len(self._rows) == EPISODES_IN_FILE:
            self._write_episodes()

    def _write_data(self) -> None:
        if self._data:
            self._write_parquet(DATA.format(**_place(self._files["data"])), pl.concat(self._data))
            self._files["data"] += 1
            self._data = []

    def _write_episodes(self) -> None:
        if self._rows:
            table = pl.DataFrame(self._rows, infer_schema_length=None)
            self._write_parquet(EPISODES.format(**_place(self._files["episodes"])), table)
            self._files["episodes"] += 1
            self._rows = []

    def _write_json(self, name: str, content: dict[str, Any]) -> None:
        text = json.dumps(content, indent=4, ensure_ascii=False) + "\n"
        write_whole(make_folder(self._folder / "meta") / f"{name}.json", text)

    def _write_parquet(
        self, name: str, table: pl.DataFrame, metadata: dict[str, str] | None = None
    ) -> None:
        path = self._folder / name
        make_folder(path.parent)
        content = io.BytesIO()
        table.write_parquet(content, compression="snappy", metadata=metadata)
        written = content.getvalue()
        if metadata is not None:
            # Where it finds the schema that polars notes, Arrow reads no other notes, such as those
            # of pandas: a name that it does not know.
            written = written.replace(ARROW_NOTE, ARROW_NOTE.lower())
        write_whole(path, written)


_INDEXED_BY_TASK = {
    "index_columns": ["task"],
    "column_indexes": [],
    "columns": [
        {
            "name": "task_index",
            "field_name": "task_index",
            "pandas_type": "int64",
            "numpy_type": "int64",
            "metadata": None,
        },
        {
            "name": "task",
            "field_name": "task",
            "pandas_type": "unicode",
            "numpy_type": "object",
            "metadata": None,
        },
    ],
    "pandas_version": "2.2.0",
}
"""What pandas notes in a table of its own, whose index is the task, as LeRobot looks tasks up."""


def _place(number: int) -> dict[str, int]:
    chunk, file = divmod(number, FILES_IN_CHUNK)
    return {"chunk_index": chunk, "file_index": file}


def _under(place: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Values by their names below another one, as columns have them."""
    return {f"{place}/{name}": value for name, value in values.items()}


def _listed(of: Statistics) -> dict[str, Any]:
    return {name: value.tolist() for name, value in of.items()}


def _series(name: str, values: np.ndarray[Any, Any], feature: dict[str, Any]) -> pl.Series:
    """A feature's values (frames, k) as a column: numbers, or arrays of k numbers where k > 1."""
    typed = values.astype(feature["dtype"])
    kind = TYPES[feature["dtype"]]()
    if feature["shape"] == [1]:
        return pl.Series(name, typed[:, 0], dtype=kind)
    return pl.Series(name, typed, dtype=pl.Array(kind, typed.shape[1]))


def _write(asked: ExportRequest) -> Path:
    return write_dataset(asked.runs, asked.out, asked.tick, asked.within, asked.task)


LEROBOT = ExportFormat(_write, heeds=("--task",))
