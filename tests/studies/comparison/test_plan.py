"""What a comparison runs: controllers, seeds, folders, and what is refused before anything runs."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

from vstestbed.cli.options import settings_of, vary_of
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.named_files import bundled_comparisons
from vstestbed.studies.comparison import Comparison, Jobs, chosen, controllers
from vstestbed.studies.comparison.folder import command_of
from vstestbed.studies.comparison.plan import read_comparison

LONG = ("canonical_arm", "calibration_error", "depth_error", "realism")
"""Comparisons of hundreds of scenarios: reading them all takes seconds."""


def of(*base: object, seeds: int | None = None, **axes: tuple[object, ...]) -> Comparison:
    return Comparison(
        base=tuple(map(str, base)),
        axes={k.replace("__", "."): v for k, v in axes.items()},
        seeds=seeds,
    )


def test_every_combination_from_every_seed_seed_by_seed(quick: Path):
    found = controllers(of(quick, "ibvs_book", law__gain=(1.0, 2.0), camera__latency_s=(0.0, 0.1)))
    assert len(found) == 8
    assert [c.folder for c in found[:2]] == [
        "runs/quick/law.gain=1.0,camera.latency_s=0.0",
        "runs/quick/law.gain=1.0,camera.latency_s=0.1",
    ]
    assert found[3].scenario.law.gain.value == 2.0
    assert found[3].scenario.camera.latency_s == 0.1
    # the block is set first all the same
    inner_first = controllers(of(quick, law__gain=(0.75,), law=("ibvs", "pbvs")))
    assert [(c.scenario.law.kind, c.scenario.law.gain.value) for c in inner_first] == [
        ("ibvs", 0.75),
        ("pbvs", 0.75),
    ]
    made = Jobs(controllers(of(quick, seeds=3, law__gain=(1.0, 2.0))), 3)
    assert [(j.seed, j.controller.values["law.gain"]) for j in made] == [
        (0, 1.0),
        (0, 2.0),
        (1, 1.0),
        (1, 2.0),
        (2, 1.0),
        (2, 2.0),
    ]
    assert made[-1].folder == "runs/quick/law.gain=2.0/2"
    assert [j.folder for j in Jobs(controllers(of(quick)), None)] == ["runs/quick/as_it_is/nominal"]


def test_one_seed_gives_every_controller_the_same_start_and_other_seeds_others(quick: Path):
    made = Jobs(controllers(of("arm_ibvs", "arm_pbvs", "arm_hybrid", seeds=3)), 3)
    starts = np.array([j.scenario().resolved.robot.configuration() for j in made]).reshape(3, 3, 6)
    np.testing.assert_array_equal(starts, np.broadcast_to(starts[:, :1], starts.shape))
    assert np.abs(np.diff(starts[:, 0], axis=0)).max() > 0.01
    assert [j.scenario().seed for j in made] == [0, 0, 0, 1, 1, 1, 2, 2, 2]


def test_scenarios_of_one_name_are_refused_since_a_table_has_them_as_one(
    quick: Path, tmp_path: Path
):
    for name in ("one", "other"):
        (tmp_path / f"{name}.yaml").write_text(f"name: same\n{quick.read_text()}")
    with pytest.raises(
        ParameterError,
        match="two scenarios of the name same, one and other; give each its own `name`",
    ):
        controllers(of(tmp_path / "one.yaml", tmp_path / "other.yaml"))


def test_what_only_describes_a_run_cannot_decide(quick: Path):
    with pytest.raises(
        ParameterError,
        match="primary must be a number of which more is better, or less; this one describes a run",
    ):
        Comparison(base=(str(quick),), primary="frames")


def test_seeds_that_draw_nothing_are_refused_with_the_reason():
    with pytest.raises(
        ParameterError,
        match=(
            r"polar_book.*robot.start.random is missing,"
            r" and nothing else is random: every seed would"
        ),
    ):
        controllers(Comparison(base=("polar_book",), seeds=2, set={"robot.start.random": None}))
    unseen = {"robot.start.random": None, "noise.image_sigma": 2, "detector": "oracle"}
    with pytest.raises(ParameterError, match="every seed would"):
        controllers(Comparison(base=("polar_book",), seeds=2, set=unseen))
    noisy = Comparison(
        base=("polar_book",), seeds=2, set={"robot.start.random": None, "noise.pixel_sigma_px": 0.1}
    )
    first, second = (j.scenario() for j in Jobs(controllers(noisy), 2))
    assert (first.seed, second.seed) == (0, 1)
    np.testing.assert_array_equal(first.robot.configuration(), second.robot.configuration())


@pytest.mark.parametrize(
    "name", ["quadrotor_hover", "quadrotor_gust", "car_pbvs", "arm_track_random"]
)
def test_sensor_noise_turbulence_and_random_walks_are_draws(name: str):
    made = controllers(Comparison(base=(name,), seeds=2, set={"robot.start.random": None}))
    assert [j.scenario().seed for j in Jobs(made, 2)] == [0, 1]


def test_names_that_folders_cannot_have_and_values_that_look_alike(quick: Path):
    found = controllers(of(quick, description=("a/b: c", "a b; c", "x" * 300)))
    folders = [c.folder for c in found]
    assert len(set(folders)) == 3
    assert all(len(part) < 100 and "/" not in part for f in folders for part in f.split("/", 2)[2:])


def test_what_is_refused():
    for words, changes in (
        ("base has a scenario, or a file name, twice", {"base": ("arm_ibvs", "arm_ibvs")}),
        ("axes.law.gain must be a list of different values", {"axes": {"law.gain": (1, 1)}}),
        ("axes.law.gain must be a list of different values", {"axes": {"law.gain": (3, 3.0)}}),
        ("axes.law.gain must be a list of different values", {"axes": {"law.gain": ()}}),
        (
            "axes.law replaces the whole block, so that law.gain of",
            {"axes": {"law": ("ibvs", "pbvs")}, "set": {"law.gain": 1}},
        ),
        (
            "axes.law.gain excludes the same field in `set`",
            {"axes": {"law.gain": (1, 2)}, "set": {"law.gain": 1}},
        ),
        ("metrics must be one of sim_time_s, .*got 'speed'", {"metrics": ("speed",)}),
    ):
        with pytest.raises(ParameterError, match=words):
            Comparison(**({"base": ("arm_ibvs",)} | changes))


def test_a_value_that_no_scenario_takes_is_found_before_anything_runs(quick: Path):
    with pytest.raises(ScenarioError, match=r"law.gain"):
        controllers(of(quick, law__gain=(1.0, -1.0)))
    with pytest.raises(ScenarioError, match="no such file, and no bundled scenario"):
        controllers(of(quick, "arm_ibsv"))


class TestFile:
    def test_it_is_read_beside_its_scenarios_and_changed_by_words(
        self, quick: Path, tmp_path: Path
    ):
        path = tmp_path / "mine.yaml"
        path.write_text(
            "base: [quick.yaml]\n"
            "set: {law.gain: 2}\n"
            "axes: {camera.latency_s: [0, 0.1]}\n"
            "seeds: 4\n"
            "metrics: [path_ratio]\n"
        )
        read = read_comparison(path)
        assert (read.base, read.seeds, read.axes["camera.latency_s"]) == (
            (str(quick),),
            4,
            (0, 0.1),
        )
        asked = chosen([str(path)], {"law.gain": 3}, {}, seeds=2)
        assert (asked.set["law.gain"], asked.seeds, asked.metrics) == (3, 2, ("path_ratio",))

    def test_its_mistakes_have_their_place(self, tmp_path: Path):
        path = tmp_path / "mine.yaml"
        path.write_text("base: [arm_ibvs]\nseeds: 0\nmetrix: [path_ratio]\n")
        with pytest.raises(ScenarioError) as found:
            read_comparison(path)
        assert str(found.value).splitlines() == [
            f"{path}:2:1: seeds: must be >= 1, got 0",
            f"{path}:3:1: metrix: is an unknown field; did you mean 'metrics'?",
        ]

    @pytest.mark.parametrize(
        "name",
        [
            pytest.param(n, marks=[pytest.mark.study] if n in LONG else [])
            for n in bundled_comparisons()
        ],
    )
    def test_bundled_ones_can_be_run(self, name: str):
        comparison = chosen([name], {}, {})
        assert controllers(comparison)


def test_the_command_of_a_comparison_repeats_its_values():
    """Texts that YAML would read otherwise are quoted;
    one with `#` ended the report in an error.
    """
    values = (
        1,
        2.5,
        True,
        None,
        "on",
        "1",
        "#x",
        "a,b",
        "x: y",
        "",
        {"kind": "ibvs", "gain": 2.0},
        [0, "on"],
    )
    words = shlex.split(
        command_of(Comparison(base=("quick",), set={"name": "#1, a"}, axes={"law.gain": values}))
    )
    assert words[:3] == ["vstestbed", "compare", "quick"]
    assert settings_of([words[words.index("--set") + 1]]) == {"name": "#1, a"}
    assert vary_of([words[words.index("--vary") + 1]]) == {"law.gain": values}


def test_the_margin_is_a_share_from_0_to_a_half_and_a_tenth_where_none_is_given():
    assert of("arm_ibvs").margin == 0.1
    assert Comparison(base=("arm_ibvs",), margin=0).margin == 0
    for margin in (-0.01, 0.51, float("nan")):
        with pytest.raises((ParameterError, ValueError), match="margin"):
            Comparison(base=("arm_ibvs",), margin=margin)
