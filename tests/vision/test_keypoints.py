"""The detector of natural features: rows, goals, identities; with which laws it runs, and what is
refused.
"""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from tests.vision.views import CAMERA, GOAL_H, goal, homography_of, picture_by, places
from vstestbed.camera import Picture
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import Array
from vstestbed.features.observation import Goal, Observation, Sight
from vstestbed.laws import IBVS
from vstestbed.laws.error_law import ErrorState
from vstestbed.laws.feedforward import KalmanCV
from vstestbed.laws.points import reckoned_markers
from vstestbed.loop.controller import detail
from vstestbed.vision import Keypoints, keypoints
from vstestbed.vision.keypoints import Klt, Slots, followed
from vstestbed.vision.local_features import Orb, extracted
from vstestbed.vision.observe import FlowState

T_GOAL = np.eye(4)
T_GOAL[2, 3] = 0.61
SMALL = {
    "camera.width": 320,
    "camera.height": 240,
    "detector.features": {"kind": "orb", "most": 400},
}
TARGET = vs.load("camera_keypoints").target
RNG = np.random.default_rng(0)


def the_goal() -> Goal:
    return replace(Goal.from_view(CAMERA, TARGET.points, T_GOAL), image=Sight(goal()))


def seen(detector: Keypoints, state: Any, H: Array, sigma: float = 2.0) -> Any:
    return detector.detect(state, Picture(0.0, (picture_by(H, sigma),)), None, CAMERA, TARGET, RNG)


def begun(detector: Keypoints) -> Any:
    return detector.begin(the_goal(), CAMERA, TARGET)


