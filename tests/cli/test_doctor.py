"""The doctor: what it looks at, and that what does not work comes with the words that mend it."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.cli import doctor, pixel_convention
from vstestbed.cli.doctor import Finding, examine
from vstestbed.core.errors import EnvironmentLackError
from vstestbed.sim import gl_probe as gl


@pytest.fixture
def pixel_errors(monkeypatch: pytest.MonkeyPatch):
    """Sets what the check of pixels finds."""

    def set_(errors: np.ndarray) -> None:
        monkeypatch.setattr(
            pixel_convention, "pixel_convention", lambda renderer: (errors, "a renderer")
        )

    return set_


@pytest.mark.opengl
def test_everything_works_here_and_is_told_in_a_line_each(command) -> None:
    ended = command("doctor")
    *lines, last = ended.out.splitlines()
    assert [line.split()[1] for line in lines] == [
        "python",
        "packages",
        "cores",
        "scenarios",
        "guides",
        "OpenGL",
        "pixels",
        "video",
    ]
    assert ended.code == 0, ended.out
    assert all(line.startswith("ok ") for line in lines)
    assert last == "all 8 are well"


def test_rendered_balls_are_where_the_camera_model_says() -> None:
    """The pixel convention, proven on this machine's OpenGL: half a pixel off would be 5 times the
    tolerance.
    """
    pixels = next(f for f in examine() if f.what == "pixels")
    assert pixels.works, pixels.found
    assert "12 rendered balls" in pixels.found


def test_half_a_pixel_off_is_found(pixel_errors) -> None:
    pixel_errors(np.full((12, 2), 0.5))
    pixels = next(f for f in examine() if f.what == "pixels")
    assert not pixels.works
    assert "0.500 px" in pixels.found


def test_a_ball_that_is_not_drawn_is_counted(pixel_errors) -> None:
    pixel_errors(np.vstack([np.zeros((10, 2)), np.full((2, 2), np.nan)]))
    pixels = next(f for f in examine() if f.what == "pixels")
    assert not pixels.works
    assert pixels.found == "only 10 of 12 rendered balls were found in the picture"


@pytest.mark.opengl
def test_no_opengl_is_told_with_its_remedy_and_exit_4(
    command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    monkeypatch.setattr(gl, "_lack", [])
    ended = command("doctor")
    lines = ended.out.splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("missing "))
    assert ended.code == 4
    words = "no OpenGL: MUJOCO_GL=disable is set; rays draw the pictures instead, without shadows"
    assert lines[at].split(None, 2)[1:] == ["OpenGL", words]
    assert lines[at + 1].strip() == "-> unset MUJOCO_GL or set MUJOCO_GL=egl"
    assert lines[at + 2].split()[:2] == ["ok", "pixels"]
    assert lines[at + 2].endswith("by rays (mj_multiRay)")
    assert lines[-2].split()[:2] == ["ok", "video"]  # it goes on after what does not work
    assert lines[-1] == "1 of 8 to mend, see ->"


@pytest.mark.parametrize(
    ("release", "words"),
    [
        (
            {"ID": "debian"},
            (
                "as root: apt-get install libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri;"
                " then `vstestbed doctor`"
            ),
        ),
        ({"ID": "linuxmint", "ID_LIKE": "ubuntu debian"}, "as root: apt-get install libegl1"),
        ({"ID": "rocky", "ID_LIKE": "rhel centos fedora"}, "as root: dnf install mesa-libEGL"),
        ({"ID": "opensuse-leap", "ID_LIKE": "suse opensuse"}, "as root: zypper install libglvnd"),
        ({"ID": "arch"}, "as root: pacman -S libglvnd mesa"),
        ({"ID": "void"}, "as root: (on Debian or Ubuntu) apt-get install libegl1"),
        (None, "as root: (on Debian or Ubuntu) apt-get install libegl1"),
    ],
)
def test_the_command_that_installs_opengl_is_that_of_the_distribution(
    release, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found() -> dict[str, str]:
        if release is None:
            raise OSError
        return release

    monkeypatch.setattr(gl.platform, "freedesktop_os_release", found)
    assert gl.remedy().startswith(words)


def test_run_doctor_and_an_error_say_the_same(
    command, quick, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is lacking and the command that installs it, wherever OpenGL is missed."""
    from vstestbed.sim.render import pictures

    monkeypatch.setenv("MUJOCO_GL", "disable")
    monkeypatch.setattr(gl, "_lack", [("libEGL.so.1 not found", gl.remedy())])
    pictures._warn_once.cache_clear()
    line = (
        "run",
        "quick.yaml",
        "--set",
        "detector=blobs",
        "--set",
        "stop.duration_s=0.1",
        "--video",
        "none",
    )
    warned, refused, examined = (
        command(*line).err,
        command(*line, "--set", "camera.renderer=gl"),
        command("doctor").out,
    )
    lack = "no OpenGL: libEGL.so.1 not found"
    assert warned.splitlines()[0] == f"{lack}; {gl.RAYS_INSTEAD}; {gl.remedy()}"
    assert (refused.code, refused.err) == (4, f"{lack}; {gl.remedy()}\n")
    assert f"{lack}; {gl.RAYS_INSTEAD}\n{' ' * 22}-> {gl.remedy()}\n" in examined


