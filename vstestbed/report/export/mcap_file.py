"""A run as an MCAP file with Foxglove's schemas: pictures, calibration, transforms, markers as annotations, time series.

Topics under /truth are the simulator's alone; those under /camera and /robot are what a robot has. Of joints the log has the true
positions. Messages are stamped with simulated time: those of a picture with the middle of its exposure, a command's with the time from
which it is in force.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vstestbed.core.errors import EnvironmentLackError
from vstestbed.core.files import PartFile, make_folder, writing
from vstestbed.core.folders import whole_folder
from vstestbed.core.geometry import inverse
from vstestbed.core.provenance import vstestbed_version
from vstestbed.report.export.columns import meaning, name_with_unit
from vstestbed.report.export.source import RecordedRun, Taken
from vstestbed.scenario.scenario import Scenario

try:
    from mcap_protobuf.writer import Writer

    from vstestbed.report.export import messages
except ImportError as error:
    raise EnvironmentLackError(f"MCAP files need {error.name}, which is not installed", "pip install 'vstestbed[export]'") from error

Message = tuple[str, int, Any]
"""Topic, time [ns], message."""
ATTACHED = {"scenario.yaml": "application/yaml", "summary.json": "application/json", "model.xml": "application/xml"}
"""Files of a run's folder that are attached, with their media types."""
TIMED_BY_COMMAND = ("/robot/command", "/robot/applied")


def write_mcap(run: RecordedRun, path: Path, start_s: float = 0.0, tick: Callable[[], None] = lambda: None) -> Path:
    """Write a run as an MCAP file, which appears whole or not at all; an older one of that name is replaced.

    Args:
        run: the run. path: of the file. start_s: what t = 0 is in the file [s since 1970]. tick: called after each frame.

    Raises:
        EnvironmentLackError: pictures cannot be drawn here, or no space. OutputError: cannot be written.
    """
    topics = Topics(run, start_s)
    with writing(path), PartFile(path) as part:
        writer = Writer(part.file)
        writer.add_metadata("vstestbed", described(run))
        for name, kind in ATTACHED.items():
            if (run.folder / name).is_file():
                writer.add_attachment(0, topics.time_ns(0.0), name, kind, (run.folder / name).read_bytes())
        for frame in run.frames():
            for topic, time_ns, message in topics.of(frame):
                writer.write_message(topic, message, time_ns, time_ns, int(frame.row["frame"]))
            tick()
        writer.finish()
    return path


def write_mcaps(
    runs: Iterable[RecordedRun], out: Path, within: Path, start_s: float = 0.0, tick: Callable[[], None] = lambda: None
) -> Path:
    """Write a file for each run into a folder, which appears whole or not at all.

    Args:
        runs, start_s, tick: see `write_mcap`. out: the folder. within: the folder in which the runs' are; each file has the same place
            in `out`.

    Raises:
        EnvironmentLackError, OutputError: see `write_mcap`; `out` holds something already.
    """
    with whole_folder(out) as folder:
        for run in runs:
            path = folder / f"{run.folder.relative_to(within).as_posix()}.mcap"
            make_folder(path.parent)
            write_mcap(run, path, start_s, tick)
    return out


def described(run: RecordedRun) -> dict[str, str]:
    """What a reader must know of a run and of its export, as MCAP's metadata has it."""
    s = run.scenario
    lens = (
        "K, D as calibrated; /truth has the true lens"
        if messages.lens_model(s.camera)
        else f"none: no standard model of {type(s.camera).__name__}"
    )
    return {
        "scenario": s.name,
        "description": s.description,
        "seed": str(s.seed),
        "outcome": run.outcome,
        "success": json.dumps(run.success),
        "pictures": run.how_taken,
        "calibration": lens,
        "times": "simulated; pictures and measurements at the middle of the exposure, commands when they are in force",
        "vstestbed": vstestbed_version(),
    }


