"""What every image feature must do."""

from __future__ import annotations

import numpy as np

from vstestbed.camera import Perspective
from vstestbed.core.geometry import Array, exp, inverse, transform
from vstestbed.features import FEATURES, Feature
from vstestbed.features.observation import Goal

STEP = 1e-6
"""Motion of the camera for a difference quotient [m, rad], which then has 9 digits."""
VIEWS = 20
RADIUS_M = 0.35


def check_feature(feature: Feature, seed: int = 0) -> None:
    """L is the derivative of the error over motions of the camera; shapes are right; leading axes are taken.

    The markers lie on a circle: four, or as many as the feature needs.

    Args:
        feature: with the parameters to test. seed: of the views that are tried.

    Raises:
        AssertionError: it says what was expected and what was found.
    """
    assert FEATURES.contract is not None
    FEATURES.contract.check(type(feature))
    rng, many = np.random.default_rng(seed), []
    markers = _on_a_circle(max(4, feature.least_markers))
    for _ in range(VIEWS):
        twist = rng.uniform(-1, 1, 6) * [0.2, 0.2, 0, 0.6, 0.6, 3.0]
        T = np.eye(4)
        T[2, 3] = rng.uniform(0.8, 2.0)
        p = transform(T @ exp(twist), markers)
        many.append(_inputs(feature, p))
        _check_derivative(feature, p)
    one = np.stack([feature.interaction(*inputs) for inputs in many])
    together = feature.interaction(*(np.stack(values) for values in zip(*many, strict=True)))
    assert np.allclose(one, together), f"{feature.kind}: interaction must take leading axes: {VIEWS} views at once differ from one by one"


def _on_a_circle(n: int) -> Array:
    """Points (n, 3) on a circle [m], at uneven distances: the symmetries of a regular polygon leave some features undefined."""
    i = np.arange(n)
    angle = 2 * np.pi * i / n + 0.4 * np.sin(2 * i)
    return RADIUS_M * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)])


def _inputs(feature: Feature, p: Array) -> tuple[Array, Array]:
    """The feature's two inputs, for points p (N, 3) in the camera's frame."""
    view = Goal.of_points(Perspective(), p, np.eye(4))
    first, second = (np.asarray(getattr(view, name)) for name in feature.inputs)
    return first, second


def _check_derivative(feature: Feature, p: Array) -> None:
    kind, inputs = feature.kind, _inputs(feature, p)
    s, L = feature.measure(inputs[0]), feature.interaction(*inputs)
    assert L.ndim == 2 and L.shape[1] == 6, f"{kind}: interaction must have shape (rows, 6), got {L.shape}"
    rows = feature.error(s, s).shape
    assert rows == L.shape[:1], f"{kind}: error must have as many rows as L, {L.shape[0]}, got the shape {rows}"
    expected = feature.rows_per_marker * len(p)
    assert not expected or len(L) == expected, f"{kind}: {feature.rows_per_marker} rows for each of {len(p)} markers, L has {len(L)}"
    assert np.abs(feature.error(s, s)).max() < 1e-9, f"{kind}: error(s, s) must be 0"
    for i, name in enumerate(("vx", "vy", "vz", "wx", "wy", "wz")):
        step = STEP * (np.arange(6) == i)
        after, before = (feature.measure(_inputs(feature, transform(inverse(exp(sign * step)), p))[0]) for sign in (1, -1))
        measured = (feature.error(after, s) - feature.error(before, s)) / (2 * STEP)
        off = float(np.abs(measured - L[:, i]).max())
        assert off < 1e-5 * max(1.0, float(np.abs(L).max())), (
            f"{kind}: column {name} of L is {off:.3g} from the error's difference quotient"
        )
