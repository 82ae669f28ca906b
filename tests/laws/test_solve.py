"""Least squares of one problem, of many, and of many right sides, against the pseudo-inverse."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from tests.laws.flight import fly
from tests.laws.test_line_following import CAR, UNDER, observe, world
from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose, transform
from vstestbed.features import Point
from vstestbed.features.depth import OracleDepth
from vstestbed.features.observation import EgoMotion, Goal, Observation
from vstestbed.laws import IBVS, PBVS, Hybrid, Law, LineFollowing, Partitioned
from vstestbed.laws.error_law import ErrorState
from vstestbed.laws.feedforward import KalmanCV, follow
from vstestbed.laws.solve import PINV_RCOND, Solve, least_squares
from vstestbed.robots import Mount
from vstestbed.targets.base import Square
from vstestbed.targets.route import Straight


def problems(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Interaction matrices of four points in views of all kinds, and errors."""
    rng = np.random.default_rng(seed)
    L = Point().interaction(rng.uniform(-1, 1, (n, 4, 2)), rng.uniform(0.3, 5, (n, 4)))
    return L, rng.normal(size=(n, 8))


def test_many_are_as_each_alone():
    A, b = problems(300)
    expected = np.array([np.linalg.pinv(a, PINV_RCOND) @ e for a, e in zip(A, b, strict=True)])
    # Normal equations square the condition, here up to 1e3 or so: six digits of sixteen.
    np.testing.assert_allclose(
        least_squares(A, b), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max()
    )
    np.testing.assert_allclose(
        [least_squares(a, e) for a, e in zip(A, b, strict=True)], expected, rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize("rows", [2, 4, 5])
def test_with_fewer_equations_than_unknowns_many_get_the_shortest(rows: int):
    A, b = problems(100)
    A, b = A[:, :rows], b[:, :rows]
    expected = np.array([np.linalg.pinv(a, PINV_RCOND) @ e for a, e in zip(A, b, strict=True)])
    # Normal equations square the condition, as above.
    np.testing.assert_allclose(
        least_squares(A, b), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max()
    )
    A[:50, 1], b[:50, 1] = A[:50, 0], b[:50, 0]  # one marker that says the same twice
    expected = np.array([np.linalg.pinv(a, PINV_RCOND) @ e for a, e in zip(A, b, strict=True)])
    np.testing.assert_allclose(
        least_squares(A, b), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max()
    )


def test_one_matrix_with_many_right_sides():
    A, b = problems(50)
    np.testing.assert_allclose(
        least_squares(A[0], b), b @ np.linalg.pinv(A[0]).T, rtol=1e-9, atol=1e-12
    )


def test_leading_axes_are_kept():
    A, b = problems(12)
    assert least_squares(A.reshape(3, 4, 8, 6), b.reshape(3, 4, 8)).shape == (3, 4, 6)


def test_a_direction_that_nothing_tells_is_not_moved_in():
    A, b = problems(20)
    A[:, :, 5] = 0.0
    A[10:, :, 5] = 1e-9 * A[10:, :, 4]  # far below the cut-off
    x = least_squares(A, b)
    assert (x[:, 5] == 0).all()
    np.testing.assert_allclose(x[:, :5], least_squares(A[..., :5], b), rtol=1e-6, atol=1e-9)


def test_rounding_alone_orders_nothing():
    A, b = problems(20)
    b -= np.einsum("mij,mj->mi", A, least_squares(A, b))  # what no motion would mend
    b -= np.einsum("mij,mj->mi", A, least_squares(A, b))
    x = least_squares(A, b)
    size = np.linalg.norm(A, axis=(1, 2)) * np.linalg.norm(b, axis=1)
    gradient = np.linalg.norm(np.einsum("mij,mi->mj", A, b), axis=1)
    assert (x[gradient < 1e-12 * size] == 0).all() and (gradient < 1e-12 * size).any()


@pytest.mark.parametrize("shape", [(0, 8, 6)])
def test_no_problem_has_no_answer(shape: tuple[int, ...]):
    assert least_squares(np.zeros(shape), np.zeros(shape[:2])).shape == (0, 6)


class TestParameters:
    """Cutoff and damping, against scipy."""

    @pytest.mark.parametrize("columns", [4, 6, 8])
    @pytest.mark.parametrize("cutoff", [0.0, 1e-9, 0.03, 0.2, 0.5])
    def test_a_cutoff_is_that_of_scipy(self, cutoff: float, columns: int):
        A, b = (x[:, :columns] for x in problems(100))
        x = Solve(cutoff=cutoff).least_squares(A, b)
        # gelsd: singular values under cond times the largest count as zero.
        expected, ranks = zip(
            *(linalg.lstsq(a, e, cond=cutoff)[::2] for a, e in zip(A, b, strict=True)), strict=True
        )
        assert cutoff < 0.03 or len(set(ranks)) > 1
        np.testing.assert_allclose(x, expected, rtol=1e-9, atol=1e-9 * np.abs(x).max())

    @pytest.mark.parametrize("damping", [1e-3, 0.1, 3.0])
    def test_damping_adds_its_share_of_the_motion_to_what_is_minimised(self, damping: float):
        A, b = problems(50)
        x = Solve(damping=damping).least_squares(A, b)
        for a, e, found in zip(A, b, x, strict=True):
            # |A x - b|^2 + damping^2 |x|^2 as one least-squares problem with six more rows.
            expected = linalg.lstsq(
                np.vstack([a, damping * np.eye(6)]), np.concatenate([e, np.zeros(6)])
            )[0]
            np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10 * np.abs(x).max())

    @pytest.mark.parametrize(("mu", "fades"), [(0.01, 0.0), (4.0, 0.0), (0.5, 3.0)])
    def test_levenberg_and_marquardts_step_in_closed_form(self, mu: float, fades: float):
        A, b = problems(50)
        b[25:] /= 100
        x = Solve(levenberg_marquardt=mu, fades_below=fades).least_squares(A, b)
        # one matrix, many right sides
        many = Solve(levenberg_marquardt=mu, fades_below=fades).least_squares(A[0], b)
        for i, (a, e) in enumerate(zip(A, b, strict=True)):
            m = mu * min(1.0, np.linalg.norm(e) / fades) if fades else mu
            for H, g, found in ((a.T @ a, a.T @ e, x[i]), (A[0].T @ A[0], A[0].T @ e, many[i])):
                np.testing.assert_allclose(
                    found, np.linalg.solve(H + m * np.diag(np.diag(H)), g), rtol=1e-6, atol=1e-8
                )
            alone = Solve(levenberg_marquardt=mu, fades_below=fades).least_squares(a, e)
            np.testing.assert_allclose(alone, x[i], rtol=1e-6, atol=1e-8)

    def test_levenberg_and_marquardts_step_lies_between_newtons_and_the_gradient(self):
        A, b = problems(20)
        A[:, :, 5] = 0.0  # a motion that nothing tells is not made, however large mu is
        for mu in (0.01, 1e6):
            assert not Solve(levenberg_marquardt=mu).least_squares(A, b)[:, 5].any()
        pinv = [np.linalg.pinv(a) @ e for a, e in zip(A, b, strict=True)]
        np.testing.assert_allclose(
            Solve(levenberg_marquardt=1e-9).least_squares(A, b), pinv, rtol=1e-4, atol=1e-6
        )
        gradient = np.einsum("kij,ki->kj", A, b)[:, :5] / (
            1e6 * np.einsum("kij,kij->kj", A, A)[:, :5]
        )
        np.testing.assert_allclose(
            Solve(levenberg_marquardt=1e6).least_squares(A, b)[:, :5],
            gradient,
            rtol=1e-4,
            atol=1e-10,
        )

    def test_both_together_by_hand(self):
        # Singular values 10, 1 and .1: the last is left out by .05, the others have s/(s^2 + .25).
        A, b = np.diag([10.0, 1.0, 0.1]), np.array([3.0, 3.0, 3.0])
        x = Solve(cutoff=0.05, damping=0.5).least_squares(A, b)
        np.testing.assert_allclose(x, [3 * 10 / 100.25, 3 / 1.25, 0], rtol=1e-14)

    def test_many_are_the_same_numbers_as_each_alone(self):
        for solve in (
            Solve(cutoff=0.1),
            Solve(damping=0.1),
            Solve(cutoff=0.05, damping=0.2),
            Solve(cutoff=0.0),
            Solve(damping=0.1, levenberg_marquardt=0.2),
        ):
            A, b = problems(40)
            alone = [solve.least_squares(a, e) for a, e in zip(A, b, strict=True)]
            np.testing.assert_allclose(solve.least_squares(A, b), alone, rtol=1e-12, atol=1e-14)
            # One matrix with many right sides, and leading axes.
            np.testing.assert_allclose(
                solve.least_squares(A[0], b),
                [solve.least_squares(A[0], e) for e in b],
                rtol=1e-12,
                atol=1e-14,
            )
            assert solve.least_squares(A.reshape(2, 20, 8, 6), b.reshape(2, 20, 8)).shape == (
                2,
                20,
                6,
            )
            assert solve.least_squares(A[:0], b[:0]).shape == (0, 6)

    def test_the_default_is_the_plain_solution_bit_for_bit(self):
        A, b = problems(10)
        assert Solve() == Solve(cutoff=PINV_RCOND, damping=0)
        np.testing.assert_array_equal(Solve().least_squares(A, b), least_squares(A, b))
        np.testing.assert_array_equal(Solve().least_squares(A[0], b[0]), least_squares(A[0], b[0]))
        # another way of the same
        assert not np.array_equal(Solve(cutoff=2e-6).least_squares(A, b), least_squares(A, b))

    def test_without_any_equation_nothing_moves(self):
        assert not Solve(cutoff=0.1).least_squares(np.zeros((4, 6)), np.ones(4)).any()
        assert not Solve(cutoff=0.0, damping=0.1).least_squares(np.zeros((4, 6)), np.ones(4)).any()

    @pytest.mark.parametrize(("cutoff", "free"), [(0.0, 1), (1e-6, 1), (1e-3, 2), (0.5, 3)])
    def test_the_null_space_is_what_the_cutoff_leaves_out(self, cutoff: float, free: int):
        A = np.diag([1.0, 0.3, 1e-4, 0.0])
        N = Solve(cutoff=cutoff).null_space(A)
        assert N.shape == (4, free)
        np.testing.assert_allclose(np.abs(N.T), np.eye(4)[::-1][:free][::-1], atol=1e-15)
        assert Solve().null_space(np.zeros((0, 4))).shape == (4, 4)

    def test_what_makes_no_sense_is_refused(self):
        for wrong in (
            {"cutoff": -0.1},
            {"cutoff": 1.0},
            {"damping": -1e-3},
            {"levenberg_marquardt": -1.0},
            {"fades_below": -1.0},
        ):
            with pytest.raises(ParameterError, match=next(iter(wrong))):
                Solve(**wrong)


