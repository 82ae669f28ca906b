"""200 random starts near the picture's border: who keeps all markers in view, and how far
constraints are broken.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

import vstestbed as vs
from tests.laws.test_qp import edge_px, near_the_border
from vstestbed.laws import IBVS, PBVS, QP, Predictive
from vstestbed.laws.points import Visibility
from vstestbed.studies.batch import started_at

STARTS, MARGIN_PX = 200, 5.0
FIELD = Visibility(margin_px=30.0)
LAWS: dict[str, Any] = {
    "points": IBVS(),
    "points, repulsion": IBVS(visibility=FIELD),
    "points, qp": QP(law=IBVS()),
    "desired": IBVS(interaction="desired"),
    "desired, repulsion": IBVS(interaction="desired", visibility=FIELD),
    "desired, qp": QP(law=IBVS(interaction="desired")),
    "pose": PBVS(),
    "pose, qp": QP(law=PBVS()),
    "predictive": Predictive(),
}


class Edge:
    """The least distance of a marker's edge from the border in a run [px]."""

    def __init__(self, scenario: vs.Scenario) -> None:
        self._scenario, self.least = scenario, np.inf

    def frame(self, frame: vs.Frame) -> None:
        """One frame more."""
        self.least = min(self.least, edge_px(self._scenario, frame.truth.p_camera))


class Kept(NamedTuple):
    """Of all starts: how many kept all markers in view, how many converged, and the largest
    violation of the margin [px].
    """

    in_view: int
    converged: int
    violation_px: float


def flown(law: Any, latency_s: float) -> Kept:
    """All starts with one law; the picture has a border that nothing but the law minds."""
    view = {
        "detector": {"kind": "oracle", "field_of_view": "unlimited"},
        "camera.rate_hz": 25,
        "stop.duration_s": 40,
    }
    scenario = vs.load("ibvs_book", view | {"camera.latency_s": latency_s})
    edges, converged = [], 0
    for seed in range(STARTS):
        edge = Edge(scenario)
        recording = vs.run(
            replace(started_at(scenario, near_the_border(scenario, seed)), law=law), watch=[edge]
        )
        edges.append(edge.least)
        converged += recording.outcome.success
    return Kept(int(np.sum(np.array(edges) > 0)), converged, max(0.0, MARGIN_PX - min(edges)))


@pytest.mark.study
@pytest.mark.parametrize("latency_s", [0.0, 0.04])
@pytest.mark.parametrize("name", LAWS)
def test_markers_stay_in_view(name: str, latency_s: float) -> None:
    kept = flown(LAWS[name], latency_s)
    print(f"{name}, {1e3 * latency_s:g} ms: {kept}")
    if "qp" in name or name == "predictive":
        assert kept.in_view >= STARTS - 1 and kept.violation_px < 2 * MARGIN_PX
    elif name in ("desired", "pose"):
        assert kept.in_view < 0.9 * STARTS
