"""Calibration of a camera and of where it sits, from pictures of a ChArUco board: of a run, or of a
real robot.
"""

from __future__ import annotations

import csv
import logging
import math
import statistics
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import polars as pl
from scipy.spatial.transform import Rotation

from vstestbed.apps.calibrate.hand_eye import (
    HandEye,
    View,
    calibrate,
    held_out,
    joint_jacobian,
    posed,
    seen_from,
    turns,
)
from vstestbed.camera import Camera, Fisheye, Image, Perspective
from vstestbed.camera.intrinsics import Intrinsics, read_intrinsics, write_calibration
from vstestbed.core.errors import (
    ParameterError,
    RunFolderError,
    UnreachableError,
    VstestbedError,
    short,
)
from vstestbed.core.files import write_whole
from vstestbed.core.foreign import foreign, only_known, plain_file
from vstestbed.core.geometry import (
    Array,
    inverse,
    pose_from,
    rpy_of,
    transform,
    unit_quaternion,
)
from vstestbed.core.lazy import cv2
from vstestbed.loop.episode import BY_HAND, Episode
from vstestbed.report.canvas import new_figure, publish, style
from vstestbed.report.marks import LINE_COLORS
from vstestbed.report.pages import write_page
from vstestbed.report.recorded_run import RecordedRun
from vstestbed.robots import Robot
from vstestbed.scenario.scenario import Scenario
from vstestbed.targets.picture import read_rgb

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Model = Literal["plumb_bob", "rational_polynomial", "equidistant"]
MOST_VIEWS = 30  # of a run; more pictures tell hardly more, and each costs
LEAST_M, MOST_M = 1e-9, 1e9  # sides of a board, which OpenCV keeps in 32 bits [m]
LEAST_CORNERS = 6  # corners in a picture with which it counts
POSE_SIGMA = 1e-4  # error of poses that are not given by joints, along and about each axis [m, rad]


@dataclass(frozen=True)
class Board:
    """A ChArUco board: columns x rows of squares, their side and that of the markers in them [m],
    and the markers' dictionary.
    """

    columns: int = 7
    rows: int = 5
    square_m: float = 0.04
    marker_m: float = 0.03
    dictionary: str = "4X4_50"

    @classmethod
    def of(cls, words: str) -> Board:
        """The board of `COLUMNSxROWS:SQUARE:MARKER:DICTIONARY`, such as 7x5:0.04:0.03:4X4_50.
        ParameterError: of another form.
        """
        try:
            size, square, marker, name = words.split(":")
            columns, _, rows = size.partition("x")
            made = cls(
                int(columns),
                int(rows),
                float(square),
                float(marker),
                name.upper().removeprefix("DICT_"),
            )
            markers = len(made._markers().bytesList)
            if (
                made.columns < 3
                or made.rows < 3
                or not LEAST_M < made.marker_m < made.square_m < MOST_M
            ):
                raise ValueError(words)
        except (ValueError, AttributeError, cv2.error):
            form = (
                "COLUMNSxROWS:SQUARE_M:MARKER_M:DICTIONARY, 3 or more each way,"
                f" {LEAST_M:g} to {MOST_M:g} m, such as 7x5:0.04:0.03:4X4_50"
            )
            raise ParameterError.form("--board", form, short(words)) from None
        if (needed := made.columns * made.rows // 2) > markers:  # before OpenCV makes them
            raise ParameterError.bound(
                "--board", "of at most", f"{markers} markers, which {made.dictionary} has", needed
            )
        return made

    def _markers(self) -> Any:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))

    def board(self) -> Any:
        """OpenCV's board."""
        return cv2.aruco.CharucoBoard(
            (self.columns, self.rows), self.square_m, self.marker_m, self._markers()
        )

    def finder(self) -> Callable[[Image], tuple[Array, Array] | None]:
        """Finds the corners in a picture: in the board's frame (n, 3) [m], and in the picture (n,
        2) [px]; None where there are too few.
        """
        board = self.board()
        detector = cv2.aruco.CharucoDetector(board)
        corners = np.asarray(board.getChessboardCorners(), dtype=float)

        def find(picture: Image) -> tuple[Array, Array] | None:
            uv, ids, _, _ = detector.detectBoard(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))
            if ids is None or len(ids) < LEAST_CORNERS:
                return None
            return corners[np.asarray(ids, dtype=int).ravel()], np.asarray(uv, dtype=float).reshape(
                -1, 2
            )

        return find

    def print(self, px: int = 200) -> Any:
        """The board as a grey picture to be printed, `px` pixels a square."""
        return self.board().generateImage((self.columns * px, self.rows * px), marginSize=0)


