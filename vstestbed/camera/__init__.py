"""Cameras: pixel to ray and back for each lens, and the pixel convention of the whole project.

The centre of the first pixel is (0, 0), u to the right, v down (OpenCV's convention); a picture of
W x H pixels thus covers u in [-0.5, W - 0.5]. Camera axes: x right, y down, z forward. `uv` is
pixels, `xy` is normalised (X/Z, Y/Z), `depth` is Z, `range` is the norm; theta is a ray's angle
from z, phi its angle about z, from x towards y.
"""

from vstestbed.camera.base import Calibration, Camera, Image, Panel, Picture, Regions, Window
from vstestbed.camera.perspective import Perspective
from vstestbed.camera.wide import Catadioptric, Fisheye, Radial, SphericalCamera
from vstestbed.core.registry import Registry
from vstestbed.imaging.depth import DEPTH_SENSORS, DepthImage, DepthSensor

CAMERAS = Registry(
    "camera", Perspective, Fisheye, Catadioptric, SphericalCamera, default="perspective"
)

__all__ = [
    "CAMERAS",
    "DEPTH_SENSORS",
    "Calibration",
    "Camera",
    "Catadioptric",
    "DepthImage",
    "DepthSensor",
    "Fisheye",
    "Image",
    "Panel",
    "Perspective",
    "Picture",
    "Radial",
    "Regions",
    "SphericalCamera",
    "Window",
]
