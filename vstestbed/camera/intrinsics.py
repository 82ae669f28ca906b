"""Calibrations of real cameras: intrinsics and mount, read from the files of ROS and OpenCV, and
written as ROS reads them.
"""

from __future__ import annotations

import functools
import json
import logging
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import yaml
from annotated_types import Ge, Le, Len

from vstestbed.core.errors import ParameterError, short
from vstestbed.core.files import write_whole
from vstestbed.core.foreign import only_known
from vstestbed.core.geometry import Array, pose_block, pose_from, quaternion_wxyz, unit_quaternion
from vstestbed.core.lazy import cv2
from vstestbed.core.named_files import named_file
from vstestbed.core.plain_yaml import once, plain_documents
from vstestbed.core.quantity import Coefficient, Pixel, PositivePixels
from vstestbed.core.spec import spec

if TYPE_CHECKING:
    from vstestbed.camera.base import Camera

__all__ = [
    "Intrinsics",
    "as_ros",
    "read_calibration",
    "read_intrinsics",
    "read_mount",
    "write_calibration",
]

Model = Literal["plumb_bob", "rational_polynomial", "equidistant"]
COEFFICIENTS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (8,), "equidistant": (0, 4)}
"""How many numbers each of ROS's distortion models has."""
LENSES: dict[str, tuple[Model, ...]] = {
    "perspective": ("plumb_bob", "rational_polynomial"),
    "fisheye": ("equidistant",),
}
"""The models of each lens."""


