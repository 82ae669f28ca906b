"""Surfaces that are hard to match: large letters, one object again and again, faint contrast, fine
print, and a table full of things.
"""

from __future__ import annotations

import cv2
import numpy as np

from drawing import leaves
from drawing.canvas import Image, blend, disc, letters, noise, polygon, relief, rgb
from drawing.page import WORDS

HEIGHT, WIDTH = 768, 1024
SIGNS = "ABCDEFGHJKLMNPRSTUVWXYZ23456789"
COLOURS = ("c23b2e", "2e6fc2", "2f8f5b", "d9a928", "6d4aa8", "23303f", "e7dfd0", "b8633a")


def alphabet(rng: np.random.Generator) -> Image:
    """Letters and digits of many sizes (768, 1024, 3), in rows, on paper:
    each of them comes again.
    """
    image = np.broadcast_to(rgb("f2ede0"), (HEIGHT, WIDTH, 3)).copy()
    base = 20.0
    while base < HEIGHT + 40:
        size = float(rng.uniform(22, 64))
        base += 1.25 * size
        x = float(rng.uniform(-20, 10))
        while x < WIDTH:
            x = (
                letters(
                    image,
                    str(rng.choice(list(SIGNS))),
                    x,
                    base,
                    size,
                    rgb(str(rng.choice(COLOURS[:6]))),
                    0.12,
                )
                + 0.25 * size
            )
    return np.clip(image, 0, 1)


def objects(rng: np.random.Generator) -> Image:
    """The same screw nut some 110 times (768, 1024, 3), each at its own place and angle, on brushed
    steel.
    """
    image = np.broadcast_to(rgb("8d939b"), (HEIGHT, WIDTH, 3)).copy()
    image *= (1 + 0.05 * noise(rng, 1, WIDTH, 60, 2)[..., None]) * (
        1 + 0.01 * noise(rng, HEIGHT, WIDTH, 3, 1)[..., None]
    )
    side = 64
    hexagon = np.stack([np.cos(k := np.arange(6) * np.pi / 3), np.sin(k)], axis=1)
    for v in np.arange(36, HEIGHT, 84.0):
        for u in np.arange(40, WIDTH, 84.0):
            a, x, y = rng.uniform(0, 2 * np.pi), u + rng.uniform(-9, 9), v + rng.uniform(-9, 9)
            turn = np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
            blend(image, rgb("4a4f57"), 0.5 * disc(HEIGHT, WIDTH, (x + 4, y + 5), side / 2, 9))
            blend(image, rgb("c9b05a"), polygon(HEIGHT, WIDTH, hexagon @ turn * side / 2 + (x, y)))
            blend(
                image, rgb("e6d48c"), polygon(HEIGHT, WIDTH, hexagon @ turn * side / 2.5 + (x, y))
            )
            blend(image, rgb("3b3b3f"), disc(HEIGHT, WIDTH, (x, y), side / 4.6, 1.5))
            letters(image, "8", x + 20 * np.cos(a) - 4, y + 20 * np.sin(a) + 4, 8, rgb("6b5a20"))
    return np.clip(image, 0, 1)


def faint(rng: np.random.Generator) -> Image:
    """The leaves at a sixth of their contrast (768, 1024, 3), as under fog: SIFT finds some 30
    points in a picture of it.
    """
    image = np.asarray(
        cv2.resize(leaves.draw(rng), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA), np.float32
    )
    return np.clip(0.55 + (image - image.mean()) / 6, 0, 1)


def small_print(rng: np.random.Generator) -> Image:
    """Words in capitals of 6 px (768, 1024, 3), line after line, as on the back of a contract: one
    word is like another.
    """
    image = np.broadcast_to(rgb("f4f2ec"), (HEIGHT, WIDTH, 3)).copy()
    for base in np.arange(14.0, HEIGHT, 13.0):
        x = 10.0
        while x < WIDTH - 30:
            x = letters(image, str(rng.choice(WORDS)), x, float(base), 6, rgb("2b2a28"), 0.09) + 5
    return np.clip(image, 0, 1)


def clutter(rng: np.random.Generator) -> Image:
    """A table full of things (768, 1024, 3): sheets, lids, sticks and labels on top of one another,
    with shadows.
    """
    image = np.broadcast_to(rgb("a98458"), (HEIGHT, WIDTH, 3)).copy()
    image *= (1 + 0.07 * noise(rng, HEIGHT, 1, 40, 2)[..., None]) * (
        1 + 0.02 * noise(rng, HEIGHT, WIDTH, 8, 1)[..., None]
    )
    for _ in range(230):
        centre, size = rng.uniform((0, 0), (WIDTH, HEIGHT)), float(rng.uniform(14, 70))
        a, long = rng.uniform(0, 2 * np.pi), rng.uniform(0.15, 1)
        turn = np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
        corners = (
            np.array([[-1, -long], [1, -long], [1, long], [-1, long]]) @ turn * size
        ) + centre
        round_one = rng.random() < 0.4
        shape = (
            disc(HEIGHT, WIDTH, (float(centre[0]), float(centre[1])), size / 1.6)
            if round_one
            else polygon(HEIGHT, WIDTH, corners)
        )
        shadow = np.roll(np.asarray(cv2.GaussianBlur(shape, (0, 0), 5)), (6, 5), axis=(0, 1))
        blend(image, rgb("20180f"), 0.45 * shadow * (1 - shape))
        grain = noise(rng, HEIGHT // 4, WIDTH // 4, 30, 1, 0.7)
        height = np.asarray(cv2.resize(grain, (WIDTH, HEIGHT)), np.float32)
        colour = (
            rgb(str(rng.choice(COLOURS)))
            * (1 + 0.12 * height[..., None])
            * relief(height * 2, 0.4)[..., None]
        )
        blend(image, colour.astype(np.float32), shape)
        if rng.random() < 0.4:
            letters(
                image,
                str(rng.choice(WORDS)),
                float(centre[0]) - size / 2,
                float(centre[1]) + 5,
                size / 4,
                rgb("1d1d1f"),
            )
    return np.clip(image, 0, 1)
