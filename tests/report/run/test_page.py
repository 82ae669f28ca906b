"""The report of a run that never happened but could have: an ideal camera that nears its goal view
exponentially.
"""

from __future__ import annotations

import base64
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from tests.report.html import Reader, checked
from vstestbed.core.errors import RunFolderError, ScenarioError
from vstestbed.core.geometry import (
    Array,
    Pose,
    exp,
    inverse,
    quaternion_wxyz,
    rigid_error,
    transform,
)
from vstestbed.loop.log_file import Log
from vstestbed.report import Setting, render_page, write_report
from vstestbed.report.marks import marker_colors, number
from vstestbed.report.run import page
from vstestbed.report.run.tracks import MOST_ROWS, LogArrays

SCENARIO = "robot: free\nlaw: {kind: ibvs, gain: 0.5}  # <b>not bold</b> & so on\n"
TEXTS = {"scenario.yaml": SCENARIO, "resolved.yaml": SCENARIO}

WIDTH, HEIGHT, FOCAL = 640, 480, 384.0


def ring(n: int) -> Array:
    """n points on a circle of 0.25 m (one point: off the centre), shape (n, 3)."""
    angle = 2 * np.pi * np.arange(n) / n + np.pi / 4
    return 0.25 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)


def setting(markers: int) -> Setting:
    """The facts of the synthetic scenario."""
    return Setting(
        WIDTH,
        HEIGHT,
        0.2,
        ring(markers),
        Pose(xyz=(0, 0, 1)).T,
        "A camera nears a ring of markers.",
        changed=("law.gain=2",),
    )


def log(
    frames: int = 250,
    markers: int = 4,
    joints: tuple[str, ...] = ("joint1", "joint2"),
    lost: slice = slice(60, 70),
) -> pl.DataFrame:
    """A log with the columns of the contract: 25 Hz, gain 0.6, noise of 0.05 px, the target lost
    for a stretch.
    """
    rng = np.random.default_rng(0)
    t = np.arange(frames) / 25
    T_world_target = Pose(xyz=(1.5, 0, 0.7), rpy_deg=(0, 90, 0)).T
    points, T_goal = ring(markers), Pose(xyz=(0, 0, 1)).T
    offset = np.array([0.3, -0.25, 0.9, 0.15, -0.2, 1.0])
    rows = [_row(time, T_world_target, T_goal, points, offset, rng) for time in t]
    table = pl.DataFrame(rows, schema=None if rows else _schema(markers), infer_schema_length=None)
    table = table.with_columns(
        _hide(np.isin(np.arange(frames), np.arange(frames)[lost]), markers) if frames else []
    )
    wave = [
        pl.Series(f"{stem}_{n}", scale * np.sin(t + k))
        for stem, scale in (("q", 1.0), ("qd", 0.4), ("ctrl", 9.0))
        for k, n in enumerate(joints)
    ]
    return table.with_columns(wave)


def _row(
    t: float,
    T_world_target: Array,
    T_goal: Array,
    points: Array,
    offset: Array,
    rng: np.random.Generator,
) -> dict[str, Any]:
    left = np.exp(-0.6 * t)
    T_camera_target = exp(offset * left) @ T_goal
    T_world_camera = T_world_target @ inverse(T_camera_target)
    p, g = transform(T_camera_target, points), transform(T_goal, points)
    centre = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
    true, goal = p[:, :2] / p[:, 2:] * FOCAL + centre, g[:, :2] / g[:, 2:] * FOCAL + centre
    uv = true + rng.normal(0, 0.05, true.shape)
    position, angle = rigid_error(T_camera_target, T_goal)
    row: dict[str, Any] = {"t": t, "frame": round(t * 25), "lost": False}
    for i in range(len(points)):
        for name, value in (("", uv), ("_true", true), ("_goal", goal)):
            row |= {f"u{name}_{i}": value[i, 0], f"v{name}_{i}": value[i, 1]}
        row[f"depth_{i}"] = p[i, 2] * (1 + 0.1 * left)
    row |= {
        "error_px": float(np.sqrt(np.mean((goal - uv) ** 2))),
        "position_error_m": position,
        "rotation_error_rad": angle,
    }
    for stem, T in (("cam", T_world_camera), ("tgt", T_world_target)):
        row |= dict(
            zip(
                (f"{stem}_{a}" for a in ("x", "y", "z", "qw", "qx", "qy", "qz")),
                [*T[:3, 3], *quaternion_wxyz(T[:3, :3])],
                strict=True,
            )
        )
    command = 0.6 * left * offset
    row |= dict(
        zip((f"cmd_{a}" for a in ("vx", "vy", "vz", "wx", "wy", "wz")), command, strict=True)
    )
    return row | dict(
        zip((f"act_{a}" for a in ("vx", "vy", "vz", "wx", "wy", "wz")), 0.97 * command, strict=True)
    )


