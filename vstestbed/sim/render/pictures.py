"""Who draws the pictures: OpenGL, or rays where it does not work."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol, TypeVar

import numpy as np

from vstestbed.camera import Camera, Image
from vstestbed.core.errors import EnvironmentLackError
from vstestbed.core.geometry import Array
from vstestbed.sim.base import Eyes
from vstestbed.sim.render import gl_probe as gl

if TYPE_CHECKING:
    from vstestbed.sim.scene.stage import Stage

T = TypeVar("T")
FILM_RAYS = 4
"""Rays that a pixel of the outside view gets where a thing ends, two each way."""


class Outside(Protocol):
    """A picture of the scene from outside."""

    def picture(self) -> Image:
        """The picture now, (H, W, 3) uint8 RGB, its own for good."""
        ...


def eye_of(stage: Stage, camera: Camera, image_sigma: float = 0.0, rng: np.random.Generator | None = None) -> Eyes:
    """What makes the servo camera's pictures, as `camera.renderer` says.

    Raises:
        EnvironmentLackError: OpenGL is asked for, or the picture needs it, and it does not work here.
        ParameterError: rays are asked for, and cannot draw this.
    """

    def by_gl() -> Eyes:
        from vstestbed.sim.render.opengl import Eye

        return Eye(stage, camera, image_sigma, rng)

    def by_rays() -> Eyes:
        from vstestbed.sim.render.rays import RayEye

        return RayEye(stage, camera, image_sigma, rng)

    return _chosen(camera, by_gl, by_rays)


def view_of(stage: Stage, name: str, width: int, height: int, camera: Camera, shadows: bool = True) -> Outside:
    """What makes the pictures of one of the scene's cameras, as the servo camera's `renderer` says; rays draw no shadows.

    Raises:
        EnvironmentLackError: OpenGL is asked for, and does not work here.
    """

    def by_gl() -> Outside:
        from vstestbed.sim.render.opengl import View

        return View(stage, name, width, height, shadows, style="outside")

    def by_rays() -> Outside:
        from vstestbed.sim.render.rays import RayView

        return RayView(stage, name, width, height, FILM_RAYS)

    return _chosen(camera, by_gl, by_rays)


def bare_of(stage: Stage, camera: Camera) -> Callable[[Array], object]:
    """The least that a picture of the servo camera costs, given the markers (N, 3) in its frame.

    What OpenGL draws before the lens and the noise, of several faces of a cube only those with a marker; or all rays.
    """

    def by_gl() -> Callable[[Array], object]:
        from vstestbed.sim.lens.cube import drawn_for
        from vstestbed.sim.render.opengl import View

        drawn = drawn_for(camera)
        views = [View(stage, face.name, face.width, face.height, camera.shadows, "own") for face in drawn]
        return lambda p: [v.raw() for v, face in zip(views, drawn, strict=True) if len(drawn) == 1 or face.holds(p)]

    def by_rays() -> Callable[[Array], object]:
        from vstestbed.sim.render.rays import RayEye

        eye = RayEye(stage, camera)
        return lambda p: eye.glimpse()

    return _chosen(camera, by_gl, by_rays)


def _chosen(camera: Camera, by_gl: Callable[[], T], by_rays: Callable[[], T]) -> T:
    if camera.renderer == "rays":
        return by_rays()
    try:
        gl.require()
        return by_gl()
    except (EnvironmentLackError, ImportError) as error:
        lack = gl.explain(error) if isinstance(error, ImportError) else error
        if camera.renderer == "gl" or lack is None:
            raise
    try:
        made = by_rays()
    except EnvironmentLackError as refused:  # what rays cannot draw, and why it is left to them
        raise EnvironmentLackError(f"{refused.lack} ({lack.lack})", lack.remedy) from None
    _say(lack.lack)
    return made


@functools.cache
def _say(lack: str) -> None:
    """Tell once that rays are used, on standard error (where nobody has set up logging otherwise)."""
    logging.getLogger("vstestbed").warning("%s; rays draw the pictures instead, films without shadows", lack)
