"""Poses from markers: exact data, noise, mirror views, three markers, wide rays."""

from __future__ import annotations

import numpy as np
import pytest

from tests.shortcuts import one_quick
from vstestbed.core.geometry import Array, Pose, exp, inverse, rigid_error, transform
from vstestbed.vision import pnp, solve_pose, solve_pose_from_rays

SQUARE = np.array([[-0.25, -0.25, 0], [0.25, -0.25, 0], [0.25, 0.25, 0], [-0.25, 0.25, 0]])
HOUSE = np.vstack([SQUARE, [[0.0, 0.0, 0.2], [0.1, 0.0, 0.3]]])


def _pose(wx: float, wy: float, wz: float, t: tuple[float, float, float]) -> Array:
    T = exp(np.array([0, 0, 0, wx, wy, 0])) @ exp(np.array([0, 0, 0, 0, 0, wz]))
    T[:3, 3] = t
    return T


def _see(T: Array, points: Array) -> Array:
    p = transform(T, points)
    return p[:, :2] / p[:, 2:]


def _random_poses(n: int) -> list[Array]:
    rng = np.random.default_rng(5)
    draws = [
        rng.uniform([-0.8, -0.8, -3, -0.2, -0.2, 0.7], [0.8, 0.8, 3, 0.2, 0.2, 2]) for _ in range(n)
    ]
    return [_pose(d[0], d[1], d[2], (d[3], d[4], d[5])) for d in draws]


_ROUND = np.linspace(0, 2 * np.pi, 12, endpoint=False)
DOZEN = np.stack([0.3 * np.cos(_ROUND), 0.2 * np.sin(_ROUND), 0 * _ROUND], axis=1)


@pytest.mark.parametrize("depth", [0.6, 1.0, 4.0])
@pytest.mark.parametrize(
    "axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.2, 0.1, 0.97), (0.6, -0.3, 0.2)], ids=str
)
@pytest.mark.parametrize(
    "points", [SQUARE, DOZEN, SQUARE[:, [2, 0, 1]] @ exp(np.array([0, 0, 0, 0, 1.5, 0]))[:3, :3].T]
)
def test_half_and_quarter_turns(points: Array, axis: tuple[float, ...], depth: float) -> None:
    n = np.array(axis) / np.linalg.norm(axis)
    K = np.cross(np.eye(3), -n)
    T = np.eye(4)
    T[:3, 3] = 0.02, 0.01, depth
    for angle in (
        np.pi,
        *(np.pi + s * d for s in (-1, 1) for d in (1e-9, 1e-7, 1e-5, 1e-3)),
        np.pi / 2,
        1e-6,
        0.0,
    ):
        sine = 0.0 if angle == np.pi else np.sin(angle)  # exactly half a turn
        T[:3, :3] = np.eye(3) + sine * K + (1 - np.cos(angle)) * K @ K
        p = transform(T, points)
        if (
            p[:, 2].min() < 0.1
            or np.linalg.svd(p / p[:, 2:] - (p / p[:, 2:]).mean(axis=0))[1][1] < 1e-3
        ):
            continue  # behind the camera, or seen edge on
        for previous in (None, T):
            found = solve_pose(_see(T, points), points, previous)
            assert found is not None
            assert rigid_error(found, T) == pytest.approx((0, 0), abs=1e-6), angle


def test_pixels_that_fit_no_pose_give_none() -> None:
    xy = np.array([[-0.2, -0.2], [0.2, 0.2], [0.2, -0.2], [-0.2, 0.2]])  # two corners swapped
    assert solve_pose(xy, SQUARE) is None


@pytest.mark.parametrize(
    "points",
    [SQUARE, HOUSE, HOUSE[:5], HOUSE[[0, 1, 2, 4]]],
    ids=["plane 4", "space 6", "space 5", "space 4"],
)
def test_exact_pixels_give_the_exact_pose(points: Array) -> None:
    for T in _random_poses(50):
        found = solve_pose(_see(T, points), points)
        assert found is not None
        # single-precision stop of the refinement
        assert rigid_error(found, T) == pytest.approx((0, 0), abs=1e-6)


THREE_IN_LINE = np.array([[-0.25, 0, 0], [0, 0, 0], [0.25, 0, 0], [0, 0.25, 0]])
FOUR_IN_LINE = np.vstack([THREE_IN_LINE, [[0.1, 0, 0]]])