def begun_with(few: int, detector: Keypoints) -> Any:
    """`begun` where the goal's picture has few key points."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            keypoints, "extracted", lambda *given: tuple(part[:few] for part in extracted(*given))
        )
        return begun(detector)


ROLLED = homography_of((0.06, -0.05, -0.7), (5, 8, 40))


@pytest.mark.parametrize(
    "detector",
    [
        Keypoints(features=Orb(most=400)),
        Keypoints(features=Orb(most=400), best=12, choose="distance"),
    ],
)
def test_the_rows_show_points_of_the_goal_s_picture_with_their_depths_there(detector: Keypoints):
    _, detection = seen(detector, begun(detector), ROLLED)
    there = detection.seen
    assert detection.uv.shape == (detector.best, 2) and there.sum() >= 0.7 * detector.best
    error = np.linalg.norm(detection.uv - places(ROLLED, detection.goal.uv), axis=1)[there]
    assert np.median(error) < 0.06 and error.max() < 0.4
    np.testing.assert_allclose(detection.goal.depth[there], 0.61, atol=1e-9)
    assert (detection.ids[there] >= 0).all() and (detection.ids[~there] == -1).all()
    again = seen(detector, begun(detector), ROLLED)[1]
    np.testing.assert_array_equal(again.uv, detection.uv)  # random samples are seeded


def test_points_are_followed_and_matched_again_now_and_then():
    detector = Keypoints(features=Orb(most=400), track=Klt(redetect_every=3))
    state, ids = begun(detector), []
    for k in range(5):
        H = homography_of((0.02 + 0.004 * k, 0.01, -0.63), (1, 2, 5 + 0.5 * k))
        state, detection = seen(detector, state, H)
        ids.append(detection.ids)
        error = np.linalg.norm(detection.uv - places(H, detection.goal.uv), axis=1)
        assert detection.seen.sum() > 12 and np.nanmedian(error) < 0.06, k
    stays = [np.mean(np.isin(a[a >= 0], b)) for a, b in pairwise(ids)]
    assert min(stays) > 0.7 and (ids[1] == np.where(ids[1] >= 0, ids[0], -1)).all()


def test_an_empty_picture_shows_nothing_and_keeps_what_the_rows_were():
    detector = Keypoints(features=Orb(most=400))
    state, before = seen(detector, begun(detector), GOAL_H)
    empty = Picture(0.0, (np.full((240, 320, 3), 128, np.uint8),))
    state, detection = detector.detect(state, empty, None, CAMERA, TARGET, RNG)
    assert detection.goal is not None and np.isnan(detection.uv).all()
    np.testing.assert_array_equal(detection.ids, before.ids)
    np.testing.assert_array_equal(detection.goal.uv, before.goal.uv)
    assert seen(detector, state, GOAL_H)[1].seen.sum() > 12


def test_few_points_are_those_whose_patches_are_whole_and_without_patches_the_reason_says_so():
    """Spread over the picture, the first ones are at its border, where patches are cut."""
    detector = Keypoints(features=Orb(most=400), best=5, track=Klt())
    # 4 of 5 will do, since `keep` is the user's alone
    assert not detector._due(Slots.empty(5).placed(*np.zeros((2, 4, 2))), 1)
    state, detection = seen(detector, begun(detector), GOAL_H)
    assert detection.seen.all() and not detection.why
    for uv in (detection.uv, detection.goal.uv):
        assert (uv > 10).all() and (uv < [309, 229]).all()
    blurred = replace(
        state,
        smooth=np.random.default_rng(0).normal(128, 40, (240, 320)).astype(np.float32),
        last=None,
    )
    detection = seen(detector, blurred, GOAL_H)[1]
    assert not detection.seen.any()
    sentence = detail(
        vs.load("camera_keypoints"),
        observed(detection.uv, list(detection.ids)),
        True,
        detection.why,
    )
    words = (
        r"^ \(detector keypoints: \d+ points match the goal's picture,"
        r" of which \d+ agree with one plane; of those tried the patches of 0 "
    )
    assert re.search(words, sentence)
    sentence = detail(
        vs.load("camera_keypoints"), observed(detection.uv, list(detection.ids)), False
    )
    assert sentence.endswith(
        "too little of it, or from too far aside, or too few points of it are looked for)"
    )
    noise = np.random.default_rng(1).integers(0, 255, (240, 320, 3), np.uint8)
    picture = Picture(0.0, (noise,))
    detection = detector.detect(begun(detector), picture, None, CAMERA, TARGET, RNG)[1]
    assert re.search(
        (
            r"\d+ points match the goal's picture, of which 0 agree with one plane:"
            r" the target may have too little"
        ),
        detection.why,
    )


def test_only_the_board_s_points_count_where_that_is_asked_for():
    near = replace(TARGET, width=0.2)  # of the poster in the picture its middle alone
    on_board, anywhere = (
        Keypoints(features=Orb(most=400), within="board", best=100),
        Keypoints(features=Orb(most=400), best=100),
    )
    for detector, outside in ((on_board, False), (anywhere, True)):
        state = detector.begin(
            replace(Goal.from_view(CAMERA, near.points, T_GOAL), image=Sight(goal())), CAMERA, near
        )
        _, detection = detector.detect(state, Picture(0.0, (goal(),)), None, CAMERA, near, RNG)
        assert detection.goal is not None
        xy = (detection.goal.ray * detection.goal.range[:, None])[detection.seen, :2]
        assert (np.abs(xy) > [0.1, 0.075]).any() == outside


def test_what_cannot_work_is_refused_with_a_sentence():
    flat = replace(the_goal(), image=Sight(np.full((240, 320, 3), 90, np.uint8)))
    with pytest.raises(
        ParameterError,
        match=(
            "must find least = 4 key points or more in the goal's picture:"
            " sift finds 0; use a target"
        ),
    ):
        Keypoints(ransac="none").begin(flat, CAMERA, TARGET)
    edge_on = replace(
        the_goal(),
        T_camera_target=np.array([[0.0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 0.6], [0, 0, 0, 1]]),
    )
    with pytest.raises(
        ParameterError,
        match=r"orb finds \d\d+, of which 0 have a depth there; use a goal that shows more",
    ):
        Keypoints(features=Orb()).begin(edge_on, CAMERA, TARGET)
    with pytest.raises(
        ParameterError,
        match=r"of which 0 lie on the target's board; use a goal that shows it larger",
    ):
        # its plane alone is in the picture
        far = T_GOAL + np.array([[0, 0, 0, 3.0], *np.zeros((3, 4))])
        Keypoints(features=Orb(), within="board").begin(
            replace(the_goal(), T_camera_target=far), CAMERA, TARGET
        )
    with pytest.raises(ParameterError, match="compares with the picture taken at the goal"):
        Keypoints().begin(replace(the_goal(), image=None), CAMERA, TARGET)
    with pytest.raises(
        ParameterError, match="may not be board with target mesh, which has none; works: picture"
    ):
        Keypoints(within="board").begin(the_goal(), CAMERA, vs.load("arm_mesh").target)
    with pytest.raises(ParameterError, match="at most best = 24"):
        Keypoints(least=30)
    with pytest.raises(ParameterError, match="at most best = 8"):
        Keypoints(best=8, track=Klt(keep=12))
    with pytest.raises(ParameterError, match="needs one whole picture"):
        Keypoints().detect(begun(Keypoints()), None, None, CAMERA, TARGET, RNG)


def test_the_goal_s_picture_must_have_as_many_key_points_as_tell_a_plane():
    orb, words = (
        Orb(most=400),
        "must find {} in the goal's picture: orb finds {}; use a target with more texture",
    )
    plane = words.format("8 key points or more, as many as tell a plane,", 6) + ", or ransac: none$"
    with pytest.raises(ParameterError, match=plane):
        begun_with(6, Keypoints(features=orb))
    with pytest.raises(ParameterError, match=words.format("least = 9 key points or more", 8) + "$"):
        begun_with(8, Keypoints(features=orb, least=9))
    for few, detector in [
        (8, Keypoints(features=orb)),
        (6, Keypoints(features=orb, ransac="none", subpixel=False)),
    ]:
        assert seen(detector, begun_with(few, detector), GOAL_H, sigma=0.0)[1].seen.sum() >= 4


THREE = {"detector.best": 3, "detector.least": 3}


def test_three_points_will_do_where_no_pose_is_needed():
    assert vs.load("camera_keypoints", THREE | {"law.depth": "goal"}).rows == 3


def test_laws_and_cameras_that_need_markers_are_refused():
    for changes, words in (
        ({"law.depth": "estimate"}, "or let it follow its points"),
        (
            {"law": "partitioned"},
            "law: may not be partitioned: it needs the same markers in every picture",
        ),
        (
            {"law": "uncalibrated", "detector.track": "klt"},
            "may not be uncalibrated: it needs the same markers",
        ),
        (
            {"law.feature": "polygon", "law.redundant": True},
            (
                r"law\.feature: may not be polygon: it is made of several markers together, .*;"
                r" use point, polar or spherical"
            ),
        ),
        (
            {"law.visibility": {"margin_px": 20}},
            (
                r"law\.visibility\.margin_px: keeps points from the border or a plane, .*;"
                r" works: law\.visibility\.margin_px: 0"
            ),
        ),
        ({"camera": {"kind": "spherical"}}, "with a camera that sees all round"),
        (
            THREE,
            (
                r"detector\.best: must be at least 4 where the target's pose is needed, .*;"
                r" works: 4, or law\.depth goal or sensor, got 3"
            ),
        ),
        (
            THREE | {"law": "pbvs"},
            (
                r"detector\.best: must be at least 4 where the target's pose is needed,"
                r" .*; works: 4, got 3"
            ),
        ),
    ):
        with pytest.raises(ScenarioError, match=words):
            vs.load("camera_keypoints", changes)


LAWS: dict[str, dict[str, Any]] = {
    "ibvs": {"law.gain": 2, "detector.track": "none"},
    "feedforward": {"law.gain": 2, "law.feedforward": "kalman_cv"},
    "estimate": {"law.gain": 2, "law.depth": {"kind": "estimate", "initial_m": 0.8}},
    "desired": {"law": {"kind": "ibvs", "gain": 2, "interaction": "desired", "depth": "goal"}},
    "pbvs": {"law": {"kind": "pbvs", "gain": 2}},
    "hybrid": {"law": {"kind": "hybrid", "gain": 2}},
    "qp": {"law": {"kind": "qp", "law": {"kind": "ibvs", "gain": 2}, "margin_px": None}},
    "predictive": {"law": {"kind": "predictive", "margin_px": None}},
    "switched": {
        "law": {
            "kind": "switched",
            "laws": [{"law": {"kind": "ibvs", "gain": 2}, "until": {"error_under_px": 40}}, "pbvs"],
        }
    },
}


@pytest.mark.parametrize("name", one_quick(*LAWS))
def test_laws_take_what_points_there_are(name: str):
    short = {
        "stop.duration_s": 0.6,
        "robot.start.nominal.rpy_deg": [2, -3, 10],
        "detector.track": "klt",
    }
    s = vs.load("camera_keypoints", SMALL | short | LAWS[name])
    r = vs.run(s)
    assert not r["lost"].any() and r["position_error_m"][-1] < 0.6 * r["position_error_m"][0]
    at = [f"u_{i}" for i in range(s.rows)]
    off = np.abs(
        np.column_stack([r[n] for n in at])
        - np.column_stack([r[n.replace("u_", "u_true_")] for n in at])
    )
    assert np.nanmedian(off) < 0.08


def observed(xy: Array, ids: list[int]) -> Observation:
    return Observation(0.0, 100 * xy, xy, np.ones(len(xy)), ids=np.array(ids))


def test_what_a_row_showed_before_counts_only_while_it_shows_the_same_point():
    rng = np.random.default_rng(0)
    xy = rng.uniform(-0.3, 0.3, (8, 2))
    before, other = observed(xy, list(range(8))), xy.copy()
    other[3] += 0.2  # another point in this row
    now = observed(other, [0, 1, 2, 30, 4, 5, 6, 7])
    state = ErrorState(
        np.zeros(0),
        seen=before,
        known_t=0.0,
        marker_t=np.zeros(8),
        target=KalmanCV().update(None, None, 0.1, 6),
    )
    change = IBVS()._change(
        state, now, Goal.of_points(CAMERA, np.column_stack([xy, np.ones(8)]), T_GOAL), np.eye(6)
    )
    assert change is not None and change[0].shape == (14,) and np.abs(change[0]).max() < 1e-12
    lost = other.copy()
    lost[[3, 5]] = np.nan
    carried = reckoned_markers(
        observed(lost, [0, 1, 2, 30, 4, 5, 6, 7]),
        before,
        np.eye(4),
        np.full(8, 0.04),
        0.3,
        np.eye(6),
    )
    np.testing.assert_allclose(carried.xy[5], xy[5], atol=1e-9)
    assert np.isnan(carried.xy[3]).all()
    flow = FlowState(np.arange(3.0), np.ones(3), np.ones((3, 3)), 0.0, np.array([4, 5, 6])).of(
        np.array([4, 9, 6])
    )
    assert (
        np.isnan(flow.inverse_range[1])
        and flow.inverse_range[2] == 2.0
        and flow.information.tolist() == [1, 0, 1]
    )


@pytest.mark.parametrize("ransac", ["homography", "essential", "none"])
def test_points_that_were_followed_astray_are_dropped_as_wrong_matches_are(
    ransac: Any, monkeypatch: pytest.MonkeyPatch
):
    """Lucas-Kanade is made to lead six points 15 px aside; the epipolar constraint misses those
    that went along their line.
    """
    detector = Keypoints(
        features=Orb(most=400), track=Klt(redetect_every=50), ransac=ransac, subpixel=False
    )
    there = homography_of((0.03, 0.01, -0.61), (0, 0, 0))
    state, before = seen(detector, begun(detector), there)
    rows = np.flatnonzero(before.seen)[:6]
    angle = np.arange(6.0)

    def astray(*given: Any) -> Array:
        uv = followed(*given)
        uv[rows] += 15 * np.column_stack([np.cos(angle), np.sin(angle)])
        return uv

    monkeypatch.setattr(keypoints, "followed", astray)
    after = seen(detector, state, there)[1].seen
    assert (
        after[rows].sum() <= {"homography": 0, "essential": 2, "none": 6}[ransac]
        and after.sum() > 12
    )
    assert ransac != "none" or after[rows].all()
