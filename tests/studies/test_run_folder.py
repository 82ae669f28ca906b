"""A run's folder: what it holds, and that nothing in it looks finished that is not, however the run
ended.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import polars as pl
import pytest

from vstestbed.core.errors import EnvironmentLackError, OutputError, RunFolderError
from vstestbed.loop.columns import LOSS, Layout
from vstestbed.loop.log_file import Log, LogWriter, finish, open_log
from vstestbed.loop.session import run
from vstestbed.report.video.overlay import strip_height
from vstestbed.scenario.dump import load_run
from vstestbed.scenario.load import load
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.run_folder import new_folder, run_into, write_whole
from vstestbed.tasks.frame import Frame

NO_FILM = ("--video", "none")
PROMISED = {
    "scenario.yaml",
    "resolved.yaml",
    "model.xml",
    "log.parquet",
    "summary.json",
    "report.html",
}
FINISHED = {"log.parquet", "summary.json", "report.html", "camera.mp4", "overview.mp4"}
HELD_S, PICTURE_S = 1.0, 2.1 / 25
"""How long a film's last picture stays; the time of one of its pictures, which is that of two of
the camera's [s].
"""
ENDLESS = (
    "--set",
    "stop.duration_s=1000",
    "--set",
    "stop.converged.error_px=1e-9",
    "--set",
    "noise.pixel_sigma_px=0.1",
)
"""Noise of a tenth of a pixel never comes under a billionth: a run that goes on until it is
stopped.
"""


def seconds_of(film: Path) -> float:
    """How long a film is whose pictures can all be decoded [s]."""
    with av.open(str(film)) as container:
        stream = container.streams.video[0]
        return sum(1 for _ in container.decode(stream)) / float(stream.average_rate or 0)


@pytest.fixture
def scenario(quick: Path) -> Scenario:
    return load(quick)


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One run of the arm with both films, for the tests that only look at it."""
    small = {
        "camera.width": 160,
        "camera.height": 120,
        "target.marker.radius": 0.06,
        "stop.duration_s": 0.2,
    }
    folder = tmp_path_factory.mktemp("filmed") / "run"
    scenario = load("arm_ibvs", small)
    run_into(new_folder(scenario, folder), scenario, "both")
    return folder


class TestWhatARunLeaves:
    def test_the_files(self, filmed: Path) -> None:
        assert {p.name for p in filmed.iterdir()} == PROMISED | {"camera.mp4", "overview.mp4"}

    def test_every_column_with_its_type(self, filmed: Path) -> None:
        """The names that CONTRACT promises, written out here once more, so that a renamed column
        fails.
        """
        log = pl.read_parquet(filmed / "log.parquet")
        names = ["t", "frame", "lost", "error_px", "position_error_m", "rotation_error_rad"]
        names += [
            f"{name}_{i}"
            for i in range(4)
            for name in ("u", "v", "u_true", "v_true", "u_goal", "v_goal", "depth")
        ]
        names += [
            f"{who}_{part}"
            for who in ("cam", "tgt")
            for part in ("x", "y", "z", "qw", "qx", "qy", "qz")
        ]
        names += [
            f"{twist}_{part}"
            for twist in ("cmd", "act")
            for part in ("vx", "vy", "vz", "wx", "wy", "wz")
        ]
        names += [f"{kind}_joint_{i}" for i in range(1, 7) for kind in ("q", "qd", "ctrl")]
        assert set(names) <= set(log.columns)
        assert {name: log.schema[name] for name in names} == dict.fromkeys(names, pl.Float64) | {
            "frame": pl.Int64,
            "lost": pl.Boolean,
        }
        # 25 Hz for 0.2 s: pictures at 0, 40, ..., 200 ms
        assert log["frame"].to_list() == list(range(6))
        # sums of 20 steps of 2 ms, to rounding
        assert np.allclose(np.diff(log["t"]), 0.04, rtol=0, atol=1e-12)
        # unit quaternions
        assert np.allclose(
            log.select("cam_qw", "cam_qx", "cam_qy", "cam_qz").to_numpy() ** 2 @ np.ones(4), 1
        )

    def test_every_figure_of_the_summary(self, filmed: Path) -> None:
        summary = json.loads((filmed / "summary.json").read_text(encoding="utf-8"))
        promised = """
            scenario outcome success reason seed sim_time_s frames frames_lost time_to_converge_s
            final_error_px final_position_error_m final_rotation_error_deg path_length_m path_ratio
            max_retreat_m max_rotation_deg max_feature_excursion_px min_border_margin_px
            peak_speed_mps peak_rate_radps saturated_fraction wall_time_s real_time_factor time_ms
            versions"""
        assert set(promised.split()) <= set(summary)
        assert set(summary["time_ms"]) == {"physics", "render", "detect", "law", "record", "video"}
        assert set(summary["versions"]) >= {
            "vstestbed",
            "mujoco",
            "dm_control",
            "opencv",
            "numpy",
            "python",
            "renderer",
        }
        assert (summary["outcome"], summary["success"], summary["frames"]) == (
            "timed_out",
            False,
            6,
        )
        assert summary["sim_time_s"] == pytest.approx(0.2, abs=1e-9)
        assert min(summary["time_ms"][part] for part in ("physics", "render", "video")) > 0

    @pytest.mark.opengl
    def test_the_films_are_whole(self, filmed: Path) -> None:
        for name in ("camera", "overview"):
            assert seconds_of(filmed / f"{name}.mp4") == pytest.approx(0.24 + HELD_S, abs=PICTURE_S)

    def test_the_model_loads_alone(self, filmed: Path, tmp_path: Path) -> None:
        import mujoco

        shutil.copytree(filmed, tmp_path / "elsewhere")
        model = mujoco.MjModel.from_xml_path(str(tmp_path / "elsewhere" / "model.xml"))
        assert [model.site(f"target/marker_{i}").name for i in range(4)]
        assert any(model.camera(i).name.endswith("eye") for i in range(model.ncam))
        assert model.camera("overview").id >= 0

    def test_the_report_needs_nothing_outside_itself(self, filmed: Path) -> None:
        page = (filmed / "report.html").read_text(encoding="utf-8")
        assert "timed_out" in page or "timed out" in page
        assert "<svg" in page
        assert "data:video/mp4;base64," in page
        assert "http://" not in page.replace("http://www.w3.org", "")
        assert "<script src" not in page


