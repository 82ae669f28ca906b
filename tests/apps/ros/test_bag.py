"""Bags: written for other readers, replayed to the last digit, also those that somebody else has
written.
"""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

import vstestbed as vs
from tests.shortcuts import in_app
from vstestbed.apps.ros.bag import record_of, replay, write_replay, write_rosbag2
from vstestbed.apps.ros.link import remapped
from vstestbed.core.errors import ParameterError, RunFolderError
from vstestbed.report.recorded_run import RecordedRun
from vstestbed.studies.run_folder import run_into

write_mcap = in_app("vstestbed.apps.export.mcap_file:write_mcap")

GIVEN = {"stop.duration_s": 0.8, "camera.latency_s": 0.02, "timing.command_latency_s": 0.02}


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "arm"
    run_into(folder, vs.load("arm_ibvs", GIVEN), "none", report=False)
    return folder


@pytest.fixture(scope="module")
def bag(run) -> Path:
    return write_rosbag2(RecordedRun.of(run), run.with_name("bag"))


def test_two_independent_readers_open_it(run, bag):
    log = pl.read_parquet(run / "log.parquet")
    with AnyReader([bag]) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert (
        kinds["/vstestbed_robot/image_raw"] == "sensor_msgs/msg/Image"
        and kinds["/tf"] == "tf2_msgs/msg/TFMessage"
    )
    assert (
        counts["/vstestbed_robot/image_raw"]
        == counts["/servo_node/delta_twist_cmds"]
        == counts["/truth/camera_pose"]
        == len(log)
    )
    found = {}
    for message in read_ros2_messages(bag / "bag.mcap"):
        found.setdefault(message.channel.topic, []).append(message.ros_msg)
    assert {topic: len(messages) for topic, messages in found.items()} == counts
    # at the exposure, and at the arrival
    q = np.array([one.position for one in found["/joint_states"]])[::2]
    np.testing.assert_allclose(
        q, log.select([f"q_joint_{i}" for i in range(1, 7)]).to_numpy(), atol=1e-12
    )
    true = [
        [one.pose.position.x, one.pose.position.y, one.pose.position.z]
        for one in found["/truth/camera_pose"]
    ]
    np.testing.assert_allclose(true, log.select("cam_x", "cam_y", "cam_z").to_numpy(), atol=1e-12)
    twists = [one.twist.linear.x for one in found["/servo_node/delta_twist_cmds"]]
    np.testing.assert_allclose(twists[:-1], log["applied_vx"][:-1].to_numpy(), atol=1e-12)


def test_a_clock_that_is_behind_stamps_its_first_messages_before_0(tmp_path):
    behind = {"stop.duration_s": 0.2, "timing.camera_clock": {"offset_s": -0.02}}
    run_into(tmp_path / "run", vs.load("omni_ibvs", behind), "none", report=False)
    bag = write_rosbag2(RecordedRun.of(tmp_path / "run"), tmp_path / "bag")
    with AnyReader([bag]) as reader:
        received = [at for _, at, _ in reader.messages()]
        first = next(
            reader.deserialize(data, c.msgtype)
            for c, _, data in reader.messages()
            if c.topic == "/joint_states"
        )
    assert received[0] == 0
    assert (first.header.stamp.sec, first.header.stamp.nanosec) == (-1, 980_000_000)


def test_replayed_its_twists_are_the_recorded_ones(bag, run):
    scenario = vs.load("arm_ibvs", GIVEN)
    found = replay(bag, scenario)
    assert len(found.differs) == len(found.table) == len(pl.read_parquet(run / "log.parquet"))
    assert found.differs.max() == 0
    file = replay(bag / "bag.mcap", scenario)
    np.testing.assert_array_equal(file.computed, found.computed)
    other = replay(bag, vs.load("arm_ibvs", {**GIVEN, "law.gain": 1.0}))
    assert np.median(
        np.linalg.norm(other.computed, axis=1) / np.linalg.norm(found.computed, axis=1)
    ) == pytest.approx(2, rel=0.2)


@pytest.mark.app("export")
def test_a_file_for_foxglove_is_replayed(run):
    path = write_mcap(RecordedRun.of(run), run.with_name("run.mcap"))
    found = replay(
        path,
        vs.load("arm_ibvs", {**GIVEN, "camera.latency_s": 0.0, "timing.command_latency_s": 0.0}),
    )
    assert len(found.table) == len(found.differs) + (len(found.table) - len(found.differs)) > 15
    assert np.isfinite(found.computed).all()


