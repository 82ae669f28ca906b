"""Which markers a law can use, and which reason it gives for rest."""

from __future__ import annotations

import numpy as np

from vstestbed.features.observation import Observation
from vstestbed.laws.points import ALL, NO_DEPTH, TOO_FEW, usable_rows

NAN = np.nan


def seen(known: list[int], deep: list[int]) -> Observation:
    """Four markers, of which some have coordinates and some a depth."""
    has = np.isin(np.arange(4), known)
    uv = np.where(has[:, None], 1.0, NAN)
    return Observation(0.0, uv, uv, np.where(np.isin(np.arange(4), deep), 1.0, NAN))


def test_usable_rows():
    for known, deep, needed, expected in (
        ([0, 1, 2, 3], [0, 1, 2, 3], 4, ALL),
        ([0, 1, 2, 3], [0, 1, 2, 3], 5, TOO_FEW),
        ([0, 1, 3], [0, 1, 2, 3], 3, [True, True, False, True]),
        ([0, 1, 3], [0, 1, 2, 3], 4, TOO_FEW),
        ([0, 1, 2, 3], [0, 1], 2, [True, True, False, False]),
        ([0, 1, 2, 3], [0, 1], 3, NO_DEPTH),
        ([0, 1, 2], [1, 2, 3], 3, NO_DEPTH),
        ([0, 1], [2, 3], 3, TOO_FEW),
        ([0, 1], [2, 3], 2, NO_DEPTH),
    ):
        found = usable_rows(seen(known, deep), ("xy", "depth"), needed)
        if isinstance(expected, list):
            assert np.asarray(found).tolist() == expected
        else:
            assert found == expected
