"""Matches of a poster under known homographies:
which are found, how exactly, and what is refused.
"""

from __future__ import annotations

from typing import Any, Literal

import cv2
import numpy as np
import pytest

import vstestbed as vs
from tests.vision.views import CAMERA, goal, homography_of, picture_by, places
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose, transform
from vstestbed.core.registry import REGISTRIES, SPECS
from vstestbed.vision.keypoints import (
    Klt,
    Slots,
    followed,
    map_derivatives,
    of_one_motion,
    planar_map,
    refined,
    smooth,
    spread_out,
)
from vstestbed.vision.local_features import (
    Akaze,
    Orb,
    Sift,
    brightness,
    extracted,
    matched,
    mutual_matches,
)

TURNED = homography_of((0.05, -0.04, -0.65), (6, -10, 120))
ROUGH = {"sift": 0.25, "orb": 1.3}
"""Largest median error of a kind's matches [px]."""


def test_of_one_motion_are_the_pairs_that_obey_its_epipolar_constraint():
    """60 points in space that a camera sees from two places, and 20 pairs that are wrong: E = [t]x
    R is not given.
    """
    rng = np.random.default_rng(3)
    p = rng.uniform((-0.4, -0.3, 0.8), (0.4, 0.3, 1.6), (80, 3))
    T = Pose(xyz=(0.1, -0.05, 0.02), rpy_deg=(4, -6, 20)).T
    uv_goal, uv = CAMERA.project(p), CAMERA.project(transform(T, p))
    uv[60:] += rng.choice([-1, 1], (20, 2)) * rng.uniform(30, 90, (20, 2))
    agree = of_one_motion(CAMERA, uv_goal, uv, 1.0)
    # a wrong pair may lie on its line by chance
    assert agree is not None and agree[:60].all() and np.count_nonzero(agree[60:]) <= 3
    again = of_one_motion(CAMERA, uv_goal, uv, 1.0)
    assert again is not None and np.array_equal(agree, again)
    assert of_one_motion(CAMERA, uv_goal[:4], uv[:4], 1.0) is None


@pytest.mark.parametrize("features", [Sift(most=400), Orb(most=400)], ids=lambda f: f.kind)
def test_features_find_their_places_again_and_patches_measure_them_below_a_pixel(features: Any):
    image = picture_by(TURNED, sigma=2.0)
    (uv_goal, a), (uv_now, b) = extracted(features, goal()), extracted(features, image)
    i, j, distance = mutual_matches(a, b)
    assert (np.diff(distance) >= 0).all()
    found = planar_map(CAMERA, uv_goal[i], uv_now[j], 2.0)
    assert found is not None
    plane, agree = found
    off = np.linalg.norm(uv_now[j] - places(TURNED, uv_goal[i]), axis=1)
    assert np.count_nonzero(agree) > 40 and (off[agree] < 4).all() and not agree[off > 6].any()
    assert np.median(off[agree]) < ROUGH[features.kind]
    k = np.flatnonzero(agree)[spread_out(uv_goal[i][agree], 24)]
    at, uv = uv_goal[i][k], uv_now[j][k]
    fine = refined(
        smooth(brightness(goal())),
        smooth(brightness(image)),
        at,
        uv,
        map_derivatives(CAMERA, plane, at),
    )
    error = np.linalg.norm(fine - places(TURNED, at), axis=1)
    assert (
        np.isfinite(error).sum() >= 15
        and np.nanmedian(error) < 0.06
        and np.nanquantile(error, 0.9) < 0.25
    )


def test_sift_has_no_offset_under_a_rotation():
    H = homography_of((0, 0, -0.61), (0, 0, 120))
    (uv_goal, a), (uv, b) = Sift(most=400).extract(goal()), Sift(most=400).extract(picture_by(H))
    i, j, _ = mutual_matches(a, b)
    off = uv[j] - places(H, uv_goal[i])
    off = off[np.linalg.norm(off, axis=1) < 2]
    assert len(off) > 60 and np.linalg.norm(off.mean(axis=0)) < 0.1  # with OpenCV's default .6


