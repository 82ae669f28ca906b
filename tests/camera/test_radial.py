"""What holds for every wide lens: both ways, any batch, an image circle that touches the picture,
NaN outside of it.
"""

import numpy as np
import pytest

from vstestbed.camera import CAMERAS, Catadioptric, Fisheye, Radial, SphericalCamera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import direction

LENSES = [
    Fisheye(),
    Fisheye(fov_deg=360, width=400, height=700),
    Fisheye(
        coefficients=(-0.02, 0.003, -0.001, 0.0001),
        focal_length_px=150.0,
        principal_px=(330.5, 230.25),
    ),
    Fisheye(coefficients=(-0.1, 0.0, 0.0, 0.0), fov_deg=209),  # turns back at 209.2 degrees
    Catadioptric(),
    Catadioptric(xi=0.0, fov_deg=150),
    Catadioptric(xi=0.6, fov_deg=230, blind_deg=15, principal_px=(300.0, 250.0)),
    Catadioptric(xi=1.0, fov_deg=300),
    Catadioptric(xi=1.8, fov_deg=200, focal_length_px=300.0),
    SphericalCamera(),
    SphericalCamera(width=401, height=401, focal_length_px=60.0),
]


def rays_within(lens: Radial, n: int = 10_000) -> np.ndarray:
    """Directions spread evenly over what the lens sees."""
    rng = np.random.default_rng(1)
    low, high = np.cos(lens.reach)
    theta = np.arccos(rng.uniform(high, low, n))
    return direction(np.stack([theta, rng.uniform(-np.pi, np.pi, n)], axis=-1))


@pytest.mark.parametrize("lens", LENSES)
def test_directions_come_back_from_pixels(lens):
    ray = rays_within(lens)
    p = ray * np.random.default_rng(2).uniform(0.1, 100, (len(ray), 1))
    np.testing.assert_allclose(lens.ray(lens.project(p)), ray, atol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
def test_pixels_come_back_from_rays(lens):
    uv = np.random.default_rng(3).uniform(
        [-0.5, -0.5], [lens.width - 0.5, lens.height - 0.5], (10_000, 2)
    )
    ray = lens.ray(uv)
    r = np.linalg.norm(uv - lens.centre, axis=1)
    seen = (r > lens.f * lens.ring[0]) & (r < lens.f * lens.ring[1])
    assert seen.sum() > 1000
    np.testing.assert_array_equal(np.isfinite(ray).all(axis=1), seen)
    np.testing.assert_allclose(np.linalg.norm(ray[seen], axis=1), 1, atol=1e-14)
    np.testing.assert_allclose(lens.project(ray[seen]), uv[seen], atol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
def test_leading_axes_are_a_batch(lens):
    p = rays_within(lens, 24)
    uv = lens.project(p)
    for shape in [(4, 6), (2, 3, 4), (24, 1)]:
        batch = lens.project(p.reshape(*shape, 3))
        np.testing.assert_array_equal(batch, uv.reshape(*shape, 2))
        np.testing.assert_array_equal(lens.ray(batch), lens.ray(uv).reshape(*shape, 3))
        assert lens.normalise(batch).shape == (*shape, 2)
    assert lens.project(np.zeros((0, 3))).shape == (0, 2)


@pytest.mark.parametrize("lens", LENSES)
def test_normalised_coordinates_are_those_of_rays_ahead(lens):
    ray = rays_within(lens)
    ahead = ray[:, 2] > 1e-3
    xy = lens.normalise(lens.project(ray))
    np.testing.assert_allclose(xy[ahead], ray[ahead, :2] / ray[ahead, 2:], rtol=1e-6, atol=1e-9)
    assert np.isnan(xy[ray[:, 2] < 0]).all()


@pytest.mark.parametrize("size", [(640, 480), (300, 500), (333, 333)])
@pytest.mark.parametrize("kind", [Fisheye, Catadioptric, SphericalCamera])
def test_the_image_circle_touches_the_shorter_side(kind, size):
    lens = kind(width=size[0], height=size[1])
    phi = np.linspace(-np.pi, np.pi, 361)
    rim = lens.project(direction(np.stack([np.full(361, lens.reach[1]), phi], axis=-1)))
    low, high = rim.min(axis=0), rim.max(axis=0)
    short = int(np.argmin(size))
    assert low[short] == pytest.approx(-0.5)
    assert high[short] == pytest.approx(min(size) - 0.5)
    np.testing.assert_allclose(np.linalg.norm(rim - lens.centre, axis=1), min(size) / 2)
    assert np.isfinite(lens.ray(rim)).all()


@pytest.mark.parametrize("lens", LENSES)
def test_nothing_is_seen_out_of_reach(lens):
    low, high = lens.reach
    phi = np.linspace(-3, 3, 50)

    def at(theta: float) -> np.ndarray:
        return lens.project(direction(np.stack([np.full(50, theta), phi], axis=-1)))

    assert np.isfinite(at(high - 1e-6)).all()
    assert np.isfinite(at(low + 1e-6)).all()
    if high < np.pi:
        assert np.isnan(at(high + 1e-6)).all()
    if low > 0:
        assert np.isnan(at(low - 1e-6)).all()
        assert np.isnan(lens.ray(lens.centre)).all()
    else:
        np.testing.assert_allclose(lens.ray(lens.centre), [0, 0, 1], atol=1e-15)
    assert np.isnan(lens.project(np.zeros((1, 3)))).all()
    assert np.isnan(lens.ray(lens.centre + 1.001 * np.array([0, lens.f * lens.ring[1]]))).all()


@pytest.mark.parametrize("lens", LENSES)
def test_nothing_comes_of_nothing_without_a_warning(lens):
    with np.errstate(all="raise"):
        bad = np.array([[np.nan, 0.0, 1.0], [0.0, 0.0, np.nan], [0.0, 0.0, 0.0]])
        assert np.isnan(lens.project(bad)).all()
        assert np.isnan(lens.ray(np.full((2, 2), np.nan))).all()
        assert np.isnan(lens.normalise(np.full((2, 2), np.nan))).all()


@pytest.mark.parametrize("lens", LENSES)
def test_right_and_down_are_where_they_are_in_the_picture(lens):
    theta = np.mean(lens.reach)
    right, down = (
        lens.project(direction(np.array([[theta, 0.0], [theta, np.pi / 2]]))) - lens.centre
    )
    assert right[0] > 10
    assert down[1] > 10
    assert abs(right[1]) < 1e-9 > abs(down[0])


@pytest.mark.parametrize("kind", [Fisheye, Catadioptric, SphericalCamera])
def test_bad_pictures_are_refused(kind):
    assert kind in CAMERAS.members.values()
    with pytest.raises(ParameterError, match="principal_px must be within the 640 x 480 picture"):
        kind(principal_px=(700, 200))
    with pytest.raises(ParameterError, match="focal_length_px"):
        kind(focal_length_px=0.0)
    with pytest.raises(ParameterError, match="fovy_deg"):
        kind(fovy_deg=60)
