"""Boxes with bundled textures on a board:
`python scenarios/scenery/make_boxes.py [--seed N] [--boxes N] > boxes.xml`.

Bundled is the scene of seed 0, scenarios/scenery/boxes.xml. The board itself is the target, a
picture that lies in z = 0.
"""

from __future__ import annotations

import argparse

import numpy as np

HALF = np.array([0.34, 0.25])
"""Half of the place on the board in which the boxes stand [m]; a board of 0.8 x 0.6 m reaches
beyond it.
"""
GAP, TEXTURES = 0.015, ("text.jpg", "brick.jpg", "repetitive.png", "poster.jpg")


def boxes(seed: int, n: int = 6) -> str:
    """An MJCF file of n boxes that do not overlap: half edges 3 to 7 cm, 4 to 12 cm high, turned at
    random.
    """
    rng = np.random.default_rng(seed)
    placed: list[tuple[float, float, float]] = []
    lines = []
    while len(placed) < n:
        half, high = rng.uniform(0.03, 0.07, 2), rng.uniform(0.04, 0.12)
        radius = float(np.hypot(*half))
        x, y = rng.uniform(-1, 1, 2) * (HALF - radius)
        if any(np.hypot(x - a, y - b) < radius + r + GAP for a, b, r in placed):
            continue
        i = len(placed)
        size, pos = f"{half[0]:.4f} {half[1]:.4f} {high / 2:.4f}", f"{x:.4f} {y:.4f} {high / 2:.4f}"
        lines.append(
            f'    <geom name="box_{i}" type="box" size="{size}" pos="{pos}" euler="0 0'
            f' {rng.uniform(0, 360):.1f}" material="box_{i}"/>'
        )
        placed.append((x, y, radius))
    textures = [
        f'    <texture name="{name[:-4]}" type="2d" file="../../models/textures/{name}"/>'
        for name in TEXTURES
    ]
    materials = []
    for i, repeat in enumerate(rng.uniform(0.25, 0.6, n)):  # each shows a part of its texture
        look = (
            f'texture="{TEXTURES[i % len(TEXTURES)][:-4]}" texrepeat="{repeat:.3f} {repeat:.3f}"'
            ' specular="0" shininess="0"'
        )
        materials.append(f'    <material name="box_{i}" {look}/>')
    head = [
        "<!-- Written by make_boxes.py. -->",
        '<mujoco model="boxes">',
        "  <asset>",
        *textures,
        *materials,
        "  </asset>",
        "  <worldbody>",
    ]
    return "\n".join([*head, *lines, "  </worldbody>", "</mujoco>", ""])


if __name__ == "__main__":
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--seed", type=int, default=0)
    asked.add_argument("--boxes", type=int, default=6)
    given = asked.parse_args()
    print(boxes(given.seed, given.boxes), end="")
