"""The mirror camera: the unit-sphere formula, its special cases, where it ends, and the spot where
it sees itself.
"""

import numpy as np
import pytest

from vstestbed.camera import Catadioptric, Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import direction


def some_rays(degrees: float, n: int = 1000) -> np.ndarray:
    rng = np.random.default_rng(1)
    return direction(
        np.stack([np.radians(rng.uniform(0, degrees, n)), rng.uniform(-np.pi, np.pi, n)], axis=-1)
    )


@pytest.mark.parametrize(("xi", "fov"), [(0.0, 170), (0.5, 230), (1.0, 280), (1.7, 220)])
def test_a_point_goes_to_the_sphere_and_from_there_to_the_picture(xi, fov):
    lens = Catadioptric(xi=xi, fov_deg=fov)
    ray = some_rays(fov / 2)
    expected = lens.f * ray[:, :2] / (ray[:, 2:] + xi) + lens.centre
    np.testing.assert_allclose(lens.project(3 * ray), expected, rtol=1e-12)


@pytest.mark.parametrize(("xi", "fov"), [(0.0, 170), (0.5, 230), (1.0, 280), (1.7, 220)])
def test_rays_are_meis_lifting(xi, fov):
    """Mei & Rives 2007: with r^2 = x^2 + y^2 and e = (xi + sqrt(1 + (1 - xi^2) r^2)) / (r^2 + 1),
    (e x, e y, e - xi).
    """
    lens = Catadioptric(xi=xi, fov_deg=fov)
    xy = (lens.project(some_rays(fov / 2)) - lens.centre) / lens.f
    r2 = (xy * xy).sum(axis=1, keepdims=True)
    e = (xi + np.sqrt(1 + (1 - xi * xi) * r2)) / (r2 + 1)
    expected = np.concatenate([e * xy, e - xi], axis=1)
    np.testing.assert_allclose(lens.ray(lens.f * xy + lens.centre), expected, atol=1e-10)


def test_without_a_mirror_it_is_the_perspective_camera():
    pinhole = Perspective(principal_px=(300.25, 250.5))
    lens = Catadioptric(xi=0, fov_deg=160, focal_length_px=pinhole.f, principal_px=(300.25, 250.5))
    p = np.random.default_rng(2).uniform([-1, -1, 0.5], [1, 1, 2], (1000, 3))
    uv = lens.project(p)
    np.testing.assert_allclose(uv, pinhole.project(p), atol=1e-9)
    np.testing.assert_allclose(lens.ray(uv), pinhole.ray(uv), atol=1e-12)
    np.testing.assert_allclose(lens.normalise(uv), pinhole.normalise(uv), atol=1e-12)


def test_a_parabolic_mirror_is_stereographic():
    """xi = 1: sin / (1 + cos) = tan of half the angle; the horizon is f from the middle, and a
    circle stays a circle.
    """
    lens = Catadioptric(xi=1, fov_deg=300, focal_length_px=50.0)
    theta = np.radians([10, 60, 90, 149])
    uv = lens.project(direction(np.stack([theta, np.full(4, np.pi / 2)], axis=-1))) - lens.centre
    np.testing.assert_allclose(uv[:, 1], 50 * np.tan(theta / 2), rtol=1e-12)
    assert uv[2, 1] == pytest.approx(50)
    axis, across, up = np.array([0.8, 0, -0.6]), np.array([0.6, 0, 0.8]), np.array([0, 1.0, 0])
    a = np.linspace(0, 2 * np.pi, 40, endpoint=False)[:, None]
    ring = np.cos(0.3) * axis + np.sin(0.3) * (np.cos(a) * across + np.sin(a) * up)
    on = lens.project(ring)
    design = np.column_stack([on, np.ones(40)])
    solution, *_ = np.linalg.lstsq(design, (on * on).sum(axis=1), rcond=None)
    np.testing.assert_allclose(design @ solution, (on * on).sum(axis=1), rtol=1e-10)


def test_the_horizon_is_a_circle_of_radius_f_over_xi():
    """Directions square to the axis: m = sin / (0 + xi)."""
    lens = Catadioptric(xi=0.8, fov_deg=220)
    horizon = lens.project(direction(np.stack([np.full(8, np.pi / 2), np.arange(8.0)], axis=-1)))
    np.testing.assert_allclose(np.linalg.norm(horizon - lens.centre, axis=1), lens.f / 0.8)


@pytest.mark.parametrize(("xi", "cosine"), [(0.5, -0.5), (1.0, -1.0), (2.0, -0.5)])
def test_the_model_ends_where_its_formula_does(xi, cosine):
    end = 2 * np.degrees(np.arccos(cosine))
    theta = np.linspace(0, np.radians(end / 2) - 1e-3, 1001)
    lens = Catadioptric(xi=xi, fov_deg=end - 0.1)
    assert (np.diff(lens.radius(theta)) > 0).all()
    np.testing.assert_allclose(lens.angle(lens.radius(theta)), theta, atol=1e-9)
    if end < 359:
        with pytest.raises(
            ParameterError, match=f"fov_deg must be below {end:.4g} with xi = {xi:g}, got"
        ):
            Catadioptric(xi=xi, fov_deg=end + 0.1)


def test_a_camera_that_sees_itself_sees_nothing_there():
    lens = Catadioptric(blind_deg=20)
    uv = lens.project(direction(np.radians([[19.0, 30.0], [21.0, 30.0], [0.0, 0.0]])))
    np.testing.assert_array_equal(np.isfinite(uv).all(axis=1), [False, True, False])
    inner = lens.f * np.tan(np.radians(10))
    ray = lens.ray(lens.centre + np.array([[inner - 0.1, 0], [inner + 0.1, 0]]))
    np.testing.assert_array_equal(np.isfinite(ray).all(axis=1), [False, True])


def test_bad_mirrors_are_refused_in_one_sentence():
    for values, words in (
        ({"xi": 0.5, "fov_deg": 250}, "fov_deg must be below 240 with xi = 0.5, got 250"),
        ({"xi": 0}, "fov_deg must be below 180 with xi = 0, got 200"),
        (
            {"blind_deg": 100},
            "blind_deg hides the whole field of view; it must be below fov_deg / 2 = 100, got 100",
        ),
        ({"xi": -0.1}, "xi"),
        ({"fov_deg": 360}, "fov_deg"),
    ):
        with pytest.raises(ParameterError, match=words) as caught:
            Catadioptric(**values)
        assert "ArgsKwargs" not in str(caught.value)
