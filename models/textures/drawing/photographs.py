"""The poster's pictures, shaded like photographs: a bay in the mountains, a town at night, a
flower, pebbles, a map.
"""

from __future__ import annotations

import cv2
import numpy as np

from drawing.canvas import Image, blend, disc, noise, polygon, ramp, relief, rgb


def bay(rng: np.random.Generator, height: int, width: int) -> Image:
    """Mountains behind a bay in the evening, with clouds, woods, boats and their reflections."""
    shore = round(0.64 * height)
    image = np.empty((height, width, 3), np.float32)
    image[:shore] = _sky(rng, shore, width)
    for i, (top, rough, near, far) in enumerate(
        [
            (0.42, 0.17, "8d94ad", "b9b7c4"),
            (0.52, 0.15, "5f6c86", "8b94a8"),
            (0.66, 0.11, "3d5154", "6c7f78"),
            (0.82, 0.07, "24372f", "3f5545"),
        ]
    ):
        _ridge(rng, image[:shore], top * shore, rough * shore, near, far, snow=i < 2)
    _woods(rng, image[:shore], shore)
    image[shore:] = _water(rng, image[:shore], height - shore)
    for x, y, size in (
        (0.2, 0.74, 0.1),
        (0.47, 0.70, 0.06),
        (0.69, 0.83, 0.17),
        (0.86, 0.71, 0.05),
    ):
        _boat(image, x * width, y * height, size * height)
    return image * (1 + 0.012 * noise(rng, height, width, 2, 1)[..., None])


def _sky(rng: np.random.Generator, height: int, width: int) -> Image:
    down = np.linspace(0, 1, height, dtype=np.float32)[:, None].repeat(width, 1)
    sky = ramp([(0, "2f5f9e"), (0.45, "86aed1"), (0.75, "f3c98b"), (1, "f7dfb4")], down)
    sun = (0.72 * width, 0.42 * height)
    v, u = np.mgrid[:height, :width].astype(np.float32)
    far = np.hypot(u - sun[0], v - sun[1])
    blend(sky, rgb("fff3cf"), 0.8 * np.exp(-((far / (0.22 * height)) ** 2)))
    cloud = np.asarray(
        cv2.resize(
            noise(rng, height, width // 3, 70, 2, 0.62),
            (width, height),
            interpolation=cv2.INTER_LINEAR,
        )
    )
    thick = np.clip((cloud - 0.1) * 0.75, 0, 1) * np.clip(1.35 - 1.2 * down, 0, 1)
    light = ramp([(0.4, "9c98a8"), (1.15, "fff4e4")], relief(cloud * 9, 0.9, 300))
    blend(sky, light, 0.92 * thick)
    blend(sky, rgb("fffbe8"), disc(height, width, sun, 0.035 * height, 2))
    return sky


def _ridge(
    rng: np.random.Generator,
    image: Image,
    top: float,
    rough: float,
    near: str,
    far: str,
    snow: bool,
) -> None:
    """A range of mountains in place, its crest about `top`, with slopes and gullies lit from the
    right.
    """
    height, width = image.shape[:2]
    crest = top + rough * noise(rng, 1, width, width / 5, 3, 0.52)[0] * 0.6
    v = np.arange(height, dtype=np.float32)[:, None]
    cover = np.clip(v - crest + 0.5, 0, 1)
    below = np.clip((v - crest) / (height - top), 0, 1)
    rock = noise(rng, height, width, 90, 2, 0.6)
    shade = relief(rock * 7 + 0.5 * noise(rng, height, width, 40, 2, 0.7) * 5, 0.9, 340)
    colour = ramp([(0, near), (1, far)], below) * (0.45 + 0.55 * shade[..., None])
    if snow:
        white = np.clip(2.2 - 9 * below + 0.9 * rock, 0, 1) * cover
        blend(colour, rgb("eef1f6") * (0.55 + 0.45 * shade[..., None]), white)
    blend(image, np.clip(colour, 0, 1), cover)


def _woods(rng: np.random.Generator, image: Image, shore: int) -> None:
    """Fir trees along the shore, the nearer the larger and the darker."""
    height, width = image.shape[:2]
    for row, (size, dark) in enumerate(((0.07, 0.32), (0.11, 0.24), (0.16, 0.16))):
        for _ in range(120 - 30 * row):
            x, tall = rng.uniform(0, width), height * size * rng.uniform(0.6, 1.25)
            if row == 2 and 0.28 * width < x < 0.8 * width:  # the view of the water stays open
                continue
            tone = rgb("6f9a72") * np.float32(dark * rng.uniform(1.0, 2.0))
            for k in range(6):  # tiers of branches
                y, half = shore - tall * (1 - k / 6.5), tall * (0.03 + 0.036 * k)
                corners = np.array(
                    [[x, y - tall * 0.09], [x + half, y + tall * 0.16], [x - half, y + tall * 0.16]]
                )
                _paint(image, corners, tone * (0.8 + 0.14 * k))
                _paint(
                    image,
                    np.array([corners[0], corners[1], [x, y + tall * 0.13]]),
                    tone * (1.25 + 0.14 * k),
                )


def _paint(image: Image, corners: np.ndarray, colour: Image) -> None:
    """A polygon with corners (N, 2) [px] in place."""
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 1, 0)
    high = np.minimum(
        np.ceil(corners.max(axis=0)).astype(int) + 2, [image.shape[1], image.shape[0]]
    )
    if (high > low).all():
        part = image[low[1] : high[1], low[0] : high[0]]
        blend(part, np.clip(colour, 0, 1), polygon(*part.shape[:2], corners - low))


