"""The textbook's example of an arm and its exercises, as scenarios."""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.geometry import Array


def way(r: vs.Recording) -> Array:
    """Camera positions in the world (frames, 3) [m]."""
    return np.column_stack([r[f"cam_{a}"] for a in "xyz"])


def off_path(places: Array, path: Array) -> Array:
    """Distance (n,) of places (n, 3) from the line through the points of a path (m, 3) [m]."""
    a, along = path[:-1], np.diff(path, axis=0)
    share = np.einsum("nmk,mk->nm", places[:, None] - a, along) / np.maximum(
        np.einsum("mk,mk->m", along, along), 1e-18
    )
    nearest = a + np.clip(share, 0, 1)[..., None] * along
    return np.linalg.norm(places[:, None] - nearest, axis=2).min(axis=1)


@pytest.fixture(scope="module")
def printed() -> vs.Recording:
    return vs.run(vs.load("arm_book"))


class TestArmAsPrinted:
    """`arm_book` against the same loop written down here once more: the arm by its table, the law
    by its equation, no simulator.
    """

    TABLE = (
        (0.67183, 0, 90),
        (0, 0.4318, 0),
        (0.15005, 0.0203, -90),
        (0.4318, 0, 90),
        (0, 0, -90),
        (0, 0, 0),
    )
    """Standard Denavit-Hartenberg parameters d [m], a [m], alpha [deg] of a Puma 560."""
    MARKERS = np.array(
        [[1.5, -0.25, 0.95], [1.5, -0.25, 0.45], [1.5, 0.25, 0.45], [1.5, 0.25, 0.95]]
    )
    GOAL = (np.array([[300, 300], [700, 300], [700, 700], [300, 700]]) - 500) / 800
    START_DEG, GAIN, PERIOD_S = (0, 45, -180, 0, 45, -45), 0.5, 0.04

    def hand(self, q: Array) -> Array:
        """T_base_hand (4, 4)."""
        T = np.eye(4)
        for angle, (d, a, alpha) in zip(q, self.TABLE, strict=True):
            c, s = np.cos(angle), np.sin(angle)
            ca, sa = np.round(np.cos(np.radians(alpha))), np.round(np.sin(np.radians(alpha)))
            T = T @ [
                [c, -s * ca, s * sa, a * c],
                [s, c * ca, -c * sa, a * s],
                [0, sa, ca, d],
                [0, 0, 0, 1],
            ]
        return T

    def jacobian(self, q: Array, h: float = 1e-6) -> Array:
        """Twist of the hand in its frame by joint velocities (6, 6), by central differences."""
        T, columns = self.hand(q), []
        for step in h * np.eye(6):
            rate = np.linalg.inv(T) @ (self.hand(q + step) - self.hand(q - step)) / (2 * h)
            columns.append([*rate[:3, 3], rate[2, 1], rate[0, 2], rate[1, 0]])
        return np.array(columns).T

    def integrated(self, depth_m: float | None, frames: int) -> Array:
        """Camera positions (frames, 3) [m]; the joint velocities of a frame last until the next
        one. None: the true depths.
        """
        q, places = np.radians(self.START_DEG).astype(float), []
        for _ in range(frames):
            T = self.hand(q)
            places.append(T[:3, 3])
            p = (self.MARKERS - T[:3, 3]) @ T[:3, :3]
            L = []
            for (x, y), z in zip(
                p[:, :2] / p[:, 2:], p[:, 2] if depth_m is None else [depth_m] * 4, strict=True
            ):
                L += [
                    [-1 / z, 0, x / z, x * y, -1 - x * x, y],
                    [0, -1 / z, y / z, 1 + y * y, -x * y, -x],
                ]
            v = -self.GAIN * np.linalg.pinv(L) @ (p[:, :2] / p[:, 2:] - self.GOAL).ravel()
            q = q + np.linalg.solve(self.jacobian(q), v) * self.PERIOD_S
        return np.array(places)

    def test_the_start_is_the_printed_one(self, printed: vs.Recording):
        assert way(printed)[0] == pytest.approx([0.596, -0.150, 0.657], abs=6e-4)
        assert printed["u_goal_0"][0] == pytest.approx(299.5)
        assert printed["v_goal_2"][0] == pytest.approx(699.5)

    def test_every_frame_is_where_exact_kinematics_have_it(self, printed: vs.Recording):
        assert printed.outcome is vs.Outcome.converged
        off = np.linalg.norm(way(printed) - self.integrated(1.0, len(printed["t"])), axis=1)
        assert off.max() < 2e-5

    def test_the_depth_of_1_m_is_wrong_on_the_way_and_costs_2_mm_of_path(
        self, printed: vs.Recording
    ):
        own = vs.run(vs.load("arm_book", {"law.depth": "oracle"}))
        depths = np.array([own[f"depth_{i}"] for i in range(4)])
        assert depths.min() == pytest.approx(0.904, abs=1e-3)
        assert depths.max() == pytest.approx(1.040, abs=1e-3)
        n = min(len(own["t"]), len(printed["t"]))
        assert np.linalg.norm(way(own)[:n] - self.integrated(None, n), axis=1).max() < 2e-5
        assert off_path(way(printed), way(own)).max() == pytest.approx(1.9e-3, abs=1e-4)

    @pytest.mark.parametrize(
        ("depth_m", "outcome", "retreat_m"),
        one_quick((0.5, "converged", 0.005), (2, "converged", 0.095), (4, "joint_limit", 0.150)),
    )
    def test_a_depth_far_off_changes_the_run(
        self, printed: vs.Recording, depth_m: float, outcome: str, retreat_m: float
    ):
        found = vs.run(
            vs.load("arm_book", {"law.depth": {"kind": "constant", "depth_m": depth_m}})
        ).summary()
        assert found["outcome"] == outcome
        assert found["max_retreat_m"] == pytest.approx(retreat_m, abs=1e-3)
        assert printed.summary()["max_retreat_m"] == pytest.approx(0.043, abs=1e-3)
        if depth_m == 0.5:
            assert found["time_to_converge_s"] > 1.7 * printed.summary()["time_to_converge_s"]


