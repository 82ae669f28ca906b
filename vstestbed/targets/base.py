"""Targets: where markers are in the target's frame, what they look like, how the target moves.

Target frame: for planar targets the markers lie in z = 0, and z points away from a camera that looks at them
squarely, so that the goal view "1 m in front" is T_camera_target = (0, 0, 1) without rotation.
"""

from __future__ import annotations

import colorsys
import math
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, Triple, inverse, transform
from vstestbed.core.planar import pose_on_ground
from vstestbed.core.spec import OneOf, spec
from vstestbed.targets.motion import OWN_MOTIONS, Circle, Line, Lissajous, Path, RandomWalk, Sinusoid, Still
from vstestbed.targets.route import AnyRoute

Radius = Annotated[float, Gt(0)]


@spec
class Disc:
    """A flat disc in the target's plane; radius [m]. Lit: shaded by the scene's lights, else of constant colour."""

    kind: Literal["disc"] = "disc"
    radius: Radius = 0.02
    lit: bool = True


@spec
class Sphere:
    """A ball round the marker point; radius [m]."""

    kind: Literal["sphere"] = "sphere"
    radius: Radius = 0.02
    lit: bool = True


Family = Literal[
    "apriltag_16h5",
    "apriltag_25h9",
    "apriltag_36h10",
    "apriltag_36h11",
    "aruco_4x4_50",
    "aruco_4x4_100",
    "aruco_4x4_250",
    "aruco_4x4_1000",
    "aruco_5x5_50",
    "aruco_5x5_100",
    "aruco_5x5_250",
    "aruco_5x5_1000",
    "aruco_6x6_50",
    "aruco_6x6_100",
    "aruco_6x6_250",
    "aruco_6x6_1000",
    "aruco_7x7_50",
    "aruco_7x7_100",
    "aruco_7x7_250",
    "aruco_7x7_1000",
]
"""Families of square tags. AprilTag: bits and least Hamming distance of two tags; ArUco: bits and number of tags."""
APRILTAGS = {"16h5": (4, 30), "25h9": (5, 35), "36h10": (6, 2320), "36h11": (6, 587)}
"""Bits along a side and number of tags of the AprilTag families."""


@spec
class Tag:
    """A square black-and-white tag in the target's plane; marker i carries the number first_id + i.

    A white quiet zone of one module surrounds the black square. Its rows run along the target's x, the first at the least y.

    Args:
        family: which set of tags.
        size: edge of the black square [m].
        first_id: the first marker's number.
        lit: shaded by the scene's lights, else of constant brightness.

    Reference: Olson 2011, doi:10.1109/ICRA.2011.5979561 (AprilTag); Garrido-Jurado et al. 2014,
    doi:10.1016/j.patcog.2014.01.005 (ArUco).
    """

    kind: Literal["tag"] = "tag"
    family: Family = "apriltag_36h11"
    size: Annotated[float, Gt(0)] = 0.1
    first_id: Annotated[int, Ge(0)] = 0
    lit: bool = True

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
        """Edge with the quiet zone [m]."""
        return self.size * (self.modules + 2) / self.modules

    @property
    def _family(self) -> tuple[int, int]:
        kind, bits, *count = self.family.split("_")
        return APRILTAGS[bits] if kind == "apriltag" else (int(bits[0]), int(count[0]))

    @property
    def radius(self) -> float:
        """Of the circle round the tag with its quiet zone [m]: what the tag needs, however it is turned."""
        return self.tile / math.sqrt(2)

    @property
    def corners(self) -> Array:
        """The black square's corners from its centre, shape (4, 3) [m], in the order in which detectors give them."""
        h = self.size / 2
        return np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]])


@spec
class Stripe:
    """Paint along a line on the floor, `width_m` wide [m]. Lit: shaded by the scene's lights, else of constant colour."""

    kind: Literal["stripe"] = "stripe"
    width_m: Annotated[float, Gt(0), Le(1)] = 0.03
    lit: bool = True

    @property
    def radius(self) -> float:
        """Half of its width [m]."""
        return self.width_m / 2


MARKERS = OneOf("marker", Disc, Sphere, Tag, default="disc")
Marker = Annotated[Disc | Sphere | Tag, MARKERS]


@spec
class Carried:
    """The target rides on a vehicle that drives along a route; `target.pose` is then where it sits in the vehicle's frame.

    The vehicle has the masses, wheels and servos of its model. Its driver knows where it is (he is no part of the experiment).

    Args:
        by: the vehicle's kind. It starts on the route.
        route: where it drives.
        speed_mps: how fast [m/s].
        from_m: how far along the route it starts [m].
    """

    kind: Literal["carried"] = "carried"
    by: Literal["car", "omni"] = "car"
    route: AnyRoute
    speed_mps: Annotated[float, Gt(0), Le(3)] = 0.5
    from_m: float = 0.0


@spec
class Held:
    """The robot's hand holds the target, and the camera stands in the room (eye to hand).

    `target.pose` is then where the target sits in the flange's frame, `camera.mount` where the camera stands in the world.
    """

    kind: Literal["held"] = "held"


