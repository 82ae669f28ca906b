"""Calibrations of real cameras: intrinsics and mount, read from the files of ROS and OpenCV, and written as ROS reads them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import yaml
from annotated_types import Ge, Le, Len

from vstestbed.core.errors import ParameterError, short
from vstestbed.core.files import write_whole
from vstestbed.core.foreign import foreign, of_field
from vstestbed.core.geometry import Array, pose_block, pose_from, quaternion_wxyz
from vstestbed.core.lazy import cv2
from vstestbed.core.named_files import absolute_file, place_of_file
from vstestbed.core.quantity import Coefficient, Pixel, PositivePixels
from vstestbed.core.spec import spec

if TYPE_CHECKING:
    from vstestbed.camera.base import Camera

Model = Literal["plumb_bob", "rational_polynomial", "equidistant"]
COEFFICIENTS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (8,), "equidistant": (0, 4)}
"""How many numbers each of ROS's distortion models has."""
LENSES: dict[str, tuple[Model, ...]] = {"perspective": ("plumb_bob", "rational_polynomial"), "fisheye": ("equidistant",)}
"""The models of each lens."""


@spec
class Intrinsics:
    """The intrinsics of a calibrated lens, as OpenCV and ROS have them: u = fx x_d + cx, v = fy y_d + cy, without skew.

    A file stands for the block: a `camera_info` of ROS (YAML, also the message as `ros2 topic echo` prints it), or OpenCV's YAML, XML or
    JSON with a camera matrix and distortion coefficients. It is read with the scenario; a run's folder keeps the numbers.

    Args:
        focal_px: (fx, fy) [px]; e.g. `[612.4, 611.8]`.
        principal_px: (cx, cy) [px], the centre of the first pixel at 0; e.g. `[322.5, 238]`.
        distortion: of a perspective lens (k1, k2, p1, p2, k3) or, of its rational model, also (..., k4, k5, k6); of a fisheye lens
            (k1, k2, k3, k4) [1]; e.g. `[-0.2, 0.05, 0, 0, 0]`.
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
            raise ParameterError("distortion", f"must have {' or '.join(map(str, counts))} numbers{of}", list(self.distortion))

    def check(self, lens: str, width: int, height: int, field: str) -> None:
        """Refuse intrinsics of another lens, or of pictures of another size. field: the dotted name for messages."""
        if self.model is not None and self.model not in LENSES[lens]:
            other = next(kind for kind, models in LENSES.items() if self.model in models)
            raise ParameterError(field, f"are {self.model}, the model of a camera of kind {other}, and this one is {lens}")
        if lens == "fisheye" and len(self.distortion) not in (0, 4):
            raise ParameterError(f"{field}.distortion", "must have 4 numbers of a fisheye lens", list(self.distortion))
        if self.size is not None and self.size != (width, height):
            words = f"are of pictures of {self.size[0]} x {self.size[1]} px, and the camera has {width} x {height}"
            raise ParameterError(field, f"{words}; set its width and height to theirs")

    def scaled(self, focal_error: float, centre: tuple[float, float], ignores_distortion: bool) -> Intrinsics:
        """The same with focal lengths 1 + focal_error times as long, another principal point, and no distortion where it is ignored."""
        fx, fy = (f * (1 + focal_error) for f in self.focal_px)
        model = "plumb_bob" if ignores_distortion and self.model == "rational_polynomial" else self.model
        return Intrinsics(
            focal_px=(fx, fy),
            principal_px=centre,
            distortion=() if ignores_distortion else self.distortion,
            size=self.size,
            model=model,
        )

    @classmethod
    def of(cls, camera_matrix: Any, dist: Any = (), size: tuple[int, int] | None = None, model: str = "", name: str = "K") -> Intrinsics:
        """Those of a camera matrix (3, 3) and distortion coefficients of OpenCV; numbers that are 0 at the end do not count.
        Raises ParameterError: a matrix that is none, a skew, coefficients of a model that is not known here.
        """
        K = _numbers(camera_matrix, name)
        if K.size != 9:
            raise ParameterError(name, "must be a camera matrix (3, 3), [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]", short(K.tolist()))
        K = K.reshape(3, 3)
        if abs(K[0, 1]) > 1e-9 * abs(K[0, 0]):
            raise ParameterError(name, "has a skew, and pixels here are rectangles; calibrate without it", float(K[0, 1]))
        k = _numbers(dist, "distortion").ravel().tolist()
        model = {"fisheye": "equidistant", "radtan": "plumb_bob", "kannala_brandt": "equidistant"}.get(model, model)
        most = max(COEFFICIENTS.get(model, (8,)))
        while len(k) > most and k[-1] == 0:
            k.pop()
        if model == "plumb_bob" and len(k) == 8:  # OpenCV's rational model, by the name that a driver has given it
            model = "rational_polynomial"
        if model not in ("", *COEFFICIENTS) or len(k) > 8:
            valid = f"{', '.join(COEFFICIENTS)} are known, of up to 8 coefficients"
            raise ParameterError("distortion_model", f"cannot be drawn here; {valid}", model or f"{len(k)} coefficients")
        given: Any = {"model": model} if model else {}
        return cls(focal_px=(K[0, 0], K[1, 1]), principal_px=(K[0, 2], K[1, 2]), distortion=tuple(k), size=size, **given)


WORKS = "a camera_info of ROS, or OpenCV's YAML, XML or JSON"


# Reading. Each file is first a plain mapping, whichever of the formats it has.
def _plain(file: str) -> dict[str, Any]:
    """The values of a calibration file; ParameterError where it is not there, or holds none."""
    try:
        path = place_of_file(absolute_file(file, Path.cwd()))
        with foreign(file, WORKS, of_field("")):
            text = path.read_text(encoding="utf-8")
            if path.suffix.lower() == ".xml" or text.startswith("%YAML:1.0") or "opencv-matrix" in text:
                documents = [_from_opencv(text)]
            else:
                documents = [json.loads(text)] if path.suffix.lower() == ".json" else list(yaml.safe_load_all(text))
    except ParameterError as error:
        raise ParameterError("", error.problem, file) from None
    if not documents or not isinstance(documents[0], dict):
        raise ParameterError.unreadable("", "it holds no fields", WORKS, file)
    return documents[0]


def _from_opencv(text: str) -> Any:
    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    found = _node(storage.root())
    storage.release()
    return found


def _node(node: Any) -> Any:
    if node.isMap():
        if "data" in node.keys() and "rows" in node.keys():  # noqa: SIM118 - a FileNode is no mapping
            return node.mat()
        return {name: _node(node.getNode(name)) for name in node.keys()}  # noqa: SIM118 - as above
    if node.isSeq():
        return [_node(node.at(i)) for i in range(node.size())]
    return node.string() if node.isString() else node.real()


def _numbers(value: Any, name: str) -> Array:
    """An array of numbers, given as one, as lists, or as a mapping with `data`."""
    value = value.get("data") if isinstance(value, Mapping) else value
    try:
        found = np.array([] if value is None else value, dtype=float)
    except (TypeError, ValueError):
        found = np.array([np.nan])
    if not np.isfinite(found).all():
        raise ParameterError(name, "must be finite numbers", short(value))
    return found


def _first(plain: Mapping[str, Any], *names: str) -> Any:
    """The value of the first of some names, in any spelling: `camera_matrix`, `cameraMatrix`, `Camera_Matrix`."""
    spelled = {key.replace("_", "").lower(): value for key, value in plain.items() if isinstance(key, str)}
    return next((spelled[name] for name in names if name in spelled), None)


def _intrinsics_in(plain: Mapping[str, Any]) -> Intrinsics | None:
    matrix = _first(plain, "cameramatrix", "k", "intrinsicmatrix", "m")
    if matrix is None:
        return None
    width, height = _first(plain, "imagewidth", "width"), _first(plain, "imageheight", "height")
    if width is None and (size := _first(plain, "imagesize", "resolution")) is not None:
        width, height = np.ravel(size).tolist()
    dist = _first(plain, "distortioncoefficients", "distcoeffs", "distcoeff", "dist", "d", "distortion")
    size = None if width is None or height is None else (int(width), int(height))
    return Intrinsics.of(matrix, () if dist is None else dist, size, str(_first(plain, "distortionmodel") or ""), "camera_matrix")


def _mount_in(plain: Mapping[str, Any]) -> Array | None:
    """T_flange_camera (4, 4) of a hand-eye calibration: R and t, a transformation with a quaternion, or a matrix; None without one."""
    R, t = (_first(plain, *names) for names in (("rcam2gripper", "rotationmatrix", "r"), ("tcam2gripper", "translationvector", "t")))
    if R is not None and t is not None:
        R, t = _numbers(R, "R"), _numbers(t, "t")
        return np.block([[R.reshape(3, 3), t.reshape(3, 1)], [np.zeros((1, 3)), 1.0]]) if (R.size, t.size) == (9, 3) else None
    named = _first(plain, "transformation", "transform", "handeye", "mount", "tcam2gripper", "tgrippercamera", "tflangecamera")
    named = plain if named is None else named
    if not isinstance(named, Mapping) or "data" in named:
        T = _numbers(named, "mount")
        return T.reshape(4, 4) if T.size == 16 else None
    place, turn = named.get("translation", named), named.get("rotation", named)
    before = "q" if turn is named else ""  # easy_handeye has all seven numbers in one block
    if not all(isinstance(part, Mapping) for part in (place, turn)):
        return None
    p, q = [place.get(name) for name in "xyz"], [turn.get(before + name) for name in "wxyz"]
    if None in p or None in q:
        return None
    unit = _numbers(q, "rotation")
    return pose_from(_numbers(p, "translation"), unit / np.linalg.norm(unit))


def read_intrinsics(file: str) -> Intrinsics:
    """The intrinsics in a calibration file; ParameterError where it has none."""
    found = _intrinsics_in(_plain(file))
    if found is None:
        raise ParameterError.unreadable("", "it has no camera matrix", WORKS, file)
    return found


MOUNTS = "a transformation of x, y, z, qx, qy, qz, qw (easy_handeye), a matrix (4, 4), or R_cam2gripper and t_cam2gripper"


def read_mount(file: str) -> dict[str, Any]:
    """The block of the mount, the camera's pose in the flange's frame, in a hand-eye calibration's file; ParameterError if none."""
    found = _mount_in(_plain(file))
    if found is None:
        raise ParameterError.unreadable("", "it has no pose of the camera", MOUNTS, file)
    return pose_block(found)


