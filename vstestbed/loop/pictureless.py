"""Effects on pictures or measured points in a run that has none: they are told, since a comparison would take them for harmless."""

from __future__ import annotations

import functools
import logging
from collections.abc import Iterator

from vstestbed.scenario.noise import Noise
from vstestbed.scenario.scenario import Scenario

OF_CAMERAS = "optics", "exposure", "sensor", "stream"
"""Blocks of a camera that change the grey levels of a picture, and not where or when it is taken, as latency and readout do."""


def effects_on_pictures(scenario: Scenario) -> Iterator[str]:
    """The dotted paths of what a scenario does to its pictures alone."""
    given = (name for name in OF_CAMERAS if getattr(scenario.camera, name) is not None)
    # With `blurs` the exposure is also a time, half of which each picture is older.
    yield from (f"camera.{name}" for name in given if name != "exposure" or scenario.camera.blurring is None)
    noise, light = scenario.noise, scenario.world.light
    told = {
        "noise.image_sigma": noise.image_sigma > 0,
        "noise.drift": noise.drift != Noise().drift,
        "noise.target": not noise.target.none,
        "world.light.flicker": light is not None and light.flicker.depth > 0,
    }
    yield from (name for name, acts in told.items() if acts)
    yield from _perturbing(noise, "picture")


def effects_on_points(scenario: Scenario) -> Iterator[str]:
    """The dotted paths of what a scenario does to measured points alone."""
    noise = scenario.noise
    yield from (f"noise.{name}" for name in ("pixel_sigma_px", "dropout") if getattr(noise, name) > 0)
    yield from _perturbing(noise, "pixels")


def _perturbing(noise: Noise, what: str) -> Iterator[str]:
    """The kinds of `noise.perturb` that change this alone."""
    return (f"noise.perturb.{i}" for i, kind in enumerate(noise.perturb) if tuple(kind.changes) == (what,))


def warn_without_effect(scenario: Scenario) -> None:
    """Warn once of effects on pictures where neither detector nor law looks at any, and of those on points that no detector measures."""
    detector = scenario.detector
    if not scenario.needs_image and (found := ", ".join(effects_on_pictures(scenario))):
        why = f"it changes pictures and detector {detector.kind} looks at none; works: a detector of pictures, such as blobs"
        _warn_once(found, why)
    if detector.rows == 0 and (found := ", ".join(effects_on_points(scenario))):
        why = f"it changes measured points and detector {detector.kind} measures none; works: noise of the picture, noise.image_sigma"
        _warn_once(found, why)


@functools.cache
def _warn_once(found: str, why: str) -> None:
    logging.getLogger("vstestbed").warning("%s: without effect, for %s", found, why)