MOTIONS = OneOf("motion", *OWN_MOTIONS, Carried, Held, default="still")
Motion = Annotated[Still | Line | Circle | Sinusoid | Lissajous | RandomWalk | Carried | Held, MOTIONS]


@spec
class Pad:
    """A plate to land on: its middle is the target's origin, its upper side the target's plane z = 0 (z down).

    Args:
        side: of the square [m].
        mass: where a vehicle carries it [kg]; by default an aluminium honeycomb of 4 kg/m^2.
    """

    side: Annotated[float, Gt(0)] = 0.9
    mass: Annotated[float, Gt(0)] | None = None

    @property
    def weight(self) -> float:
        """[kg]."""
        return self.mass or 4.0 * self.side**2


@spec
class Target:
    """What all targets share: pose in the world, marker, motion, a pad to land on.

    Subclasses give the `points`, and say which markers they may have.
    """

    pose: Pose
    marker: Disc | Sphere | Tag | Stripe = Disc()
    motion: Motion = Still()
    pad: Pad | None = None

    @cached_property
    def points(self) -> Array:
        """Marker centres in the target frame, shape (N, 3) [m]."""
        raise NotImplementedError

    @property
    def moves(self) -> bool:
        """Whether it does anything but stand in the world."""
        return not isinstance(self.motion, Still)

    @property
    def moves_by_itself(self) -> bool:
        """Whether it moves along a path of its own, whatever the vehicles and the robot do."""
        return self.moves and not isinstance(self.motion, Carried | Held)

    def path(self, rng: np.random.Generator) -> Path:
        """Its pose in the world (4, 4) as a function of time, for a target that moves by itself or stands still."""
        if isinstance(self.motion, Carried | Held):
            raise ParameterError("target.motion", "has no path of its own: it goes where it is carried")
        rest, displacement = self.pose.T, self.motion.path(rng)
        return lambda t: rest @ displacement(t)

    @property
    def T_world_start(self) -> Array:
        """Where it is at the start (4, 4); what the hand holds depends on the robot (`sim.scene.Parts.T_world_target`)."""
        if isinstance(self.motion, Carried):
            return pose_on_ground(self.motion.route.at(self.motion.from_m)[:3]) @ self.pose.T
        if isinstance(self.motion, Held):
            return self.pose.T
        return self.path(np.random.default_rng(0))(0.0)

    def seen_from(self, T_target_camera: Array) -> Array:
        """Marker centres in the frame of a camera at a pose (4, 4) in the target's, shape (N, 3) [m]."""
        return transform(inverse(T_target_camera), self.points)

    @cached_property
    def hues_deg(self) -> tuple[float, ...]:
        """One hue for each marker, spread evenly from red on [deg]: what tells the markers apart."""
        n = len(self.points)
        return tuple(360 * i / n for i in range(n))

    @cached_property
    def colors(self) -> Array:
        """The saturated colours of these hues, shape (N, 3) in 0..1."""
        return np.array([colorsys.hsv_to_rgb(hue / 360, 1.0, 1.0) for hue in self.hues_deg])

    def _check_markers(self) -> None:
        p, marker = self.points, self.marker
        gaps = np.linalg.norm(p[:, None] - p[None], axis=-1) + np.eye(len(p)) * 1e9
        if gaps.min() <= 2 * marker.radius:
            if isinstance(marker, Tag):
                most = gaps.min() / 2 / marker.radius * marker.size
                words = f"must be under {most:.4g} m: with its quiet zone a tag takes the room of a circle round it, and markers"
                raise ParameterError("marker.size", f"{words} are {gaps.min():.4g} m apart", marker.size)
            words = f"must be under half of the smallest gap between markers, {gaps.min():.4g} m"
            raise ParameterError("marker.radius", words, marker.radius)
        if isinstance(marker, Tag) and marker.first_id + len(p) > marker.count:
            words = f"must be at most {marker.count - len(p)}: family {marker.family} has {marker.count} tags, and {len(p)} are needed"
            raise ParameterError("marker.first_id", words, marker.first_id)


@spec
class Square(Target):
    """Four markers at the corners of a square in z = 0: (-,-), (+,-), (+,+), (-,+) times side/2."""

    kind: Literal["square"] = "square"
    marker: Marker = Disc()
    side: Annotated[float, Gt(0)]

    def __post_init__(self) -> None:
        """Refuse markers that overlap, and numbers that no tag has."""
        self._check_markers()

    @cached_property
    def points(self) -> Array:
        """Corners in the target frame, shape (4, 3)."""
        h = self.side / 2
        return np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]])


@spec
class Points(Target):
    """Markers anywhere: `at`, a list of [x, y, z] in the target frame [m]."""

    kind: Literal["points"] = "points"
    marker: Marker = Disc()
    at: Annotated[tuple[Triple, ...], Len(1, 24)]

    def __post_init__(self) -> None:
        """Refuse markers that overlap, and numbers that no tag has."""
        self._check_markers()

    @cached_property
    def points(self) -> Array:
        """Marker centres in the target frame, shape (N, 3)."""
        return np.array(self.at, dtype=float)
