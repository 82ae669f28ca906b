"""Calibration from pictures of a board: of a folder, of a run, with what is wrong said in a
sentence.
"""

import csv
import functools
import os
import shutil
import time

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vstestbed as vs
from vstestbed.camera import Fisheye, Perspective
from vstestbed.camera.intrinsics import Intrinsics, read_calibration
from vstestbed.core.errors import ParameterError, RunFolderError, VstestbedError
from vstestbed.core.geometry import Pose, inverse, rigid_error
from vstestbed.studies import calibration as c
from vstestbed.studies.run_folder import run_into

BOARD = c.Board()
MOUNT = Pose(xyz=(0.03, -0.02, 0.06), rpy_deg=(2, -3, 5)).T
CAMERA = Perspective(
    intrinsics=Intrinsics.of(
        [[515, 0, 324], [0, 512, 236], [0, 0, 1]], (-0.12, 0.05, 0.0005, -0.0005, 0), (640, 480)
    )
)


@functools.lru_cache
def rays(camera):
    """Rays of two by two samples a pixel (2 H, 2 W, 3)."""
    v, u = np.mgrid[0 : camera.height * 2, 0 : camera.width * 2]
    return camera.ray(
        np.stack([(u + 0.5) / 2 - 0.5, (v + 0.5) / 2 - 0.5], axis=-1).reshape(-1, 2)
    ).reshape(*u.shape, 3)


def drawn(camera, T_camera_board, board=BOARD):
    """A picture (H, W, 3) of the board from a pose: each ray met with the board's plane."""
    T = inverse(T_camera_board)
    d, o = rays(camera) @ T[:3, :3].T, T[:3, 3]
    at = (o + d * (-o[2] / d[..., 2:]))[..., :2] * (100 / board.square_m) - 0.5
    maps = [np.ascontiguousarray(at[..., i], np.float32) for i in (0, 1)]
    fine = cv2.remap(
        board.print(100), *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=255
    )
    return cv2.cvtColor(
        cv2.resize(fine, (camera.width, camera.height), interpolation=cv2.INTER_AREA),
        cv2.COLOR_GRAY2RGB,
    )


