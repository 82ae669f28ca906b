"""What became slower or faster between two measurements of the benchmarks, beyond their noise."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.quantity import PositiveTime
from vstestbed.core.spec import spec
from vstestbed.scenario.load import text_of
from vstestbed.scenario.validation import build
from vstestbed.scenario.yaml_marks import plain_mapping

LEAST_CHANGE = 0.05
"""A smaller change of the median is not called one."""


@spec
class BesideFloor:
    """Wall times of a benchmark, each measured just before its floor, so that both meet the same load of the machine.

    Args:
        floor: what the floor is.
        seconds, floor_seconds: wall times [s], pair by pair.
    """

    floor: str
    seconds: Annotated[tuple[PositiveTime, ...], Len(1)]
    floor_seconds: Annotated[tuple[PositiveTime, ...], Len(1)]

    def __post_init__(self) -> None:
        """Refuse times without their floor."""
        if len(self.seconds) != len(self.floor_seconds):
            raise ParameterError("floor_seconds", f"must be {len(self.seconds)}, one for each of seconds", len(self.floor_seconds))

    @property
    def ratios(self) -> tuple[float, ...]:
        """Ratio of each pair, the smallest first."""
        return tuple(sorted(a / b for a, b in zip(self.seconds, self.floor_seconds, strict=True)))

    @property
    def ratio(self) -> float:
        """Median ratio of a pair; not the ratio of the medians, which different loads would distort."""
        return statistics.median(self.ratios)

    @property
    def medians_ms(self) -> tuple[float, float]:
        """Median wall time of the benchmark and of its floor [ms]."""
        return 1e3 * statistics.median(self.seconds), 1e3 * statistics.median(self.floor_seconds)


@spec
class Saved:
    """What `bench --all --json` prints.

    Args:
        machine: processor, cores, versions. timings: of each benchmark, by its name.
    """

    machine: dict[str, str]
    timings: dict[str, BesideFloor]


def read_saved(path: Path) -> Saved:
    """What an earlier `bench --all --json` printed into a file.

    Raises:
        ScenarioError: the file is not there, or holds something else.
    """
    plain, marks = plain_mapping(text_of(path), str(path), "`vstestbed bench --all --json` prints one")
    return build(Saved, plain, marks, str(path))


@dataclass(frozen=True, slots=True)
class SpeedChange:
    """A benchmark's ratio to its floor, before and after.

    Attributes:
        before, after: median ratios. share: relative change, .1 for a tenth slower.
        verdict: `slower` or `faster` where every pair of one measurement lies beyond every pair of the other, which two
            measurements of 5 pairs of the same thing do once in 126 times, and the medians differ by 5 % or more; else empty.
    """

    before: float
    after: float
    share: float
    verdict: str

    @classmethod
    def of(cls, before: BesideFloor, after: BesideFloor) -> SpeedChange:
        """The change of one benchmark."""
        share = after.ratio / before.ratio - 1
        apart = after.ratios[0] > before.ratios[-1] or after.ratios[-1] < before.ratios[0]
        verdict = ("slower" if share > 0 else "faster") if apart and abs(share) >= LEAST_CHANGE else ""
        return cls(before.ratio, after.ratio, share, verdict)


@dataclass(frozen=True, slots=True)
class SpeedChanges:
    """The changes of several benchmarks, by their names."""

    changes: dict[str, SpeedChange]

    @classmethod
    def between(cls, before: Mapping[str, BesideFloor], after: Mapping[str, BesideFloor]) -> SpeedChanges:
        """The change of every benchmark that both measurements have."""
        return cls({name: SpeedChange.of(before[name], one) for name, one in after.items() if name in before})

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON."""
        return asdict(self)["changes"]

    def as_text(self) -> str:
        """A table for the terminal, and a sentence on what became slower."""
        lines = [f"{'ratio to the floor':18}{'before':>8}{'now':>8}{'change':>9}"]
        lines += [
            f"{name:18}{c.before:8.2f}{c.after:8.2f}{100 * c.share:+7.0f} %  {c.verdict}".rstrip() for name, c in self.changes.items()
        ]
        slower = ", ".join(name for name, c in self.changes.items() if c.verdict == "slower")
        return "\n".join([*lines, "", f"slower beyond the noise: {slower or 'nothing'}"])