class Shot(NamedTuple):
    """A picture with the robot's pose at its exposure: its name, the picture, T_base_flange (4, 4),
    and J as of `View`.
    """

    name: str
    picture: Image
    T_base_flange: Array
    J: Array


def shots_of_run(folder: Path) -> tuple[Scenario, list[Shot]]:
    """Pictures and readings of a run, flown again, as the controller was given them: of each view
    of its goal the last picture, and of the others those that turn the flange the most.
    RunFolderError: no run, or one that was commanded from outside.
    """
    run = RecordedRun.of(folder)
    s = run.scenario
    _must_be_flown_by_arm(folder, s)
    rows = run.log.frame()
    views = rows["view"].to_numpy() if "view" in rows.columns else np.zeros(len(rows))
    q = rows.select([f"q_{name}" for name in s.robot.joints]).to_numpy()
    wanted = _chosen(views, np.array([s.robot.flange_pose(one) for one in q]))
    return s, list(_shots_again(s, wanted))


def _must_be_flown_by_arm(folder: Path, scenario: Scenario) -> None:
    if BY_HAND in scenario.given.description:
        raise RunFolderError(
            folder,
            "was commanded from outside, which cannot be flown again",
            "calibrate from its bag",
        )
    robot = scenario.robot
    if robot.base != "fixed" or not robot.joints:
        raise RunFolderError(
            folder, f"is of robot {robot.kind}", "an arm: hand-eye calibration needs its joints"
        )


def _shots_again(scenario: Scenario, wanted: set[int]) -> Iterator[Shot]:
    """Fly a run again up to the last of the wanted frames, by their numbers."""
    last = max(wanted)
    with closing(Episode(scenario, True, (), None)) as episode:
        while (frame := episode.advance()) is not None and frame.timing.number <= last:
            shot = episode.controller.before
            if frame.timing.number in wanted and frame.image is not None and shot is not None:
                name = f"{frame.t:.2f} s"
                yield _shot(scenario.robot, name, frame.image.copy(), shot.reading.q)
            if frame.outcome is not None:
                return


def _shot(robot: Robot, name: str, picture: Image, q: Array) -> Shot:
    return Shot(name, picture, robot.flange_pose(q), joint_jacobian(robot.flange_pose, q))


def _chosen(views: Array, poses: Array) -> set[int]:
    """Numbers of at most MOST_VIEWS frames: the last of each view, then those whose flange is
    turned the furthest from all others.
    """
    ends = [int(np.flatnonzero(views == v)[-1]) for v in np.unique(views)][:MOST_VIEWS]
    if len(ends) > 3:
        return set(ends)
    R = Rotation.from_matrix(poses[:, :3, :3])
    places = poses[:, :3, 3]

    def away_from(i: int) -> Array:
        return (R * R[i].inv()).magnitude() + np.linalg.norm(places - places[i], axis=1)

    chosen = ends or [0]
    nearest = np.min([away_from(i) for i in chosen], axis=0)
    while len(chosen) < min(MOST_VIEWS, len(poses)) and nearest.max() > 0.02:
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, away_from(chosen[-1]))
    return set(chosen)


