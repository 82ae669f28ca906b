"""Bags: a run as rosbag2 (MCAP with ROS 2 messages), and a recorded bag, ours or somebody's, fed
through the controller.
"""

from __future__ import annotations

import importlib
import io
import itertools
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np
import polars as pl
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from vstestbed.apps.ros.bag_file import (
    MOST_UNPACKED,
    BagFile,
    Event,
    checked,
    of_bag,
    of_lz4,
    of_zstd,
    refusal,
)
from vstestbed.apps.ros.law import RESTART_S, Feed, command_frame, command_topic, sent
from vstestbed.apps.ros.link import Answer, Heard, Link, remapped
from vstestbed.apps.ros.messages import (
    COMPRESSED,
    IMAGE,
    NS,
    OPTICAL,
    TWIST,
    Message,
    PassedOver,
    depth_of,
    header,
    joint_state,
    made,
    sensors_of,
    time_of,
    to_cdr,
    twist,
    twist_of,
    types,
)
from vstestbed.apps.ros.robot import Voice
from vstestbed.core.errors import EnvironmentLackError, ParameterError, RunFolderError, short
from vstestbed.core.files import whole_folder, write_whole, writing
from vstestbed.core.foreign import foreign
from vstestbed.core.geometry import Array
from vstestbed.loop.ego_motion import believed_mount, mount_at
from vstestbed.loop.episode import BY_HAND, Episode
from vstestbed.report.canvas import new_figure, publish, style
from vstestbed.report.marks import LINE_COLORS
from vstestbed.report.pages import write_page
from vstestbed.report.recorded_run import (
    ExportFormat,
    ExportRequest,
    RecordedRun,
    name_with_unit,
    unit_of_joint,
)
from vstestbed.robots import Reading
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.frame import Cycle
from vstestbed.tasks.metrics import TWIST as TWIST_NAMES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# largest difference of a twist computed again from the recorded one that is called none [m/s,
# rad/s]
SAME = 1e-9
MAGIC = b"\x89MCAP0\r\n"  # with which an MCAP file begins and ends
LARGEST_DRAWN = 1e6  # twists beyond are no robot's, and no axis has room for them [m/s, rad/s]
SHOWN = 12  # topics that a message lists
# largest difference of commands flown again from those of the log that is not worth a word [m/s,
# rad/s]
SAME_RUN = 0.001


class Bag(Link):
    """A bag that is written: what is published stands in it, with the time of its clock. folder: a
    new one. named: what errors call it.
    Raises EnvironmentLackError, OutputError: see `writing`.
    """

    def __init__(self, folder: Path, node: str = "vstestbed_robot", named: Path | None = None):
        super().__init__(node, 0)
        self._named = named or folder
        self._writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writing(self._named):
            self._writer.open()
        self._topics: dict[str, Any] = {}

    def publish(self, topic: str, message: Message, now: float = 0.0) -> None:
        name = self.name(topic)
        with writing(self._named):
            if name not in self._topics:
                self._topics[name] = self._writer.add_connection(
                    name, message.__msgtype__, typestore=types()
                )
            # a clock that is behind stamps its first messages before 0, where no bag begins
            self._writer.write(self._topics[name], max(0, round(now * NS)), to_cdr(message))

    def subscribe(self, topic: str, kind: str, heard: Heard) -> None:
        """Nothing is heard from a bag that is written."""

    def serve(self, service: str, answer: Answer) -> None:
        """Nobody asks one."""

    def call(self, service: str, timeout_s: float = 2.0) -> tuple[bool, str] | None:
        return None

    def close(self) -> None:
        with writing(self._named):
            self._writer.close()

    def __exit__(self, *error: object) -> None:
        if error[0] is None:
            self.close()
            return
        with suppress(Exception):  # a full disk, which has been told
            self._writer.abort()


