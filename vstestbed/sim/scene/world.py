"""The surroundings: floor, scenery, occluding plates, decoys, clutter, windows, wind."""

from __future__ import annotations

import colorsys
import math
import pathlib
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, inverse
from vstestbed.core.named_files import absolute_file
from vstestbed.core.quantity import (
    Angles,
    Length,
    Position,
    PositiveGain,
    PositiveLength,
    PositiveTime,
    TighterBounds,
    Time,
    check_range,
)
from vstestbed.core.spec import Shorthand, spec
from vstestbed.effects.wind import Wind
from vstestbed.imaging.flicker import STEADY, Flicker
from vstestbed.targets.motion import PLATE_MOTIONS, MotionBase, Path, Still
from vstestbed.targets.picture import picture_name, place_of_picture, read_rgb


@spec
class Floor:
    """The surface of the floor, in place of the room's matte grey checker; scenery that has a floor
    of its own shows that.

    Rays compute the highlight in every pixel; OpenGL at the corners of a grid of 0.05 m, between
    which it interpolates, and for which the floor is drawn for 10 m about the origin in place of 20
    m. Of a picture of 640 x 480 in software OpenGL (6.5 ms) gloss or windows take 12 ms more, a
    mirror 1.5 ms; by rays (115 ms) gloss takes 15 ms, a window 45 ms more. A texture costs nothing
    measurable.

    Args:
        texture: a picture that covers the floor in tiles: a PNG or JPEG file, or a bundled texture
            as of target `picture`, such as `texture:brick`; none: the room's checker. Where r, g
            and b differ by 60 grey levels the detectors `blobs` and `lines` may take parts of it
            for markers; e.g. `texture:brick`.
        tile_m: width of one tile along x; its height follows from the picture [m].
        albedo: by which the colours of the texture are multiplied [1].
        gloss: share of a lamp's light that the floor mirrors as a highlight (h . n)^`sharpness`, h
            halfway between the directions to the lamp and to the camera [1].
        sharpness: exponent of the highlight, which falls to a half at acos(2^(-1/sharpness)) from
            the mirror direction, as angle of h: 10 degrees at 45 [1].
        mirror: by which the mirrored picture of what stands on the floor is multiplied and added to
            its colour; the sky is not mirrored. It needs OpenGL, and rays refuse it [1].

    Reference: Blinn 1977, doi:10.1145/563858.563893.
    """

    texture: str | None = None
    tile_m: Annotated[PositiveLength, TighterBounds(ge=0.01)] = 1.0
    albedo: Annotated[float, Gt(0), Le(1)] = 1.0
    gloss: Annotated[float, Ge(0), Le(1)] = 0.0
    sharpness: Annotated[float, Ge(1), Le(128)] = 45.0
    mirror: Annotated[float, Ge(0), Lt(1)] = 0.0

    def __post_init__(self) -> None:
        """Read the texture, and remember where it is."""
        if self.texture is not None:
            try:
                # frozen; a run remembers where its picture is
                object.__setattr__(self, "texture", picture_name(self.texture))
                read_rgb(place_of_picture(self.texture))
            except ParameterError as error:
                raise ParameterError("texture", error.problem, error.found) from None


Shape = Literal["ball", "disc", "box"]
DISC_HALF_M = 1e-3  # half the thickness of a disc [m]
Share = Annotated[float, Ge(0), Le(1)]


@spec
class Decoy:
    """A distractor: a ball, a disc or a cube of a marker's colour, without collisions.

    Args:
        xyz: position [m]; e.g. `[1.5, 0.3, 0.7]`.
        shape: a disc, 2 mm thick, spans its own x and y axes.
        radius: of the ball or the disc, half the edge of the cube [m].
        hue_deg: its hue; markers have 0, 360/n, ... [deg].
        saturation, albedo: of its colour, as of markers [1].
        rpy_deg: how it is turned, as a pose [deg].
        motion: displacement from there.
    """

    xyz: Position
    shape: Shape = "ball"
    radius: PositiveLength = 0.02
    hue_deg: Annotated[float, Ge(0), Lt(360)] = 0.0
    saturation: Share = 1.0
    albedo: Share = 1.0
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    motion: Annotated[MotionBase, PLATE_MOTIONS] = Still()

    @property
    def color(self) -> tuple[float, float, float]:
        """Its colour (r, g, b) in 0..1."""
        return colorsys.hsv_to_rgb(self.hue_deg / 360, self.saturation, self.albedo)

    @property
    def half_sizes(self) -> tuple[float, float, float]:
        """Sizes of its geom [m], in MuJoCo's order."""
        r = self.radius
        return {"ball": (r, 0.0, 0.0), "disc": (r, DISC_HALF_M, 0.0), "box": (r, r, r)}[self.shape]


