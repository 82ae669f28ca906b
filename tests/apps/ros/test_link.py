"""Names as they are mapped, what a node listens on, and bytes that are no messages, over zenoh on
this machine.
"""

import logging
import re
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import vstestbed as vs
from tests.apps.ros.test_nodes import Wire, spun
from vstestbed.apps.ros import messages as m
from vstestbed.apps.ros.law import LawNode
from vstestbed.apps.ros.link import Rclpy, connected, rules_of
from vstestbed.apps.ros.robot import RobotNode
from vstestbed.core.errors import ParameterError

LAW, ROBOT = "vstestbed_law", "vstestbed_robot"
IMAGE = "/vstestbed_robot/image_raw"


class Mapped(Wire):
    """A node of its own, with rules, that tells nobody."""

    def __init__(self, node: str, *words: str):
        super().__init__(node)
        self._rules = rules_of(words)


def until(done, seconds=10.0):
    end = time.monotonic() + seconds
    while not done() and time.monotonic() < end:
        time.sleep(0.02)
    return done()


@pytest.mark.parametrize(
    ("word", "topic", "name"),
    [
        # as the guide has it
        ("image_raw=/camera/color/image_raw", IMAGE, "/camera/color/image_raw"),
        ("image_raw:=/camera/color/image_raw", IMAGE, "/camera/color/image_raw"),
        ("image_raw:=camera/image", IMAGE, "/camera/image"),
        ("/vstestbed_robot/image_raw:=/cam", IMAGE, "/cam"),
        ("vstestbed_robot/image_raw:=/cam", IMAGE, "/cam"),
        ("image_raw:=~/seen", IMAGE, "/vstestbed_law/seen"),
        ("image_raw/compressed:=/cam/compressed", f"{IMAGE}/compressed", "/cam/compressed"),
        ("joint_states:=/arm/joint_states", "joint_states", "/arm/joint_states"),
        ("/joint_states:=arm/joint_states", "joint_states", "/arm/joint_states"),
        ("~/stop:=/halt", "~/stop", "/halt"),
        ("stop:=/halt", "~/stop", "/halt"),
        ("/vstestbed_law/stop:=/halt", "~/stop", "/halt"),
        ("~/status:=told", "~/status", "/told"),
        (
            "servo_node/delta_twist_cmds:=/my_servo/twists",
            "/servo_node/delta_twist_cmds",
            "/my_servo/twists",
        ),
        ("vstestbed_law:image_raw:=/cam", IMAGE, "/cam"),
    ],
)
def test_the_law_has_its_names_mapped(word: str, topic: str, name: str) -> None:
    link = Mapped(LAW, word)
    LawNode(vs.load("arm_ibvs"), link)
    assert link.name(topic) == name
    others = {
        "~/start": "/vstestbed_law/start",
        "/servo_node/delta_twist_cmds": "/servo_node/delta_twist_cmds",
        IMAGE: IMAGE,
    }
    assert all(link.name(other) == full for other, full in others.items() if other != topic)
    assert name in {**link.shared["topics"], **link.shared["services"]} or topic in (
        "~/status",
        "/servo_node/delta_twist_cmds",
    )


def test_the_robot_has_its_names_mapped_where_it_speaks_and_where_it_listens() -> None:
    link = Mapped(
        ROBOT,
        "image_raw:=/cam",
        "~/camera_info:=/cam/info",
        "servo_node/delta_twist_cmds:=/v",
        "~/stop:=/halt",
        "tf:=/my/tf",
    )
    scenario = vs.load("arm_ibvs", {"stop.duration_s": 0.1})
    node = RobotNode(scenario, link, watchdog_s=0.05)
    node._heard = True  # it does not wait for a first command
    node.fly(scenario.resolved)
    assert {"/cam", "/cam/info", "/my/tf", "/joint_states"} <= {
        name for name, _ in link.shared["said"]
    }
    assert (
        "/v" in link.shared["topics"]
        and "/halt" in link.shared["services"]
        and "/vstestbed_robot/start" in link.shared["services"]
    )


def test_the_first_rule_that_fits_counts_and_rules_of_the_other_node_are_passed_over() -> None:
    link = Mapped(LAW, "vstestbed_robot:joint_states:=/a", "joint_states:=/b", "image_raw:=/cam")
    LawNode(vs.load("arm_ibvs"), link)
    assert link.name("joint_states") == "/b"