def write_rosbag2(
    run: RecordedRun, out: Path, start_s: float = 0.0, tick: Callable[[], None] = lambda: None
) -> Path:
    """Fly a run again, and write what its camera and its sensors told, and the twists that were
    ordered, into a new folder `out`, which appears whole or not at all. Pictures and readings are
    those that the controller was given, noise and motion blur included.

    start_s: what t = 0 is by the stamps [s]. tick: called after each frame.
    Raises RunFolderError: it was commanded from outside.
    """
    s = run.scenario
    if BY_HAND in s.given.description:
        words = "was commanded from outside, which cannot be flown again"
        raise RunFolderError(
            run.folder, words, "vstestbed ros ... --role robot --bag DIR records while it flies"
        )
    logged = run.log.frame().select([f"cmd_{name}" for name in TWIST_NAMES]).to_numpy()
    frames = 0
    differs = 0.0
    with whole_folder(out) as folder:
        with (
            Bag(folder / out.name, named=out) as bag,
            closing(Episode(s, True, (), None)) as episode,
        ):
            voice = Voice(s, bag, truth=True, offset_s=start_s)
            frame = episode.advance()
            while frame is not None and frames < len(logged):
                off = np.nan_to_num(np.abs(frame.command.twist - logged[frames]))
                differs = max(differs, float(off.max()))
                voice.frame(episode, frame)
                v = sent(s, voice.mount, frame.order, voice.q)
                bag.publish(command_topic(s), twist(voice.now, v, command_frame(s)), voice.now)
                tick()
                frames += 1
                frame = episode.advance() if episode.outcome is None else None
        for path in (folder / out.name).iterdir():
            path.rename(folder / path.name)
        (folder / out.name).rmdir()
    # tags and lines are a little elsewhere in whole pictures, which no window has
    if differs > SAME_RUN:
        logging.getLogger("vstestbed").warning(
            "%s: its commands, flown again, differ by up to %.2g from those of %s",
            out,
            differs,
            run.folder,
        )
    return out


# Replay: what was recorded, in the order of its arrival, through the controller.
def events(
    path: Path, scenario: Scenario, remap: Mapping[str, str], passed: PassedOver
) -> Iterator[Event]:
    """The messages of a bag that a controller needs, in their order. path: a folder of rosbag2, an
    MCAP or .db3 file of it, or a file of `export --to mcap`. remap: topics by `image_raw`, `depth`,
    `twist`, and those of the readings. passed: counts what cannot be used.
    Raises RunFolderError: no bag, or one that cannot be read. ParameterError: no topic, or more
    than one, for what is needed.
    """
    if checked(path).is_file() and path.suffix != ".db3" and _of_foxglove(path):
        if remap:
            raise ParameterError.only_for(
                "--remap", "bags of ROS, and this file has the topics of `export --to mcap`"
            )
        yield from _foxglove(path, scenario, passed)
        return
    with closing(BagFile(path, passed)) as bag:
        yield from bag.messages(_roles(bag.kinds, scenario, remap))


def _roles(
    there: Mapping[str, str], scenario: Scenario, remap: Mapping[str, str]
) -> dict[str, str]:
    """What topics are here, by their names: as they are mapped, named as ours, or the only one of
    their kind.
    """
    roles = {
        "image_raw": ("/vstestbed_robot/image_raw", (IMAGE, COMPRESSED)),
        "twist": (command_topic(scenario), (TWIST,)),
    }
    roles |= {name: (f"/{name}", (kind,)) for name, kind in sensors_of(scenario.robot).items()}
    if scenario.law.depth.measured:
        roles["depth"] = ("/vstestbed_robot/depth", (IMAGE,))
    if unknown := sorted(set(remap) - set(roles)):
        raise ParameterError.choice("--remap", roles, unknown[0])
    found: dict[str, str] = {}
    for role, (ours, kinds) in roles.items():
        of_kind = [topic for topic, kind in there.items() if kind in kinds]
        topic = remap.get(role, _usual(role, ours, of_kind))
        if topic in of_kind:
            found[topic] = role
        elif role in remap or role != "twist":
            raise ParameterError("--remap", _unclear(role, kinds, of_kind, there))
    return found


def _usual(role: str, ours: str, of_kind: list[str]) -> str:
    """The only topic of its kind, else the one that is named as ours: depths, which are of the kind
    of pictures, are known by their name alone.
    """
    return of_kind[0] if len(of_kind) == 1 and role != "depth" else ours