@spec
class Clutter:
    """Distractors at random places in a box, drawn from the seed: each place uniform, each size
    uniform, each hue one of several.

    Object i is the same whatever their number. They may stand in each other and before the target:
    choose the box so that they do not, or so that they do. 20 objects take 1 ms of a picture's 6.5
    ms in software OpenGL.

    Args:
        pose: middle and axes of the box in the world; discs face along its z axis, and cubes stand
            turned about it; e.g. `{xyz: [1.8, 0, 0.7], rpy_deg: [0, -90, 0]}`.
        size_m: edges of the box along its axes [m].
        count: number of objects [1].
        shapes: what is drawn, each as often.
        radius_m: smallest and largest radius [m].
        hues: of the `markers`, each as often, or `any`.
        saturation, albedo: of their colours [1].
        placed: the objects; none: they are drawn from the seed; e.g. `[{xyz: [1.5, 0.3, 0.7]}]`.
    """

    pose: Pose
    size_m: Annotated[tuple[PositiveLength, ...], Len(3, 3)] = (1.0, 1.0, 0.2)
    count: Annotated[int, Ge(0), Le(100)] = 10
    shapes: Annotated[tuple[Shape, ...], Len(1, 3)] = ("ball", "disc", "box")
    radius_m: Annotated[tuple[PositiveLength, ...], Len(2, 2)] = (0.01, 0.03)
    hues: Literal["markers", "any"] = "markers"
    saturation: Annotated[float, Gt(0), Le(1)] = 1.0
    albedo: Annotated[float, Gt(0), Le(1)] = 1.0
    placed: Annotated[tuple[Decoy, ...], Len(0, 100)] = ()

    def __post_init__(self) -> None:
        check_range(self, "radius_m")

    def draw(self, rng: np.random.Generator, hues_deg: Sequence[float]) -> tuple[Decoy, ...]:
        """The objects of a run. rng: of the run. hues_deg: of the markers [deg]."""
        decoys = []
        for own in rng.spawn(self.count):
            place = own.uniform(-0.5, 0.5, 3)
            shape, size, hue, turn = own.random(4).tolist()
            z = math.tau * turn
            T = np.eye(4)
            T[:3, :3] = [[math.cos(z), -math.sin(z), 0], [math.sin(z), math.cos(z), 0], [0, 0, 1]]
            T[:3, 3] = place * self.size_m
            pose = Pose.of(self.pose.T @ T)
            kind = self.shapes[int(shape * len(self.shapes))]
            radius = self.radius_m[0] + size * (self.radius_m[1] - self.radius_m[0])
            hue_deg = 360 * hue
            if self.hues == "markers" and hues_deg:
                hue_deg = hues_deg[int(hue * len(hues_deg))]
            decoy = Decoy(
                xyz=pose.xyz,
                rpy_deg=pose.rpy_deg,
                shape=kind,
                radius=radius,
                hue_deg=hue_deg,
                saturation=self.saturation,
                albedo=self.albedo,
            )
            decoys.append(decoy)
        return tuple(decoys)


def path_from(rest: Array, motion: MotionBase) -> Path:
    """Pose (4, 4) as a function of time [s] of what moves from its pose at rest (4, 4)."""
    displacement = motion.path(np.random.default_rng(0))
    return lambda t: rest @ displacement(t)


LAMP = "lamp"  # name of the body of a lamp that moves
SAMPLES_S = (0.0, 0.37, 1.13, 2.9, 7.3, 41.0)
"""Times at which it is checked whether a motion turns a lamp [s]; they have no common period."""
Colour = Annotated[tuple[Annotated[float, Ge(0), Le(1)], ...], Len(3, 3)]


