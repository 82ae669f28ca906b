"""Vision: from pixels to what a law may see. The only room with OpenCV, besides the renderer's remap and the video.

OpenCV keeps to one thread: a run's numbers do not depend on the machine's cores, and parallel runs do not fight for them.
"""

import cv2

from vstestbed.spec import OneOf
from vstestbed.vision.base import Detection, Detector, TruthView
from vstestbed.vision.blobs import Blobs
from vstestbed.vision.centre import centre_bias
from vstestbed.vision.lines import Lines
from vstestbed.vision.observe import Observer, ObserverMemory
from vstestbed.vision.oracle import Oracle
from vstestbed.vision.pose import solve_pose, solve_pose_from_rays
from vstestbed.vision.tags import Tags

cv2.setNumThreads(1)

DETECTORS = OneOf("detector", Blobs, Tags, Lines, Oracle, default="blobs")

__all__ = [
    "DETECTORS",
    "Blobs",
    "Detection",
    "Detector",
    "Lines",
    "Observer",
    "ObserverMemory",
    "Oracle",
    "Tags",
    "TruthView",
    "centre_bias",
    "solve_pose",
    "solve_pose_from_rays",
]