def poses(n, seed=1):
    rng, found = np.random.default_rng(seed), []
    for _ in range(n):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = (
            Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3)).as_matrix(),
            [*rng.uniform(-0.06, 0.06, 2), rng.uniform(0.38, 0.5)],
        )
        found.append(T @ Pose(xyz=(-0.14, -0.1, 0)).T)
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Pictures with `poses.csv`, and one that does not show the board."""
    place, base = (
        tmp_path_factory.mktemp("pictures"),
        Pose(xyz=(0.8, 0.1, 0.3), rpy_deg=(170, 10, 20)).T,
    )
    with (place / "poses.csv").open("w", newline="") as file:
        lines = csv.writer(file)
        lines.writerow(["picture", "x", "y", "z", "qx", "qy", "qz", "qw"])
        for i, T in enumerate(poses(10)):
            G = base @ inverse(T) @ inverse(MOUNT)
            cv2.imwrite(str(place / f"{i}.png"), drawn(CAMERA, T))
            lines.writerow([f"{i}.png", *G[:3, 3], *Rotation.from_matrix(G[:3, :3]).as_quat()])
        cv2.imwrite(str(place / "empty.png"), np.full((480, 640), 128, np.uint8))
        lines.writerow(["empty.png", 0, 0, 0, 0, 0, 0, 1])
    return place


def test_pictures_of_a_folder_give_lens_and_mount(folder, tmp_path):
    made = c.calibrated(c.shots_of_folder(folder, None), BOARD, True, "plumb_bob")
    mm, rad = rigid_error(made.found.X, MOUNT)
    assert mm < 1e-3 and np.degrees(rad) < 0.2 and made.unseen == ["empty.png"]
    np.testing.assert_allclose(np.diag(made.camera.K)[:2], (515, 512), rtol=0.005)
    np.testing.assert_allclose(made.camera.centre, (324, 236), atol=2)
    assert made.rms_px < 0.15 and made.found.rms_px < 0.2
    page = c.write(tmp_path, made, "pictures", None, "vstestbed calibrate").read_text(
        encoding="utf-8"
    )
    assert "The board is not found in: empty.png." in page and "daniilidis" in page
    again = read_calibration(str(tmp_path / "calibration.yaml"))
    np.testing.assert_allclose(Pose(**again["mount"]).T, made.found.X, atol=1e-9)
    assert again["intrinsics"].focal_px == made.camera.intrinsics.focal_px


def test_a_lens_that_is_known_is_kept(folder):
    made = c.calibrated(c.shots_of_folder(folder, None), BOARD, True, None, CAMERA)
    assert made.camera is CAMERA and np.isnan(made.rms_px)
    assert rigid_error(made.found.X, MOUNT)[0] < 5e-4
    with pytest.raises(ParameterError, match="must have the camera's 320 x 240 px"):
        c.calibrated(
            c.shots_of_folder(folder, None), BOARD, True, None, Perspective(width=320, height=240)
        )


def test_a_fisheye_is_calibrated():
    true = Fisheye(fov_deg=150, coefficients=(0.02, -0.004, 0, 0), focal_length_px=250)
    find = BOARD.finder()
    seen = [
        found
        for T in poses(8, 2)
        if (found := find(drawn(true, Pose(xyz=(0, 0, -0.15)).T @ T))) is not None
    ]
    camera, rms = c.intrinsics_of(seen, (480, 640), "equidistant")
    assert len(seen) >= 6 and rms < 0.2
    p = np.random.default_rng(1).uniform([-0.1, -0.1, 0.2], [0.1, 0.1, 0.3], (50, 3))
    np.testing.assert_allclose(camera.project(p), true.project(p), atol=1.0)


def test_advice_names_what_is_missing(folder):
    shots = c.shots_of_folder(folder, None)
    made = c.calibrated(shots[:4], BOARD, True, None, CAMERA)
    words = " ".join(c.advice(made))
    assert "4 views are few" in words and "No corner was in these ninths" in words


def test_what_is_no_calibration_is_refused(folder, tmp_path):
    for words in (
        "7x5",
        "7x5:a:b:4X4_50",
        "2x2:0.1:0.05:4X4_50",
        "7x5:0.03:0.04:4X4_50",
        "7x5:0.04:0.03:NONE",
    ):
        with pytest.raises(ParameterError, match="--board needs the form"):
            c.Board.of(words)
    assert c.Board.of("9x6:0.03:0.02:dict_5x5_100").board() is not None
    with pytest.raises(RunFolderError, match=r"has no poses\.csv"):
        c.shots_of_folder(tmp_path, None)
    (tmp_path / "poses.csv").write_text("picture,x\nno.png,1\n")
    with pytest.raises(RunFolderError, match=r"poses\.csv:2 cannot be read"):
        c.shots_of_folder(tmp_path, None)
    with pytest.raises(ParameterError, match="show the board 9x6 in 0 of 11"):
        c.calibrated(c.shots_of_folder(folder, None), c.Board(9, 6), True, None)
    run_into(
        tmp_path / "omni", vs.load("omni_ibvs", {"stop.duration_s": 0.1}), "none", report=False
    )
    with pytest.raises(RunFolderError, match="an arm: hand-eye calibration needs its joints"):
        c.shots_of_run(tmp_path / "omni")


def test_a_board_is_bounded_before_it_is_made(command):
    """A board of 1,000,000 x 1,000,000 squares would take all memory; markers that the dictionary
    has not would be drawn from nothing.
    """
    for size in ("1000000x1000000", "1000000x3", "40x40", "99999999999999999999x3"):
        with pytest.raises(ParameterError, match="of at most 50 markers, which 4X4_50 has"):
            c.Board.of(f"{size}:0.04:0.03:4X4_50")
    for words in (
        "0x0:1:.5",
        "1x1:1:.5",
        "-7x-5:1:.5",
        "7x5:-2:-3",
        "7x5:inf:1",
        "7x5:nan:nan",
        "7x5:1:0",
        "7x5:1e-300:1e-301",
        "7x5:1e300:1",
    ):
        with pytest.raises(ParameterError, match="--board needs the form"):
            c.Board.of(f"{words}:4X4_50")
    began = time.monotonic()
    ended = command(
        "calibrate", ".", "--board", "1000000x1000000:0.04:0.03:4X4_50", "--print", "a.png"
    )
    assert ended.code == 2 and ended.err.count("\n") == 1 and time.monotonic() - began < 5


BROKEN = {
    "nan.png": ("nan",) * 7,
    "zero.png": (0.8, 0.1, 0.3, 0, 0, 0, 0),
    "words.png": ("a",) * 7,
    "text.png": (0.8, 0.1, 0.3, 0, 0, 0, 1),
    "pipe.png": (0.8, 0.1, 0.3, 0, 0, 0, 1),
    "small.png": (0.8, 0.1, 0.3, 0, 0, 0, 1),
    "missing.png": (0.8, 0.1, 0.3, 0, 0, 0, 1),
    "huge.png": (0.8, 0.1, 0.3, 0, 0, 0, 1),
    "..": (0.8, 0.1, 0.3, 0, 0, 0, 1),
}
"""Lines of poses.csv, of a picture that is a text, a pipe, of another size, missing, of 64 MiB; and
a folder.
"""


def test_lines_and_pictures_that_are_broken_are_passed_over_and_told(folder, tmp_path, caplog):
    place = tmp_path / "pictures"
    shutil.copytree(folder, place)
    good = cv2.imread(str(place / "0.png"))
    for name in ("nan.png", "zero.png", "words.png"):
        cv2.imwrite(str(place / name), good)
    (place / "text.png").write_text("no picture")
    os.mkfifo(place / "pipe.png")
    cv2.imwrite(str(place / "small.png"), good[::2, ::2])
    (place / "huge.png").touch()
    os.truncate(place / "huge.png", (64 << 20) + 1)
    with (place / "poses.csv").open("a", newline="") as file:
        csv.writer(file).writerows([name, *numbers] for name, numbers in BROKEN.items())
    shots = c.shots_of_folder(place, None)
    assert [shot.name for shot in shots] == [f"{i}.png" for i in range(10)] + ["empty.png"]
    assert (
        f"{len(BROKEN)} of {11 + len(BROKEN)} pictures are passed over, the first: " in caplog.text
        and "poses.csv:13" in caplog.text
    )


@pytest.mark.parametrize(
    "content", [b"", b"\xff\xfe\x00", b"picture,x\n" + b"a" * 200_000, b"picture\n", b"\0\0\0"]
)
def test_poses_that_are_none_are_a_sentence(tmp_path, content):
    (tmp_path / "poses.csv").write_bytes(content)
    with pytest.raises(VstestbedError):
        c.calibrated(c.shots_of_folder(tmp_path, None), BOARD, True, None)


def test_two_hundred_broken_pose_files_are_a_sentence_or_lines_passed_over(tmp_path):
    """Bytes of poses.csv are changed, cut out and doubled; what is left has finite poses."""
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((24, 32, 3), np.uint8))
    lines = ["picture,x,y,z,qx,qy,qz,qw", *(f"a.png,0.{i},0.1,0.3,0,0,{i},1" for i in range(5))]
    whole, used = "\n".join(lines).encode(), 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        raw = bytearray(whole)
        for _ in range(rng.integers(1, 8)):
            at = int(rng.integers(len(raw)))
            raw[at] = int(rng.choice([*b'na0,;e\n"-.\0', rng.integers(256)]))
        if rng.random() < 0.3:
            at, end = sorted(int(i) for i in rng.integers(len(raw), size=2))
            raw = raw[:at] + raw[end:] if rng.random() < 0.5 else raw[:end] + raw[at:]
        (tmp_path / "poses.csv").write_bytes(raw)
        try:
            shots = c.shots_of_folder(tmp_path, None)
        except VstestbedError:
            continue
        used += 1
        assert all(np.isfinite(shot.T_base_flange).all() for shot in shots)
    assert 20 < used < 200


def test_a_calibration_is_less_exact_with_worse_joints(monkeypatch):
    """By the commands' own table: five times the joints' error is more than twice the error of the
    pose.
    """
    monkeypatch.setattr(c, "OVER", {"joint_deg": (0.02, 0.1)})
    table = c.exactness(vs.load("arm_calibrate"), BOARD, 3)
    assert len(table) == 2 * 6  # five methods, and the bundle adjustment
    small, large = table.filter(method="bundle adjustment")["mm"]
    assert 2 * small < large < 12 * small


@pytest.mark.study
def test_a_run_of_arm_calibrate_finds_the_camera(tmp_path):
    """The true mount within 0.5 mm and 0.05 degrees, the lens within 0.1 %."""
    run_into(tmp_path / "run", vs.load("arm_calibrate"), "none", report=False)
    truth, shots = c.shots_of_run(tmp_path / "run")
    made = c.calibrated(shots, BOARD, True, None)
    mm, deg = made.found.off(truth.camera.mount.T)["bundle adjustment"]
    assert len(made.views) == 15 and mm < 0.5 and deg < 0.05
    assert np.allclose(np.diag(made.camera.K)[:2], truth.camera.f, rtol=1e-3)


def test_boards_that_are_all_seen_from_the_front_are_told():
    """A board across the optical axis looks alike with any focal length at its distance."""
    grid = np.array([[x, y, 0.0] for y in range(4) for x in range(6)]) * 0.04
    seen = [
        (grid, np.array([320.0, 240.0]) + (grid[:, :2] - [0.1, 0.06]) * 600 / z)
        for z in (0.5, 0.6, 0.7, 0.8)
    ]
    with pytest.raises(
        ParameterError, match=r"do not determine the focal length .* tilt the board"
    ):
        c.intrinsics_of(seen, (480, 640), "plumb_bob")