class TestLawsUseIt:
    """Each law inverts its matrix as its `solve` says: the command in closed form, by scipy."""

    POINTS, CAMERA = Square(side=0.5, pose=Pose()).points, Perspective()
    GOAL = Goal.from_view(CAMERA, POINTS, Pose(xyz=(0, 0, 1)).T)
    T = Pose(xyz=(0.2, -0.1, 1.6), rpy_deg=(10, -15, 30)).T
    SOLVES = (Solve(damping=0.3), Solve(cutoff=0.1), Solve(levenberg_marquardt=0.2))

    def observation(self) -> Observation:
        p = transform(self.T, self.POINTS)
        uv = self.CAMERA.project(p)
        return Observation(
            t=0, uv=uv, xy=self.CAMERA.normalise(uv), depth=p[:, 2], T_camera_target=self.T
        )

    def solved(self, solve: Solve, A: np.ndarray, b: np.ndarray) -> np.ndarray:
        if solve.damping:
            return linalg.lstsq(
                np.vstack([A, solve.damping * np.eye(A.shape[1])]),
                np.concatenate([b, np.zeros(A.shape[1])]),
            )[0]
        if solve.levenberg_marquardt:
            H = A.T @ A
            return np.linalg.solve(H + solve.levenberg_marquardt * np.diag(np.diag(H)), A.T @ b)
        return linalg.lstsq(A, b, cond=solve.cutoff)[0]

    def twist(self, law: Law) -> np.ndarray:
        return law.step(law.init(self.GOAL), self.observation(), self.GOAL, np.eye(6))[1].twist

    @pytest.mark.parametrize("solve", SOLVES, ids=repr)
    def test_points_poses_and_both(self, solve: Solve):
        o = self.observation()
        e, L = (o.xy - self.GOAL.xy).ravel(), Point().interaction(o.xy, o.depth)
        assert self.twist(IBVS(solve=solve)) == pytest.approx(
            -0.5 * self.solved(solve, L, e), abs=1e-10
        )
        assert self.twist(IBVS(solve=solve)) != pytest.approx(self.twist(IBVS()), abs=1e-3)
        for law in (PBVS(solve=solve, translation="cMo"), Hybrid(solve=solve, source="model")):
            if isinstance(law, PBVS):
                e, L = law.equations(o, self.GOAL)
            else:
                R = self.GOAL.T_camera_target[:3, :3] @ self.T[:3, :3].T
                e, L = law.of_middle(self.T[:3, 3], R, self.GOAL.middle)
            assert self.twist(law) == pytest.approx(-0.5 * self.solved(solve, L, e), abs=1e-10)

    @pytest.mark.parametrize("solve", SOLVES, ids=repr)
    def test_both_terms_of_the_partitioned_law(self, solve: Solve):
        law, o = Partitioned(solve=solve, gain_z=0.3, gain_turn=0.7), self.observation()
        e, L = (o.xy - self.GOAL.xy).ravel(), Point().interaction(o.xy, o.depth)
        found = self.twist(law)
        along = found[[2, 5]]
        assert np.abs(along).min() > 0.05
        expected = -0.5 * self.solved(solve, L[:, [0, 1, 3, 4]], e) - self.solved(
            solve, L[:, [0, 1, 3, 4]], L[:, [2, 5]] @ along
        )
        assert found[[0, 1, 3, 4]] == pytest.approx(expected, abs=1e-10)

    def test_the_target_of_a_feedforward(self):
        change, solve = (np.ones(6), np.diag([1.0, 1, 1, 1, 1, 0.05])), Solve(cutoff=0.1)
        still = EgoMotion(np.zeros(6), 0.04, np.zeros(6), 0.0, np.zeros(6))
        trend = follow(
            KalmanCV(),
            follow(KalmanCV(), None, None, np.eye(6), still),
            change,
            np.eye(6),
            still,
            solve,
        )
        np.testing.assert_allclose(trend.moved, [1, 1, 1, 1, 1, 0], atol=1e-12)
        # A law's own estimate of a target that has moved sideways, of which this cutoff leaves the
        # tilt alone.
        before = self.observation()
        moved = replace(before, xy=before.xy + [0.01, 0], motion=still)
        estimate = KalmanCV().update(None, None, 0.04, 6)
        state = ErrorState(
            np.zeros(0), seen=before, known_t=0.0, marker_t=np.zeros(4), target=estimate
        )
        L = Point().interaction(before.xy, before.depth)
        for solve in (Solve(), Solve(cutoff=0.5)):
            law = IBVS(solve=solve, feedforward=KalmanCV())
            after, _ = law.step(state, moved, self.GOAL, np.eye(6))
            mean = (L + Point().interaction(moved.xy, moved.depth)) / 2
            assert after.target is not None
            np.testing.assert_allclose(
                after.target.moved, self.solved(solve, mean, np.tile([0.01, 0], 4)), atol=1e-10
            )

    def test_directions_that_are_left_out_are_free_for_a_secondary_task(self):
        for solve, free in ((Solve(), 0), (Solve(cutoff=0.1), 2)):
            law = IBVS(redundant=True, solve=solve)
            command = law.step(law.init(self.GOAL), self.observation(), self.GOAL, np.eye(6))[1]
            assert [twists.shape for _, twists in command.free] == [(6, free)]

    def test_the_turn_of_a_line_follower(self):
        basis = Mount.of(UNDER.T).to_camera @ CAR
        lines, goal = world(Straight(length_m=9))
        seen = observe(lines, goal, (3, 0.05, 0))
        turns = {
            d: (law := LineFollowing(solve=Solve(damping=d)))
            .step(law.init(goal), seen, goal, basis)[1]
            .u
            for d in (0.0, 0.4)
        }
        # One row and one column, J_y of the turn at the straight line: -m = -.4, so w = b s/(s^2 +
        # d^2) is half of b/s.
        assert turns[0.4][1] == pytest.approx(turns[0.0][1] / 2, rel=1e-6)
        assert turns[0.4][0] == turns[0.0][0] == 0.8


