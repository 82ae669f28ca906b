"""Feedforward between frames: how long an unseen target is followed."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.features.observation import Observation, OwnMotion
from vstestbed.laws.feedforward import AlphaBeta, NoFeedforward, Trend
from vstestbed.laws.following import NOTHING, Followed, coast

BASIS = np.eye(6)
RATE = np.array([0.1, 0.0, -0.2, 0.0, 0.05, 0.0])


def unseen(t: float, motion: bool = True) -> Observation:
    own = OwnMotion(twist=np.zeros(6), since_s=0.04, moved=np.zeros(6), age_s=0.0, commanded=np.zeros(6)) if motion else None
    return Observation(t, np.full((4, 2), np.nan), np.full((4, 2), np.nan), np.full(4, np.nan), motion=own)


def followed(t: float = 2.0) -> Followed:
    return Followed(t=t, trend=Trend(np.stack([np.zeros(6), RATE]), np.zeros(6), np.eye(2)))


@pytest.mark.parametrize(("after_s", "goes_on"), [(0.04, True), (0.97, True), (1.0, True), (1.04, False), (5.0, False)])
def test_an_unseen_target_is_followed_for_a_second(after_s: float, goes_on: bool):
    coasted = coast(AlphaBeta(), followed(), unseen(2.0 + after_s), BASIS)
    assert (coasted is not None) is goes_on
    if coasted is not None:
        memory, u = coasted
        np.testing.assert_allclose(u, -RATE)
        assert memory.t == 2.0 and memory.seen is None  # the second counts from the last sight, not from the last frame


def test_without_an_estimate_the_camera_rests():
    assert coast(NoFeedforward(), followed(), unseen(2.04), BASIS) is None
    assert coast(AlphaBeta(), NOTHING, unseen(0.0), BASIS) is None
    assert coast(AlphaBeta(), followed(), unseen(2.04, motion=False), BASIS) is None
