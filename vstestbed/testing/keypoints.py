"""What every kind of local features must do."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.vision.match.features import extracted, matched
from vstestbed.vision.match.mutual import mutual_matches

WIDTH, HEIGHT, FINER = 320, 240, 2
"""Size of the two pictures, and samples along each side of a pixel."""
TURN_DEG, SIZE = 8.0, 0.93
"""Rotation and scale of the second against the first."""
SHEETS = 120


def check_keypoints(features: Any, within_px: float = 2.0, least: int = 20) -> None:
    """Features match two pictures of coloured sheets, the second turned by 8 degrees and smaller; an empty picture gives no matches.

    Args:
        features: with the parameters to test; it has `extract(image)` or `match(goal_image, image)`.
        within_px: largest median distance of the matches from their true places [px].
        least: fewest matches that must be within three times that distance.

    Raises:
        AssertionError: it says what was expected and what was found. ParameterError: arrays of wrong shapes.
    """
    turn = np.radians(TURN_DEG)
    A = SIZE * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    first, second = _picture(1.0, 0.0), _picture(1 / SIZE, -turn)
    uv_goal, uv = _matches(features, first, second)
    middle = np.array([WIDTH - 1, HEIGHT - 1]) / 2
    off = np.linalg.norm(uv - ((uv_goal - middle) @ A.T + middle), axis=1)
    near = off[off < 3 * within_px]
    found = f"found {len(near)} of {len(off)} in place"
    assert len(near) >= least, f"{features.kind}: must match {least} points or more of two pictures, {found}"
    median = np.median(near)
    assert median < within_px, f"{features.kind}: matches must be within {within_px:g} px, their median is off by {median:.2f}"
    nothing, _ = _matches(features, first, np.full_like(first, 128))
    assert len(nothing) < least, f"{features.kind}: an empty picture has no points, it matched {len(nothing)}"


@lru_cache
def _picture(size: float, turn: float) -> NDArray[np.uint8]:
    """Sheets over each other (HEIGHT, WIDTH, 3): a place's offset from the middle, turned [rad] and times `size`, is that in the first."""
    c, s = size * np.cos(turn), size * np.sin(turn)
    rng = np.random.default_rng(5)
    u, v = np.meshgrid((np.arange(FINER * WIDTH) + 0.5) / FINER - WIDTH / 2, (np.arange(FINER * HEIGHT) + 0.5) / FINER - HEIGHT / 2)
    x, y = c * u - s * v, s * u + c * v
    image = np.full((*x.shape, 3), 128.0, np.float32)
    for _ in range(SHEETS):
        (px, py), (a, b), angle = rng.uniform(-0.6, 0.6, 2) * [WIDTH, HEIGHT], rng.uniform(5, 25, 2), rng.uniform(0, np.pi)
        along, across = np.cos(angle) * (x - px) + np.sin(angle) * (y - py), np.cos(angle) * (y - py) - np.sin(angle) * (x - px)
        image[(np.abs(along) < a) & (np.abs(across) < b)] = rng.uniform(0, 255, 3)
    return image.reshape(HEIGHT, FINER, WIDTH, FINER, 3).mean(axis=(1, 3)).astype(np.uint8)


def _matches(features: Any, first: NDArray[np.uint8], second: NDArray[np.uint8]) -> tuple[Array, Array]:
    """Places (M, 2) of matches in both pictures [px]."""
    if hasattr(features, "match"):
        return matched(features, first, second)[:2]
    (uv_goal, a), (uv, b) = extracted(features, first), extracted(features, second)
    i, j, _ = mutual_matches(a, b)
    return uv_goal[i], uv[j]
