"""The command line as a user meets it: exit codes, what goes to which stream, and that bad input
leaves nothing behind.
"""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import get_args

import pytest

from vstestbed.cli.rendering import view_of
from vstestbed.cli.tools import Listed
from vstestbed.core.errors import ParameterError
from vstestbed.core.named_files import bundled_comparisons, bundled_scenarios
from vstestbed.laws.switched import Stage
from vstestbed.scenario import catalogue
from vstestbed.scenario.plugins import registries
from vstestbed.sim import gl_probe as gl
from vstestbed.sim.render import pictures

NO_FILM = ("--video", "none")
LAW_WORDS = ", ".join(sorted(registries()["laws"].members))
FAILS = """\
from typing import Literal
import vstestbed as vs

@vs.LAWS.add
@vs.spec
class Fails(vs.LawBase):
    kind: Literal["fails"] = "fails"

    def step(self, memory, observation, goal, basis):
        raise RuntimeError("no")
"""


class TestBadInput:
    """Exit 2, one message on standard error, and no folder."""

    def test_of_a_scenario(self, command, quick: Path) -> None:
        for words, line in (
            (
                ["arm_ibv"],
                (
                    "arm_ibv: no such file, and no bundled scenario of that name;"
                    " did you mean 'arm_ibvs'?"
                ),
            ),
            ([""], "SCENARIO: no such file"),
            (["."], ".: is a folder; give a scenario's YAML file"),
            (
                ["empty.yaml"],
                "empty.yaml:1:1: is empty; a scenario needs robot, target, law and goal",
            ),
            (["list.yaml"], "list.yaml:1:1: must be a mapping"),
            (
                ["quick.yaml", "--set", "law.gian=1"],
                "--set: law.gian: is an unknown field; did you mean 'gain'?",
            ),
            (
                ["quick.yaml", "--set", "law.gain=nan"],
                "--set: law.gain: must be a number, or a block of one of the kinds adaptive",
            ),
            (
                ["quick.yaml", "--set", "law.gain=.nan"],
                "--set: law.gain: must be a finite number, got nan",
            ),
            (
                ["quick.yaml", "--set", "stop.duration_s=nan"],
                "--set: stop.duration_s: must be a finite number, got 'nan'",
            ),
            (
                ["quick.yaml", "--set", "stop.duration_s=.inf"],
                "--set: stop.duration_s: must be a finite number, got inf",
            ),
            (
                ["quick.yaml", "--set", "camera.rate_hz=-3"],
                "--set: camera.rate_hz: must be > 0, got -3",
            ),
            (["quick.yaml", "--set", "law"], "--set needs the form a.b=value, got 'law'"),
            (["quick.yaml", "--set", "=1"], "--set needs the form a.b=value, got '=1'"),
            (["quick.yaml", "--set", "law.=1"], "--set needs the form a.b=value, got 'law.=1'"),
            (
                ["quick.yaml", "--set", "law.gain=[1"],
                "--set value is not YAML: did not find expected ',' or ']'",
            ),
            (
                ["quick.yaml", "--set", "target.side.x=1"],
                "--set: target.side.x: target.side is a value, not a block, got 0.4",
            ),
            (
                ["quick.yaml", "--set", "robot.start.nominal.xyz.3=1"],
                "there is no item 3 in a list of 3 (the first is item 0)",
            ),
            (
                ["quick.yaml", "--set", "law=nbvs"],
                f"--set: law: is no law; valid kinds: {LAW_WORDS}, got 'nbvs'",
            ),
            (
                ["quick.yaml", "--set", "law.depth=oracle", "--set", "detector=blobs"],
                "law.depth: may be oracle only with detector",
            ),
            (
                ["ibvs_retreat", "--seed", "1"],
                "robot.start.random: is missing: a seed draws the start from it",
            ),
            (
                ["quick.yaml", "--plugin", "no_such_module"],
                (
                    "--plugin: there is no module 'no_such_module' on Python's path"
                    " or in the current folder; "
                ),
            ),
        ):
            Path("empty.yaml").write_text("", encoding="utf-8")
            Path("list.yaml").write_text("- 1\n", encoding="utf-8")
            before = sorted(Path().iterdir())
            ended = command("run", *words)
            assert (ended.code, ended.out) == (2, "")
            assert line in ended.err
            assert ended.err.count("\n") == 1
            assert sorted(Path().iterdir()) == before  # above all no runs/

    def test_of_the_words_themselves(self, command, quick: Path) -> None:
        """Typer raises its own (or click's) exceptions, which have to be met as such."""
        for words, line in (
            (["run"], "Missing argument"),
            (["run", "quick.yaml", "--foo"], "No such option: --foo"),
            (["run", "quick.yaml", "extra"], "unexpected extra argument"),
            (["run", "quick.yaml", "--seed", "-1"], "Invalid value for '--seed'"),
            (["run", "quick.yaml", "--seed", "x"], "Invalid value for '--seed'"),
            (["run", "quick.yaml", "--video", "both,none"], "'camera', 'overview', 'both', 'none'"),
            (
                ["list", "nowhere"],
                (
                    "'scenarios', 'robots', 'effects', 'cameras', 'targets', 'features',"
                    " 'laws', 'detectors'"
                ),
            ),
            (["arm_ibvs"], "No such command 'arm_ibvs'"),
        ):
            ended = command(*words)
            assert (ended.code, ended.out) == (2, "")
            assert line in " ".join(ended.err.split())
            assert "Usage: vstestbed" in ended.err
            assert "Traceback" not in ended.err
            assert not Path("runs").exists()

    def test_of_the_other_commands(self, command) -> None:
        for words, line in (
            (
                ["render", "nowhere"],
                (
                    "nowhere: no such folder;"
                    " a run's folder holds scenario.yaml and log.parquet (or log.part)"
                ),
            ),
            (["report", "nowhere"], "nowhere: no such folder; a run's folder holds"),
            (["render", "."], ".: no run here; a run's folder holds"),
            (["report", "."], ".: no run here; a run's folder holds"),
            (
                ["render", ".", "--size", "big"],
                "--size needs the form WIDTHxHEIGHT in pixels, such as 1280x720, got 'big'",
            ),
            (["render", ".", "--size", "8x8"], "--size needs the form WIDTHxHEIGHT in pixels"),
            (
                ["render", ".", "--out", "film"],
                "--out must end in .mp4, or in .gif with --gif, got 'film'",
            ),
            (
                ["render", ".", "--gif", "--out", "a.mp4"],
                "--out must end in .gif, or in .mp4 without --gif, got 'a.mp4'",
            ),
        ):
            ended = command(*words)
            assert (ended.code, ended.out) == (2, "")
            assert ended.err.startswith(line)
            assert ended.err.count("\n") == 1

    def test_debug_shows_the_traceback_wherever_it_stands(self, command, quick: Path) -> None:
        for words in (["--debug", "run", "quick.yaml"], ["run", "quick.yaml", "--debug"]):
            ended = command(*words, "--set", "law.gain=-1")
            assert ended.code == 2
            assert "Traceback" in ended.err
            assert "--set: law.gain: must be > 0, got -1" in ended.err


