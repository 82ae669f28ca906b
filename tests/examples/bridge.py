"""A bridge to a robot without ROS: its pictures and joints over a socket to the controller, joint
velocities back, and a stop first.

    python bridge.py SCENARIO HOST PORT

The robot's side sends, for each picture, a line of JSON
`{"t": 1.23, "q": [...], "qd": [...], "picture": "BASE64"}`: the time of the exposure [s] on a clock
that starts with the task, its joints [rad], and the picture as a file of PNG or JPEG. It is sent
lines `{"move": [...]}` (joint velocities [rad/s]) or `{"stop": "REASON"}`. It must stop by itself
where none has come for 0.5 s. Of pictures that have waited only the newest is answered: by the
others the robot would move late. Nobody knows by another clock how old a picture is; but what it
took to come, and what it came later than the one that came soonest, is known. One that was so long
on its way that no command lasts as long stops the robot.
"""

import base64
import json
import math
import select
import socket
import sys
import time
from typing import IO

import cv2
import numpy as np

import vstestbed as vs

SILENCE_S = 0.5


def obey(order, out: IO[str]) -> None:
    """Tell the robot what to do: the stop comes first."""
    told = (
        {"stop": order.reason, "latched": order.latched}
        if order.stopped
        else {"move": order.setpoint.tolist()}
    )
    out.write(json.dumps(told) + "\n")
    out.flush()


def picture_of(line: dict) -> np.ndarray:
    """The picture (H, W, 3), RGB."""
    data = np.frombuffer(base64.b64decode(line["picture"]), np.uint8)
    return cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def serve(controller: vs.Controller, link: socket.socket) -> int:
    """Answer each new picture until the robot's side ends; how many there were."""
    link.settimeout(SILENCE_S)  # for what is sent
    out, waiting, reading, count = link.makefile("w"), b"", None, 0
    # now: by the robot's clock; ahead: by how much the own clock is, at most; began: a message
    now, ahead, began = 0.0, math.inf, 0.0
    # for a whole message: bytes that trickle are no picture
    deadline = time.monotonic() + SILENCE_S
    try:
        while True:
            left = deadline - time.monotonic()
            if left <= 0:  # no picture: the supervisor must know
                deadline = time.monotonic() + SILENCE_S
                if reading is not None:
                    now += SILENCE_S
                    obey(controller.without_picture(now, reading), out)
                continue
            if not select.select([link], [], [], left)[0]:
                continue
            received = link.recv(1 << 20)
            if not received:
                return count
            came = controller.clock()
            began = began if waiting else came
            *whole, waiting = (waiting + received).split(b"\n")
            if not whole:
                continue
            began = began if len(whole) == 1 else came  # of the newest
            line = json.loads(whole[-1])
            t, reading = line["t"], vs.Reading(np.array(line["q"]), np.array(line["qd"]))
            ahead = min(ahead, began - t)
            now = max(t, came - ahead)  # as sums are rounded, it may be before t
            obey(controller.step(picture_of(line), t, reading, arrived=now).order, out)
            count += 1
            began = came  # of what is waiting
            deadline = time.monotonic() + SILENCE_S
    finally:
        out.write(json.dumps({"stop": "the bridge has ended", "latched": True}) + "\n")
        out.close()


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    with socket.create_connection((sys.argv[2], int(sys.argv[3]))) as robot:
        print(serve(vs.Controller(vs.load(sys.argv[1])), robot), "pictures were answered")
