"""What of a target is drawn besides its markers: a picture on a plane, a solid."""

from __future__ import annotations

from dataclasses import dataclass

from vstestbed.core.geometry import Array


@dataclass(frozen=True)
class Sheet:
    """A picture in the target's plane, its middle at the origin, its rows along x from the smallest y on.

    Attributes:
        width, height: of the picture [m].
        png: the picture as a PNG file, with a margin at its right and below that repeats the outermost pixels, of the right (lower) edge
            and then, since textures repeat themselves, of the left (upper) one.
        share: of the file's width and height that the picture takes up, without the margin.
        lit: shaded by the scene's lights, else of constant brightness.
        gloss: share of a light that it mirrors as a highlight, 0 to 1.
        albedo: by which the file's colours are multiplied.
    """

    width: float
    height: float
    png: bytes
    share: tuple[float, float]
    lit: bool
    gloss: float = 0.0
    albedo: float = 1.0


@dataclass(frozen=True, eq=False)
class Body:
    """A solid in the target's frame: corners of its triangles (F, 3, 3) [m], counter-clockwise from outside, and its colour in 0..1.

    lit: shaded by the scene's lights, else of constant brightness.
    """

    triangles: Array
    rgb: tuple[float, float, float]
    lit: bool = True


@dataclass(frozen=True)
class Globe:
    """A sphere about the target's origin: its radius [m], its colour in 0..1; lit: as of a `Body`."""

    radius: float
    rgb: tuple[float, float, float]
    lit: bool = True
