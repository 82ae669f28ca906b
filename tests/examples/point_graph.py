"""Somebody's own network as a law, for the points of a graph:
`law: {kind: point_graph, file: "net.onnx"}`, or `"adapter.py:Name"`.

Natural features are other points in each picture, and such networks (CNS, and others that take
graphs or sets of points) want the same nodes, some of them hidden. The law keeps the points of the
goal's picture that it saw first as nodes, finds them again by their place there, and begins anew
with the points of the present where fewer than half of the nodes are left. With CNS's published
network, of which `cns_network.py` says what it needs, as a file `cns.yaml` for
`vstestbed suite cns.yaml`:

    plugins: [point_graph.py]
    law:
      kind: point_graph
      file: cns_network.py:Cns
      options: {repository: /path/to/CNS, weights: /path/to/CNS/checkpoints/cns_state_dict.pth,
      distance_m: "0.6"}
"""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

import vstestbed as vs
from vstestbed.core.named_files import absolute_file, load_file


class Nodes(NamedTuple):
    """The nodes' places in the goal's picture (M, 2) and in the last one (M, 2), normalised, and
    the network of this run.
    """

    goal: vs.Array
    last: vs.Array
    network: Any


def loaded(file: str, options: dict[str, str]) -> Any:
    """What `file` names: a function of (current (M, 2), goal (M, 2), seen (M,)) that returns the
    camera's twist (6,).
    """
    if not file.endswith(".onnx"):
        source, _, name = file.rpartition(":")
        return getattr(load_file(Path(source)), name)(**options)
    import onnxruntime

    session = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])

    def network(current: vs.Array, goal: vs.Array, seen: vs.Array) -> vs.Array:
        given = {"current": current, "goal": goal, "seen": seen}
        asked = [one.name for one in session.get_inputs()]
        (twist, *_) = session.run(None, {name: given[name].astype(np.float32) for name in asked})
        return np.asarray(twist, float).ravel()

    return network


@vs.LAWS.add
@vs.spec
class PointGraph(vs.LawBase):
    """u = pinv(B) v, with v the camera's twist that a network orders for pairs of points in
    normalised coordinates.

    Args:
        file: `FILE.onnx` with inputs `current` (M, 2), `goal` (M, 2) and `seen` (M,), or
            `FILE.py:NAME`, which is called with `options` for each run.
        options: given to NAME, as texts.
        least: fewest points with which it moves [1].
    """

    kind: Literal["point_graph"] = "point_graph"
    file: str
    options: dict[str, str] = field(default_factory=dict[str, str])
    least: int = 4
    inputs = ("xy",)

    def __post_init__(self):
        """Keep the file's whole name: a worker has another folder."""
        object.__setattr__(self, "file", absolute_file(self.file, Path.cwd()))

    def step(self, state, observation, goal, basis):
        """One frame."""
        here = np.isfinite(observation.xy).all(axis=1) & np.isfinite(goal.xy).all(axis=1)
        if here.sum() < self.least:
            return state, vs.Command.rest(
                basis, f"{here.sum()} points are in sight, fewer than {self.least}"
            )
        rows = {
            tuple(place): row
            for place, row in zip(
                goal.xy[here].tolist(), np.flatnonzero(here).tolist(), strict=True
            )
        }
        found = np.array(
            [
                rows.get(tuple(place), -1)
                for place in ([] if state is None else state.goal.tolist())
            ],
            dtype=int,
        )
        if state is None or (found >= 0).sum() < max(self.least, len(found) / 2):
            state = Nodes(goal.xy[here], observation.xy[here], loaded(self.file, self.options))
            found = np.flatnonzero(here)
        seen = found >= 0
        current = np.where(seen[:, None], observation.xy[found], state.last)
        twist = np.asarray(state.network(current, state.goal, seen), float)
        return state._replace(last=current), self.limits.command(
            np.linalg.lstsq(basis, twist, rcond=None)[0], basis
        )
