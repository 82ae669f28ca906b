"""Comparisons of tasks and of named cases: their runs, their table, their page; and the canonical
ones against golden numbers.
"""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import vstestbed as vs
from tests.loop.test_golden_loops import ROWS
from tests.robots.arms import BLOCKS, HERE, NEEDS_PANDA
from tests.shortcuts import draw_one_figure, one_quick, run_here
from vstestbed.core.errors import ParameterError, ScenarioError, UnreachableError
from vstestbed.core.geometry import Pose, inverse, rigid_error, rotation_angle
from vstestbed.core.named_files import bundled_comparisons
from vstestbed.studies.comparison import (
    Comparison,
    Jobs,
    Runner,
    Variant,
    chosen,
    compare,
    controllers,
)
from vstestbed.studies.comparison.folder import table_of
from vstestbed.studies.comparison.plan import StartTable, merged
from vstestbed.studies.pools import LocalPool

YAML = """
description: Two laws turn back.
base: [ibvs_book]
set:
  name: turns
  robot.start.random: null
  target.pose.xyz: [0, 0, 0]
  detector: {kind: oracle, field_of_view: unlimited}
  stop: {duration_s: 20, converged: {error_px: 1, hold_s: 0}}
cases:
  law:
    points: {law: {kind: ibvs, gain: 1.0, depth: oracle}}
    pose: {law: {kind: pbvs, gain: 1.0}}
tasks:
  turn:
    unit: deg
    amounts: [45, 180]
    each:
      robot.start.nominal:
        - {xyz: [0, 0, -1], rpy_deg: [0, 0, 45]}
        - {xyz: [0, 0, -1], rpy_deg: [0, 0, 180]}
  random:
    seeds: 2
    set: {robot.start: {nominal: {xyz: [0, 0, -2]}, random: {rpy_deg: [5, 5, 40]}}}
metrics: [time_to_converge_s, max_retreat_m, max_rotation_deg]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("tasks")
    (place / "turns.yaml").write_text(YAML)
    with pytest.MonkeyPatch.context() as patch:
        run_here(patch)
        draw_one_figure(patch)
        compare([str(place / "turns.yaml")], out=place / "out", jobs=1)
    return place / "out"


class TestPlan:
    def test_every_case_in_every_task(self):
        whole = chosen(["canonical"], {}, {})
        found = controllers(
            replace(
                whole, cases={"law": {law: whole.cases["law"][law] for law in ("points", "pose")}}
            )
        )
        assert len(found) == 2 * 5
        assert (
            found[1].values == {"law": "points", "task": "along the axis"}
            and found[1].amounts[0] == "-0.5 m"
        )
        made = Jobs(found, None)
        assert len(made) == 2 * (10 + 7 + 5 + 8 + 20)
        assert made[0].folder == "runs/ibvs_book/law=points,task=about_the_axis/0"
        assert len({job.folder for job in made}) == len(made)

    def test_later_settings_come_later(self):
        assert list(merged({"law.gain": 1, "a": 1}, {"law": {}}, {"law.gain": 2})) == [
            "a",
            "law",
            "law.gain",
        ]
        made = Comparison(
            base=("ibvs_book",),
            set={"camera.rate_hz": 20, "law.interaction": "mean"},
            cases={"law": {"pose": {"law": {"kind": "pbvs"}}}},
            axes={"law.gain": (0.1, 0.3)},
        )
        assert [(c.scenario.law.kind, c.scenario.law.gain.value) for c in controllers(made)] == [
            ("pbvs", 0.1),
            ("pbvs", 0.3),
        ]

    def test_an_axis_may_list_whole_blocks(self):
        blocks = ({"kind": "pbvs"}, {"kind": "hybrid", "gain": 1.0})
        found = controllers(Comparison(base=("ibvs_book",), axes={"law": blocks}))
        assert [c.scenario.law.kind for c in found] == ["pbvs", "hybrid"]

    def test_what_is_refused(self):
        for words, changes in (
            ("seeds excludes tasks", {"seeds": 3, "tasks": {"a": StartTable(seeds=2)}}),
            ("cases.outcome must have a name of its own", {"cases": {"outcome": {"a": {}}}}),
            ("cases.law must have a name of its own, and one case or more", {"cases": {"law": {}}}),
        ):
            with pytest.raises(ParameterError, match=words):
                Comparison(**({"base": ("ibvs_book",)} | changes))  # pyright: ignore[reportArgumentType]

    def test_a_task_that_does_not_add_up(self):
        for words, block in (
            ("each or camera_from_goal, target_from_goal, seeds or file must say", {}),
            ("give one of the five", {"each": {"a": (1,)}, "seeds": 2}),
            (
                "give one of the five",
                {"camera_from_goal": (Pose(),), "target_from_goal": (Pose(),)},
            ),
            ("must have one value or more for each run", {"each": {"a": (1, 2), "b": (1,)}}),
            (
                "must have one value or more for each run",
                {"each": {"a": (1, 2)}, "camera_from_goal": (Pose(),)},
            ),
            (
                "amounts must be 2 names, one for each run",
                {"each": {"a": (1, 2)}, "amounts": (1.0,)},
            ),
            ("file is not there", {"file": "/nowhere.json"}),
        ):
            with pytest.raises(ParameterError, match=words):
                StartTable(**block)  # pyright: ignore[reportArgumentType]


class TestFile:
    """Start tables in a data file beside the comparison."""

    @staticmethod
    def written(folder: Path, lists: str) -> Comparison:
        (folder / "mine.json").write_text(lists)
        (folder / "mine.yaml").write_text("base: [ibvs_book]\ntasks: {starts: {file: mine.json}}\n")
        return chosen([str(folder / "mine.yaml")], {}, {})

    def test_pairs_of_goal_and_start(self, tmp_path: Path):
        goals = '{"goal.T_camera_target": [{"xyz": [0, 0, 1]}, {"xyz": [0, 0, 1.5]}]}'
        found = controllers(
            self.written(
                tmp_path,
                (
                    f'{{"each": {goals}, "camera_from_goal":'
                    ' [{"xyz": [0, 0, -1]}, {"rpy_deg": [0, 0, 9]}]}'
                ),
            )
        )
        starts = found[0].starts
        assert starts is not None and len(starts) == 2
        for i, (goal, z, yaw) in enumerate([(1.0, -1.0, 0.0), (1.5, 0.0, 9.0)]):
            s = starts[i]
            assert s.goal_poses[0][2, 3] == goal and isinstance(s.robot, vs.robots.Free)
            begun = np.linalg.inv(s.T_world_goal) @ s.robot.start.nominal.T
            assert begun == pytest.approx(Pose(xyz=(0, 0, z), rpy_deg=(0, 0, yaw)).T, abs=1e-9)

    @pytest.mark.parametrize(
        ("words", "lists"),
        [
            ("cannot be read .* works: JSON like", "no json"),
            ("cannot be read .* works: JSON like", '{"camera_from_goal": [{"xyz": [0, 0]}]}'),
            (
                "may have each, camera_from_goal, target_from_goal and about; it also has starts",
                '{"starts": []}',
            ),
            ("must hold one or more of each, camera_from_goal, target_from_goal", "{}"),
            pytest.param("it is nested too deeply.; works: JSON like", "[" * 100_000, id="nested"),
        ],
    )
    def test_what_is_refused(self, tmp_path: Path, words: str, lists: str):
        with pytest.raises(ScenarioError, match=words):
            self.written(tmp_path, lists)

    def test_a_start_has_one_number(self, tmp_path: Path):
        """In its folder, in the table's `seed`, and as the label by which a report names it, unless
        there are amounts.
        """
        found = self.written(
            tmp_path, '{"camera_from_goal": [{"xyz": [0, 0, -1]}, {"xyz": [0, 0, -2]}]}'
        )
        for job in Jobs(controllers(found), None):
            assert job.seed is not None
            assert job.controller.amounts[job.seed] == str(job.seed) == Path(job.folder).name

    def test_some_of_the_bundled_starts(self):
        """`--limit 20`: from the middle of equal parts, under the numbers that the runs have among
        all.
        """
        table = StartTable(
            file=str(bundled_comparisons()["canonical"].with_name("vitvs_starts.json"))
        )
        away = np.array([rigid_error(p.T, np.eye(4)) for p in table.displacements])
        assert table.runs == 500
        assert away.mean(axis=0) == pytest.approx([0.464, np.radians(74.1)], rel=1e-3)
        assert table.numbers(None) == table.numbers(900) == tuple(range(500))
        assert table.numbers(4) == (62, 187, 312, 437)
        some = Jobs(controllers(chosen(["canonical"], {}, {}, limit=2)), None)
        first = [job for job in some if job.controller.values["law"] == "points"]
        assert [job.seed for job in first if job.controller.values["task"] == "about the axis"] == [
            2,
            7,
        ]
        assert [job.seed for job in first if job.controller.values["task"] == "random"] == [0, 1]
        with pytest.raises(ParameterError, match="limit is for a comparison with `tasks`"):
            chosen(["arm_ibvs"], {}, {}, limit=2)


class TestFolder:
    def test_one_row_a_run_with_its_task_and_amount(self, folder: Path):
        table = pl.read_parquet(folder / "comparison.parquet")
        assert len(table) == 2 * 4
        assert table.columns[:6] == ["scenario", "law", "task", "seed", "folder", "amount"]
        turns = table.filter(pl.col("task") == "turn").select("law", "amount", "outcome").rows()
        assert turns == [
            ("points", "45 deg", "converged"),
            ("pose", "45 deg", "converged"),
            ("points", "180 deg", "diverged"),
            ("pose", "180 deg", "converged"),
        ]

    def test_the_table_names_each_failure(self, folder: Path):
        lines = (folder / "tasks.md").read_text().splitlines()
        assert lines[0] == "| | turn | random |"
        assert (
            lines[2].startswith("| `points` | 1 of 2, ")
            and "; 180 deg: diverged | 2 of 2, " in lines[2]
        )
        assert lines[3].startswith("| `pose` | 2 of 2, ")
        page = (folder / "report.html").read_text()
        assert "Largest retreat [m]" in page
        assert "180 deg: diverged" in page and "vstestbed compare comparison.yaml" in page
        assert (folder / "figures" / "tasks.png").is_file()
        assert (folder / "figures" / "tasks.pdf").is_file()

    def test_other_metrics_have_a_table_of_median_and_largest(self, folder: Path):
        whole = (folder / "tasks.md").read_text()
        labels = ("Largest retreat [m]", "Largest rotation [deg]")
        retreat, rotation = (
            whole.split(f"{label}: median and largest of the runs that reached the goal\n\n")[
                1
            ].split("\n\n")[0]
            for label in labels
        )
        assert "Time to converge [s]" not in whole
        # Of the points' turns only that of 45 degrees arrives: a retreat of 1 / cos(22.5 deg) - 1 =
        # .082 m, in steps of a tenth 1 cm more.
        median, largest = retreat.splitlines()[2].split("|")[2].split(",")
        assert float(median) == float(largest) == pytest.approx(0.082, abs=0.012)
        assert retreat.splitlines()[3].startswith("| `pose` | 0, 0 |")
        # The pose law turns by 45 and 180 degrees and no more, less what the threshold leaves.
        median, largest = rotation.splitlines()[3].split("|")[2].split(",")
        assert float(median) == pytest.approx(112.5, abs=1)
        assert float(largest) == pytest.approx(180, abs=1)

    def test_its_plan_makes_the_same_again(self, folder: Path):
        again = controllers(chosen([str(folder / "comparison.yaml")], {}, {}))
        assert [(c.folder, c.runs) for c in again] == [
            (f"runs/ibvs_book/law={law},task={task}", 2)
            for law in ("points", "pose")
            for task in ("turn", "random")
        ]


GOLDEN_LAWS = {
    "points": ("ibvs_point", "CURRENT"),
    "points_desired": ("ibvs_point", "DESIRED"),
    "points_mean": ("ibvs_point", "MEAN"),
    "polar": ("ibvs_polar", "MEAN"),
    "pose": ("pbvs_cdMc", "CURRENT"),
    "pose_origin": ("pbvs_cMo", "CURRENT"),
    "hybrid": ("vs2half_cdRc", "CURRENT"),
}
GOLDEN_STARTS = {
    ("about the axis", "90 deg"): "rotz90",
    ("about the axis", "180 deg"): "rotz180",
    ("along the axis", "1 m"): "ztrans",
}


def tasks_of(
    comparison: str, law: str, *names: str, base: tuple[str, ...] = (), **settings: object
) -> dict[str, Variant]:
    """One law's controllers of a comparison, by task; base: scenarios in place of its own."""
    whole = chosen([comparison, *base], settings, {})
    wanted = {name: task for name, task in whole.tasks.items() if name in names}
    found = controllers(replace(whole, cases={"law": {law: whole.cases["law"][law]}}, tasks=wanted))
    return {str(c.values["task"]): c for c in found}


