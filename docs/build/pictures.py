"""Makes the pages' pictures again:
`python -m docs.build.pictures [NAME ...] [--studies] [--out DIR]`.

Without names: all that show films (a minute each), and the figures of kept results (seconds);
`--studies`: the figures of studies, too, some of which take half an hour. Each picture goes into
`docs/media/`, or into DIR.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import shlex
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from fractions import Fraction
from itertools import islice
from pathlib import Path

import av
import cv2
import numpy as np

import vstestbed as vs
from docs.build import exercises, latency
from docs.build.kept import REPOSITORY, Kept
from docs.build.render import comparison
from vstestbed.core.files import make_folder, write_whole
from vstestbed.report.canvas import DPI, save, style
from vstestbed.report.comparison import grid as effects
from vstestbed.report.comparison.figures import Data
from vstestbed.report.comparison.page import COLUMN_IN
from vstestbed.report.run.space import SUFFIXES, coordinates, turns_joined
from vstestbed.report.run.tracks import LogArrays, Setting
from vstestbed.report.video.film import FINE, Pictures, replay_of, rows_of
from vstestbed.report.video.overlay import INK, PAPER, FilmFrame, draw_text
from vstestbed.report.video.side_by_side import FrameReader, scaled
from vstestbed.report.video.writer import Image

WIDTH, WIDE, FIGURE = 1280, 1080, 1300
EVERY = 8
"""Frames between two pictures that are drawn, so that the view follows and trails grow."""
FILMS: dict[str, tuple[str, tuple[tuple[str, float], ...]]] = {
    "arm_ibvs": ("arm_ibvs", (("overview", 0.03), ("eye", 1.0))),
    "car_pbvs": ("car_pbvs", (("overview", 0.25), ("overview", 1.0))),
    "quadrotor_land": ("quadrotor_land", (("overview", 0.0), ("overview", 0.5), ("overview", 1.0))),
}
"""Scenario, and from left to right the camera and the share of the run at which it is shown."""
MOVING: dict[str, str] = {
    "film_arm": "arm_ibvs",
    "film_omni": "omni_ibvs",
    "film_car": "car_pbvs",
    "film_quadrotor": "quadrotor_land",
}
"""Films of the README: their scenarios."""
MOVING_WIDTH, MOVING_HZ, MOVING_QUALITY = 480, 12, 70
STUDIES: dict[str, tuple[str, str]] = {
    "compare_differences": ("compare arm_laws", "figures/differences.png"),
    "compare_arm_laws": ("compare arm_laws --seeds 1", "comparison.mp4"),
    "canonical_tasks": ("compare canonical", "figures/tasks.png"),
    "canonical_arm_tasks": ("compare canonical_arm", "figures/tasks.png"),
    "basin_canonical": (
        "basin canonical --set camera.rate_hz=5 --x x=-2:2 --y yaw=-180:180 --at y=1 --at z=-1",
        "basin.png",
    ),
    "depth_error": ("sweep depth_error", "convergence.png"),
    "calibration_error": ("sweep calibration_error", "convergence.png"),
    "delay_arm": ("gain-limit arm_ibvs", "delay.png"),
    "flow_polar": ("optical-flow --feature polar", "flow_polar.png"),
    "flow_spherical_sphere": ("optical-flow --feature spherical", "flow_spherical_sphere.png"),
}
"""The command, and the file in its folder; of a film the picture at SHOWN_S."""
GRIDS = (
    "realism_arm",
    "realism_camera",
    "realism_pictures",
    "realism_omni",
    "realism_car",
    "realism_craft",
)
"""Comparisons of effects and laws, whose figures are drawn of the same kept results as the pages'
tables, in seconds.
"""
LATENCY = "latency_laws"
"""The figure of three laws over latency, of kept results, too."""
POLAR = "polar_planes"
POLAR_RUNS: dict[str, dict[str, object]] = {
    "mean matrix": {"law.interaction": "mean"},
    "present matrix, 100 Hz": {"camera.rate_hz": 100},
    "present matrix, start on the axis": {"robot.start.nominal.xyz": [0, 0, -2]},
}
"""Title, and what is changed in `polar_book`."""
SHOWN_S = Fraction(18, 5)
CAMERA = "camera_effects"
CAMERA_EFFECTS: dict[str, dict[str, object]] = {
    "as rendered": {},
    "rolling shutter, 20 ms": {"camera.readout_s": 0.02},
    "motion blur, 20 ms": {"timing.exposure_s": 0.02},
    "flicker, rolling shutter": {
        "camera.readout_s": 0.03,
        "timing.exposure_s": 0.002,
        "world.light": {"flicker": {"frequency_hz": 100, "depth": 0.6}},
    },
    "defocus, f/1.4 at 0.25 m": {
        "camera.optics": {"defocus": {"focus_m": 0.25, "f_number": 1.4, "focal_length_m": 0.008}}
    },
    "vignetting, lateral colour": {
        "camera.optics": {"vignetting": 0.6, "red_px": 3, "blue_px": -3}
    },
    "sensor at gain 8": {
        "camera.exposure": {"time_s": 0.00125, "nominal_s": 0.01, "gain": 8},
        "camera.sensor": {},
    },
    "JPEG, quality 10": {"camera.stream": {"kind": "jpeg", "quality": 10}},
}
"""Effects of a camera that moves at 1 m/s to its right and turns at 2.5 rad/s about its axis."""
DEPTH, CUT, DEPTHS_M = "depth_sensors", np.s_[40:460, 60:480], (0.4, 2.4)
"""What depth cameras measure: the part of the picture that is shown, and the depths of the first
and the last colour [m].
"""
LIVE, LATE_S, QUIET, SWINGS, TURNED_S, SHOT_S = "live", 0.4, 0.4, 3.6, 4.0, 8.5
"""The page of `vstestbed live`, which needs a Chromium: pictures that come so late [s], the gain
before and after TURNED_S [1/s, s], and when it is shown [s].
"""


def strip(name: str) -> Image:
    """Pictures of one run side by side, at one height."""
    scenario_name, wanted = FILMS[name]
    scenario = vs.load(scenario_name)
    rows = list(rows_of(vs.run(scenario).rows))
    found: dict[tuple[str, float], Image] = {}
    replay = replay_of(scenario, FINE)
    try:
        for camera in {camera for camera, _ in wanted}:
            eye = scenario.camera
            share = FINE.share(eye.width, eye.height)
            size = (
                (round(share * eye.width), round(share * eye.height))
                if camera == "eye"
                else FINE.size
            )
            pictures = Pictures(scenario, camera, replay, size)
            shares = {
                round(share * (len(rows) - 1)): share
                for found_by, share in wanted
                if found_by == camera
            }
            for i in sorted({*range(0, max(shares), EVERY), *shares}):
                image = pictures.picture(FilmFrame.of_row(rows[i], scenario))
                if i in shares:
                    found[camera, shares[i]] = image
    finally:
        replay.close()
    images = [found[key] for key in wanted]
    height = round(WIDTH / sum(image.shape[1] / image.shape[0] for image in images))
    sized = [
        cv2.resize(
            x, (round(x.shape[1] * height / x.shape[0]), height), interpolation=cv2.INTER_AREA
        )
        for x in images
    ]
    return np.asarray(np.concatenate(sized, axis=1), np.uint8)


def moving(name: str, folder: Path) -> bytes:
    """The film from outside of a run as an animated WebP that repeats."""
    place = folder / name
    words = ["run", MOVING[name], "--video", "overview", "--fine", "--quiet", "--out", str(place)]
    subprocess.run([sys.executable, "-m", "vstestbed", *words], check=True)
    with av.open(str(place / "overview.mp4")) as film:
        shown = film.streams.video[0]
        every = max(1, round(float(shown.average_rate or MOVING_HZ) / MOVING_HZ))
        size = MOVING_WIDTH, MOVING_WIDTH * shown.height // shown.width
        images = [
            frame.to_image(width=size[0], height=size[1], interpolation="AREA")
            for frame in islice(film.decode(shown), 0, None, every)
        ]
        duration_ms = round(1000 * every / float(shown.average_rate or MOVING_HZ))
    file = io.BytesIO()
    settings = {"duration": duration_ms, "loop": 0, "quality": MOVING_QUALITY, "method": 4}
    images[0].save(file, "webp", save_all=True, append_images=images[1:], **settings)
    return file.getvalue()


def depth_sensors() -> Image:
    """The first picture of `arm_depth` with balls as markers, and the depth that each kind of
    sensor measures of it; black in holes.
    """
    shown: list[Image] = []
    for kind in ("ideal", "stereo", "structured_light", "time_of_flight"):
        changes = {"camera.depth_sensor": kind, "target.marker": {"kind": "sphere", "radius": 0.04}}
        with vs.Session(vs.load("arm_depth", changes), pictures=True) as session:
            frame = session.reset()
        assert frame.image is not None and frame.depth_image is not None
        share = np.clip((frame.depth_image - DEPTHS_M[0]) / (DEPTHS_M[1] - DEPTHS_M[0]), 0, 1)
        colours = cv2.applyColorMap(
            (255 * np.nan_to_num(share)).astype(np.uint8), cv2.COLORMAP_TURBO
        )[..., ::-1]
        shown += [frame.image.copy()] if not shown else []
        shown.append(np.where(np.isnan(frame.depth_image)[..., None], 0, colours).astype(np.uint8))
    gap = np.full((CUT[0].stop - CUT[0].start, 6, 3), 255, np.uint8)
    wide = np.hstack([part for image in shown for part in (image[CUT], gap)][:-1])
    return np.asarray(
        cv2.resize(wide, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8
    )


def camera_effects() -> Image:
    """One view of the poster, half a metre before a camera in motion, with one effect of the camera
    in each picture.
    """
    shown: list[Image] = []
    camera = {"kind": "perspective", "width": 320, "height": 240, "fovy_deg": 45, "rate_hz": 25}
    plain = {
        "camera": camera,
        "robot.start.nominal": {"xyz": [0.02, -0.01, -0.55]},
        "target.lit": True,
        "stop.duration_s": 1,
    }
    for words, effect in CAMERA_EFFECTS.items():
        with vs.Session(vs.load("camera_photometric", plain | effect), pictures=True) as session:
            session.reset()
            image = [session.step([1.0, 0, 0, 0, 0, 2.5]).image for _ in range(4)][-1]
        assert image is not None
        image = image.copy()
        for off, colour in ((1, INK), (0, PAPER)):
            draw_text(image, words, (8 + off, 20 + off), colour, 15, weight=600)
        shown.append(image)
    return np.vstack([np.hstack(shown[:4]), np.hstack(shown[4:])])


def study(name: str, folder: Path) -> Image:
    """The figure of a study, or a picture of its film."""
    command, file = STUDIES[name]
    words = shlex.split(command)
    place = folder / "-".join(words).replace("/", "-")
    if not place.exists():
        out = place / f"flow_{words[-1]}.png" if words[0] == "optical-flow" else place
        make_folder(out.parent)
        subprocess.run([sys.executable, "-m", "vstestbed", *words, "--out", str(out)], check=True)
    if not file.endswith(".mp4"):
        return figure(place / file)
    with contextlib.closing(FrameReader(place / file)) as reader:
        shown = reader.newest(SHOWN_S)
        assert shown is not None
        return scaled(shown, WIDE, reader.height * WIDE // reader.width)


def grid_of(name: str, folder: Path) -> Image:
    """The grid of a comparison of effects and laws, of its kept results."""
    rows = Kept(may_run=False)(f"compare {name}")
    with style():
        drawn = effects.grid(Data(comparison(rows)), COLUMN_IN[2])
        assert drawn is not None, name
        save(drawn, folder / f"{name}.png", DPI)
    return figure(folder / f"{name}.png")


def latency_laws(name: str, folder: Path) -> Image:
    """Time to converge over latency, and gain limits over delay, of kept results."""
    latency.draw(folder / f"{name}.png")
    return figure(folder / f"{name}.png")


def polar_planes(name: str, folder: Path) -> Image:
    """The markers of three runs of `polar_book` in the plane of phi and r; circles where they
    start, crosses where they shall be.
    """
    import matplotlib.pyplot as plt

    with style():
        drawn, panels = plt.subplots(
            1, len(POLAR_RUNS), figsize=(COLUMN_IN[2], 2.6), layout="constrained"
        )
        for axes, (title, changes) in zip(panels, POLAR_RUNS.items(), strict=True):
            scenario = vs.load(
                "polar_book", {"law.interaction": "current", "detector": "oracle"} | changes
            )
            tracks = LogArrays.of(vs.run(scenario).frame(), Setting.of(scenario))
            measured, true, goal = (
                coordinates(tracks, scenario.law.feature, suffix) for suffix in SUFFIXES
            )
            turns_joined(*(way[..., 0] for way in (measured, true, goal)))
            for i in range(measured.shape[1]):
                (line,) = axes.plot(measured[:, i, 0] / np.pi, measured[:, i, 1], lw=1.2)
                axes.plot(
                    measured[0, i, 0] / np.pi,
                    measured[0, i, 1],
                    "o",
                    ms=4,
                    color=line.get_color(),
                    mfc="none",
                )
                axes.plot(goal[-1, i, 0] / np.pi, goal[-1, i, 1], "x", ms=5, color=line.get_color())
            axes.set_title(title)
            axes.set_xlabel("φ [π rad]")
            axes.set_ylim(bottom=0)
        panels[0].set_ylabel("r [1]")
        save(drawn, folder / f"{name}.png", DPI)
    return figure(folder / f"{name}.png")


def of_exercise(name: str, folder: Path) -> Image:
    """The figure of an exercise, of runs and of kept results."""
    return figure(exercises.draw(name, folder))


def figure(path: Path) -> Image:
    """A figure, scaled down to FIGURE pixels where it is wider."""
    whole = cv2.imread(str(path))
    assert whole is not None, path
    share = min(1.0, FIGURE / whole.shape[1])
    sized = cv2.resize(
        whole,
        (round(whole.shape[1] * share), round(whole.shape[0] * share)),
        interpolation=cv2.INTER_AREA,
    )
    return np.asarray(cv2.cvtColor(sized, cv2.COLOR_BGR2RGB), np.uint8)


def live_page() -> Image:
    """The page of a live run whose gain was made too large for its delay."""
    sys.path.insert(0, str(REPOSITORY))
    from tests.apps.live.browser import Browser
    from vstestbed.apps.live.app import LiveApp
    from vstestbed.apps.live.run import Settings

    app = LiveApp(Settings("arm_ibvs", {"camera.latency_s": LATE_S, "law.gain": QUIET}))
    app.run.transport.play(False)
    serving = threading.Thread(target=app.serve)
    serving.start()
    try:
        with Browser(1400, 880) as browser:
            tab = browser.tab(app.address)
            tab.wait("document.body?.innerText.includes('frame')", 60)
            for gain, until_s in ((QUIET, TURNED_S), (SWINGS, SHOT_S)):
                app.ask(lambda gain=gain: app.change("law.gain", gain))
                tab.click("play")
                while app.run.last.film.t < until_s and not app.run.ended:
                    time.sleep(0.02)  # between two looks at what another thread changes
            tab.click("pause")
            time.sleep(2.0)  # the page draws what has arrived: nothing tells when it has
            tab.js("document.querySelector('.mantine-Notification-closeButton')?.click()")
            time.sleep(1.0)  # the notice fades
            shot = cv2.imdecode(np.frombuffer(tab.screenshot(), np.uint8), cv2.IMREAD_COLOR_RGB)
    finally:
        app.stop()
        serving.join()
    assert shot is not None
    return np.asarray(
        cv2.resize(
            shot, (WIDE, shot.shape[0] * WIDE // shot.shape[1]), interpolation=cv2.INTER_AREA
        ),
        np.uint8,
    )


def main() -> None:
    """Make them."""
    makers: dict[str, Callable[[str, Path], Image]] = {
        **dict.fromkeys(FILMS, lambda name, _: strip(name)),
        LIVE: lambda *_: live_page(),
        DEPTH: lambda *_: depth_sensors(),
        CAMERA: lambda *_: camera_effects(),
        **dict.fromkeys(GRIDS, grid_of),
        LATENCY: latency_laws,
        POLAR: polar_planes,
        **dict.fromkeys(exercises.EXERCISES, of_exercise),
    }
    usual = [*MOVING, *makers]
    makers |= dict.fromkeys(exercises.REPORTS, of_exercise) | dict.fromkeys(STUDIES, study)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join([*MOVING, *makers]))
    parser.add_argument("--studies", action="store_true")
    parser.add_argument("--out", type=Path, default=REPOSITORY / "docs" / "media")
    given = parser.parse_args()
    make_folder(given.out)
    with tempfile.TemporaryDirectory() as folder:
        for name in given.names or [*usual, *(STUDIES if given.studies else ())]:
            if name in MOVING:
                write_whole(given.out / f"{name}.webp", moving(name, Path(folder)))
                continue
            made = makers[name](name, Path(folder))
            path = given.out / f"{name}.png"
            write_whole(
                path,
                cv2.imencode(
                    ".png", cv2.cvtColor(made, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_PNG_COMPRESSION, 9]
                )[1].tobytes(),
            )
            print(path)


if __name__ == "__main__":
    main()
