"""A printed picture tracked whole: the homography of its plane by ESM, found again by keypoints."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from vstestbed.camera import Camera, Look, Picture, Window
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositiveTime
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal
from vstestbed.targets.base import Target
from vstestbed.vision.base import Detection, DetectorBase, TruthView
from vstestbed.vision.detect.esm import Fit, align, normalised, similarity
from vstestbed.vision.detect.plane_search import found
from vstestbed.vision.detect.sampling import GreyPicture
from vstestbed.vision.detect.template import Template, template_of
from vstestbed.vision.detect.windows import windows_round

ALONG = np.linspace(-1, 1, 5)
"""Places along a template's sides whose images make its bounding box."""


@dataclass(frozen=True, slots=True)
class PatchMemory:
    """The plane's homography (3, 3) when it was last seen, and in the picture before that one; None where it was not.

    Attributes:
        tracked: the last picture showed it. searched_s: time of the last search by keypoints [s].
    """

    G: Array | None = None
    before: Array | None = None
    tracked: bool = False
    searched_s: float = -math.inf


@spec
class PatchDetector(DetectorBase):
    """The target's own picture, tracked whole; its corners, or the points `at_px`, are the markers.

    The template is the target's picture file. Its homography to the picture is aligned by efficient second-order minimisation (ESM) from
    the last one, predicted at constant velocity, with a gain and an offset of the light and the robust weights of an M-estimator. At
    first, and every `search_s` while it is lost, SIFT keypoints find it. It works with every lens: the plane is projected by the
    camera's own model.

    All points of the plane are known by the homography: also those that are hidden, and those beyond the border of the picture, whose
    pixels are extrapolated. When less than `least_visible` of the template is in the picture, and alike, all markers are lost.

    Args:
        least_correlation: a block of the template (a sixth of its longer side) is taken to be visible if its zero-mean normalised
            correlation with the picture is at least this [1].
        least_visible: share of the blocks with texture that must be visible [1].
        search_s: time between two searches while it is lost [s].
        texels: largest number of the template's pixels that are compared with the picture; more are slower and a little more exact.
        window_margin_px: margin of the window around the predicted picture, besides half of its last move [px].

    References: Benhimane & Malis 2007, doi:10.1177/0278364907080252; Lowe 2004, doi:10.1023/B:VISI.0000029664.99615.94.
    """

    kind: Literal["patch"] = "patch"
    least_correlation: Annotated[float, Gt(0), Lt(1)] = 0.6
    least_visible: Annotated[float, Gt(0), Le(1)] = 0.3
    search_s: PositiveTime = 0.2
    texels: Annotated[int, Ge(1000), Le(1000000)] = 30000
    window_margin_px: Annotated[int, Ge(2), Le(8192)] = 12
    needs_image: ClassVar[bool] = True
    needs_sheet: ClassVar[bool] = True

    def init(self) -> PatchMemory:
        """Nothing seen yet."""
        return PatchMemory()

    def begin(self, goal: Goal, camera: Camera, target: Target) -> PatchMemory:
        """Nothing seen yet; the target's picture and its keypoints are read now, not while a robot waits for the first picture."""
        if target.sheet is not None:
            self._template(target)
        return self.init()

    def look(self, memory: PatchMemory, camera: Camera, target: Target) -> Look | None:
        """The window of the next picture; None for everything, always so in a camera with panels."""
        window = self._window(memory, camera, target)
        return None if window is None else ((window,),)

    def detect(
        self, memory: PatchMemory, picture: Picture | None, view: TruthView | None, camera: Camera, target: Target, rng: np.random.Generator
    ) -> tuple[PatchMemory, Detection]:
        """Pixels (N, 2) of the target's points in one picture, all NaN where its picture is not found.

        Raises:
            ParameterError: there is no picture, or the target has none to track.
        """
        if picture is None or picture.empty:
            raise ParameterError("picture", "is missing: detector patch needs one; use detector oracle where there is none")
        template = self._template(target)
        fit, searched_s = self._tracked(memory, picture, template, camera, target), memory.searched_s
        if fit is None and picture.t - searched_s >= self.search_s:
            fit, searched_s = self._found(picture, template, camera), picture.t
        if fit is None:
            lost = replace(memory, before=None, tracked=False, searched_s=searched_s)
            return lost, Detection(uv=np.full((len(target.points), 2), np.nan))
        points = np.column_stack([target.points[:, :2] / template.unit_m, np.ones(len(target.points))])
        next_memory = PatchMemory(fit.G, memory.G if memory.tracked else None, True, searched_s)
        return next_memory, Detection(uv=camera.project(points @ fit.G.T))

    def _template(self, target: Target) -> Template:
        if target.sheet is None or target.source is None:
            raise ParameterError("target", "must be a picture for detector patch, which tracks it")
        return template_of(target.source, target.sheet.width, self.texels)

    def _tracked(self, memory: PatchMemory, picture: Picture, template: Template, camera: Camera, target: Target) -> Fit | None:
        """The template aligned from where it was: in its window, else in the whole picture; None where it is not there."""
        if memory.G is None:
            return None
        window = self._window(memory, camera, target)
        fit = self._aligned(memory, GreyPicture(picture, camera, window), template)
        if fit is None and window is not None:
            fit = self._aligned(memory, GreyPicture(picture.completed(), camera), template)
        return fit

    def _aligned(self, memory: PatchMemory, grey: GreyPicture, template: Template) -> Fit | None:
        """Aligned from the last homography and the one predicted at constant velocity, from the more similar one first."""
        if memory.G is None:
            return None
        starts = [memory.G]
        if memory.before is not None:
            starts.append(normalised(memory.G @ np.linalg.inv(memory.before) @ memory.G))
            starts.sort(key=lambda G: similarity(template, grey, G, self.least_correlation))
        for G in reversed(starts):
            fit = self._good(align(template, grey, G, self.least_correlation))
            if fit is not None:
                return fit
        return None

    def _found(self, picture: Picture, template: Template, camera: Camera) -> Fit | None:
        """The template found by keypoints and aligned."""
        whole = picture.completed()
        G = found(template, whole, camera)
        return None if G is None else self._good(align(template, GreyPicture(whole, camera), G, self.least_correlation))

    def _good(self, fit: Fit | None) -> Fit | None:
        return fit if fit is not None and fit.visible >= self.least_visible else None

    def _window(self, memory: PatchMemory, camera: Camera, target: Target) -> Window | None:
        """Around the template, predicted at constant velocity; None where the whole image is to be searched."""
        if len(camera.panels) > 1 or not memory.tracked or memory.G is None:
            return None
        half = self._template(target).half
        x, y = np.meshgrid(ALONG * half[0], ALONG * half[1])
        plane = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
        uv = camera.project(plane @ memory.G.T)
        before = uv if memory.before is None else camera.project(plane @ memory.before.T)
        if not (np.isfinite(uv).all() and np.isfinite(before).all()):
            return None
        (left, top), (right, bottom) = uv.min(axis=0).tolist(), uv.max(axis=0).tolist()
        box = max(-camera.width, int(left)), max(-camera.height, int(top)), math.ceil(right) + 1, math.ceil(bottom) + 1
        du, dv = (uv - before).mean(axis=0).tolist()
        windows = windows_round([box], [(du, dv)], [0], camera, self.window_margin_px)
        return None if windows is None else windows[0]
