"""Where blobs are looked for next: windows round predicted blobs, in the panel of the camera that will hold them best."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from vstestbed.camera import Camera, Look, Window
from vstestbed.core.geometry import Array
from vstestbed.vision.detect.colour_blobs import Blob
from vstestbed.vision.detect.windows import Move, window_round, windows_round

REACH = 0.1
"""A camera with panels is asked for windows that are larger by this share of a panel on each side, and for the next panel
where such a window leaves the first: a marker that turns up beside its own window is then still in a picture."""
TWIN_COSINE = math.cos(math.radians(3))
"""Two blobs of one hue nearer to each other than 3 degrees, in two panels that overlap, are one marker seen twice."""


@dataclass(frozen=True, slots=True)
class BlobsMemory:
    """Each marker's blob in the last picture (None: lost) and its move since the one before [px]; the last pose and bias.

    `panels` says in which of the camera's panels the blob will be looked for; blob and move are told in that one's pixels.
    """

    blobs: tuple[Blob | None, ...] = ()
    moves: tuple[Move, ...] = ()
    T_camera_target: Array | None = None
    bias: Array | None = None
    panels: tuple[int, ...] = ()


def windows(memory: BlobsMemory, camera: Camera, margin: int) -> list[Window] | None:
    """A window round each marker's predicted blob, within its panel; None where one is lost or the whole is quicker."""
    return windows_round([b.box if b else None for b in memory.blobs], memory.moves, memory.panels, camera, margin)


def look_of(memory: BlobsMemory, camera: Camera, margin: int) -> Look | None:
    """The windows in each panel that the next detection may want; None: everything."""
    own = windows(memory, camera, margin)
    if own is None or len(camera.panels) == 1:
        return None if own is None else (tuple(own),)
    out: list[list[Window]] = [[] for _ in camera.panels]
    for blob, move, home in zip(memory.blobs, memory.moves, memory.panels, strict=True):
        if blob is None:
            return None
        lens = camera.panels[home].lens
        wide = margin + REACH * lens.width
        panels = [home] if _slack(blob, move, lens) >= wide else range(len(out))
        for panel in panels:
            seen = (blob, move) if panel == home else seen_from(blob, move, home, panel, camera)
            window = window_round(seen[0].box, seen[1], camera.panels[panel].lens, wide) if seen else None
            if window is not None:
                out[panel].append(window)
    return tuple(tuple(some) for some in out)


def moves_of(memory: BlobsMemory, blobs: list[Blob | None], panels: list[int], camera: Camera) -> tuple[Move, ...]:
    """By how much each blob has moved since the last picture [px]; nothing where it was not seen then or is not now."""
    none = (None,) * len(blobs)
    out: list[Move] = []
    for a, b, before, panel in zip(memory.blobs or none, blobs, memory.panels or none, panels, strict=True):
        if a is not None and before is not None and before != panel:
            seen = seen_from(a, (0.0, 0.0), before, panel, camera)
            a = seen[0] if seen else None
        out.append((b.u - a.u, b.v - a.v) if a and b else (0.0, 0.0))
    return tuple(out)


def hand_over(memory: BlobsMemory, camera: Camera, margin: int) -> BlobsMemory:
    """The same with each blob in the panel in which it will be farthest from the border, where it comes near its own's."""
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
    """A blob and its move as another panel sees them; None where that cannot, even in part of its field of view, see it."""
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
    """How far inside the picture the predicted blob's box lies [px]; negative where it reaches out."""
    (left, top, right, bottom), (du, dv) = blob.box, move
    return min(left + du, top + dv, lens.width - right - du, lens.height - bottom - dv)


def at_border(blob: Blob, lens: Camera) -> bool:
    """Whether a blob touches the picture's border."""
    left, top, right, bottom = blob.box
    return left <= 0 or top <= 0 or right >= lens.width or bottom >= lens.height


def largest(found: list[tuple[int, Blob]], camera: Camera) -> tuple[int, Blob] | None:
    """Of a hue's blobs, each with its panel, whole ones first, the largest; in panels by the angle that it fills.

    Where panels overlap, the same marker may be whole in two of them; that one counts in which it is nearer the middle.
    A pinhole stretches what lies an angle a off its axis to 1 / cos^3 a of the area that it has there.
    """
    if len(camera.panels) == 1 or not found:
        return max(found, key=lambda f: (f[1].whole, f[1].area), default=None)
    rays = [camera.panels[p].lens.ray(np.array([[b.u, b.v]]))[0] for p, b in found]
    along = [float(ray[2]) for ray in rays]
    best = max(range(len(found)), key=lambda i: (found[i][1].whole, found[i][1].area * along[i] ** 3))
    world = [camera.panels[p].R_camera_panel @ ray for (p, _), ray in zip(found, rays, strict=True)]
    twins = [i for i in range(len(found)) if found[i][1].whole == found[best][1].whole and world[i] @ world[best] > TWIN_COSINE]
    twins = [i for i in twins if found[i][0] != found[best][0]] + [best]
    return found[max(twins, key=lambda i: along[i])]
