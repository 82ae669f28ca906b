"""What a scenario is in the simulator: its plant, and the pictures of its goal."""

from __future__ import annotations

import functools
import logging
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace

from vstestbed.camera import Picture
from vstestbed.core.errors import ParameterError
from vstestbed.features.observation import Goal, Sight
from vstestbed.scenario.cameras import OtherCamera
from vstestbed.scenario.distributions import (
    GOAL_STREAM,
    IMAGE_STREAM,
    IMAGING_STREAM,
    MOTION_STREAM,
    RGBD_STREAM,
    SENSOR_STREAM,
)
from vstestbed.scenario.noise import Noise, TargetNoise
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import Plant, flange_for, posture_at
from vstestbed.sim.build import PictureSetup, build_plant
from vstestbed.tasks.base import GoalPicture

# Inactive effects, on pictures or measured points in a run that has none, are warned of: a
# comparison would take them for harmless.


def effects_on_pictures(scenario: Scenario) -> Iterator[str]:
    """The dotted paths of what a scenario does to its pictures alone."""
    # What changes the grey levels of a picture, and not where or when it is taken, as latency and
    # readout do.
    camera = scenario.camera
    noise = scenario.noise
    light = scenario.world.light
    acts = {
        "camera.optics": camera.optics is not None,
        # With `blurs` the exposure is also a time, half of which each picture is older.
        "camera.exposure": camera.exposure is not None and camera.blurring is None,
        "camera.sensor": camera.sensor is not None,
        "camera.stream": camera.stream is not None,
        "noise.image_sigma": noise.image_sigma > 0,
        "noise.drift": noise.drift != Noise().drift,
        "noise.target": not noise.target.none,
        "world.light.flicker": light is not None and light.flicker.depth > 0,
    }
    yield from (name for name in acts if acts[name])
    yield from _perturbing(noise, "picture")


def _perturbing(noise: Noise, what: str) -> Iterator[str]:
    for i, kind in enumerate(noise.perturb):
        if tuple(kind.changes) == (what,):
            yield f"noise.perturb.{i}"


def warn_without_effect(scenario: Scenario) -> None:
    """Warn once of effects on pictures where neither detector nor law looks at any, and of those on
    points that no detector measures.
    """
    detector = scenario.detector
    if not scenario.needs_image and (found := ", ".join(effects_on_pictures(scenario))):
        why = (
            f"it changes pictures and detector {detector.kind} looks at none;"
            " works: a detector of pictures, such as blobs"
        )
        _warn_once(found, why)
    if detector.rows == 0 and (found := ", ".join(_effects_on_points(scenario.noise))):
        why = (
            f"it changes measured points and detector {detector.kind} measures none;"
            " works: noise of the picture, noise.image_sigma"
        )
        _warn_once(found, why)


def _effects_on_points(noise: Noise) -> Iterator[str]:
    for name in ("pixel_sigma_px", "dropout"):
        if getattr(noise, name) > 0:
            yield f"noise.{name}"
    yield from _perturbing(noise, "pixels")


@functools.cache
def _warn_once(found: str, why: str) -> None:
    logging.getLogger("vstestbed").warning("%s: without effect, for %s", found, why)


# The goal's pictures, taken by the simulated camera at each goal view before the run, as a robot is
# taught its goal by showing.
def take_goal_images(scenario: Scenario, plant: Plant) -> tuple[Sight, ...]:
    """The picture at each goal view; none where neither law nor detector needs them. It is taken
    through the true lens, without noise and at rest, unless the scenario names a file, or other
    light (`GoalPicture`). The plant is left in its state.
    """
    if not scenario.needs_goal_image:
        return ()
    said = scenario.goal.pictures or (GoalPicture(),) * len(scenario.goal_poses)
    rng = scenario.rng(GOAL_STREAM)
    sights: list[Sight] = []
    for T_camera_target, one in zip(scenario.goal_poses, said, strict=True):
        if one.source is not None:
            sights.append(Sight(one.read(scenario.camera)))
        else:
            T_world_flange = flange_for(scenario.camera, scenario.target, T_camera_target)
            # of the target where it is at the start; an arm stands as it will at the goal
            stands = scenario.robot.base == "fixed"
            q = posture_at(scenario.robot, T_world_flange) if stands else None
            taken = sight_of(plant.picture_from(T_world_flange, q))
            sights.append(replace(taken, image=one.under_its_light(taken.image, rng)))
    return tuple(sights)


