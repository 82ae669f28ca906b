"""Bags of others, element by element: what is broken is passed over and counted, and nothing
unpacks without a bound.
"""

from __future__ import annotations

import importlib
import itertools
import math
import shutil
import struct
import tempfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO, NamedTuple

import apsw
from lz4.frame import LZ4FrameDecompressor
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import parse_qos

from vstestbed.apps.ros.messages import NS, Message, PassedOver, from_cdr, stamp, time_of
from vstestbed.core.errors import EnvironmentLackError, ParameterError, RunFolderError
from vstestbed.core.foreign import foreign, plain_file

WORKS = (
    "a folder of rosbag2, or its MCAP or .db3 file;"
    " `mcap recover FILE -o OUT`, or `sqlite3 FILE.db3 .recover`, mends one that was cut off,"
    " `ros2 bag reindex` a folder, `rosbags-convert` makes one of ROS 1"
)
MOST_BAG = 1 << 36  # bytes of a bag's file
MOST_METADATA = 1 << 19  # bytes of its metadata.yaml
LONGEST_QOS = 1000  # characters that tell how a topic is transmitted
MOST_UNPACKED = 1 << 27  # bytes of an unpacked chunk or message, which is in memory as a whole
LOOKED_AT = 2000  # messages in which stamps that stand still are looked for
# Whose bounds are set here: neither library has any of its own.
folders: Any = importlib.import_module("rosbags.rosbag2.reader")
mcap: Any = importlib.import_module("rosbags.rosbag2.storage_mcap")
sqlite: Any = importlib.import_module("rosbags.rosbag2.storage_sqlite3")
zstd = mcap.zstd  # Python's own, or its backport


def refusal(path: object, why: str, works: str) -> RunFolderError:
    """The error of a bag that cannot be read."""
    return RunFolderError(path, f"cannot be read ({why})", works)


@contextmanager
def of_bag(path: Path) -> Iterator[None]:
    """Turn what a library raises of a bag into RunFolderError: also for want of memory, of which a
    broken length asks any amount.
    """
    try:
        with foreign(path, WORKS, refusal):
            yield
    except EnvironmentLackError as error:
        raise refusal(path, error.lack, WORKS) from error


# Of some kilobytes a bomb unpacks to more than a memory or a disk holds, and rosbags and mcap
# unpack whatever there is.
class _Unpacked(zstd.ZstdFile):
    """A packed file that unpacks to at most half of what is free where rosbags puts it."""

    def read(self, size: int | None = -1) -> bytes:
        if self.tell() > shutil.disk_usage(tempfile.gettempdir()).free // 2:
            raise ValueError("it unpacks to more than half of the free space for temporary files")
        return super().read(size)


def _unpacked(data: bytes, decompressor: Any) -> bytes:
    found: bytes = decompressor.decompress(data, MOST_UNPACKED)
    if not decompressor.eof:
        raise ValueError(f"a part is cut off, or unpacks to more than {MOST_UNPACKED >> 20} MiB")
    return found


def of_zstd(data: bytes, _size: int = 0) -> bytes:
    """What was packed by zstd. ValueError: it is cut off, or more than MOST_UNPACKED."""
    return _unpacked(data, zstd.ZstdDecompressor())


def of_lz4(data: bytes, _size: int = 0) -> bytes:
    """What was packed by LZ4; errors as of `of_zstd`."""
    return _unpacked(data, LZ4FrameDecompressor())


def _open(file: BinaryIO, _mode: str) -> _Unpacked:
    return _Unpacked(file)


def _bounded(connection: Any) -> None:
    """Of a database tables alone are read, and no row that it would make up without a bound."""
    connection.limit(apsw.SQLITE_LIMIT_LENGTH, MOST_UNPACKED)
    connection.config(apsw.SQLITE_DBCONFIG_ENABLE_VIEW, 0)


def _qos(told: Any) -> Any:
    """What rosbags makes of a topic's quality of service: nothing of a text that is broken, or so
    long that it could take hours.
    """
    with suppress(Exception):  # whatever it raises: it is not used here
        return parse_qos(told) if len(told) < LONGEST_QOS else []
    return []


_open_whole = mcap.McapReader._open


def _open_mcap(reader: Any) -> None:
    """Open an MCAP file. Of one that was cut off, what lies before the break is indexed, record by
    record, from its start: `cut_at` is the byte where it breaks.
    """
    try:
        _open_whole(reader)
    except mcap.ReaderError as error:
        if str(error) != NO_END:
            raise
        _index(reader)


# how rosbags says that a file lacks its end, having read its beginning
NO_END = "File end magic is invalid."
# of the format's records: https://mcap.dev/spec#records
OPCODE_CHUNK, LAST_OPCODE = 0x06, 0x0F
RECORD_HEAD = struct.Struct("<BQ")
CHUNK_HEAD = struct.Struct("<QQQII")


def _index(reader: Any) -> None:
    """Find the whole records of a file that was cut off, and its chunks."""
    file = reader.bio
    size = file.seek(0, 2)
    at = reader.data_start
    found: list[tuple[Any, ...]] = []
    while at + RECORD_HEAD.size <= size:
        file.seek(at)
        opcode, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size))
        end = at + RECORD_HEAD.size + length
        if not 0 < opcode <= LAST_OPCODE or end > size:
            break
        if opcode == OPCODE_CHUNK:
            first, last, unpacked, _, letters = CHUNK_HEAD.unpack(file.read(CHUNK_HEAD.size))
            packing = file.read(min(letters, length)).decode()
            (packed,) = struct.unpack("<Q", file.read(8))
            found.append((first, last, at, end - at, packing, packed, unpacked))
        at = end
    reader.cut_at = reader.data_end = at
    reader.meta_scan()
    told = reader.statistics
    reader.metadata = reader.metadata._replace(
        start_time=told.start_time, end_time=told.end_time + 1, message_count=told.message_count
    )
    any_channel = dict.fromkeys(reader.channels, 1)
    for first, last, start, length, packing, packed, unpacked in found:
        reader.chunks.append(
            mcap.ChunkInfo(
                first, last, start, length, {}, 0, packing, packed, unpacked, any_channel
            )
        )


