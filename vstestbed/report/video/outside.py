"""The picture from outside with goal, frustum and trail of the camera, target frame and inset,
projected and drawn by OpenCV.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from vstestbed.camera import Camera, Perspective
from vstestbed.core.geometry import Array, inverse, transform
from vstestbed.core.lazy import cv2
from vstestbed.report.video.overlay import INK, PAPER, SHIFT, SMALL, UNIT, Color, overlay_of
from vstestbed.report.video.writer import Image
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.replay import FREE, Replay

if TYPE_CHECKING:
    from vstestbed.report.video.overlay import FilmFrame

__all__ = ["GOAL", "OWN", "Outside", "frustum_corners", "inset_share"]

GOAL: Color = (110, 255, 170)
OWN: Color = (255, 196, 64)
AXES: tuple[Color, ...] = ((255, 70, 70), (70, 225, 90), (90, 150, 255))
FRUSTUM = 0.055  # Length of a frustum over the picture's width, at its place
# Points of the trail of the camera: when there are more, every other one is dropped
MOST_PLACES = 400
AXIS = 0.045  # Length of an axis of the target's frame over the picture's width, at its place
INSET_S = 0.2  # Time between two pictures of the servo camera in the inset [s]
EDGE = 2  # Width of the edge of the inset [px]
DRAWN_FOR = 360
"""Height of a picture in which a plain line is a pixel wide [px]; in a lower one it is no thinner,
and has no dark edge (as `SMALL`).
"""
GHOST_FILL = 0.25
FOLDED = np.array([[i, j, 1.0] for i, j in ((-0.6, -0.6), (0.6, -0.6), (0.6, 0.6), (-0.6, 0.6))])
"""Corners of the pyramid that stands for the frustum of a lens that sees sideways."""
# The edges of a pyramid as two polylines through its corners, the last of which is its top
EDGES = ([0, 1, 2, 3, 0, 4, 1], [2, 4, 3])


class Outside:
    """Draws pictures (width, height) of a run from one outside camera; called with each frame in
    turn, since view and trail continue.
    """

    def __init__(self, scenario: Scenario, replay: Replay, camera: str, size: tuple[int, int]):
        self._replay, self._size = replay, size
        self._name, self._moving, self._has_frame = (
            camera,
            scenario.robot.base != "fixed",
            len(scenario.target.places) > 0,
        )
        self._held = 1.2 * scenario.target.points if scenario.target.on_gripper else None
        self._line = size[1] / DRAWN_FOR
        self._trail, self._spacing = np.zeros((0, 3)), 0.0
        self._corners = np.vstack([frustum_corners(scenario.camera), np.zeros(3)])
        self._scale = inset_share(scenario.camera, size)
        inset = (
            round(scenario.camera.width * self._scale),
            round(scenario.camera.height * self._scale),
        )
        self._inset_t, self._inset = (
            -np.inf,
            np.full((inset[1] + EDGE, inset[0] + EDGE, 3), PAPER, np.uint8),
        )
        self._overlay = overlay_of(scenario, inset)

    def picture(self, frame: FilmFrame, T_world_goal: Array | None) -> Image:
        """One picture (H, W, 3); T_world_goal: the servo camera's pose (4, 4) at its goal, if it
        has one.
        """
        T_target, T_camera = frame.T_world_target, frame.T_world_camera
        scene = self._replay.picture(self._name, self._size, frame.state, T_world_goal)
        pen = Pen(scene, *self._replay.sight(self._name), self._line)
        strokes: list[Stroke] = (
            [] if T_world_goal is None else self._goal(pen, T_world_goal, T_camera, T_target)
        )
        self._extend(pen, T_camera[:3, 3])
        strokes.append(([self._trail, *self._wire(pen, T_camera)], OWN, 1))
        if self._has_frame:
            length = pen.metres(AXIS, T_target[:3, 3])
            axes = T_target[:3, 3] + np.array([[0.0], [length]]) * T_target[:3, :3].T[:, None]
            strokes += [([axis], color, 2) for axis, color in zip(axes, AXES, strict=True)]
        pen.lines(strokes)
        return scene

    def _goal(
        self, pen: Pen, T_world_goal: Array, T_camera: Array, T_target: Array
    ) -> list[Stroke]:
        """The camera's frustum at its goal; the body there of a robot that moves is drawn, eye to
        hand the target where it has to go.
        """
        to_goal = T_world_goal @ inverse(T_camera)
        if self._held is not None:
            pen.area(transform(inverse(to_goal) @ T_target, self._held)[None], GOAL, GHOST_FILL)
            return []
        if self._moving:
            pen.area(transform(to_goal, self._replay.body()), GOAL, GHOST_FILL)
        return [(self._wire(pen, T_world_goal), GOAL, 1)]

    def put_inset(
        self, scene: Image, frame: FilmFrame, image: Image | None, render: Callable[[], Image]
    ) -> None:
        """The servo camera's image, renewed every INSET_S, in the upper right corner, in place;
        without `image` `render` is asked.
        """
        if frame.t >= self._inset_t + INSET_S - 1e-9:
            image = render() if image is None else image
            small = self._inset[:-EDGE, EDGE:]
            height, width = small.shape[:2]
            # of a large picture not every pixel counts, since their mean would take longer than the
            # rest
            every = max(1, image.shape[1] // (2 * width))
            sampled = image[every // 2 :: every, every // 2 :: every]
            # half the size takes a tenth of the time of any other share
            if sampled.shape[1] >= 2 * width:
                sampled = cv2.resize(
                    sampled,
                    (sampled.shape[1] // 2, sampled.shape[0] // 2),
                    interpolation=cv2.INTER_AREA,
                )
            small[:] = cv2.resize(sampled, (width, height), interpolation=cv2.INTER_LINEAR)
            self._overlay.marks(
                small,
                (frame.uv + 0.5) * self._scale - 0.5,
                (frame.goal_uv + 0.5) * self._scale - 0.5,
            )
            self._inset_t = frame.t
        height, width = self._inset.shape[:2]
        scene[:height, -width:] = self._inset

    def _wire(self, pen: Pen, T: Array) -> list[Array]:
        corners = transform(T, pen.metres(FRUSTUM, T[:3, 3]) * self._corners)
        return [corners[edges] for edges in EDGES]

    def _extend(self, pen: Pen, place: Array) -> None:
        trail = self._trail
        self._spacing = self._spacing or pen.metres(0.006, place)  # between two points
        if not len(trail) or np.linalg.norm(place - trail[-1]) >= self._spacing:
            trail = np.vstack([trail, place])
        if len(trail) > MOST_PLACES:
            trail, self._spacing = trail[::2], 2 * self._spacing
        self._trail = trail


# Polylines (N, 3) of points in the world, their colour, and their width in that of a pen
Stroke = tuple[list[Array], Color, int]


class Pen:
    """Draws lines and areas of the world on a picture, in place; stroke: width of a plain line
    [px], at least a pixel when drawn.
    """

    def __init__(self, image: Image, lens: Perspective, T_world_camera: Array, stroke: float):
        self.image, self._lens, self._T, self._stroke = image, lens, inverse(T_world_camera), stroke
        self._edge = 1 if image.shape[0] > SMALL else 0

    def pixels(self, points: Array) -> Array:
        """Pixels (..., 2) of points (..., 3) in the world; NaN behind the camera, or too far
        outside for OpenCV's integers.
        """
        uv = self._lens.project(transform(self._T, points))
        with np.errstate(invalid="ignore"):
            return np.where(
                (np.abs(uv) < 8 * self._lens.width).all(axis=-1, keepdims=True), uv, np.nan
            )

    def metres(self, share: float, place: Array) -> float:
        """What appears as long as a share of the picture's width, at a place (3,) [m]."""
        depth = max(float(self._T[2, :3] @ place + self._T[2, 3]), 1e-3)
        return share * self._lens.width * depth / self._lens.f

    def lines(self, strokes: list[Stroke]) -> None:
        """Polylines, each colour over a dark edge and over those before; points that cannot be
        drawn are left out.
        """
        # All at once: a call for each polyline would take longer than the drawing.
        uv = self.pixels(
            np.concatenate([line for polylines, _, _ in strokes for line in polylines])
        )
        seen = np.isfinite(uv[:, 0])
        grid = np.rint(np.where(seen[:, None], uv, 0.0) * UNIT).astype(np.int32)[:, None]
        first = 0
        for polylines, color, width in strokes:
            own = []
            for line in polylines:
                part = slice(first, first + len(line))
                own += [grid[part][seen[part]]] if np.count_nonzero(seen[part]) > 1 else []
                first += len(line)
            pixels = max(1, round(self._stroke * width))
            if self._edge:
                cv2.polylines(self.image, own, False, INK, pixels + self._edge, cv2.LINE_AA, SHIFT)
            cv2.polylines(self.image, own, False, color, pixels, cv2.LINE_AA, SHIFT)

    def area(self, hulls: Array, color: Color, fill: float) -> None:
        """The union of the convex hulls of points (G, P, 3): a translucent area with an outline."""
        uv = self.pixels(hulls)
        uv = uv[np.isfinite(uv).all(axis=(1, 2))]
        size = np.array(self.image.shape[1::-1])
        low, high = np.clip(
            [uv.min(axis=(0, 1), initial=8e3) - 2, uv.max(axis=(0, 1), initial=-8e3) + 3], 0, size
        ).astype(int)
        if not (low < high).all():
            return
        part = self.image[low[1] : high[1], low[0] : high[0]]
        mask = np.zeros(part.shape[:2], np.uint8)
        for points in np.rint((uv - low) * UNIT).astype(np.int32)[:, :, None]:
            cv2.fillConvexPoly(mask, cv2.convexHull(points), 255, cv2.LINE_8, SHIFT)
        cv2.copyTo(cv2.addWeighted(part, 1 - fill, np.full_like(part, color), fill, 0), mask, part)
        outline = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)[0]
        cv2.polylines(part, list(outline), True, color, max(1, round(self._stroke)), cv2.LINE_AA)


def inset_share(camera: Camera, size: tuple[int, int]) -> float:
    """Size of the inset in a picture of a size (width, height) as a share of the servo camera's
    image.
    """
    return min((1 - FREE) * size[0] / camera.width, 0.5 * size[1] / camera.height)


def frustum_corners(camera: Camera) -> Array:
    """Corners (4, 3) of the picture on the plane at distance 1, at most .6 to each side; of a lens
    that sees beyond it, a pyramid.
    """
    w, h = camera.width - 0.5, camera.height - 0.5
    rays = camera.ray(np.array([[-0.5, -0.5], [w, -0.5], [w, h], [-0.5, h]]))
    with np.errstate(invalid="ignore"):
        if not (rays[:, 2] > 0.2).all():
            return FOLDED
    corners = rays / rays[:, 2:]
    return corners * min(1.0, 0.6 / float(np.abs(corners[:, :2]).max()))
