"""One bad element never ends a bag: it is passed over, counted, and told; a broken bag is a
sentence, soon and small.
"""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import queue
import resource
import shutil
import sqlite3
import struct
import time
import traceback
import zlib
from collections import Counter
from contextlib import closing
from pathlib import Path

import cv2
import lz4.frame
import numpy as np
import pytest
from backports import zstd
from rosbags.rosbag2 import CompressionMode, StoragePlugin

import vstestbed as vs
from tests.apps.ros import bags
from tests.apps.ros.bags import BEGAN
from tests.shortcuts import in_app
from vstestbed.apps.ros import bag as vs_bag
from vstestbed.apps.ros import bag_file
from vstestbed.apps.ros import messages as ros
from vstestbed.apps.ros.bag import replay, write_rosbag2
from vstestbed.apps.ros.law import Senses
from vstestbed.core.errors import RunFolderError, VstestbedError
from vstestbed.report.recorded_run import RecordedRun
from vstestbed.studies.run_folder import run_into

write_mcap = in_app("vstestbed.apps.export.mcap_file:write_mcap")
GIB = 1 << 30


@pytest.fixture(scope="module")
def taken():
    return bags.flown()


@pytest.fixture(scope="module")
def scenario():
    return bags.scenario()


@pytest.fixture(scope="module")
def clean(taken, scenario, tmp_path_factory):
    """A bag without fault, and what the controller makes of it."""
    found = replay(
        bags.written(tmp_path_factory.mktemp("clean") / "bag", bags.usual(taken)), scenario
    )
    assert len(found.table) == len(taken) and found.passed.rows() == []
    return found


def replayed(put, scenario, path):
    return replay(bags.written(path, put), scenario)


def told(found):
    """Topic, number, first time after the beginning, and why, of what was passed over."""
    return [
        (topic, int(n), round(float(first) - BEGAN, 3), why)
        for topic, n, first, _, why, _ in found.passed.rows()
    ]


def test_a_picture_that_is_stamped_back_is_passed_over_and_told(
    taken, scenario, clean, tmp_path, caplog
):
    put = bags.usual(taken)
    put[5 * 5 + 3] = (
        "/cam/color",
        put[5 * 5 + 3][1],
        bags.image(BEGAN + taken[5].t - 0.1, taken[5].picture),
    )
    found = replayed(put, scenario, tmp_path / "bag")
    assert len(found.table) == len(clean.table) - 1
    ((topic, n, at, why),) = told(found)
    assert (topic, n, at) == (
        "/cam/color",
        1,
        round(taken[5].t - 0.1, 3),
    ) and "when the last picture was taken" in why
    assert any(
        line.startswith("/cam/color: 1 ") and f"{BEGAN + at:.3f} s" in line
        for line in caplog.messages
    )


@pytest.mark.parametrize(
    ("topic", "broken", "words"),
    [
        (
            "/joint_states",
            lambda one: bags.joints(BEGAN + one.t, np.full(6, np.nan)),
            "must be finite",
        ),
        (
            "/joint_states",
            lambda one: bags.joints(
                BEGAN + one.t, one.q, position=np.zeros(0), velocity=np.zeros(7)
            ),
            "0 positions of 7",
        ),
        (
            "/joint_states",
            lambda one: bags.joints(BEGAN + one.t, one.q, name=["a", "b"], position=np.zeros(2)),
            "have no joint_1",
        ),
        (
            "/cam/color",
            lambda one: bags.image(BEGAN + one.t, one.picture, data=np.zeros(99, np.uint8)),
            "has 99 bytes",
        ),
        (
            "/cam/color",
            lambda one: bags.image(BEGAN + one.t, one.picture, encoding="bayer_rggb8"),
            "bayer_rggb8",
        ),
        (
            "/cam/color",
            lambda one: bags.image(BEGAN + one.t, one.picture[::2]),
            "must be (240, 320, 3)",
        ),
        (
            "/cam/color",
            lambda one: ("sensor_msgs/msg/Image", b"\0\1\0\0" + bytes(20)),
            "message cannot be read",
        ),
        ("/cam/color", lambda one: ("sensor_msgs/msg/Image", b""), "message cannot be read"),
        ("/cmd", lambda one: bags.twist(BEGAN + one.t, np.full(6, np.nan)), "twist must be finite"),
    ],
)
def test_one_broken_element_costs_itself_alone(
    taken, scenario, clean, tmp_path, topic, broken, words
):
    put = bags.usual(taken)
    # the reading of the exposure itself, the picture, the twist
    at = 5 * 4 + {"/joint_states": 1, "/cam/color": 3, "/cmd": 4}[topic]
    put[at] = (topic, put[at][1], broken(taken[4]))
    found = replayed(put, scenario, tmp_path / "bag")
    ((told_topic, n, first, why),) = told(found)
    assert (told_topic.lstrip("/"), n) == (topic.lstrip("/"), 1) and words in why
    assert abs(first - taken[4].t) < 0.02
    assert len(found.table) == len(clean.table) - (topic == "/cam/color")
    if topic == "/cmd":
        assert len(found.differs) == len(clean.differs) - 1


