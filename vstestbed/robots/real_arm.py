"""Arms with imperfections: elastic gears, ripple, encoders, current loops, errors of the geometry and of the gravity compensation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.effects.base import Effect
from vstestbed.effects.joints import (
    DRIVES_STEP_S,
    FINEST,
    CurrentLoops,
    ElasticJoints,
    Encoders,
    Gears,
    Motors,
    Ripple,
    each,
    quickest,
)
from vstestbed.effects.links import DisplacedLinks, GeometryError, Payload
from vstestbed.effects.strain_wave import StrainWave
from vstestbed.robots.allocation import Actuation
from vstestbed.robots.arm import Arm
from vstestbed.robots.base import Reading
from vstestbed.robots.chain import reader
from vstestbed.robots.realism import Realistic

SHORTEST_STEP_S = 1e-4
"""Shortest physics step that elastic gears may ask for [s]: twenty times the time of a run at 2 ms."""


@spec
class RealArm(Realistic, Arm):
    """An arm whose joints and links may have imperfections; without them it is that of its file, and knows itself exactly.

    Args:
        gears: elasticity and backlash; None: rigid, without play.
        strain_wave: the strain wave gears in its joints, of which `realism`, and `gears` without a stiffness, make springs and rotors;
            None: its joints are rigid with a preset that has no stiffness of its own; e.g. `{sizes: [20, 20, 20, 20, 14, 14, 0]}`.
        ripple: cogging and torque ripple of the motors; None: none.
        encoders: steps and eccentricity of what the joints read; None: exact.
        drives: lag and delay of the motors' torque; None: none.
        geometry_error: the true geometry where it differs from the arm's own model; None: it does not.
        gravity_error: share of the weight that the drives' gravity compensation leaves uncarried, negative for too much [1]; servos that
            hold a position without compensation then have one, and sag by what it leaves over kp; e.g. `0.05`.
        payload: a load at the flange; None: none.
    """

    gears: Gears | None = None
    strain_wave: StrainWave | None = None
    ripple: Ripple | None = None
    encoders: Encoders | None = None
    drives: CurrentLoops | None = None
    geometry_error: GeometryError | None = None
    gravity_error: Annotated[float, Ge(-1), Le(1)] | None = None
    payload: Payload | None = None

    def __post_init__(self) -> None:
        if self.realism != "none" and self._is_ideal:
            raise ParameterError("realism", "must be none with `actuation: ideal`; works: another actuation", self.realism)

    @property
    def _is_ideal(self) -> bool:
        return getattr(self, "actuation", "") == "ideal"  # a field of the subclasses

    @property
    def draws(self) -> bool:
        """Errors of its geometry."""
        return self.geometry_error is not None and self.geometry_error.draws

    @property
    def slides(self) -> NDArray[np.bool_]:
        """Which joints slide, (n,)."""
        return np.zeros(len(self.joints), dtype=bool)

    def idealised(self) -> Self:
        """The same arm with stiff servos and gears and without friction; its geometry and its payload stay what they are."""
        rigid = dict.fromkeys(("gears", "ripple", "encoders", "drives", "gravity_error"))
        return replace(self, **{"actuation": "ideal", "realism": "none", **rigid})

    def _check_effects(self) -> None:
        self.acting  # noqa: B018 - refuses what does not fit
        if self.encoders is not None:
            self.encoders.read(np.zeros(len(self.joints)), np.zeros(len(self.joints)), self.slides)
        for field in ("drives", "ripple", "gravity_error"):
            if self._is_ideal and getattr(self, field) is not None:
                raise ParameterError(field, "is for actuators with limits, and `actuation: ideal` has none; works: another actuation")

    @cached_property
    def elastic(self) -> ElasticJoints | None:
        """Its gears in plain numbers; None where it has none."""
        gears = self.gears
        if gears is None:
            return None
        k, stages, rotors = self._springs(gears)
        return ElasticJoints(self.joints, k, k * gears.damping_s, gears.play(k, self.slides), stages, rotors)

    @cached_property
    def acting(self) -> tuple[Effect, ...]:
        """Motors, gears, links, payload, and further ones."""
        found: list[Effect] = []
        if self.ripple is not None or self.drives is not None:
            ripple, slides = self.ripple or Ripple(), self.slides
            cogging = each("ripple.cogging_nm", ripple.cogging_nm, slides)
            found.append(Motors(cogging, each("ripple.cycles", ripple.cycles, slides), ripple.share, self.drives))
        if self.elastic is not None:
            found.append(self.elastic)
        if self.geometry_error is not None and (D := self.geometry_error.displacements(len(self.joints))) is not None:
            found.append(DisplacedLinks(self.joints, D))
        return (*found, *((self.payload,) if self.payload is not None else ()), *self.effects)

    def compensated(self, actuators: Actuation) -> Actuation:
        """A choice of actuators with the error of their gravity compensation."""
        return actuators if self.gravity_error is None else replace(actuators, gravity_error=self.gravity_error)

    def _springs(self, gears: Gears) -> tuple[Array, Array | None, Array | None]:
        """Stiffness (n,) and stages (n, m, 2) of the gears, inertia of the rotors (n,); None where there are none of its own."""
        preset = self.presets.get(self.realism, {}).get("gears")
        if gears.stiffness_nmprad:
            if self.strain_wave is not None and gears == preset:
                words = f"is given by realism {self.realism} and by strain_wave; works: robot.gears.stiffness_nmprad=[]"
                raise ParameterError("gears.stiffness_nmprad", words)
            return each("gears.stiffness_nmprad", gears.stiffness_nmprad, self.slides, turns=False), None, None
        if self.strain_wave is not None:
            return *self.strain_wave.curves(self.slides), self.strain_wave.rotors(self.slides)
        if gears != preset:
            words = "is missing; or give the catalogue sizes of its gears, e.g. robot.strain_wave: {sizes: [20]}"
            raise ParameterError("gears.stiffness_nmprad", words)
        return np.zeros(len(self.joints)), None, None

    @property
    def needed_step_s(self) -> float:
        """1 ms with `drives`, and what resolves the quickest vibration of the gears [s].

        Raises ParameterError: a stiffness that needs a shorter step than SHORTEST_STEP_S, or a joint without rotor.
        """
        step = np.inf if self.drives is None else DRIVES_STEP_S
        return step if self.gears is None else min(step, self._gears_step_s)

    @cached_property
    def _gears_step_s(self) -> float:
        assert self.elastic is not None and self.model is not None
        M, rotors = reader().inertias_at(self.model, self.joints, tuple(self.configuration().tolist()))
        rotors = rotors if self.elastic.rotors is None else self.elastic.rotors
        k = self.elastic.stiffest
        for i in np.flatnonzero((k > 0) & (rotors <= 0)).tolist():
            words = "must be 0 for {joint}, which has no rotor that could move by itself; give it an `armature` in its file{or_here}"
            raise self._too_stiff(i, float(k[i]), words)
        w, joint = quickest(M, rotors, k)
        step = FINEST / w if w else np.inf
        if step < SHORTEST_STEP_S:
            most = float(f"{k[joint] * (step / SHORTEST_STEP_S) ** 2:.2g}")
            needs = f"it vibrates at {w / 2 / np.pi:.0f} Hz, which needs physics steps of {1e6 * step:.0f} us"
            raise self._too_stiff(joint, float(k[joint]), f"must be 0 (rigid){{or_softer}} for {{joint}}: {needs}", most)
        return step

    def _too_stiff(self, joint: int, k: float, words: str, most: float = 0.0) -> ParameterError:
        """The refusal of a gear, by the field that has its stiffness k [Nm/rad]."""
        name = self.joints[joint]
        if self.gears is not None and self.gears.stiffness_nmprad:
            said = words.format(joint=name, or_here="", or_softer=f" or at most {most:g}")
            if len(self.gears.stiffness_nmprad) == 1:
                said += "; works: a list, with a value for each joint"
            return ParameterError("robot.gears.stiffness_nmprad", said, k)
        said = words.format(joint=name, or_here=", or its inertia in strain_wave.rotor_kgm2", or_softer="")
        return ParameterError("robot.strain_wave.sizes", said)

    def measured(self, q: Array, qd: Array, sensors: Mapping[str, list[float]], noise: Any) -> Reading:
        """What the encoders read of the rotors' angles q and speeds qd (n,) each."""
        return Reading(q, qd) if self.encoders is None else Reading(*self.encoders.read(q, qd, self.slides))

    def drawn(self, rng: np.random.Generator) -> Self:
        """The same arm with the errors of its geometry drawn from `rng`."""
        given = self.geometry_error
        error = given and given.drawn(len(self.joints), rng)
        return self if error is given else replace(self, geometry_error=error)
