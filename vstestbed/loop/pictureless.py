"""Effects on pictures in a run in which nobody looks at any: they are told, since a comparison would take them for harmless."""

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
    if noise.image_sigma > 0:
        yield "noise.image_sigma"
    if noise.drift != Noise().drift:
        yield "noise.drift"
    yield from (f"noise.perturb.{i}" for i, kind in enumerate(noise.perturb) if tuple(kind.changes) == ("picture",))
    if not noise.target.none:
        yield "noise.target"
    if light is not None and light.flicker.depth > 0:
        yield "world.light.flicker"


def warn_without_pictures(scenario: Scenario) -> None:
    """Warn once of effects on pictures where neither the detector nor the law looks at pictures: they change nothing then."""
    if not scenario.needs_image and (found := ", ".join(effects_on_pictures(scenario))):
        _warn_once(found, scenario.detector.kind)


@functools.cache
def _warn_once(found: str, detector: str) -> None:
    words = "without effect, for it changes pictures and detector %s looks at none; works: a detector of pictures, such as blobs"
    logging.getLogger("vstestbed").warning(f"%s: {words}", found, detector)
