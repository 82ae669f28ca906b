"""A batch of ideal loops against the golden rows, and against the time loop."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from tests.laws.flight import book_camera
from tests.loop.test_golden_loops import ROWS, SET, STARTS, decided_by_rounding, law_of, pose
from tests.shortcuts import one_quick
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, inverse
from vstestbed.core.named_files import bundled_scenarios
from vstestbed.features import FEATURES, Ellipse, Feature, LineFeature, Moments, Polar, Polygon
from vstestbed.features.depth import AtGoal, Constant, Estimate, OracleDepth
from vstestbed.features.observation import Observation
from vstestbed.laws import IBVS, LAWS, PBVS, QP, Hybrid, Law, Partitioned, Predictive
from vstestbed.laws.base import AdaptiveGain, ConstantGain, TwistLimits, has_batch
from vstestbed.laws.points import Visibility
from vstestbed.laws.solve import Solve
from vstestbed.robots import Free
from vstestbed.robots.free import FreeStart
from vstestbed.scenario.noise import Noise
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.batch import ideal, simulate_batch, start_of, started_at
from vstestbed.targets import Target
from vstestbed.targets.base import Points, Square
from vstestbed.tasks import GoalView
from vstestbed.tasks.stop import Converged, Stop
from vstestbed.vision import Oracle

FAST = ConstantGain(value=2.5)
"""A tenth a step at 25 Hz."""
BOUND = 1e-3 * 800 / np.sqrt(8)  # a norm of 1e-3 of the eight normalised coordinates

BOOK = Square(side=0.5, pose=Pose())


def scenario(
    law: Law,
    *,
    limited: bool = False,
    error_px: float = BOUND,
    hold_s: float = 0.0,
    duration_s: float = 20.0,
    target: Target = BOOK,
) -> Scenario:
    """The ideal camera 1 m before a square of .5 m, f = 800 px on 1000 x 1000, 25 Hz."""
    return Scenario(
        robot=Free(start=FreeStart(nominal=Pose(xyz=(0, 0, -1)))),
        camera=book_camera(),  # pyright: ignore[reportArgumentType]
        target=target,  # pyright: ignore[reportArgumentType]
        detector=Oracle(field_of_view="limited" if limited else "unlimited"),
        law=law,  # pyright: ignore[reportArgumentType]
        goal=GoalView(T_camera_target=Pose(xyz=(0, 0, 1))),
        stop=Stop(duration_s=duration_s, converged=Converged(error_px=error_px, hold_s=hold_s)),
    )


def from_(*poses: Pose) -> Array:
    """T_camera_target of cameras at poses in the target's frame."""
    return np.array([inverse(p.T) for p in poses])


def drawn(n: int, yaw: float = 170, seed: int = 3) -> Array:
    rng = np.random.default_rng(seed)
    return from_(
        *(
            Pose(
                xyz=(*rng.uniform(-0.8, 0.8, 2).tolist(), rng.uniform(-2.5, -0.8)),
                rpy_deg=(*rng.uniform(-25, 25, 2).tolist(), a),
            )
            for a in rng.uniform(-yaw, yaw, n).tolist()
        )
    )


def golden_kinds() -> list[tuple[str, str]]:
    return list(dict.fromkeys((r["law"], r["L"]) for r in ROWS))


@pytest.mark.parametrize(("law", "interaction"), golden_kinds(), ids=lambda word: word.lower())
def test_golden_rows_at_once(law: str, interaction: str):
    rows = [
        r for r in ROWS if (r["law"], r["L"]) == (law, interaction) and not decided_by_rounding(r)
    ]
    rows = [r for r in rows if STARTS[r["scenario"]]["square_half_side"] == 0.25]
    # There a camera behind the target's plane flies on, here it has lost its target
    # (tests/test_golden_loops.py).
    rows = [
        r
        for r in rows
        if (r["scenario"], law, interaction) != ("book_sph", "ibvs_polar", "DESIRED")
    ]
    starts = from_(
        *(pose(STARTS[r["scenario"]]["wtc0"], STARTS[r["scenario"]]["wqc0_xyzw"]) for r in rows)
    )
    found = simulate_batch(
        scenario(law_of(law, interaction), duration_s=SET["max_iterations"] * SET["dt"]), starts
    )
    assert len(rows) >= 4
    for i, row in enumerate(rows):
        expected = {
            "target_plane_crossed_or_behind": "target_lost",
            "diverged_dist>200m": "diverged",
        }.get(row["status"], row["status"])
        assert found.outcome[i].name == expected
        if expected == "converged":  # the golden files' own tolerances; distances have four digits
            assert abs(found.near[i] - int(row["it_e<1e-3"])) <= 1
            assert found.farthest_m[i] == pytest.approx(float(row["max_cam_dist_m"]), abs=1e-3)