def test_a_name_that_maps_nothing_is_refused_with_the_names_that_there_are() -> None:
    """Also where the depth is not read, and where an earlier rule has taken the name."""
    for words, culprit in (
        (["imag_raw:=/cam"], "imag_raw"),
        # private names are those of the node itself, and the picture is the robot's
        (["~/image_raw:=/cam"], "~/image_raw"),
        (["depth:=/cam/depth"], "depth"),
        (["image_raw:=/a", "image_raw:=/b"], "image_raw"),
        (["/image_raw:=/cam"], "/image_raw"),
        (["odom:=/o"], "odom"),
    ):
        with pytest.raises(ParameterError) as refused:
            LawNode(vs.load("arm_ibvs"), Mapped(LAW, *words))
        sentence = str(refused.value)
        assert f"--remap maps {culprit}, which vstestbed_law does not have" in sentence, words
        assert all(
            name in sentence
            for name in (
                IMAGE,
                "/joint_states",
                "/vstestbed_law/stop",
                "/servo_node/delta_twist_cmds",
            )
        )
    with pytest.raises(ParameterError, match="maps truth/camera_pose"):
        RobotNode(vs.load("arm_ibvs"), Mapped(ROBOT, "truth/camera_pose:=/t"))
    RobotNode(vs.load("arm_ibvs"), Mapped(ROBOT, "truth/camera_pose:=/t"), truth=True)
    RobotNode(vs.load("arm_depth"), Mapped(ROBOT, "depth:=/t"))


def test_what_is_no_rule_is_refused() -> None:
    names = (
        "image_raw",
        "=/x",
        "image_raw=",
        "image raw=/x",
        "1x:=/y",
        "a:=/b/",
        "a:=//b",
        "a*:=/b",
        "a:=/b/**",
        "~x:=/y",
        "a:=b:=c",
    )
    for word in (*names, "mine:a:=/b", "rostopic://a:=/b", "a:=/b?c", "a{x}:=/b"):
        with pytest.raises(ParameterError, match="--remap needs the form"):
            rules_of([word])
    for word in ("__node:=mine", "__ns:=/arm", "vstestbed_law:__ns:=/arm", "__name:=a"):
        with pytest.raises(
            ParameterError,
            match=re.escape(f"does not know {word.rpartition(':=')[0].rpartition(':')[2]}; works"),
        ):
            rules_of([word])


def test_the_command_takes_the_arguments_of_ros(command) -> None:
    """`--ros-args -r` is `--remap`, `use_sim_time` is passed over, others are refused by name.
    `stop` has the two services of its name.
    """
    for given, code, words in (
        (
            ["--ros-args", "-r", "nothing:=/x"],
            2,
            "maps nothing, which vstestbed_stop does not have",
        ),
        (["--ros-args", "--remap", "stop:=/halt"], 4, "no node has answered"),
        (["--ros-args", "-p", "use_sim_time:=true"], 4, "use_sim_time:=true changes nothing"),
        (
            ["--ros-args", "-p", "rate:=1"],
            2,
            "--param is known as use_sim_time:=true or false alone",
        ),
        (["--ros-args", "-r", "__ns:=/arm"], 2, "does not know __ns"),
        (["--remap", "image_raw"], 2, "--remap needs the form"),
    ):
        ended = command(
            "ros", "arm_ibvs", "--role", "stop", "--connect", "tcp/127.0.0.1:17001", *given
        )
        assert ended.code == code and words in ended.err, ended.err
    assert command("ros", "arm_ibvs", "--role", "stop", "--connect", "nowhere").code == 2


def test_a_robot_that_refuses_a_name_leaves_no_folder(command, tmp_path: Path) -> None:
    end = "tcp/127.0.0.1:17002"
    ended = command(
        "ros",
        "arm_ibvs",
        "--role",
        "robot",
        "--listen",
        end,
        "--remap",
        "imag=/x",
        "--bag",
        tmp_path / "bag",
    )
    assert (ended.code, list(tmp_path.iterdir())) == (2, []) and "maps imag" in ended.err


def sockets(pid: int | str = "self") -> dict[str, list[str]]:
    """What a process has open, by the tables of the kernel: local addresses of listening TCP, of
    other TCP, of UDP sockets.
    """
    held = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            held.update(re.findall(r"socket:\[(\d+)\]", str(link.readlink())))
        except FileNotFoundError:  # it was closed while they were read
            continue
    found: dict[str, list[str]] = {"listening": [], "tcp": [], "udp": []}
    for table in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            cells = line.split()
            if cells[9] in held:
                found[
                    "udp" if "udp" in table else "listening" if cells[3] == "0A" else "tcp"
                ].append(cells[1])
    return found


