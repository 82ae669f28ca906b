"""The goal's pictures, taken by the simulated camera at each goal view before the run, as a robot is taught its goal by showing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vstestbed.camera import Picture
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.features.observation import Goal, Sight
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.streams import GOAL_STREAM
from vstestbed.sim.base import Plant
from vstestbed.sim.scene.start_pose import flange_for, posture_at
from vstestbed.tasks.goal_picture import GoalPicture


def take_goal_images(scenario: Scenario, plant: Plant) -> tuple[Sight, ...]:
    """The picture at each goal view; none where neither law nor detector needs them.

    It is taken through the true lens, without noise and at rest, unless the scenario names a file, or other light (`GoalPicture`). The
    plant is left in its state.
    """
    if not scenario.needs_goal_image:
        return ()
    said = scenario.goal.pictures or (GoalPicture(),) * len(scenario.goal_poses)
    rng = scenario.rng(GOAL_STREAM)
    return tuple(_pictured(scenario, plant, T, one, rng) for T, one in zip(scenario.goal_poses, said, strict=True))


def _pictured(scenario: Scenario, plant: Plant, T_camera_target: Array, said: GoalPicture, rng: np.random.Generator) -> Sight:
    """The file's picture, or the one from T_camera_target (4, 4) under the light of teaching."""
    if said.source is not None:
        return Sight(said.read(scenario.camera))
    taken = _taken(scenario, plant, T_camera_target)
    return replace(taken, image=said.under_its_light(taken.image, rng))


def _taken(scenario: Scenario, plant: Plant, T_camera_target: Array) -> Sight:
    """The picture from T_camera_target (4, 4), of the target where it is at the start; an arm stands as it will at the goal."""
    T_world_flange = flange_for(scenario.camera, scenario.target, T_camera_target)
    q = posture_at(scenario.robot, T_world_flange) if scenario.robot.base == "fixed" else None
    return sight_of(plant.picture_from(T_world_flange, q))


def sight_of(picture: Picture) -> Sight:
    """A picture, completed where only a part of it was drawn, as laws and detectors are given it."""
    whole = picture.completed()
    if whole.image is None:
        raise ParameterError("camera", "must have a single image, of which a law or a detector takes all; use a perspective camera")
    # The renderer overwrites its picture, and a law may keep one to compare the next with.
    return Sight(whole.image.copy(), whole.depth)


def _from_files(scenario: Scenario) -> tuple[Sight, ...]:
    """The pictures of all goal views from their files; () where one has none."""
    said = scenario.goal.pictures
    return tuple(Sight(one.read(scenario.camera)) for one in said) if all(one.file is not None for one in said) else ()


def with_images(scenario: Scenario, images: Sequence[Sight]) -> tuple[Goal, ...]:
    """The goal views with their pictures.

    Raises:
        ParameterError: their number, or the size of one, is not that of the goal views and the camera.
    """
    views, camera = scenario.goal_views, scenario.camera
    if not scenario.needs_goal_image:
        return views
    images = images or _from_files(scenario)
    if len(images) != len(views):
        words = (
            f"must be {len(views)}, one of each goal view: detector {scenario.detector.kind} or law {scenario.law.kind} compares with it;"
            " give them, or name their files in goal.picture"
        )
        raise ParameterError("goal_images", words, len(images))
    for sight in images:
        if sight.image.shape != (camera.height, camera.width, 3):
            raise ParameterError("goal_images", f"must be of shape {(camera.height, camera.width, 3)}", sight.image.shape)
    return tuple(replace(view, image=sight) for view, sight in zip(views, images, strict=True))