def _unclear(
    role: str, kinds: tuple[str, ...], of_kind: list[str], there: Mapping[str, str]
) -> str:
    """That a bag has no topic of these kinds, or several."""
    listed = ", ".join(of_kind[:SHOWN])
    if not listed:
        every = [f"{topic} ({kind})" for topic, kind in there.items()]
        listed = f"none; the bag has {', '.join(every[:SHOWN]) or 'nothing'}"
    return f"{role}=TOPIC must say which topic it is: of {' or '.join(kinds)} there are {listed}"


def _of_foxglove(path: Path) -> bool:
    """Whether an MCAP file has messages in protobuf, as `export --to mcap` writes them."""
    try:
        from mcap.reader import make_reader
    except ImportError as error:
        raise EnvironmentLackError(
            f"MCAP files need {error.name}, which is not installed",
            "pip install 'vstestbed[export]'",
        ) from None
    with of_bag(path), path.open("rb") as file:
        if _is_cut(file):
            return _begins_in_protobuf(file)
        summary = make_reader(file).get_summary()
        return summary is not None and any(
            c.message_encoding == "protobuf" for c in summary.channels.values()
        )


def _is_cut(file: BinaryIO) -> bool:
    """Whether a file begins as MCAP and does not end so, as a killed recorder or a full disk leaves
    it; it is put back to its start.
    """
    begins = file.read(len(MAGIC)) == MAGIC
    file.seek(max(file.seek(0, 2) - len(MAGIC), 0))
    ends = file.read() == MAGIC
    file.seek(0)
    return begins and not ends


def _stream_reader() -> Any:
    """The library's reader from the start on, whose chunks are bounded as those of rosbags."""
    reader: Any = importlib.import_module("mcap.stream_reader")
    reader.zstandard = SimpleNamespace(decompress=of_zstd)
    reader.lz4 = SimpleNamespace(decompress=of_lz4)
    return reader


def _begins_in_protobuf(file: BinaryIO) -> bool:
    # whatever it raises before the first channel: then it is none of ours
    with suppress(Exception):
        for record in _stream_reader().StreamReader(file, record_size_limit=MOST_UNPACKED).records:
            if type(record).__name__ == "Channel":
                return record.message_encoding == "protobuf"
    return False


def _protobuf(file: BinaryIO, topics: list[str]) -> Iterator[tuple[Any, Any, Any, Any]]:
    """Schema, channel, message and its content; of a file that was cut off up to the break, in the
    file's order.
    """
    from mcap.reader import NonSeekingReader, make_reader
    from mcap_protobuf.decoder import DecoderFactory

    cut = _is_cut(file)
    decoders = [DecoderFactory()]
    if cut:
        reader = NonSeekingReader(file, decoder_factories=decoders, record_size_limit=MOST_UNPACKED)
    else:
        reader = make_reader(file, decoder_factories=decoders)
    try:
        yield from reader.iter_decoded_messages(topics, log_time_order=not cut)
    except Exception as error:
        if not cut:
            raise
        raise ValueError("the file ends in the middle: what came before is used") from error


POSITIONS = "/truth/joint_positions"
VELOCITIES = "/truth/joint_velocities"
PICTURE = "/camera/image"
EXPORTED = {POSITIONS: 0, VELOCITIES: 0, PICTURE: 1, "/robot/applied": 2}
"""Topics of `export --to mcap` that are fed, with the order of those of one time."""


def _foxglove(path: Path, scenario: Scenario, passed: PassedOver) -> Iterator[Event]:
    """The same of a file of `export --to mcap`, whose joints are the true ones."""
    _stream_reader()
    exported = _Exported(scenario)
    t = 0.0
    try:
        with of_bag(path), path.open("rb") as file:
            messages = _protobuf(file, list(EXPORTED))
            for _, same in itertools.groupby(messages, key=lambda m: m[2].log_time):
                for _, channel, told, content in sorted(same, key=lambda m: EXPORTED[m[1].topic]):
                    t = told.log_time / NS
                    with foreign(path, "a file of `export --to mcap`", refusal):
                        found = exported.event(channel.topic, t, content)
                    if found is not None:
                        yield found
    except RunFolderError as error:
        passed.lost(path, t, error)


