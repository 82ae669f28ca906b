"""The picture of an environment from outside, as in the film of a run."""

from __future__ import annotations

from vstestbed.camera import Image
from vstestbed.report.video.film import Pictures, replay_of
from vstestbed.report.video.film_frame import FilmFrame
from vstestbed.report.video.quality import quality_of
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.frame import Frame


class Overview:
    """Draws one episode from outside, with the camera's own picture inset; the trail joins the frames that were drawn.

    Args:
        scenario: the episode's.

    Raises:
        EnvironmentLackError: OpenGL is asked for, and does not work here.
    """

    def __init__(self, scenario: Scenario):
        quality = quality_of(scenario)
        self._replay = replay_of(scenario, quality)
        self._pictures = Pictures(scenario, "overview", self._replay, quality.size)

    def picture(self, frame: Frame) -> Image:
        """The picture (H, W, 3) uint8 RGB of a frame; the caller may keep it."""
        return self._pictures.picture(FilmFrame.of_frame(frame))

    def close(self) -> None:
        """Free its scene."""
        self._replay.close()
