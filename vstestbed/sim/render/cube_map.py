"""Images of wide lenses, composed of pinhole images on the faces of a cube (cube map)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Perspective, Window
from vstestbed.camera.wide import CUBE
from vstestbed.core.geometry import Array, pixel_grid
from vstestbed.core.lazy import cv2


@dataclass(frozen=True)
class Pinhole:
    """A rendered pinhole image: size, focal length, principal point [px], the face of the cube that
    it shows, and its camera.
    """

    width: int
    height: int
    f: float
    centre: tuple[float, float]
    face: str = "front"
    eye: str = "eye"

    @property
    def name(self) -> str:
        """The camera's name in the scene: `eye` ahead, `eye_right`, ... elsewhere."""
        return self.eye if self.face == "front" else f"{self.eye}_{self.face}"

    @property
    def R_camera_face(self) -> Array:
        """Its orientation in the camera's frame, (3, 3)."""
        return CUBE[self.face]

    def holds(self, p_camera: Array) -> bool:
        """Whether one of the points (N, 3) lies in the middle part of its face of the cube, |x|,
        |y| <= z in its axes.
        """
        p = p_camera @ self.R_camera_face
        return bool((np.abs(p[:, :2]).max(axis=1) <= p[:, 2]).any())


def covering(px: Array, f: float, face: str = "front") -> Pinhole:
    """The smallest image that holds all of px (..., 2), relative to its principal point [px]."""
    px = px.reshape(-1, 2)
    # One pixel more on each side: bilinear resampling reads the four pixels round a point.
    low = np.floor(px.min(axis=0)) - 1
    high = np.ceil(px.max(axis=0)) + 1
    return Pinhole(
        int(high[0] - low[0]) + 1,
        int(high[1] - low[1]) + 1,
        f,
        (float(-low[0]), float(-low[1])),
        face,
    )


def pinhole_of(camera: Perspective) -> Pinhole:
    """The camera's own image; of a distorted lens, a pinhole image that covers its whole field of
    view.
    """
    if not camera.resampled:
        return Pinhole(
            camera.width,
            camera.height,
            camera.f,
            (float(camera.centre[0]), float(camera.centre[1])),
        )
    grid = pixel_grid(camera.width, camera.height)
    # The border is enough: distortion maps the inside of the image to the inside of its border.
    border = np.concatenate([grid[0], grid[-1], grid[:, 0], grid[:, -1]])
    return covering(camera.normalise(border) * camera.f, camera.f)


def resampling_maps(
    camera: Perspective, pinhole: Pinhole
) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """Maps for cv2.remap: the place in the rendered image of each pixel of the camera; None for an
    undistorted lens.
    """
    if not camera.resampled:
        return None
    grid = pixel_grid(camera.width, camera.height)
    px = camera.normalise(grid.reshape(-1, 2)).reshape(grid.shape) * camera.f + pinhole.centre
    return px[..., 0].astype(np.float32), px[..., 1].astype(np.float32)


# Coordinate of a pixel that a face does not hold [px]: outside, so that cv2.remap leaves it
# unchanged
NOWHERE = -10.0
# Largest focal length of a rendered face [px]; the image of a lens with more pixels per radian is
# blurred
MOST_PX = 2048.0
# A face is also rendered when a window comes this near to it [px]: a marker may appear a little
# outside of its window
SEAM_PX = 24


@dataclass(frozen=True)
class Patch:
    """One face's part of the image: its rows and columns, and their coordinates in the face for
    cv2.remap.
    """

    rows: slice
    columns: slice
    maps: tuple[NDArray[np.int16], NDArray[np.uint16]]

    @cached_property
    def reach(self) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
        """For each of its rows, see `_reach`."""
        return _reach(self.maps[0])


@dataclass(frozen=True)
class Cube:
    """How a camera's own image is composed of rendered faces.

    faces: the faces that the lens can see. patches: the part of each.
    owner: index of the face that each pixel is taken from, shape (H, W); -1 where the lens sees
    nothing.
    """

    faces: tuple[Pinhole, ...]
    patches: tuple[Patch, ...]
    owner: NDArray[np.int8]

    def needed(self, windows: Iterable[Window]) -> set[int]:
        """Indices of the faces that have pixels in windows of the camera's image, or within SEAM_PX
        of one.
        """
        out: set[int] = set()
        for left, top, right, bottom in windows:
            near = left - SEAM_PX, top - SEAM_PX, right + SEAM_PX, bottom + SEAM_PX
            out.update(self.parts(near))
        return out

    def parts(self, window: Window) -> dict[int, Window]:
        """The part of each face that a window of the camera's image is taken from, by index."""
        wide = window[2] - window[0] == self.owner.shape[1]
        out: dict[int, Window] = {}
        for i, (patch, face) in enumerate(zip(self.patches, self.faces, strict=True)):
            some = _within(patch.rows, window[1], window[3])
            columns = _within(patch.columns, window[0], window[2])
            if wide:
                low, high = (ends[some] for ends in patch.reach)
            else:
                low, high = _reach(patch.maps[0][some, columns])
            if len(low) and high.max() >= 0:
                left, top = low.min(axis=0).tolist()
                right, bottom = high.max(axis=0).tolist()
                out[i] = left, top, min(right + 2, face.width), min(bottom + 2, face.height)
        return out

    def compose(self, drawn: dict[int, Image], windows: Iterable[Window] | None = None) -> Image:
        """The camera's image (H, W, 3) from rendered faces, by index; black where a face is missing
        or the lens sees nothing.

        windows: the only ones that are composed, of which the faces need hold no more than their
            `parts`.
        """
        image = np.zeros((*self.owner.shape, 3), np.uint8)
        if windows is None:
            for i, face in drawn.items():
                patch = self.patches[i]
                self._put(image[patch.rows, patch.columns], face, *patch.maps)
            return image
        for window in windows:
            for i, (left, top, right, bottom) in self.parts(window).items():
                patch = self.patches[i]
                part = (
                    _within(patch.rows, window[1], window[3]),
                    _within(patch.columns, window[0], window[2]),
                )
                still = drawn[i][top:bottom, left:right]
                coarse, rest = patch.maps
                moved = coarse[part] - np.array([left, top], np.int16)
                self._put(image[patch.rows, patch.columns][part], still, moved, rest[part])
        return image

    def _put(
        self, into: Image, still: Image, coarse: NDArray[np.int16], rest: NDArray[np.uint16]
    ) -> None:
        cv2.remap(
            still, coarse, rest, cv2.INTER_LINEAR, dst=into, borderMode=cv2.BORDER_TRANSPARENT
        )


