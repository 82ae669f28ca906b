"""ROS 2 messages and what they are here: pictures, calibrations, readings, twists, poses; in CDR by
rosbags, which needs no ROS.

Frames follow REP 103 and 105: `world`, `base_link` (of a vehicle or a craft) or `flange` (of an
arm), `camera_optical_frame` (x right, y down, z forward). Units are SI. Joints go by their names,
whatever their order.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from vstestbed.camera import Camera, DepthImage, Image
from vstestbed.camera.intrinsics import as_ros
from vstestbed.core.errors import EnvironmentLackError, ParameterError, short
from vstestbed.core.foreign import foreign
from vstestbed.core.geometry import (
    Array,
    quaternion_wxyz,
    rotation_from_quaternion,
    rotation_from_rpy,
    rpy_of,
)
from vstestbed.core.lazy import MOST_PIXELS
from vstestbed.robots import Reading, Robot
from vstestbed.robots.flight import RECOVER_RAD, FlightEstimate, FlightReading
from vstestbed.targets.picture import whole

try:
    from rosbags.serde import SerdeError
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

except ImportError as error:
    raise EnvironmentLackError(
        f"ROS messages need {error.name}, which is not installed", "pip install 'vstestbed[ros]'"
    ) from error

NS = 1_000_000_000
OPTICAL = "camera_optical_frame"
WORLD = "world"
IMAGE = "sensor_msgs/msg/Image"
INFO = "sensor_msgs/msg/CameraInfo"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
JOINTS = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"
ODOMETRY = "nav_msgs/msg/Odometry"
RANGE = "sensor_msgs/msg/Range"
TWIST = "geometry_msgs/msg/TwistStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
CLOCK = "rosgraph_msgs/msg/Clock"
TEXT = "std_msgs/msg/String"
POSE = "geometry_msgs/msg/PoseStamped"
TRIGGER = "std_srvs/srv/Trigger"

# of one of rosbags' message classes: a dataclass whose fields are those of the ROS message
Message = Any


@cache
def types() -> Any:
    """The messages of ROS 2 Jazzy, of which Humble's differ in Range alone (`variance`), and those
    of the service Trigger.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    for kind, fields in (
        ("std_srvs/msg/Trigger_Request", "uint8 structure_needs_at_least_one_member\n"),
        ("std_srvs/msg/Trigger_Response", "bool success\nstring message\n"),
    ):
        store.register(get_types_from_msg(fields, kind))
    return store


@cache
def _humble() -> Any:
    return get_typestore(Stores.ROS2_HUMBLE)


def made(kind: str, **fields: Any) -> Message:
    """A message of a kind, `sensor_msgs/msg/Image`."""
    return types().types[kind](**fields)


def to_cdr(message: Message) -> bytes:
    """A message as it is sent."""
    return bytes(types().serialize_cdr(message, message.__msgtype__))


def from_cdr(data: bytes, kind: str) -> Message:
    """The message of what was received; of a range also one of Humble, which has a field less.
    ParameterError: it is none of that kind.
    """
    with foreign("message", f"the CDR of {kind}"):
        try:
            return types().deserialize_cdr(data, kind)
        except SerdeError:
            if kind != RANGE:
                raise
            return _humble().deserialize_cdr(data, kind)