class TestOutputFolder:
    def test_an_older_run_is_never_written_over(self, command, quick: Path) -> None:
        older = Path("out")
        older.mkdir()
        (older / "log.parquet").write_bytes(b"precious")
        ended = command("run", "quick.yaml", "--out", older, *NO_FILM)
        assert ended.code == 2
        assert (
            ended.err == "out: exists and is not an empty folder; give a new folder;"
            " an older run is never written over\n"
        )
        assert [p.name for p in older.iterdir()] == ["log.parquet"]
        assert (older / "log.parquet").read_bytes() == b"precious"

    @pytest.mark.parametrize("out", ["quick.yaml", "quick.yaml/run"])
    def test_a_place_that_cannot_be_a_folder(self, command, quick: Path, out: str) -> None:
        ended = command("run", "quick.yaml", "--out", out, *NO_FILM)
        assert ended.code == 2
        assert ended.err.startswith(f"{out}: ")
        assert ended.err.count("\n") == 1
        assert [p.name for p in Path().iterdir()] == ["quick.yaml"]

    def test_a_folder_that_may_not_be_written(self, command, quick: Path, tmp_path: Path) -> None:
        """Root may write everywhere, except into the kernel's own tree."""
        ended = command("run", "quick.yaml", "--out", "/proc/vstestbed", *NO_FILM)
        assert ended.code == 2
        assert ended.err.startswith("/proc/vstestbed: cannot be written (")
        assert ended.err.endswith("; choose another place\n")

    def test_an_empty_folder_is_used(self, command, quick: Path) -> None:
        Path("mine").mkdir()
        assert command("run", "quick.yaml", "--out", "mine", *NO_FILM, "--quiet").code == 0
        assert Path("mine/summary.json").is_file()


