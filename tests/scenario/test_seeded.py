"""A seed draws what is random, also from a fixed start."""

from __future__ import annotations

import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.scenario.load import load, seeded


@pytest.mark.parametrize(
    "settings",
    [{"timing.link": {}}, {"timing.latency_jitter_s": 0.01}, {"robot.realism": "field"}, {"robot.geometry_error": {"sigma_m": 0.001}}],
    ids=str,
)
def test_a_seed_draws_what_is_random_from_a_fixed_start(settings: dict[str, object]) -> None:
    fixed = load("arm_ibvs", {"robot.start.random": None, "detector": "oracle", **settings})
    again = seeded(fixed, 7)
    assert again.seed == 7 and again.robot.configuration().tolist() == fixed.robot.configuration().tolist()


def test_a_seed_of_nothing_random_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"robot\.start\.random"):
        seeded(load("arm_ibvs", {"robot.start.random": None, "detector": "oracle", "robot.payload": {"mass_kg": 1.0}}), 7)
