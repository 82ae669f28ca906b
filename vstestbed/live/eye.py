"""The servo camera's picture in the browser: reduced, with markers, goals and numbers drawn in, not more often than needed."""

from __future__ import annotations

import numpy as np
import viser

from vstestbed.live.transport import Sample
from vstestbed.report.video.film import Pictures, scaled
from vstestbed.report.video.writer import Image
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.replay import Replay

WIDTH, HEIGHT = 400, 320
"""The picture in the panel is at most as large [px]."""
FRUSTUM_WIDTH = 160
"""Width of the one in the frustum [px]."""
JPEG_QUALITY = 70


class Eye:
    """The picture of a run.

    Args:
        gui: where it is added, in the container that is open. scenario: the experiment. replay: draws what the run did not.
    """

    def __init__(self, gui: viser.GuiApi, scenario: Scenario, replay: Replay):
        camera = scenario.camera
        share = min(WIDTH / camera.width, HEIGHT / camera.height, 1.0)
        self._size = max(16, round(share * camera.width)), max(16, round(share * camera.height))
        self._scenario, self._replay = scenario, replay
        self._pictures = Pictures(scenario, "eye", replay, self._size)
        blank = np.full((self._size[1], self._size[0], 3), 60, np.uint8)
        self._shown = gui.add_image(blank, label="servo camera", format="jpeg", jpeg_quality=JPEG_QUALITY)

    def draw(self, sample: Sample) -> Image:
        """Send the picture of a sample; returns a small one for the frustum."""
        image = self._pictures.picture(sample.film)
        self._shown.image = image
        share = min(1.0, FRUSTUM_WIDTH / image.shape[1])
        return scaled(image, (round(share * image.shape[1]), round(share * image.shape[0])))

    def clear(self) -> None:
        """Forget the trails."""
        self._pictures = Pictures(self._scenario, "eye", self._replay, self._size)

    def remove(self) -> None:
        """Take the picture away."""
        self._shown.remove()