class _Exported:
    """Makes messages of ROS of those of `export --to mcap`."""

    def __init__(self, scenario: Scenario):
        self._scenario = scenario
        units = [(name, unit_of_joint(name, scenario)) for name in scenario.robot.joints]
        self._joints = {
            POSITIONS: [name_with_unit(name, unit) for name, unit in units],
            VELOCITIES: [name_with_unit(name, f"{unit}/s") for name, unit in units],
        }
        self._waiting: dict[str, Array] = {}

    def event(self, topic: str, t: float, message: Any) -> Event | None:
        """The event of a message of a time [s]; None of joints whose other half is to come."""
        if topic in self._joints:
            self._waiting[topic] = _numbers(message, self._joints[topic])
            if len(self._waiting) < 2:
                return None
            q = self._waiting.pop(POSITIONS)
            qd = self._waiting.pop(VELOCITIES)
            told = joint_state(t, self._scenario.robot.joints, q, qd)
            return Event("joint_states", topic, t, told)
        if topic == PICTURE:
            data = np.frombuffer(message.data, np.uint8)
            picture = made(COMPRESSED, header=header(t, "camera"), format=message.format, data=data)
            return Event("image_raw", topic, t + self._scenario.camera.latency_s, picture)
        v = _numbers(message, APPLIED)
        return Event("twist", topic, t, twist(t, v, command_frame(self._scenario)))


APPLIED = [name_with_unit(n, "m/s" if n.startswith("v") else "rad/s") for n in TWIST_NAMES]


def _numbers(message: Any, fields: list[str]) -> Array:
    return np.array([getattr(message, field) for field in fields])


@dataclass(frozen=True)
class Replayed:
    """A bag that went through the controller. table: a line for each picture. recorded, computed:
    twists (n, 6), NaN where none is. passed: what could not be used.
    """

    table: pl.DataFrame
    recorded: Array
    computed: Array
    passed: PassedOver

    @property
    def differs(self) -> Array:
        """The largest difference of a component, of each picture to which a twist was recorded."""
        both = np.abs(self.recorded - self.computed).max(axis=1)
        return both[np.isfinite(both)]


class Fed(NamedTuple):
    """A picture of a bag that went through the controller: when it was stamped and when it came
    [s], its cycle with what it took [ms], the robot's reading at the exposure, the twist (6,) that
    the controller sends, and the recorded one, NaN where there is none.
    """

    stamp: float
    arrived: float
    cycle: Cycle
    took_ms: float
    reading: Reading
    computed: Array
    recorded: Array


def stepped(
    path: Path, scenario: Scenario, remap: Mapping[str, str]
) -> tuple[list[Fed], PassedOver]:
    """Feed a bag through the controller of a scenario, offline; errors: as of `events`. A twist
    belongs to the picture before it. What cannot be used is passed over, counted, and told as
    warnings. RunFolderError: no picture can be used.
    """
    fed = _Feeding(Feed(scenario, live=False))
    for event in events(path, scenario, remap, fed.passed):
        fed.hear(event)
    while fed.waiting:
        fed.step()
    lines = fed.passed.lines()
    if not fed.done:
        why = ": " + "; ".join(lines) if lines else ""
        raise RunFolderError(
            path,
            f"has no picture that can be used{why}",
            "is the topic the right one (--remap image_raw=/TOPIC)?",
        )
    for line in lines:
        logging.getLogger("vstestbed").warning("%s", line)
    return fed.done, fed.passed


