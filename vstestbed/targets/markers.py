"""Markers at a target's points: their shape, size and appearance."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from annotated_types import Ge, Len, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, lengths
from vstestbed.core.quantity import PositiveLength, Share, TighterBounds
from vstestbed.core.registry import Registry
from vstestbed.core.spec import spec

# fmt: off
Family = Literal[
    "apriltag_16h5", "apriltag_25h9", "apriltag_36h10", "apriltag_36h11",
    "aruco_4x4_50", "aruco_4x4_100", "aruco_4x4_250", "aruco_4x4_1000",
    "aruco_5x5_50", "aruco_5x5_100", "aruco_5x5_250", "aruco_5x5_1000",
    "aruco_6x6_50", "aruco_6x6_100", "aruco_6x6_250", "aruco_6x6_1000",
    "aruco_7x7_50", "aruco_7x7_100", "aruco_7x7_250", "aruco_7x7_1000",
]
# fmt: on
"""Families of square tags. AprilTag: bits and least Hamming distance of two tags; ArUco: bits and
number of tags.
"""
# bits along a side and number of tags
APRILTAGS = {"16h5": (4, 30), "25h9": (5, 35), "36h10": (6, 2320), "36h11": (6, 587)}
HALF_THICKNESS_M = 1e-4
"""Half height of a flat marker [m]: its front face lies at z = 0 of the target frame, its rim adds
under 0.02 px at 1 m.
"""
THIN = 0.02  # most of any thickness or gap, as a share of what is thin
HIDDEN_M, HIDDEN = 0.002, 0.01
"""What comes between camera and marker nearer to the marker than this [m], or this share of its
distance, does not hide it.
"""
HueName = Literal["red", "orange", "yellow", "green", "cyan", "blue", "violet", "magenta"]
HUES_DEG = dict(
    zip(get_args(HueName), (0.0, 30.0, 60.0, 120.0, 180.0, 240.0, 270.0, 300.0), strict=True)
)
Hue = HueName | Annotated[float, Ge(0), Lt(360)]
Solid = tuple[Literal["cylinder", "sphere", "box"], tuple[float, float, float]]
"""Shape of a marker and its half sizes [m], in MuJoCo's order: (radius, half height, 0), (radius,
0, 0), (x, y, z).
"""


def thin(size: float, most: float = HALF_THICKNESS_M) -> float:
    """Half the thickness of what is flat and of some size [m], or a gap behind it: `most`, of small
    things less.
    """
    return min(most, THIN * size)


class Marker:
    """The marker at each of a target's points; by default flat, of one colour, its front face in
    the target's plane z = 0.

    Attributes:
        radius: of its circumscribed circle [m]. lit: whether the scene's lights shade it; otherwise
            its brightness is constant.
        saturation, albedo: of its colour, S and V of HSV (V also of a texture's white); 1 is the
            pure colour.
        hues: of all markers of a target, as `RoundMarker` has them; none: spread evenly.
        solid: shape and half sizes of its geom (`Solid`); None for one that is the edge of the
            target's body.
        height_m: how far it rises from the target's plane towards the camera [m].
        textured: it has a printed texture (`vision.tags.printed`) instead of one colour.
    """

    kind: Any  # these without a type: kinds have a field or a property in their place
    radius: Any
    lit: Any
    solid: Any
    saturation: float = 1.0
    albedo: float = 1.0
    hues: Any = ()
    height_m: Any = 0.0
    textured: ClassVar[bool] = False

    def clearance_m(self, ways: Array) -> float:
        """How far before markers at `ways` from the camera, (N, 3) [m], a thing must be to hide
        one.
        """
        nearest = float(np.fmin.reduce(lengths(ways), axis=None, initial=np.inf))
        return float(self.height_m) + min(HIDDEN_M, HIDDEN * nearest)

    def looks(self, count: int) -> str:
        """What `count` of them are in a picture, in words."""
        return "dots of the markers' colours"

    def check_spacing(self, gap: float, count: int) -> None:
        """Refuse a marker too large for the smallest `gap` between the centres of `count` markers
        [m], or a kind that has fewer.
        """


@spec
class RoundMarker(Marker):
    """A disc or a ball.

    Args:
        radius: its radius [m].
        lit: whether the scene's lights shade it; otherwise its colour is constant.
        saturation: of its colour: 1 is pure, 0 grey; detector `blobs` needs 60 grey levels between
            r, g and b of the picture [1].
        albedo: share of the light that it throws back in its strongest channel; its grey level
            there is 255 albedo times the light [1].
        hues: colours of the target's markers in their order, each red, orange, yellow, green, cyan,
            blue, violet, magenta, or the hue of HSV; none: spread evenly from red on [deg]; e.g.
            `[red, green, blue, 300]`.
    """

    radius: PositiveLength = 0.02
    lit: bool = True
    saturation: Share = 1.0
    albedo: Share = 1.0
    hues: Annotated[tuple[Hue, ...], Len(0, 24)] = ()

    def check_spacing(self, gap: float, count: int) -> None:
        if self.hues and len(self.hues) != count:
            raise ParameterError.count(
                "marker.hues", count, "colours, one for each marker, or none", list(self.hues)
            )
        if gap <= 2 * self.radius:
            raise ParameterError.bound(
                "marker.radius",
                "under",
                f"half of the smallest gap between markers, {gap:.4g} m",
                self.radius,
            )


@spec
class Disc(RoundMarker):
    """A flat disc in the target's plane."""

    kind: Literal["disc"] = "disc"

    @property
    def solid(self) -> Solid:
        """A thin cylinder."""
        return "cylinder", (self.radius, thin(self.radius), 0.0)


@spec
class Sphere(RoundMarker):
    """A ball round the marker point."""

    kind: Literal["sphere"] = "sphere"

    @property
    def solid(self) -> Solid:
        """A sphere."""
        return "sphere", (self.radius, 0.0, 0.0)

    @property
    def height_m(self) -> float:
        """Its radius: its centre lies in the plane."""
        return self.radius


@spec
class Tag(Marker):
    """A square black-and-white tag in the target's plane; marker i carries the number first_id + i.

    A white quiet zone of one module surrounds the black square. Its rows run along the target's x,
    from the smallest y on.

    Args:
        family: which set of tags.
        size: edge of the black square [m].
        first_id: the first marker's number.
        lit: shaded by the scene's lights, else of constant brightness.
        albedo: share of the light that its white throws back [1].

    Reference: Olson 2011, doi:10.1109/ICRA.2011.5979561 (AprilTag); Garrido-Jurado et al. 2014,
    doi:10.1016/j.patcog.2014.01.005 (ArUco).
    """

    kind: Literal["tag"] = "tag"
    family: Family = "apriltag_36h11"
    size: PositiveLength = 0.1
    first_id: Annotated[int, Ge(0), Lt(2320)] = 0
    lit: bool = True
    albedo: Share = 1.0
    textured = True

    @property
    def modules(self) -> int:
        """Modules along the black square's edge, its border of one module on each side included."""
        return self._family[0] + 2

    @property
    def count(self) -> int:
        """How many tags the family has."""
        return self._family[1]

    @property
    def tile(self) -> float:
        """Edge of the tag with its quiet zone [m]."""
        return self.size * (self.modules + 2) / self.modules

    @property
    def _family(self) -> tuple[int, int]:
        # `apriltag_36h11`: bits and distance name the set. `aruco_4x4_50`: bits along a side, and
        # the number of tags.
        kind, bits, *count = self.family.split("_")
        return APRILTAGS[bits] if kind == "apriltag" else (int(bits[0]), int(count[0]))

    @property
    def solid(self) -> Solid:
        """A thin box, the quiet zone included."""
        return "box", (self.tile / 2, self.tile / 2, thin(self.tile))

    def looks(self, count: int) -> str:
        return (
            f"tags of family {self.family}, number {self.first_id} to {self.first_id + count - 1}"
        )

    def check_spacing(self, gap: float, count: int) -> None:
        if gap <= 2 * self.radius:
            most = gap / 2 / self.radius * self.size
            why = (
                "with its quiet zone a tag takes the room of a circle round it,"
                f" and markers are {gap:.4g} m apart"
            )
            raise ParameterError.bound("marker.size", "under", f"{most:.4g} m", self.size, why=why)
        if self.first_id + count > self.count:
            why = f"family {self.family} has {self.count} tags, and {count} are needed"
            raise ParameterError.bound(
                "marker.first_id", "at most", self.count - count, self.first_id, why=why
            )

    @property
    def radius(self) -> float:
        """Half the diagonal of the tag with its quiet zone [m], which no neighbour may cover: its
        room, however it is rotated.
        """
        # The quiet zone belongs to it: a neighbour that covers it would hide the black square's
        # edge.
        return self.tile / math.sqrt(2)

    @property
    def corners(self) -> Array:
        """The black square's corners relative to its centre, shape (4, 3) [m], in the order in
        which detectors report them.
        """
        h = self.size / 2
        return np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]])


