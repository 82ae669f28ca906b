"""Triangles: read from STL and OBJ files, the nearest point on them, what they hide."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array

MOST_FACES = 200_000
"""MuJoCo reads no more from a file."""
MOST_BYTES = 64_000_000
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
"""A triangle in a binary STL file."""
Triangles = NDArray[np.float64]
"""Corners (F, 3, 3), counter-clockwise from outside."""


def read_triangles(path: Path) -> Triangles:
    """The triangles of an STL (binary or text) or OBJ file, in its units, without those that have no area.

    Of an OBJ file vertices and faces count; polygons are cut into triangles, normals, textures and materials are left out.

    Raises:
        ParameterError: `file` has none, too many, or cannot be read.
    """
    return _read(path, path.stat().st_mtime_ns)


@functools.lru_cache(maxsize=8)
def _read(path: Path, changed: int) -> Triangles:
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise ParameterError("file", f"has {size / 1e6:.0f} MB; a solid may have {MOST_BYTES / 1e6:.0f}: reduce its faces", str(path))
    raw = path.read_bytes()
    try:
        found = _obj(raw) if path.suffix.lower() == ".obj" else _stl(raw)
    except (ValueError, IndexError) as error:
        raise ParameterError("file", f"cannot be read ({error}); works: an STL or OBJ file", str(path)) from None
    if not np.isfinite(found).all():
        raise ParameterError("file", "has corners that are not finite", str(path))
    area = np.linalg.norm(np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0]), axis=1)
    found = found[area > 1e-12 * max(float(np.ptp(found.reshape(-1, 3), axis=0).max()), 1e-30) ** 2] if len(found) else found
    if not len(found):
        raise ParameterError("file", "has no faces with an area; export the part as triangles", str(path))
    if len(found) > MOST_FACES:
        raise ParameterError("file", f"has {len(found)} faces; {MOST_FACES} are the most: reduce (decimate) it", str(path))
    return found


def _stl(raw: bytes) -> Triangles:
    """Triangles of an STL file."""
    count = int.from_bytes(raw[80:84], "little")
    if len(raw) >= 84 and len(raw) == 84 + 50 * count:
        records = np.frombuffer(raw, RECORD, count, 84)
        return records["corners"].astype(float)
    if not raw.lstrip()[:5].lower() == b"solid":
        raise ValueError(f"as a binary STL it should have {84 + 50 * count} bytes, it has {len(raw)}")
    words = [line.split()[1:4] for line in raw.splitlines() if line.lstrip()[:6].lower() == b"vertex"]
    if len(words) % 3:
        raise ValueError(f"{len(words)} corners make no whole number of triangles")
    return np.array(words, dtype=float).reshape(-1, 3, 3)


def _obj(raw: bytes) -> Triangles:
    """Triangles of a Wavefront OBJ file."""
    places: list[list[bytes]] = []
    corners: list[int] = []
    for number, line in enumerate(raw.replace(b"\\\n", b" ").splitlines(), start=1):
        word, *rest = line.split() or [b""]
        if word == b"v":
            places.append(rest[:3])
        elif word == b"f":
            try:
                corners += _fan(rest, len(places))
            except ValueError:
                raise ValueError(f"line {number}: no face of three vertices or more that stand before it") from None
    return np.array(places, dtype=float).reshape(-1, 3)[np.array(corners, int)].reshape(-1, 3, 3)


def _fan(items: list[bytes], count: int) -> list[int]:
    """Corners of the triangles of a polygon `v/vt/vn ...` of an OBJ file that has `count` vertices so far; ValueError for no polygon."""
    numbers = [int(item.split(b"/")[0]) for item in items]
    at = [i - 1 if i > 0 else count + i for i in numbers]  # counted from 1; a negative number counts back from the last vertex
    if len(at) < 3 or min(at) < 0 or max(at) >= count:
        raise ValueError
    return [k for i in range(1, len(at) - 1) for k in (at[0], at[i], at[i + 1])]


def as_stl(triangles: Triangles) -> bytes:
    """A binary STL file."""
    records = np.zeros(len(triangles), RECORD)
    records["corners"] = triangles
    return bytes(80) + len(triangles).to_bytes(4, "little") + records.tobytes()


def nearest(triangles: Triangles, point: Array) -> tuple[Array, int]:
    """The point of triangles (F, 3, 3) nearest to a point (3,), and the number of its triangle.

    In each triangle it is the point's projection where that is inside, else the nearest point of an edge.
    """
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    flat = point - ((point - a) * normal).sum(axis=1, keepdims=True) * normal
    edges = np.stack([_on_edge(p, q, point) for p, q in ((a, b), (b, c), (c, a))])
    best = np.linalg.norm(edges - point, axis=-1).argmin(axis=0)
    found = edges[best, np.arange(len(triangles))]
    turns = [(np.cross(q - p, flat - p) * normal).sum(axis=1) >= 0 for p, q in ((a, b), (b, c), (c, a))]
    found = np.where(np.logical_and.reduce(turns)[:, None], flat, found)
    i = int(np.linalg.norm(found - point, axis=1).argmin())
    return found[i], i


def _on_edge(p: Array, q: Array, point: Array) -> Array:
    """The points of edges p to q (F, 3) nearest to a point."""
    way = q - p
    share = ((point - p) * way).sum(axis=1) / (way * way).sum(axis=1)
    return p + np.clip(share, 0, 1)[:, None] * way


def hidden_by(triangles: Triangles, eye: Array, points: Array, slack: float) -> NDArray[np.bool_]:
    """Which points (N, 3) a triangle hides from an eye (3,): it cuts the way to them more than `slack` before its end.

    Reference: Moeller & Trumbore 1997, Fast, minimum storage ray/triangle intersection, doi:10.1080/10867651.1997.10487468.
    """
    a, e1, e2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    off = eye - a
    q = np.cross(off, e1)
    covered = np.zeros(len(points), bool)
    for i, point in enumerate(points):
        way = point - eye
        reach = float(np.linalg.norm(way))
        p = np.cross(way, e2)
        with np.errstate(divide="ignore", invalid="ignore"):  # a triangle seen edge on hides nothing
            det = (e1 * p).sum(axis=1)
            u, v, t = (off * p).sum(axis=1) / det, q @ way / det, (e2 * q).sum(axis=1) / det
            covered[i] = bool(((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1 - slack / max(reach, 1e-9))).any())
    return covered