class _Feeding:
    """A bag on its way through a controller: pictures wait for the readings of their exposure."""

    def __init__(self, servo: Feed):
        self.servo = servo
        self.passed = servo.senses.passed
        self.waiting: list[Event] = []
        self.done: list[Fed] = []

    def hear(self, event: Event) -> None:
        """Take in a message, and step with the pictures whose readings are there."""
        try:
            if event.role == "image_raw":
                self.waiting.append(event)
            elif event.role == "depth":
                depth_of(event.message)  # a broken one would cost each picture until the next
                self.servo.depth = event.message
            elif event.role == "twist":
                self._recorded(twist_of(event.message))
            else:
                self.servo.senses.hear(event.role, event.message)
        except ParameterError as error:
            self.passed.note(event.topic, event.arrived, error)
        while len(self.waiting) > 1 or (
            self.waiting and self.servo.senses.until(time_of(self.waiting[0].message))
        ):
            self.step()

    def _recorded(self, v: Array) -> None:
        if self.waiting:  # it was answered, whatever was heard since
            self.step()
        if self.done and np.isnan(self.done[-1].recorded).any():
            self.done[-1] = self.done[-1]._replace(recorded=v)

    def step(self) -> None:
        """One control step for the picture that has waited longest."""
        event = self.waiting.pop(0)
        servo = self.servo
        stamp = time_of(event.message)
        began = time.perf_counter()
        late = event.arrived - stamp  # by another clock it says nothing
        # the recorder's, so that a repeated picture is as old as it was
        servo.controller.clock = lambda: event.arrived
        passes = 1.0 if servo.before is None else stamp - servo.before
        timely = 0 <= late < servo.scenario.timing.order_s(servo.scenario.camera)
        # stamps are of the recorder's clock, which counts; of another one time may have been
        # simulated
        if timely:
            servo.controller.simulates(False)
        try:
            if passes < -RESTART_S:
                # one wrong stamp alone, of which there are no readings, begins nothing
                servo.senses.at(stamp)
                words = f"goes back by more than {RESTART_S:g} s: the task begins anew"
                self.passed.note(event.topic, stamp, ParameterError("clock", words))
                servo.reset()
            cycle = servo.step(event.message, event.arrived if timely else None)
        except ParameterError as error:
            if error.field == "detector":  # the scenario's, not the picture's
                raise
            self.passed.note(event.topic, stamp, error)
            return
        took_ms = 1e3 * (time.perf_counter() - began)
        if -RESTART_S <= passes <= 0:
            words = "is not later than the picture's before: it is not used"
            self.passed.note(event.topic, stamp, ParameterError("stamp", words))
        v = servo.sent(cycle.order)
        reading = servo.senses.at(stamp)
        unknown = np.full(6, np.nan)
        self.done.append(Fed(stamp, event.arrived, cycle, took_ms, reading, v, unknown))


def replay(path: Path, scenario: Scenario, remap: Mapping[str, str] | None = None) -> Replayed:
    """What the controller of a scenario makes of a bag; errors: as of `stepped`."""
    steps, passed = stepped(path, scenario, remap or {})
    cycles = [one.cycle for one in steps]
    recorded = np.array([one.recorded for one in steps])
    computed = np.array([one.computed for one in steps])
    table = pl.DataFrame(
        {
            "t": [cycle.t for cycle in cycles],
            "stopped": [cycle.stopped for cycle in cycles],
            "reason": [cycle.reason for cycle in cycles],
            "notes": ["; ".join(cycle.notes) for cycle in cycles],
            **_columns("computed", computed),
            **_columns("recorded", recorded),
            "took_ms": [one.took_ms for one in steps],
        }
    )
    return Replayed(table, recorded, computed, passed)


def _columns(prefix: str, twists: Array) -> dict[str, Array]:
    return {f"{prefix}_{name}": v for name, v in zip(TWIST_NAMES, twists.T, strict=True)}


def read_record(path: Path, scenario: Scenario, remap: Sequence[str]) -> pl.DataFrame:
    """`record_of` with the words of `--remap`."""
    return record_of(path, scenario, remapped(remap))


