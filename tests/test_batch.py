"""A batch of ideal loops against the golden rows, and against the time loop."""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from tests.laws.flight import book_camera
from tests.laws.flight import fly as fly_one
from tests.test_golden_loops import ROWS, SET, STARTS, decided_by_rounding, pose
from vstestbed.batch import fly
from vstestbed.errors import ParameterError
from vstestbed.features import FEATURES, Line, Point, Polar
from vstestbed.geometry import Pose, inverse
from vstestbed.laws import IBVS
from vstestbed.laws.base import AdaptiveGain, ConstantGain
from vstestbed.observation import Goal, OracleDepth
from vstestbed.target import Square

CAMERA, POINTS = book_camera(), Square(side=0.5, pose=Pose()).points
GOAL = Goal.from_view(CAMERA, POINTS, Pose(xyz=(0, 0, 1)).T)
BOUND = 1e-3 * 800 / np.sqrt(8)  # a norm of 1e-3 of the eight normalised coordinates


@pytest.mark.parametrize("feature", ["point", "polar"])
@pytest.mark.parametrize("interaction", ["CURRENT", "DESIRED", "MEAN"])
def test_golden_rows_at_once(feature: str, interaction: str):
    rows = [r for r in ROWS if r["law"] == f"ibvs_{feature}" and r["L"] == interaction and not decided_by_rounding(r)]
    rows = [r for r in rows if STARTS[r["scenario"]]["square_half_side"] == 0.25]
    rows = [r for r in rows if r["status"] == "converged" and (r["scenario"], feature, interaction) != ("book_sph", "polar", "DESIRED")]
    starts = []
    for row in rows:
        s = STARTS[row["scenario"]]
        assert pytest.approx(Pose(xyz=(0, 0, -1)).T) == pose(s["wtc_goal"], s["wqc_goal_xyzw"]).T
        starts.append(inverse(pose(s["wtc0"], s["wqc0_xyzw"]).T))
    law = IBVS(
        gain=ConstantGain(value=SET["gain"]),
        feature=Point() if feature == "point" else Polar(together=False),
        interaction=interaction.lower(),  # pyright: ignore[reportArgumentType]
    )
    found = fly(law, GOAL, POINTS, np.array(starts), period=SET["dt"], steps=3000, error_px=BOUND)
    assert len(rows) >= 3
    for row, outcome, steps, farthest in zip(rows, found.outcome, found.steps, found.farthest_m, strict=True):
        assert outcome is vs.Outcome.converged
        assert abs(steps - int(row["it_e<1e-3"])) <= 1
        assert farthest == pytest.approx(float(row["max_cam_dist_m"]), abs=1e-3)


@pytest.mark.parametrize(
    ("interaction", "outcome"), [("current", "diverged"), ("desired", "target_lost"), ("mean", "local_minimum")], ids=str
)
def test_a_half_turn_ends_as_in_the_time_loop(interaction: str, outcome: str):
    law = IBVS(interaction=interaction, depth=OracleDepth())  # pyright: ignore[reportArgumentType]
    start = inverse(Pose(xyz=(0, 0, -1), rpy_deg=(0, 0, 180)).T)
    found = fly(law, GOAL, POINTS, start[None], period=0.04, steps=3000, error_px=0.01)
    assert found.outcome[0].name == outcome == fly_one(law, (0, 0, -1), np.pi).outcome.name


@pytest.mark.parametrize("kind", [k for k in FEATURES.members if k != "polygon"])  # two rows do not tell six motions
def test_every_feature_takes_the_way_of_the_time_loop(kind: str):
    law = IBVS(feature=FEATURES.members[kind](), interaction="mean", depth=OracleDepth())
    r = fly_one(law, (0.3, 0.3, -2), 0.4, norm_px=BOUND * np.sqrt(8))
    start = inverse(Pose(xyz=(0.3, 0.3, -2), rpy_deg=(0, 0, np.degrees(0.4))).T)
    found = fly(law, GOAL, POINTS, start[None], period=0.04, steps=3000, error_px=BOUND)
    assert found.outcome[0] is r.outcome is vs.Outcome.converged
    assert found.steps[0] == len(r["t"]) - 1


def test_runs_do_not_know_of_one_another():
    rng = np.random.default_rng(3)
    starts = np.array([inverse(Pose(xyz=(*rng.uniform(-0.3, 0.3, 2), -2), rpy_deg=(0, 0, rng.uniform(-90, 90))).T) for _ in range(20)])
    law, how = IBVS(feature=Line(), interaction="mean"), {"period": 0.04, "steps": 1000, "error_px": 0.1}
    together = fly(law, GOAL, POINTS, starts, **how)  # pyright: ignore[reportArgumentType]
    for i in range(0, 20, 7):
        alone = fly(law, GOAL, POINTS, starts[i : i + 1], **how)  # pyright: ignore[reportArgumentType]
        assert (alone.outcome[0], alone.steps[0]) == (together.outcome[i], together.steps[i])
        assert alone.T_camera_target[0] == pytest.approx(together.T_camera_target[i], abs=1e-9)
    assert together.run_steps == together.steps.sum()


def test_an_adaptive_gain_is_refused():
    with pytest.raises(ParameterError, match="constant"):
        fly(IBVS(gain=AdaptiveGain()), GOAL, POINTS, np.eye(4)[None], period=0.04, steps=10, error_px=0.1)
