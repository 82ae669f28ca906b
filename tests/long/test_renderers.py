"""Every bundled scenario by OpenGL and by rays: the same pictures lost, the same outcome, the same
time to converge.

Run with `-m study -s` for one line a scenario. Where the error stays near the stop tolerance, as
the noise of single pixels is, the time to converge depends on rounding by one renderer alone. There
the times of each renderer's runs are taken whose target is moved by some micrometres, or whose
tolerance is a little larger or smaller, and their ranges must overlap.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import vstestbed as vs
from tests.robots.arms import where_installed
from vstestbed.core.named_files import bundled_scenarios

FRAMES = 2
"""Largest difference of the times to converge [camera periods]."""
MOVES_M = (1e-6, -1e-6, 2e-6, -2e-6, 4e-6, -4e-6)
"""Moves of the target that no detector can measure: thousandths of a pixel."""
TOLERANCES = (0.9, 1.1)
"""Factors on the stop tolerance: of .2 to .4 px that is less than the noise of one picture."""


def moved(scenario: vs.Scenario, dx: float) -> vs.Scenario:
    """The same with its target moved along x [m]."""
    pose = scenario.target.pose
    x, y, z = pose.xyz
    target = dataclasses.replace(
        scenario.target, pose=dataclasses.replace(pose, xyz=(x + dx, y, z))
    )
    return dataclasses.replace(scenario, target=target)


def tolerant(scenario: vs.Scenario, factor: float) -> vs.Scenario:
    """The same with another stop tolerance."""
    names = ("error_px", "position_m", "rotation_deg")
    converged = scenario.stop.converged
    limits = {
        name: value * factor for name in names if (value := getattr(converged, name)) is not None
    }
    return dataclasses.replace(
        scenario,
        stop=dataclasses.replace(scenario.stop, converged=dataclasses.replace(converged, **limits)),
    )


def nearly(scenario: vs.Scenario) -> list[vs.Scenario]:
    """Scenarios that nobody could tell from this one by a picture."""
    return [moved(scenario, dx) for dx in MOVES_M] + [
        tolerant(scenario, factor) for factor in TOLERANCES
    ]


def converged_after(r: vs.Recording) -> float:
    """The time to converge [s], NaN without."""
    after = r.summary()["time_to_converge_s"]
    return math.nan if after is None else after


def line(renderer: str, r: vs.Recording) -> str:
    s = r.summary()
    return (
        f"{renderer}: lost {s['frames_lost']} of {s['frames']}, {s['outcome']},"
        f" converged after {s['time_to_converge_s']} s"
    )


@pytest.mark.study
@pytest.mark.parametrize("name", where_installed(bundled_scenarios()))
def test_the_renderer_does_not_change_the_experiment(name: str) -> None:
    scenario = vs.load(name, {"camera.renderer": "gl"})
    by_gl = vs.run(scenario)
    by_rays = vs.run(vs.load(name, {"camera.renderer": "rays"}))
    words = f"\n{name} | {line('gl', by_gl)} | {line('rays', by_rays)}"
    slack = (FRAMES + 0.5) * scenario.camera.period
    times = [[converged_after(r)] for r in (by_gl, by_rays)]
    if abs(times[1][0] - times[0][0]) > slack:
        for of, renderer in zip(times, ("gl", "rays"), strict=True):
            of += [
                converged_after(vs.run(other))
                for other in nearly(vs.load(name, {"camera.renderer": renderer}))
            ]
            words += (
                f" | {renderer}, target or tolerance changed a little:"
                f" {np.nanmin(of):.2f} to {np.nanmax(of):.2f} s"
            )
    print(words, flush=True)
    assert by_gl.outcome is by_rays.outcome
    lost = [r["t"][r["lost"].astype(bool)] for r in (by_gl, by_rays)]
    np.testing.assert_allclose(lost[0], lost[1], atol=1e-9)
    assert math.isnan(times[0][0]) == math.isnan(times[1][0])
    assert not max(map(np.nanmin, times)) > min(map(np.nanmax, times)) + slack