class TestRun:
    @pytest.fixture(autouse=True)
    def quickly(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Without drawing the report's figures, which take longer than these runs (test_runs looks
        at the report).
        """
        monkeypatch.setattr(
            "vstestbed.report.write_report", lambda folder, **_: folder / "report.html"
        )

    def test_two_runs_get_two_numbers_and_the_first_is_not_touched(
        self, command, quick: Path
    ) -> None:
        first = command("run", "quick.yaml", *NO_FILM)
        before = {p.name: p.read_bytes() for p in Path("runs/quick/001").iterdir()}
        second = command("run", "quick.yaml", *NO_FILM)
        assert (first.code, second.code) == (0, 0)
        assert sorted(p.name for p in Path("runs/quick").iterdir()) == ["001", "002"]
        assert {p.name: p.read_bytes() for p in Path("runs/quick/001").iterdir()} == before
        assert Path("runs/quick/002/log.parquet").read_bytes() == before["log.parquet"]

    def test_the_closing_words(self, command, quick: Path) -> None:
        ended = command("run", "quick.yaml", *NO_FILM)
        assert ended.out == ""
        head, judged, error, path, time, results = ended.err.splitlines()
        assert head == "converged: RMS error under 0.2 px for 0.5 s"
        assert judged.startswith("  judged    by measured pixels: 0.00")
        assert judged.endswith("limit 0.2 px")
        assert error.startswith("  error     0.00")
        assert re.fullmatch(
            (
                r"  path      at the goal from \d+\.\d s on; \d+\.\d\d times the straight line;"
                r" largest retreat \d+\.\d\d m"
            ),
            path,
        )
        assert "simulated in" in time
        assert results == "  results   runs/quick/001 (open report.html)"

    def test_json_is_the_summary_and_nothing_else(self, command, quick: Path) -> None:
        ended = command("run", "quick.yaml", *NO_FILM, "--json")
        assert ended.err == ""
        assert json.loads(ended.out) == json.loads(
            Path("runs/quick/001/summary.json").read_text(encoding="utf-8")
        )

    def test_quiet_says_nothing(self, command, quick: Path) -> None:
        ended = command("run", "quick.yaml", *NO_FILM, "--quiet")
        assert (ended.code, ended.out, ended.err) == (0, "", "")

    def test_a_goal_not_reached_is_exit_3(self, command, quick: Path) -> None:
        ended = command("run", "quick.yaml", *NO_FILM, "--set", "stop.duration_s=0.2")
        assert ended.code == 3
        assert ended.err.startswith("timed_out: 0.2 s were not enough\n")

    def test_a_target_out_of_sight_is_told_as_such(self, command, quick: Path) -> None:
        ended = command(
            "run",
            "quick.yaml",
            *NO_FILM,
            "--set",
            "robot.start.nominal.xyz=[3, 0, 0]",
            "--set",
            "stop.lost_after_s=0.1",
        )
        assert ended.code == 3
        assert ended.err.startswith("target_lost: ")
        assert "error     target not in sight; true pose of the camera: 3" in ended.err

    @pytest.mark.usefixtures("own_kinds")
    def test_a_law_that_fails_is_not_told_as_a_lost_target(
        self, command, quick: Path, tmp_path: Path
    ) -> None:
        (tmp_path / "fails.py").write_text(FAILS, encoding="utf-8")
        ended = command("run", "quick.yaml", *NO_FILM, "--plugin", "fails.py", "--set", "law=fails")
        assert (
            ended.err.startswith("law_failed: ")
            and "error     not known, since the law failed; true pose" in ended.err
        )

    def test_a_seed_draws_the_start_and_is_written_down(self, command, quick: Path) -> None:
        starts = []
        for seed in (5, 5, 6):
            ended = command("run", "quick.yaml", *NO_FILM, "--seed", seed, "--json")
            number = max(Path("runs/quick").iterdir())
            assert json.loads(ended.out)["seed"] == seed
            starts.append(
                next(
                    line
                    for line in (number / "resolved.yaml").read_text(encoding="utf-8").splitlines()
                    if "xyz" in line
                )
            )
        assert starts[0] == starts[1] != starts[2]

    def test_options_over_the_scenario_of_a_run_do_what_they_say(self, command) -> None:
        short = ("--set", "detector=oracle", "--set", "stop.duration_s=0.1")
        command(
            "run",
            "arm_ibvs",
            *NO_FILM,
            *short,
            "--seed",
            3,
            "--set",
            "robot.realism=field",
            "--out",
            "a",
        )
        for name, words in {
            "lab": ("--set", "robot.realism=lab"),
            "seed": ("--seed", 5),
            "box": ("--set", "robot.start.random.q_deg=1"),
        }.items():
            command("run", "a/scenario.yaml", *NO_FILM, *words, "--out", name)
            first = ("--set", "robot.realism=field") if name != "lab" else ()
            command(
                "run",
                "arm_ibvs",
                *NO_FILM,
                *short,
                "--seed",
                3,
                *first,
                *words,
                "--out",
                f"{name} wanted",
            )
            assert (
                Path(name, "log.parquet").read_bytes()
                == Path(f"{name} wanted", "log.parquet").read_bytes()
            )
            assert Path(name, "log.parquet").read_bytes() != Path("a/log.parquet").read_bytes()
        refused = command("run", "a/resolved.yaml", *NO_FILM, "--seed", 5)
        assert (
            refused.code == 2
            and "put other values and seeds over scenario.yaml beside it" in refused.err
        )

    def test_the_scenario_as_run_gives_the_same_log_again(self, command, quick: Path) -> None:
        command(
            "run",
            "quick.yaml",
            *NO_FILM,
            "--seed",
            2,
            "--set",
            "noise.pixel_sigma_px=0.1",
            "--set",
            "stop.converged.error_px=0.5",
        )
        command("run", "runs/quick/001/scenario.yaml", *NO_FILM, "--out", "again")
        assert (
            Path("again/log.parquet").read_bytes()
            == Path("runs/quick/001/log.parquet").read_bytes()
        )


@pytest.mark.opengl
class TestNoOpenGL:
    def test_switched_off_is_exit_4_with_the_hint_and_no_folder(
        self, command, quick: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("MUJOCO_GL", "disable")
        monkeypatch.setattr(gl, "_lack", [])
        ended = command(
            "run", "quick.yaml", "--set", "detector=blobs", "--set", "camera.renderer=gl", *NO_FILM
        )
        assert (ended.code, ended.out) == (4, "")
        assert (
            ended.err
            == "no OpenGL: MUJOCO_GL=disable is set; unset MUJOCO_GL or set MUJOCO_GL=egl\n"
        )
        assert [p.name for p in Path().iterdir()] == ["quick.yaml"]

    def test_it_is_not_needed_where_nothing_is_drawn(
        self, command, quick: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("MUJOCO_GL", "disable")
        assert command("run", "quick.yaml", *NO_FILM, "--quiet").code == 0

    def test_rays_take_its_place_with_a_line_that_says_so(
        self, command, quick: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("MUJOCO_GL", "disable")
        monkeypatch.setattr(gl, "_lack", [])
        pictures._warn_once.cache_clear()
        ended = [
            command(
                "run",
                "quick.yaml",
                "--set",
                "detector=blobs",
                "--set",
                "stop.duration_s=0.2",
                *NO_FILM,
            )
            for _ in range(2)
        ]
        assert [e.code for e in ended] == [3, 3]
        instead = "rays draw the pictures instead, without shadows"
        note = (
            f"no OpenGL: MUJOCO_GL=disable is set; {instead}; unset MUJOCO_GL or set MUJOCO_GL=egl"
        )
        assert [e.err.splitlines().count(note) for e in ended] == [1, 0]

    def test_quiet_is_quiet_about_it(
        self, command, quick: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("MUJOCO_GL", "disable")
        pictures._warn_once.cache_clear()
        ended = command(
            "run",
            "quick.yaml",
            "--set",
            "detector=blobs",
            "--set",
            "stop.duration_s=0.2",
            *NO_FILM,
            "--quiet",
        )
        assert (ended.code, ended.out, ended.err) == (3, "", "")

    @pytest.mark.process
    @pytest.mark.parametrize(
        ("hide", "line"),
        [
            ({"LD_LIBRARY_PATH": "fake"}, f"no OpenGL: libEGL.so.1 not found; {gl.remedy()}"),
            pytest.param(
                {"__EGL_VENDOR_LIBRARY_FILENAMES": "/none"},
                f"no OpenGL: libEGL starts no display; {gl.remedy()}",
                marks=pytest.mark.study,
            ),
            pytest.param(
                {"MUJOCO_GL": "vulkan"},
                "no OpenGL: MUJOCO_GL=vulkan is set, and there is no such backend",
                marks=pytest.mark.study,
            ),
        ],
    )
    def test_a_machine_without_it(
        self, quick: Path, tmp_path: Path, vstestbed_process, hide: dict[str, str], line: str
    ) -> None:
        """libEGL hidden behind an empty file of its name; libEGL without a driver; a backend that
        does not exist.
        """
        (tmp_path / "fake").mkdir()
        (tmp_path / "fake" / "libEGL.so.1").touch()
        words, environment = vstestbed_process
        words = [
            *words,
            "run",
            "quick.yaml",
            "--set",
            "detector=blobs",
            "--set",
            "camera.renderer=gl",
        ]
        done = subprocess.run(
            words, cwd=tmp_path, env=environment | hide, capture_output=True, text=True, check=False
        )
        assert done.returncode == 4, done.stderr
        assert done.stderr.startswith(line)
        assert done.stderr.count("\n") == 1
        assert not (tmp_path / "runs").exists()


class TestListAndSchema:
    @pytest.mark.parametrize("room", list(get_args(Listed)))
    def test_a_room_has_one_line_a_member(self, command, room: str) -> None:
        ended = command("list", room)
        files = {"scenarios": bundled_scenarios, "comparisons": bundled_comparisons}
        members = files[room]() if room in files else registries()[room].members
        assert ended.code == 0
        assert [line.split()[0] for line in ended.out.splitlines()] == (list(members) or ["none;"])
        # the word, and what it is
        assert all(len(line.split()) > 2 for line in ended.out.splitlines())
        # a whole sentence, though a line of the docstring may end within it
        if room not in files and members:
            assert all(line.endswith(".") for line in ended.out.splitlines())

    def test_without_a_room_it_lists_all(self, command) -> None:
        out = command("list").out
        assert [line[:-1] for line in out.splitlines() if not line.startswith(" ")] == list(
            get_args(Listed)
        )
        assert "  arm_ibvs  " in out

    def test_help_and_version(self, command) -> None:
        assert "Experiments:" in command("--help").out
        for name in (
            "run",
            "list",
            "schema",
            "render",
            "report",
            "doctor",
            "optical-flow",
        ):
            ended = command(name, "--help")
            assert ended.code == 0
            assert ended.out.startswith(f"Usage: vstestbed {name}")
        assert command("--version").out.startswith("vstestbed ")

    @pytest.mark.process
    def test_a_reader_that_goes_away_is_no_error(self, tmp_path: Path, vstestbed_process) -> None:
        words, environment = vstestbed_process
        with subprocess.Popen(
            [*words, "list"],
            cwd=tmp_path,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        ) as process:
            assert process.stdout is not None
            assert process.stderr is not None
            process.stdout.close()
            assert process.stderr.read() == b""
            assert process.wait() == 0


@pytest.mark.usefixtures("own_kinds")
def test_a_plugin_adds_a_law_to_run_list_schema_report_and_render(
    command, quick: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("timid_law.py").write_text(
        '''
from dataclasses import replace
from typing import Literal
from vstestbed.laws import IBVS, LAWS
from vstestbed.core.spec import spec

@LAWS.add
@spec
class Timid(IBVS):
    """IBVS at a share of what it would order."""

    kind: Literal["timid"] = "timid"
    share: float = 0.5

    def step(self, memory, observation, goal, basis):
        memory, command = IBVS.step(self, memory, observation, goal, basis)
        return memory, replace(command, u=self.share * command.u, twist=self.share * command.twist)
''',
        encoding="utf-8",
    )
    timid = ("--set", "law={kind: timid, gain: 6}")
    refused = command("run", "quick.yaml", *timid).err  # a file alone never imports code
    assert f"valid kinds: {LAW_WORDS}, got" in refused
    with_plugin = ("--plugin", "timid_law")
    bold, shy = (
        json.loads(
            command(
                "run",
                "quick.yaml",
                *NO_FILM,
                "--json",
                *with_plugin,
                *timid,
                "--set",
                f"law.share={share}",
            ).out
        )
        for share in (1.0, 0.5)
    )
    assert (bold["outcome"], shy["outcome"]) == ("converged", "converged")
    # The error falls as exp(-gain t): half the gain takes twice the time, within two frames of 40
    # ms.
    assert shy["time_to_converge_s"] == pytest.approx(2 * bold["time_to_converge_s"], rel=0.25)
    assert "timid IBVS at a share of what it would order." in " ".join(
        command("list", "laws", *with_plugin).out.split()
    )
    # Of a block that holds a law, in place of the whole scenario: a tenth of the work.
    monkeypatch.setattr(
        catalogue, "schema_of", lambda _, schema_of=catalogue.schema_of: schema_of(Stage)
    )
    assert "Timid" in json.loads(command("schema", *with_plugin).out)["$defs"]
    assert command("report", "runs/quick/002", *with_plugin).code == 0
    assert "share: 0.5" in Path("runs/quick/002/scenario.yaml").read_text(encoding="utf-8")


def test_flow_makes_the_folder_of_its_figure(
    command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for options, place in (
        ((), "runs/optical_flow/polar.png"),
        (("--out", "not/there/x.svg"), "not/there/x.svg"),
    ):
        ended = command("optical-flow", "--feature", "polar", *options)
        assert (
            ended.code == 0
            and ended.out.strip() == place
            and (tmp_path / place).stat().st_size > 10_000
        )


def test_a_view_is_three_or_six_numbers_from_outside(command, tmp_path: Path) -> None:
    for words in ("1,2", "1,2,3,4", "1,2,x", "1,2,0", "nan,1,2"):
        with pytest.raises(
            ParameterError, match=r"--view needs the form AZIMUTH,ELEVATION,DISTANCE\[,X,Y,Z\]"
        ):
            view_of(words)
    assert view_of(None) is None and view_of("120,-20,3,0.5,0,0.8") is not None
    ended = command("render", tmp_path, "--view", "120,-20,3", "--camera", "eye")
    assert ended.code == 2 and "--camera must be overview with --view" in ended.err