@pytest.mark.parametrize(
    "points",
    [THREE_IN_LINE, FOUR_IN_LINE, THREE_IN_LINE @ exp(np.array([0, 0, 0, 0.3, 1, 0.5]))[:3, :3].T],
)
def test_all_but_one_on_a_line_fix_a_pose_and_no_homography(points: Array) -> None:
    for T in [*_random_poses(50), _pose(0.3, 0.2, 3.14159, (0.1, 0, 1))]:
        found = solve_pose(_see(T, points), points)
        assert found is not None
        assert rigid_error(found, T) == pytest.approx((0, 0), abs=1e-6)


def test_pixels_from_which_the_solver_makes_nothing_raise_nothing() -> None:
    for xy in (
        [[-0.2, 0.1], [-0.1, 0.1], [0.1, 0.1], [0.2, 0.1]],
        [[0.1, 0.1]] * 4,
        [[0, 0], [0.1, 0], [0.2, 0], [0, 0.1]],
    ):
        # OpenCV then hands out None for its errors
        found = solve_pose(np.array(xy, dtype=float), SQUARE)
        assert found is None or np.isfinite(found).all()


def test_noise_of_a_third_of_a_pixel() -> None:
    # .2 m square at .8 m, .3 px at f = 540 px: 1.4 mm and .6 degrees are known; the mirror pose
    # would be off by tens of degrees.
    rng = np.random.default_rng(0)
    points, errors = SQUARE * 0.4, []
    for _ in range(200):
        T = _pose(
            rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), rng.uniform(-3, 3), (0.05, 0.0, 0.8)
        )
        found = solve_pose(_see(T, points) + rng.normal(0, 0.3 / 540, (4, 2)), points, previous=T)
        assert found is not None
        errors.append(rigid_error(found, T))
    assert np.median(errors, axis=0)[0] < 0.003
    assert np.degrees(np.median(errors, axis=0)[1]) < 1.2


def test_mirror_view_is_resolved_by_continuity() -> None:
    # Far and small (20 px across at f = 400), .2 px noise: both poses fit; the one that follows
    # from the last frame is right.
    rng = np.random.default_rng(3)
    T = _pose(0.35, 0.0, 0.0, (0.0, 0.0, 10.0))
    alone, followed = [], []
    for _ in range(200):
        xy = _see(T, SQUARE) + rng.normal(0, 0.2 / 400, (4, 2))
        nearby = exp(rng.normal(0, 0.02, 6)) @ T
        for found, errors in (
            (solve_pose(xy, SQUARE), alone),
            (solve_pose(xy, SQUARE, nearby), followed),
        ):
            assert found is not None
            errors.append(rigid_error(found, T)[1])
    wrong = 0.5  # rad: the mirror is 2 * .35 = .7 away
    assert np.mean(np.array(alone) > wrong) > 0.05  # the case is a hard one
    assert np.mean(np.array(followed) > wrong) < 0.02  # .7 % measured


def test_clear_fit_overrules_a_wrong_previous_pose() -> None:
    T, mirror = _pose(0.6, 0.1, 0.2, (0, 0, 0.9)), _pose(-0.6, -0.1, 0.2, (0, 0, 0.9))
    xy = _see(T, SQUARE) + np.random.default_rng(0).normal(0, 2e-4, (4, 2))
    found = solve_pose(xy, SQUARE, previous=mirror)
    assert found is not None
    assert rigid_error(found, T)[1] < 0.05


def test_three_markers_need_and_follow_a_previous_pose() -> None:
    for T in _random_poses(50):
        xy = _see(T, SQUARE[:3])
        assert solve_pose(xy, SQUARE[:3]) is None
        found = solve_pose(
            xy, SQUARE[:3], previous=exp(np.array([0.002, -0.001, 0.002, 0.001, 0.001, -0.002])) @ T
        )
        assert found is not None
        # single precision near a double root
        assert rigid_error(found, T) == pytest.approx((0, 0), abs=1e-4)
        assert solve_pose(xy, SQUARE[:3], previous=_pose(2.0, 1.0, 1.0, (0, 0, 9.0))) is None


def test_too_few_or_collinear_markers_give_no_pose() -> None:
    line = np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.3, 0, 0.0]])
    T = _pose(0.1, 0.2, 0.3, (0, 0, 1))
    assert solve_pose(_see(T, SQUARE[:2]), SQUARE[:2], T) is None
    assert solve_pose(_see(T, line), line, T) is None


