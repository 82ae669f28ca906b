"""The six directions in which a camera that sees all around is drawn: how the faces of a cube stand in the camera."""

from __future__ import annotations

import numpy as np

from vstestbed.core.geometry import Array


def _face(x: tuple[int, int, int], y: tuple[int, int, int]) -> Array:
    """R_camera_face (3, 3) from the face's right and down, in camera axes; it looks along right x down."""
    return np.stack([x, y, np.cross(x, y)], axis=1).astype(float)


CUBE: dict[str, Array] = {
    "front": _face((1, 0, 0), (0, 1, 0)),
    "right": _face((0, 0, -1), (0, 1, 0)),
    "back": _face((-1, 0, 0), (0, 1, 0)),
    "left": _face((0, 0, 1), (0, 1, 0)),
    "up": _face((1, 0, 0), (0, 0, 1)),
    "down": _face((1, 0, 0), (0, 0, -1)),
}
"""R_camera_face (3, 3) by name, in the order of panels: axes x right, y down, z forward as a camera's. Going right from
the front one comes to right, back, left; `up` and `down` stand at the front's upper and lower border as one looks there."""
