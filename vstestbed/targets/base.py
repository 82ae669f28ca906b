"""The contract of a target and its defaults: pose in the world, marker, motion, landing pad.

Target frame: the markers of a planar target lie in z = 0, and z points away from a camera that
faces them, so that the goal view "1 m in front" is T_camera_target = (0, 0, 1) without rotation.
"""

from __future__ import annotations

import colorsys
import pathlib
from abc import abstractmethod
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Gt, Le, Len
from numpy.typing import NDArray
from pydantic import StringConstraints

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, inverse, transform
from vstestbed.core.quantity import Length, Mass, Position, PositiveLength
from vstestbed.core.spec import spec
from vstestbed.targets.markers import HUES_DEG, MARKERS, Disc, Marker
from vstestbed.targets.motion import MOTIONS, Carried, MotionBase, Path, Still
from vstestbed.targets.route import Route

if TYPE_CHECKING:
    from vstestbed.targets.picture import PictureTarget


Body = tuple[Array | float, tuple[float, float, float], bool]
"""A solid in the target's frame: its triangles (F, 3, 3) [m], counter-clockwise from outside, or
the radius of a sphere about the origin [m]; its colour in 0..1; whether the scene's lights shade
it, else its brightness is constant.
"""
# of a marker: it begins with a letter, so that it is no number
Name = Annotated[str, StringConstraints(pattern=r"^[^\W\d][\w .-]{0,31}$")]


@spec
class Pad:
    """A square plate to land on: centred at the target's origin, its upper side in the target's
    plane z = 0 (z down).

    Args:
        side: edge of the square [m].
        mass: what a vehicle that carries it has to bear [kg]; by default that of an aluminium
            honeycomb, 4 kg/m^2; e.g. `3.2`.
    """

    side: PositiveLength = 0.9
    mass: Mass | None = None

    @property
    def weight(self) -> float:
        """Its mass, given or by area [kg]."""
        return self.mass or 4.0 * self.side**2


@spec
class Socket:
    """A round hole for a plug: a tube on the front of the target, its axis along the target's z,
    the mouth towards the viewer.

    Args:
        radius: of the hole [m].
        depth: from the mouth to the bottom, which is in the target's plane [m].
        wall: thickness of the tube [m].
        xy: where its axis crosses the plane, in the target's frame [m].
        friction: Coulomb friction of what it touches [1].
    """

    radius: PositiveLength = 0.011
    depth: PositiveLength = 0.04
    wall: PositiveLength = 0.01
    xy: tuple[Length, Length] = (0.0, 0.0)
    friction: Annotated[float, Gt(0), Le(2)] = 0.3