@pytest.mark.parametrize("frozen", [0.0, 77.0])
def test_stamps_that_stand_still_are_replaced_by_the_times_of_receipt(
    taken, scenario, clean, tmp_path, frozen
):
    put = [
        (
            topic,
            t,
            message
            if topic == "/cmd"
            else type(message)(bags.header(frozen), *list(vars(message).values())[1:-1]),
        )
        for topic, t, message in bags.usual(taken)
    ]
    found = replayed(put, scenario, tmp_path / "bag")
    assert len(found.table) == len(clean.table)
    # a constant gain of a still target: the same pictures at the same times, arrived without
    # latency as this scenario has it
    np.testing.assert_allclose(found.computed, clean.computed, atol=1e-9)
    assert {(topic, n) for topic, n, _, _ in told(found)} == {
        ("/cam/color", len(taken)),
        ("/joint_states", 3 * len(taken)),
    }
    assert all("the times at which the bag received them" in why for *_, why in told(found))


def test_the_page_and_the_terminal_tell_what_was_passed_over(taken, tmp_path, command):
    put = bags.usual(taken)
    put[8] = (
        "/cam/color",
        put[8][1],
        bags.image(put[8][1], taken[1].picture, data=np.zeros(99, np.uint8)),
    )
    bag = bags.written(tmp_path / "bag", put)
    given = [f"{name}={value}" for name, value in bags.GIVEN.items()]
    sets = [word for one in given for word in ("--set", one)]
    ended = command("replay", bag, "arm_ibvs", *sets)
    assert (
        ended.code == 0
        and "/cam/color: 1 told or passed over, the first of 1000.040 s" in ended.err
    )
    assert "--remap image_raw=/TOPIC" in ended.err and f"{len(taken) - 1} pictures" in ended.err
    page = (tmp_path / "bag_replay" / "report.html").read_text(encoding="utf-8")
    assert "What was passed over" in page and "has 99 bytes" in page


def test_a_picture_that_comes_again_is_told(taken, scenario, clean, tmp_path):
    put = bags.usual(taken)
    put.insert(24, put[23])
    found = replayed(put, scenario, tmp_path / "bag")
    ((topic, n, _, why),) = told(found)
    assert (topic, n) == ("/cam/color", 1) and "is not used" in why


def test_a_clock_that_begins_anew_begins_the_task_anew(taken, scenario, clean, tmp_path):
    """A recording that was begun twice, by a simulation that was reset: the second half is used
    like the first.
    """
    once = bags.usual(taken)
    again = [(topic, t + 1, message) for topic, t, message in once]
    later = [Taken._replace(t=Taken.t + 500) for Taken in taken]
    found = replayed(
        [(topic, t - 600, message) for topic, t, message in bags.usual(later)] + again,
        scenario,
        tmp_path / "bag",
    )
    assert len(found.table) == 2 * len(clean.table)
    assert [(n, "begins anew" in why) for _, n, _, why in told(found)] == [(1, True)]


