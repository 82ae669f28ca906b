"""Perturbations: what each does to a picture or to measured coordinates, and that a run of it
depends on nothing but the seed.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.vision.perturb import (
    PERTURBATIONS,
    ColorJitter,
    Erasing,
    Outliers,
    PerturbationBase,
    Perturbed,
    Shadow,
)

IMAGE = np.arange(60 * 80 * 3, dtype=np.uint32).reshape(60, 80, 3).astype(np.uint8)
FAST = {"detector": "oracle", "camera.rate_hz": 25.0, "stop.duration_s": 1.0}


def pictures(kind, n, seed=0):
    one = Perturbed((kind,), np.random.default_rng(seed))
    return [one.next_picture()(0.0, (IMAGE,))[0] for _ in range(n)]


class TestErasing:
    def test_rectangles_have_the_area_and_the_shape_asked_for(self):
        changed = [
            np.any(image != IMAGE, axis=2)
            for image in pictures(Erasing(probability=1.0, fill="random"), 200)
        ]
        for mask in changed:
            rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
            h, w = np.ptp(rows) + 1, np.ptp(columns) + 1
            assert 0.015 < h * w / mask.size < 0.11  # by rounding to whole pixels
            assert 0.25 < h / w < 4.0

    def test_its_probability(self):
        changed = [np.any(image != IMAGE) for image in pictures(Erasing(probability=0.3), 1000)]
        assert np.mean(changed) == pytest.approx(0.3, abs=0.05)

    def test_a_range_upside_down_is_refused(self):
        with pytest.raises(ParameterError, match=r"needs the form .smallest, largest"):
            Erasing(area=(0.4, 0.02))


class TestColorJitter:
    def test_the_factors_are_those_of_the_run_or_of_the_picture(self):
        a, b = pictures(ColorJitter(), 2)
        assert np.array_equal(a, b) and not np.array_equal(a, IMAGE)
        a, b = pictures(ColorJitter(each="picture"), 2)
        assert not np.array_equal(a, b)

    def test_brightness_alone_is_a_factor(self):
        kind = ColorJitter(brightness=0.5, contrast=0.0, saturation=0.0)
        factor = kind.begin(np.random.default_rng(3))[0]
        image = kind.picture(np.array([factor, 1, 1]), IMAGE.copy(), 0.0, np.random.default_rng(0))
        np.testing.assert_allclose(image, np.clip(factor * IMAGE.astype(float), 0, 255), atol=0.51)

    def test_no_saturation_is_grey(self):
        image = ColorJitter().picture(
            np.array([1.0, 1.0, 0.0]), IMAGE.copy(), 0.0, np.random.default_rng(0)
        )
        assert np.ptp(image.astype(int), axis=2).max() == 0


class TestShadow:
    @pytest.mark.parametrize("shape", ["band", "blob"])
    def test_it_crosses_the_picture_again_and_again(self, shape: Literal["band", "blob"]):
        kind, white = (
            Shadow(shape=shape, darkness=0.6, period_s=2.0),
            np.full((60, 80, 3), 200, np.uint8),
        )
        state = kind.begin(np.random.default_rng(1))
        seen = np.array(
            [kind.picture(state, white, t, np.random.default_rng(0)) for t in np.arange(0, 4, 0.1)],
            int,
        )
        assert np.array_equal(seen[:20], seen[20:])
        assert seen.max() == 200 and seen.min() == 80  # 40 % of 200, in its middle
        # between two crossings it is beyond the picture
        assert (seen.min(axis=(1, 2, 3)) == 200).any()
        deep = [np.mean(image[..., 0] < 200) for image in seen[:20]]
        assert 0.15 < max(deep) < 0.6
        assert np.abs(np.diff(seen[int(np.argmax(deep))], axis=1)).max() < 40  # its edge is soft

    def test_each_seed_has_its_own(self):
        one, other = (pictures(Shadow(darkness=1.0), 1, seed)[0] for seed in (0, 1))
        assert not np.array_equal(one, other)


def test_outliers_hit_their_share_of_markers_within_the_radius():
    one = Perturbed((Outliers(probability=0.2, radius_px=5.0),), np.random.default_rng(0))
    off = np.linalg.norm([one.pixels(np.zeros((4, 2)), 0.0) for _ in range(500)], axis=2)
    assert np.mean(off > 0) == pytest.approx(0.2, abs=0.03)
    assert 4.5 < off.max() <= 5.0
    assert np.isnan(one.pixels(np.full((4, 2), np.nan), 0.0)).all()  # what is not seen stays unseen


def test_the_panels_of_a_picture_are_changed_alike_and_again_alike():
    change = Perturbed((Erasing(probability=1.0),), np.random.default_rng(0)).next_picture()
    a, b, none = change(0.0, (IMAGE, IMAGE, None))
    assert none is None and np.array_equal(a, b) and np.array_equal(change(0.0, (IMAGE,))[0], a)


@pytest.mark.parametrize("name", one_quick("ibvs_book", "arm_tags"))
def test_a_run_repeats_and_does_not_depend_on_who_looks_at_the_pictures(name):
    changes = {"noise.perturb": ["color_jitter", "erasing"], "stop.duration_s": 0.4}
    scenario = vs.load(name, changes)
    first = vs.run(scenario)
    with vs.Session(scenario, pictures=True) as session:
        frame = session.reset()
        while frame.outcome is None:
            frame = session.step()
    assert np.array_equal(first.table, session.recording().table, equal_nan=True)
    other = vs.run(vs.load(name, changes | {"seed": 1}))
    assert not np.array_equal(first["u_0"], other["u_0"][: len(first.rows)], equal_nan=True)


def test_a_further_perturbation_leaves_the_other_noise_as_it_is():
    noisy = FAST | {"noise.pixel_sigma_px": 0.5}
    plain = vs.run(vs.load("ibvs_book", noisy))
    more = vs.run(
        vs.load("ibvs_book", noisy | {"noise.perturb": [{"kind": "outliers", "probability": 0.0}]})
    )
    assert np.array_equal(plain["u_0"], more["u_0"])


def test_rays_are_perturbed_too():
    small = {
        "camera.width": 500,
        "camera.height": 500,
        "camera.pixel_size_m": 2e-5,
        "camera.renderer": "rays",
        "stop.duration_s": 0.2,
    }
    plain, erased = (
        vs.run(vs.load("ibvs_book", small | {"noise.perturb": kinds}))
        for kinds in (
            [],
            [
                {"kind": "color_jitter", "each": "picture"},
                {"kind": "erasing", "area": [0.3, 0.6], "probability": 1.0},
            ],
        )
    )
    assert erased["lost"].any() or not np.array_equal(plain["u_0"], erased["u_0"], equal_nan=True)


def test_a_seed_may_draw_perturbations_alone(quick):
    fixed = {"robot.start.random": None}
    with pytest.raises(ScenarioError, match="random"):
        vs.load(quick, fixed, seed=3)
    assert vs.load(quick, fixed | {"noise.perturb": ["outliers"]}, seed=3).seed == 3
    on_pictures = vs.load(quick, {"noise.perturb": ["erasing"]}).noise
    # an oracle's
    assert on_pictures.draws(pictures=True, points=True)
    assert not on_pictures.draws(pictures=False, points=True)


def test_a_picture_of_another_shape_is_said(own_kinds):
    @PERTURBATIONS.add
    @vs.spec
    class Cropped(PerturbationBase):
        """It loses a row."""

        kind: Literal["cropped"] = "cropped"

        def picture(self, state, image, t, rng):
            return image[1:]

    with pytest.raises(
        ParameterError, match=r"cropped.*picture must return an image \(60, 80, 3\) uint8"
    ):
        pictures(Cropped(), 1)
