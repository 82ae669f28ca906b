"""The camera model shared by every lens: image size, rate, latency, mount, rendering; its pictures,
and errors of its calibration.
"""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray
from pydantic import model_validator
from pydantic_core import ArgsKwargs

from vstestbed.camera.intrinsics import Intrinsics, read_intrinsics, read_mount
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, DepthImage, Image, Pose, lengths, unit_of
from vstestbed.core.quantity import Frequency, Pixel, PositiveGain, TighterBounds, Time
from vstestbed.core.spec import FromFile, spec
from vstestbed.imaging.chain import Imaging
from vstestbed.imaging.depth import DEPTH_SENSORS, DepthSensor
from vstestbed.imaging.exposure import ExposureControl, ExposureSetting
from vstestbed.imaging.optics import LensEffects, Optics
from vstestbed.imaging.sensor import SensorNoise
from vstestbed.imaging.stream import STREAMS, VideoStream

if TYPE_CHECKING:
    from spatialmath import SE3

Window = tuple[int, int, int, int]  # left, top, right, bottom [px]; right and bottom are exclusive
# of interest: for each panel of a camera its windows; empty for a panel that is not needed
Regions = tuple[tuple[Window, ...], ...]
LARGEST_PX = 8192
MOST_SAMPLES = 1 << 27
"""Largest side of a picture [px], and most samples of a rendered one, of colour and depth in a GB:
what graphics cards draw.
"""
Mount = Annotated[Pose, FromFile(read_mount)]
LensNumbers = Annotated[Intrinsics, FromFile(read_intrinsics)]
# inward unit normals of an image's left, top, right and bottom side
SIDES = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
# least Z of a unit ray that has normalised coordinates X/Z, Y/Z; below it they are dominated by
# rounding
FORWARD_COSINE = 1e-6


@dataclass(frozen=True, slots=True)
class Picture:
    """One exposure of a camera.

    Attributes:
        t: time of the exposure [s]. images: one image for each panel, (H, W, 3) uint8 RGB; None for
            a panel that was not asked for.
        whole: the images are complete; otherwise they may be blank outside of the regions of
            interest.
        draw_whole: draws the whole picture of the same exposure; None where nobody can.
        own: the camera's own image, whole, which no detector works on; None unless it was asked
            for, or where `images` is it.
        depth: what the depth camera measured (H, W) [m], at the middle of the exposure, NaN in its
            holes; None without one.
        exposed: its exposure time and gain, which cameras report; None without `camera.exposure`.
    """

    t: float
    images: tuple[Image | None, ...]
    whole: bool = True
    draw_whole: Callable[[], Picture] | None = field(default=None, compare=False, repr=False)
    own: Image | None = None
    depth: DepthImage | None = None
    exposed: ExposureSetting | None = None

    @property
    def image(self) -> Image | None:
        """The camera's own image if it is complete; None for one of which only parts were drawn, or
        panels, unless it was asked for.
        """
        return self.images[0] if self.whole and len(self.images) == 1 else self.own

    @property
    def empty(self) -> bool:
        """Whether no panel has an image."""
        return all(image is None for image in self.images)

    def completed(self) -> Picture:
        """The whole picture of the same exposure, with the same noise, so that what a detector
        finds does not depend on its windows.
        """
        return self if self.whole or self.draw_whole is None else self.draw_whole()

    def copy(self) -> Picture:
        """The same with copies of the images, which the renderer does not overwrite."""
        depth = None if self.depth is None else self.depth.copy()
        return replace(
            self,
            images=tuple(None if image is None else image.copy() for image in self.images),
            depth=depth,
        )


IMAGING = ("optics", "exposure", "sensor", "stream")  # fields of what changes a rendered picture


@dataclass(frozen=True, slots=True)
class Panel:
    """One image of a camera: its lens, and its orientation in the camera's frame, R_camera_panel
    (3, 3).
    """

    lens: Camera
    R_camera_panel: Array

    def ray(self, uv: Array) -> Array:
        """Unit rays (..., 3) in the camera's frame of its pixels (..., 2)."""
        return self.lens.ray(uv) @ self.R_camera_panel.T

    def project(self, p_camera: Array) -> Array:
        """Its pixels (..., 2) of directions (..., 3) in the camera's frame; NaN where its lens does
        not see one.
        """
        return self.lens.project(p_camera @ self.R_camera_panel)