EVERY = {
    **{
        f"ibvs_{kind}": IBVS(gain=FAST, feature=FEATURES.members[kind](), interaction="mean")
        for kind in FEATURES.members
        # of one marker each: others need other targets, or leave motions open
        if FEATURES.members[kind].rows_per_marker
    },
    "ibvs_current": IBVS(gain=FAST),
    "qp_desired": QP(law=IBVS(gain=FAST, interaction="desired")),
    "qp_pose": QP(law=PBVS(gain=FAST), margin_px=20.0),
    "ibvs_desired": IBVS(gain=FAST, interaction="desired"),
    "ibvs_adaptive": IBVS(gain=AdaptiveGain(at_zero=3, at_infinity=1, slope_at_zero=10)),
    "ibvs_smooth": IBVS(gain=FAST, smooth_start_s=0.3, smoothing_s=0.1),
    "ibvs_limits": IBVS(gain=FAST, limits=TwistLimits(speed_mps=0.3, rate_radps=0.5)),
    "ibvs_constant": IBVS(gain=FAST, depth=Constant(depth_m=1.5)),
    "ibvs_at_goal": IBVS(gain=FAST, depth=AtGoal()),
    "partitioned": Partitioned(gain=FAST, gain_z=2.5, gain_turn=2.5),
    "partitioned_limits": Partitioned(
        gain=FAST, gain_z=2.5, gain_turn=2.5, sigma="log", turn_limits_deg=(-200, 20)
    ),
    **{f"pbvs_{t}": PBVS(gain=FAST, translation=t) for t in ("cdMc", "cMcd", "cMo")},  # pyright: ignore[reportArgumentType]
    **{
        f"{law.kind}_{word}": replace(law, solve=solve)
        for law in (
            IBVS(gain=FAST),
            Partitioned(gain=FAST, gain_z=2.5, gain_turn=2.5),
            PBVS(gain=FAST),
            Hybrid(gain=FAST),
        )
        for word, solve in (("cutoff", Solve(cutoff=0.04)), ("damped", Solve(damping=0.1)))
    },
    "hybrid": Hybrid(gain=FAST),
    "hybrid_model": Hybrid(gain=FAST, source="model"),
}
"""Every law, and every parameter that changes what it orders."""


def test_every_law_is_there():
    assert {law.kind for law in EVERY.values()} == {
        kind for kind, law in LAWS.members.items() if hasattr(law, "step_batch")
    }
    assert {"ibvs", "partitioned", "pbvs", "hybrid"} <= {law.kind for law in EVERY.values()}


@pytest.mark.parametrize(
    "picked", [slice(0, 2), pytest.param(slice(2, 3), marks=pytest.mark.study)], ids=["", "more"]
)
# the other half of the fields of view: the study below
@pytest.mark.parametrize(
    ("name", "limited"), one_quick(*((name, bool(i % 2)) for i, name in enumerate(EVERY)), every=3)
)
def test_every_law_ends_as_in_the_time_loop(name: str, limited: bool, picked: slice):
    must_end_as_in_the_time_loop(name, limited, picked)


@pytest.mark.study
@pytest.mark.parametrize(("name", "limited"), [(name, not i % 2) for i, name in enumerate(EVERY)])
def test_every_law_with_the_other_field_of_view_ends_as_in_the_time_loop(name: str, limited: bool):
    must_end_as_in_the_time_loop(name, limited, slice(0, 3))


def must_end_as_in_the_time_loop(name: str, limited: bool, picked: slice) -> None:
    s, starts = scenario(EVERY[name], limited=limited, error_px=0.2, hold_s=0.5), drawn(3)[picked]
    found = simulate_batch(s, starts)
    for i, start in enumerate(starts):
        r = vs.run(started_at(s, start))
        last = len(r["t"]) - 1
        assert (found.outcome[i], found.steps[i]) == (r.outcome, last)
        if r.outcome is vs.Outcome.converged:
            assert found.near[i] / 25 == pytest.approx(r.summary()["time_to_converge_s"])
            # Least squares by normal equations and by a factorisation: they agree to a few digits
            # less than rounding.
            p, q = inverse(found.T_camera_target[i])[:3, 3], [r[f"cam_{n}"][-1] for n in "xyz"]
            assert p == pytest.approx(q, abs=1e-6)


ELBOW = Points(
    at=tuple(
        (x - 0.1, y - 0.15, 0.0)
        for x, y in ((0, 0), (0.3, 0), (0.3, 0.12), (0.12, 0.12), (0.12, 0.4), (0, 0.4))
    ),
    pose=Pose(),
)
DISC = Points(
    at=tuple((0.2 * float(np.cos(i)), 0.2 * float(np.sin(i)), 0.0) for i in range(6)), pose=Pose()
)