def test_far_away_damping_keeps_the_partitioned_law_straight():
    """From 4 m and 30 degrees: 1.7 times the straight line at up to 25 m/s without,
    .7 m/s with it.
    """
    laws = {
        d: Partitioned(gain_z=0.5, sigma="log", depth=OracleDepth(), solve=Solve(damping=d))
        for d in (0.0, 0.1)
    }
    runs = {
        d: fly(law, (0.5, 0.3, -4), rpy_deg=(0, 0, 30), norm_px=0.8).summary()
        for d, law in laws.items()
    }
    assert all(r["success"] for r in runs.values())
    assert runs[0.0]["path_ratio"] > 1.5 and runs[0.0]["peak_speed_mps"] > 10
    assert runs[0.1]["path_ratio"] < 1.05 and runs[0.1]["peak_speed_mps"] < 1


@pytest.mark.parametrize("many", [False, True], ids=["one", "many"])
def test_the_default_cutoff_is_a_millionth(many: bool):
    for smallest, counts in ((1e-5, True), (1e-7, False)):
        A, b = np.diag([1.0, smallest]), np.array([1.0, smallest])
        x = least_squares(A[None], b[None])[0] if many else least_squares(A, b)
        np.testing.assert_allclose(x, [1.0, 1.0 if counts else 0.0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(
            least_squares(A, np.stack([b, 2 * b]))[1], [2.0, 2.0 if counts else 0.0], atol=1e-9
        )


@pytest.mark.process
def test_lapack_is_scipys_without_the_package_that_takes_long_to_import(
    vstestbed_process: tuple[list[str], dict[str, str]],
) -> None:
    """The very function, whichever of the two is imported first."""
    code = """if True:
        import sys
        from vstestbed.laws.solve import load_lapack
        own, late = load_lapack(), "scipy.linalg" not in sys.modules
        from scipy.linalg import get_lapack_funcs
        print(late and own is get_lapack_funcs("gelsy", dtype="d"))
        load_lapack.cache_clear()
        print(load_lapack() is own)"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=vstestbed_process[1],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["True", "True"]
