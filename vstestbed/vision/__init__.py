"""Vision: from pixels to what a law may see. The only room with OpenCV, besides the renderer's
remap and the video.
"""

from vstestbed.core.registry import Contract, Registry
from vstestbed.vision.base import Detection, Detector, DetectorBase, TruthView
from vstestbed.vision.blobs import Blobs, centre_bias
from vstestbed.vision.keypoints import Keypoints
from vstestbed.vision.lines import Lines
from vstestbed.vision.local_features import KEYPOINTS
from vstestbed.vision.observe import Observer
from vstestbed.vision.oracle import NoDetector, Oracle
from vstestbed.vision.patch import PatchDetector
from vstestbed.vision.pnp import solve_pose, solve_pose_from_rays
from vstestbed.vision.region import RegionDetector
from vstestbed.vision.tags import Tags

DETECTORS = Registry(
    "detector",
    Blobs,
    Tags,
    Lines,
    Keypoints,
    PatchDetector,
    RegionDetector,
    Oracle,
    NoDetector,
    default="blobs",
    contract=Contract(Detector, base=DetectorBase),
)

__all__ = [
    "DETECTORS",
    "KEYPOINTS",
    "Blobs",
    "Detection",
    "Detector",
    "DetectorBase",
    "Keypoints",
    "Lines",
    "NoDetector",
    "Observer",
    "Oracle",
    "PatchDetector",
    "RegionDetector",
    "Tags",
    "TruthView",
    "centre_bias",
    "solve_pose",
    "solve_pose_from_rays",
]
