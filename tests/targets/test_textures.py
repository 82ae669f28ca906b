"""Bundled textures: what is there, what is said of a name that is not, and that their script draws
them.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.core.named_files import folder
from vstestbed.targets import PictureTarget
from vstestbed.targets.picture import textures

NAMES = [
    "alphabet",
    "brick",
    "clutter",
    "faint",
    "flat",
    "leaves",
    "objects",
    "poster",
    "repetitive",
    "small_print",
    "text",
]


def grey(name: str) -> np.ndarray:
    """A texture's grey levels (H, W)."""
    return np.asarray(cv2.imread(str(textures()[name]), cv2.IMREAD_GRAYSCALE), np.float32)


def test_they_are_small():
    assert list(textures()) == NAMES
    assert sum(path.stat().st_size for path in textures().values()) < 3.2e6


def test_a_picture_may_be_one_by_its_name():
    target = PictureTarget(pose=Pose(), file="texture:poster", width=0.8)
    assert target.height == pytest.approx(0.6) and target.source.name == "poster.jpg"
    with pytest.raises(
        ParameterError,
        match=(
            r"is no bundled texture;"
            r" there are texture:alphabet, .* texture:text, got 'texture:postr'"
        ),
    ):
        PictureTarget(pose=Pose(), file="texture:postr", width=0.8)


def test_they_have_the_structure_that_is_said_of_them():
    found = {
        name: len(cv2.SIFT.create().detect(grey(name).astype(np.uint8)[:400, :400]))
        for name in NAMES
    }
    assert (
        min(found[name] for name in ("poster", "brick", "clutter", "small_print")) > 300
        and grey("faint").std() < grey("leaves").std() / 5
    )
    assert found["leaves"] > 100 and found["flat"] < 5
    levels = grey("flat")
    assert np.ptp(levels) < 60 and levels.std() < 12
    tiles = grey("repetitive").reshape(12, 64, 16, 64)
    assert np.array_equal(tiles, np.broadcast_to(tiles[:1, :, :1], tiles.shape))


@pytest.mark.study
@pytest.mark.parametrize("name", NAMES)
def test_their_script_draws_them(name: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(folder("models") / "textures"))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    import make  # type: ignore[import-not-found]  # a script beside the textures

    there = np.asarray(cv2.imread(str(Path(textures()[name]))), int)
    apart = np.abs(make.drawn(name).astype(int) - there)
    assert apart.mean() < 6 and np.mean(apart > 60) < 0.005  # the file is compressed
