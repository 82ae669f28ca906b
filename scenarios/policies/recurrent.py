"""A recurrent policy for views of a square, which has learned to predict;
`tests/long/train_recurrent.py` made its weights.

    u_k = M(h_k) [d_k, d_k - d_(k-1), u_(k-1), ..., u_(k-6)],
    d   = phi(markers) - phi(goal),   h_k = GRU(h_(k-1), x_k)

phi is a perceptron of the markers in units of the goal's view, x are the markers, their change and
the last command, and the matrix M (6, 84) is read from the memory h: features are learned, and so
is how strongly they act, which the policy tells from how the picture answers its own commands. With
the markers at their goal and no command in the last six frames u is zero, whatever h is.

It sees pixels alone: no depth, no pose, no camera. The goal's view gives the scale, which is right
where the square is seen from the front at twice its side. Reference for the unit: Cho et al. 2014,
doi:10.3115/v1/D14-1179.
"""

from pathlib import Path

import numpy as np

# commands that it remembers one by one; m/s and rad/s of an action of 1 (`law.limits`)
PAST, MOST = 6, 10.0
WEIGHTS = (
    dict(np.load(Path(__file__).with_suffix(".npz")))
    if Path(__file__).with_suffix(".npz").is_file()
    else {}
)


def soft(x):
    """Small and large values alike: asinh(100 x) / 5."""
    return np.arcsinh(100.0 * x) / 5.0


def sigmoid(x):
    """1 / (1 + exp(-x))."""
    return 0.5 + 0.5 * np.tanh(0.5 * x)


class Recurrent:
    """One run of the policy."""

    def __init__(self):
        """Begin with the weights of the file beside this one."""
        self.w = {name: value.astype(float) for name, value in WEIGHTS.items()}
        self.reset()

    def reset(self):
        """Forget the last run."""
        self.h, self.last, self.d, self.past = (
            np.zeros(self.w["whh"].shape[1]),
            None,
            None,
            np.zeros((PAST, 6)),
        )

    def features(self, x):
        """Features phi (24,) of markers (8,)."""
        for i in (0, 1):
            x = np.tanh(self.w[f"W{i}"] @ x + self.w[f"b{i}"])
        return self.w["W2"] @ x

    def act(self, observation):
        """The action (6,); None before all markers have been seen once. One that is hidden stays
        where it was seen last.
        """
        goal, seen = observation["goal"].astype(float), observation["seen"] > 0
        centre = goal.mean(axis=0)
        scale = np.sqrt(((goal - centre) ** 2).mean())
        uv = ((observation["markers"] - centre) / scale).ravel()
        if self.last is None and not seen.all():
            return None
        now = uv if self.last is None else np.where(np.repeat(seen, 2), uv, self.last)
        before, there = now if self.last is None else self.last, ((goal - centre) / scale).ravel()
        x = np.concatenate([now, soft(now - before), soft(now - there), seen, soft(self.past[0])])
        given, kept = self.w["wih"] @ x + self.w["bih"], self.w["whh"] @ self.h + self.w["bhh"]
        (r, z, n), (kept_r, kept_z, kept_n) = np.split(given, 3), np.split(kept, 3)
        r, z = sigmoid(r + kept_r), sigmoid(z + kept_z)
        self.h = (1 - z) * np.tanh(n + r * kept_n) + z * self.h
        d = self.features(now) - self.features(there)
        parts = np.concatenate([d, d - (d if self.d is None else self.d), self.past.ravel()])
        u = (self.w["Wm"] @ self.h + self.w["bm"]).reshape(6, -1) @ parts
        self.last, self.d, self.past = now, d, np.concatenate([u[None], self.past[:-1]])
        return u / MOST