@pytest.mark.skipif(
    not Path("/proc/net/tcp").exists(), reason="it reads the tables of sockets that Linux has"
)
def test_who_connects_listens_on_nothing_and_joins_no_multicast() -> None:
    before = sockets()
    with connected(LAW, "zenoh"):  # it finds the others by itself: the check sees that
        now = sockets()
        assert len(now["listening"]) > len(before["listening"])
        assert len(now["udp"]) > len(before["udp"])
    before = sockets()
    with connected(LAW, "zenoh", connect=["tcp/127.0.0.1:17003"]):  # nobody is there yet
        now = sockets()
        assert (now["listening"], now["udp"]) == (before["listening"], before["udp"])
        with connected(ROBOT, "zenoh", listen=["tcp/127.0.0.1:17003"]):
            assert until(lambda: len(sockets()["tcp"]) >= len(before["tcp"]) + 2)
            now = sockets()
            assert now["udp"] == before["udp"]
            assert set(now["listening"]) - set(before["listening"]) == {f"0100007F:{17003:04X}"}


@pytest.mark.process
@pytest.mark.skipif(
    not Path("/proc/net/tcp").exists(), reason="it reads the tables of sockets that Linux has"
)
def test_the_command_connects_and_does_nothing_else(vstestbed_process) -> None:
    words, environment = vstestbed_process
    end = "tcp/127.0.0.1:17004"
    with connected(ROBOT, "zenoh", listen=[end]) as link:
        law = subprocess.Popen(
            [*words, "ros", "arm_ibvs", "--role", "law", "--connect", end],
            env=environment,
            stderr=subprocess.PIPE,
        )
        try:
            assert until(lambda: link.call(f"/{LAW}/stop", 0.5) is not None, 60.0)
            found = sockets(law.pid)
            assert found["listening"] == found["udp"] == [] and len(found["tcp"]) == 1
        finally:
            law.terminate()
            law.wait(10)


def test_who_is_connected_to_one_address_hears_the_others_there() -> None:
    """`--role stop --connect ROBOT` stops the law that is connected to the same robot, whoever came
    first.
    """
    end = ["tcp/127.0.0.1:17005"]
    with (
        connected(LAW, "zenoh", connect=end) as law,
        connected("vstestbed_stop", "zenoh", connect=end) as other,
    ):
        law.serve("~/stop", lambda: (True, "stopped"))
        with connected(ROBOT, "zenoh", listen=end):
            assert until(lambda: other.call(f"/{LAW}/stop", 0.5) == (True, "stopped"))


GARBAGE = {
    "nothing": b"",
    "noise": bytes(np.random.default_rng(0).integers(0, 256, 500, dtype=np.uint8)),
    "cut off": m.to_cdr(m.image(1.0, np.zeros((4, 4, 3), np.uint8)))[:-10],
    "another kind": m.to_cdr(m.text("no picture")),
    "more than it says": m.to_cdr(m.image(1.0, np.zeros((4, 4, 3), np.uint8))) + bytes(100),
}
GARBAGE["a gigabyte, it says"] = (
    m.to_cdr(m.image(1.0, np.zeros((4, 4, 3), np.uint8)))[:-52]
    + (1 << 30).to_bytes(4, "little")
    + bytes(48)
)
PICTURE = m.to_cdr(m.image(1.0, np.zeros((4, 4, 3), np.uint8)))