def sight_of(picture: Picture) -> Sight:
    """A picture, completed where only a part of it was drawn,
    as laws and detectors are given it.
    """
    whole = picture.completed()
    if whole.image is None:
        words = (
            "must have a single image, of which a law or a detector takes all;"
            " use a perspective camera"
        )
        raise ParameterError("camera", words)
    # The renderer overwrites its picture, and a law may keep one to compare the next with.
    return Sight(whole.image.copy(), whole.depth)


def with_images(scenario: Scenario, images: Sequence[Sight]) -> tuple[Goal, ...]:
    """The goal views with their pictures; ParameterError where the number, or a size, is not that
    of the goal views and the camera.
    """
    views = scenario.goal_views
    camera = scenario.camera
    if not scenario.needs_goal_image:
        return views
    said = scenario.goal.pictures
    if not images and all(one.file is not None for one in said):
        images = tuple(Sight(one.read(camera)) for one in said)
    if len(images) != len(views):
        words = (
            f"must be {len(views)}, one of each goal view: detector {scenario.detector.kind} or law"
            f" {scenario.law.kind} compares with it; give them, or name their files in goal.picture"
        )
        raise ParameterError("goal_images", words, len(images))
    wanted = camera.height, camera.width, 3
    for sight in images:
        if sight.image.shape != wanted:
            raise ParameterError.count("goal_images", "of shape", f"{wanted}", sight.image.shape)
    return tuple(replace(view, image=sight) for view, sight in zip(views, images, strict=True))


def shown_clean(scenario: Scenario) -> tuple[Sight, ...] | None:
    """Pictures of the goal before the target's picture was changed (`noise.target`); None where it
    is not changed.
    """
    if scenario.noise.target.none or not scenario.needs_goal_image:
        return None
    clean = replace(scenario, noise=replace(scenario.noise, target=TargetNoise()))
    plant, _ = plant_of(clean, pictures=True, plate_m=0.0)
    with closing(plant):
        return take_goal_images(clean, plant)


def plant_of(scenario: Scenario, pictures: bool, plate_m: float) -> tuple[Plant, str]:
    """The plant of a scenario, and the name of its renderer; warns of scenery that the detector may
    take for markers, and of effects that it does not see.
    """
    warn_without_effect(scenario)
    scenery = scenario.world.scenery
    chroma = getattr(scenario.detector, "chroma", None)
    if scenery is not None and chroma is not None:
        # here: MuJoCo is imported where there is any
        from vstestbed.sim.scene.scenery import warn_of_colours

        warn_of_colours(scenery.file, scenario.detector.kind, chroma)
    scene = replace(scenario.scene, plate_m=plate_m)
    timing = scenario.timing
    return build_plant(
        scene,
        _pictures(scenario, pictures),
        sensor_rng=scenario.rng(SENSOR_STREAM),
        motion_rng=scenario.rng(MOTION_STREAM),
        setpoints=scene.setpoints(
            timing.order_s(scenario.camera), timing.interpolator(*scenario.clock)
        ),
        others={name: _pictures(eye, pictures) for name, eye in scenario.eyes.items()},
    )


def _pictures(of: Scenario | OtherCamera, wanted: bool) -> PictureSetup:
    """What becomes of the pictures of a scenario's camera, or of a further one; wanted: whether
    also somebody else looks at them.
    """
    return PictureSetup(
        needs_image=of.needs_image or wanted,
        needs_truth=of.detector.needs_truth,
        image_sigma=of.noise.image_sigma,
        rng=of.rng(IMAGE_STREAM),
        depth_rng=of.rng(RGBD_STREAM),
        imaging_rng=of.rng(IMAGING_STREAM),
        drift=of.noise.drift,
        perturbed=of.perturbed(),
    )
