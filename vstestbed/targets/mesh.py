"""A part of one's own as the target: a solid from a CAD program,
with marker points on its surface.
"""

from __future__ import annotations

import functools
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Len
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.named_files import absolute_file, place_of_file
from vstestbed.core.quantity import Coefficient, PositiveLength, Share
from vstestbed.core.registry import Registry
from vstestbed.core.spec import spec
from vstestbed.targets.base import Body, Target
from vstestbed.targets.markers import Disc, Marker, Sphere

MOST_FACES = 200_000  # MuJoCo reads no more from a file
# a triangle in a binary STL file
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
Triangles = NDArray[np.float64]  # corners (F, 3, 3), counter-clockwise from outside


@functools.lru_cache(maxsize=8)
def read_triangles(path: Path, written_ns: int) -> Triangles:
    """The triangles of an STL (binary or text) or OBJ file, last written at a time [ns], in its
    units, without those that have no area.

    Of an OBJ file vertices and faces count; polygons are cut into triangles, normals, textures and
    materials are left out.
    """
    raw = path.read_bytes()
    try:
        found = _obj(raw) if path.suffix.lower() == ".obj" else _stl(raw)
    except (ValueError, IndexError) as error:
        raise ParameterError.unreadable("file", error, "an STL or OBJ file", str(path)) from None
    if not np.isfinite(found).all():
        raise ParameterError.unreadable(
            "file", "it has corners that are not finite", "an STL or OBJ file", str(path)
        )
    if len(found):
        size = float(np.ptp(found.reshape(-1, 3), axis=0).max())
        a, b, c = np.moveaxis(found, 1, 0)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        found = found[area > 1e-12 * max(size, 1e-30) ** 2]
    if not len(found):
        raise ParameterError.unreadable(
            "file",
            "it has no faces with an area",
            "a part that is exported as triangles",
            str(path),
        )
    if len(found) > MOST_FACES:
        raise ParameterError.unreadable(
            "file",
            f"it has {len(found)} faces",
            f"at most {MOST_FACES}, of a part that is reduced (decimated)",
            str(path),
        )
    return found


def _stl(raw: bytes) -> Triangles:
    count = int.from_bytes(raw[80:84], "little")
    size = 84 + 50 * count
    if len(raw) == size:
        return np.frombuffer(raw, RECORD, count, 84)["corners"].astype(float)
    if not raw.lstrip()[:5].lower() == b"solid":
        raise ValueError(f"as a binary STL it should have {size} bytes, it has {len(raw)}")
    words = [
        line.split()[1:4] for line in raw.splitlines() if line.lstrip()[:6].lower() == b"vertex"
    ]
    if len(words) % 3:
        raise ValueError(f"{len(words)} corners make no whole number of triangles")
    return np.array(words, dtype=float).reshape(-1, 3, 3)


def _obj(raw: bytes) -> Triangles:
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
                raise ValueError(
                    f"line {number}: no face of three vertices or more that stand before it"
                ) from None
    return np.array(places, dtype=float).reshape(-1, 3)[np.array(corners, int)].reshape(-1, 3, 3)


def _fan(items: list[bytes], count: int) -> list[int]:
    """Corners of the triangles of a polygon `v/vt/vn ...` of an OBJ file that has `count` vertices
    so far; ValueError for no polygon.
    """
    numbers = [int(item.split(b"/")[0]) for item in items]
    # counted from 1; a negative number counts back from the last vertex
    at = [i - 1 if i > 0 else count + i for i in numbers]
    if len(at) < 3 or min(at) < 0 or max(at) >= count:
        raise ValueError
    corners = []
    for second, third in pairwise(at[1:]):
        corners += at[0], second, third
    return corners


def as_stl(triangles: Triangles) -> bytes:
    """A binary STL file."""
    records = np.zeros(len(triangles), RECORD)
    records["corners"] = triangles
    return bytes(80) + len(triangles).to_bytes(4, "little") + records.tobytes()


