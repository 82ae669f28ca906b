"""A printed page of text in two columns, in OpenCV's stroke letters."""

from __future__ import annotations

import numpy as np

from drawing.canvas import FONT, Image, blend, letters, noise, rgb, width_of

HEIGHT, WIDTH = 1200, 900
MARGIN, GUTTER, SIZE, LEADING = 60, 36, 11.0, 25
INK = "22201e"
TEXT = """
the of and in a to is that which with by for as on are from at this it be one has not or its where
each all two image camera point line motion robot error velocity frame feature depth plane axis
angle light surface matrix gain goal view sensor lens pixel picture marker measure follow estimate
converge rotate translate observe control align move turn reach compute project match track mean
small large same other first last between near far left right under over through without before
after while time distance place order noise number
"""
WORDS = TEXT.split()


def draw(rng: np.random.Generator) -> Image:
    """The page (1200, 900, 3), upright."""
    image = np.broadcast_to(rgb("f3f0e8"), (HEIGHT, WIDTH, 3)).copy()
    image *= (1 + 0.008 * noise(rng, HEIGHT, WIDTH, 200, 2, 0.75))[..., None]
    letters(image, "On seeing where one goes", MARGIN, 98, 30, rgb(INK), 0.11)
    letters(image, "Notes for a workshop, part 3", MARGIN, 138, 13, rgb(INK), 0.1)
    blend(image[156:159, MARGIN : WIDTH - MARGIN], rgb(INK), 1.0)
    column = (WIDTH - 2 * MARGIN - GUTTER) / 2
    for i in range(2):
        left, base = MARGIN + i * (column + GUTTER), 196.0
        while base < HEIGHT - 80:
            base = _paragraph(rng, image, left, base, column) + LEADING * 0.7
    letters(image, "17", WIDTH / 2 - 10, HEIGHT - 34, 12, rgb(INK), 0.1)
    return np.clip(image, 0, 1)


def _paragraph(
    rng: np.random.Generator, image: Image, left: float, base: float, column: float
) -> float:
    """A heading now and then, and 4 to 9 lines of words set to the column's width; the next line's
    base.
    """
    if rng.random() < 0.35:
        letters(
            image, " ".join(rng.choice(WORDS, 3)).capitalize(), left, base + 4, 15, rgb(INK), 0.13
        )
        base += LEADING * 1.3
    lines = int(rng.integers(4, 10))
    for k in range(lines):
        if base > HEIGHT - 70:
            break
        _line(rng, image, left, base, column, first=k == 0, last=k == lines - 1)
        base += LEADING
    return base


def _line(
    rng: np.random.Generator,
    image: Image,
    left: float,
    base: float,
    column: float,
    first: bool,
    last: bool,
) -> None:
    """One line of words, the spaces between them stretched so that it is full; the last of a
    paragraph ends with a stop.
    """
    start = left + (24 if first else 0)
    room = column - (start - left)
    words = _words(rng, room, first, room * (0.6 if last else 1))
    longs = [width_of(word, SIZE, FONT) for word in words]
    gap = 8.0 if last else max(7.0, (room - sum(longs)) / max(len(words) - 1, 1))
    if last and words:
        words[-1] = words[-1].rstrip(",") + "."
    x = start
    for word, long in zip(words, longs, strict=True):
        letters(image, word, x, base, SIZE, rgb(INK), 0.1)
        x += long + gap


def _words(rng: np.random.Generator, room: float, first: bool, enough: float) -> list[str]:
    """Words that fit into a line [px], until there are enough [px]; the first of a paragraph begins
    with a capital.
    """
    words, used = [], 0.0
    while used < enough:
        word = str(rng.choice(WORDS)) + ("," if rng.random() < 0.1 else "")
        word = word.capitalize() if first and not words else word
        long = width_of(word, SIZE, FONT)
        if used + long > room:
            break
        words.append(word)
        used += long + 7
    return words
