"""OpenCV, imported when one of its functions is first used.

A run of an ideal camera with exact pixels works without OpenCV, MuJoCo and OpenGL, for example in a
browser. OpenCV keeps to one thread: a run's numbers do not depend on the machine's cores, and
parallel runs do not fight for them.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

MOST_PIXELS = 1 << 26
"""Of a picture that is read: a file of some kilobytes may claim a thousand million, and OpenCV's
own bound is as high.
"""

if TYPE_CHECKING:
    import cv2
else:

    class _OpenCV:
        def __getattr__(self, name: str) -> Any:
            # read when it is imported
            os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MOST_PIXELS))
            import cv2

            cv2.setNumThreads(1)
            value = getattr(cv2, name)
            setattr(self, name, value)  # so that it is looked up once
            return value

    cv2 = _OpenCV()

__all__ = ["MOST_PIXELS", "cv2"]