def test_sensors_are_heard_from_drivers_that_speak_by_best_effort(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A reliable subscription hears none of them (REP 2003), a best-effort one hears both. Commands
    stay reliable.
    """

    class Qos(SimpleNamespace):
        QoSProfile = staticmethod(lambda **given: given)
        ReliabilityPolicy = SimpleNamespace(BEST_EFFORT="best effort")
        DurabilityPolicy = SimpleNamespace(TRANSIENT_LOCAL="latched")

    monkeypatch.setitem(sys.modules, "rclpy.qos", Qos())
    made = []
    one = Rclpy.__new__(Rclpy)
    one.node, one._rules, one._names = "vstestbed_law", [], {}
    one._node = SimpleNamespace(
        create_subscription=lambda kind, name, heard, quality, raw: made.append(quality)
    )
    monkeypatch.setattr(one, "_class", lambda kind: kind)
    for kind in (m.IMAGE, m.COMPRESSED, m.JOINTS, m.IMU, m.TWIST):
        one.subscribe("~/it", kind, print)
    assert made == [{"depth": 5, "reliability": "best effort"}] * 4 + [{"depth": 10}]


def test_bytes_that_are_no_message_are_passed_over_counted_and_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
    end = ["tcp/127.0.0.1:17006"]
    heard: list[m.Message] = []
    with (
        connected(LAW, "zenoh", rules_of(["image_raw:=/cam"]), listen=end) as law,
        connected("other", "zenoh", connect=end) as other,
    ):
        law.subscribe(IMAGE, m.IMAGE, heard.append)
        key = law.key(IMAGE, m.IMAGE)
        put = other._session.put  # past all that makes messages
        assert until(lambda: put(key, PICTURE) or heard)
        time.sleep(0.2)
        heard.clear()
        with caplog.at_level(logging.WARNING, "vstestbed"):
            for data in GARBAGE.values():
                put(key, data)
            # of a kind that may have changed
            put(key.rpartition("/")[0] + "/TypeHashNotSupported", PICTURE)
            put(law.key(IMAGE, m.TEXT), m.to_cdr(m.text("of another type")))
            put(key, PICTURE)
            assert until(lambda: heard)
        assert len(heard) == 1 and law.passed_over == {"/cam": len(GARBAGE) + 2}
        told = [record.getMessage() for record in caplog.records]
        assert len(told) == 1
        assert told[0].startswith(
            "/cam: messages passed over: 1; the last one: message cannot be read"
        )
        with caplog.at_level(logging.WARNING, "vstestbed"):
            for _ in range(92):
                put(law.key(IMAGE, m.TEXT), b"")
            assert until(lambda: law.passed_over["/cam"] == 100)
        assert [r.getMessage().partition("; ")[0].rpartition(" ")[2] for r in caplog.records] == [
            "1",
            "10",
            "100",
        ]
        assert "std_msgs::msg::dds_::String_" in caplog.records[-1].getMessage()


def test_an_answer_of_a_service_that_is_none_is_none() -> None:
    end = ["tcp/127.0.0.1:17007"]
    with (
        connected(LAW, "zenoh", listen=end) as law,
        connected("other", "zenoh", connect=end) as other,
    ):
        key = law._service("~/stop")
        queryable = law._session.declare_queryable(key, lambda query: query.reply(key, b"garbage"))
        assert until(
            lambda: other.call(f"/{LAW}/stop", 0.5) is None and other.passed_over[f"/{LAW}/stop"]
        )
        queryable.undeclare()


def test_a_law_whose_pictures_are_all_garbage_stops_the_robot() -> None:
    """It had moved, then only bytes come that are no pictures: no picture is none, and zero is
    sent.
    """
    end = ["tcp/127.0.0.1:17008"]
    scenario = vs.load("arm_ibvs", {"stop.duration_s": 0.4})
    twists, words = [], []
    with (
        connected(LAW, "zenoh", listen=end) as mine,
        connected(ROBOT, "zenoh", connect=end) as robot,
    ):
        law = LawNode(scenario, mine, watchdog_s=0.2, started=True)
        robot.subscribe(
            "/servo_node/delta_twist_cmds",
            m.TWIST,
            lambda message: twists.append(m.twist_of(message)),
        )
        robot.subscribe(f"/{LAW}/status", m.TEXT, lambda message: words.append(message.data))
        ended, thread = spun(law)
        try:
            RobotNode(scenario, robot).fly(scenario.resolved)
            assert any(np.any(v) for v in twists)
            stop = threading.Event()
            flood = threading.Thread(
                target=lambda: [
                    robot._session.put(mine.key(IMAGE, m.IMAGE), b"x")
                    for _ in iter(stop.is_set, True)
                ]
            )
            flood.start()
            assert until(lambda: any("no picture for over 0.2 s" in word for word in words))
            twists.clear()
            assert until(lambda: len(twists) >= 3) and not np.any(twists)
            stop.set()
            flood.join()
        finally:
            ended.set()
            thread.join(5)
        assert thread.is_alive() is False and mine.passed_over[IMAGE] > 1


@pytest.mark.study
def test_no_mutated_message_is_more_than_passed_over() -> None:
    """Each byte may be any other, each end may come early: a message, or a sentence that names the
    kind.
    """
    rng = np.random.default_rng(1)
    arm = vs.load("arm_ibvs").robot
    joints = m.readings(1.0, arm, vs.Reading(np.zeros(6), np.zeros(6)))
    span = {
        "radiation_type": 1,
        "field_of_view": 0.0,
        "min_range": 0.0,
        "max_range": 1.0,
        "range": 1.0,
        "variance": 0.0,
    }
    height = m.made(m.RANGE, header=m.header(1.0, "base_link"), **span)
    samples = [
        m.image(1.0, np.zeros((4, 4, 3), np.uint8)),
        m.twist(1.0, np.ones(6), "base_link"),
        height,
        *joints.values(),
    ]
    for message in samples:
        data, kind = m.to_cdr(message), message.__msgtype__
        for _ in range(2000):
            changed = bytearray(data)
            for place in rng.integers(len(data), size=rng.integers(1, 5)):
                changed[place] = rng.integers(256)
            changed = changed[: rng.integers(len(changed) + 1)] if rng.random() < 0.3 else changed
            try:
                m.from_cdr(bytes(changed), kind)
            except ParameterError as error:
                assert kind in str(error) and "\n" not in str(error)
