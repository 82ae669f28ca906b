"""Segmentation of coloured blobs in a window of an image: chroma mask, contours, moments, hue at
the centroid.
"""

from __future__ import annotations

import colorsys
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Window
from vstestbed.core.lazy import cv2

Rim = Literal["sharp", "binary", "grey"]

# pixels masked at a time: the intermediate images then stay in the core's cache (640x480: .1 ms
# instead of 1 ms)
STRIP_PX = 38400
# A whole ellipse of pixels may seem incomplete by this share of its area (distortion, a ball drawn
# with facets) and this area [px^2] (rendered discs and balls of 2 to 24 px radius reach .3, .8 and
# 1.2), more by noise [px^2 per grey level of its standard deviation] (balls of 4 to 30 px). A disc
# of 8 px of which 7 % are hidden is past all.
ROUGHNESS = 0.005
ROUGHNESS_PX = {"sharp": 1.0, "binary": 1.5, "grey": 1.5}
NOISE_ROUGHNESS_PX = 0.1
# noise is estimated from one row in so many: 480 rows give 5112 differences, enough for a few
# percent
NOISE_ROWS = 60
# Median absolute difference of two independent Gaussian numbers of standard deviation 1; .6745 is
# the normal upper quartile.
MEDIAN_STEP = 0.6745 * math.sqrt(2)
_NEIGHBOURS = np.ones((3, 3), np.uint8)


@dataclass(frozen=True, slots=True)
class Blob:
    """A connected region of saturated colour.

    Attributes:
        u, v: centroid [px]. area: area [px^2]. hue_deg: hue at the centroid [deg]. box: bounding
            box [px].
        whole: neither cut by the image's border nor, judging by its own shape, partly occluded.
    """

    u: float
    v: float
    area: float
    hue_deg: float
    box: Window
    whole: bool


def mixes_colours(lens: Camera) -> bool:
    """Whether pixels at an edge mix colours: several samples a pixel, or an image interpolated for
    a lens.
    """
    return lens.multisampling > 0 or lens.resampled


def chroma(image: Image) -> Image:
    """max(r, g, b) - min(r, g, b), shape (H, W), of an RGB image (H, W, 3): zero for every grey,
    and on grey proportional to coverage.
    """
    r, g, b = cv2.split(image)
    high = cv2.max(cv2.max(r, g), b)
    return cv2.subtract(high, cv2.min(cv2.min(r, g), b))


