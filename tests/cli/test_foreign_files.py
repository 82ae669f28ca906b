"""Whatever a file is that somebody gives, each reader answers with a sentence that names it: no
traceback, no hang, no memory lost.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import in_app, of_apps
from vstestbed.camera.intrinsics import read_calibration, read_intrinsics, read_mount
from vstestbed.core.errors import VstestbedError
from vstestbed.core.lazy import cv2
from vstestbed.core.named_files import (
    bundled_comparisons,
    bundled_labs,
    bundled_scenarios,
    place_of_file,
)
from vstestbed.laws.policy import _network
from vstestbed.loop.log_file import open_log
from vstestbed.loop.recording import read_summary
from vstestbed.report.comparison.baseline import FILE, read_changes
from vstestbed.robots.realism import _preset_in
from vstestbed.sim.scene.joint_chain import compiled
from vstestbed.sim.scene.scenery import _checked
from vstestbed.studies.comparison.folder import Baseline
from vstestbed.studies.comparison.plan import _read_lists, read_comparison
from vstestbed.targets.mesh import read_triangles
from vstestbed.targets.picture import decoded

LONGEST_S = 60.0
"""No answer within this is a hang: the slowest takes 1 s, on a machine with other work 20 s."""
DEEP = 3000
ARM = (
    '<mujoco><worldbody><body><joint name="j" axis="0 0 1"/><geom size="0.1"/><site name="tool"/>'
    "</body></worldbody></mujoco>"
)
STAND = '<mujoco><worldbody><geom size="0.1"/></worldbody></mujoco>'
CALIBRATION = (
    "camera_matrix: {rows: 3, cols: 3, data: [600, 0, 320, 0, 600, 240, 0, 0, 1]}\n"
    "image_width: 640\n"
    "image_height: 480\n"
)
TRIANGLE = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n"


def png() -> bytes:
    """A picture of 32 x 32 pixels."""
    return cv2.imencode(".png", np.full((32, 32, 3), 90, np.uint8))[1].tobytes()


def huge_png() -> bytes:
    """The beginning of a picture of 100,000 x 100,000 pixels."""
    return png()[:16] + (100_000).to_bytes(4, "big") * 2 + png()[24:]


def in_folder(name: str, read: Callable[[Path], object]) -> Callable[[Path], object]:
    """A reader of the file of a name in a folder."""

    def reader(path: Path) -> object:
        place = path.parent / f"{path.name}_folder"
        place.mkdir(exist_ok=True)
        (place / name).unlink(missing_ok=True)
        (place / name).symlink_to(path)
        return read(place)

    return reader


def parquet() -> bytes:
    """A table of one row."""
    import io

    import polars as pl

    pl.DataFrame({"t": [0.0], "lost": [0.0]}).write_parquet(content := io.BytesIO())
    return content.getvalue()


read_trials = in_app("vstestbed.apps.tune.search_space:read_record")
READERS: dict[str, tuple[str, Callable[[Path], object], Callable[[], bytes]]] = {
    "scenario": (".yaml", vs.load, lambda: bundled_scenarios()["ibvs_book"].read_bytes()),
    "comparison": (
        ".yaml",
        read_comparison,
        lambda: bundled_comparisons()["canonical"].read_bytes(),
    ),
    "lab": (
        ".yaml",
        in_app("vstestbed.apps.course.grading:read_lab"),
        lambda: next(iter(bundled_labs().values())).read_bytes(),
    ),
    "intrinsics": (".yaml", lambda path: read_intrinsics(str(path)), CALIBRATION.encode),
    "intrinsics in XML": (
        ".xml",
        lambda path: read_intrinsics(str(path)),
        lambda: b"<?xml version='1.0'?><root><camera/></root>",
    ),
    "intrinsics in JSON": (
        ".json",
        lambda path: read_intrinsics(str(path)),
        lambda: b'{"K": [600, 0, 320, 0, 600, 240, 0, 0, 1]}',
    ),
    "mount": (
        ".yaml",
        lambda path: read_mount(str(path)),
        b"transformation: {x: 0, y: 0, z: 0, qx: 0, qy: 0, qz: 0, qw: 1}".strip,
    ),
    "calibration": (".yaml", lambda path: read_calibration(str(path)), CALIBRATION.encode),
    "realism": (".yaml", lambda path: _preset_in(str(path)), b"drive_lag_s: 0.05\n".strip),
    "model": (".xml", lambda path: compiled(str(path)), ARM.encode),
    "model in URDF": (
        ".urdf",
        lambda path: compiled(str(path)),
        b'<robot name="a"><link name="b"/></robot>'.strip,
    ),
    "scenery": (".xml", lambda path: _checked(str(place_of_file(str(path))), 0), STAND.encode),
    "mesh": (".obj", lambda path: read_triangles(place_of_file(str(path)), 0), TRIANGLE.encode),
    "mesh in STL": (
        ".stl",
        lambda path: read_triangles(place_of_file(str(path)), 0),
        lambda: b"solid a\n" + 3 * b"vertex 0 0 0\n",
    ),
    "picture": (".png", lambda path: decoded(place_of_file(str(path))), png),
    "policy": (
        ".onnx",
        lambda path: _network(place_of_file(str(path)), 0, ("markers",)),
        lambda: b"\x08\x07\x12\x04test",
    ),
    "starts": (
        ".json",
        lambda path: _read_lists(str(path)),
        lambda: b'{"robot": [{"xyz": [0, 0, 0]}]}',
    ),
    "baseline": (
        ".csv",
        Baseline.read,
        lambda: b"scenario,seed,outcome,success\na,0,converged,true\n",
    ),
    "baseline in Parquet": (".parquet", Baseline.read, parquet),
    "log": (".parquet", in_folder("log.parquet", open_log), parquet),
    "summary": (
        ".json",
        in_folder("summary.json", lambda folder: read_summary(folder, "run again")),
        lambda: b'{"outcome": "converged"}',
    ),
    "changes": (".json", in_folder(FILE, read_changes), lambda: b"{}"),
    "trials": (
        ".json",
        in_folder("trials.json", lambda folder: read_trials(folder, ("law.gain",))),
        lambda: b"[]",
    ),
}
"""Each reader of files with the ending that they have, and the content of one that is well or
nearly so.
"""


def deep(ending: str) -> bytes:
    """What is nested DEEP times, in the format of an ending."""
    inside = "[" * DEEP + "]" * DEEP
    if ending in (".xml", ".urdf"):
        return ("<mujoco>" + "<a>" * DEEP + "</a>" * DEEP + "</mujoco>").encode()
    return (f'{{"x": {inside}}}' if ending == ".json" else f"x: {inside}").encode()


KINDS: dict[str, Callable[[Path, str, bytes], object]] = {
    "empty": lambda path, ending, well: path.write_bytes(b""),
    "random": lambda path, ending, well: path.write_bytes(np.random.default_rng(0).bytes(2000)),
    "cut off": lambda path, ending, well: path.write_bytes(well[: 2 * len(well) // 3]),
    "zeros inside": lambda path, ending, well: path.write_bytes(
        well[: len(well) // 2] + bytes(64) + well[len(well) // 2 :]
    ),
    "deep": lambda path, ending, well: path.write_bytes(deep(ending)),
    "folder": lambda path, ending, well: path.mkdir(),
    "pipe": lambda path, ending, well: os.mkfifo(path),
    "huge": lambda path, ending, well: (
        os.truncate(path, 70 << 20) if path.write_bytes(well) else None
    ),
    "UTF-16": lambda path, ending, well: path.write_bytes(well.decode("latin-1").encode("utf-16")),
    "Latin-1": lambda path, ending, well: path.write_bytes(b"\xe9\xff" + well),
    "missing": lambda path, ending, well: None,
}
"""How a file is not what is asked for."""
MAY_BE_READ = {
    ("huge", "baseline"),
    ("folder", "changes"),
    ("pipe", "changes"),
    ("folder", "trials"),
    ("pipe", "trials"),
}
"""Tables are as large as the studies that wrote them; a folder that has no file of a name has
nothing to read.
"""


@contextlib.contextmanager
def no_hang() -> Iterator[None]:
    """Interrupts what takes longer than LONGEST_S."""

    def stop(*_: Any) -> None:
        raise AssertionError("it hangs")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("name", of_apps(READERS, {"lab": "course", "trials": "tune"}))
def test_a_reader_answers_with_a_sentence(name: str, tmp_path: Path):
    ending, read, content = READERS[name]
    faults = []
    for kind, make in KINDS.items():
        path = tmp_path / f"{kind.replace(' ', '_')}{ending}"
        make(path, ending, content())
        said = ""
        try:
            with no_hang():
                read(path)
        except VstestbedError as error:
            said = str(error)
            if path.stem not in said:
                faults.append(f"{kind}: does not name the file: {said[:200]}")
            if len(said) > 1500 or "Traceback" in said:
                faults.append(f"{kind}: is no sentence: {said[:200]}")
        except BaseException as error:
            faults.append(f"{kind}: {type(error).__name__}: {str(error)[:160]}")
        if kind in ("pipe", "folder", "huge") and not said and (kind, name) not in MAY_BE_READ:
            faults.append(f"{kind}: is read")
    assert not faults, "\n".join(faults)


def test_a_huge_picture_is_refused(tmp_path: Path):
    path = tmp_path / "huge.png"
    path.write_bytes(huge_png())
    with pytest.raises(VstestbedError, match=r"huge\.png"):
        decoded(path)
