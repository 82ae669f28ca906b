"""What a map of ideal runs leaves out of a scenario: it is told, since the map is that of the law alone."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Iterable, Iterator

from vstestbed.robots import Robot
from vstestbed.scenario.scenario import Scenario

OF_CAMERAS = "latency_s", "readout_s", "optics", "exposure", "sensor", "stream"
"""What the pictures of an ideal camera do not have."""
THAT_HIDE = "plates", "scenery"
"""What of the world may stand before a target; the rest of it changes how pictures look."""


def left_out(scenario: Scenario) -> list[str]:
    """What `ideal` takes out of a scenario: a robot's body, points of a detector's own, effects on pictures and timing by their paths."""
    found = [] if scenario.robot.model is None else [*_of_robot(scenario.robot)]
    if scenario.detector.rows is not None:
        found.append(f"the points that detector {scenario.detector.kind} finds (the law has the target's corners in their place)")
    found += [f"camera.{name}" for name in OF_CAMERAS if getattr(scenario.camera, name) not in (0.0, None)]
    for block in ("noise", "timing"):
        found += [f"{block}.{name}" for name in _changed(getattr(scenario, block))]
    return found + [f"world.{name}" for name in THAT_HIDE if getattr(scenario.world, name)]


def tell_left_out(scenarios: Iterable[Scenario]) -> None:
    """Warn of all that is left out of scenarios, in one sentence."""
    if found := dict.fromkeys(name for scenario in scenarios for name in left_out(scenario)):
        words = "the maps are of the law behind an ideal camera, and leave out %s; vstestbed compare runs it all, start by start"
        logging.getLogger("vstestbed").warning(words, ", ".join(found))


def _of_robot(robot: Robot) -> Iterator[str]:
    """Its dynamics and limits, its preset, and the effects that it has: the blocks that are none by default."""
    yield f"the dynamics and limits of robot {robot.kind}"
    names = {field.name: field.default for field in dataclasses.fields(robot) if field.init}  # pyright: ignore[reportArgumentType] - a spec
    names.pop("filled", None)  # by which preset, here none
    if getattr(robot, "realism", "none") != "none":
        yield "robot.realism"
        return  # it fills the others
    yield from (f"robot.{name}" for name, default in names.items() if default is None and getattr(robot, name) is not None)


def _changed(block: object) -> Iterator[str]:
    """The names of a block's fields that are not as by default."""
    plain = type(block)()
    for field in dataclasses.fields(block):  # pyright: ignore[reportArgumentType] - a spec
        if getattr(block, field.name) != getattr(plain, field.name):
            yield field.name