def stamp(t: float) -> Message:
    """A time [s] as ROS has it."""
    seconds, nanoseconds = divmod(round(t * NS), NS)
    return made("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)


def time_of(message: Message) -> float:
    """When a message was stamped [s]."""
    at = message.header.stamp
    return at.sec + at.nanosec / NS


def header(t: float, frame: str) -> Message:
    """A header of a time [s] and a frame."""
    return made("std_msgs/msg/Header", stamp=stamp(t), frame_id=frame)


def clock(t: float) -> Message:
    """The simulated time [s]."""
    return made(CLOCK, clock=stamp(t))


def text(words: str) -> Message:
    """A text."""
    return made(TEXT, data=words)


HELPS = {
    "image": "--remap image_raw=/TOPIC names another topic",
    "picture": "--set camera.width=W --set camera.height=H fits the scenario to it",
    "readings": "--remap joint_states=/TOPIC names another topic",
    "joint_states": "--remap joint_states=/TOPIC names another topic",
    "depth": "--remap depth=/TOPIC names another topic",
}
"""What helps, by what an element that cannot be used is wrong in."""


class PassedOver:
    """Elements that could not be used, by topic and by what is wrong in them: how many, when the
    first and the last, and why.
    """

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], tuple[int, float, float, str]] = {}

    def note(self, topic: str, t: float, why: ParameterError) -> None:
        """Count an element of a time [s]."""
        kind = re.split(r"\W", why.field)[0]
        count, first, _, words = self._found.get((topic, kind), (0, t, t, str(why)))
        self._found[topic, kind] = count + 1, first, t, words

    def lost(self, path: Path, t: float, why: Exception) -> None:
        """Count a part of a bag that cannot be read, after a time [s]."""
        self.note(path.name, t, ParameterError("part", f"of the bag is lost: {why}"))

    def rows(self) -> list[list[str]]:
        """Topic, number, time of the first and the last [s], why, and what helps."""
        return [
            [topic, str(count), f"{first:.3f}", f"{last:.3f}", words, HELPS.get(kind, "")]
            for (topic, kind), (count, first, last, words) in self._found.items()
        ]

    def lines(self) -> list[str]:
        """The same in sentences."""
        return [
            f"{topic}: {count} told or passed over, the first of {first} s, the last of {last} s:"
            f" {words}{helps and '; '}{helps}"
            for topic, count, first, last, words, helps in self.rows()
        ]


# Pictures.
def image(t: float, picture: Image) -> Message:
    """A picture (H, W, 3), RGB."""
    return _image(t, picture, "rgb8")


def depth_image(t: float, depth: DepthImage) -> Message:
    """A depth picture (H, W) [m]."""
    return _image(t, depth.astype(np.float32, copy=False), "32FC1")


def _image(t: float, pixels: Image | DepthImage, encoding: str) -> Message:
    height, width = pixels.shape[:2]
    data = np.ascontiguousarray(pixels).view(np.uint8).reshape(-1)
    return made(
        IMAGE,
        header=header(t, OPTICAL),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=data.size // height,
        data=data,
    )


CHANNELS = {
    "rgb8": [0, 1, 2],
    "bgr8": [2, 1, 0],
    "rgba8": [0, 1, 2],
    "bgra8": [2, 1, 0],
    "mono8": [0, 0, 0],
    "8UC1": [0, 0, 0],
    "8UC3": [2, 1, 0],
}
"""Where red, green and blue stand in a pixel of each encoding."""
WIDTHS = {"rgba8": 4, "bgra8": 4, "mono8": 1, "8UC1": 1}
DEPTHS = {
    "16UC1": (np.dtype(np.uint16), 1e-3),
    "mono16": (np.dtype(np.uint16), 1e-3),
    "32FC1": (np.dtype(np.float32), 1.0),
}
"""Numbers of each encoding of depths, and their unit [m]: REP 118."""


def picture_of(message: Message) -> Image:
    """The picture (H, W, 3), RGB, of an Image or a CompressedImage. ParameterError: an encoding
    that is not read, or too few bytes.
    """
    if message.__msgtype__ == COMPRESSED:
        from vstestbed.core.lazy import cv2, quiet

        raw = np.asarray(message.data, np.uint8)
        with foreign("image", "JPEG or PNG"), quiet():
            found = cv2.imdecode(raw, cv2.IMREAD_COLOR) if whole(raw) else None
        if found is None:
            raise ParameterError(
                "image", "is compressed, and neither JPEG nor PNG, or broken", short(message.format)
            )
        return np.ascontiguousarray(np.asarray(found, np.uint8)[..., ::-1])
    if message.encoding not in CHANNELS:
        raise ParameterError.choice("image.encoding", CHANNELS, message.encoding)
    rows = _rows(message, np.dtype(np.uint8), WIDTHS.get(message.encoding, 3))
    return np.ascontiguousarray(rows[..., CHANNELS[message.encoding]])


