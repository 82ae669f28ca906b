"""What a law leaves to a secondary task: the error's norm decreases as without one, near the goal
the null space alone is free.
"""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose, exp, transform
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import IBVS, Command
from vstestbed.laws.ibvs import Classical, Large, Projection
from vstestbed.targets import Square

CAMERA, POINTS = Perspective(), Square(side=0.5, pose=Pose()).points
GOAL = Goal.from_view(CAMERA, POINTS, Pose(xyz=(0, 0, 1)).T)
FAR, CLOSE = Pose(xyz=(0.2, -0.1, 1.6), rpy_deg=(10, -15, 30)).T, Pose(xyz=(0.005, 0, 1.01)).T
BETWEEN = Pose(xyz=(0.06, 0, 1)).T
WANTED = np.array([0.3, -0.2, 0.1, 0.2, 0.4, -0.3])


def view(T: np.ndarray) -> Observation:
    p = transform(T, POINTS)
    uv = CAMERA.project(p)
    return Observation(0.0, uv, CAMERA.normalise(uv), p[:, 2], T)


def command(projection: Projection, T: np.ndarray) -> Command:
    law = IBVS(redundant=True, projection=projection)
    return law.step(law.init(GOAL), view(T), GOAL, np.eye(6))[1]


def secondary(made: Command) -> np.ndarray:
    """The secondary task of a robot whose joints are the camera's motions: `WANTED`, projected
    orthogonally.
    """
    return sum(
        (
            share * np.linalg.qr(twists)[0] @ (np.linalg.qr(twists)[0].T @ WANTED)
            for share, twists in made.free
        ),
        np.zeros(6),
    )


def test_the_norm_of_the_error_decreases_as_without_a_secondary_task():
    made = command(Large(), FAR)
    aside = secondary(made)
    assert np.linalg.norm(aside) > 0.5 * np.linalg.norm(WANTED)

    def rate(twist: np.ndarray) -> float:
        h = 1e-5
        after, before = (
            np.linalg.norm(view(exp(-sign * twist * h) @ FAR).xy - GOAL.xy) for sign in (1, -1)
        )
        return float(after - before) / (2 * h)

    alone = rate(made.twist)
    assert alone < -0.1
    assert rate(made.twist + aside) == pytest.approx(alone, rel=1e-6)
    assert rate(made.twist + WANTED) != pytest.approx(alone, rel=0.1)


@pytest.mark.parametrize("T", [FAR, BETWEEN, CLOSE], ids=["far", "between", "close"])
def test_the_projector_is_that_of_the_paper(T: np.ndarray):
    projection = Large()
    law, o = IBVS(), view(T)
    e, L = law.equations(o, GOAL)
    share = projection.share(np.linalg.pinv(L) @ e)
    of_norm = np.eye(6) - np.outer(L.T @ e, L.T @ e) / (e @ L @ L.T @ e)
    P = share * of_norm + (1 - share) * (np.eye(6) - np.linalg.pinv(L) @ L)
    np.testing.assert_allclose(secondary(command(projection, T)), P @ WANTED, atol=1e-9)
    assert (share == 1, share == 0) == (T is FAR, T is CLOSE)


def test_near_the_goal_it_is_the_classical_one():
    for T in (CLOSE, GOAL.T_camera_target):
        large, classical = command(Large(), T), command(Classical(), T)
        assert len(large.free) == 1 and large.free[0][0] == 1
        np.testing.assert_array_equal(large.free[0][1], classical.free[0][1])
    assert not secondary(command(Classical(), FAR)).any()


def test_the_share_grows_smoothly_from_near_to_far():
    shares = [
        Large(near=0.1, far=0.3).share(np.array([0.0, -x, 0.0]))
        for x in (0.0, 0.1, 0.1001, 0.2, 0.2999, 0.3, 5.0)
    ]
    assert shares[:2] == [0, 0] and shares[-2:] == [1, 1] and shares[3] == pytest.approx(0.5)
    assert 0 < shares[2] < 1e-3 and 1 - 1e-3 < shares[4] < 1


def test_what_makes_no_sense_is_refused():
    with pytest.raises(ParameterError, match=r"^near must be under far = 0.1"):
        Large(near=0.2)
    with pytest.raises(ParameterError, match="redundant: true"):
        IBVS(projection=Large())
