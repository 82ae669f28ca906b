"""Choice of the renderer: OpenGL, or ray casting where OpenGL does not work."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from vstestbed.camera import Camera
from vstestbed.core.errors import EnvironmentLackError
from vstestbed.core.geometry import Array
from vstestbed.sim import gl_probe as gl
from vstestbed.sim.base import Renderer
from vstestbed.sim.render.cube_map import drawn_for

if TYPE_CHECKING:
    from vstestbed.sim.render.opengl import SceneCamera
    from vstestbed.sim.render.rays import RaySceneCamera
    from vstestbed.sim.scene.scene import Scene

__all__ = ["bare_renderer", "drawn_together", "draws_rays", "outside_view", "servo_renderer"]

T = TypeVar("T")


class DrawsTogether(Protocol):
    """Draws a run's pictures together with those of others."""

    def renderer(
        self, stage: Scene, camera: Camera, noisy: bool, share: float, eye: str
    ) -> Renderer:
        """The renderer of a run's camera; arguments as of `servo_renderer`."""
        ...


drawn_together: ContextVar[DrawsTogether | None] = ContextVar("drawn_together", default=None)
"""Of a run that flies with others, in its own context: what draws its pictures, whatever
`camera.renderer` says.
"""
FILM_RAYS = 4  # rays for each pixel of the outside view at the edge of an object, two each way


def servo_renderer(
    stage: Scene, camera: Camera, noisy: bool = False, share: float = 1.0, eye: str = "eye"
) -> Renderer:
    """The renderer of the servo camera, or of a further camera `eye`, as `camera.renderer` asks.

    noisy: noise will be added to its images. share: size of the images as a share of the camera's,
    for films; OpenGL draws those of wide and distorted lenses in full. Raises EnvironmentLackError:
    OpenGL is asked for, or the image needs it, and it does not work here.
    ParameterError: rays are asked for and cannot draw this scene.
    """
    given = stage, camera, noisy, share, eye
    if together := drawn_together.get():
        return together.renderer(*given)
    return _chosen(
        camera, lambda: _opengl().OpenGLRenderer(*given), lambda: _rays().RayRenderer(*given)
    )


def outside_view(
    stage: Scene, name: str, width: int, height: int, camera: Camera, shadows: bool = True
) -> SceneCamera | RaySceneCamera:
    """One of the scene's cameras, rendered as the servo camera's `renderer` asks; rays draw no
    shadows. Raises as `servo_renderer`.
    """

    def by_rays() -> RaySceneCamera:
        return _rays().RaySceneCamera(stage, name, width, height, FILM_RAYS)

    if drawn_together.get():  # OpenGL in a process with Warp has been seen to crash
        return by_rays()
    return _chosen(
        camera,
        lambda: _opengl().SceneCamera(stage, name, width, height, shadows, style="outside"),
        by_rays,
    )


def bare_renderer(stage: Scene, camera: Camera) -> Callable[[Array], object]:
    """The cheapest rendering of the servo camera, as a function of the markers (N, 3) [m] in its
    frame; for speed baselines.

    With OpenGL that is what MuJoCo draws before the lens and the noise, of several faces of a cube
    only those with a marker; with rays it is the whole image.
    """

    def by_gl() -> Callable[[Array], object]:
        drawn = drawn_for(camera)
        views = [
            _opengl().SceneCamera(stage, face.name, face.width, face.height, camera.shadows, "bare")
            for face in drawn
        ]
        if len(views) == 1:
            return lambda p: views[0].raw()
        return lambda p: [
            view.raw() for view, face in zip(views, drawn, strict=True) if face.holds(p)
        ]

    def by_rays() -> Callable[[Array], object]:
        renderer = _rays().RayRenderer(stage, camera)
        return lambda p: renderer.images()

    return _chosen(camera, by_gl, by_rays)


# Imported only when called: importing OpenGL fails on a machine without it.
def _opengl() -> Any:
    from vstestbed.sim.render import opengl

    return opengl


def _rays() -> Any:
    from vstestbed.sim.render import rays

    return rays


def draws_rays(camera: Camera) -> bool:
    """Whether `camera.renderer` and this machine make it rays that draw."""
    try:
        gl.require()
    except EnvironmentLackError:
        return camera.renderer != "gl"
    return camera.renderer == "rays"


def _chosen(camera: Camera, by_gl: Callable[[], T], by_rays: Callable[[], T]) -> T:
    """What `camera.renderer` asks for; with `auto`, rays where OpenGL does not work, with a
    warning.
    """
    if camera.renderer == "rays":
        return by_rays()
    try:
        gl.require()
        return by_gl()
    except (EnvironmentLackError, ImportError) as error:
        told = gl.explain(error) if isinstance(error, ImportError) else error
        if camera.renderer == "gl" or told is None:
            raise
        lack = told.lack
        remedy = told.remedy
        del told  # its traceback has this frame, and with it the scene: a cycle
    try:
        made = by_rays()
    except EnvironmentLackError as refused:
        # what rays cannot draw, and why OpenGL could not draw it
        raise EnvironmentLackError(f"{refused.lack} ({lack})", remedy) from None
    _warn_once(lack, remedy)
    return made


@functools.cache
def _warn_once(lack: str, remedy: str) -> None:
    """Warn once for each reason that rays are used: on standard error, unless the application has
    configured logging.
    """
    logging.getLogger("vstestbed").warning("%s; %s; %s", lack, gl.RAYS_INSTEAD, remedy)
