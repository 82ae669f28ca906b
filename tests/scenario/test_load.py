"""Scenario files: every mistake named at once with its place, changes by overrides, and what is
written reads back the same.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from ruamel.yaml import YAML

from tests.robots.arms import where_installed
from tests.scenario.schemas import whole_schema
from tests.shortcuts import one_quick
from vstestbed.core.errors import ParameterError, PluginError, ScenarioError
from vstestbed.core.named_files import bundled_scenarios
from vstestbed.core.spec import spec
from vstestbed.laws import IBVS
from vstestbed.scenario.dump import dump
from vstestbed.scenario.load import find, load, parse
from vstestbed.scenario.plugins import load_plugins, registries
from vstestbed.scenario.scenario import Scenario, in_view
from vstestbed.scenario.yaml_marks import plain_mapping, read_value

GOOD = """\
robot:
  kind: puma560
  start: {nominal: {q_deg: [0, 45, -180, 0, 45, -45]}}
camera: {rate_hz: 25, latency_s: 0.04}
target:
  kind: square
  side: 0.5
  pose: {xyz: [1.5, 0, 0.7], rpy_deg: [0, 90, 0]}
law: {kind: ibvs, gain: 0.5, depth: pnp}
goal: {T_camera_target: {xyz: [0, 0, 1]}}
"""
NAMES = sorted(bundled_scenarios())


def kinds_of(room: str) -> str:
    """The words of a room's list, as messages have them."""
    return ", ".join(sorted(registries()[room].members))


@spec
class Eager(IBVS):
    """What an installed package may add."""

    kind: Literal["eager"] = "eager"


def mistakes(text: str, **settings: object) -> list[str]:
    """What is said of a file `s.yaml` with this text."""
    with pytest.raises(ScenarioError) as told:
        parse(text, "s.yaml", {k.replace("__", "."): v for k, v in settings.items()})
    return [str(mistake) for mistake in told.value.mistakes]


def changed(old: str, new: str) -> str:
    assert GOOD.count(old) == 1
    return GOOD.replace(old, new)


