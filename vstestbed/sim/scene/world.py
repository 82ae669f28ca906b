"""The surroundings: floor, scenery, occluding plates, decoys, clutter, windows, wind."""

from __future__ import annotations

import math
import pathlib
from typing import Annotated

import numpy as np
from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, inverse
from vstestbed.core.named_files import absolute_file
from vstestbed.core.quantity import Length, Narrower, PositiveGain, PositiveLength, PositiveTime, Speed, Time, Velocity
from vstestbed.core.spec import Shorthand, spec
from vstestbed.sim.scene.clutter import Clutter, Decoy, decoy_path
from vstestbed.sim.scene.floor import Floor
from vstestbed.sim.scene.lighting import LAMP, Light, WindowPane
from vstestbed.targets.motion import PLATE_MOTIONS, MotionBase, Path, Still


@spec
class Plate:
    """An opaque plate that stands in the room from `from_s` until `until_s`; it can hide markers, and touches nothing.

    Args:
        pose: its centre in the world; the plate spans its x and y axes; e.g. `{xyz: [1.2, 0, 0.7], rpy_deg: [0, 90, 0]}`.
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
        """Refuse an empty interval of time."""
        if self.until_s <= self.from_s:
            raise ParameterError("until_s", f"must be after from_s = {self.from_s:g} s", self.until_s)


@spec
class Gust:
    """A gust that comes and goes: v(t) = velocity/2 (1 - cos(2 pi (t - from)/duration)), the discrete gust of flight testing.

    Args:
        from_s, duration_s: when it begins, and how long it lasts [s].
        velocity_mps: at its peak, along world axes [m/s].

    Reference: MIL-F-8785C 1980, section 3.7.1.3 (a whole period of it).
    """

    from_s: Time
    duration_s: PositiveTime = 3.0
    velocity_mps: Velocity = (5.0, 0.0, 0.0)

    def at(self, t: float) -> Array:
        """Its velocity (3,) at a time [s]."""
        share = (t - self.from_s) / self.duration_s
        return np.array(self.velocity_mps) * (0.5 - 0.5 * math.cos(2 * math.pi * share)) if 0 < share < 1 else np.zeros(3)


@spec
class Wind:
    """The air's motion: a mean, gusts, and turbulence as a first-order Gauss-Markov process on each axis.

    Args:
        mean_mps: along world axes [m/s].
        gusts: added to the mean while they last.
        turbulence_mps: standard deviation of the turbulence [m/s].
        turbulence_s: its correlation time [s]: L/V of Dryden's longitudinal spectrum.

    Reference: Dryden's spectra as in MIL-F-8785C 1980; a hovering craft meets the longitudinal one at V = 0 only by the mean wind.
    """

    mean_mps: Velocity = (0.0, 0.0, 0.0)
    gusts: Annotated[tuple[Gust, ...], Len(0, 100)] = ()
    turbulence_mps: Speed = 0.0
    turbulence_s: PositiveTime = 1.0

    @property
    def still(self) -> bool:
        """No wind at all."""
        return not (any(self.mean_mps) or self.gusts or self.turbulence_mps)

    def at(self, t: float) -> Array:
        """Mean and gusts (3,) at a time [s]."""
        return sum((gust.at(t) for gust in self.gusts), np.array(self.mean_mps))


@spec
class Scenery:
    """Tables, walls, floors and lights by an MJCF file, which stand still; `sim/scene/scenery.py` says what becomes of its parts.

    In YAML its file's name alone is enough.

    Args:
        file: an MJCF file, absolute, relative to the scenario's file, or `package:NAME/path` inside an installed package;
            e.g. `scenery/workshop.xml`.
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
        floor_friction: Coulomb friction between the floor and wheels or feet, an upper bound of their own [1]; .05 is ice; e.g. `0.3`.
        plates: can occlude markers, or cast a shadow on them (`camera.shadows`).
        decoys: can be taken for markers.
        clutter: more of them, drawn from the seed; none: no more; e.g. `{pose: {xyz: [1.8, 0, 0.7]}, count: 5}`.
        wind: acts on flying craft.
        light: in place of the room's own light; none: that light.
        windows: bright panes, which add to the light; OpenGL has lamps for four.
        floor: what the floor looks like.
    """

    scenery: Annotated[Scenery | None, Shorthand("file")] = None
    floor_z: Length = 0.0
    floor_friction: Annotated[PositiveGain, Narrower(le=10)] | None = None
    plates: Annotated[tuple[Plate, ...], Len(0, 100)] = ()
    decoys: Annotated[tuple[Decoy, ...], Len(0, 100)] = ()
    wind: Wind = Wind()
    light: Light | None = None
    clutter: Clutter | None = None
    windows: Annotated[tuple[WindowPane, ...], Len(0, 4)] = ()
    floor: Floor = Floor()

    def __post_init__(self) -> None:
        """Refuse scenery that cannot stand here."""
        if self.scenery is not None:
            from vstestbed.sim.scene.scenery import check_scenery  # here: MuJoCo is imported where there is any

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
        """Whether a seed makes a difference: to the clutter, or to the turbulence that a craft meets."""
        return self.clutter is not None or self.wind.turbulence_mps > 0

    @property
    def movers(self) -> dict[str, Path]:
        """Poses (4, 4) as functions of time [s] of what may have another place at another time, by the names of their bodies."""
        found = {f"plate_{i}": plate_path(plate) for i, plate in enumerate(self.plates)}
        found |= {f"decoy_{i}": decoy_path(decoy) for i, decoy in enumerate(self.distractors)}
        return found | ({LAMP: self.light.path()} if self.light is not None and self.light.motion.moves else {})

    @property
    def light_differs(self) -> bool:
        """Whether light differs within a flat surface, which OpenGL computes at corners alone: it must have many."""
        return bool(self.windows or self.floor.gloss) or (self.light is not None and self.light.xyz is not None)

    def scenery_before(self, T_world_camera: Array, p_camera: Array, slack: float) -> tuple[str, ...]:
        """Which part of the scenery hides each of points p_camera (N, 3) from a camera at a pose (4, 4); "" where none does.

        slack: what is nearer to a point than this does not hide it [m].
        """
        if self.scenery is None:
            return ("",) * len(p_camera)
        from vstestbed.sim.scene.scenery import parts_before  # here: MuJoCo is imported where there is any

        return parts_before(self.scenery.file, inverse(self.scenery.pose.T) @ T_world_camera, p_camera, slack)


AWAY = np.array([0.0, 0.0, -50.0])
"""Place of plates outside of their time: under the floor [m]. MuJoCo cannot remove a geom from a compiled model."""


def plate_path(plate: Plate) -> Path:
    """Pose (4, 4) of a plate as a function of time [s]."""
    rest, displacement = plate.pose.T, plate.motion.path(np.random.default_rng(0))
    # 1e-9: times are sums of steps, and a plate must come in the very frame of from_s.
    away = rest.copy()
    away[:3, 3] = AWAY
    return lambda t: rest @ displacement(t) if plate.from_s - 1e-9 <= t < plate.until_s - 1e-9 else away
