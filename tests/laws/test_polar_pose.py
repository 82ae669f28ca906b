"""The polar law: its coordinates, its linear behaviour near the goal, the ideal bicycle under it,
and where it fails.
"""

import numpy as np
import pytest

from vstestbed.core.planar import wrapped
from vstestbed.laws.pose_controller import Gains, direction_to, polar, polar_law
from vstestbed.robots.car import BicycleLimits, Drive, drive

GAINS = (1.0, 5.0, -2.0)  # the textbook's
GOAL = np.array([5, 5, np.pi / 2])
LIMITS = BicycleLimits(
    speed_mps=1.0, steering_rad=1.0, acceleration_mps2=1.5, steering_rate_radps=2.0
)


def park(
    start: np.ndarray,
    goal: np.ndarray = GOAL,
    limits: BicycleLimits = LIMITS,
    gains: Gains = GAINS,
    duration: float = 20.0,
) -> Drive:
    way = direction_to(start, goal)
    return drive(
        lambda place: polar_law(place, goal, way, gains, 1.0),
        start,
        1.0,
        limits,
        duration,
        period=0.02,
    )


def errors(course: Drive, goal: np.ndarray = GOAL) -> tuple[np.ndarray, np.ndarray]:
    """Distance [m] and size of the heading's error [deg] at the end."""
    end = course.place[-1] - goal
    return np.hypot(end[..., 0], end[..., 1]), np.degrees(np.abs(wrapped(end[..., 2])))


def arrived(course: Drive) -> np.ndarray:
    """Within 10 cm and 5 degrees at the end."""
    distance, heading = errors(course)
    return (distance < 0.1) & (heading < 5)


def facing(n: int) -> np.ndarray:
    """Starts (n, 3) in a box of 1 m and 60 degrees about (2, 2, 20 degrees)."""
    return np.array([2, 2, np.radians(20)]) + np.random.default_rng(0).uniform(-1, 1, (n, 3)) * [
        0.5,
        0.5,
        np.radians(30),
    ]


class TestCoordinates:
    def test_by_hand(self):
        """The goal at the origin looking along x; the vehicle 2 m below it and looking up: straight
        ahead, a quarter turn to make.
        """
        rho, alpha, beta = polar(np.array([0, -2, np.pi / 2]), np.zeros(3), np.array(1))
        assert (rho, alpha, beta) == (pytest.approx(2), pytest.approx(0), pytest.approx(-np.pi / 2))
        # Looking down, in reverse it is the same, but that it ends the other way round.
        rho, alpha, beta = polar(
            np.array([0, -2, -np.pi / 2]), np.array([0, 0, np.pi]), np.array(-1)
        )
        assert (rho, alpha, beta) == (pytest.approx(2), pytest.approx(0), pytest.approx(-np.pi / 2))

    def test_only_the_place_seen_from_the_goal_matters(self):
        rng = np.random.default_rng(0)
        place, turn, shift = rng.uniform(-3, 3, (50, 3)), 2.1, np.array([4.0, -7.0])
        c, s = np.cos(turn), np.sin(turn)

        def elsewhere(p: np.ndarray) -> np.ndarray:
            return np.concatenate(
                [p[..., :2] @ np.array([[c, s], [-s, c]]) + shift, p[..., 2:] + turn], axis=-1
            )

        for way in (1, -1):
            here, there = (
                polar(place, GOAL, np.array(way)),
                polar(elsewhere(place), elsewhere(GOAL), np.array(way)),
            )
            np.testing.assert_allclose(here[0], there[0], atol=1e-12)
            np.testing.assert_allclose(
                np.exp(1j * np.array(here[1:])), np.exp(1j * np.array(there[1:])), atol=1e-12
            )

    def test_rates_are_the_kinematics(self):
        """Finite differences along the arc against rho_dot, alpha_dot and beta_dot in print."""
        from vstestbed.core.planar import moved

        rng, dt = np.random.default_rng(3), 1e-6
        place = np.column_stack([rng.uniform(-3, 3, (200, 2)), rng.uniform(-3, 3, 200)])
        for way in (1, -1):
            v, w = way * 0.6, 0.3
            before = np.array(polar(place, GOAL, np.array(way)))
            after = np.array(
                polar(moved(place, np.tile([v, 0, w], (200, 1)), dt), GOAL, np.array(way))
            )
            rate = np.vstack([after[:1] - before[:1], wrapped(after[1:] - before[1:])]) / dt
            rho, alpha, _ = before
            expected = [
                -abs(v) * np.cos(alpha),
                abs(v) * np.sin(alpha) / rho - w,
                -abs(v) * np.sin(alpha) / rho,
            ]
            np.testing.assert_allclose(rate, expected, atol=1e-4)  # first order in dt over rho^2

    def test_direction(self):
        ahead, behind = np.array([2, 2, 0.35]), np.array([2, 2, 0.35 + np.pi])
        assert (direction_to(ahead, GOAL), direction_to(behind, GOAL)) == (1, -1)


