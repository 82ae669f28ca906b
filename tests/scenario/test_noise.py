"""Changes of the target's own picture: what they are, that the seed alone draws them, and what is
refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ScenarioError
from vstestbed.core.geometry import Array
from vstestbed.targets import Target
from vstestbed.targets.picture import SHARE

GREY = 140


def shown(target: Target) -> Array:
    """The picture as it is drawn, red first, without its margin."""
    assert target.sheet is not None
    image = np.asarray(
        cv2.imdecode(np.frombuffer(target.sheet.png, np.uint8), cv2.IMREAD_COLOR_RGB)
    )
    return image[: round(image.shape[0] * SHARE), : round(image.shape[1] * SHARE)].astype(float)


@pytest.fixture
def plain(tmp_path: Path) -> str:
    """A grey picture of the size of a texture without its margin, so that its pixels are those that
    are drawn.
    """
    assert cv2.imwrite(str(tmp_path / "plain.png"), np.full((224, 448, 3), GREY, np.uint8))
    return str(tmp_path / "plain.png")


def scenario(file: str, noise: dict[str, Any], seed: int = 3) -> vs.Scenario:
    return vs.load("camera_vitvs", {"target.file": file, "noise.target": noise, "seed": seed})


def test_off_it_is_the_very_target(plain: str):
    s = scenario(plain, {})
    assert s.target_in_run is s.target and not s.noise.draws(pictures=True, points=True)


def test_noise_of_the_picture_has_its_standard_deviation_and_no_bias(plain: str):
    s = scenario(plain, {"image_sigma": 12.75})
    off = shown(s.target_in_run) - GREY
    # 3e5 samples; rounding adds 0.03 %
    assert off.std() == pytest.approx(12.75, rel=0.01) and abs(off.mean()) < 0.1
    # each pixel of the file by itself
    assert abs(np.corrcoef(off[:-1].ravel(), off[1:].ravel())[0, 1]) < 0.01
    assert s.noise.draws(pictures=True, points=True) and (shown(s.target) == GREY).all()


def test_kinds_act_in_their_order_and_the_noise_last(plain: str):
    jitter = {"kind": "color_jitter", "brightness": 0.4, "contrast": 0.3, "saturation": 0}
    patch = {"kind": "erasing", "probability": 1, "area": [0.1, 0.1]}
    first, last = (
        shown(scenario(plain, {"perturb": kinds}).target_in_run)
        for kinds in ([patch, jitter], [jitter, patch])
    )
    for image in (first, last):
        levels, counts = np.unique(image[..., 0], return_counts=True)
        assert len(levels) == 2 and counts.min() / counts.sum() == pytest.approx(0.1, abs=0.01)
    noisy = shown(scenario(plain, {"perturb": [patch, jitter], "image_sigma": 5}).target_in_run)
    assert np.std((noisy - first)[first[..., 0] == np.unique(first)[0]]) == pytest.approx(
        5, rel=0.05
    )


def test_the_seed_alone_draws_it(plain: str):
    noise = {"perturb": ["erasing", "color_jitter"], "image_sigma": 3}
    one, again, other = (shown(scenario(plain, noise, seed).target_in_run) for seed in (3, 3, 4))
    assert np.array_equal(one, again) and not np.array_equal(one, other)


def test_a_detector_that_knows_the_picture_knows_the_clean_one(plain: str):
    s = scenario(plain, {"image_sigma": 30})
    assert (
        s.target_in_run.source == s.target.source
        and s.target_in_run.sheet.png != s.target.sheet.png
    )


def test_what_has_no_picture_or_changes_none_is_refused():
    for settings, words in (
        (
            {"target": {"kind": "square", "side": 0.3, "pose": {"xyz": [0, 0, 0]}}},
            "a square has none; works: target picture, or noise.perturb",
        ),
        ({"noise.target.perturb": ["outliers"]}, "works: erasing, color_jitter, shadow"),
    ):
        with pytest.raises(ScenarioError, match=words):
            vs.load("camera_vitvs", {"noise.target.image_sigma": 5, **settings})