def plain_bag(path, frames, plugin, image="/cam/color", twist="/cmd"):
    """A bag by rosbags alone, as a camera's and a robot's driver would fill it: joints at 100 Hz,
    in another order, and grey pictures.
    """
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    names = ["finger", "joint_6", "joint_5", "joint_4", "joint_3", "joint_2", "joint_1"]

    def at(t):
        time = kinds["builtin_interfaces/msg/Time"](sec=int(t), nanosec=round(t % 1 * 1e9))
        return kinds["std_msgs/msg/Header"](stamp=time, frame_id="x")

    with Writer(path, version=8, storage_plugin=plugin) as bag:
        topics = {
            "/joint_states": "sensor_msgs/msg/JointState",
            image: "sensor_msgs/msg/Image",
            twist: "geometry_msgs/msg/TwistStamped",
        }
        to = {
            topic: bag.add_connection(topic, kind, typestore=store)
            for topic, kind in topics.items()
        }

        def put(topic, t, **fields):
            message = kinds[topics[topic]](header=at(t), **fields)
            bag.write(to[topic], round(t * 1e9), store.serialize_cdr(message, topics[topic]))

        for t, picture, q, v in frames:
            for k in (-1, 0, 1):
                told = np.array([9.0, *(q + 0.01 * k)[::-1]])
                put(
                    "/joint_states",
                    t + 0.01 * k,
                    name=names,
                    position=told,
                    velocity=np.zeros(0),
                    effort=np.zeros(0),
                )
            data = np.ascontiguousarray(picture[..., ::-1]).reshape(-1)
            h, w = picture.shape[:2]
            put(image, t, height=h, width=w, encoding="bgr8", is_bigendian=0, step=3 * w, data=data)
            vector = kinds["geometry_msgs/msg/Vector3"]
            both = kinds["geometry_msgs/msg/Twist"](linear=vector(*v[:3]), angular=vector(*v[3:]))
            put(twist, t + 0.012, twist=both)
    return path


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_bag_of_somebody_else_is_replayed(tmp_path, plugin):
    """Twists equal those of the controller that is fed by hand; topics of other names are found by
    their kinds.
    """
    scenario = vs.load("arm_ibvs", {"stop.duration_s": 0.4})
    controller, frames, expected = vs.Controller(scenario), [], []
    with vs.Session(scenario, pictures=True) as session:
        frame = session.reset()
        while frame.outcome is None:
            q = frame.truth.q
            # the driver tells no speeds: they are those of the way between two messages
            cycle = controller.step(frame.image, frame.t, vs.Reading(q, np.ones(6)))
            expected.append(cycle.twist)
            frames.append((1000.0 + frame.t, frame.image.copy(), q, cycle.twist))
            frame = session.step()
    found = replay(plain_bag(tmp_path / "other", frames, plugin), scenario)
    np.testing.assert_allclose(found.computed, expected, atol=1e-6)  # between stamps in nanoseconds
    np.testing.assert_allclose(found.recorded, expected, atol=1e-12)
    assert (found.table["stopped"] == False).all()  # noqa: E712 - a column
    with pytest.raises(ParameterError, match=r"image_raw=TOPIC.*there are /cam/color"):
        replay(tmp_path / "other", scenario, {"image_raw": "/nothing"})


def test_a_bag_is_a_record_for_identification(bag):
    record = record_of(bag, vs.load("arm_ibvs", GIVEN))
    assert {"t", "arrived", "u_0", "u_5", "q_joint_1", "qd_joint_6", "u_px_0", "v_px_3"} <= set(
        record.columns
    )
    np.testing.assert_allclose((record["arrived"] - record["t"]).to_numpy(), 0.02, atol=1e-9)


@pytest.mark.app("export")
def test_a_topic_that_maps_nothing_is_refused(bag, run):
    scenario = vs.load("arm_ibvs", GIVEN)
    with pytest.raises(
        ParameterError,
        match=r"--remap must be one of image_raw, twist, joint_states, got 'imag_raw'",
    ):
        replay(bag, scenario, remapped(["imag_raw:=/x"]))
    with pytest.raises(ParameterError, match="--remap is for bags of ROS"):
        replay(
            write_mcap(RecordedRun.of(run), run.with_name("mapped.mcap")),
            scenario,
            remapped(["image_raw=/x"]),
        )
    given = ["~/image_raw:=/a", "image_raw:=/b", "/joint_states=arm/joints"]
    # the first one of each, absolutely
    assert remapped(given) == {"image_raw": "/a", "joint_states": "/arm/joints"}


def test_the_page_says_how_many_agree(bag, tmp_path):
    found = replay(bag, vs.load("arm_ibvs", GIVEN))
    n = len(found.table)
    page = write_replay(tmp_path, found, "bag", "vstestbed replay bag").read_text(encoding="utf-8")
    assert f"{n} of {n} recorded twists are computed again" in page and "<svg" in page
    assert len(pl.read_parquet(tmp_path / "replay.parquet")) == n


def test_what_is_no_bag_is_refused(tmp_path, run):
    scenario = vs.load("arm_ibvs")
    (tmp_path / "a.mcap").write_bytes(b"no")
    (tmp_path / "b.mcap").write_bytes(bytes(500))
    for path, words in (
        (tmp_path / "no", "no such file"),
        (tmp_path, "cannot be read"),
        (tmp_path / "a.mcap", "cannot be read"),
        (tmp_path / "b.mcap", "cannot be read"),
    ):
        with pytest.raises(RunFolderError, match=words):
            replay(path, scenario)
    by_hand = run_into(
        tmp_path / "hand",
        vs.load(
            "arm_ibvs", {"stop.duration_s": 0.1, "description": "Changed by hand during the run: x"}
        ),
        "none",
    )
    assert by_hand.outcome
    with pytest.raises(RunFolderError, match="commanded from outside"):
        write_rosbag2(RecordedRun.of(tmp_path / "hand"), tmp_path / "out")