class TestRenderAndReport:
    @pytest.fixture
    def folder(self, filmed: Path, tmp_path: Path) -> Path:
        shutil.copytree(filmed, tmp_path / "run")
        return Path("run")

    @pytest.mark.parametrize(("camera", "size"), [("overview", (96, 64)), ("eye", (80, 60))])
    @pytest.mark.opengl
    def test_a_film_again_from_each_camera_in_any_size(
        self, command, folder: Path, camera: str, size: tuple[int, int]
    ) -> None:
        before = (folder / "overview.mp4").read_bytes()
        ended = command(
            "render",
            folder,
            "--camera",
            camera,
            "--size",
            f"{size[0]}x{size[1]}",
            "--out",
            "again.mp4",
        )
        assert (ended.code, ended.out, ended.err) == (0, "", "again.mp4\n")
        with av.open("again.mp4") as container:
            assert (container.streams.video[0].width, container.streams.video[0].height) == size
        assert seconds_of(Path("again.mp4")) == pytest.approx(0.24 + HELD_S, abs=PICTURE_S)
        assert (folder / "overview.mp4").read_bytes() == before

    @pytest.mark.opengl
    def test_drafts_are_small_and_fine_films_show_every_frame(self, command, folder: Path) -> None:
        def read(name: str) -> tuple[tuple[int, int], float]:
            with av.open(name) as container:
                stream = container.streams.video[0]
                return (stream.width, stream.height), float(stream.average_rate or 0)

        assert [read("run/overview.mp4"), read("run/camera.mp4")] == [
            ((640, 360), 12.5),
            ((160, 120 + strip_height(120)), 12.5),
        ]
        assert command("render", folder, "--fine", "--out", "fine.mp4").code == 0
        assert read("fine.mp4") == ((1280, 720), 25.0)
        assert seconds_of(Path("fine.mp4")) == pytest.approx(0.24 + HELD_S)

    @pytest.mark.opengl
    def test_a_gif(self, command, folder: Path) -> None:
        ended = command("render", folder, "--gif", "--size", "96x54")
        assert (ended.code, ended.err[:52]) == (
            0,
            "run/overview.gif (96 x 54, 12.5 pictures a second, 0",
        )
        assert (folder / "overview.gif").read_bytes().startswith(b"GIF89a")
        assert {p.name for p in folder.iterdir()} == PROMISED | {
            "camera.mp4",
            "overview.mp4",
            "overview.gif",
        }

    def test_an_unknown_camera_is_refused_with_the_list_and_leaves_no_film(
        self, command, folder: Path
    ) -> None:
        ended = command("render", folder, "--camera", "hand")
        assert ended.code == 2
        assert ended.err == "--camera must be one of overview, eye, got 'hand'\n"
        assert not list(folder.glob("hand*"))

    def test_a_film_that_cannot_be_written(self, command, folder: Path) -> None:
        ended = command("render", folder, "--out", "run/summary.json/film.mp4", "--size", "32x32")
        assert ended.code == 2
        assert ended.err.startswith("run/summary.json/film.mp4: Not a directory")

    def test_the_report_again(self, command, folder: Path) -> None:
        before = (folder / "report.html").read_text(encoding="utf-8")
        (folder / "report.html").unlink()
        ended = command("report", folder)
        assert (ended.code, ended.err) == (0, "run/report.html\n")
        assert (folder / "report.html").read_text(encoding="utf-8") == before

    def test_the_log_of_another_experiment_is_refused(self, command, folder: Path) -> None:
        log = pl.read_parquet(folder / "log.parquet")
        log.drop("q_joint_3").write_parquet(folder / "log.parquet")
        ended = command("render", folder)
        assert ended.code == 2
        assert ended.err.startswith("run/log.parquet: has no column q_joint_3; ")

    @pytest.mark.parametrize("damage", [b"", b"PAR1", b"PAR1" + bytes(200)])
    def test_a_damaged_log_is_refused(self, command, folder: Path, damage: bytes) -> None:
        (folder / "log.parquet").write_bytes(damage)
        for name in ("render", "report"):
            ended = command(name, folder)
            assert ended.code == 2
            assert ended.err.startswith("run/log.parquet: cannot be read (")