class TestOneMistake:
    """Each is one line `FILE:LINE:COL: field: sentence` that points at the very place."""

    @pytest.mark.parametrize(
        ("old", "new", "line"),
        [
            (
                "law: {",
                "lwa: {",
                (
                    f"s.yaml:1:1: law: is missing; valid kinds: {kinds_of('laws')}\n"
                    "s.yaml:9:1: lwa: is an unknown field; did you mean 'law'?"
                ),
            ),
            (
                "gain: 0.5",
                "gian: 0.5",
                "s.yaml:9:19: law.gian: is an unknown field; did you mean 'gain'?",
            ),
            (
                "gain: 0.5",
                "feature: {kind: point, deepth: 1}",
                "s.yaml:9:42: law.feature.deepth: is an unknown field; valid: kind",
            ),
            (
                "gain: 0.5",
                "gain: {kind: constant, slope_at_zero: 1}",
                "law.gain.slope_at_zero: is an unknown field of constant; adaptive has it",
            ),
            (
                "rate_hz: 25",
                "ratehz: 25",
                "s.yaml:4:10: camera.ratehz: is an unknown field; did you mean 'rate_hz'?",
            ),
            ("side: 0.5", "side: wide", "s.yaml:7:3: target.side: must be a number, got 'wide'"),
            ("side: 0.5", 'side: "0.5"', "s.yaml:7:3: target.side: must be a number, got '0.5'"),
            ("side: 0.5", "side: true", "s.yaml:7:3: target.side: must be a number, got True"),
            ("side: 0.5", "side: [0.5]", "s.yaml:7:3: target.side: must be a number, got [0.5]"),
            ("side: 0.5", "side:", "s.yaml:7:3: target.side: must be a number, got None"),
            (
                "side: 0.5",
                "side: .nan",
                "s.yaml:7:3: target.side: must be a finite number, got nan",
            ),
            (
                "side: 0.5",
                "side: -.inf",
                "s.yaml:7:3: target.side: must be a finite number, got -inf",
            ),
            (
                "side: 0.5",
                "side: 1e999",
                "s.yaml:7:3: target.side: must be a finite number, got inf",
            ),
            ("side: 0.5", "side: 0", "s.yaml:7:3: target.side: must be > 0, got 0"),
            (
                "xyz: [1.5, 0, 0.7]",
                "xyz: [1.5, .nan, 0.7]",
                "s.yaml:8:21: target.pose.xyz.1: must be a finite number, got nan",
            ),
            (
                "xyz: [1.5, 0, 0.7]",
                "xyz: [1.5, 0]",
                "s.yaml:8:10: target.pose.xyz: must be a list of 3 items, got [1.5, 0]",
            ),
            (
                "xyz: [1.5, 0, 0.7]",
                "xyz: 3",
                "s.yaml:8:10: target.pose.xyz: must be a list, such as [0.0, 0.0, 0.0], got 3",
            ),
            ("rate_hz: 25", "rate_hz: -25", "s.yaml:4:10: camera.rate_hz: must be > 0, got -25"),
            (
                "rate_hz: 25",
                "shadows: 1",
                "s.yaml:4:10: camera.shadows: must be true or false, got 1",
            ),
            (
                "rate_hz: 25",
                "width: 640.5",
                "s.yaml:4:10: camera.width: must be a whole number, got 640.5",
            ),
            (
                "kind: puma560",
                "kind: puma",
                (
                    "s.yaml:2:3: robot.kind: is no robot;"
                    f" valid kinds: {kinds_of('robots')}, got 'puma'"
                ),
            ),
            (
                "kind: square\n",
                "\n",
                f"s.yaml:5:1: target: needs a kind; valid kinds: {kinds_of('targets')}",
            ),
            (
                "depth: pnp",
                "depth: magic",
                f"law.depth: is no depth; valid kinds: {kinds_of('depths')}, got 'magic'",
            ),
            (
                "gain: 0.5",
                "gain: fast",
                (
                    "law.gain: must be a number, or a block of one of the kinds adaptive,"
                    " constant, got 'fast'"
                ),
            ),
            ("gain: 0.5", "gain: .nan", "s.yaml:9:19: law.gain: must be a finite number, got nan"),
            (
                "gain: 0.5",
                "gain: {kind: constant, value: -1}",
                "s.yaml:9:42: law.gain.value: must be > 0, got -1",
            ),
            (
                "depth: pnp",
                "interaction: old",
                "law.interaction: must be one of 'current', 'desired' or 'mean', got 'old'",
            ),
            (
                "depth: pnp",
                "depth: oracle",
                "s.yaml:9:30: law.depth: may be oracle only with detector: {kind: oracle}",
            ),
            (
                "side: 0.5",
                "side: 0.5\n  marker: {radius: -1}",
                "s.yaml:8:12: target.marker.radius: must be > 0, got -1",
            ),
            (
                "side: 0.5",
                "side: 0.5\n  marker: {radius: 0.3}",
                "target.marker.radius: must be under half of the smallest gap",
            ),
            (
                "45, -180, 0",
                "45, 180, 0",
                (
                    "s.yaml:3:36: robot.start.nominal.q_deg.2:"
                    " must be within joint_3's range, -225 to 45 deg"
                ),
            ),
            (
                "xyz: [0, 0, 1]",
                "xyz: [0, 0, -1]",
                (
                    "s.yaml:10:8: goal.T_camera_target:"
                    " is a view in which markers 0, 1, 2, 3 are behind"
                ),
            ),
            (
                "xyz: [0, 0, 1]",
                "xyz: [0.6, 0, 1]",
                (
                    "is a view in which markers 1, 2 are outside the 640 x 480 picture;"
                    " move the goal back"
                ),
            ),
            (
                "goal: {",
                "goal: 3 #",
                (
                    "s.yaml:10:1: goal: must be a goal block or one of the words:"
                    f" {kinds_of('goals')}, got 3"
                ),
            ),
        ],
    )
    def test_in_a_field(self, old: str, new: str, line: str) -> None:
        told = "\n".join(mistakes(changed(old, new)))
        assert line in told
        assert told.count("\n") == line.count("\n"), told  # one mistake, one line
        assert all(re.match(r"s\.yaml:\d+:\d+: [\w.]+: \S", one) for one in told.splitlines())

    def test_in_the_whole_file(self) -> None:
        for text, line in (
            ("", "s.yaml:1:1: is empty; a scenario needs robot, target, law and goal"),
            ("# nothing\n", "s.yaml:1:1: is empty; a scenario needs robot, target, law and goal"),
            (
                "- a\n- b\n",
                (
                    "s.yaml:1:1: must be a mapping (name: value);"
                    " a scenario needs robot, target, law and goal"
                ),
            ),
            (
                "just words\n",
                (
                    "s.yaml:1:1: must be a mapping (name: value);"
                    " a scenario needs robot, target, law and goal"
                ),
            ),
            (
                "robot: [1, 2\nlaw: }\n",
                "s.yaml:2:4: is not YAML: did not find expected ',' or ']', got ':'",
            ),
            (
                "\tlaw: 1\n",
                "s.yaml:1:1: is not YAML: found character that cannot start any token, got '\\t'",
            ),
            ("a: 1\n---\nb: 2\n", "s.yaml:2:1: is not YAML: but found another document"),
            ("law: \x01\n", "s.yaml:1:6: is not YAML: unacceptable character #x0001; delete it"),
            ("seed: " + "9" * 5000 + "\n", "s.yaml:1:7: is not YAML: Exceeds the limit"),
            (
                "law: {{a: [1]}: 2}\n",
                "s.yaml:1:7: holds YAML beyond plain mappings, lists and values",
            ),
            (
                "law: !!omap x\n",
                (
                    "s.yaml:1:1: law: has the tag tag:yaml.org,2002:omap;"
                    " a scenario holds plain values only"
                ),
            ),
            (
                GOOD + "law: ibvs\n",
                (
                    "s.yaml:11:1: law: stands here for the second time in its block;"
                    " keep one of the two"
                ),
            ),
            (
                "law: !!python/object:os.system x\n",
                "s.yaml:1:1: law: has the tag tag:yaml.org,2002:python/object:os.system",
            ),
            (
                "law: " + "[" * 40 + "]" * 40,
                "s.yaml:1:37: is nested more than 32 deep; a scenario needs far less",
            ),
        ):
            told = mistakes(text)
            assert len(told) == 1
            assert told[0].startswith(line)
            assert "\n" not in told[0]

    def test_of_two_blocks_the_one_that_is_meant(self) -> None:
        for random, line in (
            ("{xyz: [0, 0, 1e9]}", "robot.start.random.xyz.2: must be -1000 to 1000 m"),
            (
                "{random: {q_deg: -1}}",
                "s.yaml:3:29: robot.start.random.random.q_deg: must be >= 0, got -1",
            ),
            (
                "{nominal: {q_deg: [0, 0], qdg: 1}}",
                (
                    "s.yaml:3:45: robot.start.random.nominal.qdg: is an unknown field;"
                    " did you mean 'q_deg'?"
                ),
            ),
            (
                "3",
                (
                    "s.yaml:3:11: robot.start.random:"
                    " must be a block (a mapping) of xyz, rpy_deg, got 3"
                ),
            ),
        ):
            robot = f"robot:\n  kind: free\n  start: {{random: {random}, nominal: {{}}}}\n"
            (told,) = mistakes(robot + GOOD[GOOD.index("camera:") :])
            assert told.startswith("s.yaml:3:") and line in told

    def test_nesting_too_deep_for_the_parser(self) -> None:
        """A hundred thousand brackets would overflow the stack of libyaml's composer."""
        assert mistakes("seed: 1\nlaw: " + "[" * 100_000) == [
            "s.yaml:2:37: is nested more than 32 deep; a scenario needs far less"
        ]

    def test_merges_of_merges_are_gone_through_once(self) -> None:
        """Nine merges of nine of nine ...: 9^12 ways to one field, of which a loader that goes each
        would never come back.
        """
        merges = "\n".join(
            ["m0: &m0 {a: 1}"]
            + [f"m{i}: &m{i} {{<<: [{', '.join([f'*m{i - 1}'] * 9)}]}}" for i in range(1, 13)]
        )
        plain, _ = plain_mapping(f"{merges}\n<<: *m12\n", "s.yaml", "")
        assert plain["a"] == 1 and plain["m12"] == {"a": 1}

    def test_aliases_of_aliases_do_not_fill_the_memory(self) -> None:
        """Nine lists of nine of the one before would be 9^9 = 387 million values."""
        lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
        lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 9)]
        assert "brings the file to more than 20000 values" in mistakes("\n".join(lines))[0]

    def test_a_block_inside_itself_ends(self) -> None:
        (told,) = mistakes("robot: &r {kind: free, start: *r}\n")
        assert "is nested more than 32 deep" in told


