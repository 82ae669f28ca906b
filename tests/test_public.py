"""The public names: what they are, that they cost nothing until used, and the example of the
package's docstring.
"""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import vstestbed as vs
from vstestbed.core.apps import bundled
from vstestbed.core.errors import ParameterError

pytestmark = pytest.mark.app()
NAMES = {
    "Outcome",
    "Recording",
    "Scenario",
    "features",
    "load",
    "run",
    "run_into",
    "starts_needed",
} | {
    *(
        "Pose",
        "GroundPose",
        "Stop",
        "Noise",
        "Timing",
        "World",
        "Clock",
        "Calibration",
        "Session",
        "Controller",
        "compare",
        "dump",
    ),
    *("camera", "robots", "targets", "vision", "laws", "tasks"),
    *(
        "Law",
        "LawBase",
        "Command",
        "Observation",
        "Goal",
        "Robot",
        "Allocation",
        "Order",
        "Feature",
        "Detector",
        "spec",
        "errors",
        "testing",
    ),
}
"""To run experiments, and to extend what there is."""


def test_the_public_names_are_these_and_all_of_them_are_there() -> None:
    assert set(vs.__all__) >= NAMES
    assert set(dir(vs)) == set(vs.__all__)
    names = set(vs.__all__) if "tune" in bundled() else set(vs.__all__) - {"tune"}
    for name in names:
        assert getattr(vs, name) is not None
    assert (Path(vs.__file__).parent / "py.typed").exists()


def test_an_unknown_name_is_refused_with_the_list() -> None:
    with pytest.raises(AttributeError, match=r"no attribute 'lod'; public names: .*load"):
        _ = vs.lod


@pytest.mark.process
@pytest.mark.parametrize("module", ["vstestbed", "vstestbed.cli.app"])
def test_importing_costs_no_heavy_package(
    module: str, vstestbed_process: tuple[list[str], dict[str, str]]
) -> None:
    """`--help` has to come at once, so nothing that takes more than some milliseconds may be
    imported for it.
    """
    heavy = [
        "numpy",
        "mujoco",
        "dm_control",
        "cv2",
        "polars",
        "matplotlib",
        "spatialmath",
        "pydantic",
        "yaml",
        "av",
        "scipy",
        "rich",
    ]
    code = f"import sys, {module}; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=vstestbed_process[1],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.process
def test_loading_a_scenario_builds_few_validators_and_reads_no_docstring(
    vstestbed_process: tuple[list[str], dict[str, str]],
) -> None:
    """Of some 220 spec classes those alone that the scenario holds; docstrings are for `describe`
    and messages.
    """
    code = """if True:
        import sys, vstestbed as vs
        from vstestbed.core.fields import class_text
        from vstestbed.core.registry import validator_of
        vs.load("arm_ibvs")
        print(class_text.cache_info().currsize, validator_of.cache_info().currsize)"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=vstestbed_process[1],
        capture_output=True,
        text=True,
        check=True,
    )
    read, built = map(int, done.stdout.split())
    assert read == 0 and 5 < built < 40


@pytest.mark.process
def test_an_ideal_run_needs_neither_mujoco_nor_opencv_nor_opengl(
    vstestbed_process: tuple[list[str], dict[str, str]],
) -> None:
    """A free camera with exact pixels and depths, as in a browser, where none of the three is
    installed.
    """
    code = """if True:
        import sys
        absent = ["mujoco", "dm_control", "cv2", "OpenGL"]
        sys.modules.update(dict.fromkeys(absent))  # importing one of them fails
        import vstestbed as vs
        scenario = vs.load("ibvs_book", {"detector": "oracle", "law.depth": "oracle"})
        print(vs.run(scenario).outcome.name)"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=vstestbed_process[1],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "converged"