@spec
class Stripe(Marker):
    """Paint along a line on the floor.

    Args:
        width_m: width of the line [m].
        lit: whether the scene's lights shade it; otherwise its colour is constant.
        saturation: of its colour: 1 is pure, 0 grey; detector `blobs` needs 60 grey levels between
            r, g and b of the picture [1].
        albedo: share of the light that it throws back in its strongest channel; its grey level
            there is 255 albedo times the light [1].
    """

    kind: Literal["stripe"] = "stripe"
    width_m: Annotated[PositiveLength, TighterBounds(le=1)] = 0.03
    lit: bool = True
    saturation: Share = 1.0
    albedo: Share = 1.0

    @property
    def solid(self) -> Solid:
        """None: paint follows the line (`sim.scene.compose`), and no other target has stripes."""
        raise ParameterError.excluded("target.marker", "stripe without target lines")

    @property
    def radius(self) -> float:
        """Half its width [m]."""
        return self.width_m / 2


MARKERS = Registry("marker", Disc, Sphere, Tag, default="disc")


@spec
class Outline(Marker):
    """The edge of a region of one colour, which is the target's body: its points have no geoms of
    their own.

    Args:
        lit: whether the scene's lights shade the region; otherwise its colour is constant.
    """

    kind: Literal["outline"] = "outline"
    lit: bool = True
    solid = None
    radius = 0.0

    def looks(self, count: int) -> str:
        return "a region of the target's colour"