POSES = "poses.csv"
QUATERNION = "qw", "qx", "qy", "qz"
COMMENTS = "number", "time", "t", "stamp", "comment"  # columns that say nothing of a pose


def shots_of_folder(folder: Path, robot: Robot | None) -> list[Shot]:
    """Pictures of a folder with `poses.csv`: a line for each picture, `picture`, and
    `x,y,z,qx,qy,qz,qw` of the flange in the base [m], or the names of the joints of a scenario's
    robot [rad, m]. Lines that are none, and pictures that are not there, are broken, or of another
    size than most, are passed over and told. RunFolderError: no such file, or no line that can be
    used.
    """
    path = folder / POSES
    works = "poses.csv has the columns picture, and x, y, z, qx, qy, qz, qw or the joints' names"
    lines = _lines_of(path, works)
    shots: list[Shot] = []
    bad: list[VstestbedError] = []
    for number, line in enumerate(lines, start=2):
        try:
            with foreign(f"{path}:{number}", works):
                shots.append(_shot_of_line(folder, line, robot))
        except (ParameterError, RunFolderError) as error:
            bad.append(error)
    if not shots:
        why = f": {bad[0]}" if bad else ""
        raise RunFolderError(path, f"has no line that can be used{why}", works)
    size = statistics.mode(shot.picture.shape for shot in shots)
    alike: list[Shot] = []
    for shot in shots:
        if shot.picture.shape == size:
            alike.append(shot)
        else:
            words = "is not of the size of most pictures"
            bad.append(RunFolderError(folder / shot.name, words, "take all with one camera"))
    if bad:
        logging.getLogger("vstestbed").warning(
            "%d of %d pictures are passed over, the first: %s", len(bad), len(lines), bad[0]
        )
    return alike


def _lines_of(path: Path, works: str) -> list[dict[str, Any]]:
    """The lines of poses.csv by their columns; RunFolderError."""
    if not path.exists():
        raise RunFolderError(path.parent, f"has no {POSES}", works)
    with (
        foreign(path, works, RunFolderError),
        plain_file(path, works, refusal=RunFolderError).open(
            newline="", encoding="utf-8-sig"
        ) as file,
    ):
        return list(csv.DictReader(file, skipinitialspace=True))


def _shot_of_line(folder: Path, line: dict[str, Any], robot: Robot | None) -> Shot:
    """The picture and the pose of a line. ParameterError, or what its numbers raise: it is none."""
    joints = robot.joints if robot is not None and robot.joints else ()
    only_known(line, ("picture", *"xyz", *QUATERNION, *joints), COMMENTS)
    by_joints = robot if joints and set(joints) <= set(line) else None
    names = by_joints.joints if by_joints else (*"xyz", *QUATERNION)
    numbers = np.array([float(line[name]) for name in names])
    if not np.isfinite(numbers).all():
        raise ValueError(f"{', '.join(names)} must be finite")
    picture = read_rgb(plain_file(folder / line["picture"], "a PNG or JPEG file"))
    if by_joints:
        return _shot(by_joints, line["picture"], picture, numbers)
    T = pose_from(numbers[:3], unit_quaternion(numbers[3:], ", ".join(QUATERNION)))
    return Shot(line["picture"], picture, T, np.eye(6))


@dataclass(frozen=True)
class Calibrated:
    """A camera's calibration. camera: with the intrinsics found, or given. rms_px: of the corners
    by the intrinsics, NaN where they were given.
    views: that were used. found: the hand-eye calibration. held: as of `held_out`. unseen: names of
    pictures without the board.
    """

    camera: Camera
    rms_px: float
    views: list[View]
    found: HandEye
    held: Array
    unseen: list[str]


