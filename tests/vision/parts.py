"""Pictures of which only a part was drawn."""

from __future__ import annotations

import numpy as np

from vstestbed.camera import Picture, Regions


def in_windows(whole: Picture, regions: Regions, asked: list[Picture]) -> Picture:
    """A picture of which only the regions of interest were drawn; `asked` gets the whole one when
    it is asked for.
    """
    image, drawn = np.asarray(whole.images[0]), np.full_like(whole.images[0], 128)
    for left, top, right, bottom in regions[0]:
        drawn[top:bottom, left:right] = image[top:bottom, left:right]

    def draw_whole() -> Picture:
        asked.append(whole)
        return whole

    return Picture(whole.t, (drawn,), whole=False, draw_whole=draw_whole)
