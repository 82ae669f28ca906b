"""Wind: gusts against their formula, turbulence against its statistics."""

import mujoco
import numpy as np
import pytest

from vstestbed.effects.wind import Gust, Wind, WindField

MODEL = mujoco.MjModel.from_xml_string("<mujoco><worldbody/></mujoco>")


def test_a_gust_comes_and_goes():
    wind = Wind(mean_mps=(1, 0, 0), gusts=(Gust(from_s=2, duration_s=4, velocity_mps=(0, 5, 0)),))
    np.testing.assert_allclose(
        [wind.at(t) for t in (0, 2, 3, 4, 5, 6, 9)],
        [[1, v, 0] for v in (0, 0, 2.5, 5, 2.5, 0, 0)],
        atol=1e-12,
    )


def test_turbulence_has_its_size_and_its_memory():
    field = WindField(Wind(turbulence_mps=0.5, turbulence_s=0.2), MODEL, np.random.default_rng(0))
    rows = []
    for k in range(40000):
        field.act(0.01 * k, 0.01)
        rows.append(MODEL.opt.wind.copy())
    u = np.array(rows)
    # 400 s hold 2000 correlation times on each of three axes: 2 % of the size, twice that.
    assert u.std() == pytest.approx(0.5, rel=0.04)
    assert (u[20:] * u[:-20]).mean() / u.var() == pytest.approx(np.exp(-1), abs=0.05)


def test_still_air():
    assert (
        Wind().still
        and not Wind(turbulence_mps=0.1).still
        and not Wind(gusts=(Gust(from_s=1),)).still
    )
