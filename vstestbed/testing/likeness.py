"""Whether a law moves a robot as a bundled one does: both are given the same observations."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.core.registry import to_mapping
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import LAWS, Command, Law
from vstestbed.laws.base import inputs_of
from vstestbed.loop.isolated import Isolated, LawBlock
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.frame import Frame

__all__ = ["Likeness"]

# of the commands' size: pbvs and hybrid, the most alike on the course's tasks, differ by 0.085 and
# more there
ALIKE = 0.02
# settings that a law from elsewhere declares
SHARED = "depth", "limits", "visibility", "feedforward"
# fields of an observation that a law could compute of others, and by the goal; no further sensor
KNOWN = (
    *("xy", "xyw", "depth", "ray", "range", "radius_px", "T_camera_target", "relative"),
    *("motion", "robot"),
)


class Likeness:
    """Bundled laws that fly beside another one, by kind, and how far their commands are from its
    own.

    Of commands a and b their distance is that of a from the line along b, whatever the gain: sum
    |a - (a.b / b.b) b|^2 over the runs, as a share of sum |a|^2. Near the goal all laws order
    nearly the same, but little.

    What a law says of its command does not count, but what moves the robot. Two twists stand for
    it: the one that was ordered at last, after limits, secondary tasks and the supervisor; and that
    of the law's own velocities, before these turned it, as long as the one that was ordered. A
    bundled law is alike by either: a robot near a singularity turns the commands of all laws.

    settings: of the law in its task, by name; a kind has those that it knows.
    """

    def __init__(self, settings: dict[str, Any]):
        self.settings = settings
        self.laws: dict[str, Law[Any]] | None = None
        self.states = dict[str, Any]()
        self.apart = dict[str, Array]()  # by both twists
        self.size = np.zeros(2)
        self.given = dict[str, Array]()  # their twists in this frame
        self.own: Array | None = None

    def beside(self, scenario: Scenario) -> Scenario:
        """The scenario in which the bundled laws that could fly it have all that they read of an
        observation, whatever the judged law does: it could compute that itself. Raises what
        `Scenario` does.
        """
        law = scenario.law
        assert isinstance(law, Isolated)
        if self.laws is None:
            self.laws = dict(self._fitting(scenario))
            self.apart = {kind: np.zeros(2) for kind in self.laws}
        needed = {name for each in self.laws.values() for name in inputs_of(each)}
        return replace(scenario, law=replace(law, also=tuple(sorted(needed - {*inputs_of(law)}))))

    def begin(self, goal: Goal) -> None:
        """A run of the law begins, or goes on to another goal view."""
        for kind, each in (self.laws or {}).items():
            self.states[kind] = each.init(goal)

    def step(self, seen: Observation, goal: Goal, basis: Array, command: Command) -> None:
        """What the law was given, and what it orders."""
        laws = self.laws or {}
        self.given = {}
        for kind, law in list(laws.items()):
            try:
                self.states[kind], other = law.step(self.states[kind], seen, goal, basis)
            except Exception:  # it cannot fly this task
                self.apart.pop(kind)
                laws.pop(kind)
                continue
            self.given[kind] = other.twist
        if command.rates is None or seen.robot is None:
            self.own = command.twist
        else:  # these move the robot, whatever the twist says
            self.own = seen.robot.J @ command.rates

    def frame(self, frame: Frame) -> None:
        """What the robot was ordered by it."""
        if self.own is None:  # the law had failed before
            return
        ordered = frame.twist
        most = float(np.linalg.norm(self.own))
        said = self.own * (float(np.linalg.norm(ordered)) / most if most > 0.0 else 0.0)
        self.own = None
        both = np.stack([said, ordered])
        squares = np.einsum("ij,ij->i", both, both)
        self.size += squares
        for kind, other in self.given.items():
            square = float(other @ other)
            self.apart[kind] += squares - ((both @ other) ** 2 / square if square > 0.0 else 0.0)

    def found(self, allowed: tuple[str, ...]) -> str:
        """The bundled kind whose commands are the law's, "" where none, or one that is allowed."""
        known = self.size > 0
        alike: dict[str, float] = {}
        for kind, apart in self.apart.items():
            share = float(np.min(apart[known] / self.size[known], initial=math.inf))
            if share <= ALIKE**2:
                alike[kind] = share
        if not alike or set(alike) & set(allowed):
            return ""
        return min(alike, key=lambda kind: alike[kind])

    def _fitting(self, scenario: Scenario) -> Iterator[tuple[str, Law[Any]]]:
        """The kinds that could fly the scenario, with the judged law's settings."""
        law = scenario.law
        shared = {name: to_mapping(getattr(law, name)) for name in SHARED}
        for kind, made in LAWS.members.items():
            if kind == law.kind:
                continue  # to make another of these would end its process
            known = {
                name: value
                for name, value in (shared | self.settings).items()
                if name in made.__dataclass_fields__
            }
            with suppress(Exception):  # of settings that it has not, or without its file
                own = LawBlock(law={"kind": kind, **known}).law  # pyright: ignore[reportArgumentType] - a block
                if set(inputs_of(own)) <= {*inputs_of(law), *KNOWN}:
                    replace(scenario, law=own)  # refused where the task is not one of this kind
                    own.prepare()
                    yield kind, own
