"""Foxglove's messages of a frame, in protobuf: rerun reads no other encoding of them, and pictures stay binary; and plain time series.

Frames of reference: `world` (z up), `camera` (x right, y down, z forward), `target`, `goal` (of the camera), the robot's bodies.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
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

from vstestbed.camera import Camera, Fisheye, Image, Perspective
from vstestbed.core.geometry import Array, quaternion_wxyz
from vstestbed.report.export.source import Bodies
from vstestbed.report.video.encoded import jpeg_of, png_of

NS = 1_000_000_000
FIRST_PIXEL = 0.5
"""Where the middle of the first pixel is in annotations, whose origin is the picture's corner; in logs and in K it is 0."""
LINE_PX = 1.5
SEEN, TRUE = (1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 1.0)
"""Colours (red, green, blue, alpha) of circles round measured and true markers; those at the goal have the marker's own."""
SIZES_PX = {"seen": 14.0, "goal": 20.0, "true": 8.0}


def stamp(time_ns: int) -> Timestamp:
    """A time [ns] as protobuf has it."""
    return Timestamp(seconds=time_ns // NS, nanos=time_ns % NS)


def image(time_ns: int, picture: Image, noisy: bool) -> CompressedImage:
    """A picture: as PNG, without loss; one with noise as JPEG, a seventh of that."""
    encoded, name = (jpeg_of(picture), "jpeg") if noisy else (png_of(picture), "png")
    return CompressedImage(timestamp=stamp(time_ns), frame_id="camera", data=encoded, format=name)


def lens_model(camera: Camera) -> tuple[str, tuple[float, ...]] | None:
    """The standard model of a lens and its coefficients; None for a lens that has none."""
    if isinstance(camera, Perspective):
        return "plumb_bob", camera.distortion or (0.0,) * 5
    if isinstance(camera, Fisheye):
        return "kannala_brandt", camera.coefficients
    return None


def calibration(time_ns: int, camera: Camera) -> CameraCalibration | None:
    """Intrinsics K of a camera, with the middle of the first pixel at 0, and its distortion; None for a lens without a standard model."""
    model = lens_model(camera)
    if model is None:
        return None
    f, (cx, cy) = float(getattr(camera, "f")), camera.centre  # noqa: B009 - both lenses have it, the base class has none
    return CameraCalibration(
        timestamp=stamp(time_ns),
        frame_id="camera",
        width=camera.width,
        height=camera.height,
        distortion_model=model[0],
        D=model[1],
        K=(f, 0, cx, 0, f, cy, 0, 0, 1),
        R=np.eye(3).ravel(),
        P=(f, 0, cx, 0, 0, f, cy, 0, 0, 0, 1, 0),
    )


def circles(time_ns: int, uv: Array, colors: Iterable[Sequence[float]], size_px: float) -> ImageAnnotations:
    """A circle round each pixel uv (N, 2) that is one; colors: (red, green, blue, alpha) of each."""
    when = stamp(time_ns)
    return ImageAnnotations(
        circles=[
            CircleAnnotation(
                timestamp=when,
                position=Point2(x=u + FIRST_PIXEL, y=v + FIRST_PIXEL),
                diameter=size_px,
                thickness=LINE_PX,
                outline_color=Color(r=c[0], g=c[1], b=c[2], a=c[3]),
            )
            for (u, v), c in zip(uv.tolist(), colors, strict=True)
            if math.isfinite(u) and math.isfinite(v)
        ]
    )


def transforms(time_ns: int, T_world: dict[str, Array], bodies: Bodies) -> FrameTransforms:
    """Poses (4, 4) in the world by the name of the frame, and those of the scene's bodies that are the robot's or a vehicle's."""
    when = stamp(time_ns)
    named = [(name, T[:3, 3], quaternion_wxyz(T[:3, :3])) for name, T in T_world.items()]
    named += [body for body in zip(*bodies, strict=True) if body[0].startswith(("robot/", "leader/"))]
    return FrameTransforms(transforms=list(_transforms(when, named)))


def _transforms(when: Timestamp, named: Iterable[tuple[str, Array, Array]]) -> Iterator[FrameTransform]:
    for name, (x, y, z), (qw, qx, qy, qz) in named:
        yield FrameTransform(
            timestamp=when,
            parent_frame_id="world",
            child_frame_id=name,
            translation=Vector3(x=x, y=y, z=z),
            rotation=Quaternion(w=qw, x=qx, y=qy, z=qz),
        )


class TimeSeries:
    """Time series side by side: a message of its own, with a time stamp and a number for each column.

    Args:
        name: of the message. fields: names of its numbers, which end with their units. columns: of the log, one for each.
    """

    def __init__(self, name: str, fields: Sequence[str], columns: Sequence[str]):
        self._fields, self._columns = tuple(fields), tuple(columns)
        self._message = _message_class(name, self._fields)

    def message(self, time_ns: int, row: dict[str, float]) -> Any:
        """The numbers of a row of the log."""
        made = self._message(**{field: row[column] for field, column in zip(self._fields, self._columns, strict=True)})
        made.timestamp.seconds, made.timestamp.nanos = divmod(time_ns, NS)  # its class is of another pool than `Timestamp`
        return made


def _message_class(name: str, fields: Sequence[str]) -> Any:
    """The class of protobuf messages `vstestbed.NAME`, with a time stamp and a double for each field."""
    file = descriptor_pb2.FileDescriptorProto(name=f"vstestbed/{name}.proto", package="vstestbed", syntax="proto3")
    file.dependency.append(timestamp_pb2.DESCRIPTOR.name)
    kind, one = descriptor_pb2.FieldDescriptorProto, descriptor_pb2.FieldDescriptorProto.LABEL_OPTIONAL
    made = file.message_type.add(name=name)
    made.field.add(name="timestamp", number=1, label=one, type=kind.TYPE_MESSAGE, type_name=".google.protobuf.Timestamp")
    for number, field in enumerate(fields, start=2):
        made.field.add(name=field, number=number, label=one, type=kind.TYPE_DOUBLE)
    pool = descriptor_pool.DescriptorPool()  # its own: runs of other robots have messages of the same name
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"vstestbed.{name}"))