def _hide(hidden: Array, markers: int) -> list[pl.Series | pl.Expr]:
    """Columns as they are while the target is lost: nothing measured."""
    mask = pl.Series("lost", hidden.astype(bool))
    names = [f"{a}_{i}" for a in ("u", "v", "depth") for i in range(markers)] + ["error_px"]
    return [mask, *(pl.when(mask).then(float("nan")).otherwise(pl.col(n)).alias(n) for n in names)]


def _schema(markers: int) -> dict[str, Any]:
    row = _row(
        0.0, np.eye(4), Pose(xyz=(0, 0, 1)).T, ring(markers), np.zeros(6), np.random.default_rng(0)
    )
    kinds: dict[type, Any] = {bool: pl.Boolean, int: pl.Int64}
    return {name: kinds.get(type(value), pl.Float64) for name, value in row.items()}


def summary(**changes: object) -> dict[str, Any]:
    """A summary with every name of the contract."""
    made: dict[str, Any] = {
        "scenario": "arm_ibvs",
        "outcome": "converged",
        "success": True,
        "reason": "RMS error under 0.2 px for 0.5 s",
        "seed": 0,
        "sim_time_s": 10.0,
        "frames": 250,
        "frames_lost": 10,
        "time_to_converge_s": 8.76,
        "final_error_px": 0.1234,
        "judged_error": 0.1234,
        "judged_unit": "px",
        "judged_limit": 0.2,
        "judged_by": "pixels",
        "final_position_error_m": 0.000456,
        "final_rotation_error_deg": 0.0789,
        "path_length_m": 1.2345,
        "path_ratio": 1.0467,
        "max_retreat_m": 0.0,
        "max_rotation_deg": 57.3,
        "max_feature_excursion_px": 210.5,
        "min_border_margin_px": 31.25,
        "peak_speed_mps": 0.61,
        "peak_rate_radps": 0.62,
        "saturated_fraction": 0.125,
        "wall_time_s": 2.5,
        "real_time_factor": 4.0,
        "time_ms": {
            "physics": 4.1,
            "render": 2.3,
            "detect": 0.9,
            "law": 0.3,
            "record": 0.05,
            "video": 1384.2,
        },
        "versions": {
            "vstestbed": "0.1.0",
            "mujoco": "3.17.0",
            "dm_control": "1.0.50",
            "opencv": "5.0.0",
            "numpy": "2.4.6",
            "python": "3.11.9",
            "renderer": "llvmpipe <LLVM 15 & co>",
        },
    }
    return made | changes


# of two features, own columns, further cameras
OF_ANGLES = ("polar", "spherical", "on_sphere", "own_columns", "other_cameras")
OF_VEHICLES = ("plane", "task_error", "localisation_error", "wheels", "slip")
OF_FLIGHTS = ("velocity", "tilt", "rates", "rotors")
EVERY_FIGURE = [
    title
    for draw, title in page.FIGURES.items()
    if draw.__name__ not in (*OF_ANGLES, *OF_VEHICLES, *OF_FLIGHTS)
]


def test_the_page_stands_alone_and_has_it_all(tmp_path: Path) -> None:
    film = tmp_path / "camera.mp4"
    film.write_bytes(b"a film")
    text = render_page(log(), summary(), TEXTS, {"camera": film}, setting(4))
    reader = checked(text)
    assert reader.figures == EVERY_FIGURE
    for words in (
        "arm_ibvs",
        "Converged",
        (
            "RMS error under 0.2 px for 0.5 s."
            " Task error by measured pixels: 0.123 px, limit 0.200 px."
        ),
        "A camera nears a ring of markers.",
        "Changed in this run: law.gain=2",
        "What the camera sees",
        "threshold 0.2 px",
        "target lost",
        "joint1",
    ):
        assert words in reader.text
    for name, value in (
        ("Time to converge", "8.76 s"),
        ("Measured image error", "0.123 px"),
        ("True position error", "0.456 mm"),
        ("Frames with a limited command", "12.5 %"),
        ("Peak speed", "0.610 m/s"),
        ("Frames without target", "10"),
        ("Path over straight line", "1.05 ×"),
        ("numpy", "2.4.6"),
        ("physics", "4.10 ms"),
        ("video", "1384 ms"),
    ):
        assert f"{name} {value}" in reader.text
    assert "data:video/mp4;base64," + base64.b64encode(b"a film").decode() in text
    assert "outcome good" in text


