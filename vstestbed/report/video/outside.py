"""The picture from outside with what explains it: goal, frustum and trail of the camera, target frame, the camera's own picture.

All of it is projected with the outside camera's pose and drawn by OpenCV: the same for every renderer, and never in the servo camera's
pictures.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array, inverse, transform
from vstestbed.report.video.overlay import INK, PAPER, SHIFT, UNIT, Color, Overlay
from vstestbed.report.video.writer import Image
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.replay import FREE, Replay

if TYPE_CHECKING:
    from vstestbed.report.video.film import FilmFrame

GOAL: Final[Color] = (110, 255, 170)
OWN: Final[Color] = (255, 196, 64)
AXES: Final[tuple[Color, ...]] = ((255, 70, 70), (70, 225, 90), (90, 150, 255))
FRUSTUM: Final = 0.055
"""Length of a frustum over the picture's width, at its place."""
MOST_PLACES: Final = 400
"""Points of the trail of the camera: when there are more, every other one is dropped."""
AXIS: Final = 0.045
"""Length of an axis of the target's frame over the picture's width, at its place."""
INSET_S: Final = 0.2
"""Time between two pictures of the servo camera in the inset that must be rendered for it [s]."""
EDGE: Final = 2
"""Width of the edge of the inset [px]."""
SPACING: Final = 0.006
"""Distance of two points of it over the picture's width, at their place."""
GHOST_FILL: Final = 0.25
FOLDED: Final = np.array([[i, j, 1.0] for i, j in ((-0.6, -0.6), (0.6, -0.6), (0.6, 0.6), (-0.6, 0.6))])
"""Corners of the pyramid that stands for the frustum of a lens that sees sideways."""