def calibrated(
    shots: Sequence[Shot],
    board: Board,
    in_hand: bool,
    model: Model | None,
    known: Camera | None = None,
    pixel_sigma: float = 0.1,
    joint_sigma: float = 1e-4,
) -> Calibrated:
    """Intrinsics, unless they are known, and the hand-eye calibration. model: of the lens.
    Raises ParameterError: the board is in too few pictures, or they turn about one axis alone.
    """
    find = board.finder()
    seen: list[Shot] = []
    corners: list[tuple[Array, Array]] = []
    unseen: list[str] = []
    for shot in shots:
        found = find(shot.picture)
        if found is None:
            unseen.append(shot.name)
        else:
            seen.append(shot)
            corners.append(found)
    if len(seen) < 3:
        words = (
            f"show the board {board.columns}x{board.rows} in {len(seen)} of {len(shots)},"
            " and 3 are needed; is --board right?"
        )
        raise ParameterError("pictures", words)
    size = seen[0].picture.shape[:2]
    if known is None:
        camera, rms = intrinsics_of(corners, size, model)
    else:
        camera = known
        rms = math.nan
        if size != (known.height, known.width):
            words = f"must have the camera's {known.width} x {known.height} px"
            raise ParameterError("pictures", words, size[::-1])
    views = [
        View(s.name, s.T_base_flange, p, uv, seen_from(p, uv, camera), s.J)
        for s, (p, uv) in zip(seen, corners, strict=True)
    ]
    of_poses = np.array_equal(views[0].J, np.eye(6))
    sigma = POSE_SIGMA if of_poses else joint_sigma
    pose = calibrate(views, camera, in_hand, pixel_sigma, sigma)
    held = held_out(views, camera, in_hand, pixel_sigma, sigma)
    return Calibrated(camera, rms, views, pose, held, unseen)


def intrinsics_of(
    corners: Sequence[tuple[Array, Array]], size: tuple[int, int], model: Model | None
) -> tuple[Camera, float]:
    """The camera of some pictures' corners (height, width), by OpenCV's `calibrateCamera` or
    `fisheye.calibrate`; and its RMS error [px].
    """
    height, width = size
    points = [np.ascontiguousarray(p, np.float32).reshape(1, -1, 3) for p, _ in corners]
    uv = [np.ascontiguousarray(pixels, np.float32).reshape(1, -1, 2) for _, pixels in corners]
    model = model or "plumb_bob"
    try:
        rms, K, k = _opencv_calibrates(points, uv, (width, height), model)
    except cv2.error as error:
        said = " ".join(str(error.err).split())
        words = f"do not determine the lens ({said}); take more, from aslant"
        raise ParameterError("pictures", words) from None
    try:
        found = Intrinsics.of(K, np.ravel(k), (width, height), model)
    except ParameterError as error:
        # OpenCV returns zeros, NaN or anything where nothing fixes the numbers
        words = (
            f"do not determine the focal length ({error}):"
            " views in which all boards are seen from the front leave it open;"
            " tilt the board by 20 to 40 degrees, about both of its axes"
        )
        raise ParameterError("pictures", words) from None
    return _camera(found), rms / math.sqrt(2)  # OpenCV's is of points, here of coordinates


def _camera(intrinsics: Intrinsics) -> Camera:
    lens = Fisheye if intrinsics.model == "equidistant" else Perspective
    return lens(intrinsics=intrinsics)


def _opencv_calibrates(
    points: Sequence[Any], uv: Sequence[Any], size: tuple[int, int], model: Model
) -> tuple[float, Any, Any]:
    """RMS error of points [px], camera matrix and distortion."""
    if model == "equidistant":
        flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
        p = [one.astype(float) for one in points]
        pixels = [one.astype(float) for one in uv]
        no: Any = None
        rms, K, k, _, _ = cv2.fisheye.calibrate(p, pixels, size, no, no, flags=flags)
    else:
        flags = cv2.CALIB_RATIONAL_MODEL if model == "rational_polynomial" else 0
        rms, K, k, _, _ = cv2.calibrateCamera(points, uv, size, None, None, flags=flags)
    return float(rms), K, k


