"""The difference of picture and goal picture, which a law of grey levels sees, as an inset of the camera's film."""

from __future__ import annotations

from contextlib import closing
from typing import Final

import cv2
import numpy as np

from vstestbed.core.geometry import inverse
from vstestbed.report.video.film_frame import FilmFrame
from vstestbed.report.video.overlay import PAPER, draw_text, shortened, text_size
from vstestbed.report.video.writer import Image
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.streams import GOAL_STREAM
from vstestbed.sim.replay import Replay

SHARE: Final = 1 / 3
"""Width of the inset over that of the film."""
WORDS: Final = "picture \u2212 goal"
"""What the inset is called."""
EDGE: Final = 2
"""Width of its edge [px]."""
ZERO: Final = 128
"""Grey of a pixel without a difference; a difference of d grey levels is ZERO + d/2."""


class Residual:
    """Draws I - I* into the upper right corner, under its name: mid-grey is no difference, lighter is lighter than the goal's picture.

    Args:
        scenario: the experiment. replay: takes the goal's picture of a recorded run again.
    """

    def __init__(self, scenario: Scenario, replay: Replay):
        self._scenario, self._replay = scenario, replay
        self._goal: dict[int, Image] = {}

    def put(self, film: Image, seen: Image, frame: FilmFrame, view: int) -> None:
        """Draw the inset on a film's picture, in place; seen: the camera's image of the frame."""
        goal = self._goal_image(frame, view)
        difference = cv2.subtract(_grey(seen), _grey(goal), dtype=cv2.CV_16S)
        shown = cv2.convertScaleAbs(difference.astype(np.float32) / 2 + ZERO)
        width = round(SHARE * film.shape[1])
        height = round(width * seen.shape[0] / seen.shape[1])
        small = np.asarray(cv2.cvtColor(cv2.resize(shown, (width, height), interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2RGB), np.uint8)
        _label(small, text_size(film.shape[0]))
        film[: height + EDGE, -(width + EDGE) :] = PAPER
        film[:height, -width:] = small

    def _goal_image(self, frame: FilmFrame, view: int) -> Image:
        """The goal's picture: of a running loop its own, of a log taken again."""
        if frame.goal_image is not None:
            return frame.goal_image
        if view not in self._goal:
            self._goal[view] = self._taken_again(frame, view)
        return self._goal[view]

    def _taken_again(self, frame: FilmFrame, view: int) -> Image:
        s = self._scenario
        said = s.goal.pictures[view] if s.goal.pictures else None
        if said is not None and said.source is not None:
            return said.read(s.camera)
        T_world_goal = frame.T_world_target @ inverse(s.goal_poses[view])
        # Of a scene of its own: the target as it was before `noise.target`, and no picture that others take for one of the run.
        with closing(self._replay.of_target(s.target)) as taught:
            image = taught.picture("eye", s.camera.width, s.camera.height, frame.t, frame.T_world_target, frame.q, T_world_goal).copy()
        return image if said is None else said.under_its_light(image, s.rng(GOAL_STREAM))


def _label(image: Image, size: int) -> None:
    """Write what the inset shows on a darkened strip along its top, since what is below may be light or dark; size: of the text [px]."""
    words, pad = shortened(WORDS, size, image.shape[1] - size), size // 2
    strip = image[: round(1.5 * size)]
    cv2.convertScaleAbs(strip, strip, 0.35)
    draw_text(image, words, (pad, round(1.15 * size)), PAPER, size)


def _grey(image: Image) -> Image:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
