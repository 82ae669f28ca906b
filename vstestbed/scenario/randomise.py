"""Domain randomisation: the block `randomise`, and clutter, drawn from a scenario's seed.

Each field has a generator of its own, of the seed, RANDOMISE_STREAM and the field's name: one more changes none of the others, nor any
other stream.

Reference: Tobin, Fong, Ray, Schneider, Zaremba & Abbeel 2017, doi:10.1109/IROS.2017.8202133 (a simulator's pictures varied so widely that
the real one is one more variation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vstestbed.core.errors import ParameterError, ScenarioError, short
from vstestbed.core.registry import brief_mapping, to_mapping
from vstestbed.scenario.distributions import Distribution
from vstestbed.scenario.yaml_marks import build, put_over

if TYPE_CHECKING:
    from vstestbed.scenario.scenario import Scenario

# Independent random streams of one seed. Their numbers enter the seed: a new one comes last, or all recorded runs change.


START_STREAM, NOISE_STREAM, IMAGE_STREAM, SENSOR_STREAM, TIMING_STREAM, DEPTH_STREAM, MOTION_STREAM, PERTURB_STREAM = range(8)
"""The start, the noise of measured pixels, of pictures, of the robot's own sensors, of timing, of the calibration of depths, the target's
random walk, perturbations."""
RGBD_STREAM, GOAL_STREAM, BODY_STREAM, LINK_STREAM, STAMP_STREAM, IMAGING_STREAM, RANDOMISE_STREAM, CLUTTER_STREAM = range(8, 16)
"""The depth camera, the goal's picture, what differs from one robot to the next of its kind, losses of the link, time stamps, the image
sensor, the block `randomise`, clutter."""
TARGET_STREAM = 16  # changes of the target's own picture


def drawn(scenario: Scenario) -> Scenario:
    """The scenario with the values of `randomise`, which is then empty, and the objects of `world.clutter` that its seed draws. Itself
    where it has them already.
    Raises ParameterError: a drawn value is refused; it names the distribution, `randomise.2`, the value and why.
    """
    if scenario.randomise:
        plain, found = to_mapping(scenario) | {"randomise": []}, values_of(scenario)
        fields, values = list(found), list(found.values())
        if "robot.realism" in fields:  # it fills what is not given
            plain["robot"] = brief_mapping(scenario.robot)
        try:
            put_over(plain, found, {}, {})
            scenario = build(type(scenario), plain, {}, "")
        except ScenarioError as error:
            mistake = error.mistakes[0]
            wrong, places = f"{mistake.field}.", [f"{field}." for field in fields]
            # It is of the drawn field, of one in it, or of its block.
            i = next((i for i, at in enumerate(places) if wrong.startswith(at) or (wrong != "." and at.startswith(wrong))), 0)
            words = f"drew {short(values[i])} for {fields[i]} with seed {scenario.seed}: {mistake.field} {mistake.sentence}"
            raise ParameterError(f"randomise.{i}", words) from None
    clutter = scenario.world.clutter
    if clutter is None or clutter.placed or not clutter.count:
        return scenario
    placed = clutter.draw(np.random.default_rng([scenario.seed, CLUTTER_STREAM]), scenario.target.hues_deg)
    return replace(scenario, world=replace(scenario.world, clutter=replace(clutter, placed=placed)))


def values_of(scenario: Scenario) -> dict[str, Any]:
    """What the seed draws for the fields of `randomise`, by their paths."""
    of_field = [(one, np.random.default_rng([scenario.seed, RANDOMISE_STREAM, *one.field.encode()])) for one in scenario.randomise]
    return {one.field: one.draw(rng) for one, rng in of_field}


def check_randomise(randomise: Sequence[Distribution]) -> None:
    """Refuse two distributions of one field, or of a block and a field in it."""
    for i, one in enumerate(randomise):
        for j, other in enumerate(randomise[:i]):
            if f"{one.field}.".startswith(f"{other.field}.") or f"{other.field}.".startswith(f"{one.field}."):
                raise ParameterError.conflict(f"randomise.{i}.field", f"randomise.{j}.field: {other.field}", one.field)