def depth_of(message: Message) -> DepthImage:
    """The depths (H, W) [m] of an Image. ParameterError: as `picture_of`."""
    if message.encoding not in DEPTHS:
        raise ParameterError.choice("depth.encoding", DEPTHS, message.encoding)
    kind, unit = DEPTHS[message.encoding]
    rows = _rows(message, kind, 1)[..., 0]
    depths = (rows * np.float32(unit)).astype(np.float32)
    if kind.kind == "u":
        depths[rows == 65535] = np.nan  # the largest of 16 bits: as far or farther
    return depths


def _rows(message: Message, kind: np.dtype[Any], channels: int) -> Any:
    """The numbers (H, W, channels) of an Image, without what stands between its rows."""
    height = message.height
    width = message.width
    if not 0 < height * width <= MOST_PIXELS:
        raise ParameterError(
            "image", f"must have between 1 and {MOST_PIXELS} pixels", f"{width} x {height}"
        )
    used = width * channels * kind.itemsize
    data = np.asarray(message.data, np.uint8)
    step = message.step or used
    if step < used or data.size < step * height:
        words = (
            f"has {data.size} bytes in rows of {step};"
            f" {width} x {height} pixels of {message.encoding} are {used * height}"
        )
        raise ParameterError("image", words)
    rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :used]).view(kind)
    if message.is_bigendian:
        rows = rows.byteswap()  # of single bytes it changes nothing
    return rows.reshape(height, width, channels)


def camera_info(t: float, camera: Camera) -> Message | None:
    """The calibration of a camera; None of a lens that ROS has no model of."""
    lens = as_ros(camera)
    if lens is None:
        return None
    K, model, k = lens
    region = made(
        "sensor_msgs/msg/RegionOfInterest",
        x_offset=0,
        y_offset=0,
        height=0,
        width=0,
        do_rectify=False,
    )
    return made(
        INFO,
        header=header(t, OPTICAL),
        height=camera.height,
        width=camera.width,
        distortion_model=model,
        d=np.array(k, dtype=float),
        k=K.ravel(),
        r=np.eye(3).ravel(),
        p=np.column_stack([K, np.zeros(3)]).ravel(),
        binning_x=0,
        binning_y=0,
        roi=region,
    )