@spec
class Light:
    """One lamp and an even light from all sides, in place of the room's own light and of the lights
    of scenery.

    A surface of colour c with normal n has c (ambient + brightness max(0, n . l)) for each channel,
    l towards the lamp, at most 1.

    Args:
        direction: along its rays in the world, of any length; the room's own comes from behind the
            robots' side, from above [1].
        xyz: place of the lamp, which shines into the half space along `direction`, equally far [m];
            none: it is as far as the sun; e.g. `[0.5, 1.2, 2]`.
        brightness: of what faces the lamp [1].
        ambient: of what does not [1].
        color: of the lamp and of the light from all sides: red, green and blue, by which both are
            multiplied [1].
        motion: displacement of the lamp from its place, along the world's axes; its angles turn
            `direction`. A lamp without `xyz` is so far that they alone count. Shading and shadows
            (`camera.shadows`) move with it; a random walk is the same in all runs. It costs no
            time.
        flicker: of both lights, against the camera's shutter.
    """

    direction: Annotated[tuple[Annotated[float, Ge(-1e6), Le(1e6)], ...], Len(3, 3)] = (
        0.45,
        0.45,
        -1.0,
    )
    xyz: Position | None = None
    brightness: Annotated[float, Ge(0), Le(5)] = 0.6
    ambient: Annotated[float, Ge(0), Le(5)] = 0.5
    color: Colour = (1.0, 1.0, 1.0)
    motion: Annotated[MotionBase, PLATE_MOTIONS] = Still()
    flicker: Flicker = STEADY

    def __post_init__(self) -> None:
        if not 1e-6 < math.hypot(*self.direction) < 1e6:
            raise ParameterError.bound("direction", ">", "0 in length", list(self.direction))
        if self.xyz is None and self.motion.moves:
            path = self.path()
            if all(np.allclose(path(t)[:3, :3], np.eye(3), atol=1e-9) for t in SAMPLES_S):
                words = (
                    "must turn a lamp that is as far as the sun; works: {kind: sinusoid,"
                    " amplitude: {rpy_deg: [20, 0, 0]}, frequency_hz: 0.2},"
                    " or give the lamp a place, xyz"
                )
                raise ParameterError("motion", words, self.motion.kind)

    def path(self) -> Path:
        """Pose (4, 4) of the lamp as a function of time [s], at rest along the world's axes; of one
        without a place about the origin.
        """
        return path_from(Pose(xyz=self.xyz or (0.0, 0.0, 0.0)).T, self.motion)


@spec
class WindowPane:
    """A bright pane, such as a window or a lamp's diffuser, which shines along its z axis by
    Lambert's law.

    A surface of colour c whose normal makes an angle a with the direction to the pane's middle, at
    a distance d and at an angle b from the pane's z axis, gets the light c brightness cos a cos b A
    / (A + pi d^2) of a pane of area A. It is the light of a small Lambertian surface far away,
    and on its axis the exact one of a disc of this area. It casts no shadows; the pane itself is
    drawn with its brightness, at most white. A glossy surface shows it as a highlight, gloss
    brightness cos b A/(A + pi d^2) (n + 1)/2 (h . n)^s of `world.floor.sharpness` s: about the
    mirror direction a lobe cos^n, n = s/4, whose integral over the half space is 1.

    Args:
        pose: its middle and axes in the world; it spans its x and y axes, and shines along z;
            e.g. `{xyz: [1, 2, 1.5], rpy_deg: [90, 0, 0]}`.
        width, height: size along x and y [m].
        brightness: of the pane, 1 for white; the light that it sheds is in proportion to it, also
            above 1 [1].

    Reference: Howell, Menguc, Daun & Siegel 2020, Thermal Radiation Heat Transfer, 7th ed.,
    configuration factors (element to disc: A/(A + pi d^2), with A = pi r^2).
    """

    pose: Pose
    width: PositiveLength = 1.2
    height: PositiveLength = 1.0
    brightness: Annotated[float, Gt(0), Le(100)] = 1.0


@spec
class Plate:
    """An opaque plate that stands in the room from `from_s` until `until_s`; it can hide markers,
    and touches nothing.

    Args:
        pose: its centre in the world; the plate spans its x and y axes; e.g.
            `{xyz: [1.2, 0, 0.7], rpy_deg: [0, 90, 0]}`.
        width, height: size along x and y [m].
        from_s, until_s: when it is present [s].
        motion: displacement from its pose, in its own axes; a random walk is the same in all runs.
    """

    pose: Pose
    motion: Annotated[MotionBase, PLATE_MOTIONS] = Still()
    width: PositiveLength = 0.5
    height: PositiveLength = 0.5
    from_s: Time = 0.0
    until_s: PositiveTime = 1e9

    def __post_init__(self) -> None:
        if self.until_s <= self.from_s:
            raise ParameterError.bound(
                "until_s", "after", f"from_s = {self.from_s:g} s", self.until_s
            )


@spec
class Scenery:
    """Tables, walls, floors and lights by an MJCF file, which stand still; `sim/scene/scenery.py`
    says what becomes of its parts.

    In YAML its file's name alone is enough.

    Args:
        file: an MJCF file, absolute, relative to the scenario's file, or `package:NAME/path` inside
            an installed package; e.g. `scenery/workshop.xml`.
        pose: place of its origin in the world.
    """

    file: str
    pose: Pose = Pose()

    def __post_init__(self) -> None:
        """Make the name independent of the folder: a run remembers where its scenery is."""
        object.__setattr__(self, "file", absolute_file(self.file, pathlib.Path.cwd()))


