"""Films of a run: `VideoWriter` streams frames into a file, `Overlay` and `captioned` draw over
them.
"""

from vstestbed.report.video.overlay import Overlay, captioned
from vstestbed.report.video.writer import VideoWriter

__all__ = ["Overlay", "VideoWriter", "captioned"]
