"""Observer: depth as the scenario says, pose carried over gaps, noise, the estimate from motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.shortcuts import one_quick
from vstestbed.camera import Fisheye, Perspective, SphericalCamera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, exp, inverse, rigid_error, transform
from vstestbed.features.depth import AtGoal, Constant, Depth, Estimate, OracleDepth, PnP
from vstestbed.features.observation import Goal, Observation
from vstestbed.targets.base import Square
from vstestbed.vision import Detection, Observer, observe

CAMERA = Perspective(distortion=(-0.1, 0.02, 0.001, -0.001, 0.0))
TARGET = Square(pose=Pose(), side=0.4)
GOAL = Goal.from_view(CAMERA, TARGET.points, Pose(xyz=(0, 0, 1.3)).T)
START = Pose(xyz=(0.1, -0.05, 1.6), rpy_deg=(10, -15, 20)).T
REST = np.zeros(6)
P_START, RNG = transform(START, TARGET.points), np.random.default_rng(0)
DT = 0.04


def _observer(depth: Depth, sigma: float = 0.0) -> Observer:
    return Observer(camera=CAMERA, target=TARGET, goal=GOAL, depth=depth, pixel_sigma_px=sigma)


def _detection(T: Array, lost: tuple[int, ...] = (), oracle: bool = False) -> Detection:
    p = transform(T, TARGET.points)
    uv = CAMERA.project(p)
    uv[list(lost)] = np.nan
    return Detection(uv=uv, p_camera=p if oracle else None)


def _once(depth: Depth, detection: Detection) -> Observation:
    observer = _observer(depth)
    return observer.observe(observer.init(), 0.0, detection, REST, np.random.default_rng(0))[1]


def test_coordinates_are_undistorted() -> None:
    p = transform(START, TARGET.points)
    seen = _once(Constant(), _detection(START))
    assert seen.xy == pytest.approx(p[:, :2] / p[:, 2:], abs=1e-10)
    assert seen.uv == pytest.approx(CAMERA.project(p), abs=0)


def test_each_source_of_depth() -> None:
    true = transform(START, TARGET.points)[:, 2]
    assert _once(PnP(), _detection(START)).depth == pytest.approx(true, abs=1e-6)
    assert _once(Constant(depth_m=2.0), _detection(START)).depth == pytest.approx([2.0] * 4)
    assert _once(AtGoal(), _detection(START)).depth == pytest.approx([1.3] * 4)
    assert _once(Estimate(initial_m=0.7), _detection(START)).depth == pytest.approx([0.7] * 4)
    assert _once(OracleDepth(), _detection(START, oracle=True)).depth == pytest.approx(true, abs=0)


class TestRadius:
    """Apparent radii from the target's model and the depth that the law knows."""

    def seen(self, depth: Depth, **changes: object) -> Observation:
        given = {"required_fields": ("xy", "depth", "radius_px")} | changes
        observer = replace(_observer(depth), **given)  # pyright: ignore[reportArgumentType]
        return observer.observe(
            observer.init(), 0.0, Detection(uv=observer.camera.project(P_START)), REST, RNG
        )[1]

    def test_of_a_pinhole_it_is_f_r_over_z(self) -> None:
        flat = Perspective()
        found = self.seen(
            PnP(), camera=flat, goal=Goal.from_view(flat, TARGET.points, Pose(xyz=(0, 0, 1.3)).T)
        ).radius_px
        assert found == pytest.approx(flat.f * TARGET.marker.radius / P_START[:, 2], rel=1e-6)

    def test_it_is_what_cuts_a_marker_at_the_border(self) -> None:
        lens = Fisheye(width=640, height=640, fov_deg=180)
        goal = Goal.from_view(lens, TARGET.points, Pose(xyz=(0, 0, 1.3)).T)
        found = self.seen(
            AtGoal(), camera=lens, goal=goal, required_fields=("ray", "range", "radius_px")
        ).radius_px
        # At the goal's ranges, whatever the true ones.
        p = P_START / np.linalg.norm(P_START, axis=1, keepdims=True) * goal.range[:, None]
        assert found == pytest.approx(lens.half_size(p, TARGET.marker.radius).max(axis=1), rel=1e-9)

    def test_unseen_markers_have_none_and_laws_without_a_field_do_not_pay_for_it(self) -> None:
        observer = replace(_observer(AtGoal()), required_fields=("xy", "depth", "radius_px"))
        seen = _detection(START, lost=(2,))
        found = observer.observe(observer.init(), 0.0, seen, REST, RNG)[1].radius_px
        assert found is not None and np.isfinite(found).tolist() == [True, True, False, True]
        assert _once(AtGoal(), _detection(START)).radius_px is None


def test_oracle_depth_without_the_oracle_says_what_would_work() -> None:
    with pytest.raises(ParameterError, match=r"oracle.*pnp, constant, goal, estimate"):
        _once(OracleDepth(), _detection(START))