def test_one_wrong_stamp_begins_nothing(taken, scenario, clean, tmp_path):
    put = bags.usual(taken)
    put[5 * 5 + 3] = ("/cam/color", put[5 * 5 + 3][1], bags.image(0.0, taken[5].picture))
    found = replayed(put, scenario, tmp_path / "bag")
    assert len(found.table) == len(clean.table) - 1
    assert [(topic, n) for topic, n, *_ in told(found)] == [("/cam/color", 1)]
    np.testing.assert_array_equal(found.table["t"][-1], clean.table["t"][-1])


def test_of_a_bag_without_a_usable_picture_the_refusal_says_why(taken, scenario, tmp_path):
    put = [one for one in bags.usual(taken) if one[0] != "/cam/color"]
    small = [
        ("/cam/color", BEGAN + one.t, bags.image(BEGAN + one.t, one.picture[::2, ::2]))
        for one in taken
    ]
    n = len(taken)
    with pytest.raises(
        RunFolderError,
        match=(
            r"no picture that can be used: /cam/color:"
            rf" {n} .*must be \(240, 320, 3\).*--set camera.width"
        ),
    ):
        replayed(sorted(put + small, key=lambda one: one[1]), scenario, tmp_path / "bag")


def test_a_broken_chunk_costs_its_own_messages(taken, scenario, clean, tmp_path):
    """Chunks of an MCAP file hold some pictures each; one with a wrong checksum is a hole of that
    size, not the end.
    """
    bag = bags.written(tmp_path / "bag", bags.usual(taken), mode=CompressionMode.STORAGE)
    with closing(bag_file.BagFile(bag, ros.PassedOver())) as opened:
        chunks = [chunk for _, part in opened._parts for chunk in part]
    assert len(chunks) > 1
    file = bag / "bag.mcap"
    raw = bytearray(file.read_bytes())
    at = chunks[0].chunk_start_offset + 300
    raw[at : at + 1000] = bytes(1000)
    file.write_bytes(raw)
    found = replay(bag, scenario)
    assert 0 < len(found.table) < len(clean.table)
    np.testing.assert_array_equal(found.recorded[-1], clean.recorded[-1])
    ((topic, n, _, why),) = told(found)
    assert (topic, n) == ("bag", 1) and "part of the bag is lost" in why


@pytest.mark.parametrize("place", ["folder", "file"])
@pytest.mark.parametrize("mode", [CompressionMode.STORAGE, CompressionMode.NONE])
@pytest.mark.parametrize("share", [0.75, 0.999])
def test_of_a_bag_that_was_cut_off_what_came_before_is_used_and_told(
    taken, scenario, clean, tmp_path, share, mode, place
):
    """A killed recorder leaves an MCAP file without its summary: whole chunks are read up to the
    break.
    """
    bag = bags.written(tmp_path / "bag", bags.usual(taken), mode=mode)
    file = bag / "bag.mcap"
    os.truncate(file, int(share * file.stat().st_size))
    found = replay(bag if place == "folder" else file, scenario)
    n = len(found.table)
    assert 0 < n <= len(clean.table) and (share > 0.9 or n < len(clean.table))
    # the last pictures' twists may lie behind the break
    np.testing.assert_array_equal(found.recorded[: n - 2], clean.recorded[: n - 2])
    assert any("the file ends in the middle, at byte" in why for _, _, _, why in told(found))


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_twists_beyond_all_robots_are_not_drawn(taken, scenario, tmp_path):
    huge = [
        (topic, at, bags.twist(at, np.full(6, 1e308)) if topic == "/cmd" else m)
        for topic, at, m in bags.usual(taken)
    ]
    found = replayed(huge, scenario, tmp_path / "bag")
    vs_bag._drawn(found).savefig(tmp_path / "drawn.png")


