"""Robot and law as nodes, over zenoh on this machine: the same run as without them, stops that
stay, silence that stops.
"""

import threading
import time

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.apps.ros import link as links
from vstestbed.apps.ros import messages as m
from vstestbed.apps.ros.law import LawNode, Senses, command_frame, command_topic
from vstestbed.apps.ros.link import Link, connected
from vstestbed.apps.ros.robot import RobotNode
from vstestbed.core.errors import EnvironmentLackError, ParameterError
from vstestbed.robots.allocation import LIMITS


class Wire(Link):
    """A link in this process: what is published is heard at once, by whoever has the same wire. It
    crosses as CDR.
    """

    def __init__(self, node, others=None):
        super().__init__(node, 0)
        self.shared = (
            {"topics": {}, "services": {}, "said": []} if others is None else others.shared
        )

    def publish(self, topic, message, now=0.0):
        name, data = self.name(topic), m.to_cdr(message)
        self.shared["said"].append((name, message))
        for heard, kind in self.shared["topics"].get(name, []):
            heard(m.from_cdr(data, kind))

    def subscribe(self, topic, kind, heard):
        self.shared["topics"].setdefault(self.name(topic), []).append((heard, kind))

    def serve(self, service, answer):
        self.shared["services"][self.name(service)] = answer

    def call(self, service, timeout_s=2.0):
        return self.shared["services"][self.name(service)]()

    def close(self):
        pass

    def twists(self):
        return [
            m.twist_of(message)
            for _, message in self.shared["said"]
            if message.__msgtype__ == m.TWIST
        ]


def spun(node):
    """A law's node at work in a thread, and what ends it."""
    ended = threading.Event()
    thread = threading.Thread(target=node.spin, args=(ended,), daemon=True)
    thread.start()
    return ended, thread


def flown(name, given, robot_link, law_link, watch=None, **robot):
    scenario = vs.load(name, given)
    law = LawNode(scenario, law_link, started=True)
    ended, thread = spun(law)
    node = RobotNode(scenario, robot_link, **robot)
    try:
        return node, law, node.fly(scenario.resolved, watch or ())
    finally:
        ended.set()
        thread.join(5)


@pytest.mark.parametrize("name", ["arm_ibvs", "omni_ibvs", "arm_eye_to_hand"])
def test_commanded_by_messages_it_is_the_same_run(name):
    """Pictures, readings and twists cross as CDR; the twists are in the camera's frame for the arm,
    in the body's for the others.
    """
    given = {"stop.duration_s": 1.2, "camera.latency_s": 0.02, "timing.command_latency_s": 0.02}
    wire = Wire("vstestbed_robot")
    node, law, recording = flown(name, given, wire, Wire("vstestbed_law", wire))
    expected = vs.run(vs.load(name, given), pictures=True)
    mine, theirs = recording.rows.frame(), expected.rows.frame()
    assert len(mine) == len(theirs) > 20
    for column in ("applied_vx", "applied_wz", "cam_x", "cam_z", "u_0"):
        np.testing.assert_allclose(
            mine[column].to_numpy()[:-1], theirs[column].to_numpy()[:-1], atol=1e-9, err_msg=column
        )
    assert len(node.answered_s) == len(mine) - 1
    assert command_frame(law.scenario) in (
        "camera_optical_frame",
        "base_link",
        "flange",
    )
    topics = {topic for topic, _ in wire.shared["said"]}
    assert {
        "/clock",
        "/tf",
        "/vstestbed_robot/image_raw",
        "/vstestbed_robot/camera_info",
        command_topic(law.scenario),
    } <= topics
    assert not any(topic.startswith("/truth") for topic in topics)
    assert (wire.twists()[-1] == 0).all()  # a law that ends leaves the robot at rest


def test_over_zenoh_it_is_the_same_run_and_services_answer():
    end = ["tcp/127.0.0.1:17447"]
    given = {"stop.duration_s": 0.6}
    with (
        connected("vstestbed_robot", "zenoh", listen=end) as a,
        connected("vstestbed_law", "zenoh", connect=end) as b,
    ):
        _, law, recording = flown("arm_ibvs", given, a, b, truth=True)
        expected = vs.run(vs.load("arm_ibvs", given), pictures=True).rows.frame()
        # The node's law finds the markers in whole pictures, of which the run draws windows: a
        # pixel at an edge may be another one.
        np.testing.assert_allclose(
            recording.rows.frame()["cam_x"].to_numpy(), expected["cam_x"].to_numpy(), atol=1e-4
        )
        assert law.took_s
        assert a.call("/vstestbed_law/stop") == (True, "asked to stop")
        assert a.call("/nobody/stop", 0.2) is None