def record_of(
    path: Path, scenario: Scenario, remap: Mapping[str, str] | None = None
) -> pl.DataFrame:
    """A bag as a record for `identify`: the commands along the robot's own motions, joints, and the
    markers that the detector finds.
    """
    robot = scenario.robot
    mount = believed_mount(scenario)
    rows: list[dict[str, float]] = []
    steps, _ = stepped(path, scenario, remap or {})
    for one in steps:
        q = one.reading.q
        at = mount_at(scenario, mount, q)
        v = np.nan_to_num(one.recorded)
        if command_frame(scenario) != OPTICAL:
            v = at.to_camera @ v
        u = np.linalg.pinv(robot.motion_basis(at, q)) @ v
        row = {"t": one.stamp, "t_q": one.stamp, "arrived": one.arrived}
        row |= {f"u_{i}": x for i, x in enumerate(u.tolist())}
        for name, position, velocity in zip(
            robot.joints, q.tolist(), one.reading.qd.tolist(), strict=True
        ):
            row |= {f"q_{name}": position, f"qd_{name}": velocity}
        for i, (a, b) in enumerate(one.cycle.observation.uv.tolist()):
            row |= {f"u_px_{i}": a, f"v_px_{i}": b}
        rows.append(row)
    return pl.DataFrame(rows, infer_schema_length=None)


def write_replay(folder: Path, found: Replayed, source: str, command: str) -> Path:
    """Write `replay.parquet` and the page into a folder; the page's path."""
    content = io.BytesIO()
    found.table.write_parquet(content)
    write_whole(folder / "replay.parquet", content.getvalue())
    with style():
        plots = [("Twists", publish(_drawn(found), "twists", "Twists", None), CAPTION)]
    differs = found.differs
    took = found.table["took_ms"].median()
    sentences = [
        f"{len(found.table)} pictures went through the controller, each in {took:.2f} ms (median);"
        f" {int(found.table['stopped'].sum())} ended in a stop."
    ]
    head = "No twist was recorded: these are what the law would have ordered"
    state = "open"
    if len(differs):
        same = int((differs <= SAME).sum())
        head = f"{same} of {len(differs)} recorded twists are computed again to {SAME:g}"
        sentences.append(
            f"The largest difference is {differs.max():.3g},"
            f" the median {np.median(differs):.3g} [m/s, rad/s]."
        )
        if same == len(differs):
            state = "good"
    tables = []
    stopped = found.table.filter(pl.col("reason") != "")["reason"].value_counts(sort=True)
    if reasons := [[reason, str(count)] for reason, count in stopped.head(8).rows()]:
        title = "Why it stopped, or did not follow the law"
        tables.append((title, ["Reason", "Pictures"], reasons))
    if passed := found.passed.rows():
        heads = ["Topic", "Number", "First [s]", "Last [s]", "Why", "What helps"]
        tables.append(("What was passed over", heads, passed))
    return write_page(
        folder,
        "study.html",
        f"Replay of {short(source)}",
        outcome=(head, state, sentences),
        plots=plots,
        tables=tables,
        command=command,
    )


CAPTION = (
    "Recorded twists (dots) and those that the controller computes of the recorded pictures"
    " and readings (lines), in the frame in which they were sent;"
    " below the largest difference of a component."
)


def _drawn(found: Replayed) -> Figure:
    drawn = new_figure(5.2, 7.16)
    t = found.table["t"].to_numpy()
    recorded = np.where(np.abs(found.recorded) < LARGEST_DRAWN, found.recorded, np.nan)
    grid = drawn.subplots(3, 1, sharex=True)
    for i, name in enumerate(TWIST_NAMES):
        colour = LINE_COLORS[i % 3]
        grid[i // 3].plot(t, found.computed[:, i], color=colour, label=name)
        grid[i // 3].plot(t, recorded[:, i], ".", markersize=2.5, color=colour)
    for axes, unit in zip(grid, ("m/s", "rad/s"), strict=False):
        axes.set_ylabel(f"[{unit}]")
        axes.legend(loc="upper right", ncols=3)
    differs = np.abs(recorded - found.computed).max(axis=1)
    if np.isfinite(differs).any():
        grid[2].semilogy(t, np.maximum(differs, 1e-17), ".", markersize=2.5, color=LINE_COLORS[3])
    grid[2].set_ylabel("difference")
    grid[2].set_xlabel("time [s]")
    return drawn


def _export(asked: ExportRequest) -> None:
    asked.each(lambda run, path: write_rosbag2(run, path, asked.start_s, asked.tick))


ROSBAG2 = ExportFormat(_export, heeds=("--start",))
