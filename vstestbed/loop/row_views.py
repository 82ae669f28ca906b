"""What an oracle sees through a rolling shutter: each marker when the row that it is in is exposed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array
from vstestbed.vision.base import TruthView

ROUNDS = 12
"""Iterations to the time at which a marker is exposed. Each divides the error by H / (readout_s v'), v' the marker's speed down the
picture [px/s]: 24 for one that crosses it in half a second while 20 ms are read out."""


class RowViews:
    """Views of the truth while a picture is read out, and the one view that the picture is of.

    Marker i is exposed at the time t_i that solves t = d(v_i(t)), with the delay d(v) of a row (`Camera.row_delay`) and v_i(t) the row
    of the marker's centre at t; its place is interpolated between the views. A marker that the lens cannot project is taken at the
    picture's time stamp, one beyond the picture at the begin or end of the readout.

    Args:
        camera: the lens. times: of the views from the picture's time stamp (K,) [s], rising.
    """

    def __init__(self, camera: Camera, times: Array):
        self._camera, self._times = camera, times
        self._ends = camera.row_delay(np.array([0.0, camera.height - 1.0]))
        self._views: list[TruthView] = []

    def add(self, view: TruthView) -> None:
        """Add the view at the next of the times."""
        self._views.append(view)

    def taken(self) -> TruthView:
        """The view in which each marker is where it was when its row was exposed; the next view is the first one of the next picture."""
        views, self._views = self._views, []
        p = np.stack([view.p_camera for view in views])
        t = np.zeros(p.shape[1])
        for _ in range(ROUNDS):
            v = self._camera.project(self._at(p, t))[:, 1]
            t = np.clip(np.where(np.isfinite(v), self._camera.row_delay(v), 0.0), *self._ends)
        nearest = np.abs(self._times[:, None] - t).argmin(axis=0)
        hidden: NDArray[np.bool_] = np.stack([view.hidden for view in views])
        return TruthView(self._at(p, t), hidden[nearest, np.arange(len(t))])

    def _at(self, p: Array, t: Array) -> Array:
        """Places (N, 3), each at its own time (N,), between those at all times (K, N, 3)."""
        k = np.clip(np.searchsorted(self._times, t, side="right") - 1, 0, len(self._times) - 2)
        share = ((t - self._times[k]) / (self._times[k + 1] - self._times[k]))[:, None]
        i = np.arange(len(t))
        return (1 - share) * p[k, i] + share * p[k + 1, i]
