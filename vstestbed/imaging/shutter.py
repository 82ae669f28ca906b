"""What each image of an exposure contributes to each row of the picture: rolling shutter, exposure
and flicker in one integral.

Between two images the scene is taken to move evenly, so that row v at time t is (1 - a) I_k + a
I_(k+1), a = (t - t_k) / (t_(k+1) - t_k): image k has the weight hat_k(t), a triangle about t_k.
Over the row's own exposure of e seconds about t_v, under light of brightness B(t),

w_k(v) = 1/e integral of hat_k(t) dt, l_k(v) = 1/e integral of hat_k(t) B(t) dt.

Both are in closed form; sum_k w_k = 1, sum_k l_k = mean of B. The centre of a moving marker is then
where it is to second order, a tau^2 / 8 for an acceleration a [px/s^2] in the picture and images
tau apart, and its edge is double by its motion in tau, a pixel at 500 px/s and the 2 ms of a
physics step. Shorter steps (`physics.step_s`) allow more images; an exposure longer than tau blurs
as it should.

Only the rows to which an image contributes are drawn, of wide and distorted lenses what they are
interpolated from; of a lens with panels whole panels. CPU time of a frame of `arm_ibvs`, 640 x 480,
by OpenGL in software and by rays: 6.6 and 4.2 ms without, 22 and 14 ms with a readout of 20 ms (11
images), 36 and 23 ms with an exposure of 5 ms besides, 38 and 43 ms with flicker besides the
readout. An oracle takes 3 ms in place of 1. By OpenGL, with the readout alone, and with noise
besides: 33 and 60 ms through a lens with distortion (20 ms without both), 33 and 80 ms through a
fisheye (9 ms without both), where noise has whole rows drawn.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.imaging.flicker import INSTANT_S, STEADY, Flicker

RowWeight = float | Array  # a weight of a whole picture, or one of each row (H,)
Rows = tuple[int, int]  # the first of a band of rows of a picture, and the one after the last


Contribution = tuple[tuple[float, RowWeight], ...]
"""What the scene at one instant contributes to a picture: brightness of the lamps and weight of
each image of it that is drawn.
"""


def of_rows(
    nodes: Array, middles: Array, exposure_s: float, flicker: Flicker = STEADY
) -> tuple[Array, Array]:
    """Weights w (K, H) and light l (K, H) of images at times `nodes` (K,) [s], rising, for rows
    exposed about `middles` (H,) [s].

    Exposures must lie within the nodes. A single node contributes to all.
    """
    if exposure_s < INSTANT_S or len(nodes) == 1:
        w = np.array([np.interp(middles, nodes, one) for one in np.eye(len(nodes))])
        return w, w * flicker.mean(middles, exposure_s)
    totals = []
    for light in (STEADY, flicker):
        total = np.zeros((len(nodes), len(middles)))
        for k, (start, stop) in enumerate(itertools.pairwise(nodes)):
            begin, end = (np.clip(middles + side * exposure_s / 2, start, stop) for side in (-1, 1))
            whole, moment = light.moments(start, begin, end)
            total[k + 1] += moment / (stop - start)
            total[k] += whole - moment / (stop - start)
        totals.append(total / exposure_s)
    return totals[0], totals[1]


def of_exposure(nodes: Array, exposure_s: float) -> Array:
    """Weights (K,) of images at times `nodes` (K,) [s], symmetric about 0, for a picture exposed
    about 0, which they hold.

    They are the integrals of triangles, scaled about the middle one, so that their sum is 1, their
    mean time 0 and their variance exposure_s^2 / 12, that of the exposure: the smear of what moves
    evenly has the length speed * exposure_s, however coarse the images. Of three images a step
    apart and an exposure of two steps they are Simpson's.
    """
    (w,) = of_rows(nodes, np.zeros(1), exposure_s)[0].T
    spread = float(w @ nodes**2)
    share = exposure_s**2 / 12 / spread if spread > 0 else 1.0
    return share * w + (1 - share) * (nodes == 0)


def contributions(weights: Array, light: Array, depth: float) -> tuple[Contribution, ...]:
    """The contributions of images with weights w (K, H) under light l (K, H) that flickers by
    `depth` about 1.

    What is lit is linear in the light, what is not is not: w I = a I_dark + (w - a) I_bright, a the
    share for which the light is l.
    """
    if depth == 0:
        return tuple(((1.0, w),) for w in weights)
    bright = np.clip((light - (1 - depth) * weights) / (2 * depth), 0.0, weights)
    return tuple(((1 - depth, w - b), (1 + depth, b)) for w, b in zip(weights, bright, strict=True))


@dataclass(frozen=True)
class Opening:
    """One opening of the shutter, in physics steps from the picture's middle.

    Attributes:
        exposure_s: exposure time, with a rolling shutter of each row [s]. half: from the middle to
            the end of it all.
        most: number of images, at most. step_s: of the physics [s].
        exact: the exposure need not be whole pairs of steps: the images' weights make up for it
            (`of_exposure`).
    """

    exposure_s: float
    half: int
    most: int
    step_s: float
    exact: bool = False

    @cached_property
    def offsets(self) -> tuple[int, ...]:
        """Steps at which images are drawn, symmetric; the middle is one of them."""
        if self.half == 0:
            return (0,)
        n = min(2 * self.half + 1, self.most - 1 + self.most % 2)  # odd
        return tuple(np.round(np.linspace(-self.half, self.half, n)).astype(int).tolist())

    @cached_property
    def nodes(self) -> Array:
        """The same as times (K,) [s]."""
        return np.array(self.offsets) * self.step_s

    @cached_property
    def weights(self) -> tuple[float, ...]:
        """Weight of each image in a picture whose rows are all exposed at once, sum 1."""
        if self.half == 0:
            return (1.0,)
        if self.exact:
            return tuple(of_exposure(self.nodes, self.exposure_s).tolist())
        # Rounded to whole steps they are unevenly spaced: the weights are those of the trapezoidal
        # rule, so that the mean stays unbiased.
        weights: Array = np.gradient(np.array(self.offsets, dtype=float))
        weights[[0, -1]] /= 2
        return tuple((weights / weights.sum()).tolist())