def test_pose_of_the_detector_is_taken() -> None:
    T = START @ exp(np.array([0, 0, 0.1, 0, 0, 0]))
    seen = _once(PnP(), Detection(uv=_detection(START).uv, T_camera_target=T))
    assert seen.T_camera_target is T
    assert seen.depth == pytest.approx(transform(T, TARGET.points)[:, 2])


def test_no_pose_no_depth() -> None:
    seen = _once(PnP(), _detection(START, lost=(0, 1)))
    assert seen.T_camera_target is None
    assert np.isnan(seen.depth).all()


def test_pose_is_carried_on_by_the_commanded_motion() -> None:
    observer, rng = _observer(PnP()), np.random.default_rng(0)
    twist = np.array([0.1, -0.2, 0.3, 0.2, 0.1, -0.3])
    state, T = observer.init(), START
    for k in range(20):
        lost = () if k < 5 else (0, 1, 2)
        state, seen = observer.observe(state, k * DT, _detection(T, lost), twist, rng)
        assert seen.T_camera_target is not None
        # constant twist: the step is exact
        assert rigid_error(seen.T_camera_target, T) == pytest.approx((0, 0), abs=1e-6)
        assert seen.seen.tolist() == [i not in lost for i in range(4)]
        T = inverse(exp(twist * DT)) @ T


def test_three_markers_go_on_with_the_pose() -> None:
    observer, rng = _observer(PnP()), np.random.default_rng(0)
    state, _ = observer.observe(observer.init(), 0.0, _detection(START), REST, rng)
    moved = exp(np.array([0.01, 0, 0.01, 0, 0.01, 0])) @ START
    _, seen = observer.observe(state, DT, _detection(moved, lost=(2,)), REST, rng)
    assert seen.T_camera_target is not None
    assert rigid_error(seen.T_camera_target, moved) == pytest.approx((0, 0), abs=1e-5)


def test_pixel_noise_is_drawn_from_the_generator_and_is_solved_again() -> None:
    observer = _observer(PnP(), sigma=0.5)
    clean = Detection(uv=_detection(START).uv, T_camera_target=START)
    first = observer.observe(observer.init(), 0.0, clean, REST, np.random.default_rng(7))[1]
    again = observer.observe(observer.init(), 0.0, clean, REST, np.random.default_rng(7))[1]
    assert first.uv.tobytes() == again.uv.tobytes()
    assert first.T_camera_target is not None
    assert rigid_error(first.T_camera_target, START)[0] > 1e-5
    rng = np.random.default_rng(1)
    draws = [
        observer.observe(observer.init(), 0.0, clean, REST, rng)[1].uv - clean.uv
        for _ in range(300)
    ]
    assert np.std(draws) == pytest.approx(0.5, rel=0.06)  # 2400 draws: 1.4 % standard error


def _run_estimate(
    twist_at: Depth | None = None, *, sigma: float = 0.0, frames: int = 75, still: int = 0
) -> tuple[Array, Array]:
    """Estimated and true depths (4,) after a slow curve that starts at the wrong depth of 1 m; at
    rest for the last frames.
    """
    observer, rng = (
        _observer(Estimate(initial_m=1.0, forget_s=0.5), sigma),
        np.random.default_rng(0),
    )
    state, T, twist, depth = observer.init(), START, REST, np.zeros(4)
    for k in range(frames + still):
        state, seen = observer.observe(state, k * DT, _detection(T), twist, rng)
        depth = seen.depth
        twist = (
            REST
            if k >= frames - 1
            else np.array([0.15 * np.cos(0.1 * k), 0.15 * np.sin(0.1 * k), 0.05, 0.05, -0.04, 0.1])
        )
        T = inverse(exp(twist * DT)) @ T
    return depth, transform(T, TARGET.points)[:, 2]


def test_estimate_converges_to_the_true_depth() -> None:
    depth, true = _run_estimate()
    assert abs(true - 1.0).min() > 0.3
    assert depth == pytest.approx(true, rel=2e-3)  # flow over 40 ms is a mean, not a derivative


def test_estimate_under_noise_and_kept_at_rest() -> None:
    depth, true = _run_estimate(sigma=0.1)
    assert depth == pytest.approx(true, rel=0.15)
    rested, true = _run_estimate(sigma=0.1, still=500)
    # noise without motion teaches nothing; Z = R cos has the pixel's own
    assert rested == pytest.approx(depth, rel=1e-3)


@pytest.mark.parametrize("ratio", one_quick(3.0, 0.3))
@pytest.mark.parametrize("sigma", [0.0, 0.05])
def test_estimate_from_far_off_converges_and_does_not_drift_as_motion_fades(
    ratio: float, sigma: float
) -> None:
    # The motion of a servo: it dies away over 2 s. Depths within 1 % after 1 s, and still so at the
    # end.
    observer, rng = _observer(Estimate(initial_m=1.6 * ratio), sigma), np.random.default_rng(0)
    state, T, twist = observer.init(), START, REST
    for k in range(400):
        state, seen = observer.observe(state, k * DT, _detection(T), twist, rng)
        if k >= 25:
            assert seen.depth == pytest.approx(transform(T, TARGET.points)[:, 2], rel=0.01)
        twist = np.exp(-k * DT / 2) * np.array([0.15, -0.1, 0.1, 0.05, -0.04, 0.1])
        T = inverse(exp(twist * DT)) @ T