@pytest.mark.app("export")
def test_of_an_export_that_was_cut_off_what_came_before_is_used_and_told(scenario, tmp_path):
    run_into(tmp_path / "run", scenario)
    file = write_mcap(RecordedRun.of(tmp_path / "run"), tmp_path / "run.mcap")
    whole = replay(file, scenario)
    os.truncate(file, int(0.999 * file.stat().st_size))
    found = replay(file, scenario)
    assert 0 < len(found.table) <= len(whole.table)
    assert any("the file ends in the middle" in why for _, _, _, why in told(found))


@pytest.mark.parametrize("place", ["folder", "file"])
def test_a_bag_cut_in_its_first_chunk_is_a_sentence(taken, scenario, tmp_path, place):
    bag = bags.written(tmp_path / "bag", bags.usual(taken))
    os.truncate(bag / "bag.mcap", 2000)
    with pytest.raises(VstestbedError, match=r"cut off|ends in the middle"):
        replay(bag if place == "folder" else bag / "bag.mcap", scenario)


@pytest.mark.parametrize("name", ["omni_ibvs", "quadrotor_perspective"])
def test_readings_of_an_imu_are_checked_alike(name):
    senses = Senses(vs.load(name).robot, 0.06)
    senses.hear("imu", _imu(np.nan))
    ((topic, count, *_),) = senses.passed.rows()
    assert (topic, count) == ("imu", "1")
    senses.hear("imu", _imu(1.0))
    assert len(senses.passed.rows()) == 1


def test_joints_without_positions_are_passed_over_and_counted_live():
    """Drivers that tell velocities alone, or leave one position out,
    also on the topic of a node.
    """
    robot = vs.load("arm_ibvs").robot
    senses = Senses(robot, 0.06)
    for n in (0, 5):
        told = ros.made(
            ros.JOINTS,
            header=ros.header(0.0, ""),
            name=list(robot.joints),
            position=np.zeros(n),
            velocity=np.zeros(6),
            effort=np.zeros(0),
        )
        senses.hear("joint_states", told)
    ((topic, count, _, _, why, helps),) = senses.passed.rows()
    assert (topic, count, why) == (
        "joint_states",
        "2",
        "joint_states have 0 positions of 6 joints",
    ) and "--remap" in helps


