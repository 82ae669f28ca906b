"""Runs as a LeRobot dataset, format v3.0: each run an episode, many in a file; what a frame holds: `lerobot_features`.

    meta/info.json, stats.json, tasks.parquet, episodes/chunk-000/file-000.parquet
    data/chunk-000/file-000.parquet
    videos/observation.image/chunk-000/file-000.mp4

`meta/vstestbed.json` says how the pictures were made; `meta/episodes` has for each episode its run's folder, seed and outcome.

Source: https://huggingface.co/docs/lerobot/lerobot-dataset-v3
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from vstestbed.core.errors import ParameterError
from vstestbed.core.files import make_folder, write_whole
from vstestbed.core.folders import whole_folder
from vstestbed.core.provenance import vstestbed_version
from vstestbed.report.export.lerobot_features import IMAGE, Features, Numbers, features_of, numbers_of, rate_of
from vstestbed.report.export.lerobot_stats import PictureStatistics, Statistics, statistics, together
from vstestbed.report.export.source import RecordedRun
from vstestbed.report.video.writer import DATASET, VideoWriter

VERSION = "v3.0"
FILES_IN_CHUNK = 1000
DATA_MB, VIDEO_MB = 100, 200
"""Most megabytes of a file, unless one episode has more."""
EPISODES_IN_FILE = 1000
NUMBERED = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA, VIDEO, EPISODES = f"data/{NUMBERED}.parquet", f"videos/{{video_key}}/{NUMBERED}.mp4", f"meta/episodes/{NUMBERED}.parquet"
ARROW_NOTE = b"ARROW:schema"
TYPES = {"float32": pl.Float32, "float64": pl.Float64, "int64": pl.Int64, "bool": pl.Boolean}


def write_dataset(runs: Iterable[RecordedRun], out: Path, tick: Callable[[], None] = lambda: None, within: Path | None = None) -> Path:
    """Write runs as a dataset, which appears whole or not at all; one run is in memory at a time, and its pictures are not.

    Args:
        runs: of one robot, camera and number of markers. out: its folder. tick: called after each frame.
        within: the folder that the runs' folders are named relative to.

    Raises:
        ParameterError: the runs differ in what a frame holds. OutputError: `out` holds something already, or cannot be made.
        EnvironmentLackError: pictures cannot be drawn here, no H.264 encoder, no space.
    """
    with whole_folder(out) as folder:
        writer = DatasetWriter(folder, within)
        try:
            for run in runs:
                writer.add(run, tick)
            writer.finish()
        finally:
            writer.abort()
    return out


class DatasetWriter:
    """Writes a dataset episode by episode.

    Args:
        folder: to be filled. within: see `write_dataset`.
    """

    def __init__(self, folder: Path, within: Path | None = None):
        self._folder, self._within = folder, within
        self._features: Features | None = None
        self._first: RecordedRun | None = None
        self._tasks: dict[str, int] = {}
        self._frames = self._episodes = self._in_film = 0
        self._data: list[pl.DataFrame] = []
        self._films: list[VideoWriter] = []
        self._rows: list[dict[str, Any]] = []
        self._files = {"data": 0, "episodes": 0}
        self._statistics: dict[str, list[Statistics]] = {}
        self._taken: dict[str, None] = {}

    def add(self, run: RecordedRun, tick: Callable[[], None] = lambda: None) -> None:
        """Write a run as the next episode.

        Raises:
            ParameterError: its frames hold something else than those before.
        """
        numbers, state = numbers_of(run)
        self._check(run, state)
        n, task = len(numbers["timestamp"]), run.scenario.description or run.scenario.name
        numbers |= {
            "episode_index": np.full((n, 1), self._episodes),
            "index": np.arange(self._frames, self._frames + n)[:, None],
            "task_index": np.full((n, 1), self._tasks.setdefault(task, len(self._tasks))),
        }
        film = self._film(run)
        began, pictures = Fraction(self._in_film) / film.rate, PictureStatistics()
        for frame in islice(run.frames(), n):  # a run that goes on may have more by now
            film.write(frame.picture)
            pictures.add(frame.picture)
            tick()
        self._in_film += n
        found = {IMAGE: pictures.result()} | {name: statistics(values) for name, values in numbers.items()}
        where = {"data": self._files["data"], f"videos/{IMAGE}": len(self._films) - 1, "meta/episodes": self._files["episodes"]}
        row: dict[str, Any] = {"episode_index": self._episodes, "tasks": [task], "length": n}
        row |= {"dataset_from_index": self._frames, "dataset_to_index": self._frames + n}
        row |= {f"{name}/{key}": value for name, number in where.items() for key, value in _place(number).items()}
        row |= {f"videos/{IMAGE}/from_timestamp": float(began), f"videos/{IMAGE}/to_timestamp": float(Fraction(self._in_film) / film.rate)}
        row |= {"vstestbed/run": self._name(run), "vstestbed/seed": run.scenario.seed, "vstestbed/outcome": run.outcome}
        row |= {f"stats/{name}/{key}": value.tolist() for name, of in found.items() for key, value in of.items()}
        self._add(numbers, row, found)
        self._taken[run.how_taken] = None

    def finish(self) -> None:
        """Write what waits, and what is known only at the end."""
        self._end_film()
        self._write_data()
        self._write_episodes()
        assert self._first is not None and self._features is not None
        overall = {name: together(parts) for name, parts in self._statistics.items()}
        stats = {name: {key: value.tolist() for key, value in of.items()} for name, of in overall.items()}
        self._write_json("meta/stats.json", stats)
        self._write_json("meta/info.json", self._info(self._first, self._features))
        about = {"vstestbed": vstestbed_version(), "pictures": list(self._taken), "videos": "H.264, yuv420p by BT.601, crf 20"}
        missing = [name for name in self._first.scenario.robot.proprioception_names if name not in self._state_names]
        about |= {"agent_pos_without": missing, "state": "of the robot's own sensors, as the log has them; of joints the true positions"}
        self._write_json("meta/vstestbed.json", about)
        tasks = pl.DataFrame({"task_index": list(self._tasks.values()), "task": list(self._tasks)})
        self._write_parquet("meta/tasks.parquet", tasks, {"pandas": json.dumps(_INDEXED_BY_TASK)})

    def abort(self) -> None:
        """Discard the video that is not finished; harmless after `finish`."""
        for film in self._films:
            film.abort()

    def _check(self, run: RecordedRun, state: tuple[str, ...]) -> None:
        """Refuse a run whose frames hold something else."""
        features = features_of(run.scenario, state)
        if self._first is None:
            self._first, self._features, self._state_names = run, features, state
            return
        assert self._features is not None
        wrong = next((name for name in {**self._features, **features} if self._features.get(name) != features.get(name)), None)
        kinds = [r.scenario.robot.kind for r in (self._first, run)]
        if wrong is None and kinds[0] == kinds[1]:
            return
        what = f"robots ({' and '.join(kinds)})" if wrong is None else f"{wrong} (shape, rate or names)"
        words = f"holds runs that differ in {what}: {self._name(self._first)} and {self._name(run)}; a dataset's frames are all alike"
        raise ParameterError("DIR", words)

    def _name(self, run: RecordedRun) -> str:
        return run.folder.name if self._within is None else run.folder.relative_to(self._within).as_posix()

    def _film(self, run: RecordedRun) -> VideoWriter:
        """The video that takes the next episode."""
        if not self._films or self._films[-1].bytes > VIDEO_MB * 1e6:
            self._end_film()
            path = self._folder / VIDEO.format(video_key=IMAGE, **_place(len(self._films)))
            make_folder(path.parent)
            self._films.append(VideoWriter(path, run.scenario.camera.rate_hz, DATASET))
            self._in_film = 0
        return self._films[-1]

    def _end_film(self) -> None:
        if self._films:
            self._films[-1].close()

    def _add(self, numbers: Numbers, row: dict[str, Any], found: dict[str, Statistics]) -> None:
        """An episode is complete."""
        assert self._features is not None
        columns = {name: _series(name, numbers[name], f) for name, f in self._features.items() if f["dtype"] != "video"}
        self._data.append(pl.DataFrame(columns))
        self._rows.append(row)
        for name, of in found.items():
            parts = self._statistics.setdefault(name, [])
            parts[:] = [together([*parts, of])]
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

    def _info(self, run: RecordedRun, features: Features) -> dict[str, Any]:
        totals = {"total_episodes": self._episodes, "total_frames": self._frames, "total_tasks": len(self._tasks)}
        sizes = {"chunks_size": FILES_IN_CHUNK, "data_files_size_in_mb": DATA_MB, "video_files_size_in_mb": VIDEO_MB}
        paths = {"data_path": DATA, "video_path": VIDEO}
        kind = {"codebase_version": VERSION, "robot_type": run.scenario.robot.kind}
        splits = {"train": f"0:{self._episodes}"}
        return kind | totals | sizes | {"fps": rate_of(run.scenario), "splits": splits} | paths | {"features": features}

    def _write_json(self, name: str, content: dict[str, Any]) -> None:
        write_whole(make_folder((self._folder / name).parent) / Path(name).name, json.dumps(content, indent=4, ensure_ascii=False) + "\n")

    def _write_parquet(self, name: str, table: pl.DataFrame, metadata: dict[str, str] | None = None) -> None:
        path = self._folder / name
        make_folder(path.parent)
        content = io.BytesIO()
        table.write_parquet(content, compression="snappy", metadata=metadata)
        written = content.getvalue()
        # Where it finds the schema that polars notes, Arrow reads no other notes, such as those of pandas; a name that it does not know.
        write_whole(path, written if metadata is None else written.replace(ARROW_NOTE, ARROW_NOTE.lower()))


_INDEXED_BY_TASK = {
    "index_columns": ["task"],
    "column_indexes": [],
    "columns": [
        {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64", "metadata": None},
        {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object", "metadata": None},
    ],
    "pandas_version": "2.2.0",
}
"""What pandas notes in a table of its own, whose index is the task, as LeRobot looks tasks up."""


def _place(number: int) -> dict[str, int]:
    """Chunk and number of a file in it."""
    chunk, file = divmod(number, FILES_IN_CHUNK)
    return {"chunk_index": chunk, "file_index": file}


def _series(name: str, values: np.ndarray[Any, Any], feature: dict[str, Any]) -> pl.Series:
    """A feature's values (frames, k) as a column: numbers, or arrays of k numbers where k > 1."""
    typed, k = values.astype(feature["dtype"]), feature["shape"][0]
    kind = TYPES[feature["dtype"]]
    return pl.Series(name, typed[:, 0], dtype=kind()) if k == 1 else pl.Series(name, typed, dtype=pl.Array(kind(), k))
