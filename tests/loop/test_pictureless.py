"""A run says which effects on pictures or points it ignores for want of them, once, and other runs
say nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

import vstestbed as vs
from vstestbed.core.named_files import bundled_scenarios
from vstestbed.loop import plants
from vstestbed.loop.plants import effects_on_pictures, warn_without_effect

SHORT = {"stop.duration_s": 0.2, "detector": "oracle"}
ON_PICTURES: dict[str, Any] = {
    "camera.optics": {"vignetting": 0.4},
    "camera.exposure": {"gain": 2},
    "camera.sensor": {},
    "camera.stream": "jpeg",
    "noise.image_sigma": 3,
    "noise.drift.brightness": 0.2,
    "noise.perturb": ["erasing"],
    "world.light.flicker.depth": 0.3,
}


@pytest.fixture(autouse=True)
def told_anew() -> Iterator[None]:
    plants._warn_once.cache_clear()
    yield
    plants._warn_once.cache_clear()


@pytest.mark.parametrize("name", ON_PICTURES)
def test_each_effect_is_told(name: str, caplog: pytest.LogCaptureFixture) -> None:
    scenario = vs.load("arm_ibvs", SHORT | {name: ON_PICTURES[name]})
    field = {"noise.drift.brightness": "noise.drift", "noise.perturb": "noise.perturb.0"}.get(
        name, name.removesuffix(".depth")
    )
    assert list(effects_on_pictures(scenario)) == [field]
    warn_without_effect(scenario)
    warn_without_effect(scenario)
    words = (
        "without effect, for it changes pictures and detector oracle looks at none;"
        " works: a detector of pictures, such as blobs"
    )
    assert [record.getMessage() for record in caplog.records] == [f"{field}: {words}"]


def test_effects_on_points_that_nobody_measures_are_told(caplog: pytest.LogCaptureFixture) -> None:
    noise = {
        "noise.pixel_sigma_px": 1,
        "noise.dropout": 0.2,
        "noise.perturb": ["erasing", "outliers"],
    }
    warn_without_effect(vs.load("arm_photometric", noise))
    (record,) = caplog.records
    words = (
        "it changes measured points and detector none measures none;"
        " works: noise of the picture, noise.image_sigma"
    )
    assert (
        record.getMessage()
        == f"noise.pixel_sigma_px, noise.dropout, noise.perturb.1: without effect, for {words}"
    )


def test_a_target_whose_picture_has_changed_is_told() -> None:
    scenario = vs.load("arm_picture", SHORT | {"noise.target.image_sigma": 3})
    assert list(effects_on_pictures(scenario)) == ["noise.target"]


def test_what_acts_without_pictures_is_not_told(caplog: pytest.LogCaptureFixture) -> None:
    acts = {
        "camera.readout_s": 0.02,
        "camera.latency_s": 0.04,
        "timing.exposure_s": 0.01,
        "noise.pixel_sigma_px": 1,
        "noise.dropout": 0.1,
    }
    warn_without_effect(vs.load("arm_ibvs", SHORT | acts | {"noise.perturb": ["outliers"]}))
    # its time is the age of the pictures
    warn_without_effect(vs.load("arm_ibvs", SHORT | {"camera.exposure": {"blurs": True}}))
    assert caplog.text == ""


def test_pictures_that_are_looked_at_are_not_told(caplog: pytest.LogCaptureFixture) -> None:
    warn_without_effect(vs.load("arm_ibvs", {"camera.sensor": {}}))
    warn_without_effect(vs.load("arm_photometric", {"camera.sensor": {}}))
    assert caplog.text == ""


def test_a_run_tells_it_and_is_the_same_run(caplog: pytest.LogCaptureFixture) -> None:
    plain, noisy = (
        vs.run(vs.load("ibvs_book", SHORT | more))
        for more in ({}, {"noise.image_sigma": 3, "camera.stream": "jpeg"})
    )
    assert [record.getMessage().partition(":")[0] for record in caplog.records] == [
        "camera.stream, noise.image_sigma"
    ]
    assert (plain["u_0"] == noisy["u_0"]).all()


def test_no_bundled_scenario_has_one_in_vain(caplog: pytest.LogCaptureFixture) -> None:
    for name, path in bundled_scenarios().items():
        if "oracle" in path.read_text(encoding="utf-8"):
            warn_without_effect(vs.load(name))
    assert caplog.text == ""
