"""Bags as others fill them, and ways in which they are broken."""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import yaml
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

import vstestbed as vs

STORE = get_typestore(Stores.ROS2_HUMBLE)
KINDS = STORE.types
GIVEN = {"stop.duration_s": 0.3, "camera.width": 320, "camera.height": 240}
NAMES = ["finger", "joint_6", "joint_5", "joint_4", "joint_3", "joint_2", "joint_1"]
BEGAN = 1000.0  # when the recording begins [s]


class Taken(NamedTuple):
    """A picture of a flight, with its time, the joints, and the law's twist."""

    t: float
    picture: Any
    q: Any
    v: Any


def scenario() -> vs.Scenario:
    """A short flight with small pictures."""
    return vs.load("arm_ibvs", GIVEN)


def flown() -> list[Taken]:
    """What a camera and a robot saw of it."""
    taken = []
    with vs.Session(scenario(), pictures=True) as session:
        frame = session.reset()
        while frame.outcome is None:
            assert frame.image is not None
            taken.append(Taken(frame.t, frame.image.copy(), frame.truth.q, frame.command.twist))
            frame = session.step()
    return taken


def header(t: float, frame: str = "x") -> Any:
    return KINDS["std_msgs/msg/Header"](
        stamp=KINDS["builtin_interfaces/msg/Time"](sec=int(t), nanosec=round(t % 1 * 1e9)),
        frame_id=frame,
    )


def image(t: float, picture: Any, **other: Any) -> Any:
    h, w = picture.shape[:2]
    data = np.ascontiguousarray(picture[..., ::-1]).reshape(-1)
    told = {
        "height": h,
        "width": w,
        "encoding": "bgr8",
        "is_bigendian": 0,
        "step": 3 * w,
        "data": data,
    }
    return KINDS["sensor_msgs/msg/Image"](header=header(t), **{**told, **other})


def compressed(t: float, picture: Any, **other: Any) -> Any:
    data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))[1].ravel()
    told = {"format": "bgr8; png compressed bgr8", "data": data}
    return KINDS["sensor_msgs/msg/CompressedImage"](header=header(t), **{**told, **other})


def joints(t: float, q: Any, **other: Any) -> Any:
    told = {
        "name": NAMES,
        "position": np.array([9.0, *q[::-1]]),
        "velocity": np.zeros(0),
        "effort": np.zeros(0),
    }
    return KINDS["sensor_msgs/msg/JointState"](header=header(t), **{**told, **other})


def twist(t: float, v: Any) -> Any:
    vector = KINDS["geometry_msgs/msg/Vector3"]
    told = KINDS["geometry_msgs/msg/Twist"](
        linear=vector(*map(float, v[:3])), angular=vector(*map(float, v[3:]))
    )
    return KINDS["geometry_msgs/msg/TwistStamped"](header=header(t), twist=told)


Put = tuple[str, float, Any]  # topic, time of receipt [s], message


def usual(taken: list[Taken], pictures: Callable[..., Any] = image) -> list[Put]:
    """The messages of a flight: three readings about each picture, the picture, and the twist that
    answers it.
    """
    put: list[Put] = []
    for one in taken:
        t = BEGAN + one.t
        put += [("/joint_states", t + 0.01 * k, joints(t + 0.01 * k, one.q)) for k in (-1, 0, 1)]
        put += [("/cam/color", t, pictures(t, one.picture)), ("/cmd", t + 0.012, twist(t, one.v))]
    return put