def test_rays_to_the_side_and_behind() -> None:
    # The target seen by a lens turned away by 100 degrees: every ray points backward.
    T = _pose(0.3, 0.2, 0.5, (0.1, 0.0, 1.0))
    turned = inverse(exp(np.array([0, 0, 0, 0, np.radians(100), 0]))) @ T
    p = transform(turned, SQUARE)
    assert (p[:, 2] < 0).any()
    found = solve_pose_from_rays(p / np.linalg.norm(p, axis=1, keepdims=True), SQUARE, turned)
    assert found is not None
    assert rigid_error(found, turned) == pytest.approx((0, 0), abs=1e-6)


def test_rays_all_round_give_no_pose() -> None:
    rays = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0.0]])
    assert solve_pose_from_rays(rays, SQUARE) is None


_HEXAGON = np.arange(6) * np.pi / 3
FRONTAL = {
    "square": SQUARE,
    "rectangle": SQUARE * [1, 0.5, 1],
    "quadrilateral": np.array([[-0.3, -0.2, 0], [0.25, -0.1, 0], [0.2, 0.3, 0], [-0.1, 0.2, 0]]),
    "pentagon": np.array(
        [[0.3, 0, 0], [0.1, 0.25, 0], [-0.2, 0.15, 0], [-0.25, -0.1, 0], [0.05, -0.3, 0]]
    ),
    "hexagon": 0.3 * np.stack([np.cos(_HEXAGON), np.sin(_HEXAGON), 0 * _HEXAGON], axis=1),
    "octagon": np.vstack([SQUARE, SQUARE @ exp(np.array([0, 0, 0, 0, 0, np.pi / 4]))[:3, :3].T]),
    "tag corners": np.vstack([0.2 * SQUARE + corner for corner in SQUARE]),
    "square off its origin": SQUARE + [0, 0, 0.1],
    "house": HOUSE,
    "tetrahedron": SQUARE + 0.1 * np.array([[0, 0, 1], [0, 0, -1], [0, 0, 1], [0, 0, -1]]),
}
_ASKEW = exp(np.array([0, 0, 0, *np.radians(5) * np.array([0.6, -0.5, 0.62])]))
"""A previous pose 5 degrees off."""


def _frontal_error(
    points: Array, T: Array, previous: Array | None, noise: Array | float = 0.0
) -> float:
    """Error of the pose solved from (noisy) exact pixels: angle [rad] plus translation as a share
    of the distance.
    """
    found = solve_pose(_see(T, points) + noise, points, previous)
    assert found is not None, T
    distance, angle = rigid_error(found, T)
    return angle + distance / float(T[2, 3])