# What a calibration says of itself.
def advice(made: Calibrated) -> list[str]:
    """Which poses to add, in sentences; none where the views turn by 15 degrees or more about each
    axis and fill the picture.
    """
    spread, axes = turns(made.views)
    found: list[str] = []
    if len(made.views) < 10:
        found.append(f"{len(made.views)} views are few: 10 to 20 are better.")
    for angle, axis in zip(spread, axes, strict=True):
        if angle < 15:
            words = ", ".join(f"{a:.1f}" for a in axis)
            found.append(
                f"The flange turns by {angle:.0f} degrees (RMS) about its axis ({words}):"
                " add views turned by 30 degrees about it."
            )
    if empty := _empty_ninths(made):
        found.append(
            f"No corner was in these ninths of the picture: {', '.join(empty)};"
            " the lens is not known there."
        )
    return found


def _empty_ninths(made: Calibrated) -> list[str]:
    """The ninths of the picture without a corner, by their names."""
    camera = made.camera
    uv = np.concatenate([v.uv for v in made.views]).clip(0, [camera.width, camera.height])
    bounds = [(0, camera.height), (0, camera.width)]
    corners, _ = np.histogramdd(uv[:, ::-1], 3, bounds)
    columns = ("left", "middle", "right")
    names = [f"{row} {column}" for row in ("upper", "middle", "lower") for column in columns]
    return [name for name, n in zip(names, corners.ravel(), strict=True) if not n]


def write(
    folder: Path, made: Calibrated, source: str, truth: Scenario | None, command: str
) -> Path:
    """Write `calibration.yaml`, and the page, into a folder; the page's path."""
    found = made.found
    comment = (
        f"{len(made.views)} views of {source};"
        f" corners RMS {made.rms_px:.3f} px, by the hand-eye pose {found.rms_px:.3f} px"
    )
    write_calibration(folder / "calibration.yaml", made.camera, found.X, comment)
    px, m, rad = np.sqrt(np.ma.masked_invalid(made.held**2).mean(axis=0)).filled(math.nan)
    sentences = [
        f"The corners are {found.rms_px:.3f} px (RMS) from where the pose puts them;"
        f" of views that were left out {px:.3f} px,"
        f" {1e3 * m:.2f} mm and {math.degrees(rad):.3f} degrees."
    ]
    if math.isfinite(made.rms_px):
        sentences.append(f"The lens alone explains them to {made.rms_px:.3f} px.")
    else:
        sentences.append("The lens was given.")
    if made.unseen:
        sentences.append(f"The board is not found in: {', '.join(made.unseen[:6])}.")
    advised = advice(made)
    place, turn = _uncertainty(found)
    where = "on the flange" if found.in_hand else "in the room"
    head = (
        f"The camera {where} is known to {place:.2f} mm and"
        f" {turn:.3f} degrees (one standard deviation)"
    )
    off = {}
    if truth is not None:
        off = found.off(truth.camera.mount.T)
        mm, deg = off["bundle adjustment"]
        head += f"; it is off the truth by {mm:.2f} mm and {deg:.3f} degrees"
    with style():
        corners = publish(_drawn(made), "corners", "Corners in the pictures", None)
    return write_page(
        folder,
        "study.html",
        f"Calibration from {source}",
        outcome=(head, "open" if advised else "good", sentences + advised),
        plots=[("Where the corners were", corners, CAPTION)],
        tables=[_methods(found, off), _lens(made, truth), _per_view(made)],
        command=command,
    )


def _uncertainty(found: HandEye) -> tuple[float, float]:
    """One standard deviation of the camera's place [mm], and of its rotation [deg]."""
    place, turn = found.sigma
    return 1e3 * float(np.linalg.norm(place)), math.degrees(np.linalg.norm(turn))


