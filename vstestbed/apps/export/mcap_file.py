"""A run as an MCAP file with Foxglove's schemas: pictures, calibration, transforms, markers as
annotations, time series.

Topics under /truth are the simulator's alone; those under /camera and /robot are what a robot has.
Of joints the log has the true positions. Messages are stamped with simulated time: those of a
picture with the middle of its exposure, a command's with the time from which it is in force.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CircleAnnotation_pb2 import CircleAnnotation
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Point2_pb2 import Point2
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from google.protobuf.timestamp_pb2 import Timestamp

from vstestbed.camera import Camera, Image
from vstestbed.camera.intrinsics import as_ros
from vstestbed.core.errors import EnvironmentLackError
from vstestbed.core.files import PartFile, writing
from vstestbed.core.geometry import Array, inverse, quaternion_wxyz
from vstestbed.core.provenance import vstestbed_version
from vstestbed.loop.columns import LOSS
from vstestbed.report.recorded_run import (
    Bodies,
    ExportFormat,
    ExportRequest,
    RecordedRun,
    Taken,
    meaning,
    name_with_unit,
)
from vstestbed.report.video.writer import jpeg_of, png_of
from vstestbed.scenario.scenario import Scenario

try:
    from mcap_protobuf.writer import Writer

except ImportError as error:
    raise EnvironmentLackError(
        f"MCAP files need {error.name}, which is not installed", "pip install 'vstestbed[export]'"
    ) from error

Message = tuple[str, int, Any]  # topic, time [ns], message
ATTACHED = {
    "scenario.yaml": "application/yaml",
    "resolved.yaml": "application/yaml",
    "summary.json": "application/json",
    "model.xml": "application/xml",
}
"""Files of a run's folder that are attached, with their media types."""
TIMED_BY_COMMAND = ("/robot/command", "/robot/applied")


def write_mcap(
    run: RecordedRun, path: Path, start_s: float = 0.0, tick: Callable[[], None] = lambda: None
) -> Path:
    """Write a run as an MCAP file, which appears whole or not at all; an older one of that name is
    replaced.

    `start_s`: what t = 0 is in the file [s since 1970]. tick: called after each frame.
    EnvironmentLackError: pictures cannot be drawn here, or no space. OutputError: cannot be
    written.
    """
    start_ns = round(start_s * NS)
    series = _series(run.scenario, run.log.columns)
    # of more points than markers: over again
    colors = np.resize(run.scenario.target.colors, (run.scenario.rows, 3))
    goal_colors = np.column_stack([colors, np.ones(len(colors))]).tolist()
    with writing(path), PartFile(path) as part:
        writer = Writer(part.file)
        writer.add_metadata("vstestbed", described(run))
        for name, kind in ATTACHED.items():
            file = run.folder / name
            if file.is_file():
                writer.add_attachment(0, start_ns, name, kind, file.read_bytes())
        for frame in run.frames():
            for topic, time_ns, message in _messages(frame, run, start_ns, series, goal_colors):
                writer.write_message(topic, message, time_ns, time_ns, int(frame.row["frame"]))
            tick()
        writer.finish()
    return path


def described(run: RecordedRun) -> dict[str, str]:
    """What a reader must know of a run and of its export, as MCAP's metadata has it."""
    s = run.scenario
    calibration = f"none: no standard model of {type(s.camera).__name__}"
    if as_ros(s.camera):
        calibration = "K, D as calibrated; /truth has the true lens"
    return {
        "scenario": s.name,
        "description": s.description,
        "seed": str(s.seed),
        "outcome": run.outcome,
        "success": json.dumps(run.success),
        "pictures": run.how_taken,
        "calibration": calibration,
        "times": (
            "simulated; pictures and measurements at the middle of the exposure,"
            " commands when they are in force"
        ),
        "vstestbed": vstestbed_version(),
    }


# By topic the class of a message, and the columns of the log by its fields
Series = dict[str, tuple[Any, dict[str, str]]]


