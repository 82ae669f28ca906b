"""A bridge to a robot without ROS: its pictures and joints over a socket to the controller, joint velocities back, and a stop first.

    python bridge.py SCENARIO HOST PORT

The robot's side sends, for each picture, a line of JSON `{"t": 1.23, "q": [...], "qd": [...], "jpeg": "BASE64"}`: the time of the
exposure [s] on a clock that starts with the task, its joints [rad], and the picture. It is sent lines `{"move": [...]}` (joint velocities
[rad/s]) or `{"stop": "REASON"}`. It must stop by itself where none has come for 0.5 s. Of pictures that have waited only the newest is
answered: by the others the robot would move late.
"""

import base64
import json
import socket
import sys
from typing import IO

import cv2
import numpy as np

import vstestbed as vs

SILENCE_S = 0.5


def obey(order, out: IO[str]) -> None:
    """Tell the robot what to do: the stop comes first."""
    told = {"stop": order.reason, "latched": order.latched} if order.stopped else {"move": order.setpoint.tolist()}
    out.write(json.dumps(told) + "\n")
    out.flush()


def picture_of(line: dict) -> np.ndarray:
    """The picture (H, W, 3), RGB."""
    data = np.frombuffer(base64.b64decode(line["picture"]), np.uint8)
    return cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def serve(controller: vs.Controller, link: socket.socket) -> int:
    """Answer each new picture until the robot's side ends; how many there were."""
    link.settimeout(SILENCE_S)
    out, lines, waiting, t, reading, count = link.makefile("w"), link, b"", 0.0, None, 0
    try:
        while True:
            try:
                received = lines.recv(1 << 20)
            except TimeoutError:  # no picture: the supervisor must know
                if reading is not None:
                    t += SILENCE_S
                    obey(controller.without_picture(t, reading), out)
                continue
            if not received:
                return count
            *whole, waiting = (waiting + received).split(b"\n")
            for text in whole[-1:]:
                line = json.loads(text)
                t, reading = line["t"], vs.Reading(np.array(line["q"]), np.array(line["qd"]))
                obey(controller.step(picture_of(line), t, reading).order, out)
                count += 1
    finally:
        out.write(json.dumps({"stop": "the bridge has ended", "latched": True}) + "\n")
        out.close()


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    with socket.create_connection((sys.argv[2], int(sys.argv[3]))) as robot:
        print(serve(vs.Controller(vs.load(sys.argv[1])), robot), "pictures were answered")