CAPTION = (
    "Corners of all views in the picture,"
    " each with its error by the hand-eye pose, 200 times as long."
)
Table = tuple[str, list[str], list[list[str]]]


def _methods(found: HandEye, off: dict[str, tuple[float, float]]) -> Table:
    turns = ["roll [deg]", "pitch [deg]", "yaw [deg]"]
    heads = ["Method", "x [mm]", "y [mm]", "z [mm]", *turns]
    if off:
        heads += ["off by [mm]", "off by [deg]"]
    lines = []
    for name, X in found.poses.items():
        place = [f"{1e3 * v:.2f}" for v in X[:3, 3]]
        turn = [f"{v:.3f}" for v in rpy_of(X[:3, :3].tolist())]
        lines.append([name, *place, *turn])
        if off:
            mm, deg = off[name]
            lines[-1] += [f"{mm:.2f}", f"{deg:.3f}"]
    frame = "in the flange's frame" if found.in_hand else "in the robot's base"
    return f"The camera's pose {frame}", heads, lines


def _lens(made: Calibrated, truth: Scenario | None) -> Table:
    def line(whose: str, camera: Any) -> list[str]:
        numbers = (*np.broadcast_to(camera.focal, 2), *camera.centre)
        distortion = ", ".join(f"{k:.4g}" for k in camera.lens_coefficients)
        return [whose, *(f"{v:.2f}" for v in numbers), distortion or "none"]

    lines = [line("found" if math.isfinite(made.rms_px) else "given", made.camera)]
    if truth is not None and hasattr(truth.camera, "lens_coefficients"):
        lines.append(line("true", truth.camera))
    return "The lens", ["", "fx [px]", "fy [px]", "cx [px]", "cy [px]", "Distortion"], lines


def _per_view(made: Calibrated) -> Table:
    lines = []
    for v, (px, m, rad) in zip(made.views, made.held, strict=True):
        rms = np.sqrt((v.errors(made.found.board_in(v), made.camera) ** 2).mean())
        left_out = [f"{px:.3f}", f"{1e3 * m:.2f}", f"{math.degrees(rad):.3f}"]
        lines.append([v.name, str(len(v.uv)), f"{rms:.3f}", *left_out])
    return "Views", ["Picture", "Corners", "RMS [px]", "Left out: RMS [px]", "[mm]", "[deg]"], lines


def _drawn(made: Calibrated) -> Figure:
    w = made.camera.width
    h = made.camera.height
    drawn = new_figure(7.16 * 0.7 * h / w + 0.5, 7.16 * 0.7)
    axes = drawn.add_subplot()
    for v in made.views:
        error = v.errors(made.found.board_in(v), made.camera)
        axes.plot(*v.uv.T, ".", markersize=2, color=LINE_COLORS[0])
        ends = np.stack([v.uv, v.uv + 200 * error]).transpose(2, 0, 1)
        axes.plot(*ends, color=LINE_COLORS[1], linewidth=0.6)
    axes.set(xlim=(-0.5, w - 0.5), ylim=(h - 0.5, -0.5), xlabel="u [px]", ylabel="v [px]")
    axes.set_aspect("equal")
    return drawn


def told(made: Calibrated, truth: Scenario | None) -> list[str]:
    """The result in lines for a terminal."""
    found = made.found
    x, y, z = 1e3 * found.X[:3, 3]
    roll, pitch, yaw = rpy_of(found.X[:3, :3].tolist())
    place, turn = _uncertainty(found)
    lines = [
        f"{len(made.views)} views; xyz {x:.2f} {y:.2f} {z:.2f} mm,"
        f" rpy {roll:.3f} {pitch:.3f} {yaw:.3f} deg, +-{place:.2f} mm +-{turn:.3f} deg"
    ]
    if truth is not None:
        for name, (mm, deg) in found.off(truth.camera.mount.T).items():
            lines.append(f"  off by    {mm:.2f} mm and {deg:.3f} deg by {name}")
    return lines + [f"  advice    {words}" for words in advice(made)]