def _water(rng: np.random.Generator, above: Image, height: int) -> Image:
    """The reflection of what is above, in waves that grow towards the viewer."""
    width = above.shape[1]
    down = np.arange(height, dtype=np.float32)[:, None]
    grow = (0.04 + down / height) ** 1.2
    waves = np.asarray(
        cv2.resize(
            noise(rng, height, width // 6, 34, 1.5, 0.72),
            (width, height),
            interpolation=cv2.INTER_CUBIC,
        )
    )
    u = np.arange(width, dtype=np.float32)[None] + 10 * grow * waves
    v = above.shape[0] - 1 - down * 1.25 + 34 * grow * waves
    mirrored = np.asarray(
        cv2.remap(above, u, np.clip(v, 0, None), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT),
        np.float32,
    )
    depth = ramp([(0, "5f8294"), (1, "16364a")], (down / height).repeat(width, 1))
    blend(mirrored, depth, 0.28 + 0.3 * (down / height).repeat(width, 1))
    glitter = np.clip(waves - 1.1, 0, 1) * np.exp(
        -(((np.arange(width) / width - 0.72) / 0.12) ** 2)
    ).astype(np.float32)
    blend(mirrored, rgb("fff0cc"), 0.9 * np.clip(glitter, 0, 1))
    return mirrored * (1 + 0.08 * np.clip(waves, -2, 2)[..., None])


def _boat(image: Image, x: float, y: float, size: float) -> None:
    """A sailing boat and its reflection."""
    shape = {
        "main": ("f6efe2", [[0.02, -1.0], [0.02, -0.12], [0.42, -0.12]]),
        "jib": ("d9583f", [[-0.02, -0.92], [-0.02, -0.14], [-0.3, -0.14]]),
        "hull": ("3a2a26", [[-0.42, -0.08], [0.5, -0.08], [0.36, 0.05], [-0.3, 0.05]]),
        "mast": ("2a211e", [[-0.012, -1.03], [0.012, -1.03], [0.012, -0.05], [-0.012, -0.05]]),
        "stripe": ("efe6d6", [[-0.41, -0.05], [0.48, -0.05], [0.46, -0.025], [-0.39, -0.025]]),
    }
    for flip, share in ((-0.62, 0.45), (1.0, 1.0)):
        for tone, corners in shape.values():
            at = np.array(corners) * [1, flip] * size + [x, y + (0.05 - 0.05 * flip) * size]
            low, high = (
                np.floor(at.min(axis=0)).astype(int) - 1,
                np.ceil(at.max(axis=0)).astype(int) + 2,
            )
            low, high = np.maximum(low, 0), np.minimum(high, [image.shape[1], image.shape[0]])
            part = image[low[1] : high[1], low[0] : high[0]]
            if part.size:
                blend(part, rgb(tone), share * polygon(*part.shape[:2], at - low))


def town(rng: np.random.Generator, height: int, width: int) -> Image:
    """A town at night: towers in three rows, with lit windows, over a river."""
    bank = round(0.78 * height)
    down = np.linspace(0, 1, bank, dtype=np.float32)[:, None].repeat(width, 1)
    image = np.zeros((height, width, 3), np.float32)
    image[:bank] = ramp([(0, "0c1430"), (0.6, "3b3565"), (1, "c9705c")], down)
    for _ in range(60):
        u, v = rng.integers(width), rng.integers(bank // 2)
        image[v, u] = rng.uniform(0.5, 1)
    for row, (top, tone) in enumerate(((0.35, "4b4470"), (0.5, "2c2c50"), (0.66, "151a33"))):
        x = -10.0
        while x < width:
            wide, high = rng.uniform(0.045, 0.11) * width, bank * (top + rng.uniform(-0.18, 0.2))
            _tower(
                rng,
                image[:bank],
                (int(max(x, 0)), int(high)),
                int(min(x + wide, width)),
                rgb(tone),
                3 + row,
            )
            x += wide * rng.uniform(0.9, 1.3)
    mirrored = image[:bank][::-1][: height - bank]
    shift = (3 * noise(rng, height - bank, 1, 6, 1.5)[:, 0]).astype(int)
    image[bank:] = [
        0.62 * cv2.blur(np.roll(row, s, 0)[None], (9, 1))[0]
        for row, s in zip(mirrored, shift, strict=True)
    ]
    return image


def _tower(
    rng: np.random.Generator,
    image: Image,
    corner: tuple[int, int],
    right: int,
    tone: Image,
    pitch: int,
) -> None:
    left, top = corner
    bottom = image.shape[0]
    if right - left < 4 or bottom - top < 4:
        return
    shade = np.linspace(1.25, 0.8, right - left, dtype=np.float32)[None, :, None]
    image[top:, left:right] = tone * shade
    gap = pitch + 3
    for v in range(top + 4, bottom - gap, gap):
        for u in range(left + 3, right - gap, gap):
            if rng.random() < 0.5:
                image[v : v + pitch, u : u + pitch - 1] = rgb(
                    "ffd98a" if rng.random() < 0.75 else "cfe6ff"
                ) * np.float32(rng.uniform(0.55, 1))


def flower(rng: np.random.Generator, height: int, width: int) -> Image:
    """A dahlia from above: rings of petals with veins, before blurred leaves."""
    leaves = noise(rng, height, width, 60, 8, 0.5)
    image = ramp([(-2, "12261a"), (0, "2f5a37"), (2, "83ab60")], leaves)
    v, u = np.mgrid[:height, :width].astype(np.float32)
    x, y = u - 0.52 * width, v - 0.5 * height
    radius, angle = np.hypot(x, y) / (0.47 * min(height, width)), np.arctan2(y, x)
    for ring in range(9):
        reach, n = 1 - 0.1 * ring, 20 - ring
        phase = angle * n / (2 * np.pi) + 0.5 * ring + 0.08 * ring
        petal = np.abs(phase - np.floor(phase) - 0.5) * 2  # 0 at its middle, 1 between two
        edge = reach * (1 - 0.22 * petal**2.4)
        inside = np.clip((edge - radius) * 60, 0, 1)
        along = np.clip(radius / reach, 0, 1)
        vein = 0.06 * np.cos(petal * 22) * along
        tone = ramp(
            [(0, "5a0f2e"), (0.55, "b92b58"), (1, "f7b9a9")], along - 0.35 * petal**3 + vein
        )
        shadow = np.exp(-np.clip(radius - edge, 0, None) * 22) * (radius > edge)
        image *= (1 - 0.55 * shadow)[..., None]
        blend(image, tone, inside.astype(np.float32))
    heart = disc(height, width, (0.52 * width, 0.5 * height), 0.045 * min(height, width), 3)
    blend(image, ramp([(-2, "7a4a10"), (2, "ffe08a")], noise(rng, height, width, 5, 1)), heart)
    return image


def pebbles(rng: np.random.Generator, height: int, width: int) -> Image:
    """Wet pebbles, each with its own grain and colour, lit from above left."""
    seeds = rng.uniform(0, 1, (150, 2)) * [width, height]
    v, u = np.mgrid[:height, :width].astype(np.float32)
    u, v = u + 5 * noise(rng, height, width, 40, 8), v + 5 * noise(rng, height, width, 40, 8)
    far = np.full((2, height, width), np.inf, np.float32)
    owner = np.zeros((height, width), int)
    for i, (a, b) in enumerate(seeds.astype(np.float32)):
        d = np.hypot(u - a, v - b)
        nearer = d < far[0]
        far[1] = np.where(nearer, far[0], np.minimum(far[1], d))
        far[0], owner = np.where(nearer, d, far[0]), np.where(nearer, i, owner)
    gap = far[1] - far[0]
    dome = np.sqrt(np.clip(gap / 26, 0, 1)) * 16
    tones = np.array(
        [rgb(c) for c in ("8c8378", "b9ab98", "5d6166", "a98a72", "d8d0c2", "6f7f86", "93614f")]
    )[rng.integers(0, 7, len(seeds))]
    grain = noise(rng, height, width, 12, 1.5, 0.7)
    bright = relief(cv2.GaussianBlur(dome, (0, 0), 1.5) + 0.3 * grain, 1.3, 225) * (
        0.85 + 0.1 * grain
    )
    image = tones[owner] * bright[..., None]
    blend(image, rgb("14110f"), np.clip(1 - gap / 5, 0, 1) * 0.85)
    return np.clip(image, 0, 1).astype(np.float32)


def plan(rng: np.random.Generator, height: int, width: int) -> Image:
    """A map of a town: blocks of houses, streets, a river, a railway, a park."""
    image = np.broadcast_to(rgb("f1ead8"), (height, width, 3)).copy()
    turn = np.radians(17)
    v, u = np.mgrid[:height, :width].astype(np.float32)
    a, b = u * np.cos(turn) + v * np.sin(turn), -u * np.sin(turn) + v * np.cos(turn)
    a, b = a + 3 * np.sin(b / 40), b + 4 * np.sin(a / 55)
    cell = np.floor(a / 26).astype(int), np.floor(b / 19).astype(int)
    tones = np.array([rgb(c) for c in ("d9b48f", "c98f6d", "e3c9a3", "bfae97", "d7a58a", "efe0bf")])
    block = tones[(cell[0] * 7 + cell[1] * 13 + (cell[0] * cell[1]) % 5) % 6]
    inner = np.minimum(np.minimum(a % 26, 26 - a % 26), np.minimum(b % 19, 19 - b % 19))
    blend(image, block, np.clip(inner - 2.6, 0, 1))
    blend(image, rgb("8a6f57"), np.clip(1.3 - np.abs(inner - 3.2), 0, 1) * 0.6)
    river = np.abs(v - 0.62 * height - 0.14 * height * np.sin(u / (0.16 * width)))
    blend(image, rgb("7fb0cf"), np.clip(0.085 * height - river, 0, 1))
    blend(image, rgb("3d6f93"), np.clip(1.5 - np.abs(river - 0.085 * height), 0, 1))
    park = np.clip(
        (0.17 * height - np.hypot(u - 0.76 * width, 0.8 * (v - 0.25 * height))) / 1.5, 0, 1
    )
    blend(image, ramp([(-2, "6f9d5c"), (2, "b4d18f")], noise(rng, height, width, 9, 2)), park)
    rail = np.abs(u * 0.35 + v - 0.46 * height)
    blend(image, rgb("333333"), np.clip(2.6 - rail, 0, 1))
    blend(image, rgb("ffffff"), np.clip(1.4 - rail, 0, 1) * ((u // 7) % 2))
    return image
