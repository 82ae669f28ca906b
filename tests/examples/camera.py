"""The controller of a scenario on a real camera's pictures: prints the order that each one asks
for, a stop or a camera twist.

    python camera.py SCENARIO [FILM.mp4 | CAMERA]

SCENARIO: with the real camera's size, focal length and rate, for a camera held by hand
(`robot: free`). CAMERA: 0 for the first one.
"""

import sys
import time
from collections.abc import Iterator

import cv2
import numpy as np

import vstestbed as vs

NO_JOINTS = vs.Reading(q=np.zeros(0), qd=np.zeros(0))


def twists(scenario: vs.Scenario, source: str) -> Iterator[vs.Cycle]:
    """The cycle of each picture of a film, or of a camera until Ctrl-C."""
    controller, began = vs.Controller(scenario), time.monotonic()
    video = cv2.VideoCapture(int(source) if source.isdigit() else source)
    if not video.isOpened():
        sys.exit(f"{source}: no film or camera that OpenCV can open")
    while True:
        there, picture = video.read()
        t = (
            time.monotonic() - began
            if source.isdigit()
            else video.get(cv2.CAP_PROP_POS_MSEC) / 1000
        )
        if not there:
            return
        yield controller.step(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), t, NO_JOINTS)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    for cycle in twists(vs.load(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "0"):
        order = ["stop:", cycle.reason] if cycle.stopped else [f"{v:8.4f}" for v in cycle.twist]
        print(f"{cycle.t:7.3f} s", *order, *cycle.notes)