@pytest.mark.process
def test_a_run_imports_nothing_before_it_needs_it(
    tmp_path: Path, vstestbed_process: tuple[list[str], dict[str, str]]
) -> None:
    """Until its first frame; each of these takes .1 to .5 s to import."""
    late = [
        "polars",
        "matplotlib",
        "spatialmath",
        "scipy.interpolate",
        "scipy.stats",
        "OpenGL.GL",
        "av",
    ]
    code = f"""if True:
        import sys, vstestbed as vs
        class Watch:
            def frame(self, frame):
                if frame.timing.number == 0:
                    print([m for m in {late} if m in sys.modules])
        from pathlib import Path
        scenario = vs.load("arm_ibvs", {{"stop.duration_s": 0.1}})
        vs.run_into(Path({str(tmp_path)!r}), scenario, "none", [Watch()], report=False)"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=vstestbed_process[1],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "[]"


def test_the_example_of_the_docstring_works() -> None:
    fast = {"detector": "oracle", "law.gain": 1.0, "stop.duration_s": 0.3}
    recording = vs.run(vs.load("ibvs_book", fast))
    assert recording.outcome is vs.Outcome.timed_out
    assert recording.summary()["scenario"] == "ibvs_book"
    # pictures at 0, .1, .2 and .3 s
    assert recording.frame().height == recording.summary()["frames"] == 4
    with pytest.raises(KeyError, match="no column 'eror_px' in the log; did you mean 'error_px'"):
        recording["eror_px"]


def test_features_are_reached_from_the_top() -> None:
    import numpy as np

    L = vs.features.Point().interaction(np.zeros((4, 2)), np.ones(4))
    assert L.shape == (8, 6)


def test_every_kind_is_a_class_of_its_room() -> None:
    """So that a scenario in Python needs no name from inside the package."""
    rooms = {
        "robots": vs.ROBOTS,
        "camera": vs.CAMERAS,
        "targets": vs.TARGETS,
        "vision": vs.DETECTORS,
        "laws": vs.LAWS,
        "tasks": vs.GOALS,
    }
    for room, kinds in rooms.items():
        public = getattr(vs, room).__all__
        ours = [
            member
            for member in kinds.members.values()
            if member.__module__.startswith("vstestbed.")
        ]
        assert ours and {member.__name__ for member in ours} <= set(public)


def test_a_name_in_place_of_a_scenario_is_refused_with_what_to_write() -> None:
    """run wants a loaded scenario."""
    with pytest.raises(ParameterError, match=r"vstestbed\.load"):
        vs.run("arm_ibvs")  # pyright: ignore[reportArgumentType]


def test_a_mistake_in_python_has_the_sentence_of_a_file() -> None:
    for call, words in (
        (lambda: vs.laws.IBVS(gian=1), "IBVS.gian is an unknown field; did you mean 'gain'?"),
        (lambda: vs.laws.IBVS(gain=-1), "IBVS.gain must be > 0, got -1"),
        (
            lambda: vs.laws.IBVS(gain={"kind": "adaptive", "at_zer": 1}),
            "IBVS.gain.at_zer is an unknown field; did you mean 'at_zero'?",
        ),
        (
            lambda: vs.laws.IBVS(depth="npn"),
            (
                "IBVS.depth is no depth; valid kinds: constant, estimate, floor, goal, oracle, pnp,"
                " sensor, size, stereo, got 'npn'"
            ),
        ),
        (
            lambda: vs.robots.Free(),
            "Free.start is missing: where the camera starts; a block of nominal, random",
        ),
        (lambda: vs.robots.Free(strat=1), "Free.strat is an unknown field; did you mean 'start'?"),
        (
            lambda: vs.targets.Square(side=1, pose=(0, 0, 3)),
            (
                "Square.pose must be a block (a mapping) of xyz, rpy_deg, got (0, 0, 3);"
                " did you mean {xyz: [0, 0, 3]}?"
            ),
        ),
        (
            lambda: vs.targets.Square(side=1, pose={"rpy": (0, 0, 3)}),
            "Square.pose.rpy is an unknown field; did you mean 'rpy_deg'?",
        ),
        (lambda: vs.Pose(xyz=(0, "1", 3)), "Pose.xyz.1 must be a number, got '1'"),
        (lambda: vs.Scenario(), "Scenario.robot is missing; valid kinds: "),
    ):
        with pytest.raises(ParameterError) as refused:
            call()
        assert str(refused.value).startswith(words) and isinstance(refused.value, ValueError)


def test_the_readme_has_no_blank_left_to_fill() -> None:
    """What was to be measured has been measured."""
    text = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"\b(?:TODO|TBD|FIXME|BENCH[A-Z]+)\b", text) == []


@pytest.mark.usefixtures("own_kinds")
def test_the_law_of_the_readme_is_a_law(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The example by which vstestbed/README.md shows how to add a kind."""
    text = (Path(__file__).parents[1] / "vstestbed" / "README.md").read_text(encoding="utf-8")
    code = next(
        block
        for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL)
        if "LAWS.add" in block
    )
    (tmp_path / "readme_law.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    vs.testing.check_law(importlib.import_module("readme_law").Mine(gain=1.0))
