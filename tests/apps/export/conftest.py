"""Two short runs of an arm in a comparison's folders, with noise in pictures and pixels."""

from __future__ import annotations

from pathlib import Path

import pytest

import vstestbed as vs

SETTINGS = {
    "camera.width": 321,  # odd: videos are even
    "camera.height": 240,
    "stop.duration_s": 0.28,
    "noise.image_sigma": 2.0,
    "noise.pixel_sigma_px": 0.1,
}


@pytest.fixture(scope="session")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the runs are in."""
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="session")
def folders(home: Path) -> list[Path]:
    """Folders of two runs from different starts."""
    found = []
    for seed in (0, 1):
        folder = home / "runs" / str(seed)
        folder.mkdir(parents=True)
        vs.run_into(folder, vs.load("arm_ibvs", SETTINGS, seed), "none", report=False)
        found.append(folder)
    return found