@lru_cache(maxsize=4)
def cube_of(camera: Camera) -> Cube:
    """The faces that a lens can see, and how its image is composed of them.

    A pixel is taken from the face that its ray meets in the middle part, |x|, |y| <= 1 in
    normalised coordinates. A lens with panels has them as faces. For any other, a face is as large
    as it is needed, and as fine: a pinhole picture of focal length f has f / cos a pixels to the
    radian across a ray a off its axis, and the lens at most 1 / (angle to the next pixel), so that
    f is the largest of (cos a) / (that angle) over the face's pixels.
    """
    rays = camera.ray(pixel_grid(camera.width, camera.height))
    names = tuple(CUBE)
    seen = np.isfinite(rays[..., 0])
    along = np.stack([rays @ CUBE[name][:, 2] for name in names])
    best = np.where(seen, np.argmax(along, axis=0), -1)
    fine = along.max(axis=0) / _angle_to_next(rays)
    faces: list[Pinhole] = []
    patches: list[Patch] = []
    owner = np.full(best.shape, -1, np.int8)
    for index, name in enumerate(names):
        mine = best == index
        if not mine.any():
            continue
        turned = rays[mine] @ CUBE[name]
        face = _face(camera, index, name, turned, float(min(np.nanmax(fine[mine]), MOST_PX)))
        patches.append(_patch(mine, turned[:, :2] / turned[:, 2:] * face.f + face.centre))
        owner[mine] = len(faces)
        faces.append(face)
    return Cube(tuple(faces), tuple(patches), owner)


def _within(part: slice, first: int, end: int) -> slice:
    """The rows or columns from `first` to before `end` of an image, counted from where its part
    begins.
    """
    return slice(max(first - part.start, 0), max(min(end, part.stop) - part.start, 0))


def _reach(at: NDArray[np.int16]) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    """Least and largest coordinates (h, 2) of each row's places (h, w, 2) in a face; -1 as the
    largest of a row without any.
    """
    there = at[..., :1] >= 0
    low = at.min(axis=1, initial=32767, where=there)
    return low, at.max(axis=1, initial=-1, where=there)


def _patch(mine: NDArray[np.bool_], px: Array) -> Patch:
    """The part of the image that holds the pixels `mine` (H, W), which lie at px (N, 2) in the
    face.
    """
    v, u = np.nonzero(mine)
    rows = slice(int(v.min()), int(v.max()) + 1)
    columns = slice(int(u.min()), int(u.max()) + 1)
    at = np.full((*mine.shape, 2), NOWHERE, np.float32)
    at[mine] = px
    # Fixed-point maps, converted once: remapping with them is faster than with floats.
    coarse, rest = cv2.convertMaps(
        at[rows, columns, 0].copy(), at[rows, columns, 1].copy(), cv2.CV_16SC2
    )
    return Patch(rows, columns, (coarse, rest))


def _face(camera: Camera, index: int, name: str, turned: Array, f: float) -> Pinhole:
    """The face of a lens with panels as the panel says, else one that covers the rays (N, 3) with a
    focal length f [px].
    """
    if len(camera.panels) == 1:
        return covering(turned[:, :2] / turned[:, 2:] * f, f, name)
    lens = camera.panels[index].lens
    middle = lens.project(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]]))
    return Pinhole(
        lens.width,
        lens.height,
        float(middle[1, 0] - middle[0, 0]),
        (float(lens.centre[0]), float(lens.centre[1])),
        name,
    )


def _angle_to_next(rays: Array) -> Array:
    """Angle [rad] from each ray (H, W, 3) to the nearest of those of the next pixels, shape (H, W);
    NaN where none is seen.
    """
    out = np.full(rays.shape[:2], np.inf)
    across = np.linalg.norm(np.diff(rays, axis=1), axis=-1)
    down = np.linalg.norm(np.diff(rays, axis=0), axis=-1)
    for step, here in (
        (across, out[:, :-1]),
        (across, out[:, 1:]),
        (down, out[:-1]),
        (down, out[1:]),
    ):
        np.fmin(here, step, out=here)
    return np.where(np.isfinite(out) & (out > 0), out, np.nan)


def drawn_for(camera: Camera, eye: str = "eye") -> tuple[Pinhole, ...]:
    """The pinhole images to be rendered for a lens, of a camera by its name: its own, or the faces
    that it can see.
    """
    drawn = (pinhole_of(camera),) if isinstance(camera, Perspective) else cube_of(camera).faces
    return drawn if eye == "eye" else tuple(replace(image, eye=eye) for image in drawn)
