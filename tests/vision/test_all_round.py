"""The pose of markers all round the camera, from rays; the place of a vehicle on the floor."""

import numpy as np
import pytest

from vstestbed.core.geometry import exp, inverse, rigid_error, transform
from vstestbed.core.planar import pose_on_ground, relative
from vstestbed.vision import pnp
from vstestbed.vision.floor_pose import solve_place
from vstestbed.vision.pnp import solve_pose_all_round, solve_pose_from_rays

RING = np.array([[4, 0.5, 1.5], [0.5, 4, 2], [-4, -0.5, 1.2], [-0.5, -4, 1.8], [3, 3, 2.5]])
MOUNT = np.eye(4)
MOUNT[:3, :3], MOUNT[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.2, 0.1, 0.5]


def rays_of(T, points, noise=0.0, rng=None):
    p = transform(T, points)
    if noise:
        p = p / np.linalg.norm(p, axis=1, keepdims=True) + rng.normal(0, noise, p.shape)
    return p / np.linalg.norm(p, axis=1, keepdims=True)


class TestAllRound:
    def test_the_guesses_are_the_24_rotations_of_a_cube(self):
        turns = np.array(pnp._turns())
        assert len(np.unique(turns.reshape(-1, 9), axis=0)) == 24
        np.testing.assert_array_equal(turns @ turns.mT, np.tile(np.eye(3), (24, 1, 1)))
        np.testing.assert_allclose(np.linalg.det(turns), 1)

    @pytest.mark.parametrize("n", [4, pytest.param(5, marks=pytest.mark.study)])
    def test_a_camera_amid_the_markers_knows_its_pose_without_a_previous_one(self, n):
        rng = np.random.default_rng(1)
        for _ in range(25):
            T = exp(rng.uniform(-1, 1, 6) * [1.5, 1.5, 0.8, 3, 3, 3])
            T = inverse(
                T
                @ np.block(
                    [
                        [np.eye(3), np.array([[0.0], [0.0], [1.0]])],
                        [np.zeros((1, 3)), np.ones((1, 1))],
                    ]
                )
            )
            found = solve_pose_all_round(rays_of(T, RING[:n]), RING[:n])
            assert found is not None
            distance, angle = rigid_error(found, T)
            assert distance < 1e-7 and angle < 1e-7  # exact rays: rounding

    def test_noise_of_half_a_milliradian_costs_millimetres(self):
        rng = np.random.default_rng(2)
        T = inverse(pose_on_ground(np.array([0.4, -0.3, 0.7])) @ MOUNT)
        errors = [
            rigid_error(solve_pose_all_round(rays_of(T, RING, 5e-4, rng), RING, T), T)[0]
            for _ in range(200)
        ]
        # Five bearings at 4 m, .5 mrad each: about 4 m x .5e-3 x sqrt(2/5) sideways, somewhat more
        # along the worst axis.
        assert 5e-4 < np.sqrt(np.mean(np.square(errors))) < 5e-3

    def test_three_need_a_previous_pose(self):
        T = inverse(pose_on_ground(np.array([0.4, -0.3, 0.7])) @ MOUNT)
        some = RING[[0, 1, 2]]
        assert solve_pose_all_round(rays_of(T, some), some) is None
        found = solve_pose_all_round(rays_of(T, some), some, exp(np.full(6, 0.02)) @ T)
        np.testing.assert_allclose(found, T, atol=1e-7)

    def test_rays_of_any_lens_come_here_when_no_pinhole_holds_them(self):
        T = inverse(pose_on_ground(np.array([0.0, 0.0, 0.2])) @ MOUNT)
        np.testing.assert_allclose(solve_pose_from_rays(rays_of(T, RING), RING), T, atol=1e-7)

    def test_what_fits_nowhere_is_no_pose(self):
        rays = np.random.default_rng(3).normal(size=(5, 3))
        assert (
            solve_pose_all_round(rays / np.linalg.norm(rays, axis=1, keepdims=True), RING) is None
        )


class TestPlaceOnTheFloor:
    LANDMARKS = np.array([[0.0, 1, 2], [0, -1, 2]])

    def seen(self, place, points, noise=0.0, rng=None):
        return rays_of(inverse(pose_on_ground(np.array(place)) @ MOUNT), points, noise, rng)

    def test_two_landmarks_tell_it_without_a_previous_one(self):
        rng = np.random.default_rng(4)
        for _ in range(200):
            place = rng.uniform([-8, -3, -3], [-1, 3, 3])
            found = solve_place(self.seen(place, self.LANDMARKS), self.LANDMARKS, MOUNT)
            np.testing.assert_allclose(relative(np.array(place), found), 0, atol=1e-8)

    def test_it_does_not_hang_on_a_wrong_previous_place(self):
        place = [-4.0, 1.0, 0.5]
        found = solve_place(
            self.seen(place, self.LANDMARKS), self.LANDMARKS, MOUNT, np.array([5.0, -3.0, 3.0])
        )
        np.testing.assert_allclose(found, place, atol=1e-8)

    def test_one_landmark_leaves_the_heading_as_it_was(self):
        place = np.array([-4.0, 1.0, 0.5])
        found = solve_place(
            self.seen(place, self.LANDMARKS[:1]), self.LANDMARKS[:1], MOUNT, place + [0.3, -0.2, 0]
        )
        np.testing.assert_allclose(found, place, atol=1e-8)

    def test_landmarks_one_above_the_other_tell_distance_but_no_heading(self):
        mast = np.array([[0.0, 0, 0.3], [0, 0, 0.9]])
        place = np.array([-3.0, 0.4, -0.1])
        found = solve_place(self.seen(place, mast), mast, MOUNT, place + [0.2, 0.1, 0.0])
        seen_from_there = [np.linalg.norm(p[:2]) for p in (found, place)]
        assert seen_from_there[0] == pytest.approx(seen_from_there[1], abs=1e-3)

    def test_rays_that_belong_to_other_landmarks_have_no_place(self):
        swapped = self.seen([-4.0, 1.0, 0.5], np.array([[0.0, 1, 6], [3, -1, 0.2]]))
        assert solve_place(swapped, self.LANDMARKS, MOUNT) is None
