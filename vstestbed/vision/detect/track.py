"""Tracking of blobs over a camera's panels: search windows around predicted blobs, handover between panels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from vstestbed.camera import Camera, Look, Window
from vstestbed.core.geometry import Array
from vstestbed.vision.detect.colour_blobs import Blob
from vstestbed.vision.detect.windows import Move, window_round, windows_round

REACH = 0.1
"""In a camera with panels, windows are enlarged by this share of a panel on each side, and continue on the next panel where they
leave the first, so that a marker a little outside of its predicted window is still rendered."""
MEASURED_PX = 2
"""Blobs are measured so far beyond their mask's box [px] (`colour_blobs`), which may touch the window in which they were searched."""
TWIN_COSINE = math.cos(math.radians(3))
"""Two blobs of one hue less than 3 degrees apart, in two overlapping panels, are one marker seen twice."""


@dataclass(frozen=True, slots=True)
class BlobsMemory:
    """State of the blob detector, of N markers.

    Attributes:
        blobs: each marker's blob in the last picture; None for a lost one.
        moves: last known displacement of each blob from one picture to the next [px]; zero at first.
        T_camera_target: last known pose of the target, shape (4, 4).
        bias: perspective bias in the last picture, shape (N, 2) [px].
        panels: index of the panel in which each marker will be searched; blob and move are in that panel's pixels.
    """

    blobs: tuple[Blob | None, ...] = ()
    moves: tuple[Move, ...] = ()
    T_camera_target: Array | None = None
    bias: Array | None = None
    panels: tuple[int, ...] = ()


def windows(memory: BlobsMemory, camera: Camera, margin: int) -> list[Window] | None:
    """A window around each marker's predicted blob, in its panel; None where one is lost or a whole search is faster."""
    return windows_round([b.box if b else None for b in memory.blobs], memory.moves, memory.panels, camera, margin)


def look_of(memory: BlobsMemory, camera: Camera, margin: int) -> Look | None:
    """Regions of interest, in each panel, of the next detection; None for everything."""
    own = windows(memory, camera, margin + MEASURED_PX)
    if own is None:
        return None
    if len(camera.panels) == 1:
        return (tuple(own),)
    out: list[list[Window]] = [[] for _ in camera.panels]
    for blob, move, home in zip(memory.blobs, memory.moves, memory.panels, strict=True):
        if blob is None:
            return None
        for panel, window in _enlarged_windows(blob, move, home, camera, margin):
            out[panel].append(window)
    return tuple(tuple(some) for some in out)


def _enlarged_windows(blob: Blob, move: Move, home: int, camera: Camera, margin: int) -> Iterator[tuple[int, Window]]:
    """The enlarged window around a predicted blob, in its own panel and, near the border, in every other that sees it."""
    lens = camera.panels[home].lens
    wide = margin + REACH * lens.width
    panels = [home] if _slack(blob, move, lens) >= wide else range(len(camera.panels))
    for panel in panels:
        seen = (blob, move) if panel == home else seen_from(blob, move, home, panel, camera)
        window = window_round(seen[0].box, seen[1], camera.panels[panel].lens, wide) if seen else None
        if window is not None:
            yield panel, window


def moves_of(memory: BlobsMemory, blobs: list[Blob | None], panels: list[int], camera: Camera) -> tuple[Move, ...]:
    """Displacement of each blob since the last picture [px]; of one that was not seen then, or is not now, the last known one.

    It is zero where none is known in the panel in which the blob is now.
    """
    none = (None,) * len(blobs)
    out: list[Move] = []
    last = zip(memory.blobs or none, memory.moves or none, memory.panels or none, strict=True)
    for (a, move, before), b, panel in zip(last, blobs, panels, strict=True):
        if before is not None and before != panel:
            a, move = _blob_there(a, before, panel, camera), None
        out.append((b.u - a.u, b.v - a.v) if a and b else move or (0.0, 0.0))
    return tuple(out)


def _blob_there(blob: Blob | None, panel: int, other: int, camera: Camera) -> Blob | None:
    """A blob in another panel's pixels; None where it lies outside of that panel."""
    seen = seen_from(blob, (0.0, 0.0), panel, other, camera) if blob else None
    return seen[0] if seen else None