def _messages(
    frame: Taken, run: RecordedRun, start_ns: int, series: Series, goal_colors: list[list[float]]
) -> Iterator[Message]:
    """The messages of a frame; start_ns: what t = 0 is in the file."""
    s = run.scenario
    row = frame.row
    state = frame.state
    now = start_ns + round(state.t * NS)
    cameras = {
        "/camera/calibration": s.believed_camera,
        "/truth/camera_calibration": s.camera,
    }
    for topic, camera in cameras.items():
        if (known := calibration(now, camera)) is not None:
            yield topic, now, known
    yield "/camera/image", now, image(now, frame.picture, run.noisy)
    n = len(state.uv)
    true = np.array([[row[f"u_true_{i}"], row[f"v_true_{i}"]] for i in range(n)])
    yield "/camera/markers", now, circles(now, state.uv, [SEEN] * n, SIZES_PX["seen"])
    yield "/camera/goal", now, circles(now, state.goal_uv, goal_colors, SIZES_PX["goal"])
    poses = {"camera": state.T_world_camera, "target": state.T_world_target}
    T_goal = s.goal_pose_at(state.t, int(row.get("view", 0)))
    if T_goal is not None:
        poses["goal"] = state.T_world_target @ inverse(T_goal)
    yield "/truth/markers", now, circles(now, true, [TRUE] * n, SIZES_PX["true"])
    yield "/truth/transforms", now, transforms(now, poses, frame.bodies)
    for topic, (kind, columns) in series.items():
        t = state.t
        if topic in TIMED_BY_COMMAND and math.isfinite(row["t_cmd"]):
            t = row["t_cmd"]
        time_ns = start_ns + round(t * NS)
        made = kind(**{field: row[column] for field, column in columns.items()})
        # its class is of another pool than `Timestamp`
        made.timestamp.seconds, made.timestamp.nanos = divmod(time_ns, NS)
        yield topic, time_ns, made


# Topics of columns: by what stands before the first "_" in their name, and of single ones.
GROUPS = {
    "cmd": "/robot/command",
    "applied": "/robot/applied",
    "act": "/truth/camera_twist",
    "ctrl": "/robot/controls",
    "q": "/truth/joint_positions",
    "qd": "/truth/joint_velocities",
    "depth": "/camera/depths",
}
SINGLE: dict[str, str] = dict.fromkeys(("scale", *LOSS), "/robot/applied")
SINGLE |= dict.fromkeys(("error_px", "error_grey", "lost"), "/camera/error")
SINGLE |= dict.fromkeys(("position_error_m", "rotation_error_rad"), "/truth/error")
OF_KINDS = {"truth": "/truth/state", "own": "/state"}  # by who knows a column of robot or task


def _series(scenario: Scenario, columns: tuple[str, ...]) -> Series:
    """The series of the columns whose values are in no other message."""
    topics: dict[str, dict[str, str]] = {}
    for column in columns:
        unit, whose, _ = meaning(column, scenario)
        before, _, name = column.partition("_")
        if column in SINGLE or column in scenario.own_columns or before == "depth":
            name = column
        if column in SINGLE:
            topic = SINGLE[column]
        elif column in scenario.own_columns:
            topic = OF_KINDS.get(whose, "/robot/state")
        elif before in GROUPS:  # whose topic says what stands before
            topic = GROUPS[before]
        else:
            continue
        topics.setdefault(topic, {})[name_with_unit(name, unit)] = column
    series = {}
    for topic, fields in topics.items():
        name = topic.title().replace("/", "").replace("_", "")
        series[topic] = _message_class(name, list(fields)), fields
    return series


# Foxglove's messages of a frame, in protobuf: rerun reads no other encoding of them, and pictures
# stay binary; and plain time series.
#
# Frames of reference: `world` (z up), `camera` (x right, y down, z forward), `target`, `goal` (of
# the camera), the robot's bodies.
NS = 1_000_000_000
# Where the middle of the first pixel is in annotations, whose origin is the picture's corner; in
# logs and in K it is 0
FIRST_PIXEL = 0.5
SEEN = (1.0, 1.0, 1.0, 1.0)
TRUE = (0.0, 0.0, 0.0, 1.0)
"""Colours (red, green, blue, alpha) of circles round measured and true markers; those at the goal
have the marker's own.
"""
SIZES_PX = {"seen": 14.0, "goal": 20.0, "true": 8.0}


