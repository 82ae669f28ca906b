"""The bias of a centroid against closed forms
of an independent library (tests/golden/README.md).
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from vstestbed.camera import Perspective
from vstestbed.core.geometry import Array, Pose, exp, transform
from vstestbed.targets.base import Points
from vstestbed.targets.markers import Disc, Sphere
from vstestbed.vision import centre_bias

GOLDEN = json.loads(
    (Path(__file__).parents[1] / "golden" / "interaction_matrices.json").read_text()
)
CAMERA = Perspective()


def _centroid_and_area(target: Points, T: Array) -> tuple[Array, Array]:
    """Centroids (N, 2), normalised, and areas (N,), in units of the image plane at Z = 1."""
    bias, area, _ = centre_bias(CAMERA, target, T)
    return CAMERA.normalise(CAMERA.project(transform(T, target.points)) + bias), area / CAMERA.f**2


def _ellipse_area(n20: float, n11: float, n02: float) -> float:
    """Area of an ellipse whose second central moments per area are n."""
    return 4 * np.pi * np.sqrt(n20 * n02 - n11**2)


@pytest.mark.parametrize("case", GOLDEN["ellipse_from_circle"]["cases"])
def test_disc_agrees_with_closed_form(case: dict[str, list[float]]) -> None:
    t, thetau, radius = np.array(case["in"][:3]), np.array(case["in"][3:6]), case["in"][6]
    T = exp(np.concatenate([np.zeros(3), thetau]))
    T[:3, 3] = t
    xy, area = _centroid_and_area(
        Points(pose=Pose(), at=((0, 0, 0),), marker=Disc(radius=radius)), T
    )
    # 32 corners: 1e-4 of biases that reach .01
    assert xy[0] == pytest.approx(case["s"][:2], abs=1e-6)
    assert area[0] == pytest.approx(_ellipse_area(*case["s"][2:]), rel=1e-6)


@pytest.mark.parametrize("case", GOLDEN["ellipse_from_sphere"]["cases"])
def test_ball_agrees_with_closed_form(case: dict[str, list[float]]) -> None:
    T = np.eye(4)
    T[:3, 3] = case["in"][:3]
    xy, area = _centroid_and_area(
        Points(pose=Pose(), at=((0, 0, 0),), marker=Sphere(radius=case["in"][3])), T
    )
    assert xy[0] == pytest.approx(case["s"][:2], abs=1e-6)
    assert area[0] == pytest.approx(_ellipse_area(*case["s"][2:]), rel=1e-6)


def test_size_of_the_bias_of_tilted_discs() -> None:
    # 6 cm discs at 1 m, tilted 40 degrees, f = 540 px: off by .95 px; 1 cm: .03 px (measured when
    # the project began).
    camera = Perspective(focal_length_m=0.0054, pixel_size_m=1e-5)
    T = exp(np.array([0, 0, 0, np.radians(40), 0, 0]))
    T[:3, 3] = 0, 0, 1
    for radius, expected in ((0.06, 0.95), (0.03, 0.24), (0.01, 0.03)):
        bias = centre_bias(
            camera, Points(pose=Pose(), at=((0, 0, 0),), marker=Disc(radius=radius)), T
        ).bias
        assert np.linalg.norm(bias) == pytest.approx(expected, rel=0.2)


def test_many_markers_at_once_equal_each_alone() -> None:
    at = ((0.1, 0, 0), (-0.2, 0.1, 0), (0, 0.3, 0.1))
    T = exp(np.array([0, 0, 0, 0.3, -0.2, 0.5]))
    T[:3, 3] = 0.1, 0, 1.2
    together = centre_bias(CAMERA, Points(pose=Pose(), at=at, marker=Sphere(radius=0.03)), T)
    for i, p in enumerate(at):
        bias, area, _ = centre_bias(
            CAMERA, Points(pose=Pose(), at=(p,), marker=Sphere(radius=0.03)), T
        )
        assert bias[0] == pytest.approx(together[0][i], abs=1e-12)
        assert area[0] == pytest.approx(together[1][i], rel=1e-12)


def test_no_number_where_the_lens_sees_no_whole_rim() -> None:
    T = np.eye(4)
    T[:3, 3] = 0, 0, -1
    bias, area, _ = centre_bias(CAMERA, Points(pose=Pose(), at=((0, 0, 0),)), T)
    assert np.isnan(bias).all()
    assert np.isnan(area).all()