class Outside:
    """Draws pictures of a run from one outside camera; called with each frame in turn, since view and trail continue.

    Args:
        scenario: the experiment. replay: renders the scene. camera: name in it. size: (width, height) [px].
    """

    def __init__(self, scenario: Scenario, replay: Replay, camera: str, size: tuple[int, int]):
        self._replay, self._size = replay, size
        self._name, self._moving, self._has_frame = camera, scenario.robot.base != "fixed", len(scenario.target.places) > 0
        self._held = 1.2 * scenario.target.points if scenario.target.on_gripper else None
        self._line = max(1, round(size[1] / 360))
        self._trail, self._spacing = np.zeros((0, 3)), 0.0
        self._corners = _frustum(scenario.camera)
        self._scale = min((1 - FREE) * size[0] / scenario.camera.width, 0.5 * size[1] / scenario.camera.height)
        self._inset: tuple[float, Image] | None = None
        self._inset_size = round(scenario.camera.width * self._scale), round(scenario.camera.height * self._scale)
        self._overlay = Overlay(*self._inset_size, scenario.target.colors)

    def picture(self, frame: FilmFrame, T_world_goal: Array | None) -> Image:
        """One picture (H, W, 3); T_world_goal: the servo camera's pose (4, 4) at its goal, if it has one."""
        width, height = self._size
        T_target, T_camera = frame.T_world_target, frame.T_world_camera
        scene = self._replay.picture(self._name, width, height, frame.t, T_target, frame.q, T_camera, T_world_goal)
        pen = Pen(scene, *self._replay.sight(self._name, width, height), self._line)
        if T_world_goal is not None:
            self._draw_goal(pen, T_world_goal, T_camera, T_target)
        self._extend(pen, T_camera[:3, 3])
        pen.lines([self._trail], OWN)
        pen.lines(self._wire(pen, T_camera), OWN)
        if self._has_frame:
            length = pen.metres(AXIS, T_target[:3, 3])
            for axis, color in zip(T_target[:3, :3].T, AXES, strict=True):
                pen.lines([T_target[:3, 3] + np.array([[0.0], [length]]) * axis], color, 2)
        return scene

    def _draw_goal(self, pen: Pen, T_world_goal: Array, T_camera: Array, T_target: Array) -> None:
        """The camera's frustum at its goal, with the body of a robot that moves; eye to hand the target where it has to go."""
        to_goal = T_world_goal @ inverse(T_camera)
        if self._held is not None:
            pen.area(transform(inverse(to_goal) @ T_target, self._held)[None], GOAL, GHOST_FILL)
            return
        if self._moving:
            pen.area(transform(to_goal, self._replay.body()), GOAL, GHOST_FILL)
        pen.lines(self._wire(pen, T_world_goal), GOAL)

    def put_inset(self, scene: Image, frame: FilmFrame, image: Image | None, render: Callable[[], Image]) -> None:
        """The servo camera's image in the upper right corner of a picture, with its markers, in place.

        image: what is there already; without one, `render` is asked every INSET_S alone, since a wide lens takes several views.
        """
        if image is None and (self._inset is None or frame.t >= self._inset[0] + INSET_S - 1e-9):
            image = render()
        if image is not None:
            width, height = self._inset_size
            part = np.full((height + EDGE, width + EDGE, 3), PAPER, np.uint8)
            every = max(1, int(0.5 / self._scale))  # the mean of every pixel of a large image would take longer than the rest
            image = image[every // 2 :: every, every // 2 :: every]
            small = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
            self._overlay.marks(small, (frame.uv + 0.5) * self._scale - 0.5, (frame.goal_uv + 0.5) * self._scale - 0.5)
            part[:height, EDGE:] = small
            self._inset = frame.t, part
        assert self._inset is not None  # rendered at the first frame
        part = self._inset[1]
        scene[: part.shape[0], scene.shape[1] - part.shape[1] :] = part

    def _wire(self, pen: Pen, T: Array) -> list[Array]:
        """The edges of the frustum of a camera at a pose (4, 4)."""
        corners = transform(T, pen.metres(FRUSTUM, T[:3, 3]) * self._corners)
        return [np.vstack([corners, corners[:1]]), *(np.array([T[:3, 3], corner]) for corner in corners)]

    def _extend(self, pen: Pen, place: Array) -> None:
        trail = self._trail
        self._spacing = self._spacing or pen.metres(SPACING, place)
        if not len(trail) or np.linalg.norm(place - trail[-1]) >= self._spacing:
            trail = np.vstack([trail, place])
        if len(trail) > MOST_PLACES:
            trail, self._spacing = trail[::2], 2 * self._spacing
        self._trail = trail


class Pen:
    """Draws lines and areas of the world on a picture, in place.

    Args:
        image: the picture. lens, T_world_camera: the camera that took it. stroke: width of a line [px].
    """

    def __init__(self, image: Image, lens: Camera, T_world_camera: Array, stroke: int):
        self.image, self._lens, self._T, self._stroke = image, lens, inverse(T_world_camera), stroke

    def pixels(self, points: Array) -> Array:
        """Pixels (..., 2) of points (..., 3) in the world; NaN behind the camera, or too far outside for OpenCV's integers."""
        uv = self._lens.project(transform(self._T, points))
        with np.errstate(invalid="ignore"):
            return np.where((np.abs(uv) < 8 * self._lens.width).all(axis=-1, keepdims=True), uv, np.nan)

    def metres(self, share: float, place: Array) -> float:
        """What appears as long as a share of the picture's width, at a place (3,) [m]."""
        depth = max(float((self._T[:3, :3] @ place + self._T[:3, 3])[2]), 1e-3)
        a, b = self._lens.project(np.array([[0.0, 0.0, depth], [depth, 0.0, depth]]))
        return share * self._lens.width * depth / float(b[0] - a[0])

    def lines(self, polylines: list[Array], color: Color, width: int = 1) -> None:
        """Polylines (N, 3) of points in the world, with a dark edge; points that cannot be drawn are left out."""
        grid = []
        for line in polylines:
            uv = self.pixels(line)
            uv = uv[np.isfinite(uv[:, 0])]
            if len(uv) > 1:
                grid.append(np.rint(uv * UNIT).astype(np.int32)[:, None])
        stroke = self._stroke * width
        cv2.polylines(self.image, grid, False, INK, stroke + 1, cv2.LINE_AA, SHIFT)
        cv2.polylines(self.image, grid, False, color, stroke, cv2.LINE_AA, SHIFT)

    def area(self, hulls: Array, color: Color, fill: float) -> None:
        """The union of the convex hulls of points (G, P, 3): a translucent area with an outline."""
        uv = self.pixels(hulls)
        uv = uv[np.isfinite(uv).all(axis=(1, 2))]
        size = np.array(self.image.shape[1::-1])
        low, high = np.clip([uv.min(axis=(0, 1), initial=8e3) - 2, uv.max(axis=(0, 1), initial=-8e3) + 3], 0, size).astype(int)
        if not (low < high).all():
            return
        part = self.image[low[1] : high[1], low[0] : high[0]]
        mask = np.zeros(part.shape[:2], np.uint8)
        for points in np.rint((uv - low) * UNIT).astype(np.int32)[:, :, None]:
            cv2.fillConvexPoly(mask, cv2.convexHull(points), 255, cv2.LINE_8, SHIFT)
        cv2.copyTo(cv2.addWeighted(part, 1 - fill, np.full_like(part, color), fill, 0), mask, part)
        cv2.polylines(part, list(cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)[0]), True, color, self._stroke, cv2.LINE_AA)


def _frustum(camera: Camera) -> Array:
    """Corners (4, 3) of the picture on the plane at distance 1, at most .6 to each side; of a lens that sees beyond it, a pyramid."""
    w, h = camera.width - 0.5, camera.height - 0.5
    rays = camera.ray(np.array([[-0.5, -0.5], [w, -0.5], [w, h], [-0.5, h]]))
    with np.errstate(invalid="ignore"):
        if not (rays[:, 2] > 0.2).all():
            return FOLDED
    corners = rays / rays[:, 2:]
    return corners * min(1.0, 0.6 / float(np.abs(corners[:, :2]).max()))