@pytest.mark.parametrize("bits", [False, True])
def test_mutual_matches_are_those_of_a_brute_force_matcher(bits: bool):
    rng = np.random.default_rng(1)
    a = rng.integers(0, 256, (60, 32)).astype(np.uint8 if bits else np.float32)
    b = rng.integers(0, 256, (80, 32)).astype(a.dtype)
    b[:20] = a[40:] if bits else a[40:] + rng.integers(-5, 6, (20, 32))
    i, j, distance = mutual_matches(a, b)
    norm = cv2.NORM_HAMMING if bits else cv2.NORM_L2
    expected = sorted(
        (m.queryIdx, m.trainIdx, m.distance)
        for m in cv2.BFMatcher(norm, crossCheck=True).match(a, b)
    )
    order = np.argsort(i)
    assert [(int(x), int(y)) for x, y in zip(i[order], j[order], strict=True)] == [
        m[:2] for m in expected
    ]
    np.testing.assert_allclose(distance[order], [m[2] for m in expected], rtol=1e-5, atol=1e-3)
    sure = mutual_matches(a, b, ratio=0.6)[0]
    assert set(range(40, 60)) <= set(sure.tolist()) and len(sure) < len(i)
    assert all(len(part) == 0 for part in mutual_matches(a[:0], b))


def test_the_map_of_a_plane_holds_for_a_lens_with_distortion_and_among_wrong_matches():
    rng = np.random.default_rng(0)
    lens = vs.camera.Fisheye(width=320, height=240)
    p = np.column_stack([rng.uniform(-0.4, 0.4, (80, 2)), np.full(80, 0.8)])
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([0.1, -0.2, 0.8]))[0]
    T[:3, 3] = 0.05, 0.02, 0.1
    uv_goal, uv = lens.project(p), lens.project(p @ T[:3, :3].T + T[:3, 3])
    wrong = uv.copy()
    wrong[:30] += rng.uniform(8, 40, (30, 2))
    found = planar_map(lens, uv_goal, wrong, 1.0)
    assert found is not None
    plane, agree = found

    def there(at: np.ndarray) -> np.ndarray:
        return lens.project(lens.ray(at) @ plane.T)

    assert not agree[:30].any() and agree[30:].all()
    np.testing.assert_allclose(there(uv_goal), uv, atol=0.02)
    slope = np.stack(
        [(there(uv_goal + s) - there(uv_goal - s)) / 2e-3 for s in 1e-3 * np.eye(2)], axis=-1
    )
    np.testing.assert_allclose(map_derivatives(lens, plane, uv_goal), slope, atol=2e-3)
    assert planar_map(lens, uv_goal[:7], uv[:7], 1.0) is None


def test_a_patch_that_is_covered_or_cut_by_the_border_has_no_place():
    dim = smooth(brightness(goal()))
    uv = np.array([[100.0, 100.0], [200.0, 120.0], [5.0, 100.0]])
    covered = brightness(goal()).copy()
    covered[105:135, 185:215] = np.random.default_rng(0).integers(0, 255, (30, 30))
    found = refined(dim, smooth(covered), uv, uv + 0.7, np.tile(np.eye(2), (3, 1, 1)))
    np.testing.assert_allclose(found[0], uv[0], atol=0.02)
    assert np.isnan(found[1:]).all()


def test_points_are_followed_until_they_are_hidden():
    before = brightness(goal())
    now = np.roll(before, (3, -5), axis=(0, 1))
    now[90:140, 130:180] = 90
    uv = cv2.goodFeaturesToTrack(before[20:220, 20:300], 400, 0.001, 6)[:, 0].astype(float) + 20
    found = followed(Klt(), before, now, np.vstack([uv, [[np.nan, np.nan]]]))
    assert np.isnan(found[-1]).all()
    hidden = ((uv + [-5, 3] > [135, 95]) & (uv + [-5, 3] < [175, 135])).all(axis=1)
    kept = np.isfinite(found[:-1, 0])
    assert hidden.any() and not kept[hidden].any() and kept[~hidden].mean() > 0.8
    assert np.median(np.linalg.norm(found[:-1][kept] - uv[kept] - [-5, 3], axis=1)) < 0.02


