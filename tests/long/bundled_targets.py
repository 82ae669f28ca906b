"""Makes the files of the bundled targets: the page of `arm_picture`, the flange of `arm_mesh`. Run
it to write them again.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from vstestbed.core.named_files import folder
from vstestbed.targets.mesh import as_stl

WIDTH, HEIGHT, TAG, EDGE = 1200, 848, 180, 130
"""The page, its tags' edge, and the distance of their middles from its borders [px]."""
INK, RULE = (52, 44, 40), (176, 168, 160)
PROFILE = ((20, 0), (150, 0), (150, 18), (70, 18), (58, 30), (50, 90), (30, 90), (30, 20), (20, 20))
"""Half section of the flange, (radius, height) in mm, counter-clockwise: a plate, a neck with a
bore, a step.
"""
TURNS = 96


def page() -> np.ndarray:
    """A page (848, 1200, 3), blue first: four ArUco tags, a title, lines of text,
    a shaded relief.
    """
    sheet = np.full((HEIGHT, WIDTH, 3), 250, np.uint8)
    tags = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    places = [
        (EDGE, EDGE),
        (WIDTH - EDGE, EDGE),
        (WIDTH - EDGE, HEIGHT - EDGE),
        (EDGE, HEIGHT - EDGE),
    ]
    for number, (u, v) in enumerate(places):
        left, top = u - TAG // 2, v - TAG // 2
        sheet[top : top + TAG, left : left + TAG] = np.asarray(
            cv2.aruco.generateImageMarker(tags, number, TAG)
        )[..., None]
    cv2.putText(sheet, "Test page 7", (310, 130), cv2.FONT_HERSHEY_DUPLEX, 2.6, INK, 5, cv2.LINE_AA)
    cv2.putText(
        sheet,
        "four tags, one relief, no colour",
        (312, 195),
        cv2.FONT_HERSHEY_SIMPLEX,
        1.15,
        INK,
        2,
        cv2.LINE_AA,
    )
    y, x = np.mgrid[0:300, 0:420] / 100
    relief = np.sin(1.7 * x + 0.6 * y) * np.cos(1.1 * y - 0.4 * x) + 0.35 * np.sin(
        4.1 * x - 2.3 * y
    )
    shade = np.clip(
        150 + 55 * (np.gradient(relief, axis=1) - np.gradient(relief, axis=0)) * 40, 30, 235
    )
    sheet[270:570, 120:540] = shade[..., None]
    for line, length in enumerate((500, 470, 505, 340, 0, 490, 505, 450, 260)):
        if length:
            cv2.rectangle(sheet, (590, 285 + 34 * line), (590 + length, 297 + 34 * line), RULE, -1)
    cv2.arrowedLine(sheet, (330, 700), (870, 700), INK, 8, cv2.LINE_AA, tipLength=0.06)
    cv2.putText(sheet, "right", (545, 765), cv2.FONT_HERSHEY_SIMPLEX, 1.6, INK, 3, cv2.LINE_AA)
    return sheet


def flange() -> np.ndarray:
    """The triangles (F, 3, 3) of a flange of 300 mm, counter-clockwise from outside."""
    turn = np.arange(TURNS + 1) * (2 * np.pi / TURNS)
    turn[-1] = 0.0  # the same corners as at the beginning
    around = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    faces = []
    for (r0, z0), (r1, z1) in zip(PROFILE, (*PROFILE[1:], PROFILE[0]), strict=True):
        low, high = (
            np.column_stack([r * around, np.full(TURNS + 1, z)]) for r, z in ((r0, z0), (r1, z1))
        )
        a, b, c, d = low[:-1], low[1:], high[1:], high[:-1]
        faces += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    return np.concatenate(faces).astype(float)


if __name__ == "__main__":
    place = folder("scenarios") / "targets"
    cv2.imwrite(str(place / "page.png"), page(), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    Path(place / "flange.stl").write_bytes(as_stl(flange()))