@spec
class Camera(ABC):
    """A calibrated camera on a robot.

    Args:
        width, height: picture size [px].
        rate_hz: pictures per second.
        latency_s: time from the end of the exposure, with a rolling shutter of the last row's,
            until the law has the picture [s].
        readout_s: time over which a rolling shutter exposes its H rows one after another from the
            top, row v from v/H of it on [s]; 0 is a global shutter. The time stamp is the middle of
            the middle row's exposure, at which a depth sensor's picture is taken, too; e.g. `0.02`.
        mount: pose of the camera in the robot's flange (or body) frame; or the file of a hand-eye
            calibration that has it.
        multisampling: samples per pixel of the rendered picture (0: one sample, cheap, jagged
            marker borders).
        anisotropy: samples of a texture along the longer side of what a pixel covers, at most; 1:
            of what is seen aslant, fine structure is as blurred along both axes as along the longer
            one. Repeated textures, as the floor's, are sampled once.
        shadows: render shadows in the servo camera's picture (it then costs several times as much).
        renderer: `gl` (OpenGL), `rays` (each pixel's ray cast by MuJoCo: no shadows, no textures)
            or `auto` (OpenGL where it works, else rays).
        depth_sensor: makes it an RGB-D camera, which measures the depth of each pixel with each
            picture; only with `perspective`; e.g. `stereo`.
        principal_px: (cx, cy) [px], where the optical axis meets the picture; default its middle
            ((W-1)/2, (H-1)/2); e.g. `[322.5, 238]`.
        optics: vignetting, lateral chromatic aberration and defocus of the lens; None for a perfect
            one.
        exposure: exposure time and gain, fixed or automatic; None for the rendered brightness.
        sensor: noise of the image sensor by EMVA 1288; None for none.
        stream: lossy compression of the pictures (`jpeg`, `h264`); None for none; e.g. `jpeg`.
    """

    width: Annotated[int, Ge(8), Le(LARGEST_PX)] = 640
    height: Annotated[int, Ge(8), Le(LARGEST_PX)] = 480
    rate_hz: Frequency = 25.0
    latency_s: Annotated[Time, TighterBounds(le=60)] = 0.0
    readout_s: Annotated[Time, TighterBounds(le=60)] = 0.0
    mount: Mount = Pose()
    multisampling: Literal[0, 2, 4, 8, 16] = 0
    anisotropy: Literal[1, 2, 4, 8, 16] = 1
    shadows: bool = False
    renderer: Literal["auto", "gl", "rays"] = "auto"
    principal_px: Pixel | None = None
    depth_sensor: Annotated[DepthSensor, DEPTH_SENSORS] | None = None
    optics: Optics | None = None
    exposure: ExposureControl | None = None
    sensor: SensorNoise | None = None
    stream: Annotated[VideoStream, STREAMS] | None = None
    # whether each pixel of its picture has a ray: a wide lens has an image circle
    sees_all: ClassVar[bool] = False
    # whether it may have a depth sensor: depth cameras have perspective lenses
    with_depth: ClassVar[bool] = False

    @model_validator(mode="before")
    @classmethod
    def _of_their_size(cls, given: Any) -> Any:
        """Of intrinsics that tell the size of their pictures, the camera's, unless it is given."""
        values: Any = given.kwargs if isinstance(given, ArgsKwargs) else given
        intrinsics = values.get("intrinsics") if isinstance(values, Mapping) else None
        if isinstance(intrinsics, str):
            with contextlib.suppress(ParameterError):  # which the field itself tells
                intrinsics = read_intrinsics(intrinsics)
        size = getattr(intrinsics, "size", None)
        if isinstance(intrinsics, Mapping):
            size = intrinsics.get("size")
        if not (isinstance(size, list | tuple) and len(size) == 2):
            return given
        sized = {"width": size[0], "height": size[1], **values, "intrinsics": intrinsics}
        return ArgsKwargs((), sized) if isinstance(given, ArgsKwargs) else sized

    def __post_init__(self) -> None:
        size = f"{self.width} x {self.height}"
        if self.width * self.height * self.multisampling > MOST_SAMPLES:
            most = MOST_SAMPLES // (self.width * self.height)
            words = f"{most} for a {size} picture, whose samples would not fit into the memory"
            raise ParameterError.bound("multisampling", "at most", words, self.multisampling)
        if self.principal_px is not None and not self.inside(np.array(self.principal_px)):
            limit = f"the {size} picture"
            raise ParameterError.bound("principal_px", "within", limit, self.principal_px)
        if self.depth_sensor is not None:
            self._check_depth_sensor(self.depth_sensor, size)
        if self.imaged:
            self._check_imaging()

    def _check_depth_sensor(self, sensor: DepthSensor, size: str) -> None:
        if not self.with_depth:
            words = (
                "camera perspective, with distortion or without: depth cameras have no wide lenses"
            )
            raise ParameterError.only_for("depth_sensor", words)
        lens = sensor.lens
        if lens is not None and (lens.width < self.width or lens.height < self.height):
            found = [lens.width, lens.height]
            raise ParameterError.bound("depth_sensor.lens", "at least", f"{size} px", found)

    def _check_imaging(self) -> None:
        """Refuse what its lens, or its rate, cannot have of optics, exposure, sensor and stream."""
        if len(self.panels) > 1:
            given = [name for name in IMAGING if getattr(self, name) is not None]
            words = (
                "is of a camera with one picture,"
                f" and {getattr(self, 'kind', 'this lens')} has several;"
                " works: perspective, fisheye or catadioptric"
            )
            raise ParameterError(given[0], words)
        if self.optics is not None:
            self.optics.check(self.with_depth, getattr(self, "focal_length_m", None))
        if self.exposure is not None and self.exposure.auto is not None:
            self.exposure.auto.check(self.period)
        if self.stream is not None:
            self.stream.check(self.width, self.height)

    @property
    def blurring(self) -> ExposureControl | None:
        """The exposure whose time is that of the motion blur; None where `timing` has it."""
        return self.exposure if self.exposure is not None and self.exposure.blurs else None

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the log of such an exposure."""
        return () if self.blurring is None else ("exposure_s", "gain")

    @property
    def imaged(self) -> bool:
        """Whether lens, exposure, sensor or stream change its pictures, which are then always taken
        whole.
        """
        return any(getattr(self, name) is not None for name in IMAGING)

    def imaging(self, rng: np.random.Generator | None) -> Imaging | None:
        """What lens, exposure, sensor and stream make of the pictures of one run; None where they
        change nothing. rng: of the noise.
        """
        if not self.imaged:
            return None
        lens = None
        if self.optics is not None:
            size = self.width, self.height
            focal = getattr(self, "f", 0.0), getattr(self, "focal_length_m", None)
            lens = LensEffects(self.optics, size, self.centre, self.ray, *focal)
        return Imaging(self, lens, rng or np.random.default_rng(0))

    @property
    def period(self) -> float:
        """Time between pictures [s]."""
        return 1.0 / self.rate_hz

    def row_delay(self, v: Array) -> Array:
        """How long after the picture's time stamp the rows v (...) [px] of its own image are
        exposed, (v - (H - 1)/2) readout_s / H [s].

        Reference: Meingast, Geyer & Sastry 2005, Geometric models of rolling-shutter cameras,
            arXiv:cs/0503076.
        """
        return (v - (self.height - 1) / 2) * (self.readout_s / self.height)

    def miscalibrated(
        self, focal_error: float, principal_px: tuple[float, float], ignores_distortion: bool
    ) -> Camera:
        """The same camera with f (1 + focal_error), another principal point, no distortion;
        ParameterError where the lens has none such.
        """
        raise ParameterError(
            "calibration", "may have no lens errors with this camera; mount_error it may"
        )

    def with_intrinsics(self, intrinsics: Intrinsics) -> Camera:
        """The same camera with other intrinsics; ParameterError where its lens has none."""
        words = (
            "are of a perspective or a fisheye lens,"
            f" and this camera is {getattr(self, 'kind', 'another')}"
        )
        raise ParameterError("calibration.intrinsics", words)

    @cached_property
    def focal(self) -> float | Array:
        """Focal length [px], the lens's `f`; of pixels that are no squares (fx, fy), shape (2,)."""
        fx, fy = lens.focal_px if (lens := getattr(self, "intrinsics", None)) else (0.0, 0.0)
        return float(getattr(self, "f")) if fx == fy else np.array([fx, fy])  # noqa: B009 - all lenses have it, this class has none

    @cached_property
    def resampled(self) -> bool:
        """Whether the rendered image is interpolated from pinhole images, so that pixels at an edge
        mix colours.
        """
        return True

    @cached_property
    def panels(self) -> tuple[Panel, ...]:
        """The images in which markers are detected: the camera's own, unless its field of view
        needs several.
        """
        return (Panel(self, np.eye(3)),)

    @cached_property
    def centre(self) -> Array:
        """Principal point (cx, cy) [px], shape (2,)."""
        if lens := getattr(self, "intrinsics", None):
            return np.array(lens.principal_px)
        if self.principal_px is not None:
            return np.array(self.principal_px, dtype=float)
        return np.array([(self.width - 1) / 2, (self.height - 1) / 2])

    @abstractmethod
    def project(self, p_camera: Array) -> Array:
        """Pixels uv (..., N, 2) of points p_camera (..., N, 3) [m]; NaN where the lens cannot see
        that direction.
        """

    @abstractmethod
    def ray(self, uv: Array) -> Array:
        """Unit rays (..., N, 3) in the camera frame of pixels uv (..., N, 2): the inverse of
        `project`, NaN where there is none.
        """

    def normalise(self, uv: Array) -> Array:
        """Normalised coordinates xy (..., N, 2) = (X/Z, Y/Z) of pixels uv (..., N, 2); NaN for rays
        sideways and back.
        """
        ray = self.ray(uv)
        z = ray[..., 2:]
        return ray[..., :2] / np.where(z > FORWARD_COSINE, z, np.nan)

    def inside(self, uv: Array, margin: float = 0.0) -> NDArray[np.bool_]:
        """Whether pixels uv (..., N, 2) lie in the picture, at least `margin` px from its border;
        NaN does not.
        """
        high = np.array([self.width, self.height]) - 0.5 - margin
        with np.errstate(invalid="ignore"):
            return np.all((uv >= -0.5 + margin) & (uv <= high), axis=-1)

    def borders(self, uv: Array) -> tuple[Array, Array]:
        """Distances of pixels uv (N, 2) from each border of the image (N, B) [px], here its four
        sides, and inward normals (N, B, 2).
        """
        high = np.array([self.width, self.height]) - 0.5
        return np.concatenate([uv + 0.5, high - uv], axis=1), np.broadcast_to(
            SIDES, (len(uv), 4, 2)
        )

    def whole(self, p_camera: Array, radius: float, margin: float = 0.0) -> NDArray[np.bool_]:
        """Whether markers of a radius [m] at p_camera (N, 3) lie wholly in the image, `margin` px
        from its border, shape (N,).

        The lens must see both ends of its extent (`half_size`). In a camera with panels a marker is
        whole if it is so in one of them.
        """
        if len(self.panels) > 1:
            return np.any(
                [p.lens.whole(p_camera @ p.R_camera_panel, radius, margin) for p in self.panels],
                axis=0,
            )
        uv = self.project(p_camera)
        a, b = (radius * direction for direction in self.across(p_camera))
        opposite = self.project(p_camera - a) + self.project(p_camera - b)
        size = np.array([self.width, self.height])
        with np.errstate(invalid="ignore"):
            clear = np.minimum(uv + 0.5, size - 0.5 - uv) - margin >= self.half_size(
                p_camera, radius
            )
            return np.all(clear & np.isfinite(opposite), axis=-1)

    def half_size(self, p_camera: Array, radius: float) -> Array:
        """Apparent half width and half height (N, 2) [px] of markers of a radius [m] at p_camera
        (N, 3); NaN where it cannot be seen.

        The roots of the summed squared displacements in u, and in v, by one radius along the two
        directions of `across`.
        """
        uv = self.project(p_camera)
        a, b = (radius * direction for direction in self.across(p_camera))
        return np.hypot(self.project(p_camera + a) - uv, self.project(p_camera + b) - uv)

    def across(self, p_camera: Array) -> tuple[Array, Array]:
        """For each point (N, 3) two unit vectors across its ray, each (N, 3) or (3,): a marker's
        extent (Duff et al. 2017, JCGT 6(1)).
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            x, y, z = (p_camera / np.linalg.norm(p_camera, axis=-1, keepdims=True)).T
        sign = np.copysign(1.0, z)
        a = -1 / (sign + z)
        first = np.stack([1 + sign * x * x * a, sign * x * y * a, -sign * x], axis=-1)
        return first, np.stack([x * y * a, sign + y * y * a, -y], axis=-1)


@spec
class Calibration:
    """Errors of the calibration that robot, detector, observer and law work with; the simulator's
    camera is the true one.

    believed mount = true mount * mount_error,  believed f = true f * (1 + focal_error),
    believed principal point = true one + principal_error_px.

    The file of a calibration may stand for the block: what it says is believed, intrinsics, mount
    or both.

    Args:
        intrinsics: believed in place of the true ones; a block, or a calibration's file; the errors
            below are of them.
        mount: believed pose of the camera in the flange's frame, in place of the true one; or the
            file of a hand-eye calibration.
        mount_error: pose of the believed camera in the true one's frame [m, deg].
        focal_error: relative error of the focal length [1]; e.g. `0.02`.
        principal_error_px: error of the principal point (u, v) [px]; e.g. `[3, -2]`.
        ignores_distortion: the distortion is not modelled: a perspective lens is taken for a
            pinhole, a fisheye for equidistant.
        depth_factor, depth_spread: error of every depth Z_i (and range) given to the law, whatever
            its source, and of the distance in an estimated pose: Z_i * factor * exp(spread n_i),
            with one normal number n_i for each marker and run [1].
        goal: how the goal view was given. `told`: as a pose in numbers; the law converges where the
            true camera sees the reference pixels of the believed one, off by the calibration's
            error. `shown`: the true camera took the picture at the goal; pose and depth there are
            estimated from it with the believed calibration, so that the errors at the goal cancel.

    Reference: Chaumette & Hutchinson 2006, doi:10.1109/MRA.2006.250573, and Malis & Rives 2003,
    doi:10.1109/ROBOT.2003.1241749.
    """

    intrinsics: LensNumbers | None = None
    mount: Mount | None = None
    mount_error: Pose = Pose()
    focal_error: Annotated[float, Gt(-0.9), Lt(9)] = 0.0
    principal_error_px: Pixel = (0.0, 0.0)
    ignores_distortion: bool = False
    depth_factor: Annotated[PositiveGain, TighterBounds(le=100)] = 1.0
    depth_spread: Annotated[float, Ge(0), Le(3)] = 0.0
    goal: Literal["told", "shown"] = "told"

    @cached_property
    def lens_exact(self) -> bool:
        """Whether the believed intrinsics are the true ones."""
        return self.intrinsics is None and not (
            self.focal_error or any(self.principal_error_px) or self.ignores_distortion
        )

    @cached_property
    def camera_exact(self) -> bool:
        """Whether the believed intrinsics and mount are the true ones."""
        return self.lens_exact and self.mount is None and self.mount_error == Pose()

    @cached_property
    def depth_exact(self) -> bool:
        """Whether depths have no error."""
        return self.depth_factor == 1 and self.depth_spread == 0

    @property
    def draws(self) -> bool:
        """Whether a seed makes a difference: errors of the depths are drawn."""
        return self.depth_spread > 0

    def depth_scale(self, markers: int, rng: np.random.Generator) -> Array | None:
        """Factor on each marker's depth in one run, shape (markers,); None where depths have no
        error.
        """
        if self.depth_exact:
            return None
        return self.depth_factor * np.exp(self.depth_spread * rng.standard_normal(markers))

    def believed(self, camera: Camera) -> Camera:
        """The camera as robot, detector, observer and law know it; ParameterError where the lens is
        impossible with this error.
        """
        if self.camera_exact:
            return camera
        mount = Pose.of((self.mount or camera.mount).T @ self.mount_error.T)
        if self.intrinsics is not None:
            camera = camera.with_intrinsics(self.intrinsics)
        if not (self.focal_error or any(self.principal_error_px) or self.ignores_distortion):
            return replace(camera, mount=mount)
        cx, cy = (camera.centre + self.principal_error_px).tolist()
        return replace(
            camera.miscalibrated(self.focal_error, (cx, cy), self.ignores_distortion), mount=mount
        )

    @classmethod
    def of(
        cls,
        camera_matrix: Any = None,
        dist: Any = (),
        mount: Array | SE3 | Pose | None = None,
        model: str = "",
    ) -> Calibration:
        """What a calibration found: the camera matrix K (3, 3) with OpenCV's distortion
        coefficients, and the pose of the camera in the flange's frame, T_flange_camera (4, 4) or an
        SE3; each may be left out. model: of the distortion, as ROS names it.
        Raises ParameterError: a matrix that is none, a skew, coefficients of another model.
        """
        lens = None
        if camera_matrix is not None:
            lens = Intrinsics.of(camera_matrix, dist, model=model, name="camera_matrix")
        return cls(intrinsics=lens, mount=mount)  # type: ignore[arg-type] - a Pose is also made of a matrix


STEP = 1e-6  # of the finite differences by which a lens is differentiated [unit, rad]


def pixel_interaction(camera: Camera, p: Array) -> Array:
    """L (N, 2, 6) of the pixels of points p (N, 3) [m] in any lens, uv_dot = L v, by central
    differences along p_dot = -v - w x p.
    """
    unit = unit_of(float(np.fmin.reduce(lengths(p), axis=None, initial=np.inf)))
    p = p / unit
    flow = np.concatenate(
        [np.broadcast_to(-np.eye(3)[:, None], (3, len(p), 3)), -np.cross(np.eye(3)[:, None], p)]
    )
    L = (camera.project(p + STEP * flow) - camera.project(p - STEP * flow)) / (2 * STEP)
    L[:3] /= unit
    # NaN: at the rim of the field of view, where a step leaves it
    return np.nan_to_num(np.moveaxis(L, 0, -1))
