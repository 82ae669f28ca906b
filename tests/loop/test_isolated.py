"""A law apart orders what it orders in the process of its loop, to the last bit, also by pictures,
several cameras, its robot's model.
"""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.named_files import bundled_scenarios
from vstestbed.core.registry import to_mapping
from vstestbed.loop import isolated

BUNDLED = sorted(bundled_scenarios())
# the robot's own model with its Jacobian; pictures; a further camera
SHOWN = "arm_qp", "camera_photometric", "arm_stereo"


def same_apart(name: str, frames: int = 12) -> None:
    given = vs.load(name)
    short = {
        "stop.duration_s": max(frames * given.camera.period, given.timing.latest_s(given.camera)),
        "plugins": list(given.plugins),
    }
    plain = vs.run(vs.load(name, short))
    block = to_mapping(given.law)
    with isolated.offered():
        apart = {
            "kind": "isolated",
            "files": list(given.plugins),
            "block": block,
            "reads": str(bundled_scenarios()[name].parent),
        }
        found = vs.run(vs.load(name, {**short, "law": apart}, plugins=[isolated.MODULE]))
    assert found.columns == plain.columns and found.outcome is plain.outcome, found.reason
    # of a law apart nobody takes it over
    judged = [i for i, column in enumerate(plain.columns) if column != "error_grey"]
    assert np.array_equal(found.rows.table[:, judged], plain.rows.table[:, judged], equal_nan=True)


@pytest.mark.process
@pytest.mark.parametrize("name", SHOWN)
def test_a_law_apart_leaves_the_same_log(name: str, own_kinds: None) -> None:
    same_apart(name)


@pytest.mark.process
def test_it_computes_with_the_kernels_of_its_loop() -> None:
    """Who sets OpenBLAS's kernels gets them on both sides: with others the last bits differ."""
    asked = "from tests.loop.test_isolated import same_apart; same_apart('arm_qp')"
    environment = {**os.environ, "OPENBLAS_CORETYPE": "Prescott"}
    ended = subprocess.run(
        [sys.executable, "-c", asked], env=environment, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr


@pytest.mark.study
@pytest.mark.process
@pytest.mark.parametrize("name", BUNDLED)
def test_every_bundled_law_apart_leaves_the_same_log(name: str, own_kinds: None) -> None:
    same_apart(name)
