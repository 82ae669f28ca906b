"""The points of a law: which it can use, where those are that a frame does not show, and a
potential that keeps them in the picture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera.base import FORWARD_COSINE, pixel_interaction
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, all_finite, exp, homogeneous, lengths, skew, transform
from vstestbed.core.quantity import Pixels, PositivePixels
from vstestbed.core.spec import spec
from vstestbed.features.base import Feature
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.solve import least_squares, units_of

__all__ = [
    "ALL",
    "NO_AREA",
    "NO_POSE",
    "TOO_FEW",
    "Rows",
    "Visibility",
    "at_goal",
    "check_goal",
    "check_margin",
    "inputs_in_space",
    "moved_markers",
    "points",
    "reckoned_markers",
    "usable_rows",
]

Rows = slice | NDArray[np.bool_]  # selection of markers along the first axis of an array
TOO_FEW = "too few markers in sight"
NO_DEPTH = "the depth of the markers in sight is unknown"
NO_POSE = "the pose cannot be estimated"
# Reasons for rest (`Command.rest_reason`); a run that ends as `target_lost` quotes them
NO_AREA = "the markers in sight span no area"
ALL = slice(None)


def usable_rows(observation: Observation, inputs: tuple[str, ...], needed: int) -> Rows | str:
    """The markers with all inputs known, or the reason for rest if there are fewer than needed.

    observation: of this frame. inputs: names of fields of the observation, the first of image
    coordinates (N, 2) or rays (N, 3), the others (N,). needed: the least number of markers.
    """
    if len(observation.uv) >= needed:
        for name in inputs:
            if not all_finite(getattr(observation, name)):
                break
        else:
            return ALL  # the usual frame: a slice gives views, where a mask would copy
    usable = np.isfinite(getattr(observation, inputs[0])[:, 0])
    seen = usable
    for name in inputs[1:]:
        usable = usable & np.isfinite(getattr(observation, name))
    if np.count_nonzero(usable) >= needed:
        return usable
    return TOO_FEW if np.count_nonzero(seen) < needed else NO_DEPTH


def at_goal(feature: Feature, goal: Goal) -> tuple[Array, Array] | None:
    """Both inputs of a feature in a goal view, of the markers that count and are in it; None where
    the feature needs more.
    """
    x, distance = (getattr(goal, name) for name in feature.inputs)
    known = np.isfinite(x[:, 0])
    if goal.counted is not None:
        known &= goal.counted
    return (x[known], distance[known]) if np.count_nonzero(known) >= feature.least_markers else None


def check_goal(feature: Feature, goal: Goal) -> None:
    """Refuse a goal view at which a feature cannot work, as its own `check_goal` says, where it has
    one.
    """
    check = getattr(feature, "check_goal", None)
    inputs = at_goal(feature, goal)
    if check is not None and inputs is not None:
        check(*inputs)


# What a frame does not show, dead-reckoned from the last one by the motion of the camera relative
# to the target.

# time constant with which a marker that is not seen loses its weight against those that are seen
TRUST_S = 0.04


def points(observation: Observation) -> Array:
    """The markers in the camera frame by the law's own depths or ranges, shape (N, 3) [m]; NaN
    where one is not known.
    """
    if observation.ray is not None and observation.range is not None:
        return observation.ray * observation.range[:, None]
    return homogeneous(observation.xy) * observation.depth[:, None]


def inputs_in_space(observation: Observation) -> tuple[str, str]:
    """The fields that tell where markers are: rays where the law has them, as points beside or
    behind a wide lens have no xy.
    """
    if observation.ray is None or observation.range is None:
        return "xy", "depth"
    return "ray", "range"


def moved_markers(observation: Observation, p: Array, which: NDArray[np.bool_]) -> Observation:
    """The observation with its markers `which` (N,) at p (N, 3) [m] in the camera frame; `uv`
    stays: it is what the picture shows.
    """
    reach = lengths(p)
    ray = p / reach
    with np.errstate(invalid="ignore"):
        xy = ray[:, :2] / np.where(ray[:, 2:] > FORWARD_COSINE, ray[:, 2:], np.nan)
    new = {
        "xy": np.where(which[:, None], xy, observation.xy),
        "depth": np.where(which, p[:, 2], observation.depth),
    }
    if observation.ray is not None and observation.range is not None:
        new["ray"] = np.where(which[:, None], ray, observation.ray)
        new["range"] = np.where(which, reach[:, 0], observation.range)
    return replace(observation, **new)


def reckoned_markers(
    seen: Observation,
    last: Observation,
    motion: Array,
    unseen_s: Array,
    longest_s: float,
    basis: Array | None,
) -> Observation:
    """`seen` with the markers that it lacks where those of `last` are after a `motion` (4, 4) of
    the target in the camera frame.

    The markers are one rigid body, and four of them tell lateral motion from tilt by little: one
    that is off by the thousandth part of its distance against the others may cost a law a twentieth
    of it. So, with a basis, all that are not seen are moved further by exp(-B c), where c minimises
    sum of w_i^2 |r_i - r_i(c)|^2: r_i are the unit rays, as measured where the marker is seen (w =
    1), as dead-reckoned where it is not, with w = exp(-unseen_s / TRUST_S).
    Without a basis, all markers are dead-reckoned, also those that are seen, as the rest would not
    fit to them.

    unseen_s: for how long each marker has not been seen (N,) [s]. longest_s: those that were unseen
    for longer are left out. basis: the robot's motions (6, n), or None where too few markers are
    seen to correct the others by.
    """
    p = transform(motion, points(last))
    known = np.isfinite(p[:, 0]) & seen.same(last)
    kept = known & (unseen_s <= longest_s)
    if basis is None:
        return moved_markers(seen, p, kept)
    kept &= ~seen.seen
    if not kept.any():
        return seen
    ahead = homogeneous(seen.xy)
    rays = ahead / lengths(ahead) if seen.ray is None else seen.ray
    measured = known & np.isfinite(rays[:, 0])
    use = measured | kept
    reach = lengths(p[use])
    r = p[use] / reach
    w = np.where(measured, 1.0, np.exp(-unseen_s / TRUST_S))[use, None]
    change = np.where(measured[use, None], rays[use] - r, 0.0)
    # p_dot = -v - w x p of a fixed point, and so r_dot = -(I - r r^T) v / |p| + r x w.
    L = np.concatenate(
        [(r[:, :, None] * r[:, None, :] - np.eye(3)) / reach[:, :, None], skew(r)], axis=-1
    )
    c = least_squares((w[:, :, None] * L).reshape(-1, 6) @ basis, (w * change).ravel())
    return moved_markers(seen, transform(exp(-basis @ c), p), kept)


# A repulsive potential at the border of the image, for all image-based laws.

# least distance to the border that enters the field, as a share of the margin: at 0 the potential
# is infinite
NEAREST = 0.2


@spec
class Visibility:
    """Markers within a margin of the border of the image are pushed inwards.

    The border is that of the image; for fisheye and catadioptric lenses also the image circle (and
    the blind spot of a mirror). A marker is lost when its edge passes the border, not its centre.

    With d the distance of a marker's edge to a border, d0 the margin and x = d/d0, the field is the
    negative gradient of the potential (1/x - 1)^2 / 2: the desired image velocity inwards is

    f = strength (1/x - 1)/x^2  [px/s],

    zero beyond the margin. The camera follows it in the least-squares sense, u = pinv(L B) f with
    the rows of the pixels in the margin. One marker at the border pans the camera; all of them, as
    in a large rotation, make it retreat.

    Args:
        margin_px: d0 [px]; 0 switches the field off.
        strength_pxps: a quarter of the speed of the field at half the margin (x = 1/2) [px/s].

    Reference: Corke & Hutchinson 2001, section IV, doi:10.1109/70.954764 (the potential, there for
    translation along the optical axis only).
    """

    margin_px: Pixels = 0.0
    strength_pxps: PositivePixels = 20.0

    @property
    def inputs(self) -> tuple[str, ...]:
        """The fields of an Observation that the field needs besides those of its law: none where it
        is off.
        """
        return ("radius_px",) if self.margin_px > 0 else ()

    def check(self, goal: Goal, marker_radius_m: float, called: Callable[[int], str] = str) -> None:
        """Refuse a goal with a marker inside the margin: the field would keep the camera away from
        it.

        called: what messages call a marker.

        Raises ParameterError: a marker of the goal view is inside the margin, or the image has no
        border.
        """
        if self.margin_px == 0:
            return
        if len(goal.camera.panels) > 1:
            raise ParameterError.fixed(
                "law.visibility.margin_px",
                "0",
                self.margin_px,
                where="with a camera that sees all round",
                why="its image has no border",
            )
        check_margin("law.visibility.margin_px", self.margin_px, goal, marker_radius_m, called)

    def push(self, observation: Observation, goal: Goal, basis: Array) -> Array:
        """The additional motion (n,) [m/s, rad/s] that drives markers off the border; zero if none
        is near. `goal` has the lens.
        """
        nothing = np.zeros(basis.shape[1])
        rows = usable_rows(observation, inputs_in_space(observation), 1)
        if isinstance(rows, str):
            return nothing
        radius = 0.0 if observation.radius_px is None else observation.radius_px[rows]
        distance, inwards = goal.camera.borders(observation.uv[rows])
        x = np.clip((distance - np.reshape(radius, (-1, 1))) / self.margin_px, NEAREST, 1.0)
        # the wanted image velocity (N, 2) [px/s]
        speed = np.einsum("nb,nbk->nk", self.strength_pxps * (1 / x - 1) / x**2, inwards)
        near = speed.any(axis=1)
        if not near.any():
            return nothing
        L = pixel_interaction(goal.camera, points(observation)[rows][near])
        units = units_of(goal, basis)
        return units * least_squares(L.reshape(-1, 6) @ basis * units, speed[near].ravel())


def check_margin(
    field: str, margin_px: float, goal: Goal, marker_radius_m: float, called: Callable[[int], str]
) -> None:
    """Refuse a goal with a marker inside a margin of the border, which would keep it from there."""
    radius = goal.camera.half_size(goal.ray * goal.range[:, None], marker_radius_m).max(axis=1)
    nearest = np.where(
        goal.counted is None or goal.counted,
        goal.camera.borders(goal.uv)[0].min(axis=1) - radius,
        np.inf,
    )
    marker = int(nearest.argmin())
    if nearest[marker] <= margin_px:
        words = (
            f"reaches marker {called(marker)} of the goal view,"
            f" whose edge is {nearest[marker]:.4g} px from the border, and would keep it"
            " off its goal; use less, or a goal farther back"
        )
        raise ParameterError(field, words, margin_px)