def print_to(board: Board, path: Path) -> None:
    """Write a board as a picture."""
    write_whole(path, cv2.imencode(".png", board.print())[1].tobytes())


def camera_of(file: Path) -> Camera:
    """The camera of a calibration's file."""
    return _camera(read_intrinsics(str(file)))


# How exact a hand-eye calibration will be: by trial, over number of views, their turns, errors of
# joints and of corners.
BASE = {"views": 15.0, "turn_deg": 30.0, "joint_deg": 0.02, "corner_px": 0.1}
OVER: dict[str, tuple[float, ...]] = {
    "views": (5.0, 10.0, 15.0, 25.0, 40.0),
    "turn_deg": (5.0, 10.0, 20.0, 30.0, 40.0),
    "joint_deg": (0.0, 0.01, 0.02, 0.05, 0.1),
    "corner_px": (0.05, 0.1, 0.3, 1.0),
}


def exactness(
    scenario: Scenario, board: Board, trials: int, tick: Callable[[], None] = lambda: None
) -> pl.DataFrame:
    """Errors of hand-eye calibrations of a scenario's arm and camera, over each of OVER with the
    others as in BASE, by simulated corners: a line for each, with the median and the 95 % quantile
    of each method's errors [mm, deg].

    Raises UnreachableError: the arm reaches no views of the board.
    """
    rows: list[dict[str, Any]] = []
    for name, values in OVER.items():
        for value in values:
            setting = {**BASE, name: value}
            thousandths = np.round(1e3 * np.array(list(setting.values()))).astype(int)
            rng = np.random.default_rng([scenario.seed, *thousandths])
            for _ in range(trials):
                off = _trial(scenario, board, rng, setting).off(scenario.camera.mount.T)
                for method, (mm, deg) in off.items():
                    rows.append({"over": name, **setting, "method": method, "mm": mm, "deg": deg})
                tick()
    groups = pl.DataFrame(rows).group_by("over", *BASE, "method", maintain_order=True)
    return groups.agg(
        trials=pl.len(),
        mm=pl.median("mm"),
        mm_95=pl.quantile("mm", 0.95, "linear"),
        deg=pl.median("deg"),
        deg_95=pl.quantile("deg", 0.95, "linear"),
    )


def _trial(
    scenario: Scenario, board: Board, rng: np.random.Generator, setting: dict[str, float]
) -> HandEye:
    """One calibration by drawn views."""
    camera = scenario.camera
    robot = scenario.robot
    pixel_sigma = setting["corner_px"]
    joint_sigma = math.radians(setting["joint_deg"])
    corners = np.asarray(board.board().getChessboardCorners(), dtype=float)
    views: list[View] = []
    drawn = _drawn_views(scenario, board, rng, round(setting["views"]), setting["turn_deg"])
    for q, T_camera_board in drawn:
        uv = camera.project(transform(T_camera_board, corners))
        uv = uv + pixel_sigma * rng.standard_normal(uv.shape)
        read = q + joint_sigma * rng.standard_normal(len(q))
        seen = seen_from(corners, uv, camera)
        J = joint_jacobian(robot.flange_pose, read)
        views.append(View("", robot.flange_pose(read), corners, uv, seen, J))
    return calibrate(views, camera, True, max(pixel_sigma, 1e-3), max(joint_sigma, 1e-6))


