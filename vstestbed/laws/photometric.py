"""Direct visual servoing: the luminance of every pixel is a feature."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import GainOrZero, Narrower, Pixels, Time
from vstestbed.core.spec import kind_of, spec
from vstestbed.features.depth import AtGoal, Constant, Depth
from vstestbed.features.observation import Goal, Observation, Sight
from vstestbed.laws.base import Command, ConstantGain, Gain, LawBase, TwistLimits
from vstestbed.laws.illumination import Light, relit
from vstestbed.laws.luminance import GoalLevel, Grey, LevelPixels, Normal, Which, coarser, luminance, motion_px
from vstestbed.laws.robust import Robust

NO_PICTURE = "the law has no picture"
BLANK = "the picture shows next to nothing of what the goal's shows"
NO_PIXEL = "no pixel of the picture fits the goal's"
NO_STRUCTURE = "the goal's picture has too little structure (a motion of 10 mm or 1 degree changes it by less than 0.05 grey levels)"
NO_DEPTH = "the depth camera measured no pixel: all is nearer than its near_m or beyond its far_m"
LEAST_CHANGE = 0.05
"""Least RMS change of the goal's picture [grey levels] by a motion of 10 mm or 1 degree, whichever changes it least. With structure it is
some 0.4; a wall with 0.01 was once taken as the goal's from 0.26 m away."""
LEAST_CONTRAST = 0.1
"""Least standard deviation of the picture's grey levels over that of the goal's: under it a wall or the floor fills the picture."""
FINER_PX, COARSER_PX = 0.25, 4.0
"""The law goes to a finer level where the remaining motion in the picture is under FINER_PX pixels of its own, and back to a coarser one
where it is over COARSER_PX: linear are grey levels over about a pixel."""
LEAST_SIDE = 12
"""Least height and width of the coarsest level, without its border [px]."""


@spec
class LevenbergMarquardt:
    """Damping of the least squares, (H + mu diag(H))^-1: from steepest descent with large mu to Gauss-Newton with small mu.

    Args:
        mu: at first [1].
        mu_then: from after_s on [1].
        after_s: time of the change, from the law's first picture on [s]; the printed example has 90 pictures at 25 Hz.

    Reference: Collewet & Marchand 2011.
    """

    mu: GainOrZero = 0.01
    mu_then: GainOrZero = 0.0001
    after_s: Time = 3.6

    def at(self, since_s: float) -> float:
        """The damping at a time after the first picture [s]."""
        return self.mu if since_s < self.after_s else self.mu_then


@dataclass(frozen=True, slots=True)
class PhotometricMemory:
    """What the law keeps.

    Attributes:
        pyramid: the goal's picture, from the finest level to the coarsest; None before the first picture.
        level: number of the current level. t0: time of the first picture [s]. goal: whose pyramid it is.
    """

    pyramid: tuple[GoalLevel, ...] | None = None
    level: int = 0
    t0: float = 0.0
    goal: Sight | None = None