class TestNewFolder:
    @pytest.fixture(autouse=True)
    def here(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)

    def test_numbers_go_up_and_are_never_used_again(self, scenario: Scenario) -> None:
        assert [new_folder(scenario, None) for _ in range(2)] == [
            Path("runs/quick/001"),
            Path("runs/quick/002"),
        ]
        Path("runs/quick/001").rmdir()
        Path("runs/quick/notes").mkdir()
        Path("runs/quick/0041").mkdir()
        assert new_folder(scenario, None) == Path("runs/quick/042")

    @pytest.mark.parametrize("name", ["..", ".", "a/b", "../../up", "/etc/x", "ü ñ", "..."])
    def test_a_name_never_leads_out_of_runs(self, scenario: Scenario, name: str) -> None:
        folder = new_folder(replace(scenario, name=name), None)
        assert folder.parent.parent == Path("runs")
        assert folder.resolve().parent.parent == Path("runs").resolve()

    def test_a_file_in_the_way_of_runs(self, scenario: Scenario) -> None:
        Path("runs").touch()
        with pytest.raises(
            OutputError, match=r"^runs/quick: cannot be written \(.*\); choose another place$"
        ):
            new_folder(scenario, None)


class TestWholeOrNotAtAll:
    def test_a_file_keeps_its_old_content_when_the_new_one_cannot_be_written(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = tmp_path / "a.txt"
        write_whole(path, "old")

        def full(descriptor: int) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "fsync", full)
        with pytest.raises(EnvironmentLackError, match="no space left on the disk"):
            write_whole(path, "new")
        assert path.read_text(encoding="utf-8") == "old"
        assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]

    def test_a_run_that_fails_before_its_first_frame_leaves_no_folder(
        self, scenario: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(tmp_path)

        def broken(*_: object, **__: object) -> None:
            raise EnvironmentLackError("no OpenGL", "get some")

        monkeypatch.setattr("vstestbed.loop.plants.build_plant", broken)
        with pytest.raises(EnvironmentLackError):
            run_into(new_folder(scenario, None), scenario, "none")
        assert not Path("runs").exists()

    def test_a_run_that_fails_later_keeps_what_it_had(
        self, scenario: Scenario, tmp_path: Path
    ) -> None:
        class Fails:
            def frame(self, frame: Frame) -> None:
                if frame.timing.number == 5:
                    raise EnvironmentLackError("the plug was pulled", "put it in again")

        folder = new_folder(scenario, tmp_path / "run")
        with pytest.raises(EnvironmentLackError, match="the plug"):
            run_into(folder, scenario, "none", [Fails()])
        assert {p.name for p in folder.iterdir()} == {
            "scenario.yaml",
            "resolved.yaml",
            "model.xml",
            "log.part",
        }
        assert open_log(folder).frame()["frame"].to_list() == [0, 1, 2, 3, 4, 5]


class TestLogPart:
    @pytest.fixture
    def part(self, scenario: Scenario, tmp_path: Path) -> Path:
        """Five rows of numbers that are hard to write down, among them NaN and infinity."""
        layout = Layout(scenario)
        writer = LogWriter(layout, tmp_path)
        rng = np.random.default_rng(0)
        for i in range(5):
            row = rng.standard_normal(len(layout.columns)) * 10.0 ** rng.integers(
                -300, 300, len(layout.columns)
            )
            row[:6] = i / 25, i, i % 2, np.nan, np.inf, -0.0
            writer.add(row[None])
        writer.close()
        return tmp_path / "log.part"

    def test_numbers_read_back_exactly(self, part: Path, scenario: Scenario) -> None:
        log = open_log(part.parent, scenario).frame()
        rng = np.random.default_rng(0)
        for i in range(5):
            row = rng.standard_normal(log.width) * 10.0 ** rng.integers(-300, 300, log.width)
            row[:6] = i / 25, i, i % 2, np.nan, np.inf, -0.0
            np.testing.assert_array_equal(np.array(log.row(i), dtype=float), row)

    def test_it_reads_at_any_length(self, part: Path, scenario: Scenario) -> None:
        """Cut at every 41st byte of its last row, beside the end of each, and through its first
        line.
        """
        whole = part.read_bytes()
        head = whole.index(b"\n") + 1
        size = (len(whole) - head) // 5  # of a row; a log without rows has no columns of a loss
        ends = [
            head + i * size + beside
            for i in range(1, 6)
            for beside in (-8, -1, 0, 1)
            if i < 5 or beside <= 0
        ]
        for length in [*range(len(whole) - size, len(whole) + 1, 41), *ends, head]:
            part.write_bytes(whole[:length])
            log = open_log(part.parent, scenario).frame()
            assert log.height == (length - head) // size
            assert log["frame"].to_list() == list(range(log.height))
        for length in (0, 1, head - 1):
            part.write_bytes(whole[:length])
            with pytest.raises(RunFolderError, match=r"log\.part ends before its first line does"):
                open_log(part.parent).frame()

    @pytest.mark.parametrize("n", [0, 1, 70])
    def test_the_finished_log_is_that_of_one_table(
        self, tmp_path: Path, scenario: Scenario, monkeypatch: pytest.MonkeyPatch, n: int
    ) -> None:
        """In row groups of 32 rows, the numbers are those that were appended; in one, the bytes are
        those of a table.
        """
        place = tmp_path / "log"
        place.mkdir()
        layout = Layout(scenario)
        columns = layout.columns
        table = np.random.default_rng(0).standard_normal((n, len(columns)))
        table[:, columns.index("frame")], table[:, columns.index("lost")] = (
            np.arange(n),
            np.arange(n) % 2,
        )
        whole = Log(columns, table).frame()
        if not n:
            whole = whole.drop(LOSS)
        whole.write_parquet(place / "whole", compression="zstd", statistics=False)
        for group in (32, 8_192):
            monkeypatch.setattr("vstestbed.loop.log_file.ROW_GROUP", group)
            writer = LogWriter(layout, place)
            for rows in np.array_split(table, 3):
                writer.add(rows)
            writer.close()
            before = open_log(place).frame()
            finish(place, writer.log())
            assert {p.name for p in place.iterdir()} == {"whole", "log.parquet"}
            for found in (before, open_log(place).frame(), pl.read_parquet(place / "log.parquet")):
                assert found.equals(whole) and found.schema == whole.schema
            same = (place / "log.parquet").read_bytes() == (place / "whole").read_bytes()
            assert same or group < n
            (place / "log.parquet").unlink()
        (place / "whole").unlink()

    def test_garbage_is_refused(self, part: Path, scenario: Scenario) -> None:
        whole, row = part.read_bytes(), 8 * len(Layout(scenario).columns)
        for damaged in (whole + row * b"x", whole.replace(b"float64: ", b"")):
            part.write_bytes(damaged)
            with pytest.raises(RunFolderError, match=r"log\.part: cannot be read"):
                open_log(part.parent, scenario).frame()

    def test_the_finished_log_goes_before_it(self, part: Path) -> None:
        pl.DataFrame({"frame": [7]}).write_parquet(part.with_name("log.parquet"))
        assert open_log(part.parent).frame()["frame"].to_list() == [7]


Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start(tmp_path: Path, vstestbed_process: tuple[list[str], dict[str, str]]) -> Iterator[Start]:
    """Starts `vstestbed run` into `run/` as a process of its own and waits until it has logged some
    frames.
    """
    words, environment = vstestbed_process
    started = []

    def call(*more: object, frames: int = 5) -> subprocess.Popen[str]:
        line = [*words, "run", "quick.yaml", "--out", "run", *map(str, more)]
        process = subprocess.Popen(
            line,
            cwd=tmp_path,
            env=environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        started.append(process)
        part, patience = tmp_path / "run" / "log.part", time.monotonic() + 60
        while not (
            part.exists() and b"\n" in part.read_bytes() and len(open_log(part.parent)) > frames
        ):
            assert process.poll() is None, process.communicate()[1]
            assert time.monotonic() < patience, "the run logs no frames"
            time.sleep(0.005)
        return process

    yield call
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.process
class TestCutOff:
    @pytest.mark.parametrize(
        "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.study)]
    )
    @pytest.mark.opengl
    def test_an_interrupt_leaves_a_whole_folder(
        self, start: Start, quick: Path, tmp_path: Path, number: signal.Signals
    ) -> None:
        films = ("--set", "detector=blobs") if number == signal.SIGINT else NO_FILM
        process = start(*ENDLESS, *films)
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
        assert process.returncode == 130, err
        assert err.startswith("interrupted: the run was interrupted\n")
        assert "Traceback" not in err + out
        folder = tmp_path / "run"
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        assert (summary["outcome"], summary["success"]) == ("interrupted", False)
        names = {p.name for p in folder.iterdir()}
        assert names == PROMISED | (
            {"camera.mp4", "overview.mp4"} if films is not NO_FILM else set()
        )
        frames = pl.read_parquet(folder / "log.parquet").height
        assert summary["frames"] == frames >= 5
        for film in folder.glob("*.mp4"):
            assert seconds_of(film) == pytest.approx(frames / 25 + HELD_S, abs=PICTURE_S)

    @pytest.mark.parametrize(
        ("more", "frames"),
        [pytest.param(("--set", "detector=blobs"), 3, marks=pytest.mark.study), (NO_FILM, 40)],
    )
    @pytest.mark.opengl
    def test_a_kill_leaves_what_there_was_and_nothing_that_looks_finished(
        self, start: Start, quick: Path, tmp_path: Path, command, more: tuple[str, ...], frames: int
    ) -> None:
        process = start(*ENDLESS, *more, frames=frames)
        time.sleep(float(np.random.default_rng().uniform(0, 0.2)))  # at any moment of a frame
        process.kill()
        process.communicate(timeout=60)
        folder = tmp_path / "run"
        assert not FINISHED & {p.name for p in folder.iterdir()}
        log = open_log(folder, load(folder / "scenario.yaml")).frame()
        assert log["frame"].to_list() == list(range(log.height))
        assert log.height >= frames
        assert command("report", folder).code == 0
        assert "cut off" in (folder / "report.html").read_text(encoding="utf-8")
        (folder / "log.part").unlink()
        layout = Layout(load(folder / "scenario.yaml"))
        rows = log.head(3).cast(pl.Float64).to_numpy()
        # the columns of a loss, which a log without one leaves out
        unlimited = np.zeros((len(rows), len(layout.columns) - rows.shape[1]))
        few = LogWriter(layout, folder)
        few.add(np.hstack([rows, unlimited]))
        few.close()
        assert command("render", folder, "--size", "64x48").code == 0
        assert seconds_of(folder / "overview.mp4") == pytest.approx(log["t"][2], abs=PICTURE_S)


@pytest.mark.process
class TestFullDisk:
    """One message, exit 4, and what was logged until then."""

    def check(self, code: int, err: str, folder: Path) -> pl.DataFrame:
        assert code == 4, err
        assert err.count("\n") == 1
        assert "Traceback" not in err
        assert not FINISHED & {p.name for p in folder.iterdir()}
        log = open_log(folder, load(folder / "scenario.yaml")).frame()
        assert log["frame"].to_list() == list(range(log.height))
        return log

    def test_files_that_may_not_grow(
        self, quick: Path, tmp_path: Path, vstestbed_process: tuple[list[str], dict[str, str]]
    ) -> None:
        """A limit of 60 kB on every file: the log meets it in mid-run (EFBIG)."""
        words, environment = vstestbed_process
        line = [*words, "run", "quick.yaml", "--out", "run", *ENDLESS, *NO_FILM]
        done = subprocess.run(
            line,
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000)),
        )
        log = self.check(done.returncode, done.stderr, tmp_path / "run")
        assert done.stderr == "run: no space left on the disk; free some, or choose another place\n"
        assert log.height > 30  # 60 kB are some sixty rows of about a kilobyte

    @pytest.fixture
    def small_disk(self, tmp_path: Path) -> Iterator[Callable[[int], Path]]:
        """Mounts a disk of so many kB; skips where that is not allowed."""
        place = tmp_path / "disk"
        place.mkdir()

        def mount(kilobytes: int) -> Path:
            words = [
                "mount",
                "-t",
                "tmpfs",
                "-o",
                f"size={kilobytes}k",
                "vstestbed-test",
                str(place),
            ]
            if (
                not shutil.which("mount")
                or subprocess.run(words, capture_output=True, check=False).returncode != 0
            ):
                pytest.skip("mounting a small disk needs root's right to mount")
            return place

        yield mount
        if place.is_mount():
            subprocess.run(["umount", str(place)], check=True)

    def test_a_disk_that_fills_up_in_mid_run(
        self, command, quick: Path, small_disk: Callable[[int], Path]
    ) -> None:
        folder = small_disk(64) / "run"
        ended = command("run", "quick.yaml", "--out", folder, *ENDLESS, *NO_FILM)
        log = self.check(ended.code, ended.err, folder)
        assert (
            ended.err
            == f"{folder}: no space left on the disk; free some, or choose another place\n"
        )
        assert log.height > 20

    def test_a_disk_without_room_for_the_film(
        self, command, quick: Path, small_disk: Callable[[int], Path]
    ) -> None:
        """The overview of 960 x 540 alone is larger than what is left."""
        folder = small_disk(40) / "run"
        ended = command("run", "quick.yaml", "--out", folder, *ENDLESS, "--video", "overview")
        self.check(ended.code, ended.err, folder)
        assert not list(folder.glob("*.mp4*"))

    def test_a_disk_without_room_for_the_report(
        self, command, quick: Path, small_disk: Callable[[int], Path]
    ) -> None:
        """What is there is whole: the run had ended."""
        folder = small_disk(62) / "run"
        ended = command("run", "quick.yaml", "--out", folder, *NO_FILM)
        assert ended.code == 4
        assert ended.err.count("\n") == 1
        assert {p.name for p in folder.iterdir()} == PROMISED - {"report.html"}
        assert (
            json.loads((folder / "summary.json").read_text(encoding="utf-8"))["outcome"]
            == "converged"
        )

    def test_a_disk_without_any_room(
        self, command, quick: Path, small_disk: Callable[[int], Path]
    ) -> None:
        place = small_disk(4)
        ended = command("run", "quick.yaml", "--out", place / "run", *NO_FILM)
        assert ended.code == 4
        assert ended.err.count("\n") == 1
        assert list(place.iterdir()) == []


