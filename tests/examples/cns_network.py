"""The published network of CNS for `point_graph`: Chen et al. 2023, arXiv:2309.09047,
https://github.com/hhcaz/CNS (MIT licence).

It needs a clone of that repository, with its weights, and what they need:
`pip install torch torch_geometric scikit-learn`. Nothing of it is copied here; the graph and the
network are built by its own code.
"""

from __future__ import annotations

import sys

import numpy as np


class Cns:
    """The network in one run.

    repository: of the clone. weights: `checkpoints/cns_state_dict.pth` in it. distance_m: from the
    camera to the scene at the goal, about [m].
    """

    def __init__(self, repository: str, weights: str, distance_m: str):
        if repository not in sys.path:
            sys.path.insert(0, repository)
        import torch
        from cns.midend.graph_gen import GraphGenerator  # type: ignore[import-not-found]  # of the clone
        from cns.models.graph_vs import GraphVS  # type: ignore[import-not-found]

        torch.set_num_threads(1)
        self.torch, self.generator, self.graph, self.hidden = torch, GraphGenerator, None, None
        self.net = GraphVS(2, 2, 128, regress_norm=True)
        self.net.load_state_dict(torch.load(weights, map_location="cpu"))
        self.net.eval()
        self.distance = float(distance_m)

    def __call__(self, current, goal, seen):
        """The twist (6,), in the units of its training; translation by the distance."""
        if self.graph is None:
            before = np.random.get_state()  # noqa: NPY002 - scikit-learn's
            np.random.seed(0)  # noqa: NPY002 - its clusters are drawn: the same run again has the same graph
            self.graph = self.generator(goal)
            np.random.set_state(before)  # noqa: NPY002 - scikit-learn's
        data = self.graph.get_data(current, missing_node_indices=np.flatnonzero(~seen))
        data.set_distance_scale(self.distance)
        with self.torch.no_grad():
            found = self.net(data, self.hidden)
            self.hidden = found[-1]
            return self.net.postprocess(found, data).squeeze(0).numpy()