class Topics:
    """The messages of a run, frame by frame.

    Args:
        run: the run. start_s: what t = 0 is in the file [s since 1970].
    """

    def __init__(self, run: RecordedRun, start_s: float):
        self._scenario, self._noisy = run.scenario, run.noisy
        self._start_ns = round(start_s * messages.NS)
        self._series = dict(_series(run.scenario, run.log.columns))
        colors = np.resize(run.scenario.target.colors, (run.scenario.rows, 3))  # of more points than markers: over again
        self._goal_colors = np.column_stack([colors, np.ones(len(colors))]).tolist()

    def time_ns(self, t: float) -> int:
        """A simulated time [s] as the file has it [ns]."""
        return self._start_ns + round(t * messages.NS)

    def of(self, frame: Taken) -> Iterator[Message]:
        """The messages of a frame."""
        s, row, state = self._scenario, frame.row, frame.state
        now = self.time_ns(state.t)
        for topic, camera in (("/camera/calibration", s.believed_camera), ("/truth/camera_calibration", s.camera)):
            if (known := messages.calibration(now, camera)) is not None:
                yield topic, now, known
        yield "/camera/image", now, messages.image(now, frame.picture, self._noisy)
        n = len(state.uv)
        true = np.array([[row[f"u_true_{i}"], row[f"v_true_{i}"]] for i in range(n)])
        sizes = messages.SIZES_PX
        yield "/camera/markers", now, messages.circles(now, state.uv, [messages.SEEN] * n, sizes["seen"])
        yield "/camera/goal", now, messages.circles(now, state.goal_uv, self._goal_colors, sizes["goal"])
        yield "/truth/markers", now, messages.circles(now, true, [messages.TRUE] * n, sizes["true"])
        yield "/truth/transforms", now, messages.transforms(now, self._poses(frame), frame.bodies)
        for topic, series in self._series.items():
            at = row["t_cmd"] if topic in TIMED_BY_COMMAND and math.isfinite(row["t_cmd"]) else state.t
            time_ns = self.time_ns(at)
            yield topic, time_ns, series.message(time_ns, row)

    def _poses(self, frame: Taken) -> dict[str, Any]:
        """Poses in the world: camera, target, and the camera's goal, where there is one."""
        s, state = self._scenario, frame.state
        T_goal = s.goal_pose_at(state.t, int(frame.row.get("view", 0)))
        found = {"camera": state.T_world_camera, "target": state.T_world_target}
        return found if T_goal is None else found | {"goal": state.T_world_target @ inverse(T_goal)}


def _series(scenario: Scenario, columns: tuple[str, ...]) -> Iterator[tuple[str, messages.TimeSeries]]:
    """The time series by topic: columns of the log whose values are in no other message."""
    groups: dict[str, list[str]] = {}
    for column in columns:
        if topic := _topic(column, scenario):
            groups.setdefault(topic, []).append(column)
    for topic, those in groups.items():
        names = [name_with_unit(_short(topic, column), meaning(column, scenario).unit) for column in those]
        yield topic, messages.TimeSeries("".join(word.title() for word in topic.split("/")).replace("_", ""), names, those)


def _topic(column: str, scenario: Scenario) -> str | None:
    """The topic of a column; None where another message has it."""
    groups = {"cmd": "/robot/command", "applied": "/robot/applied", "act": "/truth/camera_twist", "ctrl": "/robot/controls"}
    groups |= {"q": "/truth/joint_positions", "qd": "/truth/joint_velocities", "depth": "/camera/depths"}
    before = column.partition("_")[0]
    if column == "scale":
        return "/robot/applied"
    if before in groups and column not in scenario.own_columns:
        return groups[before]
    if column in ("error_px", "error_grey", "lost"):
        return "/camera/error"
    if column in ("position_error_m", "rotation_error_rad"):
        return "/truth/error"
    if column in scenario.own_columns:
        return {"truth": "/truth/state", "own": "/state"}.get(meaning(column, scenario).whose, "/robot/state")
    return None


def _short(topic: str, column: str) -> str:
    """A column's name within its topic, which says what stands before it."""
    grouped = topic in ("/truth/camera_twist", "/robot/controls", "/truth/joint_positions", "/truth/joint_velocities", *TIMED_BY_COMMAND)
    return column.partition("_")[2] if grouped and column != "scale" else column