@pytest.mark.parametrize("law", one_quick(*GOLDEN_LAWS, every=3))
def test_canonical_cells_are_the_golden_ones(law: str):
    found = tasks_of("canonical", law, *(task for task, _ in GOLDEN_STARTS))
    for (task, amount), start in GOLDEN_STARTS.items():
        controller = found[task]
        assert controller.starts is not None
        r = vs.run(controller.starts[controller.amounts.index(amount)])
        row = next(
            g for g in ROWS if (g["scenario"], g["law"], g["L"]) == (start, *GOLDEN_LAWS[law])
        )
        expected = {
            "target_plane_crossed_or_behind": "target_lost",
            "diverged_dist>200m": "diverged",
        }.get(row["status"], row["status"])
        assert r.outcome.name == expected
        if expected == "converged":  # the golden files' own tolerances
            assert abs(len(r["t"]) - 1 - int(row["it_e<1e-3"])) <= 1
            farthest_m = np.linalg.norm([r["cam_x"], r["cam_y"], r["cam_z"]], axis=0).max()
            assert farthest_m == pytest.approx(float(row["max_cam_dist_m"]), abs=1e-3)
            # A golden path ends at a norm of 1e-5, ours at 1e-3: the camera is then a few mm from
            # its goal (t_err_m goes with the norm).
            rest_m = 100 * float(row["t_err_m"])
            assert r.summary()["path_length_m"] == pytest.approx(
                float(row["path_len_m"]), abs=1e-3 + rest_m
            )


