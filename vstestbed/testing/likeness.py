"""Whether a law orders what a bundled one orders: both are given the same observations."""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated, Any

from vstestbed.core.geometry import Array
from vstestbed.core.registry import to_mapping
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import LAWS, Command, Law
from vstestbed.laws.base import inputs_of

# of the commands' size: pbvs and hybrid, the most alike on the course's tasks, differ by 0.085 and
# more there
ALIKE = 0.02
# settings that a law from elsewhere declares
SHARED = "depth", "limits", "visibility", "feedforward"


@spec
class _Beside:
    law: Annotated[Law[Any], LAWS]


class Likeness:
    """Bundled laws that fly beside another one, by kind, and how far their commands are from its
    own.

    Of commands a and b their distance is that of a from the line along b, whatever the gain: sum
    |a - (a.b / b.b) b|^2 over the runs, as a share of sum |a|^2. Near the goal all laws order
    nearly the same, but little.

    settings: of the law in its task, by name; a kind has those that it knows.
    """

    def __init__(self, settings: dict[str, Any]):
        self.settings = settings
        self.laws: dict[str, Law[Any]] | None = None
        self.states = dict[str, Any]()
        self.apart = dict[str, float]()
        self.size = 0.0

    def begin(self, law: Law[Any], goal: Goal) -> None:
        """A run of the law begins."""
        if self.laws is None:
            self.laws = dict(self._fitting(law))
            self.apart = dict.fromkeys(self.laws, 0.0)
        for kind, each in self.laws.items():
            self.states[kind] = each.init(goal)

    def step(self, seen: Observation, goal: Goal, basis: Array, command: Command) -> None:
        """A frame of it: what it was given, and what it ordered."""
        size = float(command.twist @ command.twist)
        self.size += size
        laws = self.laws or {}
        for kind, law in list(laws.items()):
            try:
                self.states[kind], other = law.step(self.states[kind], seen, goal, basis)
            except Exception:  # it cannot fly this task
                self.apart.pop(kind)
                laws.pop(kind)
                continue
            along = float(command.twist @ other.twist)
            square = float(other.twist @ other.twist)
            self.apart[kind] += size if square == 0.0 else size - along**2 / square

    def found(self, allowed: tuple[str, ...]) -> str:
        """The bundled kind whose commands are the law's, "" where none, or one that is allowed."""
        alike = [
            kind
            for kind, apart in self.apart.items()
            if self.size > 0 and apart <= ALIKE**2 * self.size
        ]
        if not alike or set(alike) & set(allowed):
            return ""
        return min(alike, key=lambda kind: self.apart[kind])

    def _fitting(self, law: Law[Any]) -> Any:
        """The kinds that need nothing that this law is not given, with its settings."""
        given = set(inputs_of(law))
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
                own = _Beside(law={"kind": kind, **known}).law  # pyright: ignore[reportArgumentType] - a block
                if set(inputs_of(own)) <= given:
                    own.prepare()
                    yield kind, own
