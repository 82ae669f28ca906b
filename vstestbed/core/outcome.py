"""How a run ends: a registry of outcomes, each with all that pages, tables and programs say of it.

OVERHEATED = vs.Outcome("overheated", "a motor grew too hot", letter="V", colour="#c22f2f")
    # of a plugin, whose monitors may then end a run with it
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import astuple, dataclass
from types import MappingProxyType
from typing import ClassVar

from vstestbed.core.errors import ParameterError

__all__ = ["Outcome", "Verdict"]


class _Outcomes(type):
    """All outcomes by their names, as an `Enum` has its members: `Outcome.converged`,
    `Outcome["converged"]`, `for outcome in Outcome`.
    """

    _known: ClassVar[dict[str, Outcome]] = {}

    @property
    def __members__(cls) -> Mapping[str, Outcome]:
        return MappingProxyType(cls._known)

    def __call__(cls, *values: object, **named: object) -> Outcome:
        made: Outcome = super().__call__(*values, **named)
        for known in cls:
            if known.name != made.name and not (made.letter and made.letter == known.letter):
                continue
            if astuple(known) == astuple(made):  # of a plugin that is imported again, or a worker
                return known
            taken = f"name {made.name!r} or letter {made.letter!r} is that of {known.name!r}"
            raise ParameterError("Outcome", f"{taken} ({known.value}); choose another", made.value)
        cls._known[made.name] = made
        return made

    def __getattr__(cls, name: str) -> Outcome:
        if name in cls._known:
            return cls._known[name]
        raise AttributeError(f"no outcome {name!r}; those known are {', '.join(cls._known)}")

    def __getitem__(cls, name: str) -> Outcome:
        return cls._known[name]

    def __iter__(cls) -> Iterator[Outcome]:
        return iter(tuple(cls._known.values()))

    def __len__(cls) -> int:
        return len(cls._known)


# eq=False: compared by identity, which workers keep
@dataclass(frozen=True, eq=False, repr=False)
class Outcome(metaclass=_Outcomes):
    """How a run ended.

    Raises ParameterError: another outcome has this name, or this letter.

    Attributes:
        name: its word in logs, tables and scenarios. value: the sentence that the user reads.
        success: whether the task was done: the exit status of a command is 0 then, else 3.
        out_of_time: whether the run ended because its time was over, with its task not done.
        letter: what stands for it in a map's cells; "" for none. colour: its colour in maps.
    """

    name: str
    value: str
    success: bool = False
    out_of_time: bool = False
    letter: str = ""
    colour: str = "#000000"

    def __repr__(self) -> str:
        return f"<Outcome.{self.name}: {self.value!r}>"

    def __reduce__(self) -> tuple[object, ...]:
        return Outcome, astuple(self)


Verdict = tuple[Outcome, str]  # an outcome with its reason, in words

# The colours differ in lightness as well as in hue (after Okabe & Ito 2008), so that colour-blind
# readers can distinguish them, also in a grey print; blues are of the converged.
Outcome("converged", "the goal was reached and held", success=True)
Outcome("completed", "the task was kept in its band for the whole duration", success=True)
Outcome("landed", "the craft touched down on its pad", success=True)
Outcome("inserted", "the plug sits in its socket", success=True)
Outcome("target_lost", "the target was out of sight for too long", letter="L", colour="#f3c04b")
Outcome("local_minimum", "the law orders rest away from the goal", letter="M", colour="#a0287a")
Outcome("diverged", "the camera left for the far distance", letter="D", colour="#33150a")
Outcome(
    "timed_out",
    "the time ran out before the goal was reached",
    out_of_time=True,
    letter="T",
    colour="#9c9c9c",
)
Outcome(
    "unstable",
    "the loop swung or grew until the time ran out",
    out_of_time=True,
    letter="U",
    colour="#4f7a1e",
)
Outcome("unreachable", "the robot cannot stand where the run would begin", letter="R")
Outcome("crashed", "the simulation became unstable", letter="C")
Outcome("joint_limit", "a joint stood at its limit and the law asked for more", letter="J")
Outcome(
    "singular",
    "the robot stood at a singular configuration and the law asked for a motion it cannot make",
    letter="S",
)
Outcome("collided", "the robot touched something", letter="H")
Outcome("overturned", "the craft tilted by more than 60 degrees", letter="O")
Outcome("jammed", "the plug stuck before its depth", letter="P")
Outcome("rotor_limit", "a rotor stood at its limit for too long", letter="W")
Outcome("law_failed", "the law failed, and the robot was stopped", letter="F")
Outcome("interrupted", "the run was interrupted", letter="I")