mcap.McapReader._open = _open_mcap
for module in (folders, mcap, sqlite):
    module.parse_qos = _qos
apsw.connection_hooks.append(_bounded)
mcap.DECOMPRESSORS.update(zstd=of_zstd, lz4=of_lz4)
folders.zstd = SimpleNamespace(decompress=of_zstd, open=_open)  # all that is called of it


def checked(path: Path) -> Path:
    """The path of a bag whose files are regular, and of a size that is read; RunFolderError for
    others, or where nothing is.
    """
    if not path.exists():
        raise RunFolderError(path, "no such file or folder", WORKS)
    with of_bag(path):
        files = [one for one in path.iterdir() if not one.is_dir()] if path.is_dir() else [path]
    for one in files:
        plain_file(one, WORKS, MOST_METADATA if one.suffix == ".yaml" else MOST_BAG, refusal)
    return path


class Event(NamedTuple):
    """A message of a bag: what it is here (`image_raw`, `depth`, `twist`, or a topic of
    `sensors_of`), its topic, when it came [s].
    """

    role: str
    topic: str
    arrived: float
    message: Message


class BagFile:
    """An open bag of ROS 2. kinds: the message types of its topics. passed: where what cannot be
    used is counted.
    Raises RunFolderError: it cannot be read.
    """

    def __init__(self, path: Path, passed: PassedOver):
        self._path = path
        self._passed = passed
        self._at = 0.0  # when the last message came [s]
        with of_bag(path):
            self._reader: Any = Reader(path)
            self._reader.open()
            # Types mean what they mean here, whatever definitions a bag has of them.
            self.kinds = {
                c.topic: c.msgtype
                for c in self._reader.connections
                if c.ext.serialization_format == "cdr"
            }
            whole = self._reader.storage
            files = getattr(whole, "storages", [whole])
            for one in [whole, *files]:
                # Where metadata and file tell another quality of service, rosbags finds no message
                # of the topic.
                one.connections = [
                    c._replace(ext=c.ext._replace(offered_qos_profiles=[])) for c in one.connections
                ]
            for one in files:
                if (cut_at := getattr(one, "cut_at", None)) is not None:
                    if not self.kinds:
                        words = f"it was cut off at byte {cut_at}, before its first message"
                        raise refusal(one.path, words, WORKS)
                    words = f"the file ends in the middle, at byte {cut_at}"
                    words += ": what came before is used"
                    passed.lost(path, one.metadata.end_time / NS, refusal(one.path, words, WORKS))
            self._parts = [(one, part) for one in files for part in _parts(one)]

    def close(self) -> None:
        """Close its files."""
        self._reader.close()

    def messages(self, roles: Mapping[str, str]) -> Iterator[Event]:
        """Messages of topics, by their roles, as they came. Where all stamps of a topic are the
        same, the times of receipt stand in.
        """
        stamps: dict[str, list[float]] = {topic: [] for topic in roles}
        for one in itertools.islice(self._decoded(roles, PassedOver()), LOOKED_AT):
            stamps[one.topic].append(time_of(one.message))
        for one in self._decoded(roles, self._passed):
            if len(stamps[one.topic]) > 1 and len({*stamps[one.topic]}) == 1:
                words = "are all the same: the times at which the bag received them stand in"
                why = ParameterError("stamps", words, time_of(one.message))
                self._passed.note(one.topic, one.arrived, why)
                one.message.header.stamp = stamp(one.arrived)
            yield one

    def _decoded(self, roles: Mapping[str, str], passed: PassedOver) -> Iterator[Event]:
        for connection, at, data in self._raw(roles, passed):
            topic, kind = connection.topic, connection.msgtype
            try:
                with foreign("message", "a time [ns]"):  # in a database a column may hold anything
                    self._at = at / NS
                message = from_cdr(data, kind)
            except ParameterError as error:
                passed.note(topic, self._at, error)
            else:
                yield Event(roles[topic], topic, self._at, message)

    def _raw(self, topics: Collection[str], passed: PassedOver) -> Iterator[tuple[Any, Any, Any]]:
        """Connection, time [ns] and bytes; a part of the file
        that cannot be read costs no other.
        """
        those = [c for c in self._reader.connections if c.topic in topics]
        for storage, chunks in self._parts:
            storage.chunks = chunks
            if storage is not self._reader.storage:
                self._reader.storage.storages = [storage]
            messages = self._reader.messages(those)
            try:
                with of_bag(self._path):
                    yield from messages
            except RunFolderError as error:
                passed.lost(self._path, self._at, error)


def _parts(storage: Any) -> list[list[Any]]:
    """Chunks of an MCAP file by time, those together that overlap; one part of a file that has
    none.
    """
    parts: list[list[Any]] = []
    end = -math.inf
    for chunk in sorted(getattr(storage, "chunks", []), key=lambda one: one.message_start_time):
        if not parts or chunk.message_start_time >= end:
            parts.append([])
        parts[-1].append(chunk)
        end = max(end, chunk.message_end_time)
    return parts or [[]]