@pytest.mark.parametrize(
    ("feature", "target"),
    [(Moments(of="region"), ELBOW), (Ellipse(rows=("xn", "yn", "an")), DISC)],
    ids=lambda part: part.kind,
)
def test_features_of_all_markers_end_as_in_the_time_loop(feature: Feature, target: Points):
    law = IBVS(
        gain=FAST, feature=feature, interaction="mean", redundant=not isinstance(feature, Moments)
    )
    s, starts = scenario(law, error_px=0.2, hold_s=0.1, target=target), drawn(1, yaw=40)
    found = simulate_batch(s, starts)
    for i, start in enumerate(starts):
        r = vs.run(started_at(s, start))
        # Where motions are left open, the features reach their goal, and the camera rests beside
        # its own.
        assert r.outcome is (vs.Outcome.local_minimum if law.redundant else vs.Outcome.converged)
        assert (found.outcome[i], found.steps[i]) == (r.outcome, len(r["t"]) - 1)
        assert inverse(found.T_camera_target[i])[:3, 3] == pytest.approx(
            [r[f"cam_{n}"][-1] for n in "xyz"], abs=1e-5
        )


@pytest.mark.parametrize(
    ("interaction", "outcome"),
    [("current", "diverged"), ("desired", "target_lost"), ("mean", "local_minimum")],
    ids=str,
)
def test_a_half_turn_ends_as_in_the_time_loop(interaction: str, outcome: str):
    s = scenario(IBVS(interaction=interaction, depth=OracleDepth()))  # pyright: ignore[reportArgumentType]
    start = from_(Pose(xyz=(0, 0, -1), rpy_deg=(0, 0, 180)))
    found = simulate_batch(s, start)
    r = vs.run(started_at(s, start[0]))
    assert found.outcome[0].name == outcome == r.outcome.name
    assert bool(found.crossed[0]) is (interaction == "desired")
    if outcome == "local_minimum":
        assert found.steps[0] == len(r["t"]) - 1 == 2 * 25  # the judge waits two seconds


@pytest.mark.parametrize("interaction", ["desired", "mean"])
def test_where_neither_rest_nor_loss_is_an_end_a_half_turn_goes_on(interaction: str):
    s = scenario(IBVS(interaction=interaction, depth=OracleDepth()), duration_s=4.0)  # pyright: ignore[reportArgumentType]
    s = replace(s, stop=replace(s.stop, lost_after_s=None, lost_after_m=None, rest_after_s=None))
    start = from_(Pose(xyz=(0, 0, -1), rpy_deg=(0, 0, 180)))
    found, r = simulate_batch(s, start), vs.run(started_at(s, start[0]))
    assert found.outcome[0] is r.outcome is vs.Outcome.timed_out
    assert found.steps[0] == len(r["t"]) - 1 == 4 * 25


def test_markers_that_leave_the_picture_end_a_run_where_the_time_loop_ends_it():
    s = scenario(PBVS(gain=FAST), limited=True)
    # 35 degrees off: two markers outside from the start, too few for a pose. 10: three, which tell
    # no first pose, or four.
    starts = from_(
        *(
            Pose(xyz=(0, 0, -1), rpy_deg=(0, a, b))
            for a, b in ((35.0, 0.0), (18.0, 40.0), (10.0, 0.0))
        )
    )
    found = simulate_batch(s, starts)
    assert [o.name for o in found.outcome] == [
        vs.run(started_at(s, start)).outcome.name for start in starts
    ]
    assert [o.name for o in found.outcome] == ["target_lost", "target_lost", "converged"]
    assert not found.crossed.any()
    assert found.steps[0] == 25  # lost for a second


def test_runs_do_not_know_of_one_another():
    s, starts = (
        scenario(IBVS(feature=LineFeature(), interaction="mean", gain=FAST), error_px=0.1),
        drawn(20),
    )
    together = simulate_batch(s, starts)
    for i in range(0, 20, 7):
        alone = simulate_batch(s, starts[i : i + 1])
        assert (alone.outcome[0], alone.steps[0]) == (together.outcome[i], together.steps[i])
        assert alone.T_camera_target[0] == pytest.approx(together.T_camera_target[i], abs=1e-9)
    assert together.run_steps == together.steps.sum()


def test_many_more_than_fly_at_once_keep_their_order(monkeypatch: pytest.MonkeyPatch):
    s, starts = scenario(PBVS(gain=FAST)), drawn(30)
    whole = simulate_batch(s, starts)
    monkeypatch.setattr("vstestbed.studies.batch.AT_ONCE", 7)
    parts = simulate_batch(s, starts)
    assert (parts.steps == whole.steps).all() and parts.run_steps == whole.run_steps