# Twists and poses.
def vector(v: Sequence[float] | Array) -> Message:
    """Three numbers."""
    x, y, z = (float(a) for a in v)
    return made("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def three(v: Message) -> list[float]:
    """The numbers of a vector or a point."""
    return [v.x, v.y, v.z]


def quaternion(R: Array) -> Message:
    """A rotation (3, 3)."""
    w, x, y, z = (float(q) for q in quaternion_wxyz(R))
    return made("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def twist(t: float, v: Array, frame: str) -> Message:
    """A twist (6,) [m/s, rad/s] in a frame."""
    numbers = made("geometry_msgs/msg/Twist", linear=vector(v[:3]), angular=vector(v[3:]))
    return made(TWIST, header=header(t, frame), twist=numbers)


def twist_of(message: Message) -> Array:
    """The twist (6,) of a message; ParameterError where a number is not finite."""
    v = np.array([*three(message.twist.linear), *three(message.twist.angular)])
    if not np.isfinite(v).all():
        raise ParameterError.infinite("twist", v)
    return v


def transforms(t: float, poses: Mapping[tuple[str, str], Array]) -> Message:
    """Poses (4, 4) by the names of the frame in which they are and of that whose they are."""
    found: list[Message] = []
    for (parent, child), T in poses.items():
        way = made(
            "geometry_msgs/msg/Transform",
            translation=vector(T[:3, 3]),
            rotation=quaternion(T[:3, :3]),
        )
        found.append(
            made(
                "geometry_msgs/msg/TransformStamped",
                header=header(t, parent),
                child_frame_id=child,
                transform=way,
            )
        )
    return made(TRANSFORMS, transforms=found)


def pose(t: float, T: Array, frame: str = WORLD) -> Message:
    """A pose (4, 4) in a frame."""
    x, y, z = T[:3, 3].tolist()
    at = made("geometry_msgs/msg/Point", x=x, y=y, z=z)
    return made(
        POSE,
        header=header(t, frame),
        pose=made("geometry_msgs/msg/Pose", position=at, orientation=quaternion(T[:3, :3])),
    )


# Readings of a robot's sensors.
def check_single(camera: Camera) -> None:
    """Refuse a camera whose pictures are no one image; ParameterError."""
    if len(camera.panels) > 1:
        words = (
            f"has {len(camera.panels)} pictures at once, and a topic has one; works: perspective,"
            " fisheye or catadioptric"
        )
        raise ParameterError("camera", words)


def body_frame(robot: Robot) -> str:
    """The frame in which the camera is mounted."""
    return "flange" if robot.base == "fixed" else "base_link"


def sensors_of(robot: Robot) -> dict[str, str]:
    """The topics of a robot's readings, each with its kind of message."""
    topics = {"joint_states": JOINTS} if robot.joints else {}
    if robot.base != "fixed":
        topics["imu"] = IMU
    if robot.base == "floating":
        topics |= {"odom": ODOMETRY, "range": RANGE}
    return topics


# by so much the norm of an attitude's quaternion may differ from 1: of one that was rounded, it is
# far less
UNIT = 0.1
UNKNOWN = np.zeros(36)
# a covariance that begins with -1: there is no such measurement
NONE = np.array([-1.0, *[0.0] * 8])


def joint_state(t: float, names: Sequence[str], q: Array, qd: Array) -> Message:
    """Positions and velocities (n,) [rad, m] of joints, in arrays of its own."""
    return made(
        JOINTS,
        header=header(t, ""),
        name=list(names),
        position=np.array(q, dtype=float),
        velocity=np.array(qd, dtype=float),
        effort=np.zeros(0),
    )


def readings(t: float, robot: Robot, reading: Reading) -> dict[str, Message]:
    """A reading [rad, m, s] as messages by topic: joints; of a vehicle or a craft its attitude; of
    a craft its velocity and its height.
    """
    found: dict[str, Message] = {}
    if robot.joints:
        found["joint_states"] = joint_state(t, robot.joints, reading.q, reading.qd)
    if robot.base == "fixed":
        return found
    known = reading.heading is not None or reading.tilt is not None
    roll, pitch = (0.0, 0.0) if reading.tilt is None else reading.tilt
    R = rotation_from_rpy(np.array([roll, pitch, reading.heading or 0.0]))
    imu = found["imu"] = made(
        IMU,
        header=header(t, "base_link"),
        orientation=quaternion(R),
        orientation_covariance=np.zeros(9) if known else NONE,
        angular_velocity=vector(np.zeros(3)),
        angular_velocity_covariance=NONE,
        linear_acceleration=vector(np.zeros(3)),
        linear_acceleration_covariance=NONE,
    )
    if isinstance(reading, FlightReading):
        imu.angular_velocity = vector(reading.estimate.rates)
        imu.angular_velocity_covariance = np.zeros(9)
        moved = made(
            "geometry_msgs/msg/Twist",
            linear=vector(reading.estimate.velocity),
            angular=vector(reading.estimate.rates),
        )
        at = made(
            "geometry_msgs/msg/Pose",
            position=made("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0),
            orientation=quaternion(R),
        )
        found["odom"] = made(
            ODOMETRY,
            header=header(t, "odom"),
            child_frame_id="base_link",
            pose=made("geometry_msgs/msg/PoseWithCovariance", pose=at, covariance=UNKNOWN),
            twist=made("geometry_msgs/msg/TwistWithCovariance", twist=moved, covariance=UNKNOWN),
        )
        found["range"] = made(
            RANGE,
            header=header(t, "base_link"),
            radiation_type=1,
            field_of_view=0.0,
            min_range=0.0,
            max_range=math.inf,
            range=reading.range_m,
            variance=0.0,
        )
    return found


def reading_of(robot: Robot, found: Mapping[str, Message]) -> Reading:
    """The reading that messages by topic tell. ParameterError: a topic or a joint is missing."""
    missing = [
        f"{topic} ({kind})" for topic, kind in sensors_of(robot).items() if topic not in found
    ]
    if missing:
        words = ", ".join(sorted(missing))
        raise ParameterError("readings", f"need {words}, of which nothing was heard")
    q = qd = np.zeros(0)
    if robot.joints:
        q, qd = joints_of(found["joint_states"], robot.joints)
    if robot.base == "fixed":
        return Reading(q, qd)
    imu = found["imu"]
    numbers = _four(imu.orientation)
    R = rotation_from_quaternion(np.array(numbers) / (math.hypot(*numbers) or 1.0))
    roll, pitch, heading = np.radians(rpy_of(R.tolist())).tolist()
    if not _oriented(imu):
        heading = None
    if robot.base == "planar":
        return Reading(q, qd, heading)
    tilt = np.array([roll, pitch])
    rates = np.array(three(imu.angular_velocity))
    velocity = np.array(three(found["odom"].twist.twist.linear))
    recovers = bool(R[2, 2] < math.cos(RECOVER_RAD))
    # Of the flight loops' own state these messages tell nothing: their references are what the
    # craft does.
    estimate = FlightEstimate(velocity, rates, tilt, rates, 0.0, recovers, False)
    range_m = float(found["range"].range)
    return FlightReading(q, qd, heading, tilt, range_m=range_m, estimate=estimate)


def _four(o: Message) -> list[float]:
    """The numbers of a quaternion, w first."""
    return [o.w, o.x, o.y, o.z]


def _oriented(imu: Message) -> bool:
    """Whether an IMU tells its attitude."""
    return imu.orientation_covariance[0] >= 0


def check_finite(topic: str, message: Message) -> None:
    """Refuse a message of an IMU, an odometry or a range with a number that is none;
    ParameterError. A range is infinite over nothing.
    """
    attitude: list[float] = []
    numbers: list[float] = []
    if topic == "imu":
        if _oriented(message):
            attitude = _four(message.orientation)
        if message.angular_velocity_covariance[0] >= 0:
            numbers = three(message.angular_velocity)
    elif topic == "odom":
        numbers = three(message.twist.twist.linear)
    else:
        numbers = [math.atan(message.range)]
    numbers = attitude + numbers
    if not np.isfinite(numbers).all():
        raise ParameterError.infinite(topic, numbers)
    if attitude and abs(math.hypot(*attitude) - 1.0) > UNIT:
        words = (
            "is no unit quaternion;"
            " a driver without an attitude sets the first number of its covariance to -1"
        )
        raise ParameterError("imu.orientation", words, attitude)


def joints_of(message: Message, names: Sequence[str]) -> tuple[Array, Array]:
    """Positions and velocities (n,) [rad, m] of joints by their names; velocities that are not told
    are NaN. ParameterError: one is not in the message, or twice, or has no position, or none that
    is finite; velocities are those of some joints alone.
    """
    _check_joints(message, names)
    there = {name: i for i, name in enumerate(message.name)}
    order = [there[name] for name in names]
    q = np.asarray(message.position, dtype=float)[order]
    if not np.isfinite(q).all():
        raise ParameterError.infinite("joint_states", q.tolist())
    if not len(message.velocity):
        return q, np.full(len(order), np.nan)
    return q, np.asarray(message.velocity, dtype=float)[order]


def _check_joints(message: Message, names: Sequence[str]) -> None:
    """Refuse joints that a message does not tell once each, and numbers of some of them alone."""
    told = list(message.name)
    q = len(message.position)
    qd = len(message.velocity)
    if missing := [name for name in names if name not in told]:
        words = (
            f"have no {', '.join(missing)};"
            f" this robot's joints are {', '.join(names)}, in any order, with others or without"
        )
        raise ParameterError("joint_states", words, told)
    if twice := [name for name in names if told.count(name) > 1]:
        raise ParameterError("joint_states", f"have {', '.join(twice)} more than once")
    if q != len(told):
        raise ParameterError("joint_states", f"have {q} positions of {len(told)} joints")
    if qd not in (0, q):
        raise ParameterError(
            "joint_states", f"have {qd} velocities of {q} joints; valid: all or none"
        )
