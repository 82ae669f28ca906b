"""The renderer is no part of the experiment: the same markers are found by OpenGL and by rays, in
windows and in whole pictures.
"""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.loop.controller import Controller

NUISANCES: dict[str, dict[str, object]] = {
    "clean": {},
    "noise": {"noise.image_sigma": 4.0},
    "drift": {"noise.drift": {"brightness": 0.2, "period_s": 1.0}},
    "late": {"camera.latency_s": 0.05},
    "blurred": {
        "timing": {"exposure_s": 0.02, "exposure_pictures": 3},
        "camera.latency_s": 0.03,
        "noise.image_sigma": 2.0,
    },
}

SMALL = {"camera.width": 500, "camera.height": 500, "camera.pixel_size_m": 2e-5}


def seen(r: vs.Recording, markers: int = 4) -> np.ndarray:
    """Which markers were found in each picture."""
    return np.column_stack([np.isfinite(r[f"u_{i}"]) for i in range(markers)])


@pytest.mark.parametrize("name", one_quick("polar_book", "ibvs_book"))
def test_a_quick_start_loses_no_picture_by_either_renderer(name: str):
    # The first move is beyond the windows: the camera was at rest in the picture before.
    runs = [
        vs.run(vs.load(name, SMALL | {"camera.renderer": renderer, "stop.duration_s": 1.5}))
        for renderer in ("gl", "rays")
    ]
    for r in runs:
        assert len(r["t"]) == 16 and not r["lost"].any() and seen(r).all()
    # Pictures differ at some edge pixels (facets of OpenGL's circles): .1 px of 75 and more.
    assert np.abs(runs[0]["error_px"] - runs[1]["error_px"]).max() < 0.3


@pytest.mark.parametrize("nuisance", one_quick(*NUISANCES, every=4))
def test_what_is_found_does_not_depend_on_how_much_was_drawn(
    nuisance: str, monkeypatch: pytest.MonkeyPatch
):
    s = vs.load(
        "ibvs_book",
        SMALL | {"camera.renderer": "rays", "stop.duration_s": 0.6} | NUISANCES[nuisance],
    )
    in_windows = vs.run(s)
    monkeypatch.setattr(Controller, "regions_of_interest", lambda self: None)
    np.testing.assert_array_equal(in_windows.table, vs.run(s).table)
    assert len(in_windows.table) > 5 and seen(in_windows).any()