@spec
class Target:
    """All that other rooms read of a target, with defaults for everything but `kind` and `points`.

    Args:
        pose: its place in the world; of one that is carried or held, in the frame of what holds it.
        marker: what marks each of its points.
        motion: how it moves from there.
        pad: a plate to land on; None: no plate; e.g. `{side: 0.9}`.
        socket: a hole for a plug; None: none; e.g. `{radius: 0.011, depth: 0.04}`.
        names: names of its markers, in their order, for messages, figures and `goal.markers`; none:
            they are numbered; e.g. `[top left, top right, bottom right, bottom left]`.
    """

    pose: Pose
    marker: Annotated[Marker, MARKERS] = Disc()
    motion: Annotated[MotionBase, MOTIONS] = Still()
    pad: Pad | None = None
    socket: Socket | None = None
    names: Annotated[tuple[Name, ...], Len(0, 24)] = ()

    # whether only its front has markers: seen from behind its plane it counts as lost
    one_sided: ClassVar[bool] = False
    outlined: ClassVar[bool] = False
    """Whether its points are the outline of one region of one colour, in order, and not markers
    that can be told apart.
    """
    # a field of some; without markers its picture or its body shows what is to be seen of them
    draw_markers = True

    @cached_property
    @abstractmethod
    def points(self) -> Array:
        """Marker centres in the target frame, shape (N, 3) [m]."""
        ...

    @property
    def places(self) -> Array:
        """The markers with a fixed place in the target frame, shape (K, 3) [m]: all, except for
        lines on the floor.
        """
        return self.points

    @property
    def stripes(self) -> tuple[tuple[Array, Array], ...]:
        """Left and right edge of each line painted on the floor, (K, 2) each in the target frame
        [m]; empty for other targets.
        """
        return ()

    @property
    def painted_route(self) -> Route | None:
        """The route along which lines are painted on the floor; None for a target of markers."""
        return None

    @property
    def floor_path(self) -> Array:
        """Points on the floor along the carrier's route, or along painted lines, every centimetre,
        (K, 2) [m]; else empty.
        """
        if self.carrier is None:
            return np.empty((0, 2))
        return self.carrier.route.samples[1]

    @property
    def board_half_m(self) -> tuple[float, float] | None:
        """Half the edges of the board behind the markers, along x and y [m]; None where there is no
        board.
        """
        return None

    @property
    def sheet(self) -> PictureTarget | None:
        """Itself, if a picture is in its plane; None without one."""
        return None

    @property
    def body(self) -> Body | None:
        """The solid that carries the markers, or whose outline they are; None without one."""
        return None

    @cached_property
    def normals(self) -> Array:
        """Unit normals of flat markers in the target frame, towards their viewers, shape (N, 3)."""
        return np.tile([0.0, 0.0, -1.0], (len(self.points), 1))

    @property
    def source(self) -> pathlib.Path | None:
        """The file that it was made from, its field `file`, which a run's folder keeps; None
        without one.
        """
        return None

    @property
    def moves(self) -> bool:
        """Whether it does not stand still in the world."""
        return self.motion.moves

    @property
    def on_gripper(self) -> bool:
        """Whether the robot's gripper holds it, and the camera stands in the room (eye to hand)."""
        return self.motion.on_gripper

    @property
    def carrier(self) -> Carried | None:
        """The vehicle that carries it, with its route and speed; None without one."""
        return self.motion.carrier

    def path(self, rng: np.random.Generator) -> Path:
        """Its pose in the world (4, 4) as a function of time, for a target that moves by itself or
        stands still.
        """
        # Displacements are in the target's own axes at rest: a motion turns with `pose`.
        rest = self.pose.T
        displacement = self.motion.path(rng)
        return lambda t: rest @ displacement(t)

    @property
    def T_world_start(self) -> Array:
        """Its pose in the world at the start (4, 4); in the gripper, the pose relative to the
        flange (`sim.base`).
        """
        return self.motion.start(self.pose.T)

    def points_at(self, T_camera_target: Array) -> Array:
        """Marker centres (..., N, 3) [m] in the frame of a camera that sees the target at a pose
        (..., 4, 4); NaN where it sees none.
        """
        return transform(T_camera_target, self.points)

    def seen_from(self, T_target_camera: Array) -> Array:
        """Marker centres in the frame of a camera at a pose (4, 4) in the target's, shape (N, 3)
        [m].
        """
        return self.points_at(inverse(T_target_camera))

    def by_size(self, ray: Array) -> Array | None:
        """Marker centres (N, 3) [m] from their unit rays (N, 3), NaN where unseen, and the known
        size; None where it does not tell.
        """
        return None

    @property
    def figure_corners(self) -> Array | None:
        """Corners of the polygon whose outline its points are, (E, 2) in z = 0 of the target frame
        [m]; None for other targets.
        """
        return None

    def round_outline(self, ray: Array) -> tuple[Array, Array] | None:
        """The outline that fits unit rays (K, 3) to the border of a round region; None where none
        fits, or the outline is not round.

        It is given as directions of its points in the camera's frame (N, 3), with how far each ray
        is off it (K,), as a share of its apparent radius.
        """
        return None

    def hides(self, T_target_camera: Array) -> NDArray[np.bool_]:
        """Which markers its own body hides from a camera at a pose (4, 4) in the target's frame,
        shape (N,).
        """
        return np.zeros(len(self.points), bool)

    def called(self, i: int) -> str:
        """Marker i as messages and figures call it: `2`, or with its name `2 (bolt)`."""
        return f"{i} ({self.names[i]})" if self.names else str(i)

    def number(self, marker: int | str) -> int:
        """The number of a marker, given by its number or its name; -1 for a name that no marker
        has.
        """
        if isinstance(marker, int):
            return marker
        return self.names.index(marker) if marker in self.names else -1

    @cached_property
    def hues_deg(self) -> tuple[float, ...]:
        """One hue for each marker [deg], by which detectors identify the markers: those given, or
        spread evenly from red on.
        """
        given = self.marker.hues
        if given:
            return tuple(hue if isinstance(hue, float) else HUES_DEG[hue] for hue in given)
        n = len(self.points)
        return tuple(360 * i / n for i in range(n))

    @cached_property
    def hue_gap_deg(self) -> float:
        """Smallest difference between two markers' hues that are not the same [deg]; 360 of one hue
        alone.
        """
        hues = sorted({hue % 360 for hue in self.hues_deg})
        return min(b - a for a, b in pairwise([*hues, hues[0] + 360.0]))

    @cached_property
    def colors(self) -> Array:
        """The colours of these hues with the marker's saturation and albedo, shape (N,
        3) in 0..1.
        """
        marker = self.marker
        return np.array(
            [
                colorsys.hsv_to_rgb(hue / 360, marker.saturation, marker.albedo)
                for hue in self.hues_deg
            ]
        )

    def _check_markers(self) -> None:
        p = self.points
        # 1e9 on the diagonal: a marker's distance to itself is no gap, and a single marker has
        # none.
        gaps = np.linalg.norm(p[:, None] - p[None], axis=-1) + np.eye(len(p)) * 1e9
        self.marker.check_spacing(float(gaps.min()), len(p))
        self._check_names()

    def _check_names(self) -> None:
        if self.names and len(self.names) != len(self.points):
            raise ParameterError.count(
                "names", len(self.points), "names, one for each marker, or none", list(self.names)
            )
        most = max(self.names, key=self.names.count, default="")
        if self.names.count(most) > 1:
            raise ParameterError.twice("names", most, list(self.names))


