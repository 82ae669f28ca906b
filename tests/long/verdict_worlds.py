"""Simulated comparisons of which the truth is known, and how often the rule of a verdict is wrong
in them.

    python -m tests.long.verdict_worlds
        # counts all cells, and writes docs/kept/verdicts.csv and intervals.csv for the page

A world is a few laws, each with its rate of success and its times, from starts that are common to
them. A cell is a world with a number of starts; of each, thousands of comparisons are drawn and
judged by `words_of`, which is the rule of `vstestbed.report.comparison.verdict` for many draws at
once (`test_verdicts.py` holds both side by side).
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

from vstestbed.core.geometry import Array
from vstestbed.report.comparison.verdict import ALPHA, FEWEST_UNLIKE, MARGIN, ONE_PICTURE

KEPT = Path(__file__).parents[2] / "docs" / "kept" / "verdicts.csv"
INTERVALS = KEPT.with_name("intervals.csv")
DRAWS = 4000
STARTS = (10, 20, 30, 50, 100, 200)
OF_MANY = (20, 50, 100, 200)  # of 13 laws and more fewer starts decide nothing by time
MANY = 400_000  # starts by which the truth is known
TOGETHER = 1_000_000  # values that are in memory at a time
NO_VERDICT, A_BETTER, B_BETTER, TRADE = 0, 1, 2, 3


# The worlds.
@dataclass(frozen=True)
class Law:
    """What one law does from a start of difficulty u in [-1, 1], which is the same for all laws.

    rate: probability that nothing keeps it from the goal, by which it fails otherwise; slope: what
    u adds to it. time: mean time to the goal [s]. sd: of its time [s], by a noise of one of the
    NOISES. lapse: share of the starts from which it takes `lapse_s` longer.
    """

    rate: float
    time: float
    sd: float = 0.7
    noise: str = "normal"
    lapse: float = 0.0
    lapse_s: float = 0.0
    slope: float = 0.0


@dataclass(frozen=True)
class Task:
    """A share of the starts, with what each law does in them."""

    share: float
    laws: tuple[Law, ...]


@dataclass(frozen=True)
class World:
    """Laws and their common starts.

    limit [s]: of each run. spread [s]: of what u adds to the times of all. shared: share of the
    starts in which one draw decides about the failures of all laws. hard: share of the starts from
    which all fail. period [s]: of the pictures at whose ticks runs end. grid: the starts are the
    same in each draw, their u from -1 to 1. tasks: the starts are in strata.
    """

    kind: str
    name: str
    tasks: tuple[Task, ...]
    limit: float = 12.0
    spread: float = 1.0
    shared: float = 0.0
    hard: float = 0.0
    period: float = 0.0
    grid: bool = False

    @property
    def laws(self) -> int:
        return len(self.tasks[0].laws)

    @property
    def equal(self) -> bool:
        """Whether all laws are the same."""
        return all(len(set(task.laws)) == 1 for task in self.tasks)

    def strata(self, n: int) -> NDArray[np.intp]:
        """The task of each of n starts."""
        ends = np.round(np.cumsum([task.share for task in self.tasks]) * n).astype(int)
        ends[-1] = n
        return np.searchsorted(ends, np.arange(n), side="right")

    def draw(self, rng: np.random.Generator, draws: int, n: int) -> Flown:
        """So many comparisons of n starts."""
        task = self.strata(n)
        u = (
            np.broadcast_to(np.linspace(-1, 1, n), (draws, n))
            if self.grid
            else rng.uniform(-1, 1, (draws, n))
        )
        luck = rng.random((draws, self.laws, n))
        if self.shared:
            one_for_all = rng.random((draws, 1, n)) < self.shared
            luck = np.where(one_for_all, luck[:, :1], luck)
        alive = np.ones((draws, self.laws, n), dtype=bool)
        times = np.empty((draws, self.laws, n))
        for i in range(self.laws):
            for k, group in enumerate(self.tasks):
                law, of_task = group.laws[i], task == k
                shape = draws, int(of_task.sum())
                alive[:, i, of_task] = luck[:, i, of_task] < law.rate + law.slope * u[:, of_task]
                lapses = law.lapse_s * (rng.random(shape) < law.lapse) if law.lapse else 0.0
                times[:, i, of_task] = (
                    law.time
                    + self.spread * u[:, of_task]
                    + law.sd * NOISES[law.noise](rng, shape)
                    + lapses
                )
        if self.period:
            times = self.period * np.ceil(times / self.period)
        if self.hard:
            alive &= rng.random((draws, 1, n)) >= self.hard
        reached = alive & (times < self.limit)
        return Flown(reached, np.where(reached, np.maximum(times, 0.01), self.limit), alive)

    def truth(self, n: int) -> tuple[Array, Array]:
        """Rate of success and mean time of each law, a failure counted at the limit: those of many
        starts, (laws,) each.

        Laws that are the same in all tasks have the same values. Where no run is late the rate is
        the exact one.
        """
        same_for_all_n = not self.grid and len(self.tasks) == 1
        return _truth(self, 100 if same_for_all_n else n)

    def many(self, n: int) -> tuple[Array, Array]:
        """As `truth`, counted: two laws are known to 1 % of a standard deviation of their
        difference.
        """
        flown = self.draw(np.random.default_rng(7), MANY // n, n)
        rate = flown.reached.mean(axis=(0, 2))
        time = flown.times.mean(axis=(0, 2))
        late = flown.alive & ~flown.reached
        if not late.any():
            rate = self._exact_rate(n)
        for i, k in combinations(range(self.laws), 2):
            if all(task.laws[i] == task.laws[k] for task in self.tasks):
                rate[k], time[k] = rate[i], time[i]
        return rate, time

    def _exact_rate(self, n: int) -> Array:
        u = np.linspace(-1, 1, n) if self.grid else np.linspace(-1, 1, 20_001)
        task = self.strata(n)
        weights = np.bincount(task, minlength=len(self.tasks)) / n
        rates = np.zeros(self.laws)
        for i in range(self.laws):
            for k, group in enumerate(self.tasks):
                those = u[task == k] if self.grid else u
                law = group.laws[i]
                if len(those):
                    rates[i] += weights[k] * np.clip(law.rate + law.slope * those, 0, 1).mean()
        return rates * (1 - self.hard)


@cache
def _truth(world: World, n: int) -> tuple[Array, Array]:
    return world.many(n)


class Flown(NamedTuple):
    """Comparisons: (draws, laws, n)."""

    reached: NDArray[np.bool_]
    times: Array  # the limit where it failed
    alive: NDArray[np.bool_]  # whether only the limit could keep it from the goal


NOISES = {  # of mean 0 and standard deviation 1
    "normal": lambda rng, shape: rng.normal(size=shape),
    "uniform": lambda rng, shape: rng.uniform(-np.sqrt(3), np.sqrt(3), shape),
    "exponential": lambda rng, shape: rng.exponential(size=shape) - 1,
    "lognormal": lambda rng, shape: (
        (rng.lognormal(size=shape) - np.exp(0.5)) / np.sqrt((np.e - 1) * np.e)
    ),
    "humps": lambda rng, shape: 2.0 * rng.integers(0, 2, shape) - 1,
}


def of(kind: str, name: str, *laws: Law, **fields: Any) -> World:
    """A world without tasks."""
    return World(kind, name, (Task(1.0, laws),), **fields)


def worse_in_both() -> Iterator[World]:
    """The second law fails more often, and takes longer."""
    kind = "worse in success and in time"
    pairs = (
        (1.0, 4.0, 0.95, 4.2),
        (0.95, 4.0, 0.9, 5.0),
        (0.85, 5.0, 0.8, 5.5),
        (0.7, 4.0, 0.6, 4.3),
        (0.55, 5.0, 0.5, 5.2),
    )
    for limit in (12.0, 30.0, 60.0):
        for rate, time, other, slower in pairs:
            yield of(
                kind,
                f"{rate:g}, {time:g} s / {other:g}, {slower:g} s, limit {limit:g} s",
                Law(rate, time),
                Law(other, slower),
                limit=limit,
            )
    yield of(kind, "little: 1, 4 s / 0.98, 4.02 s", Law(1, 4, 0.3), Law(0.98, 4.02, 0.3))
    yield of(kind, "little, failures shared", Law(0.9, 4, 0.3), Law(0.88, 4.02, 0.3), shared=1.0)


def worse_by_the_margin() -> Iterator[World]:
    """The second law is quicker, and fails more often by exactly the margin."""
    kind = "success worse by the margin"
    for rate in (1.0, 0.95, 0.9, 0.8, 0.6):
        for shared in (0.0, 1.0):
            laws = Law(rate, 6), Law(rate - MARGIN, 3)
            yield of(
                kind,
                f"{rate:g}, 6 s / {rate - MARGIN:g}, 3 s{', shared' if shared else ''}",
                *laws,
                shared=shared,
            )
    yield of(kind, "1, 25 s / 0.9, 3 s, limit 30 s", Law(1, 25, 1), Law(0.9, 3, 1), limit=30.0)
    yield of(kind, "1, 6 s / 0.85, 3 s", Law(1, 6), Law(0.85, 3))
    yield of(kind, "1, 9 s / 0.8, 1.5 s", Law(1, 9, 0.4), Law(0.8, 1.5, 0.1))


def rare_failures() -> Iterator[World]:
    """The second law is quicker, but its failures cost more than that: truly later on average."""
    kind = "rare failures, long limits"
    for share, limit in (
        (0.005, 200.0),
        (0.01, 100.0),
        (0.02, 60.0),
        (0.03, 30.0),
        (0.05, 60.0),
        (0.05, 12.0),
        (0.08, 30.0),
    ):
        gain = 0.95 * share * (limit - 5) / (1 - share)
        for sd in (0.05, 0.7):
            laws = Law(1, 5, sd), Law(1 - share, 5 - gain, sd)
            yield of(
                kind,
                f"1, 5 s / {1 - share:g}, {5 - gain:.2f} s, sd {sd:g} s, limit {limit:g} s",
                *laws,
                limit=limit,
            )
    laws = Law(0.9, 5), Law(0.88, 4.4)
    yield of(
        kind, "both fail: 0.9, 5 s / 0.88, 4.4 s, limit 60 s, shared", *laws, limit=60.0, shared=1.0
    )


def knife_edges() -> Iterator[World]:
    """Runs end about at the limit, so that noise decides about success."""
    kind = "knife edges"
    for time, sd in ((11.5, 0.5), (11.9, 0.2), (12.0, 1.0), (10.5, 1.0)):
        for slower in (0.02, 0.1, 0.3):
            yield of(
                kind,
                f"{time:g} s / {time + slower:g} s, sd {sd:g} s",
                Law(1, time, sd),
                Law(1, time + slower, sd),
                spread=0.0,
            )
    yield of(kind, "starts as well", Law(1, 11, 0.3), Law(1, 11.1, 0.3))
    yield of(kind, "two humps", Law(1, 11, 1.2, "humps"), Law(1, 11.05, 1.2, "humps"), spread=0.2)
    yield of(
        kind,
        "one quick and often late: 9 s / 10 s +- 2.5 s",
        Law(1, 9, 0.5),
        Law(1, 10, 2.5),
        spread=0.0,
    )


def fragile_leads() -> Iterator[World]:
    """The second law is a little quicker from most starts, and much slower from few; both always
    arrive, or nearly.
    """
    kind = "fragile leads"
    for lapse, more in ((0.02, 20.0), (0.05, 10.0), (0.1, 6.0), (0.2, 3.0), (0.03, 22.0)):
        lead = 0.95 * lapse * more
        for sd in (0.02, 0.3):
            laws = Law(1, 5, sd), Law(1, 5 - lead, sd, lapse=lapse, lapse_s=more)
            yield of(
                kind,
                (
                    f"{lead:.2f} s quicker,"
                    f" from {lapse:g} of the starts {more:g} s slower, sd {sd:g} s"
                ),
                *laws,
                limit=30.0,
            )
    laws = Law(0.95, 5, 0.3), Law(0.93, 4.5, 0.3, lapse=0.1, lapse_s=6.0)
    yield of(kind, "with failures: 0.95 / 0.93", *laws, limit=30.0)
    yield of(
        kind, "skewed: exponential", Law(1, 5, 0.05), Law(1, 5.02, 1.0, "exponential"), limit=30.0
    )
    yield of(kind, "skewed: lognormal", Law(1, 5, 0.05), Law(1, 5.02, 1.5, "lognormal"), limit=60.0)


def ticks() -> Iterator[World]:
    """Runs end with a picture: many times are equal, and most differences are one period."""
    kind = "ticks of the camera's period"
    for period in (0.04, 0.2, 1.0):
        yield of(
            kind,
            f"{period:g} s, a tenth of it later",
            Law(1, 5, period / 3),
            Law(1, 5 + period / 10, period / 3),
            period=period,
        )
        laws = Law(1, 5, period / 10), Law(0.97, 5 - 0.9 * period, period / 10)
        yield of(kind, f"{period:g} s, one earlier but 0.97", *laws, period=period, spread=0.0)
        laws = Law(0.98, 5, period / 10), Law(0.95, 5 + period, period / 10)
        yield of(
            kind, f"{period:g} s, one later and 0.95", *laws, period=period, spread=0.0, limit=30.0
        )


def hard_starts() -> Iterator[World]:
    """From a share of the starts no law arrives."""
    kind = "hard starts that fail for all"
    for hard in (0.3, 0.6):
        yield of(kind, f"{hard:g}, worse in both", Law(0.95, 4), Law(0.9, 4.4), hard=hard)
        yield of(
            kind,
            f"{hard:g}, little worse in both",
            Law(1, 4),
            Law(0.98, 4.02),
            hard=hard,
            limit=30.0,
        )
        yield of(
            kind, f"{hard:g}, by the margin", Law(1, 6), Law(1 - MARGIN / (1 - hard), 3), hard=hard
        )
        laws = Law(1, 5, 0.1), Law(0.97, 5 - 0.95 * 0.03 * 55 / 0.97, 0.1)
        yield of(kind, f"{hard:g}, rare failures, limit 60 s", *laws, hard=hard, limit=60.0)
        laws = Law(1, 5, 0.1), Law(1, 4.62, 0.1, lapse=0.05, lapse_s=8.0)
        yield of(kind, f"{hard:g}, fragile lead", *laws, hard=hard, limit=30.0)


def strata() -> Iterator[World]:
    """Starts in tasks of unequal means; the truth is the mean over these tasks, each weighted as it
    has starts.
    """
    kind = "tasks as strata"
    easy, far = (Law(1, 3), Law(1, 3.1)), (Law(0.9, 8), Law(0.85, 8.2))
    yield World(kind, "easy and far, worse in both", (Task(0.6, easy), Task(0.4, far)))
    tasks = Task(0.8, (Law(1, 4), Law(1, 3))), Task(0.2, (Law(1, 8), Law(0.5, 6)))
    yield World(kind, "fails in half of one task of five: by the margin", tasks)
    tasks = Task(0.9, (Law(1, 4), Law(1, 3))), Task(0.1, (Law(1, 8), Law(0.0, 6)))
    yield World(kind, "always fails in one task of ten: by the margin", tasks)
    tasks = tuple(Task(0.1, (Law(1, 2 + k, 0.2), Law(0.98, 2 + k - 0.15, 0.2))) for k in range(10))
    yield World(kind, "ten tasks, 0.02 fail, limit 30 s", tasks, limit=30.0, spread=0.2)
    tasks = (
        Task(0.5, (Law(1, 4, 0.1), Law(1, 5, 0.1))),
        Task(0.5, (Law(1, 6, 0.1), Law(1, 4.9, 0.1, lapse=0.1, lapse_s=3))),
    )
    yield World(kind, "one better in each task, fragile", tasks, limit=30.0)
    tasks = (
        Task(0.94, (Law(1, 4, 0.1), Law(1, 3.9, 0.1))),
        Task(0.06, (Law(1, 4, 0.1), Law(0.7, 3.9, 0.1))),
    )
    yield World(kind, "rare failures in a small task, limit 12 s", tasks, spread=0.1)
    tasks = Task(0.5, (Law(1, 4), Law(0.8, 4))), Task(0.5, (Law(0.8, 5), Law(1, 5)))
    yield World(kind, "each fails in one of two tasks: equal", tasks)
    tasks = tuple(
        Task(1 / 20, (Law(1, 2 + k / 4, 0.3), Law(0.9, 1.5 + k / 4, 0.3))) for k in range(20)
    )
    yield World(kind, "twenty tasks: by the margin", tasks)


def grids() -> Iterator[World]:
    """The same starts in every draw, of which the far ones are harder; the truth is the mean over
    these starts.
    """
    kind = "fixed grids"
    yield of(kind, "worse in both", Law(0.8, 4, slope=-0.2), Law(0.75, 4.2, slope=-0.25), grid=True)
    yield of(kind, "by the margin", Law(1, 6, 0.5), Law(0.9, 3, 0.5, slope=-0.1), grid=True)
    yield of(
        kind,
        "rare failures, limit 60 s",
        Law(1, 5, 0.05),
        Law(0.97, 3.4, 0.05, slope=-0.03),
        grid=True,
        limit=60.0,
    )
    laws = Law(1, 5, 0.1), Law(1, 4.52, 0.1, lapse=0.1, lapse_s=5.0)
    yield of(kind, "fragile lead, limit 30 s", *laws, grid=True, limit=30.0)
    yield of(
        kind,
        "each fails at one end: equal",
        Law(0.75, 4, slope=0.25),
        Law(0.75, 4, slope=-0.25),
        grid=True,
    )
    yield of(kind, "little noise, worse in both", Law(1, 4, 0.01), Law(0.98, 4.01, 0.01), grid=True)


def equal_laws() -> Iterator[World]:
    """Laws that are the same: any verdict is wrong, and so is any word on who is sooner."""
    kind = "equal laws"
    for rate in (1.0, 0.95, 0.85, 0.5):
        for shared in (0.0, 1.0):
            yield of(
                kind, f"{rate:g}{', shared' if shared else ''}", *[Law(rate, 4)] * 2, shared=shared
            )
    for noise in ("exponential", "lognormal", "humps"):
        yield of(kind, noise, *[Law(0.95, 5, 1.0, noise)] * 2, limit=30.0)
    yield of(kind, "ticks", *[Law(1, 5, 0.2)] * 2, period=0.2)
    yield of(kind, "at the limit", *[Law(1, 12, 0.5)] * 2, spread=0.0)
    yield of(kind, "hard starts", *[Law(0.9, 5)] * 2, hard=0.5)
    yield of(kind, "rare long lapses", *[Law(1, 5, 0.1, lapse=0.03, lapse_s=20.0)] * 2, limit=30.0)
    yield World(
        kind,
        "tasks",
        (Task(0.5, (Law(1, 3),) * 2), Task(0.3, (Law(0.7, 6),) * 2), Task(0.2, (Law(0.3, 9),) * 2)),
    )


def many_laws() -> Iterator[World]:
    """Of 3, 13 and 24 laws any wrong pair counts."""
    for k in (3, 13, 24):
        kind = f"{k} laws"
        yield of(f"{k} equal laws", "equal", *[Law(0.9, 5)] * k)
        yield of(f"{k} equal laws", "equal, never fail", *[Law(1, 5)] * k)
        ladder = [Law(max(1 - 0.02 * i, 0.5), 4 + 0.1 * i) for i in range(k)]
        yield of(kind, "each worse than the one before in both", *ladder)
        quick = [Law(1, 6)] * (k - 1)
        yield of(kind, "one quicker and by the margin worse", *quick, Law(1 - MARGIN, 3))
        yield of(
            kind,
            "half of them quicker and by the margin worse",
            *[Law(1, 6)] * (k // 2),
            *[Law(1 - MARGIN, 3)] * (k - k // 2),
        )
        laws = [Law(1, 5, 0.1)] * (k // 2) + [Law(0.97, 5 - 0.95 * 0.03 * 55 / 0.97, 0.1)] * (
            k - k // 2
        )
        yield of(kind, "half of them quicker with rare failures, limit 60 s", *laws, limit=60.0)
        laws = [Law(1, 5, 0.1)] * (k // 2) + [Law(1, 4.52, 0.1, lapse=0.1, lapse_s=5.0)] * (
            k - k // 2
        )
        yield of(kind, "half of them with fragile leads, limit 30 s", *laws, limit=30.0)


def random_world(i: int) -> World:
    """A world drawn from the seed i."""
    rng = np.random.default_rng([59, i])
    k = 3 if i % 4 == 3 else 2
    limit = float(rng.choice([8.0, 12.0, 30.0, 60.0]))
    base = 1.0 if rng.random() < 0.3 else rng.uniform(0.5, 1)
    time = rng.uniform(2, 7)
    noise = str(rng.choice(list(NOISES)))
    laws = []
    for _ in range(k):
        rate = (
            base if rng.random() < 0.5 else float(np.clip(base + rng.uniform(-0.15, 0.15), 0.3, 1))
        )
        lapse, lapse_s = (
            (rng.uniform(0.01, 0.2), rng.uniform(1, 10)) if rng.random() < 0.3 else (0.0, 0.0)
        )
        own = time if rng.random() < 0.4 else time + rng.uniform(-1.5, 1.5)
        laws.append(
            Law(
                round(rate, 3),
                round(own, 3),
                round(rng.uniform(0.02, 1.5), 3),
                noise,
                round(lapse, 3),
                round(lapse_s, 3),
            )
        )
    return of(
        f"random, {k} laws",
        f"number {i}",
        *laws,
        limit=limit,
        spread=float(rng.choice([0.0, 0.5, 2.0])),
        shared=float(rng.choice([0.0, 0.5, 1.0])),
        hard=float(rng.choice([0.0, 0.0, 0.2])),
        period=float(rng.choice([0.0, 0.04, 0.5])),
    )


RANDOM = 120
FIXED = (
    worse_in_both,
    worse_by_the_margin,
    rare_failures,
    knife_edges,
    fragile_leads,
    ticks,
    hard_starts,
    strata,
    grids,
    equal_laws,
)


def fixed_worlds() -> list[World]:
    return [world for made in FIXED for world in made()]


# The rule, for many draws at once.
class Words(NamedTuple):
    """What is said of each pair, (draws, pairs): NO_VERDICT, A_BETTER, B_BETTER or TRADE; of who is
    sooner never TRADE.
    """

    better: NDArray[np.int8]
    sooner: NDArray[np.int8]


def words_of(
    flown: Flown,
    limit: float | Array,
    period: float = 0.0,
    strata: NDArray[np.intp] | None = None,
    margin: float = MARGIN,
) -> Words:
    """The words of `judge` on each draw; limit: of all, or (draws, 1)."""
    _, laws, n = flown.reached.shape
    pairs = np.array(list(combinations(range(laws), 2)))
    a, b = pairs[:, 0], pairs[:, 1]
    groups = _groups(n, strata)
    reached = flown.reached.astype(float)
    counts = reached.sum(axis=2)
    both = np.einsum("dkn,dln->dkl", reached, reached, optimize=True)[:, a, b]
    only_a = np.rint(counts[:, a] - both)
    only_b = np.rint(counts[:, b] - both)

    rate_gain = (counts[:, b] - counts[:, a]) / n
    rate_variance = _variances(reached, groups)[:, a, b]
    mean = flown.times.mean(axis=2)
    saved = mean[:, a] - mean[:, b]
    variance = _variances(flown.times, groups)[:, a, b]
    with np.errstate(invalid="ignore"):
        usual = np.where(counts > 0, (flown.times * reached).sum(axis=2) / counts, limit)
    free = n - len(groups) + 1

    p_sides = []
    for sign, other in ((-1.0, usual[:, b]), (1.0, usual[:, a])):
        t_margin = _t(sign * rate_gain, rate_variance, n, -1.0, -margin)
        t_time = _t(sign * saved, variance, n, other - limit, 0.0)
        p_sides.append(special.stdtr(free, -np.minimum(t_margin, t_time)))
    p_a, p_b = p_sides
    p_time = np.minimum(1, 2 * np.minimum(p_a, p_b))
    p_success = _sign_test(only_a, only_b)
    adjusted = _holm(np.concatenate([p_success, p_time], axis=1))
    by_success = np.where(
        adjusted[:, : len(a)] <= ALPHA, np.where(only_b > only_a, B_BETTER, A_BETTER), NO_VERDICT
    )
    by_time = np.where(
        adjusted[:, len(a) :] <= ALPHA, np.where(p_a < p_b, A_BETTER, B_BETTER), NO_VERDICT
    )
    trade = (by_success > 0) & (by_time > 0) & (by_success != by_time)
    better = np.where(trade, TRADE, np.where(by_success > 0, by_success, by_time))

    wins_a, wins_b = _wins(flown, pairs, period)
    first = _holm(_sign_test(wins_a, wins_b)) <= ALPHA
    sooner = np.where(first, np.where(wins_b > wins_a, B_BETTER, A_BETTER), NO_VERDICT)
    return Words(better.astype(np.int8), sooner.astype(np.int8))


def _groups(n: int, strata: NDArray[np.intp] | None) -> list[NDArray[np.intp]]:
    """The starts of each stratum; those of one start are together."""
    if strata is None:
        return [np.arange(n)]
    found = [np.flatnonzero(strata == k) for k in np.unique(strata)]
    alone = [group for group in found if len(group) == 1]
    return [group for group in found if len(group) > 1] + ([np.concatenate(alone)] if alone else [])


def _variances(values: Array, groups: list[NDArray[np.intp]]) -> Array:
    """Of the difference of each two laws, within the groups: (draws, laws, laws)."""
    several = [group for group in groups if len(group) > 1]
    n = sum(map(len, several))
    gram = 0.0
    for group in several:
        own = values[:, :, group]
        centred = own - own.mean(axis=2, keepdims=True)
        gram = gram + len(group) / (len(group) - 1) / n * (centred @ centred.transpose(0, 2, 1))
    diagonal = np.einsum("dkk->dk", gram)
    found = diagonal[:, :, None] + diagonal[:, None, :] - 2 * gram
    rounding = 1e-13 * (diagonal[:, :, None] + diagonal[:, None, :])
    return np.where(found > rounding, found, 0.0)


def _t(mean: Array, variance: Array, n: int, imagined: Array | float, bound: float) -> Array:
    with_it = (n * mean + imagined) / (n + 1)
    spread = (n - 1) * variance + n / (n + 1) * (imagined - mean) ** 2
    distance = with_it - bound
    with np.errstate(divide="ignore", invalid="ignore"):
        t = distance / np.sqrt(spread / n / (n + 1))
    without_chance = np.where(distance > 0, np.inf, np.where(distance < 0, -np.inf, 0.0))
    return np.where(spread > 0, t, without_chance)


def _sign_test(one: Array, other: Array) -> Array:
    total = one + other
    p = np.minimum(1, 2 * special.bdtr(np.minimum(one, other), total.astype(int), 0.5))
    return np.where(total >= FEWEST_UNLIKE, p, np.nan)


def _holm(p: Array) -> Array:
    order = np.argsort(p, axis=1)  # NaN last
    ascending = np.take_along_axis(p, order, axis=1)
    tests = (~np.isnan(p)).sum(axis=1, keepdims=True)
    factors = np.maximum(tests - np.arange(p.shape[1]), 0)
    grown = np.fmax.accumulate(np.minimum(factors * ascending, 1), axis=1)
    adjusted = np.empty_like(p)
    np.put_along_axis(adjusted, order, np.where(np.isnan(ascending), np.nan, grown), axis=1)
    return adjusted


def _wins(flown: Flown, pairs: NDArray[np.intp], period: float) -> tuple[Array, Array]:
    wins = np.empty((2, len(flown.reached), len(pairs)))
    for i, (a, b) in enumerate(pairs):
        ra, rb = flown.reached[:, a], flown.reached[:, b]
        later = flown.times[:, a] - flown.times[:, b]
        far = np.abs(later) > period * ONE_PICTURE
        first_a = (ra & ~rb) | (ra & rb & far & (later < 0))
        first_b = (rb & ~ra) | (ra & rb & far & (later > 0))
        wins[0, :, i] = first_a.sum(axis=1)
        wins[1, :, i] = first_b.sum(axis=1)
    return wins[0], wins[1]


# Counting.
class Cell(NamedTuple):
    """Of so many draws: those with a wrong verdict on any pair, of each kind; with any verdict;
    with any word on who is sooner.

    wrong: [the winner is truly worse in success and in mean time, its success is truly lower by the
    margin or more, it is better in neither]; of equal laws the third is any verdict. a, b, trade:
    draws in which the first pair has this verdict.
    """

    kind: str
    name: str
    laws: int
    n: int
    draws: int
    wrong: list[int]
    any_verdict: int
    any_sooner: int
    a: int
    b: int
    trade: int
    sooner_b: int
    equal: bool

    @property
    def low(self) -> list[float]:
        """The lower 95 % bound of the share of each kind of wrong verdicts (Clopper & Pearson
        1934).
        """
        return [lower_bound(wrong, self.draws) for wrong in self.wrong]


def lower_bound(count: int, of: int) -> float:
    """One-sided, exact."""
    return float(stats.beta.ppf(0.05, count, of - count + 1)) if count else 0.0


def cell(
    world: World, n: int, draws: int, rng: np.random.Generator, margin: float = MARGIN
) -> Cell:
    """Draw and count."""
    rate, time = world.truth(n)
    pairs = np.array(list(combinations(range(world.laws), 2)))
    strata = world.strata(n) if len(world.tasks) > 1 else None
    size = max(TOGETHER // (n * world.laws), 1)
    wrong = np.zeros(3, dtype=int)
    verdicts = sooner = 0
    first = np.zeros(4, dtype=int)
    sooner_b = 0
    for begin in range(0, draws, size):
        flown = world.draw(rng, min(size, draws - begin), n)
        words = words_of(flown, world.limit, world.period, strata, margin)
        wrong += [
            int(lies.any(axis=1).sum()) for lies in _lies(words.better, pairs, rate, time, margin)
        ]
        verdicts += int(np.isin(words.better, (A_BETTER, B_BETTER)).any(axis=1).sum())
        sooner += int((words.sooner > 0).any(axis=1).sum())
        first += np.bincount(words.better[:, 0], minlength=4)
        sooner_b += int((words.sooner[:, 0] == B_BETTER).sum())
    _, a, b, trade = first.tolist()
    return Cell(
        world.kind,
        world.name,
        world.laws,
        n,
        draws,
        wrong.tolist(),
        verdicts,
        sooner,
        a,
        b,
        trade,
        sooner_b,
        world.equal,
    )


def _lies(
    better: NDArray[np.int8], pairs: NDArray[np.intp], rate: Array, time: Array, margin: float
) -> list[NDArray[np.bool_]]:
    """For each kind of wrong: which draws and pairs are."""
    lies = []
    for winner, loser, word in (
        (pairs[:, 0], pairs[:, 1], A_BETTER),
        (pairs[:, 1], pairs[:, 0], B_BETTER),
    ):
        gain, later = rate[winner] - rate[loser], time[winner] - time[loser]
        kinds = (gain < 0) & (later > 0), gain <= -margin + 1e-9, (gain <= 0) & (later >= 0)
        lies.append([(better == word) & kind for kind in kinds])
    return [one | other for one, other in zip(*lies, strict=True)]


# Power.
SOME_SHARED = 0.3  # share of the starts in which both laws fail together, in the cells of the power
POWER = {  # the second law is the better one
    "a": of("power", "no failure, 1 of 5 s, limit 12 s", Law(1, 5), Law(1, 4)),
    "b": of(
        "power",
        "success 0.85 both, 2 s, limit 12 s",
        Law(0.85, 5),
        Law(0.85, 3),
        shared=SOME_SHARED,
    ),
    "c": of(
        "power",
        "success 0.95 both, 1 s, limit 12 s",
        Law(0.95, 5),
        Law(0.95, 4),
        shared=SOME_SHARED,
    ),
    "d": of(
        "power",
        "success 0.85, 6 s against 0.95, 4 s, limit 30 s",
        Law(0.85, 6),
        Law(0.95, 4),
        limit=30.0,
        shared=SOME_SHARED,
    ),
    "e": of("power", "success 0.5 against 0.95", Law(0.5, 5), Law(0.95, 5), shared=SOME_SHARED),
}
TRUE_TRADE = of("a true trade", "1.0, 6 s against 0.95, 3 s, limit 12 s", Law(1, 6), Law(0.95, 3))


# Beside the limit of time.
def unlimited_cell(n: int, draws: int, rng: np.random.Generator, share: float = 0.02) -> Cell:
    """A primary metric without a largest value: the second law's is half of the first's, but from
    few starts a hundred times as large.

    The worst value is the largest of the runs that were flown, and nobody knows that of the others.
    Its mean is truly worse.
    """
    reached = np.ones((draws, 2, n), dtype=bool)
    values = rng.normal([[2.0], [1.0]], 0.3, (draws, 2, n))
    values[:, 1] += 100.0 * (rng.random((draws, n)) < share)
    worst = values.max(axis=(1, 2))[:, None]
    better = words_of(Flown(reached, values, reached), worst).better[:, 0]
    _, a, b, trade = np.bincount(better, minlength=4).tolist()
    name = f"always arrive, 2 / 1, but 101 from {share:g} of the starts"
    return Cell(
        "a metric without a limit", name, 2, n, draws, [0, 0, b], a + b, 0, a, b, trade, 0, False
    )


NULLS = {  # differences of mean zero: symmetric and skewed ones, heavy tails, ties
    "normal": lambda rng, shape: rng.normal(size=shape),
    "uniform": lambda rng, shape: rng.uniform(-1, 1, shape),
    "two humps": lambda rng, shape: rng.choice([-1.0, 1.0], shape) + rng.normal(0, 0.2, shape),
    "half of them zero": lambda rng, shape: np.where(
        rng.random(shape) < 0.5, 0.0, rng.normal(size=shape)
    ),
    "Student's t with 2 degrees of freedom": lambda rng, shape: rng.standard_t(2, shape),
    "one in ten ten times as large": lambda rng, shape: (
        rng.normal(size=shape) * np.where(rng.random(shape) < 0.1, 10, 1)
    ),
    "exponential, mean 0": lambda rng, shape: rng.exponential(size=shape) - 1,
    "lognormal, mean 0": lambda rng, shape: rng.lognormal(size=shape) - np.exp(0.5),
}


class Interval(NamedTuple):
    """Student's t of differences of mean zero: share of the intervals that hold the zero, and of
    those of a shift by one sd that do not.
    """

    differences: str
    n: int
    draws: int
    covered: int
    found: int


def intervals(draws: int = 20_000) -> Iterator[Interval]:
    """Of each distribution with 10, 20 and 50 starts."""
    for name, drawn in NULLS.items():
        for n in (10, 20, 50):
            d = drawn(np.random.default_rng([77, n]), (draws, n))
            half = stats.t.ppf(0.975, n - 1) * d.std(axis=1, ddof=1) / np.sqrt(n)
            covered = int((np.abs(d.mean(axis=1)) <= half).sum())
            found = int((np.abs(d.mean(axis=1) + d.std()) > half).sum())
            yield Interval(name, n, draws, covered, found)


def counted(
    worlds: Sequence[World], starts: Sequence[int] = STARTS, draws: int = DRAWS
) -> Iterator[Cell]:
    """The cells of these worlds."""
    for i, world in enumerate(worlds):
        for n in starts:
            yield cell(world, n, draws, np.random.default_rng([2026, i, n]))


def study() -> dict[str, list[Cell]]:
    """All cells, by what they count; some minutes."""
    found: dict[str, list[Cell]] = {}
    for name, worlds, starts in (
        ("fixed", fixed_worlds(), (5, *STARTS)),
        ("random", [random_world(i) for i in range(RANDOM)], STARTS),
        ("many", list(many_laws()), OF_MANY),
        ("power", [*POWER.values(), TRUE_TRADE], STARTS),
    ):
        found[name] = []
        for one in counted(worlds, starts):
            found[name].append(one)
            print(
                (
                    f"{one.kind} | {one.name} | {one.n} | {one.wrong} | {one.any_verdict} |"
                    f" {one.any_sooner} of {one.draws}"
                ),
                flush=True,
            )
    found["outside"] = [unlimited_cell(n, DRAWS, np.random.default_rng([2026, n])) for n in STARTS]
    return found


def main() -> None:
    """Count all, and write what the page shows: a row for each cell, and for each interval."""
    _write(INTERVALS, Interval._fields, list(intervals()))
    head = ["what", *Cell._fields[:5], "wrong_1", "wrong_2", "wrong_3", *Cell._fields[6:]]
    _write(
        KEPT,
        head,
        [
            [what, *one[:5], *one.wrong, *one[6:]]
            for what, cells in study().items()
            for one in cells
        ],
    )


def _write(place: Path, head: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    with place.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([head, *rows])


if __name__ == "__main__":
    sys.exit(main())