def noise_rows(height: int) -> range:
    """The rows, of an image of that height [px], from which the level of its noise is estimated; of
    a low one the middle row.
    """
    return range(min(NOISE_ROWS, height) // 2, height, NOISE_ROWS)


def noise_level(image: Image) -> float:
    """Standard deviation of an image's noise [grey levels], estimated from the image alone: 0 for a
    clean one.

    From the median step between neighbours in a row: most pixels of a rendered surface equal their
    neighbours, so that it is exactly 0 without noise. Noise below about .7 is lost in the rounding
    to grey levels. A textured background counts as noise.
    """
    of = noise_rows(len(image))
    rows = cv2.extractChannel(image[of.start :: of.step], 1)
    here = rows[:, 1:]
    there = rows[:, :-1]
    if 2 * np.count_nonzero(here != there) <= here.size:  # the median is 0: no need to sort
        return 0.0
    return float(np.median(cv2.absdiff(here, there))) / MEDIAN_STEP


def chroma_mask(image: Image, threshold: int) -> Image:
    """255 where the chroma exceeds the threshold, else 0, shape (H, W),
    of an RGB image (H, W, 3).
    """
    height, width = image.shape[:2]
    if height * width <= STRIP_PX:
        return cv2.threshold(chroma(image), threshold, 255, cv2.THRESH_BINARY)[1]
    mask = np.empty((height, width), np.uint8)
    rows = max(1, STRIP_PX // width)
    # reused for each strip; `chroma` would allocate six images
    buffers = np.empty((4, rows, width), np.uint8)
    for top in range(0, height, rows):
        strip = image[top : top + rows]
        r, g, b, high = buffers[:, : len(strip)]
        cv2.split(strip, (r, g, b))
        cv2.max(r, g, high)
        cv2.max(high, b, high)
        cv2.min(r, g, r)  # r is not needed any more: the minimum is built in its place
        cv2.min(r, b, r)
        cv2.subtract(high, r, high)
        cv2.threshold(high, threshold, 255, cv2.THRESH_BINARY, mask[top : top + rows])
    return mask


class Region(NamedTuple):
    """A part of an image in which blobs are searched.

    Attributes:
        image: the whole image, shape (H, W, 3). window: the part of it [px]. noise: standard
            deviation of its noise [grey levels]; if positive, blobs are segmented in the smoothed
            image, which has three eighths of it, and measured as in `_noisy_coverage`.
        rim: weights of the pixels at a blob's edge. `sharp`: by the threshold (by coverage where
            there is noise), for images of one sample a pixel; for images with smooth edges `binary`
            (in or out at half coverage) or `grey` (by coverage).
    """

    image: Image
    window: Window
    rim: Rim
    noise: float

    @property
    def searched(self) -> Image:
        """The pixels that are segmented."""
        left, top, right, bottom = self.window
        part = self.image[top:bottom, left:right]
        return _smoothed(part) if self.noise > 0 else part


def find_blobs(regions: Sequence[Region], threshold: int, least_area: float) -> list[list[Blob]]:
    """All blobs of at least `least_area` [px^2] whose chroma exceeds the threshold (0..255), in
    each of the regions (one or more).
    """
    canvas, lefts = _side_by_side([region.searched for region in regions])
    mask = chroma_mask(canvas, threshold)
    contours = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]
    boxes = [cv2.boundingRect(contour) for contour in contours]
    where = [bisect_right(lefts, box[0]) - 1 for box in boxes]
    out: list[list[Blob]] = [[] for _ in regions]
    for contour, (x, y, w, h), i in zip(contours, boxes, where, strict=True):
        if w * h < least_area:  # the box bounds the area: most specks of noise end here
            continue
        alone = mask[y : y + h, x : x + w]
        if where.count(i) > 1:  # remove the parts of other blobs from this one's box
            filled = cv2.drawContours(
                np.zeros((h, w), np.uint8), [contour], 0, 255, cv2.FILLED, offset=(-x, -y)
            )
            alone = cv2.bitwise_and(alone, filled)
        left = regions[i].window[0] + x - lefts[i]
        top = regions[i].window[1] + y
        blob = _blob(regions[i], alone, (left, top, left + w, top + h))
        if blob is not None and blob.area >= least_area:
            out[i].append(blob)
    return out


def _side_by_side(parts: list[Image]) -> tuple[Image, list[int]]:
    """Images side by side in one, a pixel apart, and the first column of each: one call of OpenCV
    takes longer to make than to run on a window of some 40 pixels.
    """
    lefts = list(accumulate((part.shape[1] + 1 for part in parts), initial=0))
    if len(parts) == 1:
        return parts[0], lefts
    canvas = np.zeros((max(map(len, parts)), lefts[-1], 3), np.uint8)
    for part, left in zip(parts, lefts[:-1], strict=True):
        canvas[: len(part), left : left + part.shape[1]] = part
    return canvas, lefts


def _blob(region: Region, alone: Image, box: Window) -> Blob | None:
    """One blob from its own pixels in its box, 255 in `alone`; None without mass.

    Moments are computed within the blob's own box (two pixels larger on each side where edge pixels
    are weighted by coverage), so that they are the same to the last bit whatever window the blob
    was found in.
    An ellipse with second central moments mu (per area) has area 4 pi sqrt(det mu); a blob that is
    smaller is partly occluded. (Coverage is an ellipse convolved with a pixel, which adds its
    variance 1/12 to mu_xx and mu_yy.)
    """
    image, _, rim, noise = region
    height, width = image.shape[:2]
    left, top = box[:2]
    weights = alone
    if noise > 0 or rim != "sharp":
        part, own, left, top = with_surroundings(image, alone, box, 2)
        if noise > 0:
            weights = _noisy_coverage(part, own, rim)
        else:
            weights = _coverage(chroma(part), own, rim)
    m = cv2.moments(weights)
    mass = m["m00"]
    if mass <= 0:
        return None
    area = mass / 255
    x = m["m10"] / mass
    y = m["m01"] / mass
    spread = 1 / 12 if rim == "grey" else 0.0
    # OpenCV's central moments are sums; divided by the mass they are variances about the centroid.
    xx = m["mu20"] / mass - spread
    yy = m["mu02"] / mass - spread
    xy = m["mu11"] / mass
    ellipse = 4 * math.pi * math.sqrt(max(xx * yy - xy * xy, 0.0))
    rough = ROUGHNESS * area + ROUGHNESS_PX[rim] + NOISE_ROUGHNESS_PX * noise
    inside = box[0] > 0 and box[1] > 0 and box[2] < width and box[3] < height
    u = left + round(x)
    v = top + round(y)
    r, g, b, _ = cv2.mean(image[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2])
    hue_deg = 360 * colorsys.rgb_to_hsv(r, g, b)[0]  # mixing in white or grey does not change a hue
    return Blob(left + x, top + y, area, hue_deg, box, whole=inside and ellipse - area <= rough)


def with_surroundings(
    image: Image, alone: Image, box: Window, px: int
) -> tuple[Image, Image, int, int]:
    """A box in an image with some pixels around it: the image there; 255 in the pixels `alone` of
    the box; its left and its top in the image [px].
    """
    left = max(box[0] - px, 0)
    top = max(box[1] - px, 0)
    part = image[top : box[3] + px, left : box[2] + px]
    own = np.zeros(part.shape[:2], np.uint8)
    own[box[1] - top : box[3] - top, box[0] - left : box[2] - left] = alone
    return part, own, left, top


def _coverage(chroma: Image, alone: Image, rim: Rim) -> Image:
    """Coverage of each pixel by a blob, 0..255, one pixel farther out than the thresholded mask.

    The coverage of an edge pixel is its chroma over the mean chroma of the blob's own pixels next
    to it, which follows shading: a fixed threshold would shift the centroid of a smoothed, shaded
    ball by .3 px towards the light. The chroma of the background (a blue sky has 15) is subtracted:
    as coverage it would add a halo one pixel wide.
    """
    chroma = chroma - chroma.min()
    own = cv2.bitwise_and(chroma, alone)
    total = cv2.boxFilter(own, cv2.CV_32F, (3, 3), normalize=False)
    count = cv2.boxFilter(alone, cv2.CV_32F, (3, 3), normalize=False)
    # chroma / (total / count); the small number keeps pixels without neighbours of the blob from
    # dividing 0 by 0.
    share = cv2.convertScaleAbs(
        cv2.divide(cv2.multiply(chroma, count, dtype=cv2.CV_32F), total + 1e-3)
    )
    edge = share if rim == "grey" else cv2.threshold(share, 127, 255, cv2.THRESH_BINARY)[1]
    edge = cv2.bitwise_and(edge, cv2.dilate(alone, _NEIGHBOURS))
    # Inside, away from the edge, coverage is full whatever the shading.
    return cv2.max(edge, cv2.erode(alone, _NEIGHBOURS))


def _noisy_coverage(part: Image, found: Image, rim: Rim) -> NDArray[np.float32]:
    """Noisy coverage of each pixel by a blob in a noisy image, in units of 1/255; `found` is the
    blob's approximate mask.

    The border is where the smoothed image has half of the local chroma; `binary` takes that alone.
    Otherwise the coverage of a pixel next to the border is its own, unsmoothed chroma over the mean
    chroma of the blob's pixels next to it, both less the background's. It may be below 0 or above
    255: clipping would bias the mean.
    """
    smooth = chroma(_smoothed(part)).astype(np.float32)
    raw = chroma(part).astype(np.float32)
    near = cv2.dilate(found, _NEIGHBOURS)
    around = cv2.dilate(near, _NEIGHBOURS) == 0
    if around.any():
        smooth -= np.median(smooth[around])
        raw -= np.median(raw[around])
    smooth[near == 0] = 0
    own = ((smooth > 0) & (2 * smooth >= cv2.dilate(smooth, _NEIGHBOURS))).astype(np.uint8)
    if rim == "binary":
        return (255 * own).astype(np.float32)
    total = cv2.boxFilter(raw * own, cv2.CV_32F, (3, 3), normalize=False)
    count = cv2.boxFilter(own, cv2.CV_32F, (3, 3), normalize=False)
    share = np.where((total > 0) & (count > 0), raw * count / np.maximum(total, 1), 0)
    return (255 * np.where(cv2.erode(own, _NEIGHBOURS) > 0, 1, share)).astype(np.float32)


def _smoothed(image: Image) -> Image:
    """The image filtered by the binomial kernel (1, 2, 1)/4 in both directions, which leaves 3/8 of
    white noise.
    """
    return cv2.GaussianBlur(image, (3, 3), 0)