def test_all_mistakes_are_told_at_once_in_the_order_of_the_file() -> None:
    text = (
        GOOD.replace("side: 0.5", "side: -1")
        .replace("gain: 0.5", "gian: 1")
        .replace("rate_hz: 25", "rate_hz: fast")
    )
    assert mistakes(text + "physic: {step_s: 1}\n", law__smooth_start_s=-1) == [
        "s.yaml:4:10: camera.rate_hz: must be a number, got 'fast'",
        "s.yaml:7:3: target.side: must be > 0, got -1",
        "s.yaml:9:19: law.gian: is an unknown field; did you mean 'gain'?",
        "s.yaml:11:1: physic: is an unknown field; did you mean 'physics'?",
        "overrides: law.smooth_start_s: must be >= 0, got -1",
    ]


def test_missing_blocks_are_all_named() -> None:
    told = mistakes("seed: 1\n")
    assert [line.split(": ")[1] for line in told] == ["robot", "target", "law", "goal"]
    assert f"s.yaml:1:1: robot: is missing; valid kinds: {kinds_of('robots')}" in told


def test_a_rate_and_a_step_that_do_not_divide_are_told_with_both_numbers() -> None:
    """25 Hz is 40 ms, which 3 ms do not divide; 40/14 ms = 2.857 ms do and are the next smaller
    step.
    """
    (told,) = mistakes(GOOD + "physics: {step_s: 0.003}\n")
    assert re.fullmatch(
        (
            r"s\.yaml:11:11: physics\.step_s: must divide the camera's period 0\.04 s \(25 Hz\);"
            r" 0\.002857142\d+ does, got 0\.003"
        ),
        told,
    )
    suggested = parse(GOOD + f"physics: {{step_s: {1 / 25 / 14!r}}}\n", "s.yaml")
    assert suggested.physics.resolve(suggested.camera)[1] == 14