@spec
class World:
    """The surroundings of robot and target.

    Args:
        scenery: an MJCF file round the experiment: its name, or a block with a pose.
        floor_z: height of the floor [m]; scenes in a textbook's coordinates need it out of the way.
        floor_friction: Coulomb friction between the floor and wheels or feet, an upper bound of
            their own [1]; .05 is ice; e.g. `0.3`.
        plates: can occlude markers, or cast a shadow on them (`camera.shadows`).
        decoys: can be taken for markers.
        clutter: more of them, drawn from the seed; none: no more; e.g.
            `{pose: {xyz: [1.8, 0, 0.7]}, count: 5}`.
        wind: acts on flying craft.
        light: in place of the room's own light; none: that light.
        windows: bright panes, which add to the light; OpenGL has lamps for four.
        floor: what the floor looks like.
    """

    scenery: Annotated[Scenery | None, Shorthand("file")] = None
    floor_z: Length = 0.0
    floor_friction: Annotated[PositiveGain, TighterBounds(le=10)] | None = None
    plates: Annotated[tuple[Plate, ...], Len(0, 100)] = ()
    decoys: Annotated[tuple[Decoy, ...], Len(0, 100)] = ()
    wind: Wind = Wind()
    light: Light | None = None
    clutter: Clutter | None = None
    windows: Annotated[tuple[WindowPane, ...], Len(0, 4)] = ()
    floor: Floor = Floor()

    def __post_init__(self) -> None:
        if self.scenery is not None:
            # here: MuJoCo is imported where there is any
            from vstestbed.sim.scene.scenery import check_scenery

            try:
                check_scenery(self.scenery.file, self.scenery.pose.T, self.floor_z)
            except ParameterError as error:
                raise ParameterError("scenery", error.problem, error.found) from None

    @property
    def hides(self) -> bool:
        """Whether there is what can hide a marker: plates, scenery, windows."""
        return bool(self.plates or self.scenery or self.windows)

    @property
    def distractors(self) -> tuple[Decoy, ...]:
        """All that can be taken for markers: `decoys`, and the clutter of this run."""
        return self.decoys if self.clutter is None else self.decoys + self.clutter.placed

    @property
    def draws(self) -> bool:
        """Whether a seed makes a difference: to the clutter, or to the turbulence that a craft
        meets.
        """
        return (
            self.clutter is not None and not self.clutter.placed
        ) or self.wind.turbulence_mps > 0

    @property
    def movers(self) -> dict[str, Path]:
        """Poses (4, 4) as functions of time [s] of what may have another place at another time, by
        the names of their bodies.
        """
        found = {f"plate_{i}": plate_path(plate) for i, plate in enumerate(self.plates)}
        for i, decoy in enumerate(self.distractors):
            rest = Pose(xyz=decoy.xyz, rpy_deg=decoy.rpy_deg).T
            found[f"decoy_{i}"] = path_from(rest, decoy.motion)
        if self.light is not None and self.light.motion.moves:
            found[LAMP] = self.light.path()
        return found

    @property
    def light_differs(self) -> bool:
        """Whether light differs within a flat surface, which OpenGL computes at corners alone: it
        must have many.
        """
        return bool(self.windows or self.floor.gloss) or (
            self.light is not None and self.light.xyz is not None
        )

    def scenery_before(
        self, T_world_camera: Array, p_camera: Array, slack: float
    ) -> tuple[str, ...]:
        """Which part of the scenery hides each of points p_camera (N, 3) from a camera at a pose
        (4, 4); "" where none does.

        slack: what is nearer to a point than this does not hide it [m].
        """
        if self.scenery is None:
            return ("",) * len(p_camera)
        # here: MuJoCo is imported where there is any
        from vstestbed.sim.scene.scenery import parts_before

        return parts_before(
            self.scenery.file, inverse(self.scenery.pose.T) @ T_world_camera, p_camera, slack
        )


AWAY = np.array([0.0, 0.0, -50.0])
"""Place of plates outside of their time: under the floor [m]. MuJoCo cannot remove a geom from a
compiled model.
"""


def plate_path(plate: Plate) -> Path:
    """Pose (4, 4) of a plate as a function of time [s]."""
    there = path_from(plate.pose.T, plate.motion)
    away = plate.pose.T.copy()
    away[:3, 3] = AWAY
    # 1e-9: times are sums of steps, and a plate must come in the very frame of from_s.
    return lambda t: there(t) if plate.from_s - 1e-9 <= t < plate.until_s - 1e-9 else away
