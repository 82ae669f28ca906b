"""Films of a run: `VideoWriter` streams frames into a file, `Overlay` and `draw_caption` draw over them."""

from vstestbed.report.video.overlay import Overlay, draw_caption
from vstestbed.report.video.writer import VideoWriter

__all__ = ["Overlay", "VideoWriter", "draw_caption"]