def written(
    path: Path,
    put: list[Put],
    plugin: StoragePlugin = StoragePlugin.MCAP,
    mode: CompressionMode = CompressionMode.NONE,
) -> Path:
    """A bag of messages by rosbags' own writer.
    Raw bytes are taken as they are, as (kind, bytes).
    """
    with_mode = Writer(path, version=9, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        with_mode.set_compression(mode, CompressionFormat.ZSTD)
    with with_mode as bag:
        to: dict[str, Any] = {}
        for topic, t, message in put:
            kind = message[0] if isinstance(message, tuple) else message.__msgtype__
            data = message[1] if isinstance(message, tuple) else STORE.serialize_cdr(message, kind)
            if topic not in to:
                to[topic] = bag.add_connection(topic, kind, typestore=STORE)
            bag.write(to[topic], round(t * 1e9), bytes(data))
    return path


# Ways in which a bag is broken. Each takes a random generator and the folder of a copy.
Break = Callable[[np.random.Generator, Path], None]


def data_file(rng: np.random.Generator, bag: Path) -> Path:
    files = sorted(p for p in bag.iterdir() if p.suffix in (".mcap", ".db3", ".zstd"))
    return files[rng.integers(len(files))]


def any_file(rng: np.random.Generator, bag: Path) -> Path:
    files = sorted(bag.iterdir())
    return files[rng.integers(len(files))]


def flip(rng: np.random.Generator, bag: Path) -> None:
    file = any_file(rng, bag)
    raw = bytearray(file.read_bytes())
    for _ in range(rng.integers(1, 40)):
        raw[rng.integers(len(raw))] = rng.integers(256)
    file.write_bytes(raw)


def flip_near_the_ends(rng: np.random.Generator, bag: Path) -> None:
    file = data_file(rng, bag)
    raw = bytearray(file.read_bytes())
    for _ in range(rng.integers(1, 12)):
        at = int(rng.integers(min(600, len(raw))))
        raw[at if rng.random() < 0.5 else -1 - at] = rng.integers(256)
    file.write_bytes(raw)


def lengthen(rng: np.random.Generator, bag: Path) -> None:
    """Somewhere eight bytes become a huge length."""
    file = data_file(rng, bag)
    raw = bytearray(file.read_bytes())
    at = int(rng.integers(max(1, len(raw) - 8)))
    raw[at : at + 8] = int(rng.choice([2**31, 2**32 - 1, 2**40, 2**63 - 1])).to_bytes(8, "little")
    file.write_bytes(raw)


def cut(rng: np.random.Generator, bag: Path) -> None:
    file = any_file(rng, bag)
    raw = file.read_bytes()
    file.write_bytes(raw[: rng.integers(len(raw))])


def cut_out(rng: np.random.Generator, bag: Path) -> None:
    file = data_file(rng, bag)
    raw = file.read_bytes()
    at, end = sorted(int(i) for i in rng.integers(len(raw), size=2))
    file.write_bytes(raw[:at] + raw[end:])


def double(rng: np.random.Generator, bag: Path) -> None:
    file = data_file(rng, bag)
    raw = file.read_bytes()
    at, end = sorted(int(i) for i in rng.integers(len(raw), size=2))
    file.write_bytes(raw[:end] + raw[at:])


STRANGE = [
    None,
    -1,
    2**70,
    "",
    "x",
    [],
    {},
    1e308,
    float("nan"),
    True,
    "../../etc/passwd",
    ["a"],
    {"nanoseconds": -5},
]


def metadata(rng: np.random.Generator, bag: Path) -> None:
    """A key of metadata.yaml is dropped, or has another value."""
    file = bag / "metadata.yaml"
    if not file.exists():
        return flip(rng, bag)
    whole = yaml.safe_load(file.read_text())
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key, value in (
            node.items()
            if isinstance(node, dict)
            else enumerate(node)
            if isinstance(node, list)
            else ()
        ):
            places.append((node, key))
            walk(value)

    walk(whole)
    node, key = places[rng.integers(len(places))]
    if rng.random() < 0.4:
        del node[key]
    else:
        node[key] = STRANGE[rng.integers(len(STRANGE))]
    file.write_text(yaml.safe_dump(whole))
    return None


def swap_types(rng: np.random.Generator, bag: Path) -> None:
    """Topics are said to be of another type, in metadata and in the file."""
    names = [
        b"sensor_msgs/msg/Image",
        b"sensor_msgs/msg/JointState",
        b"geometry_msgs/msg/TwistStamped",
        b"no_such_msgs/msg/A",
    ]
    a, b = (names[i] for i in rng.choice(len(names), 2, replace=False))
    for file in bag.iterdir():
        raw = file.read_bytes()
        if len(a) >= len(b) or file.suffix == ".yaml":
            file.write_bytes(raw.replace(a, b if file.suffix == ".yaml" else b.ljust(len(a), b"X")))


def other_kind(rng: np.random.Generator, bag: Path) -> None:
    """A file is a pipe, a folder, a link to nothing, to itself, to a device, or empty."""
    file = any_file(rng, bag)
    file.unlink()
    how = rng.integers(6)
    if how == 0:
        os.mkfifo(file)
    elif how == 1:
        file.mkdir()
    elif how == 5:
        file.touch()
    else:
        file.symlink_to(["/nowhere", file.name, "/dev/zero"][how - 2])


def rows(rng: np.random.Generator, bag: Path) -> None:
    """Rows of a database change their types, times, topics, or vanish."""
    file = data_file(rng, bag)
    if file.suffix != ".db3":
        return flip(rng, bag)
    changes = [
        "UPDATE messages SET timestamp = 'noon' WHERE id % 5 = 1",
        "UPDATE messages SET timestamp = 0",
        "UPDATE messages SET timestamp = -timestamp",
        "UPDATE messages SET data = '' WHERE id % 7 = 2",
        "UPDATE messages SET data = 'text' WHERE id % 7 = 2",
        "UPDATE messages SET data = zeroblob(5000000) WHERE id % 7 = 2",
        "UPDATE messages SET topic_id = 99",
        "DELETE FROM messages",
        "DELETE FROM topics WHERE id = 1",
        "UPDATE topics SET name = ''",
        "UPDATE topics SET type = 7",
        "UPDATE topics SET serialization_format = 'json'",
        "UPDATE topics SET offered_qos_profiles = '[[[['",
        "UPDATE message_definitions SET encoding = 'klingon'",
        "UPDATE message_definitions SET encoded_message_definition = 'float64 ['",
        "UPDATE schema SET schema_version = 99",
        "DROP TABLE messages",
        "DROP TABLE schema",
        "DROP TABLE message_definitions",
    ]
    with sqlite3.connect(file) as base:
        base.execute(changes[rng.integers(len(changes))])
    base.close()
    return None


BREAKS: list[Break] = [
    flip,
    flip_near_the_ends,
    lengthen,
    cut,
    cut_out,
    double,
    metadata,
    swap_types,
    other_kind,
    rows,
]


def broken_message(rng: np.random.Generator, put: list[Put]) -> list[Put]:
    """Some messages of a valid bag are such as broken drivers tell."""
    put = list(put)
    topics = ["/cam/color", "/joint_states", "/cmd"]
    topic = topics[rng.integers(3)]
    every = [i for i, one in enumerate(put) if one[0] == topic]
    those = (
        every
        if rng.random() < 0.3
        else [every[i] for i in rng.integers(len(every), size=rng.integers(1, 4))]
    )
    how = rng.integers(8)
    for i in dict.fromkeys(those):
        _, t, message = put[i]
        kind = message.__msgtype__
        raw = bytearray(STORE.serialize_cdr(message, kind))
        if how == 0:
            raw = raw[: rng.integers(len(raw))]
        elif how == 1:
            for _ in range(30):
                raw[rng.integers(min(len(raw), 120))] = rng.integers(256)
        elif how == 2:
            at = int(rng.integers(4, min(len(raw), 100) - 4))
            raw[at : at + 4] = b"\xff\xff\xff\x7f"
        elif how == 3:
            message.header.stamp.sec = int(rng.choice([0, 1, 2**31 - 1, -(2**31)]))
            raw = STORE.serialize_cdr(message, kind)
        elif how == 4:
            message.header.stamp.sec, message.header.stamp.nanosec = 0, 0
            raw = STORE.serialize_cdr(message, kind)
        elif how == 5:
            t = float(rng.choice([0.0, t - 5, t + 1e6]))
        elif how == 6 and topic == "/joint_states":
            message.position = (
                np.array([np.nan] * 7) if rng.random() < 0.5 else np.zeros(rng.integers(7))
            )
            raw = STORE.serialize_cdr(message, kind)
        elif how == 6 and topic == "/cam/color":
            name, value = [
                ("encoding", "bayer_rggb8"),
                ("encoding", "16UC1"),
                ("step", 1),
                ("height", 100_000),
                ("width", 0),
            ][rng.integers(5)]
            if hasattr(message, name):
                setattr(message, name, value)
            raw = STORE.serialize_cdr(message, kind)
        else:
            raw = bytearray(
                rng.integers(256, size=int(rng.integers(3000)), dtype=np.uint8).tobytes()
            )
        put[i] = (topic, t, (kind, bytes(raw)))
    return put


def copied(bag: Path, to: Path) -> Path:
    shutil.copytree(bag, to) if bag.is_dir() else shutil.copy(bag, to)
    return to
