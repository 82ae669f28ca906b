"""A view of a scene that is drawn again only where something in it, or its lamp, has moved by a
visible part of a pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Window
from vstestbed.core.geometry import Array, lengths
from vstestbed.sim.scene.meshes import CORNERS
from vstestbed.sim.scene.world import LAMP

UNSEEN_PX = 0.5  # motion in the image below which the last image is shown again [px]
# Motion of the camera or of a geom below which it counts as at rest when only a part is drawn again
# [px]
SLIGHT_PX = 0.05
NEAR_M = 0.1  # least distance that is assumed between a view and what it shows [m]
FLOOR_M = 0.5  # the same for planes, which have no bounding sphere [m]
ASIDE = 1.02  # margin of the tangents beyond which a geom is out of sight


class StillView:
    """A view that is drawn again only if something has moved by UNSEEN_PX since it was drawn last,
    and only there if the camera rests.

    A point of a geom at p in the camera's frame, with a bounding sphere of radius r, has moved by
    at most |dp| + r dphi for a turn by dphi, and its image by f times that over its distance |p| -
    r.

    Args:
        view: draws the whole image. data: of the scene. camera: the view's camera by its name in
            the scene. f: pixels per radian.
        part: draws a perspective image within a window alone, or returns None where it cannot.
        sides: tangents of half the angles of view (see `half_tangents`). What is beyond them,
            before and now, may move unseen: most of an arm that carries the camera. None where
            everything counts.
    """

    def __init__(
        self,
        view: Callable[[], Image],
        data: mujoco.MjData,
        camera: str,
        f: float,
        part: Callable[[Window], Image | None] = lambda window: None,
        sides: tuple[float, float] | None = None,
    ):
        model = data.model
        self._view = view
        self._model = model
        self._data = data
        self._f = f
        self._part = part
        self._camera = model.camera(camera).id
        self._sides = sides
        self._corners = model.geom_aabb[:, None, :3] + model.geom_aabb[:, None, 3:] * CORNERS
        lamp = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, LAMP)
        self._lamps = np.flatnonzero(model.light_bodyid == lamp)
        self._lit = b""
        self._drawn: tuple[NDArray[Any], ...] = ()
        self._image: Image | None = None

    def full_image(self) -> Image:
        """The image now, shape (H, W, 3) uint8 RGB, as a copy that the caller may keep."""
        state = self._state()
        # where a lamp has moved, light and shadows differ everywhere
        lit = np.stack([self._data.light_xpos, self._data.light_xdir])[:, self._lamps].tobytes()
        if lit != self._lit or self._image is None:
            self._image = self._view()
            self._drawn = state
            self._lit = lit
            return self._image.copy()
        of_geoms, of_camera = self._motion(state)
        seen = max(of_geoms.max(), of_camera) > UNSEEN_PX
        if seen and (
            of_camera > SLIGHT_PX
            or not self._renewed(self._image, state, np.flatnonzero(of_geoms > SLIGHT_PX))
        ):
            self._image = self._view()
            self._drawn = state
        return self._image.copy()

    def _renewed(
        self, image: Image, state: tuple[NDArray[Any], ...], moved: NDArray[np.intp]
    ) -> bool:
        """Draw an image again, in place, where the geoms that have moved are and were; False where
        that is not possible.
        """
        window = self._window(
            np.concatenate([state[0][moved], self._drawn[0][moved]]),
            np.tile(self._model.geom_rbound[moved], 2),
        )
        part = None if window is None else self._part(window)
        if window is None or part is None:
            return False
        left, top, right, bottom = window
        image[top:bottom, left:right] = part[top:bottom, left:right]
        for drawn, now in zip(self._drawn[:3], state, strict=False):
            drawn[moved] = now[moved]
        return True

    def _window(self, p: Array, radius: Array) -> Window | None:
        """The part of the image that holds spheres at p (N, 3) in the camera's frame (x right, y
        up, z backwards).
        """
        assert self._image is not None
        near = -p[:, 2] - radius
        far = radius - p[:, 2]
        if near.min() < NEAR_M:
            return None
        size = np.array(self._image.shape[1::-1])
        across = p[:, :2] * [1, -1]
        low = (across - radius[:, None]).T
        high = (across + radius[:, None]).T
        first = size / 2 + self._f * np.minimum(low / near, low / far).min(axis=1) - 1
        last = size / 2 + self._f * np.maximum(high / near, high / far).max(axis=1) + 2
        left, top, right, bottom = np.clip([first, last], 0, size).astype(int).ravel().tolist()
        return (left, top, right, bottom) if left < right and top < bottom else None

    def _state(self) -> tuple[NDArray[Any], ...]:
        """Places (G, 3), axes (G, 3, 3) and sight (G,) of the geoms in the camera's frame; the
        camera's place (3,) and axes (3, 3).
        """
        data = self._data
        i = self._camera
        place = data.cam_xpos[i].copy()
        axes = data.cam_xmat[i].reshape(3, 3).copy()
        p = (data.geom_xpos - place) @ axes
        Q = axes.T @ data.geom_xmat.reshape(-1, 3, 3)
        return p, Q, self._in_sight(p, Q), place, axes

    def _in_sight(self, p: Array, Q: Array) -> NDArray[np.bool_]:
        """Whether geoms (G,) may be in the image: their boxes are not all beyond one side of it,
        nor behind the camera.
        """
        if self._sides is None:
            return np.ones(len(p), bool)
        x, y, z = np.moveaxis(p[:, None] + self._corners @ Q.transpose(0, 2, 1), -1, 0)
        wide, high = (-tangent * z for tangent in self._sides)
        return ~np.logical_or.reduce(
            [(beyond > 0).all(axis=1) for beyond in (z, x - wide, -x - wide, y - high, -y - high)]
        )

    def _motion(self, state: tuple[NDArray[Any], ...]) -> tuple[Array, float]:
        """Bounds of the motion in the image since it was drawn: of each geom (G,), and of planes as
        the camera moves [px].
        """
        p, Q, seen, c, R = state
        p_drawn, Q_drawn, seen_drawn, c_drawn, R_drawn = self._drawn
        radius = self._model.geom_rbound
        moved = lengths(p - p_drawn)[:, 0] + radius * _turn(Q - Q_drawn)
        distance = lengths(p)[:, 0] - radius
        of_geoms = np.where(
            (radius > 0) & (seen | seen_drawn), moved / np.maximum(distance, NEAR_M), 0.0
        )
        of_planes = _turn(R - R_drawn) + lengths(c - c_drawn)[0] / FLOOR_M
        return self._f * of_geoms, self._f * float(of_planes)


def _turn(difference: Array) -> Array:
    """Angle between axes from their difference (..., 3, 3), for small angles: the Frobenius norm is
    sqrt(2) times it [rad].
    """
    return lengths(difference.reshape(*difference.shape[:-2], 9))[..., 0] / np.sqrt(2)


def pixels_per_radian(lens: Camera) -> float:
    """Pixels per radian, from one pixel to the next, that three quarters of a lens's image do not
    exceed.

    Not the most: at the poles of an equirectangular image there is no limit.
    """
    u, v = np.meshgrid(np.linspace(0, lens.width - 2, 9), np.linspace(0, lens.height - 2, 9))
    uv = np.stack([u, v], axis=-1)
    angles = [
        np.linalg.norm(lens.ray(uv + step) - lens.ray(uv), axis=-1) for step in ([1, 0], [0, 1])
    ]
    return 1 / float(np.nanpercentile(angles, 25))


def half_tangents(lens: Camera) -> tuple[float, float] | None:
    """Tangents of the angles from a lens's axis to the sides of its image, with a margin; None if
    it sees sideways.
    """
    u, v = np.meshgrid(
        np.linspace(-0.5, lens.width - 0.5, 9), np.linspace(-0.5, lens.height - 0.5, 9)
    )
    rays = lens.ray(np.stack([u, v], axis=-1))
    with np.errstate(invalid="ignore"):
        if not (rays[..., 2] > 0.1).all():
            return None
    across, upwards = (ASIDE * float(np.abs(rays[..., i] / rays[..., 2]).max()) for i in (0, 1))
    return across, upwards