PEER_PATHS = {10: 1.705, 16: 2.128}
"""Paths of an independent library [m] from two of the random starts, in which markers pass within 8
px of the principal point.
"""


def test_canonical_polar_paths_near_the_centre_are_the_peers():
    (found,) = (
        c for name, c in tasks_of("canonical", "polar", "random").items() if name == "random"
    )
    made = Jobs([found], None)
    for seed, path_m in PEER_PATHS.items():
        assert vs.run(made[seed].scenario()).summary()["path_length_m"] == pytest.approx(
            path_m, abs=1e-3
        )


def amounts_of(controller: Variant) -> list[tuple[float, np.ndarray]]:
    """Each amount with T_goal_camera of its start."""
    made = []
    assert controller.starts is not None
    for i, (words, s) in enumerate(zip(controller.amounts, controller.starts, strict=True)):
        T = (
            inverse(s.T_world_goal)
            @ s.robot.flange_pose(s.robot.configuration())
            @ s.camera.mount.T
        )
        if i not in controller.unreachable:
            made.append((float(words.split()[0]), T))
    return made


@pytest.mark.parametrize(
    ("comparison", "base"),
    one_quick(
        ("canonical", ()),
        ("canonical_arm", ()),
        ("canonical_arm", ("arm_jaco",)),
        pytest.param("canonical_arm", ("arm_panda",), marks=NEEDS_PANDA),
    ),
)
def test_starts_are_what_their_amounts_say(comparison: str, base: tuple[str, ...]):
    found = tasks_of(
        comparison,
        "points",
        "about the axis",
        "along the axis",
        "camera turned",
        "target turned",
        base=base,
    )
    goal_m = found["target turned"].scenario.goal_poses[-1][2, 3]
    # Joint angles are written to 1e-4 deg, which over an arm of .9 m is 2 um, and .001 deg.
    for amount, T in amounts_of(found["about the axis"]):
        assert T[:3, 3] == pytest.approx([0, 0, 0], abs=1e-5)
        assert (
            math.degrees(rotation_angle(T[:3, :3])) == pytest.approx(amount, abs=1e-3)
            and abs(T[2, 2] - 1) < 1e-6
        )
    for amount, T in amounts_of(found["along the axis"]):
        assert (
            T[:3, 3] == pytest.approx([0, 0, -amount], abs=1e-5)
            and rotation_angle(T[:3, :3]) < 1e-5
        )
    for amount, T in amounts_of(found["camera turned"]):
        assert T[:3, 3] == pytest.approx([0, 0, 0], abs=1e-5)
        assert (
            math.degrees(rotation_angle(T[:3, :3])) == pytest.approx(amount, abs=1e-3)
            and abs(T[1, 1] - 1) < 1e-6
        )
    for amount, T in amounts_of(found["target turned"]):
        to_target = np.array([0, 0, goal_m]) - T[:3, 3]
        assert np.linalg.norm(to_target) == pytest.approx(goal_m, abs=1e-5)
        assert T[:3, 2] == pytest.approx(to_target / goal_m, abs=1e-5)
        assert math.degrees(rotation_angle(T[:3, :3])) == pytest.approx(amount, abs=1e-3)