def stamp(time_ns: int) -> Timestamp:
    """A time [ns] as protobuf has it."""
    return Timestamp(seconds=time_ns // NS, nanos=time_ns % NS)


def image(time_ns: int, picture: Image, noisy: bool) -> CompressedImage:
    """A picture: as PNG, without loss; one with noise as JPEG, a seventh of that."""
    data = jpeg_of(picture) if noisy else png_of(picture)
    name = "jpeg" if noisy else "png"
    return CompressedImage(timestamp=stamp(time_ns), frame_id="camera", data=data, format=name)


def calibration(time_ns: int, camera: Camera) -> CameraCalibration | None:
    """Intrinsics K of a camera, with the middle of the first pixel at 0, and its distortion; None
    for a lens without a standard model.
    """
    if (found := as_ros(camera)) is None:
        return None
    K, model, k = found
    return CameraCalibration(
        timestamp=stamp(time_ns),
        frame_id="camera",
        width=camera.width,
        height=camera.height,
        distortion_model="kannala_brandt" if model == "equidistant" else model,
        D=k,
        K=K.ravel(),
        R=np.eye(3).ravel(),
        P=np.column_stack([K, np.zeros(3)]).ravel(),
    )


def circles(
    time_ns: int, uv: Array, colors: Iterable[Sequence[float]], size_px: float
) -> ImageAnnotations:
    """A circle round each pixel uv (N, 2) that is one;
    colors: (red, green, blue, alpha) of each.
    """
    when = stamp(time_ns)
    found = []
    for (u, v), (r, g, b, a) in zip(uv.tolist(), colors, strict=True):
        if math.isfinite(u) and math.isfinite(v):
            found.append(
                CircleAnnotation(
                    timestamp=when,
                    position=Point2(x=u + FIRST_PIXEL, y=v + FIRST_PIXEL),
                    diameter=size_px,
                    thickness=1.5,
                    outline_color=Color(r=r, g=g, b=b, a=a),
                )
            )
    return ImageAnnotations(circles=found)


def transforms(time_ns: int, T_world: dict[str, Array], bodies: Bodies) -> FrameTransforms:
    """Poses (4, 4) in the world by the name of the frame, and those of the scene's bodies that are
    the robot's or a vehicle's.
    """
    when = stamp(time_ns)
    named = [(name, T[:3, 3], quaternion_wxyz(T[:3, :3])) for name, T in T_world.items()]
    of_robots = ("robot/", "leader/")
    named += [body for body in zip(*bodies, strict=True) if body[0].startswith(of_robots)]
    found = [
        FrameTransform(
            timestamp=when,
            parent_frame_id="world",
            child_frame_id=name,
            translation=Vector3(x=x, y=y, z=z),
            rotation=Quaternion(w=qw, x=qx, y=qy, z=qz),
        )
        for name, (x, y, z), (qw, qx, qy, qz) in named
    ]
    return FrameTransforms(transforms=found)


def _message_class(name: str, fields: Sequence[str]) -> Any:
    """The class of protobuf messages `vstestbed.NAME`, with a time stamp and a double for each
    field.
    """
    file = descriptor_pb2.FileDescriptorProto(
        name=f"vstestbed/{name}.proto", package="vstestbed", syntax="proto3"
    )
    file.dependency.append(timestamp_pb2.DESCRIPTOR.name)
    kind = descriptor_pb2.FieldDescriptorProto
    one = kind.LABEL_OPTIONAL
    made = file.message_type.add(name=name)
    made.field.add(
        name="timestamp",
        number=1,
        label=one,
        type=kind.TYPE_MESSAGE,
        type_name=".google.protobuf.Timestamp",
    )
    for number, field in enumerate(fields, start=2):
        made.field.add(name=field, number=number, label=one, type=kind.TYPE_DOUBLE)
    # its own: runs of other robots have messages of the same name
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"vstestbed.{name}"))


def _write(asked: ExportRequest) -> None:
    asked.each(lambda run, path: write_mcap(run, path, asked.start_s, asked.tick), ".mcap")


MCAP = ExportFormat(_write, ".mcap", ("--start",))