class TestFoldersOfBefore:
    """A folder of version 0.1.0, whose one scenario was both what was given
    and what the seed drew.
    """

    @pytest.fixture
    def former(self, tmp_path: Path) -> Path:
        return Path(shutil.copytree(Path(__file__).parent / "former_run", tmp_path / "former"))

    def test_it_is_read_as_it_ran(self, former: Path) -> None:
        wanted = load(
            "arm_ibvs",
            {"robot.realism": "field", "detector": "oracle", "stop.duration_s": 0.4},
            seed=3,
        ).resolved
        found = load_run(former)
        assert found == replace(wanted, robot=replace(wanted.robot, start=found.robot.start))
        assert found.robot.start.nominal == wanted.robot.start.nominal
        # To rounding: at the time of this folder the Puma had a kinematics of its own.
        before, now = open_log(former), run(found)
        again = np.column_stack([now[name] for name in before.columns])  # torques have come since
        np.testing.assert_allclose(again, before.table, rtol=1e-9, atol=1e-9)

    @pytest.mark.opengl
    def test_report_and_render_read_it(self, command, former: Path) -> None:
        for words in (("report", former), ("render", former, "--size", "160x120")):
            ended = command(*words)
            assert ended.code == 0, (words, ended.err)

    @pytest.mark.app("export")
    def test_export_reads_it(self, command, former: Path) -> None:
        ended = command("export", former, "--to", "csv")
        assert ended.code == 0, ended.err
