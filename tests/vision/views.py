"""Pictures of a poster under known homographies."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Perspective
from vstestbed.core.geometry import Array, rotation_from_rpy
from vstestbed.core.named_files import folder

WIDTH, HEIGHT, FINER = 320, 240, 3
FOVY_DEG = 51.1
CAMERA = Perspective(width=WIDTH, height=HEIGHT, fovy_deg=FOVY_DEG)
POSTER_M = 0.8


@lru_cache
def poster() -> NDArray[np.uint8]:
    """The bundled poster, 1000 px wide, RGB."""
    image = cv2.imread(str(folder("models") / "textures" / "poster.jpg"))
    assert image is not None
    return np.asarray(
        cv2.cvtColor(
            cv2.resize(image, (1000, 750), interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2RGB
        ),
        np.uint8,
    )


def homography_of(xyz: tuple[float, float, float], rpy_deg: tuple[float, float, float]) -> Array:
    """From the poster's pixels to a picture's, of a camera at xyz [m] with the poster about the
    origin in z = 0.
    """
    h, w = poster().shape[:2]
    scale = POSTER_M / w
    place = np.array(
        [[scale, 0, -scale * (w - 1) / 2], [0, scale, -scale * (h - 1) / 2], [0, 0, 0]]
    )
    place[:, 2] -= xyz
    R = rotation_from_rpy(np.radians(rpy_deg))
    middle, f = CAMERA.centre, (HEIGHT / 2) / np.tan(np.radians(FOVY_DEG / 2))
    return np.array([[f, 0, middle[0]], [0, f, middle[1]], [0, 0, 1]]) @ R.T @ place


def picture_by(H: Array, sigma: float = 0.0) -> NDArray[np.uint8]:
    """The picture (240, 320, 3) under a homography, averaged over 3 x 3 places a pixel, with grey
    noise.
    """
    finer = np.array([[FINER, 0, (FINER - 1) / 2], [0, FINER, (FINER - 1) / 2], [0, 0, 1]])
    big = cv2.warpPerspective(
        poster(), finer @ H, (FINER * WIDTH, FINER * HEIGHT), borderValue=(110, 110, 110)
    )
    small = cv2.resize(big, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(float)
    return np.clip(
        np.rint(small + np.random.default_rng(0).normal(0, sigma, small.shape)), 0, 255
    ).astype(np.uint8)


GOAL_H = homography_of((0, 0, -0.61), (0, 0, 0))


@lru_cache
def goal() -> NDArray[np.uint8]:
    """The picture from straight in front."""
    return picture_by(GOAL_H)


def places(H: Array, uv_goal: Array) -> Array:
    """Where points uv_goal (N, 2) of the goal's picture are in the picture under H."""
    mapped = np.column_stack([uv_goal, np.ones(len(uv_goal))]) @ (H @ np.linalg.inv(GOAL_H)).T
    return mapped[:, :2] / mapped[:, 2:]