def hand_over(memory: BlobsMemory, camera: Camera, margin: int) -> BlobsMemory:
    """The same with each blob that nears its panel's border in the panel where it will be farthest from a border."""
    blobs, moves, panels = list(memory.blobs), list(memory.moves), list(memory.panels)
    for i, (blob, move, home) in enumerate(zip(memory.blobs, memory.moves, memory.panels, strict=True)):
        if blob is None:
            continue
        most = _slack(blob, move, camera.panels[home].lens)
        if most >= margin + max(abs(move[0]), abs(move[1])) / 2:
            continue
        for panel in range(len(camera.panels)):
            seen = seen_from(blob, move, home, panel, camera) if panel != home else None
            if seen is not None and _slack(*seen, camera.panels[panel].lens) > most:
                most = _slack(*seen, camera.panels[panel].lens)
                (blobs[i], moves[i]), panels[i] = seen, panel
    return replace(memory, blobs=tuple(blobs), moves=tuple(moves), panels=tuple(panels))


def seen_from(blob: Blob, move: Move, panel: int, other: int, camera: Camera) -> tuple[Blob, Move] | None:
    """A blob and its move in another panel's pixels; None where the blob's prediction lies outside of that panel."""
    here, there = camera.panels[panel], camera.panels[other]
    left, top, right, bottom = blob.box
    corners = [(left - 0.5, top - 0.5), (right - 0.5, top - 0.5), (left - 0.5, bottom - 0.5), (right - 0.5, bottom - 0.5)]
    px = np.array([(blob.u, blob.v), (blob.u + move[0], blob.v + move[1]), *corners])
    uv = there.lens.project(here.lens.ray(px) @ here.R_camera_panel.T @ there.R_camera_panel)
    if not (np.isfinite(uv).all() and there.lens.inside(uv[1:2]).all()):
        return None
    low, high = np.floor(uv[2:].min(axis=0) + 0.5).astype(int), np.ceil(uv[2:].max(axis=0) + 0.5).astype(int)
    (u, v), (du, dv) = uv[0].tolist(), (uv[1] - uv[0]).tolist()
    box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
    return replace(blob, u=u, v=v, box=box), (du, dv)


def _slack(blob: Blob, move: Move, lens: Camera) -> float:
    """Least distance of the predicted blob's box from the image's border [px]; negative where it reaches beyond."""
    (left, top, right, bottom), (du, dv) = blob.box, move
    return min(left + du, top + dv, lens.width - right - du, lens.height - bottom - dv)


def at_border(blob: Blob, lens: Camera) -> bool:
    """Whether a blob touches the image's border."""
    left, top, right, bottom = blob.box
    return left <= 0 or top <= 0 or right >= lens.width or bottom >= lens.height


def largest(found: list[tuple[int, Blob]], camera: Camera) -> tuple[int, Blob] | None:
    """Of the blobs of one hue, each with its panel, the largest, blobs that are not cut first; in panels by solid angle.

    A pinhole image enlarges the area of what lies at an angle a off the axis by 1 / cos^3 a. Where panels overlap, a marker may
    be seen twice; the panel whose axis is nearer to it is taken.
    """
    if len(camera.panels) == 1 or not found:
        return max(found, key=lambda f: (f[1].whole, f[1].area), default=None)
    rays = [camera.panels[p].lens.ray(np.array([[b.u, b.v]]))[0] for p, b in found]
    cosine = [float(ray[2]) for ray in rays]
    best = max(range(len(found)), key=lambda i: (found[i][1].whole, found[i][1].area * cosine[i] ** 3))
    in_camera = [camera.panels[p].R_camera_panel @ ray for (p, _), ray in zip(found, rays, strict=True)]
    return found[max(_twins(found, in_camera, best), key=lambda i: cosine[i])]


def _twins(found: list[tuple[int, Blob]], rays: list[Array], index: int) -> list[int]:
    """Indices of blobs that are the same marker as that of `index` in other panels, and `index` itself."""
    panel, blob = found[index]
    others = [i for i, (p, b) in enumerate(found) if p != panel and b.whole == blob.whole]
    return [i for i in others if rays[i] @ rays[index] > TWIN_COSINE] + [index]