def nearest(triangles: Triangles, point: Array) -> tuple[Array, int]:
    """The point of triangles (F, 3, 3) nearest to a point (3,), and its triangle's number: its
    projection, or a point of an edge.
    """
    a, b, c = np.moveaxis(triangles, 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    flat = point - ((point - a) * normal).sum(axis=1, keepdims=True) * normal
    inside = np.ones(len(triangles), bool)
    on_edges = []
    for p, q in ((a, b), (b, c), (c, a)):
        on_edges.append(_on_edge(p, q, point))
        inside &= (np.cross(q - p, flat - p) * normal).sum(axis=1) >= 0
    edges = np.stack(on_edges)
    best = np.linalg.norm(edges - point, axis=-1).argmin(axis=0)
    found = np.where(inside[:, None], flat, edges[best, np.arange(len(triangles))])
    i = int(np.linalg.norm(found - point, axis=1).argmin())
    return found[i], i


def _on_edge(p: Array, q: Array, point: Array) -> Array:
    """The points of edges p to q (F, 3) nearest to a point."""
    way = q - p
    share = ((point - p) * way).sum(axis=1) / (way * way).sum(axis=1)
    return p + np.clip(share, 0, 1)[:, None] * way


SOLID_MARKERS = Registry("marker", Disc, Sphere, default="disc")


@spec
class MeshTarget(Target):
    """A solid of triangles with markers on its surface: spheres, or discs that lie in it. What it
    hides is hidden from the oracle, too.

    Args:
        file: an STL or OBJ file, absolute, relative to the scenario's file, or `package:NAME/path`.
            Of an OBJ file only the shape counts.
        scale: metres for one unit of the file [m]; 0.001 for millimetres.
        at: marker points on the surface, (x, y, z) as a CAD program shows them [unit of the file].
        draw_markers: draw the markers; false: nothing is to be seen of them, which the oracle does
            not mind.
        color: colour of the solid, (r, g, b) of 0 to 1 [1].
    """

    kind: Literal["mesh"] = "mesh"
    file: str
    scale: PositiveLength
    at: Annotated[tuple[Annotated[tuple[Coefficient, ...], Len(3, 3)], ...], Len(1, 24)]
    marker: Annotated[Marker, SOLID_MARKERS] = Disc()
    draw_markers: bool = True
    color: Annotated[tuple[Share, ...], Len(3, 3)] = (0.72, 0.74, 0.77)

    def __post_init__(self) -> None:
        # frozen; a run remembers where its solid is
        object.__setattr__(self, "file", absolute_file(self.file, Path.cwd()))
        if not self.file.lower().endswith((".stl", ".obj")):
            raise ParameterError.form("file", "FILE.stl or FILE.obj, a solid", self.file)
        if self.pad:
            raise ParameterError.only_for("pad", "target square or points")
        # the diagonal of its box
        size = float(np.linalg.norm(np.ptp(self._triangles.reshape(-1, 3), axis=0)))
        # a part of 0.1 m or more whose millimetres were taken for metres is larger
        if not 1e-4 <= size <= 100:
            words = (
                f"makes the solid {size:.3g} m large; give the metres of one unit of the file,"
                " 0.001 for millimetres"
            )
            raise ParameterError("scale", words, self.scale)
        for i, (point, (on, _)) in enumerate(zip(self.at, self._nearest, strict=True)):
            off = float(np.linalg.norm(np.array(point) * self.scale - on))
            # the triangles of a file deviate from curved surfaces by tenths of a millimetre
            if off > max(1e-3, 5e-3 * size):
                near = [round(float(x), 6) for x in on / self.scale]
                words = (
                    "must lie on the solid's surface:"
                    f" it is {off * 1e3:.3g} mm off, nearest is {near}"
                )
                raise ParameterError(f"at.{i}", words, list(point))
        self._check_markers()
        if self.draw_markers and not self.marker.height_m:
            self._check_flat()

    def _check_flat(self) -> None:
        angle = np.arange(12) * (2 * np.pi / 12)
        radius = self.marker.radius
        for i, (p, n) in enumerate(zip(self.points, self.normals, strict=True)):
            u = np.cross(n, [1.0, 0, 0] if abs(n[0]) < 0.7 else [0, 1.0, 0])
            u /= np.linalg.norm(u)
            v = np.cross(n, u)
            rim = p + radius * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v)
            off = max(float(np.linalg.norm(nearest(self._triangles, q)[0] - q)) for q in rim)
            if off > 1e-3:
                words = (
                    f"does not fit at marker {self.called(i)}: the surface is curved or ends there,"
                    f" {off * 1e3:.3g} mm from the disc's rim; take a smaller disc, or spheres"
                )
                raise ParameterError("marker.radius", words, radius)

    @cached_property
    def _triangles(self) -> Array:
        return read_triangles(self.source, self.source.stat().st_mtime_ns) * self.scale

    @cached_property
    def _nearest(self) -> list[tuple[Array, int]]:
        """The surface's point (3,) nearest to each of `at` [m], and its triangle."""
        return [nearest(self._triangles, np.array(point) * self.scale) for point in self.at]

    @property
    def source(self) -> Path:
        return place_of_file(self.file)

    @cached_property
    def points(self) -> Array:
        """Marker centres in the target frame, shape (N, 3) [m]: the surface's points nearest to
        `at`.
        """
        return np.array([point for point, _ in self._nearest])

    @cached_property
    def normals(self) -> Array:
        """The surface's outward unit normals at the markers, shape (N, 3)."""
        a, b, c = np.moveaxis(self._triangles[[i for _, i in self._nearest]], 1, 0)
        normal = np.cross(b - a, c - a)
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)

    @property
    def body(self) -> Body:
        return self._triangles, (self.color[0], self.color[1], self.color[2]), True

    def hides(self, T_target_camera: Array) -> NDArray[np.bool_]:
        """Which markers (N,) a triangle hides: it cuts the camera's way to them more than their
        height before its end.

        Reference: Moeller & Trumbore 1997, Fast, minimum storage ray/triangle intersection,
            doi:10.1080/10867651.1997.10487468.
        """
        a, b, c = np.moveaxis(self._triangles, 1, 0)
        eye = T_target_camera[:3, 3]
        slack = self.marker.clearance_m(self.points - eye)
        e1 = b - a
        e2 = c - a
        off = eye - a
        q = np.cross(off, e1)
        covered = np.zeros(len(self.points), bool)
        for i, point in enumerate(self.points):
            way = point - eye
            reach = float(np.linalg.norm(way))
            p = np.cross(way, e2)
            # a triangle seen edge on hides nothing
            with np.errstate(divide="ignore", invalid="ignore"):
                det = (e1 * p).sum(axis=1)
                u = (off * p).sum(axis=1) / det
                v = q @ way / det
                t = (e2 * q).sum(axis=1) / det
                met = (u >= 0) & (v >= 0) & (u + v <= 1)
                before = (t > 0) & (t < 1 - slack / max(reach, 1e-9))
            covered[i] = (met & before).any()
        return covered