def test_failure_is_told_and_coloured_as_such() -> None:
    text = render_page(
        log(),
        summary(outcome="target_lost", success=False, reason="gone", time_to_converge_s=None),
        TEXTS,
        {},
    )
    assert "outcome good" not in text
    said = checked(text).text
    assert (
        "Target lost Gone. Task error by measured pixels: 0.123 px, limit 0.200 px." in said
        and "Time to converge –" in said
    )


def test_a_law_that_measures_no_markers_has_its_error_in_grey_levels() -> None:
    text = checked(
        render_page(log(10), summary(final_error_px=None, final_error_grey=0.39), TEXTS, {})
    ).text
    assert "Measured image error 0.390 grey levels" in text


def test_limits_and_joints_that_friction_held_are_told() -> None:
    t = np.arange(0, 4, 0.04)
    speed = np.where((t > 1) & (t < 2), 0.0, 0.1)
    made = pl.DataFrame(
        {
            "t": t,
            "scale": np.where(t < 0.5, 0.4, 1.0),
            "qd_joint_1": speed,
            "ctrl_joint_1": 0.1 + 0 * t,
        }
    )
    # it stands since it is told to
    made = made.with_columns(qd_joint_2=pl.lit(0.0), ctrl_joint_2=pl.lit(0.0))
    assert page.events(LogArrays.of(made, Setting())) == [
        "Limits of law or robot shortened or turned 13 of its 100 commands, the last at 0.48 s.",
        (
            "Friction held joint_1 for up to 0.92 s although it was told to move,"
            " first at 1.04 s (stick-slip)."
        ),
    ]
    assert (
        page.events(
            LogArrays.of(made.with_columns(scale=pl.lit(1.0), qd_joint_1=pl.lit(0.1)), Setting())
        )
        == []
    )


def test_a_loss_has_its_name_also_in_one_frame_and_without_a_shorter_command() -> None:
    t = np.arange(0, 4, 0.04)
    one = pl.DataFrame(
        {
            "t": t,
            "scale": 1.0 + 0 * t,
            "limit": np.where(t == t[7], 3.0, 0.0),
            "turned_rad": np.where(t == t[7], 0.4, 0.0),
        }
    )
    assert page.events(LogArrays.of(one, Setting())) == [
        "Limits of law or robot shortened or turned 1 of its 100 commands, the last at 0.28 s.",
        "The robot's limits were: singular 1 frame; its motion was turned by up to 23 degrees.",
    ]


def test_what_still_moves_in_the_last_second_is_told() -> None:
    """A steering that swings, a slide, a joint that stands, wheels that are not driven, a camera on
    its true path.
    """
    t = np.arange(0, 4, 0.04)
    swings = {
        "q_steering": 0.4 * np.sin(9 * t),
        "ctrl_steering": 0 * t,
        "q_rear_left": t,
        "q_slide": 0.03 * t,
        "ctrl_slide": 0 * t,
    }
    still = {"q_joint": 5e-3 * t, "ctrl_joint": 0 * t}  # 5 mrad in the last second
    law = {"cmd_vx": 8.0 + 0 * t}  # of which limits leave little
    path = {f"cam_{axis}": 0 * t for axis in ("y", "z", "qx", "qy")} | {
        "cam_x": 0.05 * t,
        "cam_qw": np.cos(t / 2),
        "cam_qz": np.sin(t / 2),
    }
    log = pl.DataFrame({"t": t, "scale": 1.0 + 0 * t, **swings, **still, **law, **path})
    assert page.still_moving(LogArrays.of(log, Setting(slides=("slide",)))) == [
        "steering by 0.796 rad from end to end",  # of .8, between pictures
        "slide by 28.8 mm from end to end",  # .03 m/s over the 24 steps of .04 s between 25 frames
        "the camera by 48.0 mm along its path",
        "the camera's direction by 0.960 rad along its path",  # a turn at 1 rad/s
    ]
    assert page.still_moving(LogArrays.of(log.head(0), Setting())) == []
    (words,) = page.events(LogArrays.of(log.head(60), Setting(slides=("slide",))))
    assert words.startswith(
        "In its last second it still moved,"
        " by more than the 0.02 rad or m of a robot that stands: steering by"
    )
    (words,) = page.events(LogArrays.of(log, Setting(band_m=0.25)))
    assert words.startswith(
        "Its task has no end, and in its last second it moved on, by more than the 0.02 rad or m of"
    )
    standing = log.select("t", "scale", "q_joint", "ctrl_joint")
    assert page.events(LogArrays.of(standing, Setting(band_m=0.25))) == []


