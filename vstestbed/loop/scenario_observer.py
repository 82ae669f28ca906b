"""The observer of a scenario."""

from __future__ import annotations

from vstestbed.scenario.scenario import Scenario
from vstestbed.vision import Observer


def observer_of(scenario: Scenario) -> Observer:
    """The observer of a scenario."""
    perturbed = scenario.perturbed()
    return Observer(
        camera=scenario.believed_camera,
        target=scenario.target,
        goal=scenario.goal_view,
        depth=scenario.law.depth,
        pixel_sigma_px=scenario.noise.pixel_sigma_px,
        dropout=scenario.noise.dropout,
        required_fields=scenario.law.inputs,
        grounded=scenario.robot.base == "planar",
        derotation=scenario.derotation,
        trim_s=scenario.level_trim_s,
        depth_scale=scenario.depth_scale,
        perturbed=perturbed if perturbed and perturbed.on_pixels else None,
        rows=scenario.detector.rows,
    )