class TestPartitioned:
    """With exact pixels in place of rendered ones, for speed;
    the bundled scenarios have `blobs`.
    """

    def run(self, name: str, **changes: object) -> vs.Recording:
        return vs.run(vs.load(name, {"detector": "oracle", **changes}))

    def test_two_markers_leave_the_picture_and_stay_with_the_field(self):
        leaves, stays = self.run("partitioned_leaves"), self.run("partitioned_repelled")
        assert leaves.outcome is vs.Outcome.target_lost
        assert leaves.reason.startswith("too few markers in sight")
        assert np.isfinite([leaves[f"u_{i}"][-1] for i in range(4)]).sum() < 3
        assert stays.outcome is vs.Outcome.converged and not stays["lost"].any()
        assert stays.summary()["min_border_margin_px"] > 50

    @pytest.mark.study
    def test_another_partition_takes_the_shorter_way(self):
        across = self.run("partitioned_xy")
        along = self.run("partitioned_xy", **{"law.axes": ["z", "wz"], "law.gain_z": 0.5})
        assert across.outcome is along.outcome is vs.Outcome.converged
        assert across.summary()["path_ratio"] < 1.1
        assert along.summary()["path_ratio"] > 1.5


def test_a_camera_beside_the_wrist():
    """10 cm and 20 degrees off: the law's twist becomes one of the wrist, and the camera arrives as
    one at the wrist does.
    """
    scenario = vs.load("arm_offset", {"detector": "oracle"})
    mount = scenario.camera.mount.T
    assert np.linalg.norm(mount[:3, 3]) == pytest.approx(0.10, abs=1e-6)
    assert np.degrees(np.arccos((np.trace(mount[:3, :3]) - 1) / 2)) == pytest.approx(19, abs=1)
    r = vs.run(scenario)
    assert r.outcome is vs.Outcome.converged and r["position_error_m"][-1] < 0.003


class TestRow:
    """Twelve balls, three views of four each, with exact pixels."""

    @pytest.mark.study
    def test_it_follows_the_row_by_four_balls_at_a_time(self):
        scenario = vs.load("quadrotor_row", {"detector": "oracle"})
        r = vs.run(scenario)
        assert r.outcome is vs.Outcome.converged
        seen = np.isfinite([r[f"u_{i}"] for i in range(12)])
        for view, markers in enumerate((range(4), range(4, 8), range(8, 12))):
            during = r["view"] == view
            assert (seen[list(markers)][:, during].all(axis=0)).mean() > 0.8  # those that count
            others = [i for i in range(12) if i not in markers]
            assert not seen[others][:, during].any()  # nothing else reaches the law
        flown = np.column_stack([r["cam_x"], r["cam_y"]])
        assert all(np.hypot(*(flown - [x, 0]).T).min() < 0.15 for x in (0, 3, 6))

    def test_a_random_start_needs_the_first_four_alone_in_view(self):
        scenario = vs.load("quadrotor_row").randomised(0).resolved
        assert scenario.robot.start.nominal != vs.load("quadrotor_row").robot.start.nominal
