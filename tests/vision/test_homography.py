"""Two views of a plane: rotation and scaled depth out of pixels, exact without noise, near the goal
and at half turns too.
"""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.geometry import Array, Pose, exp, rotation_angle, transform
from vstestbed.targets.base import Square
from vstestbed.vision.homography import homography, left_open, relative_view

POINTS = Square(side=0.5, pose=Pose()).points
GOAL = Pose(xyz=(0.05, 0.02, 1), rpy_deg=(5, -10, 3)).T
RNG = np.random.default_rng(7)


def project(T: Array) -> Array:
    p = transform(T, POINTS)
    return p[:, :2] / p[:, 2:]


def compare(T: Array, xy: Array | None = None) -> tuple[float, float]:
    """Errors of the rotation [rad] and of the four points' scaled coordinates."""
    found = relative_view(project(GOAL), project(T) if xy is None else xy, GOAL[:3, 2])
    assert found is not None
    R = T[:3, :3] @ GOAL[:3, :3].T
    goal, now = transform(GOAL, POINTS), transform(T, POINTS)
    m = (goal / goal[:, 2:]) @ found[0].T
    return float(rotation_angle(found[1] @ R.T)), float(np.abs(m - now / goal[:, 2:]).max())


def some_pose() -> Array:
    T = exp(np.r_[0, 0, 0, RNG.normal(0, 0.35, 2), RNG.uniform(-np.pi, np.pi)])
    T[:3, 3] = [*RNG.uniform(-0.2, 0.2, 2), RNG.uniform(0.6, 3)]
    return T


@pytest.mark.parametrize(
    "kind", ["anywhere", "near the goal", "at the goal", "a half turn about the axis"]
)
def test_exact_to_single_precision_without_noise(kind: str):
    for _ in range(50):
        match kind:
            case "anywhere":
                T = some_pose()
            case "near the goal":
                T = exp(RNG.normal(0, 1e-6, 6)) @ GOAL
            case "at the goal":
                T = GOAL
            case _:
                T = np.diag([-1.0, -1, 1, 1]) @ GOAL
                T[2, 3] *= RNG.uniform(1, 4)
        angle, coordinates = compare(T)
        assert angle < 5e-7 and coordinates < 5e-7


def test_noise_of_a_tenth_of_a_pixel_costs_tenths_of_a_degree():
    errors = []
    for _ in range(200):
        T = some_pose()
        errors.append(compare(T, project(T) + RNG.normal(0, 0.1 / 800, (4, 2)))[0])
    assert np.degrees(np.median(errors)) < 0.3


def test_three_points_make_no_homography():
    xy = project(GOAL)
    xy[0] = np.nan
    assert relative_view(project(GOAL), xy, GOAL[:3, 2]) is None


@pytest.mark.parametrize("noise", [0, 0.3 / 800])
def test_all_points_but_one_on_a_line_make_no_homography(noise: float):
    points = np.array([[-0.25, 0, 0], [0, 0, 0], [0.25, 0, 0], [0, 0.25, 0]])
    views = [transform(T, points) for T in (GOAL, *(some_pose() for _ in range(50)))]
    goal, *others = (p[:, :2] / p[:, 2:] for p in views)
    assert all(
        relative_view(goal, xy + RNG.normal(0, noise, (4, 2)), GOAL[:3, 2]) is None for xy in others
    )


@pytest.mark.parametrize("distance", [0.3, 1.0, 5.0])
def test_frontal_views_the_goal_itself_and_shifts_alone(distance: float):
    """No tilt, no parallax or no motion at all: all of the decomposition's square roots are of
    zero.
    """
    worst = 0.0
    for goal in (
        Pose(xyz=(0, 0, distance)).T,
        Pose(xyz=(0.1 * distance, -0.05 * distance, distance)).T,
    ):
        views = [
            goal,
            *(exp(np.array([*shift, 0, 0, 0.0])) @ goal for shift in 0.05 * distance * np.eye(3)),
        ]
        views += [
            Pose(xyz=(0, 0, z), rpy_deg=(0, 0, turn)).T
            for z in (0.3, 2.0, 20.0)
            for turn in np.arange(0, 180.5, 2.5)
        ]
        for T in views:
            found = relative_view(project(goal), project(T), goal[:3, 2])
            assert found is not None
            worst = max(worst, float(rotation_angle(found[1] @ (T[:3, :3] @ goal[:3, :3].T).T)))
    assert worst < 5e-7  # the root of rounding


@pytest.mark.parametrize(("off_line", "open_"), [(0.002, True), (0.06, False)])
def test_how_far_off_the_line_the_middle_point_must_be(off_line: float, open_: bool):
    points = np.array([[-0.25, 0, 0], [0, off_line, 0], [0.25, 0, 0], [0, 0.25, 0]])
    a, b = (transform(T, points) for T in (GOAL, some_pose()))
    assert (relative_view(a[:, :2] / a[:, 2:], b[:, :2] / b[:, 2:], GOAL[:3, 2]) is None) is open_
    assert left_open(a[:, :2] / a[:, 2:], np.stack([b[:, :2] / b[:, 2:]] * 2)).tolist() == [
        open_,
        open_,
    ]


def test_the_homography_of_many_points_is_exact_and_averages_noise():
    points = np.column_stack([RNG.uniform(-0.25, 0.25, (30, 2)), np.zeros(30)])
    T = some_pose()
    p, q = transform(GOAL, points), transform(T, points)
    a, b = p[:, :2] / p[:, 2:], q[:, :2] / q[:, 2:]

    def misfit(b_seen: Array) -> float:
        H = homography(a, b_seen, 1e-12)
        assert H is not None
        m = np.column_stack([a, np.ones(30)]) @ H.T
        return float(np.sqrt(np.mean((m[:, :2] / m[:, 2:] - b) ** 2)))

    assert misfit(b) < 1e-12
    # Eight unknowns of sixty equations: sqrt(8/60) of the noise is left.
    assert misfit(b + RNG.normal(0, 1e-4, b.shape)) < 0.6e-4
    assert homography(a[:4], np.full((4, 2), 0.1), 1e-12) is None


def test_points_on_both_sides_of_the_camera_have_no_view():
    xy = np.array([[-0.2, -0.2], [0.2, 0.2], [0.2, -0.2], [-0.2, 0.2]])
    assert relative_view(project(GOAL), xy, GOAL[:3, 2]) is None


def test_planes_aslant_and_far_off_the_axis():
    """The normal, which points away from the camera, may have a negative z there; and the other
    solution may be the nearer one in front.
    """
    rng, backwards = np.random.default_rng(0), 0
    for _ in range(400):
        goal, now = (
            exp(np.r_[0, 0, 0, rng.normal(0, 0.9, 2), rng.uniform(-3, 3)]) for _ in range(2)
        )
        for T in (goal, now):
            T[:3, 3] = [*rng.uniform(-0.6, 0.6, 2), rng.uniform(0.3, 1)]
        away = [float(T[:3, 2] @ T[:3, 3]) for T in (goal, now)]
        if (
            min(transform(T, POINTS)[:, 2].min() for T in (goal, now)) < 0.02
            or away[0] * away[1] < 0
        ):
            continue  # not in view, or seen from the other side
        normal = goal[:3, 2] * np.sign(away[0])
        found = relative_view(project(goal), project(now), normal)
        if found is None:  # seen edge-on
            continue
        backwards += normal[2] < 0
        assert rotation_angle(found[1] @ goal[:3, :3] @ now[:3, :3].T) < 1e-6
    assert backwards > 10