def test_a_target_of_one_marker_is_refused() -> None:
    target = changed("kind: square\n  side: 0.5\n", "kind: points\n  at: [[0, 0, 0]]\n")
    assert mistakes(target) == [
        "s.yaml:5:1: target: has 1 marker, and law ibvs needs 3 or more for this robot's motions"
    ]


def test_numbers_are_those_of_yaml_1_2() -> None:
    """YAML 1.1 would read 1e-3 as a text and `no` as false."""
    scenario = parse(
        changed("gain: 0.5", "gain: 1e-3").replace("side: 0.5", "side: 5e-1"), "s.yaml"
    )
    assert scenario.law.gain.value == 0.001
    assert scenario.target.side == 0.5
    assert parse("description: no\n" + GOOD, "s.yaml").description == "no"


def test_merge_keys_bring_values_in() -> None:
    text = GOOD.replace("law: {kind", "law: {<<: {gain: -2}, kind").replace("gain: 0.5, ", "")
    # it has no place of its own: its block's
    assert mistakes(text) == ["s.yaml:9:1: law.gain: must be > 0, got -2"]


class TestFiles:
    def told(self, name: str | Path) -> str:
        with pytest.raises(ScenarioError) as error:
            load(name)
        assert "\n" not in str(error.value)
        return str(error.value)

    @pytest.mark.parametrize("name", ["arm_ibv", "arm_ibvs.yml", "nowhere/arm_ibvss.yaml"])
    def test_a_missing_file_with_the_nearest_bundled_name(self, name: str) -> None:
        assert (
            self.told(name) == f"{name}: no such file, and no bundled scenario of that name;"
            " did you mean 'arm_ibvs'?"
        )

    def test_a_missing_file_like_none_that_is_bundled(self) -> None:
        assert self.told("zzz.yaml").endswith(f"valid: {', '.join(NAMES)}")
        assert self.told("").startswith("SCENARIO: no such file")

    def test_a_folder(self, tmp_path: Path) -> None:
        assert self.told(tmp_path) == f"{tmp_path}: is a folder; give a scenario's YAML file"

    def test_a_name_longer_than_the_system_allows(self) -> None:
        assert "cannot be read (File name too long)" in self.told("a" * 5000)

    def test_a_file_that_is_not_utf_8(self, tmp_path: Path) -> None:
        path = tmp_path / "latin.yaml"
        path.write_bytes("seed: 1\ndescription: größe\n".encode("latin-1"))
        assert (
            self.told(path) == f"{path}:2:16: is not UTF-8 text (byte 0xf6); save the file as UTF-8"
        )

    def test_a_byte_order_mark_does_no_harm(self, tmp_path: Path) -> None:
        path = tmp_path / "bom.yaml"
        path.write_bytes(b"\xef\xbb\xbf" + GOOD.encode())
        assert load(path).name == "bom"

    def test_a_bundled_name_goes_before_a_file_which_a_path_names(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(tmp_path)
        Path("arm_ibvs").write_text(GOOD, encoding="utf-8")
        assert find("arm_ibvs") == bundled_scenarios()["arm_ibvs"]
        assert find("./arm_ibvs") == find(Path("arm_ibvs")) == Path("arm_ibvs")
        assert load("./arm_ibvs").name == "arm_ibvs"


class TestSet:
    """`--set` edits the mapping before it is checked, with the same messages."""

    def test_a_field_a_list_item_a_word_a_new_block(self) -> None:
        for field, value, found in (
            ("law.gain", 1.5, lambda s: s.law.gain.value == 1.5),
            ("law.depth.depth_m", 2, None),
            ("detector", "oracle", lambda s: s.detector.kind == "oracle"),
            ("detector.field_of_view", "unlimited", None),
            (
                "robot.start.nominal.q_deg.0",
                7,
                lambda s: s.robot.start.nominal.q_deg == (7, 45, -180, 0, 45, -45),
            ),
            ("noise.pixel_sigma_px", 0.3, lambda s: s.noise.pixel_sigma_px == 0.3),
            ("stop", {"duration_s": 3}, lambda s: s.stop.duration_s == 3),
            ("camera.latency_s", 0, lambda s: s.camera.latency_s == 0 and s.camera.rate_hz == 25),
        ):
            # the bare word that stands there, or the default's kind, does not have this field, and
            # the message knows it
            if found is None:
                assert "overrides: " in mistakes(GOOD, **{field.replace(".", "__"): value})[0]
            else:
                assert found(parse(GOOD, "s.yaml", {field: value}))

    def test_a_bare_word_becomes_a_block_with_more_fields(self) -> None:
        scenario = parse(
            changed("depth: pnp", "depth: constant"), "s.yaml", {"law.depth.depth_m": 2.5}
        )
        assert scenario.law.depth.depth_m == 2.5
        assert (
            parse(
                GOOD, "s.yaml", {"law.depth": "constant", "law.depth.depth_m": 3}
            ).law.depth.depth_m
            == 3
        )

    def test_they_are_a_dictionary(self) -> None:
        with pytest.raises(
            ScenarioError,
            match=r"overrides: must be a dictionary, such as \{'law.gain': 1.0\}, got 'law.gain=1'",
        ):
            load("arm_ibvs", "law.gain=1")  # pyright: ignore[reportArgumentType]  # the mistake

    def test_what_is_given_is_not_changed(self) -> None:
        mine = {"kind": "ibvs", "gain": 1.0}
        parse(GOOD, "s.yaml", {"law": mine, "law.gain": 2.0})
        assert mine == {"kind": "ibvs", "gain": 1.0}

    def test_what_is_refused(self) -> None:
        for field, value, line in (
            ("law.gian", 1, "overrides: law.gian: is an unknown field; did you mean 'gain'?"),
            ("law.gain", float("nan"), "overrides: law.gain: must be a finite number, got nan"),
            (
                "law.kind",
                "ibv",
                f"overrides: law.kind: is no law; valid kinds: {kinds_of('laws')}, got 'ibv'",
            ),
            (
                "law",
                "ibv",
                f"overrides: law: is no law; valid kinds: {kinds_of('laws')}, got 'ibv'",
            ),
            (
                "target.side.x",
                1,
                "overrides: target.side.x: target.side is a value, not a block, got 0.5",
            ),
            ("nope.deeper.still", 1, "overrides: nope: is an unknown field; did you mean"),
            (
                "robot.start.nominal.q_deg.6",
                1,
                "there is no item 6 in a list of 6 (the first is item 0)",
            ),
            (
                "robot.start.nominal.q_deg.x",
                1,
                "there is no item x in a list of 6 (the first is item 0)",
            ),
            ("robot.start.nominal.q_deg.-1", 1, "there is no item -1 in a list of 6"),
            (
                "robot.start.nominal.q_deg.2",
                180,
                "robot.start.nominal.q_deg.2: must be within joint_3's range, -225 to 45 deg",
            ),
            ("law.", 1, "overrides: law.: is no path to a field, such as law.gain"),
            ("", 1, "is no path to a field, such as law.gain"),
        ):
            told = mistakes(GOOD, **{field.replace(".", "__"): value})
            assert len(told) == 1
            assert line in told[0]
            assert told[0].startswith("overrides: ")

    @pytest.mark.parametrize(
        ("text", "value"),
        [
            ("1e-3", 0.001),
            ("[1, 2]", [1, 2]),
            ("{kind: oracle}", {"kind": "oracle"}),
            ("raw", "raw"),
            ("", None),
            ("true", True),
        ],
    )
    def test_values_are_yaml(self, text: str, value: object) -> None:
        assert read_value(text) == value

    def test_a_value_that_is_not_yaml_is_told_in_one_line(self) -> None:
        with pytest.raises(
            ParameterError,
            match=r"--set value is not YAML: did not find expected ',' or '\]', got '\[1'$",
        ):
            read_value("[1")


class TestSeed:
    def test_a_seed_draws_the_same_start_for_everybody(self) -> None:
        a, b = (load("arm_ibvs", seed=3).resolved.robot.start.nominal.q_deg for _ in range(2))
        assert a == b
        assert a != load("arm_ibvs", seed=4).resolved.robot.start.nominal.q_deg
        other = load("arm_ibvs", {"law.gain": 2.0}, seed=3).resolved
        assert other.robot.start.nominal.q_deg == a  # one seed, the same start for every controller
        # the box of the file
        assert np.abs(np.array(a) - load("arm_ibvs").robot.start.nominal.q_deg).max() <= 15

    def test_without_a_random_block_it_is_refused_with_an_example(self) -> None:
        with pytest.raises(
            ScenarioError,
            match=r"s\.yaml:3:3: robot.start.random: is missing: .*e\.g\. {q_deg: 15}",
        ):
            parse(GOOD, "s.yaml", seed=1)

    def test_without_a_random_block_it_still_draws_the_noise(self) -> None:
        noisy = parse(GOOD, "s.yaml", {"noise.pixel_sigma_px": 0.5}, seed=9)
        assert noisy.seed == 9
        assert noisy.robot == parse(GOOD, "s.yaml").robot

    def test_a_box_from_which_nothing_sees_the_target_is_refused(self) -> None:
        with pytest.raises(ScenarioError, match=r"robot.start.random: gave no start in 1000 draws"):
            parse(
                GOOD,
                "s.yaml",
                {"robot.start.random": {"q_deg": 1}, "target.pose.xyz": [-1.5, 0, 0.7]},
                seed=1,
            )


class TestBundled:
    @pytest.mark.parametrize("name", where_installed(NAMES))
    def test_loads_with_its_goal_and_its_start_in_view(self, name: str) -> None:
        scenario = load(name)
        assert scenario.name == name
        assert scenario.description.endswith(".")
        # natural features need no corner of the picture that they are in
        markers = scenario.detector.rows is None
        # for other tasks some of the target may be out of sight
        if markers and scenario.goal.kind in ("view", "view_from", "views"):
            counted = scenario.goal_view.counted
            assert scenario.camera.inside(
                scenario.goal_view.uv[slice(None) if counted is None else counted]
            ).all()
        # where several cameras tell, one need not see all
        if scenario.goal.kind != "line" and scenario.fusion == "none":
            s = scenario
            view = in_view(s.robot, s.camera, s.target, s.detector, s.goal_views[0], s.world)
            assert view, "the start does not see the whole target"

    def test_every_default_is_written(self) -> None:
        written = YAML(typ="safe").load(dump(parse(GOOD, "s.yaml"), defaults=True))
        assert written["stop"] == {
            "duration_s": 30.0,
            "converged": {
                "error_px": 0.2,
                "position_m": None,
                "rotation_deg": None,
                "error_grey": None,
                "hold_s": 0.5,
            },
            "lost_after_s": 1.0,
            "lost_after_m": 2.0,
            "rest_after_s": 2.0,
            "frozen_after_s": None,
        }
        assert written["camera"]["width"] == 640
        assert written["detector"]["kind"] == "blobs"
        assert written["robot"]["actuation"] == "industrial"
        assert written["target"]["marker"] == {
            "kind": "disc",
            "radius": 0.02,
            "lit": True,
            "saturation": 1.0,
            "albedo": 1.0,
            "hues": [],
        }
        drift = {"brightness": 0.0, "color": 0.0, "contrast": 0.0, "period_s": 10.0}
        target = {"image_sigma": 0.0, "perturb": []}
        assert written["noise"] == {
            "image_sigma": 0.0,
            "pixel_sigma_px": 0.0,
            "dropout": 0.0,
            "drift": drift,
            "perturb": [],
            "target": target,
        }


def conforms(value: Any, rule: dict[str, Any], whole: dict[str, Any]) -> bool:
    """As much of JSON Schema as the scenario's schema uses."""
    if "$ref" in rule and not conforms(
        value, whole["$defs"][rule["$ref"].rsplit("/", 1)[1]], whole
    ):
        return False
    if "anyOf" in rule and not any(conforms(value, r, whole) for r in rule["anyOf"]):
        return False
    types = {
        "object": dict,
        "array": list,
        "string": str,
        "number": int | float,
        "integer": int,
        "boolean": bool,
        "null": type(None),
    }
    if "type" in rule and (
        not isinstance(value, types[rule["type"]])
        or (isinstance(value, bool) and rule["type"] != "boolean")
    ):
        return False
    if ("const" in rule and value != rule["const"]) or (
        "enum" in rule and value not in rule["enum"]
    ):
        return False
    if isinstance(value, int | float) and not (
        rule.get("exclusiveMinimum", -1e300) < value and rule.get("minimum", value) <= value
    ):
        return False
    if isinstance(value, dict):
        known = rule.get("properties", {})
        unknown = set(value) - set(known) if rule.get("additionalProperties") is False else set()
        if unknown or any(name not in value for name in rule.get("required", [])):
            return False
        return all(conforms(value[name], known[name], whole) for name in value if name in known)
    return not isinstance(value, list) or all(
        conforms(v, rule.get("items", {}), whole) for v in value
    )


class TestSchema:
    @pytest.fixture
    def whole(self) -> dict[str, Any]:
        return whole_schema(Scenario)

    def test_it_knows_every_field_and_kind(self, whole: dict[str, Any]) -> None:
        assert {"robot", "target", "law", "goal"} == set(whole["required"])
        # two classes of one name go by their modules', too
        known = {name.rpartition("__")[2] for name in whole["$defs"]}
        for kinds in registries().values():
            assert {member.__name__ for member in kinds.members.values()} <= known

    @pytest.mark.parametrize("name", one_quick(*where_installed(NAMES), every=3))
    def test_what_is_written_conforms_as_the_file_does_and_reads_back_as_the_same(
        self, name: str, whole: dict[str, Any]
    ) -> None:
        scenario = load(name)
        text = dump(scenario, defaults=True)
        again = parse(text, "again.yaml")
        assert again == scenario
        assert dump(again, defaults=True) == text
        for written in (bundled_scenarios()[name].read_text(encoding="utf-8"), text):
            assert conforms(YAML(typ="safe").load(written), whole, whole)

    @pytest.mark.parametrize(
        ("old", "new"),
        [
            ("kind: puma560", "kind: puma"),
            ("depth: pnp", "depth: magic"),
            ("gain: 0.5", "gian: 0.5"),
            ("side: 0.5", "side: wide"),
            ("side: 0.5", "side: -1"),
            ("law: {kind", "lwa: {kind"),
            ("kind: square\n", "\n"),
        ],
    )
    def test_mistakes_do_not(self, old: str, new: str, whole: dict[str, Any]) -> None:
        assert conforms(YAML(typ="safe").load(GOOD), whole, whole)
        assert not conforms(YAML(typ="safe").load(changed(old, new)), whole, whole)


@pytest.mark.usefixtures("own_kinds")
class TestPlugins:
    def test_an_installed_package_adds_a_kind_by_its_entry_point(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        class Entry:
            def load(self) -> type:
                return Eager

        offered = type(
            "Offered",
            (),
            {"select": lambda _, group: [Entry()] if group == "vstestbed.laws" else []},
        )()
        monkeypatch.setattr("importlib.metadata.entry_points", lambda: offered)
        load_plugins([])
        assert isinstance(parse(changed("kind: ibvs", "kind: eager"), "s.yaml").law, Eager)

    def test_an_entry_point_that_fails_is_named(self, monkeypatch: pytest.MonkeyPatch) -> None:
        class Entry:
            def load(self) -> type:
                raise ModuleNotFoundError("No module named 'torch'")

        offered = type(
            "Offered",
            (),
            {"select": lambda _, group: [Entry()] if group == "vstestbed.laws" else []},
        )()
        monkeypatch.setattr("importlib.metadata.entry_points", lambda: offered)
        with pytest.raises(
            PluginError, match=r"installed plugin of vstestbed.laws: cannot be imported .*torch"
        ):
            load_plugins([])


class TestContradictions:
    """What only shows when the blocks are looked at together."""

    def test_a_setting_is_blamed_for_its_own_mistake(self) -> None:
        with pytest.raises(ScenarioError) as caught:
            load("arm_ibvs", {"goal.T_camera_target.xyz": [2, 0, 1]})
        assert str(caught.value).startswith(
            "overrides: goal.T_camera_target: is a view in which markers 0, 1, 2, 3 are outside"
        )

    def test_a_setting_elsewhere_is_blamed_too(self) -> None:
        with pytest.raises(ScenarioError, match=r"^overrides: goal"):
            load("arm_ibvs", {"camera.width": 100})

    def test_parts_that_do_not_belong_together(self) -> None:
        for settings, words in (
            (
                {"stop.duration_s": 1e-3},
                "stop.duration_s: must be at least one camera period, 0.04 s",
            ),
            (
                {
                    "target": {
                        "kind": "points",
                        "at": [[-0.2, 0, 0], [0, 0, 0], [0.2, 0, 0]],
                        "pose": {"xyz": [1.5, 0, 0.7]},
                    }
                },
                "law.depth: may not be pnp: all markers lie on one line",
            ),
        ):
            with pytest.raises(ScenarioError, match=words):
                load("arm_ibvs", settings)

    def test_a_field_of_another_law_is_told_as_such(self) -> None:
        with pytest.raises(
            ScenarioError,
            match=(
                r"^overrides: law.turn_limits_deg: is an unknown field of hybrid;"
                r" partitioned has it$"
            ),
        ):
            load("arm_hybrid", {"law.turn_limits_deg": "none"})

    def test_a_field_within_a_list_has_its_whole_place(self) -> None:
        with pytest.raises(
            ScenarioError,
            match=r"^overrides: goal.views.0.marker: is an unknown field; did you mean 'markers'",
        ):
            load("arm_docking", {"goal.views.0.marker": [1]})

    @pytest.mark.parametrize("name", ["arm_pbvs", "arm_hybrid"])
    def test_a_law_without_a_depth_is_not_told_to_change_it(self, name: str) -> None:
        line = [[-0.2, 0, 0], [0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]]
        target = {
            "kind": "points",
            "at": line,
            "pose": {"xyz": [1.5, 0, 0.7], "rpy_deg": [0, 90, 0]},
        }
        with pytest.raises(ScenarioError, match=r"^overrides: target: has all markers on one line"):
            load(name, {"target": target})
