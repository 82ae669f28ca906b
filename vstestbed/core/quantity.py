"""Physical quantities of a scenario as types: a number with its bounds, and the reason for them.

Every number in a spec is of one of these types or has bounds of its own. The bounds are far beyond
any experiment, and keep what is computed from the numbers finite and in memory. Without them 1e308
is a valid length, its square is infinite, and a singular value decomposition of infinities may
never return.

    radius: PositiveLength = 0.02
        # of a physical quantity
    speed_mps: Annotated[PositiveSpeed, TighterBounds(le=3)] = 1.0
        # with a tighter bound of this one field
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Ge, Gt, Le, Len
from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from vstestbed.core.errors import ParameterError

__all__ = [
    "GRAVITY",
    "Angle",
    "AngleWidth",
    "Angles",
    "Bias",
    "Bounded",
    "Broadcast",
    "Coefficient",
    "Distance",
    "Duration",
    "Frequencies",
    "Frequency",
    "GainOrZero",
    "Length",
    "Mass",
    "Pixel",
    "Pixels",
    "Position",
    "PositiveAngle",
    "PositiveGain",
    "PositiveGrey",
    "PositiveLength",
    "PositivePixels",
    "PositiveRate",
    "PositiveRateDeg",
    "PositiveShare",
    "PositiveSpeed",
    "PositiveTime",
    "Seed",
    "Share",
    "Sigma",
    "SignedGain",
    "Speed",
    "Stiffness",
    "TighterBounds",
    "Time",
    "Torque",
    "Velocity",
    "check_ordered",
    "check_range",
]


@dataclass(frozen=True)
class Bounded:
    """Bounds of a quantity, for `Annotated`: a number beyond them is refused with a sentence that
    has both and says `why`. unit: as messages show it; "" for a pure number, and where fields of
    several units share the type.
    """

    low: float
    high: float
    unit: str
    why: str

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        number = core_schema.int_schema if source is int else core_schema.float_schema
        words = (
            f"must be {_shown(self.low)}"
            f" to {_shown(self.high)}{self.unit and ' '}{self.unit} ({self.why})"
        )
        bounds = core_schema.custom_error_schema(
            number(ge=self.low, le=self.high),  # pyright: ignore[reportArgumentType]
            "out_of_bounds",
            custom_error_message=words,
        )
        return core_schema.chain_schema([handler(source), bounds])

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        inner = handler(schema)
        low = max(self.low, inner.get("minimum", self.low))
        high = min(self.high, inner.get("maximum", self.high))
        return inner | {"minimum": low, "maximum": high}


@dataclass(frozen=True)
class TighterBounds:
    """Tighter bounds of one field of a quantity, for `Annotated` of its type: pydantic's own would
    be missing in the JSON Schema.
    """

    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        schema: Any = handler(source)
        given = {name: bound for name, bound in vars(self).items() if bound is not None}
        schema["steps"][0].update(given)
        return schema


@dataclass(frozen=True)
class Broadcast:
    """For `Annotated` of a list with a value for each joint: a number alone stands for the list of
    it, which holds for all joints.
    """

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self._listed, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        listed = handler(schema)
        return {"anyOf": [listed, listed["items"]]}

    @staticmethod
    def _listed(value: Any) -> Any:
        if isinstance(value, int | float) and not isinstance(value, bool):
            return (value,)
        if not isinstance(value, list | tuple):
            raise PydanticCustomError(
                "one_for_all", "must be a number for all joints, or a list with one for each"
            )
        return value


def check_ordered(block: Any, low: str, high: str, equal: bool = True) -> None:
    """Refuse a field of a block that is over another one of it; equal: both may be the same."""
    smaller = getattr(block, low)
    larger = getattr(block, high)
    if smaller > larger or (smaller == larger and not equal):
        relation = "at most" if equal else "under"
        raise ParameterError.bound(low, relation, f"{high} = {larger:g}", smaller)


def check_range(block: Any, name: str, equal: bool = True) -> None:
    """Refuse a pair of numbers that is not the smallest and the largest value; equal: both may be
    the same.
    """
    smallest, largest = getattr(block, name)
    if smallest > largest or (smallest == largest and not equal):
        raise ParameterError.form(name, "[smallest, largest]", [smallest, largest])


def _shown(bound: float) -> str:
    """A bound as messages show it: whole numbers of an integer field with all digits."""
    return f"{bound:g}" if isinstance(bound, float) else str(bound)


_FAR = "five times the 200 m at which a camera counts as diverged"
Length = Annotated[float, Bounded(-1e3, 1e3, "m", _FAR)]  # a coordinate or an offset [m]
Distance = Annotated[float, Ge(0), Bounded(0.0, 1e3, "m", _FAR)]  # a length that may be 0 [m]
PositiveLength = Annotated[float, Gt(0), Bounded(1e-9, 1e3, "m", f"a nanometre to {_FAR}")]
# Three coordinates, amplitudes, or half widths of a box [m]
Position = Annotated[tuple[Length, ...], Len(3, 3)]

_TURNS = "100 turns; beyond them an angle loses digits of its direction"
Angle = Annotated[float, Bounded(-36e3, 36e3, "deg", _TURNS)]  # an angle [deg]
AngleWidth = Annotated[float, Ge(0), Bounded(0.0, 36e3, "deg", _TURNS)]
PositiveAngle = Annotated[
    float, Gt(0), Bounded(1e-6, 36e3, "deg", f"4 milliarcseconds to {_TURNS}")
]
Angles = Annotated[tuple[Angle, ...], Len(3, 3)]  # three angles [deg]

_FAST = "in one second as far as any length"
Speed = Annotated[float, Ge(0), Bounded(0.0, 1e3, "m/s", _FAST)]  # a speed that may be 0 [m/s]
PositiveSpeed = Annotated[
    float, Gt(0), Bounded(1e-6, 1e3, "m/s", f"a micrometre a second to a kilometre, {_FAST}")
]
Velocity = Annotated[tuple[Annotated[float, Bounded(-1e3, 1e3, "m/s", _FAST)], ...], Len(3, 3)]
PositiveRate = Annotated[
    float, Gt(0), Bounded(1e-6, 1e3, "rad/s", "up to 160 turns a second, more than any robot makes")
]
PositiveRateDeg = Annotated[
    float,
    Gt(0),
    Bounded(1e-4, 36e3, "deg/s", "up to 100 turns a second, more than any robot makes"),
]

_AGES = "30 years, longer than any run"
# a time or a duration that may be 0 [s]
Time = Annotated[float, Ge(0), Bounded(0.0, 1e9, "s", _AGES)]
PositiveTime = Annotated[float, Gt(0), Bounded(1e-6, 1e9, "s", f"a microsecond to {_AGES}")]
Duration = Annotated[
    float,
    Gt(0),
    Bounded(1e-6, 86_400.0, "s", "a microsecond to a day, which a run is simulated at most"),
]
_PERIOD = "a period of three hours to one of a millisecond, a physics step"
Frequency = Annotated[float, Gt(0), Bounded(1e-4, 1e3, "Hz", _PERIOD)]  # a frequency [Hz]
Frequencies = Annotated[
    tuple[
        Annotated[float, Bounded(-1e3, 1e3, "Hz", "a period of a millisecond, a physics step")], ...
    ],
    Len(3, 3),
]
"""The frequency along each axis; a negative one runs backwards [Hz]."""

_QUICK = "a time constant of a microsecond, a thousandth of a physics step"
SignedGain = Annotated[float, Bounded(-1e6, 1e6, "", _QUICK)]
GainOrZero = Annotated[float, Ge(0), Bounded(0.0, 1e6, "", _QUICK)]
PositiveGain = Annotated[float, Gt(0), Bounded(1e-9, 1e6, "", f"one of 30 years to {_QUICK}")]

_STRONG = "a micronewton metre to a giganewton metre, more than any joint has"
# The torque of a hinge [Nm], or the force of a joint that slides [N]
Torque = Annotated[float, Gt(0), Bounded(1e-6, 1e9, "", _STRONG)]
Stiffness = Annotated[float, Gt(0), Bounded(1e-9, 1e9, "", "more than any servo has")]

_NOISE = "a larger error than any sensor's"
Sigma = Annotated[float, Ge(0), Bounded(0.0, 1e3, "", _NOISE)]
Bias = Annotated[tuple[Annotated[float, Bounded(-1e3, 1e3, "", _NOISE)], ...], Len(3, 3)]
"""The constant error of a sensor on each axis, in the unit of its field."""

_WIDE = "ten times the largest picture"
Pixels = Annotated[float, Ge(0), Bounded(0.0, 1e5, "px", _WIDE)]
"""A length in a picture that may be 0 [px], an area [px^2], or a speed in it [px/s]."""
PositivePixels = Annotated[
    float, Gt(0), Bounded(1e-12, 1e5, "px", f"far under what can be measured to {_WIDE}")
]
PositiveGrey = Annotated[
    float, Gt(0), Bounded(1e-6, 255.0, "", "the range of a picture's grey levels")
]
Pixel = Annotated[tuple[Annotated[float, Bounded(-1e5, 1e5, "px", _WIDE)], ...], Len(2, 2)]
"""A place in a picture (u, v), or the distance of two [px]."""

Coefficient = Annotated[float, Bounded(-1e6, 1e6, "", "more than any calibrated lens has")]
Share = Annotated[float, Ge(0), Le(1)]  # of a whole: none to all of it [1]
PositiveShare = Annotated[float, Gt(0), Le(1)]
GRAVITY = 9.81  # acceleration of free fall [m/s^2]
Mass = Annotated[float, Gt(0), Bounded(1e-6, 1e6, "kg", "a milligram to a thousand tonnes")]
Seed = Annotated[int, Ge(0), Bounded(0, 2**63 - 1, "", "what the tables of results hold")]
