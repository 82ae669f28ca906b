"""Textures by rays: sampled between the texels and, where a pixel holds several, from smaller copies (mipmap), as OpenGL does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array


class Mipmap:
    """A texture (H, W, 3) uint8 and its copies of half the size, a quarter, ... down to one texel, one after another in one table.

    It repeats itself beyond its edges.
    """

    def __init__(self, texels: NDArray[np.uint8]):
        levels = [texels]
        while max(levels[-1].shape[:2]) > 1:
            levels.append(_halved(levels[-1]))
        self._table = np.concatenate([level.reshape(-1, 3) for level in levels])
        self._height, self._width = (np.array([level.shape[axis] for level in levels]) for axis in (0, 1))
        self._start = np.concatenate([[0], np.cumsum(self._height * self._width)[:-1]])

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the texture [texel]."""
        return int(self._width[0]), int(self._height[0])

    def at(self, place: Array, texels: Array) -> NDArray[np.float32]:
        """Colours (N, 3), 1 for full brightness, at places (N, 2), as shares of the width from the left and of the height from the top.

        texels: across a pixel there, (N,). Linear between the centres of texels, and between the two levels whose texels are next to
        a pixel's size (trilinear); the first level where a texel is larger than a pixel.

        Reference: Williams 1983, Pyramidal parametrics, doi:10.1145/800059.801126.
        """
        level = np.clip(np.log2(np.maximum(texels, 1e-9)), 0, len(self._start) - 1)
        fine = level.astype(int)
        part = (level - fine).astype(np.float32)
        colours = self._between(place, fine)
        mixed = np.flatnonzero(part)
        if len(mixed):
            share = part[mixed, None]
            colours[mixed] = (1 - share) * colours[mixed] + share * self._between(place[mixed], fine[mixed] + 1)
        return colours

    def aslant(self, place: Array, steps: tuple[Array, Array], most: int) -> NDArray[np.float32]:
        """Colours (N, 3) of pixels that cover a long strip of the texture: means of up to `most` samples along it, each by `at`.

        steps: from one pixel to the next along two axes, as shares of the texture's width and height, (N, 2) each.

        Reference: McCormack, Perry, Farkas & Jouppi 1999, Feline: fast elliptical lines for anisotropic texture mapping,
        doi:10.1145/311535.311562.
        """
        lengths = [np.hypot(step[:, 0] * self.size[0], step[:, 1] * self.size[1]) for step in steps]
        first = (lengths[0] >= lengths[1])[:, None]
        along = np.where(first, *steps)
        longer, shorter = np.maximum(*lengths), np.minimum(*lengths)
        samples = np.clip(np.ceil(longer / np.maximum(shorter, 1e-9) - 0.01), 1, most).astype(int)
        texels, colours = np.maximum(longer / samples, shorter), np.zeros((len(place), 3), np.float32)
        for k in range(int(samples.max(initial=0))):
            on = np.flatnonzero(samples > k)
            n = samples[on]
            there = place[on] + along[on] * ((k + 0.5) / n - 0.5)[:, None]
            colours[on] += self.at(there - np.floor(there), texels[on]) / n[:, None].astype(np.float32)
        return colours

    def _between(self, place: Array, level: NDArray[np.int_]) -> NDArray[np.float32]:
        """Linear interpolation between the four texels round places (N, 2), each at its level (N,)."""
        width, height, start = self._width[level], self._height[level], self._start[level]
        u, v = place[:, 0] * width - 0.5, place[:, 1] * height - 0.5
        left, top = np.floor(u).astype(int), np.floor(v).astype(int)
        across, down = (u - left).astype(np.float32)[:, None], (v - top).astype(np.float32)[:, None]
        columns = left % width, (left + 1) % width
        rows = start + top % height * width, start + (top + 1) % height * width
        table = self._table
        upper, lower = ((1 - across) * table[row + columns[0]] + across * table[row + columns[1]] for row in rows)
        return np.asarray(((1 - down) * upper + down * lower) / 255, np.float32)


def _halved(texels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Half of the rows and columns: means of two by two texels; of an odd number, interpolated so that nothing is shifted."""
    half = texels.astype(np.float32)
    for axis in (0, 1):
        n = half.shape[axis]
        if n > 1:
            at = (np.arange(n // 2) + 0.5) * n / (n // 2) - 0.5
            low = at.astype(int)
            share = (at - low).astype(np.float32).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
            half = (1 - share) * half.take(low, axis) + share * half.take(low + 1, axis)
    return (half + 0.5).astype(np.uint8)
