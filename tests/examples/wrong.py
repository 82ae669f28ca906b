"""Kinds that break their contract, each in one way: the suites must say so."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, Literal

import numpy as np

from tests.examples.two_link import TwoLink
from vstestbed.core.spec import spec
from vstestbed.laws import IBVS, Command, LawBase
from vstestbed.robots import Omni
from vstestbed.targets import Square
from vstestbed.vision import Blobs, Oracle

COUNT = [0]


@spec
class Stateful(IBVS):
    """Its gain depends on how often it was asked."""

    kind: Literal["stateful"] = "stateful"

    def step(self, state: Any, observation: Any, goal: Any, basis: Any) -> Any:
        """One frame."""
        COUNT[0] += 1
        state, command = super().step(state, observation, goal, basis)
        factor = 1 + 0.001 * COUNT[0]
        return state, replace(command, u=command.u * factor, twist=command.twist * factor)


@spec
class Crooked(Omni):
    """It says that it can rise."""

    kind: Literal["crooked"] = "crooked"

    def motion_basis(self, mount: Any, q: Any) -> Any:
        """With a fourth motion."""
        return np.column_stack([super().motion_basis(mount, q), mount.to_camera[:, 2]])


@spec
class Shifted(Blobs):
    """Two pixels off."""

    kind: Literal["shifted"] = "shifted"
    markers: ClassVar[tuple[str, ...]] = Blobs.markers

    def detect(self, *given: Any) -> Any:
        """Beside the markers."""
        state, detection = super().detect(*given)
        return state, replace(detection, uv=detection.uv + 2.0)


@spec
class Rolling(Oracle):
    """It draws, and does not say so."""

    kind: Literal["rolling"] = "rolling"

    def detect(
        self, state: Any, picture: Any, view: Any, camera: Any, target: Any, rng: Any
    ) -> Any:
        """The true points, after a draw."""
        rng.random()
        return super().detect(state, picture, view, camera, target, rng)


@spec
class Displaced(Square):
    """Seen a millimetre off."""

    kind: Literal["displaced"] = "displaced"

    def seen_from(self, T_target_camera: Any) -> Any:
        """Off."""
        return super().seen_from(T_target_camera) + 1e-3


@spec
class Numb(TwoLink):
    """It measures no motion."""

    kind: Literal["numb"] = "numb"

    def measured_twist(self, *given: Any) -> Any:
        """Always at rest."""
        return np.zeros(6)


@spec
class Ghost(TwoLink):
    """Joints without a body."""

    kind: Literal["ghost"] = "ghost"
    body: ClassVar[None] = None


@spec
class Silent(LawBase):
    """It forgets to return."""

    kind: Literal["silent"] = "silent"

    def step(self, state: Any, observation: Any, goal: Any, basis: Any) -> Any:
        """Nothing."""


@spec
class Bare(LawBase):
    """It returns its velocities as they are."""

    kind: Literal["bare"] = "bare"

    def step(self, state: Any, observation: Any, goal: Any, basis: Any) -> Any:
        """One frame."""
        return state, np.zeros(basis.shape[1])


@spec
class Remembering(LawBase):
    """It keeps its state in itself."""

    kind: Literal["remembering"] = "remembering"

    def step(self, state: Any, observation: Any, goal: Any, basis: Any) -> Any:
        """One frame."""
        self.last = observation.t  # pyright: ignore[reportAttributeAccessIssue]  # the mistake


@spec
class Wild(LawBase):
    """It divides by zero."""

    kind: Literal["wild"] = "wild"

    def step(self, state: Any, observation: Any, goal: Any, basis: Any) -> Any:
        """NaN."""
        return state, Command(np.full(6, np.nan), np.full(6, np.nan))