class TestLaw:
    def test_speed_limit_keeps_the_arc(self):
        rng = np.random.default_rng(1)
        place = rng.uniform(-4, 4, (100, 3))
        way = direction_to(place, GOAL)
        slow, fast = (
            polar_law(place, GOAL, way, GAINS, 0.3),
            polar_law(place, GOAL, way, GAINS, np.inf),
        )
        assert np.abs(slow[0]).max() == pytest.approx(0.3)
        np.testing.assert_allclose(slow[1] / slow[0], fast[1] / fast[0])

    def test_it_rests_at_the_goal(self):
        v, w = polar_law(GOAL + [0.01, 0, 0.2], GOAL, np.array(1), GAINS, 1.0)
        assert (v, w) == (0, 0)

    def test_linear_behaviour_near_the_goal(self):
        """Without limits, alpha and beta decay with the eigenvalues -.586 and -3.41 of the closed
        loop, rho with -1.
        """
        A = np.array([[GAINS[0] - GAINS[1], -GAINS[2]], [-GAINS[0], 0]])
        slow, fast = sorted(np.linalg.eigvals(A), reverse=True)
        assert (slow, fast) == (pytest.approx(-2 + np.sqrt(2)), pytest.approx(-2 - np.sqrt(2)))
        alpha, beta, rho = 1e-3, 2e-3, 1.0
        # seen from the origin, along -beta
        start = np.array([rho * np.cos(beta + np.pi), -rho * np.sin(beta + np.pi), 0])
        start[2] = -beta - alpha
        unlimited = BicycleLimits(speed_mps=np.inf, steering_rad=1.5)
        course = drive(
            lambda p: polar_law(p, np.zeros(3), np.array(1), GAINS, np.inf, 0.0),
            start,
            1.0,
            unlimited,
            2.0,
            1e-3,
        )
        told = np.array(polar(course.place[-1], np.zeros(3), np.array(1)))
        values, vectors = np.linalg.eig(A)
        linear = vectors @ (np.exp(2.0 * values) * np.linalg.solve(vectors, [alpha, beta]))
        # periods of 1 ms: first order
        np.testing.assert_allclose(told, [np.exp(-2), *linear], rtol=5e-3)


class TestIdealCar:
    def test_the_books_goal(self):
        course = park(np.array([2, 2, 0.35]))
        assert arrived(course)
        assert course.t[np.argmax(np.linalg.norm(course.place[:, :2] - GOAL[:2], axis=1) < 0.1)] < 8

    def test_starts_that_face_the_goal_all_arrive(self):
        assert np.all(arrived(park(facing(1000))))

    def test_it_needs_its_steering(self):
        """With .45 rad of it, as in many cars, most of the same starts end askew."""
        assert np.mean(arrived(park(facing(300), limits=BicycleLimits(1.0, 0.45)))) < 0.5

    def test_gains_that_keep_the_curvature_bounded_arrive_from_anywhere(self):
        rng = np.random.default_rng(0)
        start = np.column_stack([rng.uniform(0, 10, (400, 2)), rng.uniform(-np.pi, np.pi, 400)])
        start = start[np.linalg.norm(start[:, :2] - GOAL[:2], axis=1) > 1]
        books, bounded = (
            np.mean(arrived(park(start, gains=gains))) for gains in (GAINS, (1, 4, -2.5))
        )
        # Standard error of a share of 390: 2.5 %. What is left are goals within a metre or two
        # beside the car.
        assert 0.25 < books < 0.42 and bounded > 0.88

    def test_reverse_parking_is_the_mirror_of_driving_forward(self):
        """Start and goal turned by half a turn: the same way, backwards."""
        forward = park(np.array([2, 2, 0.35]))
        turned = np.array([0, 0, np.pi])
        reverse = park(np.array([2, 2, 0.35]) + turned, GOAL + turned)
        assert np.all(reverse.v <= 0) and reverse.v.min() == pytest.approx(-1)
        np.testing.assert_allclose(reverse.place, forward.place + turned, atol=1e-6)
        np.testing.assert_allclose(reverse.steering, -forward.steering, atol=1e-6)

    @pytest.mark.parametrize("gains", [(1, 4, -2.5), (1, 5, -2)], ids=["1, 4, -2.5", "of print"])
    @pytest.mark.parametrize("away", [3.0, 12.0])
    def test_a_heading_known_wrongly_is_left_in_proportion_whatever_the_distance(self, gains, away):
        """A straight approach with alpha = -b has k_alpha alpha + k_beta beta = 0 where the heading
        is k_alpha / -k_beta b off.
        """
        bias, start = np.radians(5), np.array([5.0, 5.0 - away, np.pi / 2])
        wrong = np.array([0, 0, bias])
        course = drive(
            lambda place: polar_law(place + wrong, GOAL, np.array(1), gains, 1.0),
            start,
            1.0,
            LIMITS,
            25.0,
            period=0.02,
        )
        left = wrapped(course.place[-1, 2] - GOAL[2]) / bias
        # It stops 2 cm before; the slower root of print's gains (-.59 against -1 of the distance)
        # has not quite faded there.
        assert left == pytest.approx(gains[1] / -gains[2], rel=0.01 if gains[2] == -2.5 else 0.12)

    def test_a_goal_beside_it_is_missed(self):
        """No smooth law parks a car sideways: from 3 m beside the goal it goes by and round."""
        assert not arrived(park(np.array([8, 5, np.pi / 2])))
