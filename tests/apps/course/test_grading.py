"""Marks: a right law has all points, a wrong one none with the reason for each, and a wrong lab is
refused before any run.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from tests.shortcuts import one_quick
from vstestbed.apps.course.grading import Needs, grade, read_lab
from vstestbed.cli.new import text_of
from vstestbed.core.errors import ScenarioError
from vstestbed.testing.likeness import Likeness

LABS = Path(__file__).parents[3] / "docs" / "course"
LAW = '''\
from typing import Literal

import vstestbed as vs

POINT = vs.features.Point()


@vs.LAWS.add
@vs.spec
class Student(vs.ErrorLaw):
    """A student's law."""

    kind: Literal["student"] = "student"
    inputs = ("xy", "depth")

    def equations(self, view, goal):
        L = POINT.interaction(view.xy, view.depth).copy()
        L[..., 5] *= {sign}
        return POINT.measure(view.xy) - POINT.measure(goal.xy), L
'''
EXACT = {"detector": "oracle", "camera.rate_hz": 10}
SOON = {"time_to_converge_s": {"at_most": 9}}
LAB = {
    "title": "A lab",
    "kind": "student",
    "check": 1,
    "tasks": [
        {"title": "It arrives.", "points": 2, "scenario": "ibvs_book", "set": EXACT, "seeds": 3},
        {
            "title": "Soon.",
            "points": 3,
            "scenario": "ibvs_book",
            "set": EXACT | {"law.gain": 1.2},
            "seeds": 3,
            "median": SOON,
        },
        {
            "title": "Better.",
            "points": 4,
            "scenario": "ibvs_book",
            "set": EXACT,
            "seeds": 8,
            "better_than": {"kind": "pbvs", "gain": 0.02},
        },
    ],
}


def lab(folder: Path, **changes: object) -> Path:
    path = folder / "lab.yaml"
    path.write_text(yaml.safe_dump(LAB | changes))
    return path


def student(folder: Path, sign: int = 1) -> Path:
    path = folder / "student.py"
    path.write_text(LAW.format(sign=sign))
    return path


def test_a_right_law_has_all_points(own_kinds, tmp_path: Path) -> None:
    titles: list[str] = []
    mark = grade(read_lab(lab(tmp_path)), student(tmp_path), first_seed=40, on_task=titles.append)
    assert mark.points == (10, 10) and titles == ["check", "It arrives.", "Soon.", "Better."]
    mark.write(tmp_path)
    assert json.loads((tmp_path / "mark.json").read_text())["points"] == 10
    assert "**10 of 10 points** (student.py)" in (tmp_path / "mark.md").read_text()


def test_each_missing_point_has_its_reason(own_kinds, tmp_path: Path) -> None:
    mark = grade(read_lab(lab(tmp_path)), student(tmp_path, sign=-1))
    assert mark.points == (0, 10)
    check, arrives, soon, better = (" ".join(result.reasons) for result in mark.results)
    assert "student must reach its goal in ibvs_book" in check
    assert arrives.startswith("0 of 3 runs reached the goal, 3 are needed (")
    assert "The median of time_to_converge_s is unknown, since no run reached the goal." in soon
    assert (
        better == "It is not better: these starts show neither better"
        " (it reached the goal from 0 of 8 starts, the other from 0)."
    )


def template(folder: Path, kind: str) -> Path:
    """What `vstestbed new law` writes, untouched."""
    path = folder / f"{kind}.py"
    path.write_text(text_of("law", kind, str(path)))
    return path


@pytest.mark.parametrize("number", one_quick(1, 2, 3))
def test_the_untouched_file_of_new_law_has_no_point_in_any_lab(
    number: int, own_kinds, tmp_path: Path
) -> None:
    """What a sheet asks to be written is not in it: each task of each lab, and the suite of the
    room with them.
    """
    read = read_lab(LABS / f"lab_{number}.yaml")
    mark = grade(read, template(tmp_path, read.kind), beside=LABS)
    assert {result.title: result.points for result in mark.results if not result.reasons} == {}


@pytest.mark.parametrize("number", one_quick(1, 2, 3))
def test_a_model_solution_of_each_lab_keeps_all_points(number: int, own_kinds) -> None:
    read = read_lab(LABS / f"lab_{number}.yaml")
    mark = grade(
        read, Path(__file__).parent / "labs" / f"{read.kind}.py", first_seed=52317, beside=LABS
    )
    assert mark.points == (10, 10), [result.reasons for result in mark.results]


def test_a_field_that_changes_nothing_has_no_point_of_part_a(own_kinds, tmp_path: Path) -> None:
    """The points are for what a law does: with a field that it does not use it moves as the file of
    `new law` does.
    """
    file = template(tmp_path, "my_ibvs")
    file.write_text(
        file.read_text().replace(
            "    depth: Depth",
            '    jacobian: Literal["present", "goal", "mean"] = "present"\n    depth: Depth',
        )
    )
    lab = read_lab(LABS / "lab_1.yaml")
    mark = grade(replace(lab, tasks=lab.tasks[:2]), file, beside=LABS)
    goal, mean = (" ".join(result.reasons) for result in mark.results[1:3])
    assert mark.points[0] == 0
    assert "max_feature_excursion_px is" in goal
    assert "path_length_m is" in mean


RENAMED = """\
from typing import Literal

import vstestbed as vs
from vstestbed.laws.base import ConstantGain, Gain


@vs.LAWS.add
@vs.spec
class Student(vs.LAWS.members["{bundled}"]):
    kind: Literal["{kind}"] = "{kind}"
"""


@pytest.mark.process
def test_a_bundled_law_under_another_name_has_no_point_where_the_sheet_does_not_ask_for_it(
    own_kinds, tmp_path: Path
) -> None:
    """Whatever its gain; of what a sheet asks for one's own, and the bundled one,
    have all points.
    """
    task = {"title": "It arrives.", "points": 2, "scenario": "ibvs_book", "set": EXACT, "seeds": 1}
    file = tmp_path / "student.py"

    def reasons(may_be: list[str]) -> tuple[str, ...]:
        return (
            grade(read_lab(lab(tmp_path, check=0, tasks=[task | {"may_be": may_be}])), file)
            .results[0]
            .reasons
        )

    file.write_text(
        RENAMED.format(bundled="pbvs", kind="student")
        + "    gain: Gain = ConstantGain(value=0.7)\n"
    )
    assert (
        reasons([])
        == reasons(["ibvs"])
        == ("Its commands are those of pbvs, which is there already.",)
    )
    assert reasons(["pbvs"]) == ()
    student(tmp_path)
    assert reasons(["ibvs"]) == ()
    assert reasons([]) == ("Its commands are those of ibvs, which is there already.",)


CLAIMS_ANOTHER = (
    RENAMED.format(bundled="{bundled}", kind="student")
    + """
    inputs = ("xy", "depth", "T_camera_target", "robot")

    def step(self, state, observation, goal, basis):
        from dataclasses import replace

        import numpy as np

        state, command = super().step(state, observation, goal, basis)
        said = np.roll(command.twist, 1) * {size}
        if command.rest_reason:
            return state, command
        return state, replace(command, {changed})
"""
)
FALSE = {
    "of rates": "twist=said, rates=command.twist",
    "of both": "twist=said, u=said, rates=command.twist",
}
POSE_BY_HAND = (
    RENAMED.format(bundled="pbvs", kind="student")
    + """
    inputs = ("xy", "depth")

    def step(self, state, observation, goal, basis):
        from dataclasses import replace

        import numpy as np

        from vstestbed.core.geometry import inverse, transform
        from vstestbed.vision.pnp import solve_pose_from_rays

        rays = np.column_stack([observation.xy, np.ones(len(observation.xy))])
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        points = transform(inverse(goal.T_camera_target), goal.ray * goal.range[:, None])
        T = solve_pose_from_rays(rays, points)
        return super().step(state, replace(observation, T_camera_target=T), goal, basis)
"""
)


@pytest.mark.process
@pytest.mark.parametrize("how", [*FALSE, "a pose by hand"])
def test_what_moves_the_robot_is_compared_and_not_what_is_said_of_it(
    how: str, own_kinds, tmp_path: Path
) -> None:
    """A bundled law whose command says another twist than its velocities make; and one that
    declares less than it computes.
    """
    task = {"title": "It arrives.", "points": 2, "scenario": "ibvs_book", "set": EXACT, "seeds": 1}
    file = tmp_path / "student.py"
    file.write_text(
        POSE_BY_HAND
        if how not in FALSE
        else CLAIMS_ANOTHER.format(bundled="pbvs", size=3.0, changed=FALSE[how])
    )
    mark = grade(read_lab(lab(tmp_path, check=1, tasks=[task | {"may_be": []}])), file)
    assert mark.results[1].reasons == (
        "Its commands are those of pbvs, which is there already.",
    ), mark.markdown()
    if how in FALSE:
        said = " ".join(mark.results[0].reasons)
        assert "twist must be" in said, said


def test_a_command_that_moves_nothing_hides_no_likeness() -> None:
    """A twist that the supervisor stops, or that limits shorten, weighs what was ordered of it; one
    that a secondary task makes is compared as it is ordered.
    """
    rng = np.random.default_rng(2)

    def share(said: Callable[[int, np.ndarray], np.ndarray], ordered: float) -> float:
        like = Likeness({})
        like.apart = {"ibvs": np.zeros(2)}
        for i in range(50):
            other = rng.standard_normal(6)
            like.given, like.own = {"ibvs": other}, said(i, other)
            stopped = i % 5 == 0
            like.frame(SimpleNamespace(twist=(0.0 if stopped else ordered) * other))  # pyright: ignore[reportArgumentType] - what is read of one
        return float((like.apart["ibvs"] / like.size).min())

    assert share(lambda i, other: other if i % 5 else np.roll(other, 1) * 1e6, 0.3) < 1e-6
    assert share(lambda i, other: np.roll(other, 1), 1.0) < 1e-6


def test_a_law_that_orders_nothing_is_like_none() -> None:
    like = Likeness({})
    like.apart = {"ibvs": np.zeros(2), "pbvs": np.zeros(2)}
    assert like.found(()) == ""
    like.size = np.ones(2)
    assert like.found(()) == "ibvs" and like.found(("pbvs",)) == ""


@pytest.mark.study
@pytest.mark.process
@pytest.mark.parametrize(
    ("number", "bundled"),
    [(1, "pbvs"), (1, "ibvs"), (2, "predictive"), (2, "pbvs"), (3, "pbvs"), (3, "hybrid")],
)
def test_a_bundled_law_under_another_name_has_no_point_in_any_lab(
    number: int, bundled: str, own_kinds, tmp_path: Path
) -> None:
    read = read_lab(LABS / f"lab_{number}.yaml")
    file = tmp_path / f"{read.kind}.py"
    fields = '    jacobian: str = "goal"\n    retreat: bool = False\n' if number == 1 else ""
    file.write_text(RENAMED.format(bundled=bundled, kind=read.kind) + fields)
    mark = grade(read, file, beside=LABS)
    assert mark.points == (0, 10), mark.markdown()


def test_a_task_is_done_with_all_of_its_settings_or_not_at_all(own_kinds, tmp_path: Path) -> None:
    task = {"title": "It arrives.", "points": 2, "scenario": "ibvs_book", "set": EXACT, "seeds": 1}
    also = [
        {"set": {"law.gain": 0.9}, "median": {"time_to_converge_s": {"at_most": 0.1}}},
        {"set": {"law.gian": 1}},
    ]
    late, unknown = (
        grade(read_lab(lab(tmp_path, check=0, tasks=[task | {"also": also}])), student(tmp_path))
        .results[0]
        .reasons
    )
    assert late.startswith("The median of time_to_converge_s is") and "gian" in unknown


def test_the_suite_of_the_room_is_worth_nothing_without_a_task(own_kinds, tmp_path: Path) -> None:
    never = [LAB["tasks"][0] | {"median": {"time_to_converge_s": {"at_most": 0.1}}}]  # pyright: ignore[reportIndexIssue, reportOperatorIssue]
    mark = grade(read_lab(lab(tmp_path, tasks=never)), student(tmp_path))
    assert mark.points == (0, 3) and mark.results[0].reasons == ("It does none of the tasks.",)


def test_a_file_that_cannot_be_loaded_or_adds_another_kind_has_no_point(
    own_kinds, tmp_path: Path
) -> None:
    broken = tmp_path / "broken.py"
    broken.write_text("import nothing_of_this_name")
    assert (
        "The file cannot be loaded: "
        in grade(read_lab(lab(tmp_path)), broken).results[0].reasons[0]
    )
    other = grade(read_lab(lab(tmp_path, kind="mine")), student(tmp_path))
    assert {result.reasons for result in other.results} == {("The file adds no kind 'mine'.",)}


def test_limits_of_numbers() -> None:
    assert not Needs(at_most=1.2).missed(1.2) and not Needs().missed(1e9)
    assert Needs(at_most=1.2).missed(1.3) == "is 1.30, at most 1.20 is allowed"
    assert Needs(at_least=10).missed(9.5) == "is 9.50, at least 10.0 is asked for"


def test_mistakes_of_a_lab_are_the_teachers_and_told_before_any_run(tmp_path: Path) -> None:
    def tasks(**changes: object) -> list[dict[str, object]]:
        return [LAB["tasks"][0] | changes]  # pyright: ignore[reportIndexIssue, reportOperatorIssue]

    for changes, words in (
        (
            {"tasks": tasks(scenario="no_such")},
            r"tasks\.0: no such file, and no bundled scenario of that name",
        ),
        (
            {"tasks": tasks(set={"camera.rate": 10})},
            r"tasks\.0: camera\.rate: is an unknown field; did you mean 'rate_hz'",
        ),
        (
            {"tasks": tasks(reached=4)},
            r"tasks\.0\.reached: must be at most the 3 runs of `seeds`, got 4",
        ),
        (
            {"tasks": tasks(median={"path_ratoi": {"at_most": 1}})},
            r"tasks\.0\.median: must be one of .*, got 'path_ratoi'",
        ),
        (
            {"tasks": tasks(scenario="camera_photometric", set={})},
            r"tasks\.0: stop\.converged\.error_grey: is told by the law itself",
        ),
        ({"tasks": tasks(may_be=["pvbs"])}, r"tasks\.0\.may_be: must be one of .*, got 'pvbs'"),
        (
            {"tasks": tasks(also=[{"set": {"camera.rate": 10}}])},
            r"tasks\.0: camera\.rate: is an unknown field",
        ),
        (
            {"tasks": tasks(also=[{"set": {}, "median": {"a": {}}}])},
            r"tasks\.0\.also\.0\.median: must be one of .*, got 'a'",
        ),
        (
            {"tasks": tasks(pionts=3)},
            r"tasks\.0\.pionts: is an unknown field; did you mean 'points'",
        ),
    ):
        with pytest.raises(ScenarioError, match=words):
            read_lab(lab(tmp_path, **changes))


def test_the_labs_of_the_course_are_whole_and_their_sheets_name_their_kind() -> None:
    for number in (1, 2, 3):
        read = read_lab(LABS / f"lab_{number}.yaml")
        sheet = (LABS / f"lab_{number}.md").read_text(encoding="utf-8")
        assert (
            f"`{read.kind}.py`" in sheet and f"vstestbed grade lab_{number} {read.kind}.py" in sheet
        )
        assert read.check + sum(task.points for task in read.tasks) == 10
        assert sheet.startswith(f"# {read.title}\n")


def test_the_command_prints_the_table_and_fails_below_a_mark(
    command, own_kinds, tmp_path: Path
) -> None:
    file = student(tmp_path, sign=-1)
    file.write_text(f"print('a word of the student')\n{file.read_text()}")
    words = ("grade", lab(tmp_path, check=0, tasks=LAB["tasks"][:1]), file, "--quiet")  # pyright: ignore[reportIndexIssue]
    printed = command(*words)
    assert printed.code == 0 and "**0 of 2 points** (student.py)" in printed.out
    assert "a word of the student" in printed.err and "a word of the student" not in printed.out
    failed = command(*words, "--pass", "1", "--json", "--out", tmp_path / "marks")
    assert (
        failed.code == 3
        and json.loads(failed.out)["of"] == 2
        and (tmp_path / "marks" / "mark.md").is_file()
    )
