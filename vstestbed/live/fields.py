"""The fields of a scenario that a page has controls for, found by the types and bounds of its own specs."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from types import UnionType
from typing import Any, Literal

from annotated_types import Ge, Gt, Le, Lt

from vstestbed.core.quantity import GainOrZero, Narrower, PositiveGain, SignedGain, Within
from vstestbed.core.spec import OneOf, kind_of
from vstestbed.scenario.scenario import Scenario

Control = Literal["slider", "number", "choice", "switch"]
BLOCKS = ("law", "camera", "robot", "timing", "noise", "calibration", "detector")
"""Blocks of a scenario whose fields get controls; the others define what the experiment is."""
FIRST = "camera.latency_s", "noise.image_sigma", "noise.pixel_sigma_px", "camera.rate_hz", "seed"
"""Fields that a person turns first, after the law's gains; the others are folded away."""
LEFT_OUT = {"camera.mount", "camera.width", "camera.height", "robot.start", "robot.filled"}
HIGH = {
    "camera.latency_s": 0.4,
    "camera.rate_hz": 100.0,
    "camera.readout_s": 0.03,
    "camera.fovy_deg": 120.0,
    "timing.command_latency_s": 0.4,
    "timing.exposure_s": 0.04,
    "timing.exposure_jitter_s": 0.02,
    "timing.latency_jitter_s": 0.1,
    "timing.drop_probability": 0.9,
    "noise.image_sigma": 40.0,
    "noise.pixel_sigma_px": 5.0,
    "noise.dropout": 0.9,
    "calibration.depth_factor": 3.0,
    "law.smooth_start_s": 3.0,
    "law.smoothing_s": 1.0,
    "law.visibility.margin_px": 120.0,
    "law.speed_mps": 3.0,
}
"""Right ends of sliders: far over what is usual, far under what is valid."""
GAIN_HIGH, GAIN_TIMES = 4.0, 4.0
"""Right end of a gain's slider, at least this many times its value at the start."""
DISTORTION_END = 0.4
STEPS = 200


@dataclass(frozen=True)
class Field:
    """One control: the path of its field, what it is, its value in force.

    Attributes:
        path: dotted, as `--set` takes it. control: what shows it. value: number, word or truth.
        low, high, step: of a slider. choices: of a menu. whole: whether the number is a whole one. is_gain: of a law or a loop.
    """

    path: str
    control: Control
    value: Any
    low: float = 0.0
    high: float = 0.0
    step: float = 0.0
    choices: tuple[str, ...] = ()
    whole: bool = False
    is_gain: bool = False

    @property
    def block(self) -> str:
        """The first part of the path."""
        return self.path.partition(".")[0]

    @property
    def comes_first(self) -> bool:
        """Whether it is one of those that a person turns first."""
        return self.path in FIRST or (self.is_gain and self.block == "law")

    @property
    def label(self) -> str:
        """The path, without its block where that is written above."""
        return self.path if self.comes_first else self.path.partition(".")[2] or self.path


def fields_of(scenario: Scenario) -> list[Field]:
    """The controls of a scenario as it is now: those that come first, then block by block."""
    found = [Field("seed", "number", scenario.seed, whole=True)]
    for block in BLOCKS:
        hint = typing.get_type_hints(Scenario, include_extras=True)[block]
        value = getattr(scenario, block)
        found += [] if block in ("robot", "camera") else _kinds(block, hint, value)
        found += _inside(block, value)
    if hasattr(scenario.camera, "distortion"):
        now = getattr(scenario.camera, "distortion", None) or (0.0,) * 5
        end, step = DISTORTION_END, DISTORTION_END / STEPS
        found += [Field(f"camera.distortion.{i}", "slider", now[i], -end, end, step) for i in (0, 1)]
    rank = {path: i for i, path in enumerate(FIRST)}
    return sorted(found, key=lambda f: rank.get(f.path, -1) if f.comes_first else len(FIRST))


def _kinds(path: str, hint: Any, value: Any) -> list[Field]:
    """The menu of a block's kinds, where there are several."""
    rooms = [m for m in getattr(hint, "__metadata__", ()) if isinstance(m, OneOf)]
    if not rooms or len(rooms[0].members) < 2:
        return []
    return [Field(path, "choice", kind_of(type(value)), choices=tuple(sorted(rooms[0].members)))]


