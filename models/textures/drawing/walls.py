"""Surfaces of a building: bricks, tiles that repeat themselves, and plaster that is nearly flat."""

from __future__ import annotations

import cv2
import numpy as np

from drawing.canvas import Image, blend, noise, polygon, ramp, relief, rgb

HEIGHT, WIDTH = 768, 1024


def brick(rng: np.random.Generator) -> Image:
    """Bricks in stretcher bond (768, 1024, 3), 8 in a course and 18 courses: clay with pores and
    burnt heads, in rough mortar.
    """
    high, wide, joint = HEIGHT / 18, WIDTH / 8, 6.0
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    v, u = (
        v + 0.8 * noise(rng, HEIGHT, WIDTH, 120, 20),
        u + 0.8 * noise(rng, HEIGHT, WIDTH, 120, 20),
    )
    course = np.clip(np.floor(v / high), 0, 17).astype(int)
    shifted = u + wide / 2 * (course % 2)
    number = np.floor(shifted / wide).astype(int) % 9
    a, b = shifted % wide, v % high
    chipped = joint / 2 + 1.2 * np.abs(noise(rng, HEIGHT, WIDTH, 14, 2))
    inside = (
        np.clip(np.minimum(np.minimum(a, wide - a), np.minimum(b, high - b)) - chipped, 0, 5) / 5
    )
    tones = np.array([rgb(c) for c in ("9c4a36", "b0593f", "8a3f31", "a8674c", "74382f", "bd7350")])
    own = tones[rng.integers(0, 6, (18, 9))] * rng.uniform(0.82, 1.12, (18, 9, 1)).astype(
        np.float32
    )
    burnt = rng.random((18, 9)) < 0.12
    own[burnt] *= 0.6
    clay = noise(rng, HEIGHT, WIDTH, 24, 1.5, 0.75)
    colour = own[course, number] * (1 + 0.1 * clay[..., None])
    mortar = rgb("b8ac9a") * (0.92 + 0.09 * noise(rng, HEIGHT, WIDTH, 6, 1, 0.8)[..., None])
    image = mortar.astype(np.float32)
    blend(image, colour.astype(np.float32), np.clip(inside * 3, 0, 1))
    height = 9 * inside + 0.5 * clay + 0.6 * noise(rng, HEIGHT, WIDTH, 4, 1)
    dirt = 1 - 0.13 * np.clip(noise(rng, HEIGHT, WIDTH, 260, 12, 0.6), -1, 2)
    return np.clip(
        image
        * (0.35 + 0.65 * relief(height.astype(np.float32), 0.55))[..., None]
        * dirt[..., None],
        0,
        1,
    )


def repetitive(rng: np.random.Generator) -> Image:
    """Glazed tiles (768, 1024, 3), 16 x 12, all of them the same pixel by pixel, so that no part of
    the picture tells its place.
    """
    side = WIDTH // 16
    big = 4 * side
    tile = np.broadcast_to(rgb("e9e4d4"), (big, big, 3)).copy()
    middle, corners = (
        (big - 1) / 2,
        np.array(
            [
                [0, -1],
                [0.28, -0.28],
                [1, 0],
                [0.28, 0.28],
                [0, 1],
                [-0.28, 0.28],
                [-1, 0],
                [-0.28, -0.28],
            ]
        ),
    )
    blend(tile, rgb("23406b"), polygon(big, big, corners * big * 0.46 + middle))
    blend(
        tile,
        rgb("d8a23c"),
        polygon(
            big,
            big,
            corners * big * 0.26 @ np.array([[0.7071, 0.7071], [-0.7071, 0.7071]]) + middle,
        ),
    )
    v, u = np.mgrid[:big, :big].astype(np.float32)
    for x, y in ((0, 0), (0, big), (big, 0), (big, big)):
        far = np.hypot(u - x, v - y) / big
        blend(tile, rgb("a8432e"), np.clip((0.3 - far) * 80, 0, 1))
        blend(tile, rgb("e9e4d4"), np.clip((0.2 - far) * 80, 0, 1))
        blend(tile, rgb("2f6f5e"), np.clip((0.13 - far) * 80, 0, 1))
    edge = np.minimum(np.minimum(u, big - 1 - u), np.minimum(v, big - 1 - v)) / 4
    tile *= (1 + 0.02 * noise(rng, big, big, 40, 8))[..., None]
    blend(tile, rgb("8d877a"), np.clip(1.6 - edge, 0, 1))
    side_lit = np.where(u + v < big, 1, -1)
    tile *= (1 + 0.12 * np.clip(1 - np.abs(edge - 3) / 2, 0, 1) * side_lit)[..., None]
    small = np.asarray(cv2.resize(tile, (side, side), interpolation=cv2.INTER_AREA), np.float32)
    return np.clip(np.tile(small, (12, 16, 1)), 0, 1)


def flat(rng: np.random.Generator) -> Image:
    """Plaster (768, 1024, 3): slow gradients of some 20 grey levels, and no more than 1 or 2 of
    trowel marks.
    """
    slow = noise(rng, HEIGHT, WIDTH, 600, 150)
    marks = np.asarray(cv2.GaussianBlur(noise(rng, HEIGHT, WIDTH, 60, 6, 0.6), (0, 0), 3))
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    bright = 0.02 * slow + 0.004 * marks + 0.05 * (u / WIDTH - 0.5) - 0.03 * (v / HEIGHT - 0.5)
    return np.clip(ramp([(-0.5, "3f3e3a"), (0, "b9b5aa"), (0.5, "ffffff")], bright), 0, 1)
