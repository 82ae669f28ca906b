"""A film of a run's pictures, read by OpenCV, gives the run's twists: the example of a real camera."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import vstestbed as vs

CAMERA = Path(__file__).parent / "camera.py"


@pytest.fixture
def film(tmp_path: Path) -> tuple[Path, list[vs.Frame]]:
    """A lossless film of what the servo camera saw, and the run's frames."""
    scenario = vs.load("ibvs_book", {"stop.duration_s": 1.0, "detector": "blobs"})
    camera = scenario.camera
    writer = cv2.VideoWriter(str(tmp_path / "seen.avi"), cv2.VideoWriter.fourcc(*"FFV1"), camera.rate_hz, (camera.width, camera.height))
    assert writer.isOpened()
    with vs.Session(scenario, pictures=True) as session:
        frames = [session.reset()]
        while frames[-1].outcome is None:
            frames.append(session.step())
    for frame in frames:
        assert frame.image is not None
        writer.write(cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR))
    writer.release()
    return tmp_path / "seen.avi", frames


def test_it_prints_the_twists_of_the_run(film: tuple[Path, list[vs.Frame]]) -> None:
    path, frames = film
    ran = subprocess.run([sys.executable, CAMERA, "ibvs_book", path], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    printed = [line.replace(" s ", " ").split() for line in ran.stdout.splitlines()]
    assert len(printed) == len(frames) > 5
    # t and the twist as they are printed; nothing is unusual about these pictures
    wanted = [[frame.t, *frame.twist] for frame in frames]
    np.testing.assert_allclose([[float(word) for word in words] for words in printed], wanted, atol=6e-4)


def test_a_film_that_is_not_there_is_told(tmp_path: Path) -> None:
    ran = subprocess.run([sys.executable, CAMERA, "ibvs_book", tmp_path / "gone.avi"], capture_output=True, text=True)
    assert ran.returncode == 1
    assert "gone.avi: no film or camera that OpenCV can open" in ran.stderr