# the board behind a square reaches this many marker radii beyond the markers' edges
BOARD_MARGIN = 1.5


def in_plane(xy: Array) -> Array:
    """Points (..., 3) of a target's plane z = 0, by their x and y (..., 2)."""
    return np.concatenate([xy, np.zeros((*xy.shape[:-1], 1))], axis=-1)


@spec
class Square(Target):
    """Four markers at the corners of a square in z = 0: (-,-), (+,-), (+,+), (-,+) times side/2.

    Args:
        side: edge of the square, between centres of markers [m].
    """

    kind: Literal["square"] = "square"
    side: PositiveLength
    one_sided = True

    def __post_init__(self) -> None:
        self._check_markers()

    @cached_property
    def points(self) -> Array:
        """Corners in the target frame, shape (4, 3)."""
        h = self.side / 2
        return np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]])

    @property
    def board_half_m(self) -> tuple[float, float]:
        """The board reaches BOARD_MARGIN marker radii beyond the markers' edges."""
        half = self.side / 2 + (1 + BOARD_MARGIN) * self.marker.radius
        return half, half


@spec
class Points(Target):
    """Markers at any places.

    Args:
        at: the markers' centres in the target frame, a list of [x, y, z] [m].
    """

    kind: Literal["points"] = "points"
    at: Annotated[tuple[Position, ...], Len(1, 24)]

    def __post_init__(self) -> None:
        self._check_markers()

    @cached_property
    def points(self) -> Array:
        """Marker centres in the target frame, shape (N, 3)."""
        return np.array(self.at, dtype=float)
