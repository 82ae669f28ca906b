"""How often a verdict is wrong, where the truth is known: docs/results/verdicts.md.

Three kinds of wrong: 1, the winner is truly worse in success and in mean time; 2, its success is
truly lower by the margin or more; 3, it is better in neither. Of each cell (a world with a number
of starts) thousands of comparisons are drawn, and the lower 95 % bound of the share that is wrong
must be at most 5 %: the rule's own level, for the family of all pairs together.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from docs.build.verdicts import Verdicts
from tests.long import verdict_worlds as worlds
from tests.long.verdict_worlds import A_BETTER, B_BETTER, TRADE, Cell, World, words_of
from vstestbed.report.comparison import verdict as rule

# power of the design's own simulation [%], at 20, 50, 100, 200 starts; its shared failures are not
# known
AS_PRINTED = {
    "a": {20: 0, 50: 100},
    "b": {20: 2, 50: 16, 100: 43, 200: 80},
    "c": {20: 0, 50: 48, 100: 80, 200: 98},
    "d": {20: 10, 50: 72, 100: 99, 200: 100},
    "e": {20: 85, 50: 100},
}


def by_class(world: World, flown: worlds.Flown, draw: int, n: int) -> tuple[list[int], list[int]]:
    """What `judge` says of one draw: of each pair the verdict, and who is sooner."""
    strata = world.strata(n) if len(world.tasks) > 1 else None
    reached, times = flown.reached[draw], flown.times[draw]
    tests = []
    for a in range(world.laws):
        for b in range(a + 1, world.laws):
            starts = rule.Starts(
                reached[a], reached[b], times[a], times[b], world.limit, world.period, strata
            )
            tests.append(rule.test_of(starts))
    side = {None: 0, "a": A_BETTER, "b": B_BETTER}
    verdicts = rule.judge(tests)
    better = [
        TRADE if verdict.decision == "trade" else side[verdict.better] for verdict in verdicts
    ]
    return better, [side[verdict.sooner] for verdict in verdicts]


def test_what_is_counted_is_the_shipped_rule() -> None:
    """Some 300 draws by `judge`, one by one, and by `words_of` at once: the same words, with and
    without strata, ticks and many laws.
    """
    several = [
        *worlds.strata(),
        *worlds.ticks(),
        *worlds.grids(),
        *(world for world in worlds.many_laws() if world.laws == 3),
    ]
    several += [
        *worlds.POWER.values(),
        *[worlds.TRUE_TRADE] * 6,
        *map(worlds.random_world, range(20)),
    ]
    said = set()
    rng = np.random.default_rng(3)
    for i, world in enumerate(several):
        n = (5, 20, 34, 50, 100, 300)[i % 6]
        flown = world.draw(rng, 5, n)
        strata = world.strata(n) if len(world.tasks) > 1 else None
        words = words_of(flown, world.limit, world.period, strata)
        for draw in range(5):
            better, sooner = by_class(world, flown, draw, n)
            assert words.better[draw].tolist() == better, (world.name, n, draw)
            assert words.sooner[draw].tolist() == sooner, (world.name, n, draw)
            said |= set(better)
    assert said == {0, A_BETTER, B_BETTER, TRADE}


def demand(cells: list[Cell]) -> None:
    """At most 5 % wrong of each kind in each cell, by its lower bound; prints the largest share and
    that over all.
    """
    assert cells and all(cell.draws >= 4000 for cell in cells)
    for kind in dict.fromkeys(cell.kind for cell in cells):
        those = [cell for cell in cells if cell.kind == kind]
        draws = sum(cell.draws for cell in those)
        most = [100 * max(cell.wrong[i] / cell.draws for cell in those) for i in range(3)]
        over_all = [100 * sum(cell.wrong[i] for cell in those) / draws for i in range(3)]
        print(
            f"{kind}: {draws} draws; most {np.round(most, 2)}, over all {np.round(over_all, 2)} %"
        )
    bad = [cell for cell in cells if max(cell.low) > 0.05]
    assert not bad, bad


@pytest.mark.study
@pytest.mark.parametrize("made", worlds.FIXED, ids=lambda made: made.__name__)
def test_fixed_worlds(made) -> None:
    cells = list(worlds.counted(list(made())))
    demand(cells)
    if made is worlds.equal_laws:  # any verdict, and any word, is wrong
        assert all(worlds.lower_bound(cell.any_verdict, cell.draws) <= 0.05 for cell in cells)
        assert all(worlds.lower_bound(cell.any_sooner, cell.draws) <= 0.05 for cell in cells)


@pytest.mark.study
def test_random_worlds() -> None:
    demand(list(worlds.counted([worlds.random_world(i) for i in range(worlds.RANDOM)])))


@pytest.mark.study
def test_many_laws() -> None:
    cells = list(worlds.counted(list(worlds.many_laws()), worlds.OF_MANY))
    demand(cells)
    assert {cell.laws for cell in cells} == {3, 13, 24}
    equal = [cell for cell in cells if cell.equal]
    assert equal and all(worlds.lower_bound(cell.any_verdict, cell.draws) <= 0.05 for cell in equal)
    assert all(worlds.lower_bound(cell.any_sooner, cell.draws) <= 0.05 for cell in equal)


@pytest.mark.study
def test_power_grows_with_the_starts_and_is_that_of_the_design() -> None:
    """A step down of more than 3 standard errors fails. 8 points: what the failures that both laws
    share change (0 or .5: 11).
    """
    for letter, world in worlds.POWER.items():
        cells = {cell.n: cell for cell in worlds.counted([world])}
        power = {n: cell.b / cell.draws for n, cell in cells.items()}
        print(letter, world.name, {n: round(100 * share, 1) for n, share in power.items()})
        shares = list(power.values())
        for before, after in itertools.pairwise(shares):
            error = np.sqrt((before * (1 - before) + after * (1 - after)) / worlds.DRAWS)
            assert after >= before - 3 * error, (letter, power)
        for n, printed in AS_PRINTED[letter].items():
            assert abs(100 * power[n] - printed) <= 8, (letter, n, power[n], printed)


@pytest.mark.study
def test_five_starts_have_no_verdict() -> None:
    every = [
        *worlds.fixed_worlds(),
        *(w for w in worlds.many_laws() if w.laws < 24),
        *map(worlds.random_world, range(worlds.RANDOM)),
    ]
    for cell in worlds.counted(every, (2, 3, 4, 5)):
        assert (cell.any_verdict, cell.trade) == (0, 0), cell


def test_the_kept_counts_are_those_of_the_study() -> None:
    """Some cells again, of the same seeds: the page shows what the study counts."""
    kept = {
        (row["kind"], row["name"], row["n"]): row for row in Verdicts().cells.iter_rows(named=True)
    }
    fixed = worlds.fixed_worlds()
    for i in (0, 17, 40, 61, 90, len(fixed) - 1):
        for n in (20, 30):
            found = worlds.cell(fixed[i], n, worlds.DRAWS, np.random.default_rng([2026, i, n]))
            row = kept[fixed[i].kind, fixed[i].name, n]
            assert [row[f"wrong_{kind}"] for kind in (1, 2, 3)] == found.wrong
            assert (row["any_verdict"], row["any_sooner"], row["draws"]) == (
                found.any_verdict,
                found.any_sooner,
                found.draws,
            )
    assert {row["kind"] for row in kept.values()} >= {
        world.kind for world in [*fixed, *worlds.many_laws()]
    }