def test_what_a_batch_cannot_fly_is_refused_with_what_it_can():
    start = drawn(1)
    with pytest.raises(ParameterError, match=r"law.visibility.margin_px must be 0"):
        simulate_batch(scenario(IBVS(visibility=Visibility(margin_px=20))), start)
    with pytest.raises(
        ParameterError, match=r"law.depth may not be estimate.*valid: pnp, constant, goal, oracle"
    ):
        simulate_batch(scenario(IBVS(depth=Estimate())), start)
    with pytest.raises(ParameterError, match=r"stop.converged must be judged by error_px alone"):
        simulate_batch(
            replace(scenario(IBVS()), stop=Stop(converged=Converged(position_m=0.01))), start
        )
    omni = next(name for name in bundled_scenarios() if name.startswith("omni"))
    with pytest.raises(
        ParameterError, match=r"robot.kind moves its camera in 3 directions.*use free or puma560"
    ):
        ideal(vs.load(omni))
    with pytest.raises(ParameterError, match=r"`basin.setup.ideal` makes it so"):
        simulate_batch(replace(scenario(IBVS()), noise=Noise(pixel_sigma_px=0.1)), start)


def test_the_ideal_camera_starts_where_the_arm_holds_it():
    arm = vs.load(
        "arm_ibvs",
        {"camera.latency_s": 0.1, "noise.pixel_sigma_px": 0.2, "camera.mount.xyz": [0.1, 0, 0]},
    )
    made = ideal(arm)
    assert start_of(made) == pytest.approx(start_of(arm), abs=1e-12)
    assert isinstance(made.detector, Oracle) and made.detector.field_of_view == "limited"
    other = from_(Pose(xyz=(0.2, 0.1, -1.5), rpy_deg=(5, 10, 40)))[0]
    assert start_of(started_at(made, other)) == pytest.approx(other, abs=1e-12)
    assert (
        simulate_batch(made, start_of(made)).outcome[0]
        is vs.run(made).outcome
        is vs.Outcome.converged
    )


def test_polar_features_wrapped_alone_fly_too():
    s, starts = (
        scenario(IBVS(feature=Polar(together=False), interaction="mean", gain=FAST)),
        drawn(3, yaw=60),
    )
    assert [o.name for o in simulate_batch(s, starts).outcome] == [
        vs.run(started_at(s, start)).outcome.name for start in starts
    ]


@pytest.mark.parametrize(
    ("law", "markers"),
    [
        (IBVS(redundant=True, depth=OracleDepth(), gain=FAST), 2),
        (IBVS(redundant=True, feature=Polygon(), gain=FAST), 4),
    ],
    ids=["two", "polygon"],
)
def test_a_law_that_leaves_motions_open_does_not_make_them(law: IBVS, markers: int):
    """Fewer equations than motions: the shortest twist, as in the time loop."""
    corners = ((-0.25, -0.25, 0.0), (0.25, -0.25, 0.0), (0.25, 0.25, 0.0), (-0.25, 0.25, 0.0))
    s = replace(scenario(law, duration_s=4.0), target=Points(at=corners[:markers], pose=Pose()))
    starts = drawn(4, yaw=60)
    found = simulate_batch(s, starts)
    for i, start in enumerate(starts):
        r = vs.run(started_at(s, start))
        assert (found.outcome[i], found.steps[i]) == (r.outcome, len(r["t"]) - 1)
        # Normal equations against a factorisation: a few digits less than rounding.
        assert inverse(found.T_camera_target[i])[:3, 3] == pytest.approx(
            [r[f"cam_{n}"][-1] for n in "xyz"], abs=1e-6
        )


def test_a_law_that_fails_in_one_run_ends_that_run_alone(monkeypatch: pytest.MonkeyPatch):
    """As in the time loop: what a step raises, a ParameterError too, is the outcome of the run."""
    step = Predictive.step

    def failing(self: Predictive, state: object, observation: Observation, *given: Any) -> Any:
        if observation.T_camera_target is not None and observation.T_camera_target[2, 3] > 1.5:
            raise ParameterError("damping", "must be <= 1000", 2e3)
        return step(self, state, observation, *given)

    monkeypatch.setattr(Predictive, "step", failing)
    starts = from_(Pose(xyz=(0.1, 0, -1)), Pose(xyz=(0.1, 0, -2)), Pose(xyz=(-0.1, 0.1, -1.2)))
    found = simulate_batch(scenario(Predictive()), starts)
    assert (
        list(found.outcome) == [vs.Outcome.converged, vs.Outcome.law_failed, vs.Outcome.converged]
        and found.steps[1] == 0
    )


class OtherStep(IBVS):
    """Overrides its step, and inherits the batch's."""

    def step(self, state: Any, observation: Any, goal: Any, basis: Any) -> Any:
        """As IBVS."""
        return IBVS.step(self, state, observation, goal, basis)


def test_a_law_that_overrides_its_step_alone_has_no_batch():
    assert has_batch(IBVS()) and not has_batch(OtherStep())