def test_the_pair_of_mujoco_and_dm_control_that_does_not_work_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        doctor, "versions", lambda: {"mujoco": "4.0.0", "dm_control": "1.0.50", "python": "3.11"}
    )
    packages = next(f for f in examine() if f.what == "packages")
    assert not packages.works
    assert "pip install 'mujoco>=3.17,<4'" in packages.remedy


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "versions", lambda: {"mujoco": "3.17.0", "opencv": "missing"})
    packages = next(f for f in examine() if f.what == "packages")
    assert not packages.works
    assert "opencv missing" in packages.found


def test_a_finding_is_one_line_and_two_where_something_is_to_be_done() -> None:
    assert list(Finding("cores", True, "2", "buy more").lines(None)) == ["ok       cores        2"]
    assert list(Finding("video", False, "no libx264", "reinstall av").lines(None)) == [
        "missing  video        no libx264",
        " " * 22 + "-> reinstall av",
    ]


def test_a_long_finding_is_wrapped_in_its_column() -> None:
    lines = list(
        Finding("packages", True, ", ".join(f"package{i} 1.0" for i in range(12))).lines(80)
    )
    assert len(lines) == 3 and max(map(len, lines)) <= 80
    assert [line[:22].strip() for line in lines] == ["ok       packages", "", ""]


class TestChoiceOfBackend:
    """`gl` decides before MuJoCo is imported:
    these call it with libraries and variables made up.
    """

    @pytest.fixture(autouse=True)
    def clean(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(gl, "_lack", [])
        monkeypatch.setattr(gl, "missing_libraries", lambda backend="egl": [])
        for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM"):
            monkeypatch.setenv(name, "")
        for name in ("DISPLAY", "WAYLAND_DISPLAY"):
            monkeypatch.delenv(name, raising=False)

    @pytest.mark.parametrize("said", ["", "egl", "EGL", "on", "1"])
    @pytest.mark.opengl
    def test_egl_is_taken(self, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
        import os

        monkeypatch.setenv("MUJOCO_GL", said)
        gl.choose_backend()
        assert (os.environ["MUJOCO_GL"], os.environ["PYOPENGL_PLATFORM"]) == ("egl", "egl")
        gl.require()

    def test_without_the_libraries_the_remedy_installs_them(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(
            gl, "missing_libraries", lambda backend="egl": ["libEGL.so.1", "libGL.so.1"]
        )
        gl.choose_backend()
        with pytest.raises(
            EnvironmentLackError,
            match=r"no OpenGL: libEGL.so.1 and libGL.so.1 not found; .*install libegl1 libgl1",
        ):
            gl.require()

    @pytest.mark.parametrize(
        ("said", "words"),
        [
            (
                "vulkan",
                (
                    "MUJOCO_GL=vulkan is set, and there is no such backend;"
                    " unset MUJOCO_GL, or set it to egl, glfw, osmesa"
                ),
            ),
            (
                "glfw",
                (
                    "MUJOCO_GL=glfw needs a display, and there is none;"
                    " unset MUJOCO_GL or set MUJOCO_GL=egl"
                ),
            ),
            ("off", "MUJOCO_GL=disable is set; unset MUJOCO_GL or set MUJOCO_GL=egl"),
        ],
    )
    def test_what_cannot_work_is_told_before_mujoco_dies_of_it(
        self, said: str, words: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("MUJOCO_GL", said)
        gl.choose_backend()
        with pytest.raises(EnvironmentLackError) as told:
            gl.require()
        assert str(told.value) == f"no OpenGL: {words}"

    @pytest.mark.parametrize("device", ["7", "-1", "abc", ""])
    @pytest.mark.opengl
    def test_a_device_that_egl_does_not_have_is_told(
        self, device: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.delenv("MUJOCO_GL", raising=False)
        monkeypatch.setenv("MUJOCO_EGL_DEVICE_ID", device)
        gl.choose_backend()
        with pytest.raises(
            EnvironmentLackError,
            match=rf"MUJOCO_EGL_DEVICE_ID={device} is set, and the devices are 0 to \d+; unset",
        ):
            gl.require()

    def test_only_an_import_error_about_the_driver_is_explained(self) -> None:
        assert gl.explain(ImportError("No module named 'polars'")) is None
        assert "libegl-mesa0" in str(
            gl.explain(ImportError("Cannot initialize a headless EGL display."))
        )