@spec
class Intrinsics:
    """The intrinsics of a calibrated lens, as OpenCV and ROS have them: u = fx x_d + cx, v = fy
    y_d + cy, without skew.

    A file stands for the block: a `camera_info` of ROS (YAML, also the message as `ros2 topic echo`
    prints it), or OpenCV's YAML, XML or JSON with a camera matrix and distortion coefficients. It
    is read with the scenario; a run's folder keeps the numbers.

    Args:
        focal_px: (fx, fy) [px]; e.g. `[612.4, 611.8]`.
        principal_px: (cx, cy) [px], the centre of the first pixel at 0; e.g. `[322.5, 238]`.
        distortion: of a perspective lens (k1, k2, p1, p2, k3) or, of its rational model, also (...,
            k4, k5, k6); of a fisheye lens (k1, k2, k3, k4) [1]; e.g. `[-0.2, 0.05, 0, 0, 0]`.
        size: (width, height) of the pictures that were calibrated with [px]; e.g. `[640, 480]`.
        model: ROS's name of the distortion's model, where it is known; e.g. `plumb_bob`.

    Reference: REP 104, and OpenCV's calibration module for the order of the coefficients.
    """

    focal_px: Annotated[tuple[PositivePixels, ...], Len(2, 2)]
    principal_px: Pixel
    distortion: Annotated[tuple[Coefficient, ...], Len(0, 8)] = ()
    size: Annotated[tuple[Annotated[int, Ge(8), Le(8192)], ...], Len(2, 2)] | None = None
    model: Model | None = None

    def __post_init__(self) -> None:
        counts = COEFFICIENTS[self.model] if self.model else (0, 4, 5, 8)
        if len(self.distortion) not in counts:
            of = f" of {self.model}" if self.model else ""
            raise ParameterError(
                "distortion",
                f"must have {' or '.join(map(str, counts))} numbers{of}",
                list(self.distortion),
            )

    def check(self, lens: str, width: int, height: int, field: str) -> None:
        """Refuse intrinsics of another lens, or of pictures of another size. field: the dotted name
        for messages.
        """
        if self.model is not None and self.model not in LENSES[lens]:
            other = next(kind for kind, models in LENSES.items() if self.model in models)
            raise ParameterError(
                field,
                f"are {self.model}, the model of a camera of kind {other}, and this one is {lens}",
            )
        if lens == "fisheye" and len(self.distortion) not in (0, 4):
            raise ParameterError(
                f"{field}.distortion",
                "must have 4 numbers of a fisheye lens",
                list(self.distortion),
            )
        if self.size is not None and self.size != (width, height):
            words = (
                f"are of pictures of {self.size[0]} x {self.size[1]} px,"
                f" and the camera has {width} x {height}"
            )
            raise ParameterError(field, f"{words}; set its width and height to theirs")

    def scaled(
        self, focal_error: float, centre: tuple[float, float], ignores_distortion: bool
    ) -> Intrinsics:
        """The same with focal lengths 1 + focal_error times as long, another principal point, and
        no distortion where it is ignored.
        """
        fx, fy = (f * (1 + focal_error) for f in self.focal_px)
        scaled = replace(self, focal_px=(fx, fy), principal_px=centre)
        if not ignores_distortion:
            return scaled
        model = "plumb_bob" if self.model == "rational_polynomial" else self.model
        return replace(scaled, distortion=(), model=model)

    @classmethod
    def of(
        cls,
        camera_matrix: Any,
        dist: Any = (),
        size: tuple[int, int] | None = None,
        model: str = "",
        name: str = "K",
    ) -> Intrinsics:
        """Those of a camera matrix (3, 3) and distortion coefficients of OpenCV; numbers that are 0
        at the end do not count.
        Raises ParameterError: a matrix that is none, a skew, coefficients of a model that is not
        known here.
        """
        K = _numbers(camera_matrix, name)
        form = "must be a camera matrix (3, 3), [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        if K.size != 9:
            raise ParameterError(name, form, short(K.tolist()))
        K = K.reshape(3, 3)
        exact = 1e-9 * abs(K[0, 0])  # rounding of files with ten digits
        if abs(K[0, 1]) > exact:
            raise ParameterError(
                name,
                "has a skew, and pixels here are rectangles; calibrate without it",
                float(K[0, 1]),
            )
        if np.abs([K[1, 0], K[2, 0], K[2, 1], K[2, 2] - 1]).max() > exact:
            raise ParameterError(name, form, short(K.tolist()))
        k, model = _modelled(
            _numbers(() if dist is None else dist, "distortion").ravel().tolist(), model
        )
        given: Any = {"model": model} if model else {}
        fx, fy, cx, cy = (float(K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
        return cls(
            focal_px=(fx, fy), principal_px=(cx, cy), distortion=tuple(k), size=size, **given
        )


def _modelled(k: list[float], model: str) -> tuple[list[float], str]:
    """OpenCV's coefficients without zeros at their end, and the model that they are of; "" where
    its name is not given.
    Raises ParameterError: of a model that is not known here.
    """
    model = {"fisheye": "equidistant", "radtan": "plumb_bob", "kannala_brandt": "equidistant"}.get(
        model, model
    )
    while len(k) > 8 and k[-1] == 0:
        k = k[:-1]
    most = max(COEFFICIENTS.get(model, (8,)))
    if not any(k[most:]):
        k = k[:most]
    # OpenCV's rational model, by the name that a driver has given it
    if model == "plumb_bob" and len(k) == 8:
        model = "rational_polynomial"
    if model == "rational_polynomial" and len(k) in (4, 5):
        _tell(
            f"distortion_model rational_polynomial of {len(k)} coefficients is read as plumb_bob:"
            " k4, k5 and k6 are 0"
        )
        model = "plumb_bob"
    if model not in ("", *COEFFICIENTS):
        valid = f"{', '.join(COEFFICIENTS)} are known, of up to 8 coefficients"
        raise ParameterError("distortion_model", f"cannot be drawn here; {valid}", model)
    if len(k) > 8:
        words = (
            f"cannot be drawn here: {len(k)} coefficients are of a thin prism or a tilted sensor"
        )
        raise ParameterError(
            "distortion_coefficients",
            f"{words}; works: up to 8 of plumb_bob or rational_polynomial",
            k,
        )
    return k, model


@functools.cache
def _tell(words: str) -> None:
    """Say once what is read otherwise than it is called."""
    logging.getLogger("vstestbed").warning("%s", words)


# Reading. Each file is first a plain mapping, whichever of the formats it has.
WORKS = "a camera_info of ROS, or OpenCV's YAML, XML or JSON"
MOUNTS = (
    "a transformation of x, y, z, qx, qy, qz, qw (easy_handeye), a matrix (4, 4),"
    " or R_cam2gripper and t_cam2gripper"
)
MOST_BYTES = 1 << 20
"""A calibration has some kilobytes, with all corners of its board 100."""
MOST_PARTS = 4000
"""Most brackets of a file for OpenCV's reader, which overflows the stack where 50,000 are one
within the other.
"""
MOST_NUMBERS = 64
"""Most numbers of a row, and of a matrix."""
READ: Mapping[str, Sequence[str]] = {
    "camera_matrix": ("K", "intrinsic_matrix", "M"),
    "distortion_coefficients": ("dist_coeffs", "dist_coeff", "dist", "D", "distortion"),
    "distortion_model": (),
    "fisheye_model": (),
    "image_width": ("width",),
    "image_height": ("height",),
    "image_size": ("resolution",),
    "binning_x": (),
    "binning_y": (),
    "roi": (),
    "rectification_matrix": ("R",),
    "projection_matrix": ("P",),
    "header": (),
    "R_cam2gripper": ("rotation_matrix",),
    "T_cam2gripper": ("T_gripper_camera", "T_flange_camera"),
    "translation_vector": ("t",),
    "transformation": ("transform", "hand_eye", "mount"),
    "translation": (),
    "rotation": (),
    **dict.fromkeys(("x", "y", "z", "qw", "qx", "qy", "qz"), ()),
    "parameters": (),
    "eye_on_hand": (),
    "calibration_type": (),
    "tracking_base_frame": (),
    "child_frame_id": (),
    "robot_effector_frame": (),
}
"""The fields that are read, with further names of each, in any spelling: `camera_matrix`,
`cameraMatrix`, `Camera_Matrix`.
"""
# fmt: off
ABOUT = [
    "camera_name", "name", "comment", "comments", "description", "serial", "serial_number",
    "date", "time", "calibration_time", "calibration_date",
    "nframes", "nr_of_frames", "number_of_frames", "flags", "flag_value",
    "board_width", "board_height", "square_size", "marker_size", "fix_aspect_ratio",
    "aspect_ratio", "rms", "rms_error", "error",
    "reprojection_error", "mean_reprojection_error", "avg_reprojection_error",
    "per_view_reprojection_errors", "per_view_errors", "extrinsic_parameters",
    "image_points", "grid_points",
    "robot_base_frame", "tracking_marker_frame",
]
"""Fields that say how a calibration was made, and change nothing."""
SETUP = [
    "name", "namespace", "namespace_prefix", "move_group", "move_group_namespace",
    "freehand_robot_movement",
    "robot_base_frame", "tracking_marker_frame",
]
# fmt: on
"""The same of the block `parameters` of easy_handeye."""
STAMP = "frame_id", "seq", "stamp"
FRAMES = (
    "eye_on_hand",
    "calibration_type",
    "tracking_base_frame",
    "child_frame_id",
    "robot_effector_frame",
)
NO_FLANGE = re.compile(
    r"((robot_)?base(_link|_footprint)?|world|map|odom|.*_link_?0)$"
    r"|.*(torso|shoulder|upper_?arm|fore_?arm|elbow|optical)"
    r"|(.*_)?camera(_(link|frame|(color|depth|rgb|infra\d?|left|right)\w*))?$",
    re.IGNORECASE,
)
"""Names of frames that are no flange: of a base, a room, a camera, of a link before the wrist."""
OF_CAMERA = re.compile("optical|camera", re.IGNORECASE)
POSE = "x", "y", "z", "qw", "qx", "qy", "qz"
OF_MOUNT = (
    "R_cam2gripper",
    "T_cam2gripper",
    "translation_vector",
    "transformation",
    "translation",
    "rotation",
    *POSE,
)


def _bare(name: object) -> str:
    return str(name).replace("_", "").lower()


NAMES = {_bare(name): name for name in ABOUT}
NAMES |= {_bare(name): field for field, names in READ.items() for name in (field, *names)}


def _plain(file: str) -> dict[str, Any]:
    """The values of a calibration file by the fields of READ.

    Raises ParameterError: it is not there, holds none, several calibrations, or one field twice.
    """
    with named_file("", file, WORKS, MOST_BYTES) as path:
        documents = _documents(path.read_text(encoding="utf-8-sig"), path.suffix.lower() == ".json")
        if not documents or not all(isinstance(document, dict) for document in documents):
            raise ValueError("it holds no fields")
        first, *others = documents
        # `ros2 topic echo` prints a message after another, of which only the stamps differ.
        if any({**other, "header": None} != {**first, "header": None} for other in others):
            raise ValueError("it holds several calibrations; keep one")
        return once([(NAMES.get(_bare(key), key), value) for key, value in first.items()])


def _documents(text: str, is_json: bool) -> list[Any]:
    if "\0" in text:
        raise ValueError("it has bytes of zeros, as a file cut off by a crash")
    if text.lstrip().startswith("<") or text.startswith("%YAML:1.0") or "opencv-matrix" in text:
        return _from_opencv(text)
    if is_json:
        return [json.loads(text, object_pairs_hook=once)]
    return plain_documents(text)


def _from_opencv(text: str) -> list[Any]:
    if text.lstrip().startswith("<") and "<opencv_storage" not in text:
        raise ValueError("its XML is not OpenCV's, which begins with <opencv_storage>")
    if sum(text.count(part) for part in ("<", "[", "{", "- ")) > MOST_PARTS:
        raise ValueError("it has more parts than a calibration, or deeper ones")
    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    if not storage.root(1).empty():
        raise ValueError("it holds several documents; keep one")
    root = storage.root()
    found = []
    for key in root.keys():  # noqa: SIM118 - a FileNode is no mapping
        read = NAMES.get(_bare(key)) in READ  # others, such as all corners of a board, may be long
        found.append((key, _node(root.getNode(key)) if read else None))
    return [once(found)]


def _node(node: Any) -> Any:
    if node.isMap():
        return {name: _node(node.getNode(name)) for name in node.keys()}  # noqa: SIM118 - a FileNode is no mapping
    if node.isSeq():
        if node.size() > MOST_NUMBERS:
            raise ValueError(f"it has a row of {node.size()} numbers")
        return [_node(node.at(i)) for i in range(node.size())]
    if node.isString():
        return node.string()
    return None if node.isNone() else node.real()


def _numbers(value: Any, name: str) -> Array:
    """An array of numbers, given as one, as lists, or as a mapping with `data`."""
    sides: list[Any] = []
    if isinstance(value, Mapping):
        only_known(value, ("data", "rows", "cols"), ("dt", "type_id"), name)
        sides = [value[side] for side in ("rows", "cols") if side in value]
        value = value.get("data")
    found = _array(value)
    if not np.isfinite(found).all():
        raise ParameterError(name, "must be finite numbers", short(value))
    if sides and math.prod(_numbers(sides, f"{name}.rows").tolist()) != found.size:
        raise ParameterError(
            name, f"must have the numbers of its rows and columns, {sides}, and has {found.size}"
        )
    return found


def _array(value: Any) -> Array:
    """An array of numbers, or of lists of them; one NaN where it is neither, or larger than a
    matrix.
    """
    none = np.array([np.nan])
    try:
        items = np.array(value, dtype=object)
        plain = all(
            isinstance(one, str | Real) and not isinstance(one, bool) for one in items.ravel()
        )
        return items.astype(float) if plain and items.size <= MOST_NUMBERS else none
    except (ValueError, OverflowError):  # lists of several shapes, words, numbers beyond a float
        return none


def _block(
    plain: Mapping[str, Any], name: str, used: Sequence[str], harmless: Sequence[str] = ()
) -> Mapping[str, Any]:
    """A block whose fields are all known; an empty one where there is none."""
    block = plain.get(name)
    if not isinstance(block, Mapping | None):
        raise ParameterError(name, f"must be a block of {', '.join(used)}", short(block))
    only_known(block or {}, used, harmless, name)
    return block or {}


def _intrinsics_in(plain: Mapping[str, Any]) -> Intrinsics | None:
    if "camera_matrix" not in plain:
        return None
    _block(plain, "header", (), STAMP)
    size = _size_in(plain)
    _check_whole(plain, size)
    _check_raw(plain)
    _check_beside(plain)
    model, k = _distortion_in(plain)
    return Intrinsics.of(plain["camera_matrix"], k, size, model, "camera_matrix")


def _distortion_in(plain: Mapping[str, Any]) -> tuple[str, Any]:
    """The model's name, "" for none, and its coefficients."""
    model = str(plain.get("distortion_model") or "")
    k = plain.get("distortion_coefficients", None if model else ())
    if k is None:
        words = f"a lens of distortion_model {model or 'plumb_bob'} has some, or []"
        raise ParameterError.missing("distortion_coefficients", words)
    fisheye = plain.get("fisheye_model", 0)
    if fisheye not in (0, 1) or (fisheye and model not in ("", "equidistant", "fisheye")):
        words = f"must be 0 or 1, and 0 beside distortion_model {model or 'plumb_bob'}"
        raise ParameterError("fisheye_model", words, short(fisheye))
    return ("equidistant" if fisheye else model), k


def _size_in(plain: Mapping[str, Any]) -> tuple[int, int] | None:
    sides = [plain[name] for name in ("image_width", "image_height") if name in plain]
    if sides and "image_size" in plain:
        raise ParameterError.conflict("image_size", "image_width and image_height")
    size = _numbers(sides or plain.get("image_size", ()), "image_size").ravel()
    if size.size not in (0, 2) or (size % 1).any():
        raise ParameterError(
            "image_size", "must be two whole numbers, width and height [px]", size.tolist()
        )
    return (int(size[0]), int(size[1])) if size.size else None


def _check_whole(plain: Mapping[str, Any], size: tuple[int, int] | None) -> None:
    """Refuse pictures that are binned or cut out of those that were calibrated."""
    words = (
        "is not used, and pictures are not those that were calibrated; works: the camera matrix"
        " and the size of the pictures as they come, without"
    )
    for name in ("binning_x", "binning_y"):
        if plain.get(name, 0) not in (0, 1):
            raise ParameterError(name, f"{words} {name}", short(plain[name]))
    roi = _block(plain, "roi", ("x_offset", "y_offset", "width", "height"), ("do_rectify",))
    offset = roi.get("x_offset", 0), roi.get("y_offset", 0)
    extent = roi.get("width", 0), roi.get("height", 0)
    if offset != (0, 0) or extent not in ((0, 0), size):
        raise ParameterError("roi", f"{words} a roi", short(dict(roi)))


def _check_raw(plain: Mapping[str, Any]) -> None:
    """Refuse a camera of a stereo pair whose pictures are turned or shifted by rectification.

    P and R describe the rectified picture. The raw one has K and D alone, so that a P of another
    focal length, with R = 1 and no baseline, is of the same camera without its distortion, and
    changes nothing.
    """
    works = (
        "works: for raw pictures (image_raw) neither R nor P;"
        " for rectified ones the first three columns of P as camera_matrix, without distortion"
    )
    R = _numbers(plain.get("rectification_matrix", np.eye(3)), "rectification_matrix")
    if R.size != 9 or np.abs(R.reshape(3, 3) - np.eye(3)).max() > 1e-6:  # as exact as files have it
        words = f"must be the identity: it turns the camera of a stereo pair; {works}"
        raise ParameterError("rectification_matrix", words, short(R.tolist()))
    P = _numbers(plain.get("projection_matrix", np.eye(3, 4)), "projection_matrix")
    if P.size != 12 or P.reshape(3, 4)[:, 3].any():
        words = (
            f"must have zeros as its fourth column: it has the baseline of a stereo pair; {works}"
        )
        raise ParameterError("projection_matrix", words, short(P.tolist()))


def _check_beside(plain: Mapping[str, Any]) -> None:
    """Refuse fields of a mount that are not the whole of one: they could be meant otherwise."""
    beside = [name for name in OF_MOUNT if name in plain]
    if beside and _mount_of(plain) is None:
        words = f"is of the mount, and not the whole of it; works: {MOUNTS}, or the file without"
        raise ParameterError(beside[0], words, short(plain[beside[0]]))


def _mount_in(plain: Mapping[str, Any]) -> Array | None:
    """T_flange_camera (4, 4) of a hand-eye calibration; None without one."""
    T = _mount_of(plain)
    if T is None:
        return None
    _check_frames(plain)
    U, _, V = np.linalg.svd(T[:3, :3])
    turn = U @ V  # the nearest rotation, or mirror image: files have three digits and more
    if (
        np.abs(T[:3, :3] - turn).max() > 1e-3
        or np.linalg.det(turn) < 0
        or (T[3] != (0, 0, 0, 1)).any()
    ):
        raise ParameterError("mount", "must be a rotation and a translation", short(T.tolist()))
    T[:3, :3] = turn
    return T


FORMS = (
    ("transformation",),
    ("R_cam2gripper", "rectification_matrix", "T_cam2gripper", "translation_vector"),
    ("translation", "rotation"),
    POSE,
)
"""Fields of a pose, by the form to which they belong."""


def _check_one_pose(plain: Mapping[str, Any]) -> None:
    """Refuse a file that gives the pose twice, in whatever forms: the two may differ."""
    there = {*plain}
    if "camera_matrix" in there:
        there.discard("rectification_matrix")  # ROS's
    given = [next((name for name in form if name in there), "") for form in FORMS]
    first, *others = list(filter(None, given)) or [""]
    if others:
        raise ParameterError.conflict(first, others[0])


def _mount_of(plain: Mapping[str, Any]) -> Array | None:
    """What R and t, a transformation, or a matrix says."""
    _check_one_pose(plain)
    given = [
        name for name in ("transformation", "T_cam2gripper", "translation_vector") if name in plain
    ]
    if len(given) > 1:
        raise ParameterError.conflict(given[0], given[1])
    name = given[0] if given else ""
    turn = None
    if "camera_matrix" not in plain:  # with one it is ROS's rectification
        turn = plain.get("rectification_matrix")
    R = plain.get("R_cam2gripper", turn)
    if R is not None and name in ("T_cam2gripper", "translation_vector"):
        T = np.eye(4)
        T[:3, :3] = _sized(R, "R_cam2gripper", (3, 3))
        T[:3, 3] = _sized(plain[name], "t_cam2gripper", (3,))
        return T
    if name in ("transformation", "T_cam2gripper"):
        return _pose_in(plain[name], name)
    return _quaternion_in(plain, "")


def _sized(value: Any, name: str, shape: tuple[int, ...]) -> Array:
    """Numbers of a matrix or a vector, in whatever shape."""
    numbers = _numbers(value, name)
    if numbers.size != math.prod(shape):
        raise ParameterError.count(name, math.prod(shape), "numbers", short(numbers.tolist()))
    return numbers.reshape(shape)


def _pose_in(value: Any, name: str) -> Array:
    if not isinstance(value, Mapping) or "data" in value:
        return _sized(value, name, (4, 4))
    only_known(value, ("translation", "rotation", *POSE), (), name)
    T = _quaternion_in(value, f"{name}.")
    if T is None:
        raise ParameterError(
            name, f"needs {', '.join(POSE)}, or translation and rotation", short(value)
        )
    return T


def _quaternion_in(plain: Mapping[str, Any], where: str) -> Array | None:
    """The pose (4, 4) of x, y, z and a quaternion, in one block or in `translation` and `rotation`;
    None where it has not all seven numbers.
    """
    place = plain
    turn = plain
    before = "q"
    if "rotation" in plain or "translation" in plain:
        if beside := [name for name in POSE if name in plain]:
            raise ParameterError.conflict(f"{where}{beside[0]}", "translation and rotation")
        place = _block(plain, "translation", "xyz")
        turn = _block(plain, "rotation", "wxyz")
        before = ""
    p = [place.get(name) for name in "xyz"]
    q = [turn.get(f"{before}{name}") for name in "wxyz"]
    if None in p or None in q:
        return None
    unit = unit_quaternion(_numbers(q, f"{where}rotation"), f"{where}rotation")
    return pose_from(_numbers(p, f"{where}translation"), unit)


def _check_frames(plain: Mapping[str, Any]) -> None:
    """Refuse a pose of another camera than one on the flange, and of another frame of it than the
    optical one.
    """
    block = _block(plain, "parameters", FRAMES, SETUP)
    said = [(name, of[name]) for of in (block, plain) for name in FRAMES if name in of]
    alone = {"eye_on_hand": (True, "true"), "calibration_type": ("eye_in_hand",)}
    for name, found in said:
        if found not in alone.get(name, (found,)):
            words = (
                "is of a camera that stands beside the robot,"
                " and this is read as the mount on the flange; works: a calibration eye in hand,"
                " or, for a camera with on: world, the pose in the scenario itself"
            )
            raise ParameterError(name, words, found)
    _check_parent(plain, said)
    for name, found in said:
        if name in ("tracking_base_frame", "child_frame_id") and "optical" not in str(found):
            words = (
                "is not known as the camera's optical frame (x right, y down, z forward);"
                " works: the pose of that frame, with a name such as camera_optical_frame"
            )
            raise ParameterError(name, words, found)


def _check_parent(plain: Mapping[str, Any], said: list[tuple[str, Any]]) -> None:
    """Refuse a pose in a frame that is not the flange's, by its name. said: fields of FRAMES."""
    header = _block(plain, "header", STAMP).get("frame_id", "")
    for name, found in (("header.frame_id", header), *said):
        frame = str(found).rpartition("/")[2]
        # the header of a camera's intrinsics has the camera's frame
        of_camera = "camera_matrix" in plain and OF_CAMERA.search(frame)
        is_parent = name == "robot_effector_frame" or (name == "header.frame_id" and not of_camera)
        if is_parent and NO_FLANGE.match(frame):
            words = "must be the flange's frame, and not one of a base, a room, a link or a camera"
            raise ParameterError(name, words, found)


def _read(
    file: str, lacks: str, works: str, *parts: Callable[[Mapping[str, Any]], Any]
) -> list[Any]:
    """The parts of a calibration's file. lacks: what it lacks where all are None, for messages."""
    plain = _plain(file)
    try:
        found = [part(plain) for part in parts]
        if any(part is not None for part in found):
            only_known(plain, READ, ABOUT)
            return found
    except ParameterError as error:
        raise ParameterError(error.field, f"{error.problem} (in {file})", error.found) from None
    raise ParameterError.unreadable(
        "", f"it has {lacks} among {short(', '.join(map(str, plain)))}", works, file
    )


def read_intrinsics(file: str) -> Intrinsics:
    """The intrinsics in a calibration file; ParameterError where it has none, or fields that are
    not read.
    """
    (found,) = _read(file, "no camera matrix", WORKS, _intrinsics_in)
    return found


def read_mount(file: str) -> dict[str, Any]:
    """The block of the mount, the camera's pose in the flange's frame, in a hand-eye calibration's
    file; ParameterError as above.
    """
    (found,) = _read(file, "no pose of the camera", MOUNTS, _mount_in)
    return pose_block(found)


def read_calibration(file: str) -> dict[str, Any]:
    """The block `calibration` of a file that has intrinsics, a mount, or both; ParameterError where
    it has neither, and as above.
    """
    intrinsics, T = _read(
        file,
        "neither a camera matrix nor a pose of the camera",
        "a calibration's file",
        _intrinsics_in,
        _mount_in,
    )
    found: dict[str, Any] = {} if intrinsics is None else {"intrinsics": intrinsics}
    return found if T is None else {**found, "mount": pose_block(T)}


# Writing.
def as_ros(camera: Camera) -> tuple[Array, Model, Sequence[float]] | None:
    """Camera matrix K (3, 3), model and coefficients of a camera's lens, as ROS has them; None of a
    lens without a standard model.
    """
    lens = getattr(camera, "kind", "")
    if lens not in LENSES:
        return None
    k: tuple[float, ...] = camera.lens_coefficients  # type: ignore[attr-defined] - both lenses have them
    fx, fy = np.broadcast_to(camera.focal, 2)
    cx, cy = camera.centre
    model: Model = "equidistant"
    if lens == "perspective":
        model = "rational_polynomial" if len(k) == 8 else "plumb_bob"
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), model, k or (0.0,) * 5


def write_calibration(
    path: Path,
    camera: Camera | None,
    T_flange_camera: Array | None,
    comment: str = "",
) -> None:
    """Write intrinsics and a hand-eye calibration as one `camera_info` file of ROS, whose readers
    pass over `transformation`.
    """
    plain: dict[str, Any] = {}
    if camera is not None and (lens := as_ros(camera)) is not None:
        K, model, k = lens
        P = np.column_stack([K, np.zeros(3)])
        plain = {
            "image_width": camera.width,
            "image_height": camera.height,
            "camera_name": "camera",
            "camera_matrix": _matrix(K),
            "distortion_model": model,
            "distortion_coefficients": _matrix(np.array([k])),
            "rectification_matrix": _matrix(np.eye(3)),
            "projection_matrix": _matrix(P),
        }
    if T_flange_camera is not None:
        w, *turn = quaternion_wxyz(T_flange_camera[:3, :3]).tolist()
        numbers = [*T_flange_camera[:3, 3].tolist(), *turn, w]
        names = ("x", "y", "z", "qx", "qy", "qz", "qw")
        plain["transformation"] = dict(zip(names, numbers, strict=True))
    notes = "".join(f"# {line}\n" for line in comment.splitlines())
    text = yaml.safe_dump(plain, sort_keys=False, default_flow_style=None, width=120)
    write_whole(path, notes + text)


def _matrix(a: Array) -> dict[str, Any]:
    return {"rows": a.shape[0], "cols": a.shape[1], "data": a.ravel().tolist()}
