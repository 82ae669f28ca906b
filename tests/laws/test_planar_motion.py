"""Image-based servoing of a base that moves in the plane: the motions go through the mount's
adjoint. What print does instead diverges.
"""

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.geometry import exp, inverse, transform
from vstestbed.robots import Mount
from vstestbed.robots.vehicle import PLANE

STEP_S = 0.1
"""As in the book's omnidirectional example: steps of .1 s at gain 1."""


def drive(scenario, naive: bool, steps: int = 300):
    """Steps until the norm of the normalised coordinates is under 1e-3, or None; the largest norm
    on the way.
    """
    mount = Mount.of(scenario.camera.mount.T)
    goal, points, feature = scenario.goal_view, scenario.target.points, scenario.law.feature
    T = scenario.robot.flange_pose(scenario.robot.configuration())
    farthest = 0.0
    for k in range(steps):
        p = transform(inverse(T @ mount.T_flange_camera), points)
        if (p[:, 2] <= 0).any():
            return None, np.inf
        xy = p[:, :2] / p[:, 2:]
        e = feature.error(feature.measure(xy), feature.measure(goal.xy))
        farthest = max(farthest, float(np.linalg.norm(e)))
        if np.linalg.norm(e) < 1e-3:
            return k, farthest
        L = feature.interaction(xy, p[:, 2])
        # Print: of the camera's six columns those named vx, vy and wz, as if the camera's axes were
        # the vehicle's.
        basis = (
            np.eye(6)[:, [0, 1, 5]]
            if naive
            else scenario.robot.motion_basis(mount, scenario.robot.start_joints())
        )
        u = -np.linalg.pinv(L @ basis) @ e
        T = T @ exp(PLANE @ u * STEP_S)
        if np.hypot(*T[:2, 3]) > 100:
            return None, np.inf
    return None, farthest


@pytest.mark.parametrize("name", ["omni_ibvs"])
def test_the_exact_motions_converge_and_those_of_print_do_not(name):
    scenario = vs.load(name)
    steps, _ = drive(scenario, naive=False)
    assert steps is not None
    assert 50 <= steps <= 100
    assert drive(scenario, naive=True)[0] is None


def test_from_many_starts():
    exact = [drive(vs.load("omni_ibvs", seed=seed), naive=False)[0] for seed in range(20)]
    naive = [drive(vs.load("omni_ibvs", seed=seed), naive=True)[0] for seed in range(20)]
    assert None not in exact
    assert naive.count(None) == 20


@pytest.mark.parametrize(
    "rpy_deg", [(-45, 0, -90), (-90, 0, -90), (0, 0, -90), (-60, 10, -80), (-45, 0, 45)]
)
def test_the_basis_is_what_the_camera_does(rpy_deg):
    """Finite differences of the camera's pose for each motion of the base, any mount."""
    scenario = vs.load(
        "omni_ibvs",
        {
            "camera.mount": {"xyz": [0.2, 0.1, 0.3], "rpy_deg": list(rpy_deg)},
            "detector": "oracle",
            "detector.field_of_view": "unlimited",
            "goal": {"T_camera_target": {"xyz": [0, 0, 3]}},
        },
    )
    mount, d = Mount.of(scenario.camera.mount.T), 1e-6
    basis = scenario.robot.motion_basis(mount, scenario.robot.start_joints())
    for i in range(3):
        T = inverse(mount.T_flange_camera) @ exp(PLANE[:, i] * d) @ mount.T_flange_camera
        twist = np.array([*T[:3, 3], T[2, 1], T[0, 2], T[1, 0]]) / d
        np.testing.assert_allclose(basis[:, i], twist, atol=1e-6)
