"""A tutorial's own numbers: iterations of three laws, and the camera's rate about its axis as the
tutorial's figures draw it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick

# ViSP, "How to boost your visual servo control law",
# https://visp-doc.inria.fr/doxygen/visp-daily/tutorial-boost-vs.html, read as
# doc/tutorial/visual-servo/tutorial-boost-vs.dox of github.com/lagadic/visp; the settings are those
# of the programs that it names (tutorial/visual-servo/ibvs/tutorial-ibvs-4pts-plotter*.cpp).
# Numbers only.
LAWS: dict[str, dict[str, Any]] = {
    "constant": {},
    "adaptive": {
        "law.gain": {"kind": "adaptive", "at_zero": 4, "at_infinity": 0.4, "slope_at_zero": 30}
    },
}
# The library writes exp(-mu t) with mu = 4 1/s: tau = 0.25 s.
LAWS["continuous"] = LAWS["adaptive"] | {"law.smooth_start_s": 0.25}
PRINTED = {"constant": 191, "adaptive": 91, "continuous": 98}
# omega_z [rad/s], read off the curves of the page's three figures at iterations 0, 10, 20, ...: the
# mean row of the curve's pixels.
FIGURES = {
    "constant": [
        0.515, 0.430, 0.335, 0.258, 0.195, 0.150, 0.114, 0.091, 0.072,
        0.058, 0.044, 0.035, 0.030, 0.025, 0.021, 0.016, 0.013, 0.011,
    ],
    "adaptive": [0.411, 0.357, 0.300, 0.256, 0.221, 0.208, 0.214, 0.214, 0.142],
    "continuous": [0.009, 0.305, 0.322, 0.282, 0.240, 0.216, 0.209, 0.216, 0.204, 0.110],
}  # fmt: skip
# A pixel of each figure [rad/s]; the curves are two pixels thick, and the axes' labels have three
# digits.
LARGEST = 0.331  # of the third figure
PIXEL = {"constant": 0.0047, "adaptive": 0.0056, "continuous": 0.0034}


def flown(law: str, **more: Any) -> vs.Recording:
    return vs.run(vs.load("ibvs_tutorial", LAWS[law] | more))


def iterations(r: vs.Recording) -> int:
    """The library counts from 0 the views before the one whose squared error is under 1e-4; here
    that view is the last one.
    """
    assert r.outcome is vs.Outcome.converged
    return len(r["t"]) - 1


def test_exact_points_take_the_iterations_that_are_printed():
    assert {law: iterations(flown(law, detector="oracle")) for law in LAWS} == PRINTED


@pytest.mark.opengl
@pytest.mark.parametrize("law", one_quick(*LAWS))
def test_rendered_pictures_take_as_many(law: str):
    assert iterations(flown(law)) == PRINTED[law]


@pytest.mark.parametrize("law", LAWS)
def test_the_rate_about_the_axis_is_the_curve_of_the_figure(law: str):
    wz = flown(law, detector="oracle")["cmd_wz"]
    read = FIGURES[law]
    at = 10 * np.arange(len(read))
    difference = np.abs(np.asarray(wz)[at] - read)
    # From rest the curve rises by 10 px within its first iteration, of which a column of pixels is
    # a third.
    first = int(law == "continuous")
    assert (
        difference[first:].max() < 1.2 * PIXEL[law]
        and difference[:first].max(initial=0) < 3 * PIXEL[law]
    )
    if law == "continuous":
        assert max(wz) == pytest.approx(LARGEST, abs=PIXEL[law])


def test_another_setting_takes_another_number():
    """The counts tell laws apart: the rate of 0.5 1/s scales them, and the matrix at the goal has
    the library's own other number.
    """
    assert iterations(flown("constant", detector="oracle", **{"law.gain": 0.51})) == round(
        191 * 0.5 / 0.51
    )
    # tests/golden/closed_loop_summary.csv, visp_tutorial, DESIRED
    assert iterations(flown("constant", detector="oracle", **{"law.interaction": "desired"})) == 211
    assert iterations(flown("continuous", detector="oracle", **{"law.smooth_start_s": 0.5})) > 98
