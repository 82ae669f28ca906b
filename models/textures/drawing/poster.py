"""The poster: a collage of pictures with a title, small print and a code, with structure at all
scales.
"""

from __future__ import annotations

import numpy as np

from drawing.canvas import PLAIN, Image, blend, letters, noise, polygon, rgb, width_of
from drawing.photographs import bay, flower, pebbles, plan, town

HEIGHT, WIDTH = 1200, 1600
PAPER, INK, RED = "efe7d6", "1d2a3a", "c4452f"
SMALL = (
    (
        "A journey of nine days by boat, by train and on foot,"
        " from the quay below the old town to the huts under the glacier."
    ),
    (
        "Boats leave at 7.30, 9.15, 11.40 and 16.05 from pier 4;"
        " the last one back calls at the lighthouse when the sea is calm."
    ),
    (
        "Bring boots, a coat against the wind, and bread for two days. Dogs travel free. Bicycles:"
        " 3.50 a day, helmets included."
    ),
)
DAYS = (
    ("1", "Quay, old town"),
    ("2", "Lighthouse"),
    ("4", "Pebble beach"),
    ("6", "Gardens"),
    ("9", "Glacier huts"),
)


def draw(rng: np.random.Generator) -> Image:
    """The poster (1200, 1600, 3)."""
    image = np.broadcast_to(rgb(PAPER), (HEIGHT, WIDTH, 3)).copy()
    image *= (1 + 0.012 * noise(rng, HEIGHT, WIDTH, 300, 2, 0.7))[..., None]
    _framed(image, bay(rng, 720, 1040), 40, 200)
    for made, left, top in ((town, 1112, 40), (flower, 1112, 332), (pebbles, 1112, 624)):
        _framed(image, made(rng, 264, 448), left, top)
    _framed(image, plan(rng, 240, 448), 1112, 916)
    _title(image)
    _foot(rng, image)
    _stamp(image, 930, 312, 92)
    return np.clip(image, 0, 1)


def _framed(image: Image, picture: Image, left: int, top: int) -> None:
    """A picture with a white border and a soft shadow."""
    height, width = picture.shape[:2]
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    out = np.hypot(
        np.clip(np.maximum(left - u, u - left - width), 0, None),
        np.clip(np.maximum(top + 6 - v, v - top - height - 6), 0, None),
    )
    image *= (1 - 0.4 * np.exp(-out / 7))[..., None]
    image[top - 6 : top + height + 6, left - 6 : left + width + 6] = rgb("fbf8f1")
    image[top : top + height, left : left + width] = np.clip(picture, 0, 1)


def _title(image: Image) -> None:
    blend(image[28:176, 34:1086], rgb(INK), 1.0)
    blend(image[160:168, 34:1086], rgb(RED), 1.0)
    end = letters(image, "NORTH BAY", 62, 128, 74, rgb("f6ecd2"), 0.15)
    letters(image, "9 days", end + 34, 88, 34, rgb("f0b45a"), 0.12)
    letters(image, "from sea to summit", end + 36, 128, 17, rgb("f6ecd2"), 0.1, PLAIN)


def _foot(rng: np.random.Generator, image: Image) -> None:
    """Stops of the journey, small print, a code, a scale of greys."""
    for i, (day, name) in enumerate(DAYS):
        x = 66 + 206 * i
        y = 978
        blend(image[y - 3 : y + 3, x : min(x + 206, 1060)], rgb(INK), 1.0 if i < 4 else 0.0)
        angle = np.linspace(0, 2 * np.pi, 41)[:-1]
        around = np.column_stack([np.cos(angle), np.sin(angle)])
        box = image[y - 30 : y + 30, x - 30 : x + 30]
        blend(box, rgb(INK), polygon(60, 60, around * 26 + 29.5))
        blend(box, rgb(RED if i % 2 else "2f7f86"), polygon(60, 60, around * 20 + 29.5))
        letters(image, day, x - width_of(day, 18) / 2, y + 9, 18, rgb("ffffff"), 0.16)
        letters(image, name, x - 24, y + 54, 13, rgb(INK), 0.1, PLAIN)
    for i, line in enumerate(SMALL):
        letters(image, line, 44, 1076 + 25 * i, 9, rgb(INK), 0.1, PLAIN)
    for i in range(12):
        blend(
            image[1152:1178, 44 + 34 * i : 76 + 34 * i],
            np.float32(i / 11) * np.ones(3, np.float32),
            1.0,
        )
    x = 480.0
    while x < 720:
        wide = int(rng.integers(1, 5)) * 2
        blend(image[1146:1182, int(x) : int(x) + wide], rgb("111111"), 1.0)
        x += wide + int(rng.integers(1, 4)) * 2
    letters(image, "4 018 7730 1296", 740, 1178, 12, rgb(INK), 0.1, PLAIN)
    cells = np.kron(rng.integers(0, 2, (17, 17)), np.ones((6, 6))).astype(np.float32)
    blend(image[1078:1180, 966:1068], rgb("ffffff"), 1.0)
    blend(image[1078:1180, 966:1068], rgb("111111"), cells)


def _stamp(image: Image, u: int, v: int, radius: int) -> None:
    """A star with a price, glued over the large picture."""
    angle = np.arange(48) * np.pi / 24
    size = np.where(np.arange(48) % 2, 0.88, 1.0) * radius
    star = np.column_stack([np.cos(angle), np.sin(angle)]) * size[:, None] + radius + 4
    box = image[v - radius - 4 : v + radius + 4, u - radius - 4 : u + radius + 4]
    blend(box, rgb("000000"), 0.35 * polygon(*box.shape[:2], star + [3, 5]))
    blend(box, rgb("f4c430"), polygon(*box.shape[:2], star))
    letters(image, "from", u - 36, v - 30, 17, rgb(INK), 0.12)
    letters(image, "240", u - 58, v + 32, 46, rgb(RED), 0.17)
    letters(image, "a person", u - 46, v + 58, 12, rgb(INK), 0.12, PLAIN)
