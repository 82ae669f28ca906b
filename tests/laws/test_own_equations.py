"""A plugin law that gives its equations alone, the example of the guide: a run, the batch, the
basin, the gain limit, feedforward.
"""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.geometry import Pose, inverse
from vstestbed.laws.base import has_batch
from vstestbed.studies.batch import ideal, simulate_batch, started_at

GUIDE = Path(__file__).parents[2] / "docs" / "guides" / "first_law.md"
LINES = 16
"""The example's lines, blank ones included."""
pytestmark = pytest.mark.usefixtures("own_kinds")  # the law leaves the registry again


@pytest.fixture(scope="module")
def plugin(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The file of the guide's first example."""
    text = GUIDE.read_text(encoding="utf-8").partition("```python\n")[2].partition("```")[0]
    file = tmp_path_factory.mktemp("guide") / "my_law.py"
    file.write_text(text, encoding="utf-8")
    return str(file)


def loaded(plugin: str, name: str, **law: object) -> vs.Scenario:
    return vs.load(name, {"law": {"kind": "my_law", **law}, "detector": "oracle"}, plugins=[plugin])


def test_it_is_short_and_gives_its_equations_alone(plugin: str):
    text = Path(plugin).read_text(encoding="utf-8")
    (law,) = (node for node in ast.parse(text).body if isinstance(node, ast.ClassDef))
    assert text.count("\n") <= LINES
    assert [node.name for node in law.body if isinstance(node, ast.FunctionDef)] == ["equations"]


def test_it_passes_the_suite_for_laws(plugin: str):
    vs.testing.check_law(loaded(plugin, "ibvs_book", gain=1.0).law)


def test_a_batch_of_it_ends_as_its_runs_do(plugin: str):
    """The batch of `basin` calls `equations` over all starts; the time loop over one."""
    scenario = ideal(loaded(plugin, "ibvs_book", gain=2.0))
    assert has_batch(scenario.law)
    poses = [
        Pose(xyz=(0.3, -0.2, -1.5), rpy_deg=(5, -10, 30)),
        Pose(xyz=(0, 0, -1.2), rpy_deg=(0, 0, 170)),
    ]
    starts = np.array([inverse(pose.T) for pose in poses])
    found = simulate_batch(scenario, starts)
    assert list(found.outcome) == [vs.run(started_at(scenario, start)).outcome for start in starts]
    assert found.outcome[0] is vs.Outcome.converged


@pytest.mark.app("maps")
def test_its_gain_limit_is_that_of_theory(plugin: str):
    """One frame of delay: the loop z^2 - z + g = 0 is unstable from g = 1 a frame on, 10 1/s at 10
    Hz.
    """
    from vstestbed.apps.maps.delay import displaced, growth, prepared

    at_goal = prepared(loaded(plugin, "ibvs_book"))
    at_start, limit = displaced(at_goal), at_goal.camera.rate_hz
    assert growth(at_start, 0.97 * limit, 1) < 1 < growth(at_start, 1.03 * limit, 1)


def test_its_feedforward_removes_the_lag_behind_a_moving_target(plugin: str):
    """A target at 0.05 m/s and a gain of 1 1/s: without feedforward the camera stays speed / gain =
    50 mm behind.
    """

    def behind_m(feedforward: str) -> float:
        changes = {
            "law": {"kind": "my_law", "gain": 1.0, "feedforward": feedforward},
            "detector": "oracle",
            "stop.duration_s": 8,
        }
        moving = {
            "target.motion": {"kind": "line", "velocity_mps": [0.05, 0, 0]},
            "camera.rate_hz": 25,
        }
        return float(
            vs.run(vs.load("ibvs_book", changes | moving, plugins=[plugin]))["position_error_m"][-1]
        )

    assert behind_m("none") == pytest.approx(0.05, rel=0.05)
    assert behind_m("kalman_cv") < 1e-3  # what exp(-8) leaves of the start


def test_equations_of_a_wrong_shape_are_named_with_what_they_gave():
    @vs.LAWS.add
    @vs.spec
    class Transposed(vs.ErrorLaw):
        """J is transposed."""

        kind: Literal["transposed"] = "transposed"

        def equations(self, view, goal):
            return np.zeros(8), np.zeros((6, 8))

    ended = vs.run(vs.load("ibvs_book", {"law": "transposed", "detector": "oracle"}))
    assert ended.outcome is vs.Outcome.law_failed
    assert (
        "Transposed.equations must give e (..., rows) and J (..., rows, 6);"
        " it gave e (8,) and J (6, 8)" in ended.reason
    )