@spec
class Photometric(LawBase):
    """u = -lambda (H + mu diag(H))^-1 (L_I B)^T W (I - I*), H = (L_I B)^T W L_I B, camera twist v = B u.

    I and I* are the luminance of the current picture and of the goal's, pixel by pixel: nothing is detected, matched or tracked. L_I
    follows from the gradient of the picture (`luminance.rows`). Grey levels are linear in the camera's motion over few pixels only, so
    that the basin of attraction is small; `levels` widens it. What changes the picture other than by motion (a lamp, a shadow, a hand
    before the camera) is an error to this law; `robust` leaves out what fits least.

    Args:
        gain: lambda [1/s], a number or an adaptive gain of the remaining motion.
        interaction: L of the current picture, of the goal's (the matrix of the printed example), or the mean of both, whose steps are of
            second order (Malis 2004).
        damping: mu.
        robust: W, the weights of an M-estimator with the scale of the median absolute deviation, at the finest level: `none`, `huber` or
            `tukey`.
        light: `same` as when the goal's picture was taken, or `gain_offset`: I = (1 + a) I* + b, with a and b fitted in each picture
            together with the motion at the finest level, while at coarser ones the picture gets the mean and the contrast of the goal's;
            a lamp that became brighter is then no error, and needs some structure more.
        depth: Z of the pixels: `goal`, the markers' plane as seen at the goal; `constant`; or `sensor`, a depth camera's.
        smooth_px: standard deviation of the Gaussian that smooths both pictures first [px]; 0: none. It widens the basin, and makes L the
            true one of the pictures, whose differences from pixel to pixel are then small.
        levels: levels of a Gaussian pyramid, from coarse to fine; 1: full pictures alone.
        margin_px: border of the picture that is left out [px].
        stride: every how many-th pixel of a row and column of a level counts [1].
        limits: largest speed and rate of the commanded twist.

    References: Collewet, Marchand & Chaumette 2008, https://inria.hal.science/inria-00261398; Collewet & Marchand 2011,
    https://inria.hal.science/inria-00629834; mean matrix: Malis 2004, doi:10.1109/ROBOT.2004.1308092.
    """

    kind: Literal["photometric"] = "photometric"
    gain: Gain = ConstantGain()
    interaction: Which = "desired"
    damping: LevenbergMarquardt = LevenbergMarquardt()
    robust: Robust = "none"
    light: Light = "same"
    depth: Depth = AtGoal()
    smooth_px: Annotated[Pixels, Narrower(le=50)] = 1.5
    levels: Annotated[int, Ge(1), Le(8)] = 1
    margin_px: Annotated[int, Ge(0), Le(1000)] = 10
    stride: Annotated[int, Ge(1), Le(64)] = 1
    limits: TwistLimits = TwistLimits()
    inputs = ("image",)

    def __post_init__(self) -> None:
        """Refuse sources of depth that know nothing of a pixel."""
        if not (self.depth.measured or isinstance(self.depth, AtGoal | Constant)):
            words = "is of markers, and law photometric needs it of pixels; use goal, constant or sensor (a depth camera)"
            raise ParameterError("depth", words, self.depth.kind)

    def markers_needed(self, basis: Array) -> int:
        """None: pixels do."""
        return 0

    def check(self, points: Array, goal: Goal) -> None:
        """Refuse a lens that is not perspective, and a border or levels that leave no picture."""
        camera = goal.camera
        if not isinstance(camera, Perspective):
            raise ParameterError("camera", "must be of kind perspective for law photometric", kind_of(type(camera)))
        least = min(camera.width, camera.height)
        inner = (least - 2 * self.margin_px) / 2 ** (self.levels - 1) / self.stride
        if inner < LEAST_SIDE:
            given = f"margin_px {self.margin_px}, levels {self.levels} and stride {self.stride}"
            words = (
                f"leaves {max(inner, 0):.3g} px of the picture's {least} at the coarsest level with {given}, and {LEAST_SIDE} are needed"
            )
            raise ParameterError("law", f"{words}; make one of them smaller")

    def init(self, goal: Goal) -> PhotometricMemory:
        """No picture so far."""
        return PhotometricMemory()

    def step(self, memory: PhotometricMemory, observation: Observation, goal: Goal, basis: Array) -> tuple[PhotometricMemory, Command]:
        """One frame: the picture against the goal's."""
        sight = observation.image
        if sight is None:
            return memory, Command.rest(basis, NO_PICTURE)
        if memory.pyramid is None or memory.goal is not goal.image:
            pyramid = self._pyramid(goal)
            memory = PhotometricMemory(pyramid, len(pyramid) - 1, observation.t, goal.image)
        assert memory.pyramid is not None
        level, grey, near = memory.pyramid[memory.level], self._at_level(sight.image, memory.level), self._measured(sight, memory)
        if why := self._why_not(memory.pyramid[0], near):
            return memory, Command.rest(basis, why)
        if float(grey.std()) < LEAST_CONTRAST * float(level.grey.std()):
            return memory, Command.rest(basis, BLANK)
        # Far from the goal most pixels differ, and those that differ most tell where it is: only near it are they outliers.
        robust = self.robust if memory.level == 0 else "none"
        normal = level.normal(self._lit_as(level, grey, memory.level), self.interaction, robust, near)
        step = self._solved(normal, basis, self.damping.at(observation.t - memory.t0))
        if step is None:
            return memory, Command.rest(basis, NO_PIXEL)
        command = self.limits.command(-self.gain.at(step) * step, basis)
        memory = replace(memory, level=self._next_level(memory, basis @ step, goal))
        return memory, replace(command, error_grey=normal.error_grey)

    def _why_not(self, goal: GoalLevel, near: Grey | None) -> str:
        """Why the law cannot work with these pictures; "" if it can."""
        if not (goal.inverse_depth.any() and (near is None or near.any())):
            return NO_DEPTH
        return "" if goal.least_change >= LEAST_CHANGE else NO_STRUCTURE

    def _solved(self, normal: Normal, basis: Array, mu: float) -> Array | None:
        """The remaining motion (n,) along the robot's motions [m, rad]; None where the pixels do not determine it."""
        H = basis.T @ normal.H @ basis
        scale = np.sqrt(np.diag(H))
        if not (scale > 0).all():
            return None
        # Scaled to a unit diagonal, to which mu is then added: the condition of metres against radians is not in the matrix.
        scaled = H / np.outer(scale, scale) + mu * np.eye(len(H))
        try:
            return np.linalg.solve(scaled, basis.T @ normal.b / scale) / scale
        except np.linalg.LinAlgError:
            return None

    def _next_level(self, memory: PhotometricMemory, step: Array, goal: Goal) -> int:
        """The level for the next picture, after a step (6,) [m, rad] of the camera that would reach the goal."""
        assert memory.pyramid is not None and isinstance(goal.camera, Perspective)
        near = memory.pyramid[-1].inverse_depth
        moved = motion_px(goal.camera, step, 1 / float(near[near > 0].mean())) / 2**memory.level
        if moved < FINER_PX:
            return max(memory.level - 1, 0)
        return min(memory.level + 1, len(memory.pyramid) - 1) if moved > COARSER_PX else memory.level

    def _at_level(self, image: NDArray[np.uint8], level: int) -> Grey:
        grey = luminance(image, self.smooth_px)
        for _ in range(level):
            grey = coarser(grey)
        return grey

    def _lit_as(self, goal: GoalLevel, grey: Grey, level: int) -> Grey:
        """The picture of a coarser level as if in the goal's light; at the finest one the light is fitted with the motion."""
        return relit(grey, goal.grey) if level > 0 and self.light == "gain_offset" else grey

    def _pyramid(self, goal: Goal) -> tuple[GoalLevel, ...]:
        """The goal's picture, level by level.

        Raises:
            ParameterError: the goal has no picture.
        """
        if goal.image is None or not isinstance(goal.camera, Perspective):
            raise ParameterError("goal", "has no picture, which law photometric compares with; give goal_images to the Controller")
        made, grey = [], luminance(goal.image.image, self.smooth_px)
        for number in range(self.levels):
            pixels = LevelPixels.of(goal.camera, number, self.margin_px, self.stride)
            made.append(GoalLevel(pixels, grey, self._inverse_depth(pixels, goal, number), self.light if number == 0 else "same"))
            grey = coarser(grey)
        return tuple(made)

    def _inverse_depth(self, pixels: LevelPixels, goal: Goal, level: int) -> Grey:
        """1/Z of pixels in the goal view [1/m], 0 where it is not known."""
        depth: Any = self.depth
        if isinstance(depth, Constant):
            return np.full(pixels.x.shape, 1 / depth.depth_m, np.float32)
        if isinstance(depth, AtGoal):
            nx, ny, nz = goal.normal / float(goal.normal @ goal.middle)  # 1/Z = n . (x, y, 1) / (n . p) of a plane through p
            return np.maximum(nx * pixels.x + ny * pixels.y + nz, 0).astype(np.float32)
        return _inverse(goal.image, pixels, level)

    def _measured(self, sight: Sight, memory: PhotometricMemory) -> Grey | None:
        """1/Z of the current picture's pixels by the depth camera; None with another source of depth."""
        if not self.depth.measured or self.interaction == "desired" or memory.pyramid is None:
            return None
        return _inverse(sight, memory.pyramid[memory.level].pixels, memory.level)


def _inverse(sight: Sight | None, pixels: LevelPixels, level: int) -> Grey:
    """1/Z of the pixels of a level by a depth picture [1/m], 0 in its holes."""
    if sight is None or sight.depth is None:
        raise ParameterError("law.depth", "may be sensor only with a depth camera, camera.depth_sensor; else use goal or constant")
    depth = sight.depth[:: 2**level, :: 2**level][pixels.at]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(depth > 0, 1 / depth, 0).astype(np.float32)