def _inside(path: str, value: Any) -> Iterator[Field]:
    """Controls of the fields of a block, and of the blocks in it."""
    hints = typing.get_type_hints(type(value), include_extras=True)
    for field in dataclasses.fields(value):
        inner = f"{path}.{field.name}"
        if field.init and field.name != "kind" and inner not in LEFT_OUT:
            yield from _of(inner, hints[field.name], getattr(value, field.name))


def _of(path: str, hint: Any, value: Any) -> Iterator[Field]:
    """Controls of one field."""
    base, metadata = _opened(hint)
    if typing.get_origin(base) is Literal:
        yield Field(path, "choice", str(value), choices=tuple(str(word) for word in typing.get_args(base)))
    elif isinstance(value, bool):
        yield Field(path, "switch", value)
    elif isinstance(value, int | float):
        yield _number(path, value, metadata, whole=base is int)
    elif dataclasses.is_dataclass(value):
        yield from _kinds(path, hint, value)
        shorthand = next((m.number for m in metadata if isinstance(m, OneOf)), None)
        if shorthand is not None and shorthand[0] == kind_of(type(value)):
            inner = typing.get_type_hints(type(value), include_extras=True)[shorthand[1]]
            yield _number(path, getattr(value, shorthand[1]), _opened(inner)[1], whole=False)
        else:
            yield from _inside(path, value)


def _opened(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """A type without None and its metadata, and the metadata."""
    metadata: tuple[Any, ...] = ()
    while True:
        if typing.get_origin(hint) in (typing.Union, UnionType):
            others = [t for t in typing.get_args(hint) if t is not type(None)]
            if len(others) != 1:
                return hint, metadata
            hint = others[0]
        elif hasattr(hint, "__metadata__"):
            metadata += hint.__metadata__
            hint = hint.__origin__
        else:
            return hint, metadata


def _bounds(metadata: tuple[Any, ...]) -> tuple[float, float]:
    """Smallest and largest number that a field's type allows."""
    lows, highs = [float("-inf")], [float("inf")]
    for m in metadata:
        if isinstance(m, Within):
            lows, highs = [*lows, m.low], [*highs, m.high]
        elif isinstance(m, Narrower):
            lows += [b for b in (m.gt, m.ge) if b is not None]
            highs += [b for b in (m.lt, m.le) if b is not None]
        elif isinstance(m, Ge | Gt):
            lows.append(float(getattr(m, "ge", getattr(m, "gt", lows[0]))))
        elif isinstance(m, Le | Lt):
            highs.append(float(getattr(m, "le", getattr(m, "lt", highs[0]))))
    return max(lows), min(highs)


def _number(path: str, value: float, metadata: tuple[Any, ...], whole: bool) -> Field:
    """A slider where its useful range is known, else a number to type."""
    gains = (*PositiveGain.__metadata__, *GainOrZero.__metadata__, *SignedGain.__metadata__)  # pyright: ignore[reportAttributeAccessIssue] - of Annotated
    is_gain = any(m in gains for m in metadata if isinstance(m, Within))
    high = HIGH.get(path, max(GAIN_HIGH, GAIN_TIMES * abs(value)) if is_gain else 0.0)
    if not high or whole:
        return Field(path, "number", value, whole=whole)
    low, top = _bounds(metadata)
    high = min(max(high, value), top)
    step = _round_step(high / STEPS)
    left = -high if low < 0 else min(step, value) if _positive(metadata) else 0.0
    return Field(path, "slider", value, low=left, high=high, step=step, is_gain=is_gain)


def _positive(metadata: tuple[Any, ...]) -> bool:
    return any(isinstance(m, Gt) and float(m.gt) == 0 for m in metadata)  # pyright: ignore[reportArgumentType] - bounds of numbers


def _round_step(step: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not larger."""
    power = 10.0 ** int(f"{step:e}".partition("e")[2])
    return next(m * power for m in (5, 2, 1) if m * power <= step * (1 + 1e-9))