def test_a_point_keeps_its_row_and_number_while_it_is_there():
    a, b, c, d = np.eye(4)[:, :2] + np.arange(4)[:, None]
    first = Slots.empty(3).placed(np.array([a, b]), np.zeros((2, 2)))
    assert first.ids.tolist() == [0, 1, -1] and np.isnan(first.uv[2]).all()
    second = first.placed(np.array([c, b, d]), np.ones((3, 2)))
    assert second.ids.tolist() == [2, 1, 3] and (second.uv_goal[1] == b).all()
    moved = second.moved(np.array([[1.0, 2.0], [np.nan, np.nan], [3.0, 4.0]]))
    assert moved.ids.tolist() == [2, -1, 3] and np.isnan(moved.uv_goal[1]).all()
    # One that comes back is another: what was learnt of it over time has a gap.
    assert moved.placed(np.array([b]), np.zeros((1, 2))).ids.tolist() == [4, -1, -1]


def test_akaze_works_where_opencv_has_it_and_is_refused_where_not():
    if hasattr(cv2, "xfeatures2d"):
        uv, descriptors = Akaze(most=200).extract(goal())
        assert len(uv) == len(descriptors) > 50 and descriptors.dtype == np.uint8
    else:
        with pytest.raises(
            ParameterError, match="use sift or orb, or install opencv-contrib-python-headless"
        ):
            Akaze()


class Given:
    """Features that give what they are told to."""

    kind = "given"

    def __init__(self, given: Any):
        self.given = given

    def extract(self, image: Any) -> Any:
        return self.given

    def match(self, goal_image: Any, image: Any) -> Any:
        return self.given


def test_wrong_output_of_a_plugin_is_refused_with_a_sentence():
    for given, words in (
        (np.zeros((3, 2)), r"extract of .* must return \(uv, descriptors\), got 'ndarray'"),
        ((np.zeros((3, 3)), np.zeros((3, 8))), r"uv of shape \(M, 2\), pixels, got \(3, 3\)"),
        (
            (np.zeros((3, 2)), np.zeros((4, 8))),
            r"descriptors of shape \(3, D\), a row for each point, got \(4, 8\)",
        ),
        (
            (np.full((3, 2), np.nan), np.zeros((3, 8))),
            "uv that are finite; leave out points that were not found",
        ),
        ((np.zeros((3, 2)), np.full((3, 8), np.inf)), "descriptors that are finite"),
    ):
        with pytest.raises(ParameterError, match=words):
            extracted(Given(given), goal())


def test_a_matcher_s_output_is_checked_too():
    pairs = np.zeros((3, 2)), np.ones((3, 2)), np.arange(3)
    assert [len(part) for part in matched(Given(pairs), goal(), goal())] == [3, 3, 3]
    with pytest.raises(ParameterError, match="of as many pairs"):
        matched(Given((*pairs[:2], np.arange(2))), goal(), goal())
    with pytest.raises(ParameterError, match="distances that are finite"):
        matched(Given((*pairs[:2], np.full(3, np.nan))), goal(), goal())


def test_a_kind_without_a_method_is_refused_when_it_is_registered():
    specs, members = len(SPECS), dict(vs.KEYPOINTS.members)

    @vs.spec
    class Nothing:
        kind: Literal["nothing"] = "nothing"

    with pytest.raises(
        ParameterError,
        match=r"Nothing lacks extract\(image\), which gives \(uv, descriptors\), or match",
    ):
        vs.KEYPOINTS.add(Nothing)
    del SPECS[specs:]
    assert vs.KEYPOINTS.members == members and any(room is vs.KEYPOINTS for room in REGISTRIES)


def test_well_spread_points_begin_with_those_that_stay():
    uv = np.random.default_rng(0).uniform(0, 100, (50, 2))
    index = spread_out(uv, 10, first=3)
    assert index[:3].tolist() == [0, 1, 2] and len(set(index.tolist())) == 10
    assert len(spread_out(np.vstack([uv[:2], uv[:2]]), 4)) == 2
