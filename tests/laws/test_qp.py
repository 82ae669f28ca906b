"""Law qp: the law within where nothing binds, and constraints that hold where the law within would
break them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ScenarioError
from vstestbed.core.geometry import exp, transform
from vstestbed.features.depth import Constant
from vstestbed.laws import IBVS, PBVS, QP, Hybrid, Law, Partitioned, Predictive, constraints
from vstestbed.laws.base import TwistLimits
from vstestbed.laws.feedforward import KalmanCA
from vstestbed.laws.qp import Manipulability, PosturePull, StraightPath, manipulability
from vstestbed.robots.arm import Arm, singularity_damping2
from vstestbed.studies.batch import started_at
from vstestbed.testing import check_law


class Frames:
    """Keeps the frames of a run."""

    def __init__(self) -> None:
        self.kept: list[vs.Frame] = []

    def frame(self, frame: vs.Frame) -> None:
        """Keep it."""
        self.kept.append(frame)


def flown(
    law: Law[Any], name: str = "arm_ibvs", changes: dict[str, Any] | None = None
) -> tuple[Any, list[vs.Frame]]:
    """A run by another law with exact pixels, and its frames."""
    scenario, frames = vs.load(name, {"detector": "oracle"} | (changes or {})), Frames()
    return vs.run(replace(scenario, law=law), watch=[frames]), frames.kept


WITHIN = [
    IBVS(),
    IBVS(feature="polar", interaction="mean"),  # type: ignore[arg-type] - a kind's word
    IBVS(feature="line"),  # type: ignore[arg-type] - a kind's word
    IBVS(feature="spherical"),  # type: ignore[arg-type] - a kind's word
    PBVS(),
    Hybrid(),
    Partitioned(),
]


@pytest.mark.parametrize(
    "within", WITHIN, ids=lambda law: f"{law.kind} {law.feature.kind if law.feature else ''}"
)
def test_where_nothing_binds_it_is_the_law_within(within: Any) -> None:
    law = QP(law=within)
    _, frames = flown(law, changes={"stop.duration_s": 0.3})
    state = within.init(frames[0].goal)
    free = 0
    for frame in frames:
        state, alone = within.step(state, frame.observation, frame.goal, np.eye(6))
        if frame.command.mode == 0:
            free += 1
            np.testing.assert_allclose(
                frame.command.twist, alone.twist, atol=2e-4 * np.abs(alone.twist).max()
            )
    assert free >= len(frames) - 3  # the first ones accelerate


def test_it_does_what_every_law_must() -> None:
    check_law(QP(law=PBVS()))  # with their own settings, both kinds are in the catalogue


ROTATED = {"stop.duration_s": 20, "camera.latency_s": 0.04}


def start_turned(deg: float, nearer_m: float = 0.0) -> dict[str, Any]:
    """The Puma's start turned about the camera's axis by an angle from its goal, and that much
    nearer to the target.
    """
    scenario = vs.load("arm_ibvs")
    mount, robot = scenario.camera.mount.T, scenario.robot
    goal = scenario.target.pose.T @ np.linalg.inv(scenario.goal_view.T_camera_target)
    at = goal @ exp(np.array([0, 0, nearer_m, 0, 0, np.radians(deg)])) @ np.linalg.inv(mount)
    q = robot.configuration_at(at, robot.configuration())
    return {"robot.start.nominal.q_deg": np.degrees(q).tolist()}


@pytest.mark.parametrize(
    ("law", "outcome"),
    [(IBVS(), "joint_limit"), (QP(), "converged"), (Predictive(), "converged")],
    ids=lambda x: getattr(x, "kind", x),
)
def test_about_the_axis_points_end_at_a_joints_stop_and_the_program_goes_on(
    law: Law[Any], outcome: str
) -> None:
    recording, frames = flown(law, changes=ROTATED | start_turned(100.0))
    assert recording.outcome.name == outcome
    limits, q = (
        np.array([[-160, 160], [-45, 225], [-225, 45], [-110, 170], [-100, 100], [-266, 266]]),
        np.degrees([f.truth.q for f in frames]),
    )
    room = np.minimum(q - limits[:, 0], limits[:, 1] - q).min()
    assert room > (0.9 if law.kind == "ibvs" else 1.5)
    if law.kind != "ibvs":
        assert sum(frame.command.mode > 0 for frame in frames) > 10


def near_the_border(scenario: vs.Scenario, seed: int) -> np.ndarray:
    """A pose T_camera_target (4, 4) with all markers in the picture, the edge of one 5 to 40 px
    from its border.
    """
    rng, camera, points, radius = (
        np.random.default_rng(seed),
        scenario.camera,
        scenario.target.points,
        scenario.target.marker.radius,
    )
    while True:
        T = exp(np.concatenate([np.zeros(3), rng.uniform(-1, 1, 3) * np.radians([30, 30, 90])]))
        T[2, 3] = rng.uniform(0.8, 2.0)
        T[:2, 3] = rng.uniform(-0.6, 0.6, 2) * T[2, 3]
        if (
            camera.whole(transform(T, points), radius, 5.0).all()
            and edge_px(scenario, transform(T, points)) <= 40
        ):
            return T


def edge_px(scenario: vs.Scenario, p: np.ndarray) -> float:
    """Least distance of a marker's edge from the border [px], of markers p (N, 3) in the camera
    frame [m].
    """
    camera = scenario.camera
    radius = camera.half_size(p, scenario.target.marker.radius).max(axis=1)
    return float((camera.borders(camera.project(p))[0].min(axis=1) - radius).min())


@pytest.mark.parametrize(
    ("within", "seed"), [(IBVS(interaction="desired"), 10), (PBVS(), 6)], ids=["desired", "pbvs"]
)
def test_markers_stay_in_the_picture(within: Any, seed: int) -> None:
    free = vs.load(
        "ibvs_book",
        {
            "detector": {"kind": "oracle", "field_of_view": "unlimited"},
            "camera.rate_hz": 25,
            "camera.latency_s": 0.04,
        },
    )
    start = near_the_border(free, seed)
    least = {}
    for law in (within, QP(law=within)):
        frames = Frames()
        recording = vs.run(replace(started_at(free, start), law=law), watch=[frames])
        assert recording.outcome.name == "converged"
        least[law.kind] = min(edge_px(free, frame.truth.p_camera) for frame in frames.kept)
    assert least[within.kind] < 0 and least["qp"] > 3.5  # of 5 px asked for


def test_a_twist_limit_is_kept_by_what_remains_of_the_motion() -> None:
    _, frames = flown(QP(limits=TwistLimits(speed_mps=0.1)), changes={"stop.duration_s": 1.0})
    speeds = [float(np.linalg.norm(frame.command.twist[:3])) for frame in frames]
    assert max(speeds) == pytest.approx(0.1, abs=1e-6)
    assert {frame.command.mode for frame in frames} <= {0, 1}


def test_contradicting_constraints_give_way_and_the_log_tells() -> None:
    # Nearer to the plane than allowed: it must go back faster than the twist limit lets it.
    law = QP(law=PBVS(), plane_m=0.95, limits=TwistLimits(speed_mps=0.05), barrier_gain=3.0)
    recording, frames = flown(law, changes={"stop.duration_s": 1.0} | start_turned(0.0, 0.2))
    assert law.modes[4] == "plane gave way" and 4 in {frame.command.mode for frame in frames}
    np.testing.assert_array_equal(
        recording.frame()["law_mode"], [frame.command.mode for frame in frames]
    )
    assert all(np.linalg.norm(frame.command.twist[:3]) < 0.05 + 1e-6 for frame in frames)


@pytest.mark.parametrize("law", [QP(), Predictive()], ids=lambda law: law.kind)
def test_a_program_that_is_not_solved_gives_a_rest_with_its_reason(
    law: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        constraints,
        "load_solver",
        lambda: lambda *a, **k: (np.zeros(6), 0.0, -4, {"lam": np.zeros(6)}),
    )
    recording, frames = flown(law, changes={"stop.duration_s": 0.2})
    assert all(
        frame.command.rest_reason.endswith("the solver stopped with code -4") for frame in frames
    )
    assert {frame.command.mode for frame in frames} == {law.modes.index("not solved")}
    assert recording.outcome.name == "timed_out"


def test_a_goal_beyond_the_plane_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"law.plane_m: must be under 1 m"):
        vs.load("arm_ibvs", {"law": {"kind": "qp", "plane_m": 5.0}})


def test_a_goal_inside_the_margin_is_refused() -> None:
    for law in ("qp", "predictive"):
        with pytest.raises(
            ScenarioError, match=r"law.margin_px: reaches marker 1 of the goal view"
        ):
            vs.load("arm_ibvs", {"law": {"kind": law, "margin_px": 300.0}})


def test_a_strict_posture_moves_what_two_markers_do_not_see() -> None:
    two = vs.load("arm_avoid_limits", {"detector": "oracle", "stop.duration_s": 1.0})
    within, wanted = (
        IBVS(redundant=True, depth=Constant(depth_m=1.0)),
        two.robot.start_joints() + np.radians([0, 0, 0, 30, 0, 30]),
    )
    away, errors = {}, {}
    for name, tasks in (
        ("alone", ()),
        ("posture", (PosturePull(gain=1.0, q_deg=tuple(np.degrees(wanted).tolist())),)),
    ):
        frames = Frames()
        vs.run(replace(two, law=QP(law=within, margin_px=None, secondary=tasks)), watch=[frames])
        away[name] = np.linalg.norm(frames.kept[-1].truth.q - wanted)
        errors[name] = np.array([frame.error.rms_px for frame in frames.kept])
    assert away["posture"] < away["alone"] - 0.005
    # the features do not see it
    np.testing.assert_allclose(errors["posture"], errors["alone"], rtol=0.03, atol=0.3)


def test_a_straight_path_is_straighter() -> None:
    straight = {}
    for name, tasks in (("alone", ()), ("straight", (StraightPath(),))):
        recording, _ = flown(QP(law=IBVS(interaction="mean"), secondary=tasks))
        straight[name] = recording.summary()["path_ratio"]
    assert straight["straight"] < 1.002 < 1.02 < straight["alone"]


def test_the_straight_way_has_no_direction_within_a_millimetre_of_the_goal() -> None:
    scenario = vs.load("arm_ibvs")
    q = scenario.robot.start_joints()
    model = scenario.robot.own_model(vs.Reading(q, 0 * q), vs.Controller(scenario).mount)
    with vs.Session(
        replace(scenario, detector=vs.load("arm_ibvs", {"detector": "oracle"}).detector)
    ) as session:
        frame = session.reset()
    for aside, rows in ((0.0009, 0), (0.0011, 3)):
        T = frame.goal.T_camera_target.copy()
        T[0, 3] += aside
        A, b = StraightPath().rows(replace(frame.observation, T_camera_target=T), frame.goal, model)
        assert A.shape == (rows, 6) and not b.any()
    # across the line to the goal, along x here, no velocity is wanted, and along it any
    assert np.linalg.matrix_rank(A) == 2 and np.abs(A[0]).max() < 1e-12


def test_manipulability_grows_along_its_task() -> None:
    scenario = vs.load("arm_ibvs")
    q = scenario.robot.start_joints()
    model = scenario.robot.own_model(vs.Reading(q, 0 * q), vs.Controller(scenario).mount)
    rows, wanted = Manipulability(gain=0.1).rows(None, None, model)  # type: ignore[arg-type] # it reads the robot alone
    np.testing.assert_array_equal(rows, np.eye(6))
    assert np.linalg.norm(wanted) == pytest.approx(0.1)
    assert manipulability(model.jacobian(q + 0.05 * wanted)) > manipulability(model.J)
    slope = [
        manipulability(model.jacobian(q + d)) - manipulability(model.jacobian(q - d))
        for d in 1e-3 * np.eye(6)
    ]
    assert wanted / 0.1 == pytest.approx(np.array(slope) / np.linalg.norm(slope), abs=1e-3)


def test_near_a_singularity_joints_turn_as_damped_least_squares_have_them() -> None:
    scenario = vs.load("arm_ibvs", {"law": "pbvs"})
    q = scenario.robot.start_joints()
    q[4] = 0.002  # the axes of joints 4 and 6 nearly on one line
    model = scenario.robot.own_model(vs.Reading(q, 0 * q), vs.Controller(scenario).mount)
    model = replace(model, **dict.fromkeys(("underway", "coming", "ordered", "moved"), np.zeros(6)))
    assert isinstance(scenario.robot, Arm)
    damping2 = singularity_damping2(model.J, scenario.robot.unit_m)
    assert 0.001 < damping2 < 0.0025
    goal, off = scenario.goal_view, exp(np.array([0.002, -0.001, 0.003, 0.004, 0.003, -0.002]))
    T = off @ goal.T_camera_target
    p = transform(T, scenario.target.points)
    seen = vs.Observation(
        0.0, scenario.camera.project(p), p[:, :2] / p[:, 2:], p[:, 2], T, robot=model
    )
    law = QP(law=PBVS(), accelerations=False)
    twist = PBVS().step(PBVS().init(goal), seen, goal, np.eye(6))[1].twist
    _, command = law.step(law.init(goal), seen, goal, model.J)
    expected = np.linalg.solve(model.J.T @ model.J + damping2 * np.eye(6), model.J.T @ twist)
    assert command.rates == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())
    assert np.abs(np.linalg.solve(model.J, twist)).max() > 5 * np.abs(expected).max()


def test_prediction_follows_a_target_that_moves() -> None:
    off = {}
    for name, law in (("without", Predictive()), ("with", Predictive(feedforward=KalmanCA()))):
        _, frames = flown(law, "arm_track_circle", {"stop.duration_s": 4.0})
        off[name] = float(np.median([frame.error.rms_px for frame in frames[50:]]))
    assert off["with"] < 0.4 * off["without"]
