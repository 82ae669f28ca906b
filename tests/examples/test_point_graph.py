"""A network for the points of a graph, as a law: nodes that stay, points that come and go."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.features.observation import Observation

pytestmark = pytest.mark.usefixtures("own_kinds")
FILE = Path(__file__).parent / "point_graph.py"
ADAPTER = """import numpy as np


class Linear:
    def __init__(self, gain):
        self.gain, self.calls = float(gain), []

    def __call__(self, current, goal, seen):
        self.calls.append((current, goal, seen))
        x, y, one = current[:, 0], current[:, 1], np.ones(len(current))
        rows_x = np.stack([-one, 0 * x, x, x * y, -1 - x * x, y], 1)
        rows_y = np.stack([0 * x, -one, y, 1 + y * y, -x * y, -x], 1)
        L = np.stack([rows_x, rows_y], 1)
        return -self.gain * np.linalg.pinv(L[seen].reshape(-1, 6)) @ (current - goal)[seen].ravel()
"""


@pytest.fixture
def adapter(tmp_path: Path) -> str:
    (tmp_path / "adapter.py").write_text(ADAPTER)
    return f"{tmp_path}/adapter.py:Linear"


def test_a_network_of_ones_own_drives_markers_and_natural_features_to_their_goal(adapter: str):
    law = {"kind": "point_graph", "file": adapter, "options": {"gain": "1.5"}}
    markers = {
        "detector": "oracle",
        "law": law,
        "robot.start.nominal": {"xyz": [0.2, -0.1, 1.7], "rpy_deg": [3, -4, 20]},
    }
    assert vs.run(vs.load("ibvs_book", markers, plugins=[str(FILE)])).outcome.name == "converged"
    near = {
        "robot.start.nominal": {"xyz": [0.1, 0.05, -0.7], "rpy_deg": [3, -4, 8]},
        "camera.width": 320,
        "camera.height": 240,
    }
    s = vs.load(
        "camera_keypoints", near | {"law": law, "stop.duration_s": 1.5}, plugins=[str(FILE)]
    )
    r = vs.run(s)
    assert r["error_px"][-1] < 0.2 * r["error_px"][0]


def test_nodes_stay_while_half_of_them_are_in_sight_and_begin_anew_under_that(
    adapter: str, tmp_path: Path
):
    vs.load(
        "ibvs_book",
        {"law": {"kind": "point_graph", "file": adapter, "options": {"gain": "1"}}},
        plugins=[str(FILE)],
    )
    law = vs.LAWS.members["point_graph"](file=adapter, options={"gain": "1"})
    places = np.random.default_rng(0).uniform(-0.4, 0.4, (12, 2))
    state = None

    def shown(which: list[int]) -> tuple[Observation, SimpleNamespace]:
        xy = np.full((12, 2), np.nan)
        goal = xy.copy()
        goal[: len(which)], xy[: len(which)] = places[which], places[which] + 0.05
        depth = np.ones(12)
        return Observation(t=0.0, uv=xy, xy=xy, depth=depth), SimpleNamespace(xy=goal)

    calls = []
    for which in (list(range(10)), [9, 8, 7, 6, 5, 4, 3, 11], [0, 1, 10, 11]):
        state, command = law.step(state, *shown(which), np.eye(6))
        assert not command.rest_reason
        calls.append(state.network.calls[-1])
    assert (
        len(calls[0][1]) == len(calls[1][1]) == 10
        and calls[1][2].tolist() == [False] * 3 + [True] * 7
    )
    np.testing.assert_allclose(calls[1][0], places[:10] + 0.05)  # hidden nodes stay where they were
    np.testing.assert_allclose(calls[2][1], places[[0, 1, 10, 11]])  # a new graph
    _, command = law.step(state, *shown([0, 1, 2]), np.eye(6))
    assert "fewer than 4" in command.rest_reason