def test_the_status_says_what_limits_the_motion():
    """An aligned wrist cannot make all of the first twists."""
    wire = Wire("vstestbed_robot")
    flown("arm_wrist", {"stop.duration_s": 0.2}, wire, Wire("vstestbed_law", wire))
    said = [
        message.data for topic, message in wire.shared["said"] if topic == "/vstestbed_law/status"
    ]
    assert any(words.startswith(f"servoing: {LIMITS['singular']}") for words in said), said


def test_the_truth_is_told_only_if_it_is_asked_for():
    wire = Wire("vstestbed_robot")
    flown("arm_ibvs", {"stop.duration_s": 0.2}, wire, Wire("vstestbed_law", wire), truth=True)
    assert {"/truth/camera_pose", "/truth/target_pose"} <= {
        topic for topic, _ in wire.shared["said"]
    }


class At:
    """Calls something at a frame."""

    def __init__(self, number, what):
        self.number, self.what, self.speeds = number, what, []

    def frame(self, frame):
        if frame.timing.number == self.number:
            self.what()
        self.speeds.append(float(np.abs(frame.truth.qd).max()))


def test_nothing_moves_after_a_stop_of_the_law_until_it_is_started():
    wire = Wire("vstestbed_robot")
    law_wire = Wire("vstestbed_law", wire)
    at = At(10, lambda: wire.call("/vstestbed_law/stop"))
    _, law, _ = flown(
        "arm_ibvs", {"stop.duration_s": 2.0, "stop.rest_after_s": None}, wire, law_wire, [at]
    )
    assert max(at.speeds[:10]) > 0.05 and max(at.speeds[25:]) < 1e-3
    assert law.start() == (True, "servoing")
    assert law.reset()[1] == "not started"


def test_nothing_moves_after_a_stop_of_the_robot():
    wire = Wire("vstestbed_robot")
    at = At(10, lambda: wire.call("/vstestbed_robot/stop"))
    flown(
        "arm_ibvs",
        {"stop.duration_s": 2.0, "stop.rest_after_s": None},
        wire,
        Wire("vstestbed_law", wire),
        [at],
    )
    assert max(at.speeds[:10]) > 0.05 and max(at.speeds[25:]) < 1e-3


def test_a_robot_whose_law_is_silent_comes_to_rest():
    wire, quiet = Wire("vstestbed_robot"), []
    law_wire = Wire("vstestbed_law", wire)
    publish = law_wire.publish
    law_wire.publish = lambda topic, message, now=0.0: (
        None if quiet else publish(topic, message, now)
    )
    at = At(10, lambda: quiet.append(1))
    flown(
        "arm_ibvs",
        {"stop.duration_s": 2.0, "stop.rest_after_s": None},
        wire,
        law_wire,
        [at],
        watchdog_s=0.1,
    )
    assert max(at.speeds[:10]) > 0.05 and max(at.speeds[25:]) < 1e-3


def test_a_law_without_pictures_sends_zero_and_says_why():
    wire = Wire("vstestbed_robot")
    scenario = vs.load("arm_ibvs", {"stop.duration_s": 0.4})
    law = LawNode(scenario, Wire("vstestbed_law", wire), watchdog_s=0.1, started=True)
    ended, thread = spun(law)
    RobotNode(scenario, wire).fly(scenario.resolved)  # and then it is dead
    before = len(wire.twists())
    time.sleep(0.5)
    after = wire.twists()[before:]
    ended.set()
    thread.join(5)
    assert len(after) >= 2 and not np.any(after)
    said = [
        message.data for topic, message in wire.shared["said"] if topic == "/vstestbed_law/status"
    ]
    assert (
        "stopped: no picture for over 0.1 s" in said and said[-1] == "stopped: the node has ended"
    )