def test_text_is_escaped() -> None:
    nasty = summary(
        scenario="<script>alert(1)</script>", reason='a < b & "c"', versions={"<i>": "<u>"}
    )
    reader = checked(
        render_page(
            log(10),
            nasty,
            TEXTS,
            {},
            Setting(description="<img src=x>", changed=("law=<img src=x>",)),
        )
    )
    assert "<script>alert(1)</script>" in reader.text  # as words, not as an element
    assert "# <b>not bold</b> & so on" in reader.text
    assert "<img src=x>" in reader.text


@pytest.mark.study
def test_the_same_run_gives_the_same_page() -> None:
    pages = [render_page(log(50), summary(), TEXTS, {}, setting(4)) for _ in range(2)]
    assert pages[0] == pages[1]


def test_figures_follow_light_and_dark() -> None:
    text = render_page(log(10), summary(), TEXTS, {}, setting(4))
    assert "prefers-color-scheme: dark" in text
    for drawing in text.split("<svg role")[1:]:
        assert "var(--ink)" in drawing and "var(--rule)" in drawing
    assert "#010203" not in text and "#a1b2c3" not in text


@pytest.mark.parametrize(("frames", "markers"), [(0, 1), (1, 24), (2, 1), (40, 2)])
def test_any_length_and_number_of_markers(frames: int, markers: int) -> None:
    reader = checked(
        render_page(log(frames, markers, joints=()), summary(), TEXTS, {}, setting(markers))
    )
    assert "Joints and actuators" not in reader.figures
    assert "Features in the image" in reader.figures


@pytest.mark.process
def test_the_page_of_a_run_needs_no_matplotlib() -> None:
    """In a process of its own (a second), since other tests import it: its import alone would take
    longer than the page.
    """
    code = (
        "import sys; sys.modules['matplotlib'] = None; import polars as pl;"
        " from vstestbed.report import render_page"
    )
    code += "; print(render_page(pl.DataFrame({'t': [0.0, 0.04]}), {}, {}, {}).count('<figure>'))"
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout
        == "2\n"
    )


@pytest.mark.filterwarnings("error")
def test_columns_of_nothing_but_nan() -> None:
    table = log(30)
    table = table.with_columns(
        pl.lit(float("nan")).alias(c) for c in table.columns if c not in ("t", "frame", "lost")
    )
    reader = checked(render_page(table, summary(), TEXTS, {}, setting(4)))
    assert "no frame with a measured error" in reader.text
    assert "Camera path" not in reader.figures


@pytest.mark.filterwarnings("error")
def test_nothing_is_known_but_the_time() -> None:
    table = pl.DataFrame({"t": [0.0, 0.04, 0.08]})
    assert checked(render_page(table, {}, {}, {})).figures == ["Error in the image", "Camera twist"]


def test_nulls_read_as_nan_and_errors_of_zero_are_no_trouble() -> None:
    table = log(30).with_columns(
        pl.lit(None, dtype=pl.Float64).alias("depth_0"), pl.lit(0.0).alias("error_px")
    )
    assert (
        "Error in the image"
        in checked(render_page(table, summary(), TEXTS, {}, setting(4))).figures
    )


def test_names_of_joints_are_taken_as_they_stand() -> None:
    text = render_page(log(20, joints=("_arm/j$1$", "a<b")), summary(), TEXTS, {}, setting(4))
    assert "arm/j$1$" in checked(text).text and "a<b" in checked(text).text


def test_large_films_are_linked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "EMBED_BYTES", 10)
    films = {name: tmp_path / f"{name}.mp4" for name in ("camera", "overview")}
    films["camera"].write_bytes(b"8 bytes.")
    films["overview"].write_bytes(b"8 bytes.")
    references = Reader(render_page(log(5), summary(), TEXTS, films)).references
    assert sum(r.startswith("data:video/mp4") for r in references) == 1
    assert references.count("overview.mp4") == 2  # the film itself and a link