@pytest.mark.parametrize("name", one_quick(*FRONTAL, every=3))
def test_every_turn_of_an_exactly_frontal_view(name: str) -> None:
    """The square root in IPPE is of zero there, or of a rounding error of either sign: OpenCV's has
    no pose at 90 of the 721 turns.
    """
    # a chimney .3 m high
    distances = [d for d in (1.0, 0.2, 0.5, 2.0, 5.0, 20.0) if d > 0.25 or name != "house"]
    for i, turn in enumerate(np.arange(0, 180.25, 0.25)):
        z = distances[i // 5 % len(distances)]
        x, y = ((0.0, 0.0), (0.03 * z, -0.05 * z))[i // 15 % 2]
        T = Pose(xyz=(x, y, z), rpy_deg=(0, 0, turn)).T
        assert _frontal_error(FRONTAL[name], T, (None, T, T @ _ASKEW)[i % 3]) < 1e-9, turn
    for turn in np.arange(0, 180.25, 0.25) if name == "square" else ():
        assert _frontal_error(SQUARE, Pose(xyz=(0, 0, 1), rpy_deg=(0, 0, turn)).T, None) < 1e-9, (
            turn
        )


@pytest.mark.parametrize("z", [1.0, 5.0, 20.0])
def test_the_least_noise_moves_a_frontal_pose_the_least(z: float) -> None:
    """The error is proportional to the noise (a root of it would be a jump): tilt moves the image
    by its size times itself / distance.
    """
    rng = np.random.default_rng(1)
    for noise in np.array([1e-9, 1e-6, 1e-4, 1e-3]) / 800:
        for turn in np.arange(0, 180, 15.0):
            T = Pose(xyz=(0, 0, z), rpy_deg=(0, 0, turn)).T
            for previous in (None, T):
                assert (
                    _frontal_error(SQUARE, T, previous, rng.normal(0, noise, (4, 2)))
                    < 60 * z**2 * noise + 1e-9
                )


def test_three_markers_in_a_frontal_view_follow_the_previous_pose() -> None:
    for turn in np.arange(0, 180, 1.0):
        T = Pose(xyz=(0, 0, 1), rpy_deg=(0, 0, turn)).T
        assert _frontal_error(SQUARE[:3], T, T) < 1e-6


def test_a_view_in_which_sqpnp_takes_the_camera_for_behind() -> None:
    T = Pose(xyz=(0, 0, 0.2), rpy_deg=(0, 0, 10)).T
    points = FRONTAL["tetrahedron"]
    assert all(
        not np.isfinite(pnp._misfit(found, _see(T, points), points))
        for found in pnp._from_space(_see(T, points), points)
    )
    assert _frontal_error(points, T, None) < 1e-9


@pytest.mark.parametrize("axis", [(0, 1, 0), (1, 0, 0), (0.6, 0.8, 0)])
@pytest.mark.parametrize("degrees", [0, 60, 100, 180])
def test_rays_to_a_target_straight_ahead_of_a_turned_lens(
    degrees: float, axis: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    # a virtual camera sees them all
    monkeypatch.setattr(pnp, "solve_pose_all_round", lambda *_: None)
    V = exp(np.array([0, 0, 0, *np.radians(degrees) * np.array(axis)]))
    for turn in np.arange(0, 180, 7.5):
        T = V @ Pose(xyz=(0, 0, 0.5), rpy_deg=(0, 0, turn)).T
        p = transform(T, SQUARE)
        for previous in (None, T, T @ _ASKEW):
            found = solve_pose_from_rays(
                p / np.linalg.norm(p, axis=1, keepdims=True), SQUARE, previous
            )
            assert found is not None
            assert rigid_error(found, T) == pytest.approx((0, 0), abs=1e-9)


def test_a_target_whose_frame_is_at_the_lens() -> None:
    points = SQUARE + [0, 0, 1.0]  # T is the identity: the distance to the frame is zero
    for n in (3, 4):
        for previous in (np.eye(4), exp(np.array([0.01, 0, 0, 0, 0.01, 0]))):
            found = solve_pose(_see(np.eye(4), points[:n]), points[:n], previous)
            assert found is not None
            assert rigid_error(found, np.eye(4)) == pytest.approx((0, 0), abs=1e-6)


class TestLimits:
    """Each limit, by views on either side of it."""

    T = Pose(xyz=(0, 0, 1), rpy_deg=(15, -10, 30)).T
    BEND = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1.0]])
    """Errors that no motion of the square makes."""

    @pytest.fixture
    def searches(self, monkeypatch: pytest.MonkeyPatch) -> list[int]:
        """Grows with every search for a pose from nothing."""
        count, real = [], pnp.planar_poses
        monkeypatch.setattr(
            pnp, "planar_poses", lambda xy, points: count.append(1) or real(xy, points)
        )
        return count

    @pytest.mark.parametrize(
        ("z", "share", "searched"), [(1, 0.8e-3, 0), (1, 1.3e-3, 1), (20, 4e-5, 0), (20, 9e-5, 1)]
    )
    def test_a_previous_pose_that_still_fits_is_followed_without_a_search(
        self, searches, z, share, searched
    ):
        """Up to .1 % of the image's size and, far away, of .4 of its cube: there a mirror pose fits
        nearly as well.
        """
        T = Pose(xyz=(0, 0, z)).T
        xy = _see(T, SQUARE)
        assert solve_pose(xy + share * pnp._spread(xy) * self.BEND, SQUARE, T) is not None
        assert len(searches) == searched

    @pytest.mark.parametrize(("angle", "searched"), [(0.17, 0), (0.23, 1)])
    @pytest.mark.parametrize("along", [False, True], ids=["turned", "shifted"])
    def test_one_too_far_from_it_is_searched_for(self, searches, angle, searched, along):
        off = (
            np.array([0, 0, 0.0, 0, 0, angle])
            if not along
            else np.array([angle * np.linalg.norm(self.T[:3, 3]), 0, 0, 0, 0, 0])
        )
        found = solve_pose(_see(self.T, SQUARE), SQUARE, exp(off) @ self.T)
        assert found is not None and rigid_error(found, self.T) == pytest.approx((0, 0), abs=1e-9)
        assert len(searches) == searched

    @pytest.mark.parametrize(("turn", "distance"), [(61.0, 20.0), (81.0, 20.0)])
    def test_far_away_a_mirror_pose_from_the_previous_one_is_not_taken(self, turn, distance):
        T = Pose(xyz=(0.6, -1.0, distance), rpy_deg=(0, 0, turn)).T
        assert _frontal_error(FRONTAL["rectangle"], T, T @ _ASKEW) < 1e-9

    @pytest.mark.parametrize(("ratio", "taken"), [(1.0, 1), (5.5, 1), (6.5, 0)])
    def test_the_nearer_of_two_that_fit_about_as_well(self, ratio, taken):
        best, near = (
            (e, T) for e, T in ((1e-4, _pose(-0.3, 0, 0, (0, 0, 1))), (ratio * 1e-4, self.T))
        )
        for both in ([best, near], [near, best]):
            assert pnp._preferred(both, self.T, SQUARE) is (best, near)[taken]
            assert pnp._preferred(both, None, SQUARE)[0] == pytest.approx(1e-4)

    @pytest.mark.parametrize(("angle", "found"), [(0.45, True), (0.55, False)])
    def test_three_markers_follow_up_to_half_a_radian(self, angle, found):
        T = _pose(0.3, 0.2, 0.1, (0.05, 0, 0.7))
        points = SQUARE[:3]
        others = [F for F in pnp._three(_see(T, points), points) if sum(rigid_error(F, T)) > 1e-3]
        # about the optical axis, away from the other poses
        turn = exp(np.array([0, 0, 0, 0, 0, angle]))
        previous = turn @ T
        previous[:3, 3] = T[:3, 3]
        middle = points.mean(axis=0)
        previous[:3, 3] += T[:3, :3] @ middle - previous[:3, :3] @ middle
        assert all(pnp._step(F, previous, points) > 0.55 for F in others)
        assert (solve_pose(_see(T, points), points, previous) is not None) is found

    @pytest.mark.parametrize(("share", "found"), [(0.4, True), (0.6, False)])
    def test_an_error_of_half_of_the_images_size_is_no_pose(self, share, found):
        T = Pose(xyz=(0, 0, 1)).T
        xy = _see(T, SQUARE)
        bent = xy + share / np.sqrt(1 - share**2) * pnp._spread(xy) * np.array(
            [[1, -1], [-1, 1], [1, -1], [-1, 1.0]]
        ) * [1, 0]
        candidates = [(share * pnp._spread(bent), T)]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(pnp, "_candidates", lambda *_: candidates)
            assert (pnp._of_many(bent, SQUARE, "plane", None) is not None) is found

    @pytest.mark.parametrize(
        ("off_axis", "all_round"), [(70.0, False), (77.0, False), (80.0, True), (100.0, True)]
    )
    def test_markers_on_a_cone_go_through_a_picture_up_to_78_degrees(
        self, off_axis, all_round, monkeypatch
    ):
        asked = []
        monkeypatch.setattr(pnp, "solve_pose_all_round", lambda *given: asked.append(given))
        T = Pose(xyz=(0, 0, 0.25 * np.sqrt(2) / np.tan(np.radians(off_axis)))).T
        p = transform(T, SQUARE)
        found = solve_pose_from_rays(p / np.linalg.norm(p, axis=1, keepdims=True), SQUARE)
        assert bool(asked) is all_round
        assert all_round or (
            found is not None and rigid_error(found, T) == pytest.approx((0, 0), abs=1e-9)
        )

    def test_a_point_behind_the_camera_fits_nothing(self):
        assert (
            pnp._misfit(Pose(xyz=(0, 0, -1)).T, _see(Pose(xyz=(0, 0, 1)).T, SQUARE), SQUARE)
            == np.inf
        )
        assert pnp._misfit(self.T, _see(self.T, SQUARE) + 0.1, SQUARE) == pytest.approx(0.1)

    @pytest.mark.parametrize(("height", "flat"), [(0.4e-6, True), (3e-6, False)])
    def test_flat_is_up_to_a_millionth_of_the_size(self, height, flat):
        points = SQUARE + [[0, 0, height], [0, 0, 0], [0, 0, height], [0, 0, 0]]
        assert (pnp._layout(points.tobytes()) == "plane") is flat
