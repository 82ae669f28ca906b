"""OpenCV, imported when one of its functions is first used.

A run of an ideal camera with exact pixels works without OpenCV, MuJoCo and OpenGL, for example in a
browser. OpenCV keeps to one thread: a run's numbers do not depend on the machine's cores, and
parallel runs do not fight for them.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

MOST_PIXELS = 1 << 26
"""Of a picture that is read: a file of some kilobytes may claim a thousand million, and OpenCV's
own bound is as high.
"""


class _OpenCV:
    def __getattr__(self, name: str) -> Any:
        # read when it is imported
        os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MOST_PIXELS))
        import cv2

        cv2.setNumThreads(1)
        value = getattr(cv2, name)
        setattr(self, name, value)  # so that it is looked up once
        return value


cv2: Any = _OpenCV()
"""Without types: OpenCV's say of every array that its numbers may be of any kind."""

_QUIET = threading.RLock()


@contextmanager
def quiet() -> Iterator[None]:
    """Keep OpenCV's own log out of the terminal while it decodes what others wrote: an error of
    this program says what is wrong. Its level is of the whole process; one thread at a time sets
    it, and sets it back.
    """
    logging = cv2.utils.logging
    with _QUIET:
        before = logging.getLogLevel()
        logging.setLogLevel(logging.LOG_LEVEL_SILENT)
        try:
            yield
        finally:
            logging.setLogLevel(before)


__all__ = ["MOST_PIXELS", "cv2", "quiet"]
