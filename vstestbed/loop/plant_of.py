"""What a scenario is in the simulator: its plant, and the pictures of its goal."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

from vstestbed.features.observation import Sight
from vstestbed.loop.goal_image import take_goal_images
from vstestbed.loop.pictureless import warn_without_effect
from vstestbed.scenario.noise import TargetNoise
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.streams import IMAGE_STREAM, IMAGING_STREAM, MOTION_STREAM, RGBD_STREAM, SENSOR_STREAM
from vstestbed.sim.base import Plant
from vstestbed.sim.build import build_plant


def shown_clean(scenario: Scenario) -> tuple[Sight, ...] | None:
    """Pictures of the goal before the target's picture was changed (`noise.target`); None where it is not changed."""
    if scenario.noise.target.none or not scenario.needs_goal_image:
        return None
    clean = replace(scenario, noise=replace(scenario.noise, target=TargetNoise()))
    plant, _ = plant_of(clean, pictures=True, plate_m=0.0)
    with closing(plant):
        return take_goal_images(clean, plant)


def plant_of(scenario: Scenario, pictures: bool, plate_m: float) -> tuple[Plant, str]:
    """The plant of a scenario, and the name of its renderer; warns of scenery that the detector may take for markers, and of effects
    that it does not see.
    """
    warn_without_effect(scenario)
    scenery, chroma = scenario.world.scenery, getattr(scenario.detector, "chroma", None)
    if scenery is not None and chroma is not None:
        from vstestbed.sim.scene.scenery import warn_of_colours  # here: MuJoCo is imported where there is any

        warn_of_colours(scenery.file, scenario.detector.kind, chroma)
    return build_plant(
        scenario.robot,
        scenario.camera,
        scenario.target_in_run,
        scenario.world,
        scenario.physics,
        needs_image=scenario.needs_image or pictures,
        needs_truth=scenario.detector.needs_truth,
        image_sigma=scenario.noise.image_sigma,
        rng=scenario.rng(IMAGE_STREAM),
        depth_rng=scenario.rng(RGBD_STREAM),
        sensor_rng=scenario.rng(SENSOR_STREAM),
        motion_rng=scenario.rng(MOTION_STREAM),
        imaging_rng=scenario.rng(IMAGING_STREAM),
        drift=scenario.noise.drift,
        perturbed=scenario.perturbed(),
        order_s=scenario.timing.order_s(scenario.camera),
        led=scenario.timing.interpolated(*scenario.clock),
        plate_m=plate_m,
    )
