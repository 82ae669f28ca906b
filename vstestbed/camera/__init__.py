"""Cameras: pixel to ray and back for each lens, and the pixel convention of the whole project.

The centre of the first pixel is (0, 0), u to the right, v down (OpenCV's convention); a picture of W x H pixels
thus covers u in [-0.5, W - 0.5]. Camera axes: x right, y down, z forward. `uv` is pixels, `xy` is normalised
(X/Z, Y/Z), `depth` is Z, `range` is the norm.
"""

from vstestbed.camera.base import Camera, Frame, Image, Look, Panel, Window
from vstestbed.camera.perspective import Perspective
from vstestbed.spec import OneOf

CAMERAS = OneOf("camera", Perspective, default="perspective")

__all__ = ["CAMERAS", "Camera", "Frame", "Image", "Look", "Panel", "Perspective", "Window"]
