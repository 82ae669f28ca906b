"""A part of one's own as the target: a solid from a CAD program, with marker points on its surface."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le, Len
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.named_files import absolute_file, place_of_file
from vstestbed.core.quantity import Coefficient, PositiveLength
from vstestbed.core.spec import OneOf, spec
from vstestbed.targets.base import Target
from vstestbed.targets.markers import HIDDEN_M, Disc, Marker, Sphere
from vstestbed.targets.surfaces import Body
from vstestbed.targets.triangles import hidden_by, nearest, read_triangles

KINDS = (".stl", ".obj")
ON_SURFACE_M, ON_SURFACE = 1e-3, 5e-3
"""Largest distance of a marker point from the surface, and as a share of the solid's size: the triangles of a file deviate from curved
surfaces by tenths of a millimetre."""
FLAT_M = 1e-3
"""Largest distance of a disc's rim from the surface [m]."""
RIM = 12
Channel = Annotated[float, Ge(0), Le(1)]
LARGEST_M = 100.0
"""Largest size of a solid [m]: a part of 0.1 m or more whose millimetres were taken for metres is larger."""
SOLID_MARKERS = OneOf("marker", Disc, Sphere, default="disc")


@spec
class MeshTarget(Target):
    """A solid of triangles with markers on its surface: spheres, or discs that lie in the surface.

    The target's frame is that of the file. What the solid hides is not seen, neither in pictures nor by the oracle.

    Args:
        file: an STL or OBJ file, absolute, relative to the scenario's file, or `package:NAME/path`. Of an OBJ file only the shape counts.
        scale: metres for one unit of the file [m]; 0.001 for millimetres.
        at: marker points on the surface, (x, y, z) as a CAD program shows them [unit of the file].
        draw_markers: draw the markers; false: nothing is to be seen of them, which the oracle does not mind.
        color: colour of the solid, (r, g, b) of 0 to 1 [1].
    """

    kind: Literal["mesh"] = "mesh"
    file: str
    scale: PositiveLength
    at: Annotated[tuple[Annotated[tuple[Coefficient, ...], Len(3, 3)], ...], Len(1, 24)]
    marker: Annotated[Marker, SOLID_MARKERS] = Disc()
    draw_markers: bool = True
    color: Annotated[tuple[Channel, ...], Len(3, 3)] = (0.72, 0.74, 0.77)

    def __post_init__(self) -> None:
        """Read the solid; refuse markers off its surface, discs on curved places, and markers that overlap."""
        object.__setattr__(self, "file", absolute_file(self.file, Path.cwd()))  # frozen; a run remembers where its solid is
        if not self.file.lower().endswith(KINDS):
            raise ParameterError("file", "must be a solid, FILE.stl or FILE.obj", self.file)
        if self.pad:
            raise ParameterError("pad", "has no place on a solid; works: target square or points")
        size = self._size_m
        if not 1e-4 <= size <= LARGEST_M:
            words = f"makes the solid {size:.3g} m large; give the metres of one unit of the file, 0.001 for millimetres"
            raise ParameterError("scale", words, self.scale)
        for i, (point, (on, _)) in enumerate(zip(self.at, self._nearest, strict=True)):
            off = float(np.linalg.norm(np.array(point) * self.scale - on))
            if off > max(ON_SURFACE_M, ON_SURFACE * size):
                near = [round(float(x), 6) for x in on / self.scale]
                raise ParameterError(
                    f"at.{i}", f"must lie on the solid's surface: it is {off * 1e3:.3g} mm off, nearest is {near}", list(point)
                )
        self._check_markers()
        if self.draw_markers and not self.marker.height_m:
            self._check_flat()

    def _check_flat(self) -> None:
        """Refuse discs where the surface is curved or ends."""
        angle, normals = np.arange(RIM) * (2 * np.pi / RIM), self.normals
        for i, (p, n) in enumerate(zip(self.points, normals, strict=True)):
            across = np.cross(n, [1.0, 0, 0] if abs(n[0]) < 0.7 else [0, 1.0, 0])
            across /= np.linalg.norm(across)
            rim = p + self.marker.radius * (np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(n, across))
            off = max(float(np.linalg.norm(nearest(self._triangles, q)[0] - q)) for q in rim)
            if off > FLAT_M:
                words = (
                    f"does not fit at marker {self.called(i)}: the surface is curved or ends there, {off * 1e3:.3g} mm from the disc's rim"
                )
                raise ParameterError("marker.radius", f"{words}; take a smaller disc, or spheres", self.marker.radius)

    @cached_property
    def _triangles(self) -> Array:
        """Corners (F, 3, 3) [m]."""
        return read_triangles(self.source) * self.scale

    @property
    def _size_m(self) -> float:
        """The diagonal of the solid's box [m]."""
        return float(np.linalg.norm(np.ptp(self._triangles.reshape(-1, 3), axis=0)))

    @cached_property
    def _nearest(self) -> list[tuple[Array, int]]:
        """The surface's point (3,) nearest to each of `at` [m], and its triangle."""
        return [nearest(self._triangles, np.array(point) * self.scale) for point in self.at]

    @property
    def source(self) -> Path:
        """The solid's file."""
        return place_of_file(self.file)

    @cached_property
    def points(self) -> Array:
        """Marker centres in the target frame, shape (N, 3) [m]: the surface's points nearest to `at`."""
        return np.array([point for point, _ in self._nearest])

    @cached_property
    def normals(self) -> Array:
        """The surface's outward unit normals at the markers, shape (N, 3)."""
        a, b, c = np.moveaxis(self._triangles[[i for _, i in self._nearest]], 1, 0)
        normal = np.cross(b - a, c - a)
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)

    @property
    def body(self) -> Body:
        """The solid."""
        return Body(self._triangles, (self.color[0], self.color[1], self.color[2]))

    @property
    def shows_markers(self) -> bool:
        """Whether the markers are drawn."""
        return self.draw_markers

    def hides(self, T_target_camera: Array) -> NDArray[np.bool_]:
        """Which markers the solid hides from a camera at a pose (4, 4) in the target's frame, shape (N,)."""
        return hidden_by(self._triangles, T_target_camera[:3, 3], self.points, self.marker.height_m + HIDDEN_M)