def test_long_logs_are_thinned_and_stay_quick() -> None:
    table = log(20)
    table = table[np.arange(60_000) % 20].with_columns(pl.Series("t", np.arange(60_000) / 1000))
    numbers = table.cast(pl.Float64).to_numpy().copy()
    numbers[12_345, table.columns.index("error_px")] = (
        1e4  # a peak in one frame is in the figure, with the rest of its row
    )
    rows = Log(tuple(table.columns), numbers)
    tracks = LogArrays.of(rows, setting(4))
    assert (
        0.4 * MOST_ROWS < len(tracks.t) <= MOST_ROWS
        and tracks.t[0] == 0
        and tracks.t[-1] == pytest.approx(59.999)
    )
    assert tracks.t[np.nanargmax(tracks.column("error_px"))] == pytest.approx(12.345)
    for name in table.columns:
        kept, whole = tracks.column(name), numbers[:, table.columns.index(name)]
        assert (np.nanmin(kept), np.nanmax(kept)) == (np.nanmin(whole), np.nanmax(whole)), name
    assert (np.diff(tracks.t) > 0).all()
    began = time.perf_counter()
    text = render_page(rows, summary(), TEXTS, {}, setting(4))
    assert time.perf_counter() - began < 20  # [s] 2 s here; a slow machine may take ten times that
    assert len(text) < 5e6


def test_true_depth_is_that_of_the_poses() -> None:
    table = log(40)
    true = LogArrays.of(table, setting(4)).true_depth
    assert true is not None
    left = np.exp(-0.6 * table["t"].to_numpy())
    np.testing.assert_allclose(
        true[10:, 2] * (1 + 0.1 * left[10:]), table["depth_2"].to_numpy()[10:], atol=1e-9
    )


def test_stretches_without_target() -> None:
    t = np.arange(6) * 0.1
    tracks = LogArrays(
        pl.DataFrame({"t": t, "lost": [True, False, True, True, False, True]}), Setting()
    )
    np.testing.assert_allclose(tracks.lost_intervals(), [(0, 0.1), (0.2, 0.4), (0.5, 0.5)])


def test_marker_colours_show_on_white_and_on_black() -> None:
    for color in marker_colors(24):
        luminance = float(
            np.dot(
                (np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255) ** 2.2,
                [0.2126, 0.7152, 0.0722],
            )
        )
        # WCAG's contrast for graphics, card #1e2227
        assert 1.05 / (luminance + 0.05) > 3 and (luminance + 0.05) / 0.062 > 3


def test_numbers_are_short() -> None:
    for value, text in (
        (0.12345, "0.123"),
        (123.456, "123"),
        (99.96, "100.0"),
        (12, "12"),
        (0.0, "0"),
        (None, "–"),
        (float("nan"), "–"),
        (1.5e-7, "1.50·10^-7"),
    ):
        assert number(value) == text


def test_write_report_reads_a_folder(tmp_path: Path) -> None:
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    (tmp_path / "summary.json").write_text(json.dumps(summary()))
    (tmp_path / "overview.mp4").write_bytes(b"a film")
    path = write_report(tmp_path, log=log(20), setting=setting(4))
    assert path == tmp_path / "report.html"
    reader = checked(path.read_text(encoding="utf-8"))
    assert "From outside" in reader.text and "What the camera sees" not in reader.text
    assert not list(tmp_path.glob("*.part"))


def test_a_run_that_was_cut_off_has_a_report_too(tmp_path: Path) -> None:
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    text = write_report(tmp_path, log=log(20), setting=setting(4)).read_text(encoding="utf-8")
    assert "Interrupted The run was cut off before it wrote a summary." in checked(text).text


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"scenario\.yaml: cannot be read"):
        write_report(tmp_path)
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    (tmp_path / "summary.json").write_text('{"scenario": ')
    with pytest.raises(
        RunFolderError, match=r"summary\.json: is not the summary of a run .*; without this file"
    ):
        write_report(tmp_path, log=log(5), setting=setting(4))


def test_numbers_of_other_tasks_are_no_tiles() -> None:
    from vstestbed.report.run.page import tiles

    common, touched = (
        {tile[0] for tile in tiles(summary)}
        for summary in ({"final_error_px": 1.0}, {"insertion_m": 0.03})
    )
    assert touched - common == {"Depth of the plug in its socket"}
    assert not any("plug" in title for title in common)


def test_torques_of_an_inner_loop_are_not_taken_for_speeds_that_friction_held() -> None:
    import vstestbed as vs
    from vstestbed.report.run.page import events

    yielding = vs.load("arm_insert", {"detector": "oracle", "stop.duration_s": 3.0})
    recording = vs.run(yielding)
    # it holds its weight [Nm]
    assert yielding.robot.controller.torques and np.abs(recording["ctrl_joint_2"])[1:].min() > 1
    assert not any(
        "Friction held" in one for one in events(LogArrays.of(recording.rows, Setting.of(yielding)))
    )
