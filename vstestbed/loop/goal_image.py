"""The goal's pictures, taken by the simulated camera at each goal view before the run, as a robot is taught its goal by showing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from vstestbed.camera import Picture
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.features.observation import Goal, Sight
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import Plant
from vstestbed.sim.scene.start_pose import flange_for, posture_at


def take_goal_images(scenario: Scenario, plant: Plant) -> tuple[Sight, ...]:
    """The picture at each goal view, through the true lens, without noise and at rest; none where neither law nor detector needs them.

    The plant is left in its state.
    """
    if not scenario.needs_goal_image:
        return ()
    return tuple(_taken(scenario, plant, T) for T in scenario.goal_poses)


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
    return Sight(whole.image, whole.depth)


def with_images(scenario: Scenario, images: Sequence[Sight]) -> tuple[Goal, ...]:
    """The goal views with their pictures.

    Raises:
        ParameterError: their number, or the size of one, is not that of the goal views and the camera.
    """
    views, camera = scenario.goal_views, scenario.camera
    if not scenario.needs_goal_image:
        return views
    if len(images) != len(views):
        words = (
            f"must be {len(views)}, one of each goal view: detector {scenario.detector.kind} or law {scenario.law.kind} compares with it"
        )
        raise ParameterError("goal_images", words, len(images))
    for sight in images:
        if sight.image.shape != (camera.height, camera.width, 3):
            raise ParameterError("goal_images", f"must be of shape {(camera.height, camera.width, 3)}", sight.image.shape)
    return tuple(replace(view, image=sight) for view, sight in zip(views, images, strict=True))
