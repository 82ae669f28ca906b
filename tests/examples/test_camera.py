"""A film of a run's pictures, read by OpenCV, gives the run's twists:
the example of a real camera.
"""

from __future__ import annotations

import runpy
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
    """A lossless film of what the servo camera saw, and the run's frames; the scenario is beside
    it.
    """
    small = {"camera.width": 500, "camera.height": 500, "camera.pixel_size_m": 2e-5}
    scenario = vs.load("ibvs_book", {"stop.duration_s": 0.6, "detector": "blobs"} | small)
    vs.dump(scenario, tmp_path / "small.yaml")
    camera = scenario.camera
    writer = cv2.VideoWriter(
        str(tmp_path / "seen.avi"),
        cv2.VideoWriter.fourcc(*"FFV1"),
        camera.rate_hz,
        (camera.width, camera.height),
    )
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


@pytest.mark.process
def test_it_prints_the_twists_of_the_run(film: tuple[Path, list[vs.Frame]]) -> None:
    path, frames = film
    ran = subprocess.run(
        [sys.executable, CAMERA, path.with_name("small.yaml"), path], capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
    printed = [line.replace(" s ", " ").split() for line in ran.stdout.splitlines()]
    assert len(printed) == len(frames) > 5
    # t and the twist as they are printed; in the whole pictures of the film a pixel at an edge may
    # be another one than in the run's windows
    wanted = [[frame.t, *frame.twist] for frame in frames]
    np.testing.assert_allclose(
        [[float(word) for word in words] for words in printed], wanted, atol=2e-2
    )


def test_a_film_that_is_not_there_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", [str(CAMERA), "ibvs_book", str(tmp_path / "gone.avi")])
    # a text: it is printed, and the code is 1
    with pytest.raises(SystemExit, match=r"gone\.avi: no film or camera that OpenCV can open"):
        runpy.run_path(str(CAMERA), run_name="__main__")
