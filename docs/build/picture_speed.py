"""What a picture of 640 x 480 costs each detector and law on this machine:
`python -m docs.build.picture_speed [NAME ...]`.

Runs of all of them go on in turn, frame by frame, so that all have the same load. Compare the
ratios, not the times.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

import cv2
import numpy as np

import vstestbed as vs

GOES_ON = {"stop.converged.hold_s": 20.0}
SIZE = {"camera.width": 640, "camera.height": 480}
EVERY = {"detector.track": "none"}
SETTINGS: dict[str, tuple[str, dict[str, Any]]] = {
    "four markers (`arm_ibvs`)": ("arm_ibvs", {}),
    "tags (`arm_tags`)": ("arm_tags", {}),
    "keypoints, SIFT in every picture": ("arm_keypoints", EVERY),
    "keypoints, SIFT in every tenth, KLT between (`arm_keypoints`)": ("arm_keypoints", {}),
    "keypoints, ORB in every picture": ("arm_keypoints", {**EVERY, "detector.features": "orb"}),
    "keypoints, ORB in every tenth, KLT between": ("arm_keypoints", {"detector.features": "orb"}),
    "a plane tracked whole (`arm_patch`)": ("arm_patch", {}),
    "moments of a region (`arm_region`)": ("arm_region", {}),
    "the ellipse of a ball (`arm_ball`)": ("arm_ball", {}),
    "photometric, full pictures": ("arm_photometric", {**SIZE, "law.levels": 1}),
    "photometric, six levels, coarse to fine": ("arm_photometric", {**SIZE, "law.levels": 6}),
    "markers, a stereo depth camera (`arm_depth`)": ("arm_depth", {}),
}
FRAMES = 120
FIRST = 1
"""Frames that are left out: they load what all others use."""


class Stopwatch:
    """Processor time of the controller's steps [s], of all threads."""

    def __init__(self) -> None:
        self.s = 0.0

    @contextmanager
    def on_controllers(self) -> Iterator[None]:
        """Take the time of every step of a controller."""
        plain = vs.Controller.arrive

        def timed(controller: vs.Controller, *given: Any) -> Any:
            began = time.process_time()
            try:
                return plain(controller, *given)
            finally:
                self.s = time.process_time() - began

        with mock.patch.object(vs.Controller, "arrive", timed):
            yield


def measured(settings: dict[str, tuple[str, dict[str, Any]]]) -> dict[str, np.ndarray]:
    """Processor time of each frame's control step and of the whole frame, shape (FRAMES, 2) [ms],
    by name.
    """
    watch = Stopwatch()
    sessions = {
        name: vs.Session(vs.load(scenario, {**changes, **GOES_ON}))
        for name, (scenario, changes) in settings.items()
    }
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in settings}
    with watch.on_controllers():
        for session in sessions.values():
            session.reset()
        for _ in range(FIRST + FRAMES):
            for name, session in sessions.items():
                began = time.process_time()
                session.step()
                times[name].append((1e3 * watch.s, 1e3 * (time.process_time() - began)))
    for session in sessions.values():
        session.close()
    return {name: np.array(those[FIRST:]) for name, those in times.items()}


def row(name: str, ms: np.ndarray, first: np.ndarray) -> str:
    """A row of the table: control step, its slowest twentieth, pictures a second, and both as
    multiples of the first setting's.
    """
    step, frame = np.median(ms, axis=0)
    base_step, base_frame = np.median(first, axis=0)
    slow = float(np.quantile(ms[:, 0], 0.95))
    return (
        f"| {name} | {step:.1f} | {slow:.1f} | {1e3 / ms[:, 0].mean():.0f} | {step / base_step:.1f}"
        f" | {frame / base_frame:.1f} |"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m docs.build.picture_speed", description=__doc__)
    parser.add_argument("name", nargs="*", help="parts of the names of settings; by default all")
    asked = parser.parse_args().name
    cv2.setNumThreads(1)
    found = measured(
        {
            n: s
            for i, (n, s) in enumerate(SETTINGS.items())
            if i == 0 or not asked or any(a in n for a in asked)
        }
    )
    for name, ms in found.items():
        print(row(name, ms, next(iter(found.values()))))