def _imu(w):
    o = ros.made("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=w)
    zero = ros.vector((0, 0, 0))
    names = ("orientation", "angular_velocity", "linear_acceleration")
    covariances = {f"{name}_covariance": np.zeros(9) for name in names}
    return ros.made(
        ros.IMU,
        header=ros.header(1.0, "x"),
        orientation=o,
        angular_velocity=zero,
        linear_acceleration=zero,
        **covariances,
    )


# Files: regular, and of a size.
def test_pipes_devices_links_and_folders_are_refused_at_once(taken, scenario, tmp_path):
    bag = bags.written(tmp_path / "bag", bags.usual(taken[:2]), StoragePlugin.SQLITE3)
    os.mkfifo(tmp_path / "pipe.mcap")
    (tmp_path / "zero.mcap").symlink_to("/dev/zero")
    (tmp_path / "loop.db3").symlink_to("loop.db3")
    (tmp_path / "folder.mcap").mkdir()
    for name in ("metadata.yaml", "bag.db3"):
        copy = bags.copied(bag, tmp_path / f"with_{name}")
        (copy / next(p.name for p in copy.iterdir() if p.suffix == Path(name).suffix)).unlink()
        os.mkfifo(copy / name)
    big = bags.copied(bag, tmp_path / "big")
    os.truncate(big / "metadata.yaml", 200 << 20)
    began = time.monotonic()
    for path in (
        "pipe.mcap",
        "zero.mcap",
        "loop.db3",
        "folder.mcap",
        "with_metadata.yaml",
        "with_bag.db3",
        "big",
    ):
        with pytest.raises(RunFolderError):
            replay(tmp_path / path, scenario)
    assert time.monotonic() - began < 5  # nothing waits for a writer of the pipe


def test_a_database_alone_is_read(taken, scenario, clean, tmp_path):
    bag = bags.written(tmp_path / "bag", bags.usual(taken), StoragePlugin.SQLITE3)
    np.testing.assert_array_equal(replay(bag / "bag.db3", scenario).computed, clean.computed)


def test_bombs_are_stopped_before_they_unpack():
    """Some kilobytes that unpack to 256 MiB."""
    maker = zstd.ZstdCompressor()
    bomb = b"".join([*(maker.compress(bytes(1 << 24)) for _ in range(16)), maker.flush()])
    assert len(bomb) < 50_000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for unpack in (
        bag_file.mcap.DECOMPRESSORS["zstd"],
        lambda data, _: bag_file.folders.zstd.decompress(data),
    ):
        with pytest.raises(ValueError, match="unpacks to more than 128 MiB"):
            unpack(bomb, 1000)
    with pytest.raises(ValueError, match="unpacks to more than 128 MiB"):
        bag_file.mcap.DECOMPRESSORS["lz4"](lz4.frame.compress(bytes(GIB // 6)), 1000)
    # 128 MiB that are unpacked, and 256 MiB that this test packs
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 600_000


def test_a_packed_file_takes_half_of_the_free_space_at_most(taken, scenario, tmp_path, monkeypatch):
    bag = bags.written(
        tmp_path / "bag", bags.usual(taken[:3]), StoragePlugin.SQLITE3, CompressionMode.FILE
    )
    assert len(replay(bag, scenario).table) == 3
    monkeypatch.setattr(
        bag_file.shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**6, 10**6 - 1000, 1000)
    )
    with pytest.raises(RunFolderError, match="half of the free space"):
        replay(bag, scenario)


VIEW = """
    DROP TABLE message_definitions;
    CREATE VIEW message_definitions AS
    WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n)
    SELECT id, 'a' AS topic_type, 'ros2msg' AS encoding, '' AS encoded_message_definition,
        '' AS type_description_hash
    FROM n"""
GROWN = """
    ALTER TABLE messages RENAME TO old;
    CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,
        data BLOB GENERATED ALWAYS AS (zeroblob(900000000)) VIRTUAL);
    INSERT INTO messages SELECT id, topic_id, timestamp FROM old"""
NESTED = "UPDATE topics SET offered_qos_profiles = '" + "[" * 100_000 + "'"


def test_a_topic_of_another_quality_of_service_in_metadata_is_read(taken, scenario, tmp_path):
    """As in bags that a tool has written anew: metadata.yaml tells a topic's quality of service in
    other words than the file.
    """
    bag = bags.written(tmp_path / "bag", bags.usual(taken[:3]), StoragePlugin.SQLITE3)
    with sqlite3.connect(bag / "bag.db3") as base:
        base.execute("UPDATE topics SET offered_qos_profiles = ?", ("- history: 1\n  depth: 7\n",))
    base.close()
    assert len(replay(bag, scenario).table) == 3


@pytest.mark.parametrize("change", [VIEW, GROWN, NESTED])
def test_databases_that_never_end_or_make_up_rows_are_refused(taken, scenario, tmp_path, change):
    bag = bags.written(tmp_path / "bag", bags.usual(taken[:2]), StoragePlugin.SQLITE3)
    with sqlite3.connect(bag / "bag.db3") as base:
        base.executescript(change)
    base.close()
    began = time.monotonic()
    how = ended(bag, scenario)
    assert how == ("whole" if change is NESTED else "refused")
    assert time.monotonic() - began < 3


def test_metadata_that_is_nested_deeply_is_refused(taken, scenario, tmp_path):
    bag = bags.written(tmp_path / "bag", bags.usual(taken[:2]))
    (bag / "metadata.yaml").write_text("[" * 400)
    with pytest.raises(RunFolderError):
        replay(bag, scenario)


def grey_png(side: int) -> np.ndarray:
    """A PNG of a black square of so many pixels a side, by hand: it is some kilobytes."""

    def part(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    pack = zlib.compressobj(1)
    # cut off: the size is refused before
    lines = pack.compress(bytes(50 * (side + 1))) + pack.flush()
    head = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    return np.frombuffer(
        b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + part(b"IDAT", lines) + part(b"IEND", b""),
        np.uint8,
    )


def long_png(length: int) -> bytes:
    """A whole PNG but that its pixels claim so many bytes."""
    raw = bytearray(cv2.imencode(".png", np.zeros((240, 320, 3), np.uint8))[1].tobytes())
    at = raw.index(b"IDAT") - 4
    raw[at : at + 4] = struct.pack(">I", length)
    return bytes(raw)


@pytest.mark.parametrize(
    "broken",
    [
        b"",
        long_png(0xFFFF8000),
        long_png(2**31 - 1),
        b"no picture",
        b"\xff\xd8\xff",
        grey_png(100_000).tobytes(),
        grey_png(20_000).tobytes(),
        b"\x89PNG\r\n\x1a\n",
    ],
)
def test_compressed_pictures_that_are_none_are_passed_over(taken, scenario, tmp_path, broken):
    put = bags.usual(taken[:4], bags.compressed)
    put[8] = (
        "/cam/color",
        put[8][1],
        bags.compressed(put[8][1], taken[1].picture, data=np.frombuffer(broken, np.uint8)),
    )
    # of all tests of this process so far
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    found = replayed(put, scenario, tmp_path / "bag")
    assert len(found.table) == 3
    assert [(topic, n) for topic, n, *_ in told(found)] == [("/cam/color", 1)]
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < GIB / 1024


def test_declared_sizes_take_no_memory(taken, scenario, tmp_path):
    """A picture that claims 100,000 x 100,000 pixels, and arrays that claim two thousand million
    numbers.
    """
    put = bags.usual(taken[:4])
    put[8] = (
        "/cam/color",
        put[8][1],
        bags.image(put[8][1], taken[1].picture, height=100_000, width=100_000, step=300_000),
    )
    raw = bytearray(bags.STORE.serialize_cdr(put[11][2], put[11][2].__msgtype__))
    at = raw.index(struct.pack("<I", 7))  # how many names follow
    raw[at : at + 4] = b"\xff\xff\xff\x7f"
    put[11] = ("/joint_states", put[11][1], (put[11][2].__msgtype__, bytes(raw)))
    found = replayed(put, scenario, tmp_path / "bag")
    assert len(found.table) == 3
    assert sorted((topic, n) for topic, n, *_ in told(found)) == [
        ("/cam/color", 1),
        ("/joint_states", 1),
    ]


# Two thousand broken bags, and sixty.
def sources(folder, taken):
    """Bags without fault, by several writers' settings."""
    usual, small = bags.usual(taken), bags.usual(taken, bags.compressed)
    run_into(
        folder / "run",
        vs.load("arm_ibvs", {**bags.GIVEN, "stop.duration_s": 0.12}),
        "none",
        report=False,
    )
    run = RecordedRun.of(folder / "run")
    (folder / "protobuf").mkdir()
    return [
        write_rosbag2(run, folder / "own"),
        write_mcap(run, folder / "protobuf" / "run.mcap").parent,
        bags.written(folder / "mcap", usual),
        bags.written(folder / "mcap_zstd", usual, mode=CompressionMode.STORAGE),
        bags.written(folder / "sqlite", usual, StoragePlugin.SQLITE3),
        bags.written(folder / "sqlite_png", small, StoragePlugin.SQLITE3),
        bags.written(folder / "mcap_png", small),
        bags.written(
            folder / "sqlite_message", small, StoragePlugin.SQLITE3, CompressionMode.MESSAGE
        ),
        bags.written(folder / "sqlite_file", small, StoragePlugin.SQLITE3, CompressionMode.FILE),
    ]


def broken_bag(seed, whole, taken, path):
    """A broken bag of a seed."""
    rng = np.random.default_rng(seed)
    if rng.random() < 0.35:
        put = bags.usual(taken, bags.compressed if rng.random() < 0.5 else bags.image)
        plugin = StoragePlugin.SQLITE3 if rng.random() < 0.2 else StoragePlugin.MCAP
        return bags.written(path, bags.broken_message(rng, put), plugin)
    source = whole[rng.integers(len(whole))]
    bag = bags.copied(source, path.with_name(f"{source.name}_{path.name}"))
    bags.BREAKS[rng.integers(len(bags.BREAKS))](rng, bag)
    if rng.random() < 0.2 or bag.name.startswith("protobuf"):
        files = [file for file in bag.iterdir() if file.suffix in (".mcap", ".db3")]
        return files[0] if files else bag
    return bag


def ended(bag, scenario):
    """How a bag ends: `whole`, `counted`, or `refused`;
    what else it ends in, with its traceback.
    """
    try:
        found = replay(bag, scenario)
    except VstestbedError as error:
        return (
            "refused"
            if len(str(error)) < 4000 and "Traceback" not in str(error)
            else f"long: {error}"
        )
    except BaseException:  # what else there is, is what is looked for
        return traceback.format_exc()
    return "counted" if found.passed.rows() else "whole"


@pytest.mark.app("export")
def test_sixty_broken_bags_are_a_sentence_or_counted(taken, scenario, tmp_path):
    few = taken[:3]
    whole = sources(tmp_path, few)
    assert [
        ended(bag / "run.mcap" if bag.name == "protobuf" else bag, scenario) for bag in whole
    ] == ["whole"] * len(whole)
    found = Counter(
        ended(broken_bag(seed, whole, few, tmp_path / f"b{seed}"), scenario) for seed in range(60)
    )
    assert set(found) <= {"whole", "counted", "refused"}, found
    assert min(found["counted"], found["refused"]) > 5


def _work(seeds, folder, results):
    """In a process of its own: a bag after the other, each with 20 s; memory is bounded, so that
    what takes it fails here.
    """
    resource.setrlimit(resource.RLIMIT_AS, (6 * GIB, 6 * GIB))
    taken, scenario = bags.flown()[:4], bags.scenario()
    whole = sources(folder / "whole", taken)
    for seed in seeds:
        path = folder / f"b{seed}"
        faulthandler.dump_traceback_later(20, exit=True)  # where it hangs
        began = time.monotonic()
        how = ended(broken_bag(seed, whole, taken, path), scenario)
        faulthandler.cancel_dump_traceback_later()
        results.put(
            (
                seed,
                how,
                time.monotonic() - began,
                resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            )
        )
        for left in folder.glob(f"*b{seed}"):
            shutil.rmtree(left, ignore_errors=True)


@pytest.mark.study
@pytest.mark.process
@pytest.mark.app("export")
def test_two_thousand_broken_bags(tmp_path):
    count = int(os.environ.get("BAGS", "2000"))
    context = multiprocessing.get_context("spawn")
    results, found = context.Queue(), []
    for start in range(0, count, 250):
        folder = tmp_path / str(start)
        (folder / "whole").mkdir(parents=True)
        seeds = range(1000 + start, 1000 + min(start + 250, count))
        child = context.Process(target=_work, args=(seeds, folder, results))
        child.start()
        for seed in seeds:
            try:
                found.append(results.get(timeout=60))
            except queue.Empty:
                pytest.fail(f"bag {seed} has not ended; its process: {child.exitcode}")
        child.join()
    counts = Counter(how if len(how) < 10 else "else" for _, how, _, _ in found)
    slowest, largest = max(took for _, _, took, _ in found), max(mib for *_, mib in found)
    print(f"{counts}; slowest {slowest:.2f} s, largest {largest:.0f} MiB")
    assert not counts["else"], [how for _, how, _, _ in found if len(how) >= 10][:3]
    assert largest < 1024
