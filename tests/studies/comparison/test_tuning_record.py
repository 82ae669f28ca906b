"""Settings are not laws: what a comparison must say of the gains with which its laws fly, and which
command makes them laws.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

import vstestbed as vs
from tests.conftest import QUICK
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.named_files import bundled_comparisons
from vstestbed.studies.comparison import chosen, compare, merge
from vstestbed.studies.comparison.folder import results_of
from vstestbed.studies.comparison.plan import Comparison, Tuned, changed, read_comparison
from vstestbed.studies.comparison.record import RECORD
from vstestbed.studies.comparison.tuning_record import gains_of, laws_of, ranges, settings_of

START = "These are settings, not laws: "
TUNE = "`vstestbed tune comparison.yaml --vary law.gain=0.3:8:log` makes them laws."
POINTS, POSE = {"kind": "ibvs", "gain": 4}, {"kind": "pbvs", "gain": 5}
PARTITIONED = {"kind": "partitioned", "gain": 3, "gain_z": 0.5, "gain_turn": 0.7}


def tuned(
    law: dict[str, object],
    vary: tuple[str, ...] = ("law.gain",),
    between: str = "0.3:8:log",
    **more: object,
) -> Tuned:
    """The record of a search on the quick scenario, of 12 trials from 5 starts where nothing else
    is said.
    """
    numbers = {"trials": 12, "seeds": 5} | more
    return Tuned(law=law, scenario="quick", vary=dict.fromkeys(vary, between), **numbers)


@pytest.fixture
def two(quick: Path) -> Comparison:
    """Points and poses on the quick scenario, both tuned by one budget."""
    cases = {"law": {"points": {"law": POINTS}, "pose": {"law": POSE}}}
    return Comparison(
        base=(str(quick),),
        cases=cases,
        tuned={"points": tuned(POINTS), "pose": tuned(POSE)},
        seeds=2,
    )


def said(comparison: Comparison) -> str:
    """What is said of its laws: between the common beginning and the command, which is that of this
    comparison's file.
    """
    words = settings_of(comparison)
    assert words.startswith(START) and words.endswith(TUNE), words
    return words.removeprefix(START).removesuffix(f" {TUNE}")


def test_laws_whose_gains_nobody_tuned_are_settings() -> None:
    assert (
        settings_of(chosen(["arm_laws"], {}, {})) == "These are settings, not laws:"
        " arm_ibvs, arm_pbvs and arm_hybrid fly with gain 0.5, for which none was tuned."
        " `vstestbed tune arm_laws --vary law.gain=0.3:8:log` makes them laws."
    )


def test_the_command_is_of_the_file_in_the_folder_where_the_bundled_one_says_something_else() -> (
    None
):
    """Of scenarios by name there is no file but that; with other values, or another robot, the
    bundled one would tune something else.
    """
    for names, settings in (
        (["arm_ibvs", "arm_pbvs"], {}),
        (["arm_laws"], {"camera.latency_s": 0.1}),
        (["arm_laws", "arm_ibvs", "arm_pbvs"], {}),
    ):
        assert settings_of(chosen(names, settings, {})).endswith(TUNE)
    # the same laws from fewer starts
    assert "`vstestbed tune arm_laws " in settings_of(chosen(["arm_laws"], {}, {}, seeds=3))


def test_laws_that_were_all_tuned_by_one_budget_are_laws(two: Comparison) -> None:
    assert settings_of(two) == ""
    assert settings_of(chosen(["arm_laws_tuned"], {}, {})) == ""
    only_points = replace(two, tuned={"points": two.tuned["points"]})
    assert said(only_points) == "pose flies with gain 5, for which none was tuned."


def test_a_gain_that_was_edited_afterwards_is_named(two: Comparison) -> None:
    edited = {"points": {"law": POINTS | {"gain": 4.5}}, "pose": {"law": POSE}}
    assert (
        said(replace(two, cases={"law": edited}))
        == "points flies with law.gain 4.5 in place of 4.0, as in the search."
    )
    another = {
        "points": {"law": POINTS | {"interaction": "mean"}},
        "pose": {"law": {"kind": "hybrid", "gain": 5}},
    }
    words = (
        "points flies with law.interaction mean in place of current, as in the search;"
        " pose flies with law.kind hybrid in place of pbvs"
    )
    assert said(replace(two, cases={"law": another})) == f"{words}, as in the search."


def test_a_world_that_is_not_that_of_the_search_is_named(two: Comparison, quick: Path) -> None:
    slow = replace(two, set={"camera.rate_hz": 10, "name": "mine"})
    assert (
        said(slow)
        == "points and pose fly with camera.rate_hz 10 in place of null, as in the search."
    )
    # what is compared is no other world
    assert settings_of(changed(two, axes={"camera.rate_hz": (10, 20)})) == ""
    other = shutil.copy(quick, quick.with_name("other.yaml"))
    assert (
        said(replace(two, base=(str(other),)))
        == "points and pose fly with scenario other in place of quick, as in the search."
    )


def test_a_gain_over_which_no_search_ranged_is_named(two: Comparison) -> None:
    """Of the three gains of a partitioned law a search of `law.gain` tunes one; its fourth does
    nothing, since no axis is x or y.
    """
    cases = {"law": {"points": {"law": POINTS}, "partitioned": {"law": PARTITIONED}}}
    one = replace(
        two, cases=cases, tuned={"points": tuned(POINTS), "partitioned": tuned(PARTITIONED)}
    )
    words = settings_of(one)
    assert words.startswith(
        f"{START}partitioned flies with gain_z 0.5 and gain_turn 0.7,"
        " for which none was tuned. `vstestbed tune "
    )
    assert words.endswith(
        " --vary law.gain=0.3:8:log --vary law.gain_z=0.3:8:log"
        " --vary law.gain_turn=0.3:8:log` makes them laws."
    )
    every = tuned(PARTITIONED, ("law.gain", "law.gain_z", "law.gain_turn"))
    assert settings_of(replace(one, tuned={"points": tuned(POINTS), "partitioned": every})) == ""


def test_budgets_and_ranges_that_were_not_the_same_are_named(two: Comparison) -> None:
    longer = replace(two, tuned=two.tuned | {"pose": tuned(POSE, trials=60)})
    starts = "trials from the seeds 2000000000 to 2000000004 by time_to_converge_s"
    assert (
        said(longer)
        == f"points flies with values of 12 {starts}; pose flies with values of 60 {starts}."
    )
    for change in ({"seeds": 6}, {"first_seed": 2_000_000_001}, {"metric": "path_ratio"}):
        assert said(replace(two, tuned=two.tuned | {"pose": tuned(POSE, **change)})).startswith(
            "points flies with values of 12 trials"
        )
    wider = replace(two, tuned=two.tuned | {"pose": tuned(POSE, between="0.1:20:log")})
    assert (
        said(wider)
        == "points flies with law.gain of 0.3:8:log; pose flies with law.gain of 0.1:20:log."
    )


def test_one_law_with_different_gains_is_one_law(two: Comparison, quick: Path) -> None:
    caution = "A larger gain converges sooner by itself, until delay or limits stop it."
    assert (
        settings_of(chosen([str(quick)], {}, {"law.gain": (3, 6)}))
        == f"{START}one law flies with different gain. {caution}"
    )
    cases = {
        "law": {
            "soft": {"law": PARTITIONED},
            "hard": {"law": PARTITIONED | {"gain": 1, "gain_z": 4}},
        }
    }
    assert (
        settings_of(replace(two, cases=cases))
        == f"{START}one law flies with different gain and gain_z. {caution}"
    )


def test_one_law_as_it_is_in_several_worlds_ranks_no_laws(quick: Path) -> None:
    assert settings_of(chosen([str(quick)], {}, {"camera.rate_hz": (10, 20)})) == ""
    assert settings_of(chosen([str(quick)], {}, {})) == ""


def test_a_law_without_a_gain_is_named_beside_those_that_have_one_and_needs_no_record(
    two: Comparison, tmp_path: Path
) -> None:
    (tmp_path / "rests.py").write_text("def rests(observation):\n    return [0.0] * 6\n")
    policy = {"law": {"kind": "policy", "file": str(tmp_path / "rests.py:rests")}}
    three = replace(two, cases={"law": two.cases["law"] | {"policy": policy}})
    assert settings_of(three) == ""
    words = said(replace(three, tuned={"pose": two.tuned["pose"]}))
    assert words == "points flies with gain 4, for which none was tuned; without a gain: policy."


def test_gains_are_those_of_the_laws_in_a_law_too_and_none_that_does_nothing() -> None:
    def of(name: str, **settings: object) -> dict[str, float]:
        return gains_of(
            vs.load(name, {f"law.{field}": value for field, value in settings.items()}).law
        )

    assert of("arm_qp") == {"law.law.gain": 0.5, "law.barrier_gain": 3}
    assert of("arm_switched") == {"law.laws.0.law.gain": 0.5, "law.laws.1.law.gain": 0.5}
    assert list(of("arm_ibvs", gain={"kind": "adaptive"})) == [
        "law.gain.at_zero",
        "law.gain.at_infinity",
        "law.gain.slope_at_zero",
    ]
    assert list(of("car_pbvs")) == ["law.k_rho", "law.k_alpha", "law.k_beta"]
    assert list(of("arm_partitioned", axes=["x", "wz"])) == [
        "law.gain",
        "law.gain_turn",
        "law.gain_xy",
    ]


def test_a_range_holds_the_gain_as_it_is_and_keeps_its_sign(quick: Path) -> None:
    """0.3 to 8 1/s where they are there; else four times less and more. k_beta is negative, and a
    logarithm needs numbers above 0.
    """
    fast = Comparison(base=(str(quick),), cases={"law": {"pose": {"law": POSE | {"gain": 30}}}})
    assert ranges(laws_of(fast)) == {"law.gain": "7.5:120:log"}
    assert ranges(laws_of(Comparison(base=("car_pbvs",))))["law.k_beta"] == "-10:-0.625"


def test_more_than_four_groups_of_gains_are_counted() -> None:
    words = settings_of(chosen(["canonical_arm"], {}, {}))
    assert (
        "partitioned and partitioned_damped fly with gain 0.5, gain_z 0.5 and gain_turn 0.5, for"
        " which none was tuned; qp flies with" in words
    )
    assert "; and 1 more such group of laws; without a gain: recurrent. " in words
    assert "--vary law.laws.0.law.gain=0.3:8:log" in words


def test_laws_on_two_axes_have_no_command() -> None:
    words = settings_of(
        chosen(
            ["arm_ibvs"],
            {},
            {"law.interaction": ("mean", "current"), "law.feature": ("point", "polar")},
        )
    )
    assert words.endswith(
        " `vstestbed tune` makes laws of those that are scenarios, or one axis of `cases`."
    )


def test_the_bundled_comparisons_with_a_record_rank_laws_but_one() -> None:
    """The search of canonical_arm_tuned left two of three gains of its partitioned laws as they
    are.
    """
    recorded = [
        name
        for name, path in bundled_comparisons().items()
        if "\ntuned:" in path.read_text(encoding="utf-8")
    ]
    assert [name for name in recorded if not settings_of(chosen([name], {}, {}))] == [
        "arm_laws_tuned",
        "realism_arm_tuned",
    ]
    words = settings_of(chosen(["canonical_arm_tuned"], {}, {}))
    assert words.startswith(
        f"{START}partitioned and partitioned_damped fly with gain_z 0.5 and gain_turn 0.5, for"
        " which none was tuned. "
    )


@pytest.mark.study
def test_each_bundled_comparison_ranks_laws_or_says_that_it_does_not() -> None:
    words = [settings_of(chosen([name], {}, {})) for name in bundled_comparisons()]
    assert all(text == "" or text.startswith(START) for text in words)


def test_a_record_with_a_mistake_is_refused_in_its_place(two: Comparison, tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"gian.*did you mean 'gain'"):
        settings_of(replace(two, tuned={"points": tuned({"kind": "ibvs", "gian": 4})}))
    with pytest.raises(ParameterError, match=r"first_seed must be >= 2000000000"):
        tuned(POINTS, first_seed=7)  # starts that a comparison may have
    with pytest.raises(ParameterError, match=r"trials"):
        Tuned(law=POINTS, scenario="quick", vary={}, seeds=5)


def write(folder: Path) -> Path:
    """The comparison `two` as a file, and its scenario."""
    (folder / "quick.yaml").write_text(QUICK, encoding="utf-8")
    entries = [
        f"  {name}: {{scenario: quick, law: {law}, vary: {{law.gain: '0.3:8:log'}}, trials: 12,"
        " seeds: 5}\n"
        for name, law in LAWS.items()
    ]
    cases = "".join(f"    {name}: {{law: {law}}}\n" for name, law in LAWS.items())
    (folder / "mine.yaml").write_text(
        f"base: [quick.yaml]\nseeds: 2\ncases:\n  law:\n{cases}tuned:\n{''.join(entries)}"
    )
    return folder / "mine.yaml"


LAWS = {"points": "{kind: ibvs, gain: 4}", "pose": "{kind: pbvs, gain: 5}"}


def test_the_record_goes_with_the_folder_again_and_merged(
    tmp_path: Path, here: None, one_figure: None
) -> None:
    from vstestbed.studies.comparison import again

    file = write(tmp_path)
    flown = compare([file], jobs=1, out=tmp_path / "flown", film=False, figures=False, report=False)
    assert results_of(flown, flown.comparison).settings == ""
    for i in (1, 2):
        compare(
            [file],
            jobs=1,
            out=tmp_path / f"{i}",
            film=False,
            figures=False,
            report=False,
            shard=f"{i}/2",
        )
    merge([tmp_path / "1", tmp_path / "2"], tmp_path / "merged", figures=False)
    again(tmp_path / "flown", tmp_path / "again", jobs=1)
    for name in ("flown", "merged", "again"):
        kept = json.loads((tmp_path / name / RECORD).read_text())["tuned"]
        assert {law: one["vary"] for law, one in kept.items()} == {
            law: {"law.gain": "0.3:8:log"} for law in LAWS
        }
        assert kept["points"]["first_seed"] == 2_000_000_000
        assert settings_of(read_comparison(tmp_path / name / "comparison.yaml")) == ""
    slower = changed(flown.comparison, set={"camera.rate_hz": 10})
    assert results_of(flown, slower).settings.startswith(
        f"{START}points and pose fly with camera.rate_hz 10 "
    )