def test_estimate_without_motion_keeps_the_initial_depth() -> None:
    observer, rng = _observer(Estimate(initial_m=0.8), sigma=0.2), np.random.default_rng(0)
    state = observer.init()
    for k in range(50):
        state, seen = observer.observe(state, k * DT, _detection(START), REST, rng)
        # the pixels' own noise, a range being what is kept
        assert seen.depth == pytest.approx([0.8] * 4, rel=1e-3)


def test_estimate_survives_a_gap() -> None:
    observer, rng = _observer(Estimate(initial_m=1.0)), np.random.default_rng(0)
    state, seen = observer.observe(observer.init(), 0.0, _detection(START), REST, rng)
    twist = np.array([0.1, 0.05, 0, 0, 0, 0])
    T = inverse(exp(twist * DT)) @ START
    for k in range(1, 60):
        state, seen = observer.observe(
            state, k * DT, _detection(T, lost=(1,) if 20 <= k < 40 else ()), twist, rng
        )
        assert np.all(seen.depth[seen.seen] > 0)
        assert seen.depth[0] == pytest.approx(transform(T, TARGET.points)[0, 2], rel=0.01) or k < 20
        T = inverse(exp(twist * DT)) @ T
    assert seen.depth == pytest.approx(transform(T, TARGET.points)[:, 2], rel=5e-3)


def test_estimate_of_what_is_behind_the_camera() -> None:
    camera, T = (
        SphericalCamera(width=720, height=720),
        Pose(xyz=(0.2, 0.1, -1.6), rpy_deg=(10, -15, 20)).T,
    )
    goal = Goal.from_view(camera, TARGET.points, T)
    observer = Observer(
        camera=camera, target=TARGET, goal=goal, depth=Estimate(), required_fields=("ray", "range")
    )
    state, twist = observer.init(), np.array([0.15, -0.1, 0.1, 0.05, -0.04, 0.1])
    for k in range(50):
        p = transform(T, TARGET.points)
        state, seen = observer.observe(
            state, k * DT, Detection(uv=camera.project(p)), twist, np.random.default_rng(0)
        )
        T = inverse(exp(twist * DT)) @ T
    assert seen.range == pytest.approx(np.linalg.norm(p, axis=1), rel=5e-3)
    assert seen.depth == pytest.approx(p[:, 2], rel=5e-3)


def test_a_pixel_that_noise_puts_off_the_map_costs_no_more_than_itself() -> None:
    camera = SphericalCamera(width=720, height=720)
    T = Pose(xyz=(0.2, 0.2, -1)).T  # marker 0 straight behind, at the rim of the map
    uv = camera.project(transform(T, TARGET.points))
    out = uv.copy()
    out[0] += 0.5 * (uv[0] - camera.centre) / np.linalg.norm(uv[0] - camera.centre)
    assert np.isnan(camera.ray(out[0])).all()
    observer = Observer(
        camera=camera,
        target=TARGET,
        goal=Goal.from_view(camera, TARGET.points, T),
        depth=PnP(),
        required_fields=("ray", "range"),
    )
    state, rng = observer.init(), np.random.default_rng(0)
    state, _ = observer.observe(state, 0.0, Detection(uv=uv), REST, rng)
    moved = inverse(exp(np.array([0.01, 0, 0, 0, 0, 0]))) @ T
    now = camera.project(transform(moved, TARGET.points))
    now[0] = out[0]
    seen = observer.observe(state, DT, Detection(uv=now), REST, rng)[1]
    assert seen.T_camera_target is not None
    # by the other three
    assert rigid_error(seen.T_camera_target, moved) == pytest.approx((0, 0), abs=1e-4)


@pytest.mark.parametrize("failed", [0, 2])
def test_a_picture_without_a_pose_costs_no_later_one(
    failed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first picture or a later one: the next is solved as if there had been no failure."""
    observer, rng = _observer(PnP()), np.random.default_rng(0)
    state, solver, poses = observer.init(), observe.solve_pose_from_rays, []
    for k in range(4):
        monkeypatch.setattr(
            observe, "solve_pose_from_rays", (lambda *_: None) if k == failed else solver
        )
        state, seen = observer.observe(state, k * DT, _detection(START), REST, rng)
        poses.append(seen.T_camera_target)
    for k, T in enumerate(poses):
        if k == failed == 0:
            assert T is None
        else:  # a later failure is bridged by the camera's own motion
            assert T is not None and rigid_error(T, START) == pytest.approx((0, 0), abs=1e-6)