def test_any_arm_takes_the_place_of_the_puma():
    block = {"kind": "mjcf", "file": str(HERE / "seven.xml")} | BLOCKS["seven"]
    wide = {"camera.mount": {"xyz": [0, 0, 0.1]}, "target.pose.xyz": [1.6, 0, 0.7]}
    for base, settings in ((("arm_jaco",), {}), ((), {"robot": block, **wide})):
        found = tasks_of("canonical_arm", "points", "along the axis", base=base, **settings)[
            "along the axis"
        ]
        assert (
            found.starts is not None
            and found.scenario.robot.kind == "mjcf"
            and len(found.starts) == 5
            and len(found.unreachable) < 5
        )
    # the Puma itself starts where it always did
    puma = tasks_of("canonical_arm", "points", "target turned")["target turned"].starts
    assert puma is not None
    q_deg = np.degrees(puma[-1].robot.configuration())
    assert q_deg == pytest.approx(
        [13.6908, -11.3281, -139.5257, 11.8322, 91.5406, -6.6218], abs=2e-4
    )


def test_a_start_out_of_reach_is_told_in_the_table(tmp_path: Path):
    task = StartTable(
        camera_from_goal=(Pose(xyz=(0, 0, 0.01)), Pose(xyz=(0, 0, 5))), amounts=(0.01, 5), unit="m"
    )
    settings = {"detector": {"kind": "oracle"}, "stop.duration_s": 5, "stop.converged.error_px": 3}
    made = controllers(Comparison(base=("arm_jaco",), set=settings, tasks={"ahead": task}))
    runner = Runner(tmp_path, Jobs(made, None))
    with closing(LocalPool(1, tmp_path)) as pool:
        runner.run(pool)
    table = table_of(tmp_path, runner.jobs)
    assert table["outcome"].to_list() == ["converged", "unreachable"]
    assert table["success"].to_list() == [True, False]
    assert table["seed"].to_list() == [0, 1]  # also of a start that cannot be drawn
    assert "is out of its reach: it stays" in table["reason"][1]
    meshes = list((tmp_path / table["folder"][0] / "assets").iterdir())
    # one copy for all runs
    assert len(meshes) == 5 and all(mesh.stat().st_nlink == 2 for mesh in meshes)
    with pytest.raises(UnreachableError):
        runner.jobs[1].scenario()


def test_the_ideal_camera_of_realism_starts_where_the_arm_does():
    whole = chosen(["realism"], {}, {})
    worlds = {world: whole.cases["world"][world] for world in ("ideal", "noise")}
    found = controllers(
        replace(
            whole,
            cases=whole.cases | {"law": {"points": whole.cases["law"]["points"]}, "world": worlds},
        )
    )
    free, arm = (
        Jobs([c for c in found if c.values["world"] == world], 3) for world in ("ideal", "noise")
    )
    for one, other in zip(free, arm, strict=True):
        a, b = one.scenario().resolved, other.scenario().resolved
        assert a.robot.flange_pose(a.robot.configuration()) == pytest.approx(
            b.robot.flange_pose(b.robot.configuration()), abs=1e-12
        )