def read_calibration(file: str) -> dict[str, Any]:
    """The block `calibration` of a file that has intrinsics, a mount, or both; ParameterError where it has neither."""
    plain = _plain(file)
    intrinsics, T = _intrinsics_in(plain), _mount_in(plain)
    if intrinsics is None and T is None:
        raise ParameterError.unreadable("", "it has neither a camera matrix nor a pose of the camera", "a calibration's file", file)
    found: dict[str, Any] = {} if intrinsics is None else {"intrinsics": intrinsics}
    return found if T is None else {**found, "mount": pose_block(T)}


# Writing.
def as_ros(camera: Camera) -> tuple[Array, Model, Sequence[float]] | None:
    """Camera matrix K (3, 3), model and coefficients of a camera's lens, as ROS has them; None of a lens without a standard model."""
    lens = getattr(camera, "kind", "")
    if lens not in LENSES:
        return None
    k: tuple[float, ...] = camera.lens_coefficients  # type: ignore[attr-defined] - both lenses have them
    (fx, fy), (cx, cy) = np.broadcast_to(camera.focal, 2), camera.centre
    model: Model = "equidistant" if lens == "fisheye" else "rational_polynomial" if len(k) == 8 else "plumb_bob"
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), model, k or (0.0,) * 5


def write_calibration(path: Path, camera: Camera | None, T_flange_camera: Array | None, comment: str = "", name: str = "camera") -> None:
    """Write intrinsics and a hand-eye calibration as one `camera_info` file of ROS, whose readers pass over `transformation`."""
    plain: dict[str, Any] = {}
    if camera is not None and (lens := as_ros(camera)) is not None:
        K, model, k = lens
        P = np.column_stack([K, np.zeros(3)])
        plain = {"image_width": camera.width, "image_height": camera.height, "camera_name": name}
        plain |= {"camera_matrix": _matrix(K), "distortion_model": model, "distortion_coefficients": _matrix(np.array([k]))}
        plain |= {"rectification_matrix": _matrix(np.eye(3)), "projection_matrix": _matrix(P)}
    if T_flange_camera is not None:
        w, x, y, z = (float(q) for q in quaternion_wxyz(T_flange_camera[:3, :3]))
        place = dict(zip("xyz", T_flange_camera[:3, 3].tolist(), strict=True))
        plain["transformation"] = {**place, "qx": x, "qy": y, "qz": z, "qw": w}
    notes = "".join(f"# {line}\n" for line in comment.splitlines())
    write_whole(path, notes + yaml.safe_dump(plain, sort_keys=False, default_flow_style=None, width=120))


def _matrix(a: Array) -> dict[str, Any]:
    return {"rows": a.shape[0], "cols": a.shape[1], "data": a.ravel().tolist()}