def test_a_law_that_has_not_begun_leaves_the_robot_to_others():
    wire = Wire("vstestbed_robot")
    ended, thread = spun(LawNode(vs.load("arm_ibvs"), Wire("vstestbed_law", wire), watchdog_s=0.05))
    time.sleep(0.3)
    ended.set()
    thread.join(5)
    assert wire.twists() == []


def test_a_picture_without_its_readings_stops_with_its_reason():
    wire = Wire("vstestbed_robot")
    law = LawNode(vs.load("arm_ibvs"), Wire("vstestbed_law", wire), watchdog_s=0.1, started=True)
    ended, thread = spun(law)
    wire.publish("~/image_raw", m.image(1.0, np.zeros((480, 640, 3), np.uint8)))
    time.sleep(0.4)
    ended.set()
    thread.join(5)
    said = [
        message.data for topic, message in wire.shared["said"] if topic == "/vstestbed_law/status"
    ]
    assert any("need joint_states (sensor_msgs/msg/JointState)" in words for words in said)


def test_a_twist_that_is_none_moves_nothing():
    wire = Wire("vstestbed_robot")
    node = RobotNode(vs.load("arm_ibvs"), wire)
    for v, frame in ((np.full(6, np.nan), "camera_optical_frame"), (np.ones(6), "gripper")):
        wire.publish("/servo_node/delta_twist_cmds", m.twist(9.0, v, frame))
        assert node._command is None and node.refused
    wire.publish("/servo_node/delta_twist_cmds", m.twist(9.0, np.ones(6), "camera_optical_frame"))
    np.testing.assert_array_equal(node._command[1], np.ones(6))


def test_what_cannot_be_a_node_is_refused(monkeypatch):
    with pytest.raises(ParameterError, match="has 6 pictures at once"):
        LawNode(vs.load("quadrotor_hover"), Wire("a"))
    with pytest.raises(ParameterError, match="rclpy finds the others"):
        connected("a", "rclpy", connect=["tcp/1.2.3.4:7447"])
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    with pytest.raises(ParameterError, match="ROS_DOMAIN_ID"):
        connected("a", "zenoh")
    monkeypatch.setattr(links.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(EnvironmentLackError, match="zenoh is not installed"):
        connected("a")


def test_readings_stand_in_the_order_of_their_times_once():
    """With a camera later than its period the reading of now is told before that of the next
    exposure, and both again and again.
    """
    robot = vs.load("arm_ibvs").robot
    senses = Senses(robot, 0.06)
    for t in (0.0, 0.1, 0.04, 0.14, 0.04, 0.14, 0.08, 0.18):
        message = m.readings(t, robot, vs.Reading(np.full(6, t), np.ones(6)))["joint_states"]
        senses.hear("joint_states", message)
    for t in (0.0, 0.04, 0.06, 0.08, 0.11, 0.18):
        np.testing.assert_allclose(senses.at(t).q, t, atol=1e-9)
    assert senses.at().q[0] == pytest.approx(0.18)
    senses.hear(
        "joint_states", m.readings(100.0, robot, vs.Reading(np.ones(6), np.ones(6)))["joint_states"]
    )
    # the robot was started again
    senses.hear(
        "joint_states", m.readings(0.0, robot, vs.Reading(np.zeros(6), np.ones(6)))["joint_states"]
    )
    assert senses.at().q[0] == 0


@pytest.mark.parametrize("pace", ["wall", "lockstep"])
def test_what_the_robot_tells_while_it_waits_it_tells_without_its_lock(pace):
    """Who hears a reading may be about to command: with the lock held, each would wait for the
    other for ever.
    """
    scenario = vs.load("arm_ibvs", {"detector": "oracle", "stop.duration_s": 0.2})
    wire = Wire("vstestbed_robot")
    node, free = RobotNode(scenario, wire, pace=pace, watchdog_s=0.05), []

    def heard(message):
        def take():
            free.append(node._news.acquire(timeout=1.0))
            node._news.release()

        thread = threading.Thread(target=take)
        thread.start()
        thread.join(2)

    wire.subscribe("/joint_states", m.JOINTS, heard)
    node._heard = True  # a command came before, and then none any more
    node.fly(scenario.resolved)
    assert len(free) > 5 and all(free)