def _drawn_views(
    scenario: Scenario, board: Board, rng: np.random.Generator, views: int, turn_deg: float
) -> Iterator[tuple[Array, Array]]:
    """Joints and T_camera_board of views that the arm reaches, and that show all of the board:
    turned about it by up to an angle.
    """
    camera = scenario.camera
    robot = scenario.robot
    size = board.square_m * np.array([board.columns, board.rows, 0])
    corners = size * [[0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0]]
    shift = posed(np.eye(3), -size / 2)
    # the target's frame is in the board's middle
    T_world_board = scenario.target.pose.T @ shift
    q0 = robot.configuration()
    made = 0
    for _ in range(200 * views):
        turn = rng.standard_normal(3)
        turn *= math.radians(turn_deg) * rng.random() ** (1 / 3) / np.linalg.norm(turn)
        R = Rotation.from_rotvec(turn).as_matrix()
        place = [*rng.uniform(-0.08, 0.08, 2), rng.uniform(0.35, 0.6)]
        T_camera_board = posed(R, np.array(place)) @ shift
        if not camera.inside(camera.project(transform(T_camera_board, corners)), 5.0).all():
            continue
        T_world_camera = T_world_board @ inverse(T_camera_board)
        try:
            q = robot.configuration_at(T_world_camera @ inverse(camera.mount.T), q0)
        except UnreachableError:
            continue
        yield q, T_camera_board
        made += 1
        if made == views:
            return
    words = f"of the board that the arm reaches are {made} of {views}; place the board elsewhere"
    raise UnreachableError("views", words)


WORDS = {
    "views": ("number of views", ""),
    "turn_deg": ("views turned by up to", "deg"),
    "joint_deg": ("joints read with", "deg"),
    "corner_px": ("corners found with", "px"),
}


def write_table(folder: Path, table: pl.DataFrame, scenario: Scenario, command: str) -> Path:
    """Write `table.csv` and the page of `exactness` into a folder; the page's path."""
    write_whole(folder / "table.csv", table.write_csv())
    methods = table["method"].unique(maintain_order=True)
    tables = []
    settings = []
    for name, (words, unit) in WORDS.items():
        tables.append((f"Over {words}", [_label(name), *methods], _rows_over(table, name)))
        settings.append(f"{words} {BASE[name]:g}{unit and ' ' + unit}")
    best = table.filter(**BASE, method="bundle adjustment").row(0, named=True)
    head = f"{best['mm']:.2f} mm and {best['deg']:.3f} degrees with {', '.join(settings)}"
    said = [
        f"The camera of {scenario.name} on its arm,"
        f" {best['trials']} simulated calibrations a line.",
        "In each table the others are as above:"
        " errors in mm, in brackets that of 95 % of the calibrations, then in degrees.",
    ]
    with style():
        curves = publish(_curves(table), "exactness", "Errors of the hand-eye pose", None)
    return write_page(
        folder,
        "study.html",
        "How exact a hand-eye calibration is",
        outcome=(head, "good", said),
        plots=[("The bundle adjustment", curves, "Median, and 95 %.")],
        tables=tables,
        command=command,
    )


def _label(name: str) -> str:
    """A quantity of OVER with its unit."""
    words, unit = WORDS[name]
    return f"{words} [{unit}]" if unit else words


def _rows_over(table: pl.DataFrame, name: str) -> list[list[str]]:
    """The table over one quantity: each of its values with the errors of all methods."""
    rows = []
    for (value,), those in table.filter(over=name).group_by(name, maintain_order=True):
        errors = those.select("mm", "mm_95", "deg").rows()
        cells = [f"{mm:.2f} ({mm_95:.2f}), {deg:.3f}" for mm, mm_95, deg in errors]
        rows.append([f"{value:g}", *cells])
    return rows


def _curves(table: pl.DataFrame) -> Figure:

    drawn = new_figure(2.6, 7.16)
    for axes, name in zip(drawn.subplots(1, len(WORDS), sharey=True), WORDS, strict=True):
        those = table.filter(over=name, method="bundle adjustment")
        axes.plot(those[name], those["mm"], "o-", markersize=3, color=LINE_COLORS[0])
        axes.plot(those[name], those["mm_95"], "--", color=LINE_COLORS[0])
        axes.set_yscale("log")
        axes.set_xlabel(_label(name))
    drawn.axes[0].set_ylabel("error [mm]")
    return drawn
