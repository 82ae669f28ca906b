"""The bridge to a robot without ROS: every picture is answered,
silence and the end stop the robot.
"""

import base64
import json
import socket
import threading
import time
from pathlib import Path

import cv2
import numpy as np

import vstestbed as vs
from vstestbed.core.named_files import load_file

BRIDGE = load_file(Path(__file__).with_name("bridge.py"))


def line_of(frame):
    """What the robot's side sends."""
    png = base64.b64encode(cv2.imencode(".png", frame.image[..., ::-1])[1]).decode()
    line = {
        "t": frame.t,
        "q": frame.truth.q.tolist(),
        "qd": frame.truth.qd.tolist(),
        "picture": png,
    }
    return json.dumps(line) + "\n"


def test_every_picture_is_answered_and_silence_stops(monkeypatch):
    monkeypatch.setattr(BRIDGE, "SILENCE_S", 2.0)  # a busy machine may draw the next picture late
    scenario = vs.load("arm_ibvs", {"stop.duration_s": 0.4})
    robot, law = socket.socketpair()
    robot.settimeout(20)
    controller = vs.Controller(scenario)
    # of the simulation, which is slower than real time where the machine is busy
    controller.clock = lambda: now_s
    now_s = 0.0
    thread = threading.Thread(target=BRIDGE.serve, args=(controller, law), daemon=True)
    thread.start()
    answers, out = robot.makefile("r"), robot.makefile("w")
    with vs.Session(scenario, pictures=True) as session:
        frame = session.reset()
        for _ in range(4):
            now_s = frame.t
            out.write(line_of(frame))
            out.flush()
            moved = json.loads(answers.readline())["move"]
            np.testing.assert_allclose(moved, frame.setpoint, atol=1e-12)
            frame = session.step()
    assert json.loads(answers.readline())["stop"].startswith("no picture arrived")
    robot.shutdown(socket.SHUT_WR)
    thread.join(5)
    law.close()
    said = [json.loads(line) for line in answers]
    assert said[-1] == {"stop": "the bridge has ended", "latched": True}


def test_old_pictures_of_a_queue_and_one_that_comes_again_move_nothing(monkeypatch):
    monkeypatch.setattr(BRIDGE, "SILENCE_S", 5.0)
    scenario = vs.load("arm_ibvs")
    robot, law = socket.socketpair()
    robot.settimeout(20)
    for side in (robot, law):
        side.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
    controller = vs.Controller(scenario)
    with vs.Session(scenario, pictures=True) as session:
        first = line_of(session.reset())
        newest = line_of(session.step())
    robot.sendall((first + newest).encode())  # both wait when the bridge begins
    thread = threading.Thread(target=BRIDGE.serve, args=(controller, law), daemon=True)
    thread.start()
    answers = robot.makefile("r")
    assert (
        "move" in json.loads(answers.readline())
        and controller.before.number == 0
        and controller.before.t > 0
    )
    controller.clock = lambda: 1e9  # and then the camera stands
    robot.sendall(newest.encode())
    assert json.loads(answers.readline()) == {"stop": "no picture arrived for 1 s", "latched": True}
    robot.shutdown(socket.SHUT_WR)
    thread.join(5)
    law.close()


def test_a_link_that_stalls_stops_the_robot_and_a_picture_long_on_its_way_does_not_move_it(
    monkeypatch,
):
    """Bytes come all the time, each sooner than the silence that stops;
    the whole picture does not.
    """
    monkeypatch.setattr(BRIDGE, "SILENCE_S", 0.4)
    scenario = vs.load("arm_ibvs", {"timing.command_timeout_s": 0.3})
    robot, law = socket.socketpair()
    robot.settimeout(20)
    with vs.Session(scenario, pictures=True) as session:
        first = line_of(session.reset())
        second = line_of(session.step())
    thread = threading.Thread(target=BRIDGE.serve, args=(vs.Controller(scenario), law), daemon=True)
    thread.start()
    answers = robot.makefile("r")
    robot.sendall(first.encode())
    assert "move" in json.loads(answers.readline())
    for i in range(8):  # .8 s, twice the silence
        robot.sendall(second[10 * i : 10 * i + 10].encode())
        time.sleep(0.1)
    assert json.loads(answers.readline())["stop"].startswith("no picture arrived")
    robot.sendall(second[80:].encode())
    robot.shutdown(socket.SHUT_WR)
    thread.join(5)
    law.close()
    said = [json.loads(line) for line in answers]
    assert not any("move" in told for told in said)
    assert any("late" in told["stop"] for told in said)
