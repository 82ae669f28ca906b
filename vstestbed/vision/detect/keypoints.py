"""Natural features: key points matched between the goal's picture and this one, in place of markers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, cast

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Look, Picture
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositivePixels
from vstestbed.core.spec import kind_of, spec
from vstestbed.features.observation import Goal
from vstestbed.targets.base import Target
from vstestbed.vision.base import Detection, DetectorBase, TruthView
from vstestbed.vision.goal_points import goal_of_points, points_of
from vstestbed.vision.match.features import KEYPOINTS, Extractor, Features, Matcher, Sift, extracted, grey, matched
from vstestbed.vision.match.flow import Klt, NoTracking, Tracking, followed
from vstestbed.vision.match.mutual import mutual_matches
from vstestbed.vision.match.pairs import Pairs, among, those
from vstestbed.vision.match.patches import refined, smooth, whole
from vstestbed.vision.match.planar_map import LEAST_INLIERS, PlanarMap, planar_map, spread_out
from vstestbed.vision.match.slots import Slots

SPARE, FURTHER, LEAST_TRIED = 1.5, 4, 16
"""Points whose places are measured below a pixel, as a multiple of those that are reported, since some are not found; the most, as a
multiple of the first ones; and the fewest at first, since a plane needs eight that agree."""
SLIPPED_PX = 0.25
"""A patch that is farther than this from where the other patches' homography maps it has slipped [px]."""


@dataclass(frozen=True, slots=True)
class KeypointsMemory:
    """State of the detector in a run to one goal.

    Attributes:
        goal: the goal view, with its picture.
        learned: the goal picture's key points uv (R, 2) and descriptors (R, D); None of features that match pictures themselves.
        smooth: the goal's picture as the patches are taken from it.
        slots: the points that are reported.
        last: brightness of the last picture, where points are followed from there; since: pictures since the last matching.
    """

    goal: Goal
    learned: tuple[Array, NDArray[Any]] | None
    smooth: NDArray[np.float32]
    slots: Slots
    last: NDArray[np.uint8] | None = None
    since: int = 0


@spec
class Keypoints(DetectorBase):
    """Points of the scene itself, found again by their surroundings: no markers are needed, and the target's are not looked for.

    The points are those that are matched between the picture taken at the goal and this one. They are others in every picture, so the
    detection holds the goal's view of the very points in its `best` rows; empty rows are NaN. Where fewer than `least` are found, nothing
    is reported, and the law rests, or coasts where it can.

    - Key points of both pictures (`features`) are matched by their descriptors, if each is the other's nearest.
    - With `ransac: homography` those pairs count that agree with one plane.
    - The best of them, or well spread ones, are chosen.
    - With `subpixel` the patch round each point of the goal's picture is laid over this one (`vision.match.patches`), with its scale,
    turn and perspective from the homography: 0.02 px in place of 0.1 (SIFT) to 1 px (ORB). Points whose patch is not alike, or is cut by
    a picture's border, are dropped, and the next ones take their place.

    With `track` the points of one picture are followed into the next instead, and matched again now and then.

    Depths in the goal's view are those of the target's plane, or of a depth camera. Of points beyond the target, such as the floor's,
    the plane's are wrong, hence `within: board`.

    Args:
        features: what finds, describes and matches key points: `sift`, `orb`, `akaze`, or a plugin's.
        best: most points that are reported, the number of rows [1].
        least: fewest points that are reported; with fewer nothing is seen [1]. With `ransac: homography` eight must agree with one plane
            besides, of which `best` are reported.
        choose: which of the matched points: the `distance` of whose descriptors is least, or those that are `spread` over the picture.
        ratio: a match counts only if its distance is under this share of the distance to the second nearest [1]; none: all
            mutual matches count; e.g. `0.8`.
        ransac: which matches count: those on one plane (`homography`), or all (`none`), as in a scene of several planes.
        ransac_px: how far a match may be from where the homography maps it [px].
        subpixel: measure places below a pixel by patches; needs eight matches on one plane, without which places stay as they are.
        within: which part of the goal's picture is used: all of it (`picture`), or that which shows the target's board (`board`).
        track: whether points are followed from picture to picture: `none` or `klt`.
    """

    kind: Literal["keypoints"] = "keypoints"
    features: Annotated[Features, KEYPOINTS] = Sift()
    best: Annotated[int, Ge(3), Le(200)] = 24
    least: Annotated[int, Ge(3), Le(200)] = 4
    choose: Literal["distance", "spread"] = "spread"
    ratio: Annotated[float, Gt(0), Lt(1)] | None = None
    ransac: Literal["homography", "none"] = "homography"
    ransac_px: PositivePixels = 2.0
    subpixel: bool = True
    within: Literal["picture", "board"] = "picture"
    track: Tracking = NoTracking()
    needs_image: ClassVar[bool] = True
    needs_goal: ClassVar[bool] = True
    changing = True

    def __post_init__(self) -> None:
        """Refuse numbers that contradict each other, and a ratio where no descriptors are compared."""
        if self.least > self.best:
            raise ParameterError("least", f"must be at most best = {self.best}", self.least)
        if isinstance(self.track, Klt) and (self.track.keep or 0) > self.best:
            raise ParameterError("track.keep", f"must be at most best = {self.best}", self.track.keep)
        if self.ratio is not None and self._extractor is None:
            words = f"compares descriptors, and features {self.features.kind} match pictures by themselves; leave it out"
            raise ParameterError("ratio", words, self.ratio)

    @property
    def _extractor(self) -> Extractor | None:
        """The features, if they describe key points; None of those that match pictures by themselves."""
        return None if hasattr(self.features, "match") else cast(Extractor, self.features)

    @property
    def rows(self) -> int:
        """As many as `best`."""
        return self.best

    @property
    def fleeting(self) -> bool:
        """Without tracking, others are found in every picture."""
        return isinstance(self.track, NoTracking)

    def begin(self, goal: Goal, camera: Camera, target: Target) -> KeypointsMemory:
        """The goal picture's key points.

        Raises:
            ParameterError: there is no picture of the goal, or it has fewer key points than can ever match, or fewer where they are
                looked for; or the target has no board.
        """
        if goal.image is None:
            raise ParameterError("goal.image", "is missing: detector keypoints compares with the picture taken at the goal")
        if self.within == "board" and target.board_half_m is None:
            raise ParameterError("detector.within", f"may not be board with target {kind_of(type(target))}, which has none; use picture")
        learned = self._learned(goal, target) if self._extractor else None
        return KeypointsMemory(goal, learned, smooth(grey(goal.image.image)), Slots.empty(self.best))

    @property
    def _matching(self) -> int:
        """Fewest key points of the goal's picture that must match: `least`, and as many as tell a plane where one is asked for."""
        return max(self.least, LEAST_INLIERS) if self.ransac == "homography" else self.least

    def _learned(self, goal: Goal, target: Target) -> tuple[Array, NDArray[Any]]:
        assert goal.image is not None
        assert self._extractor is not None
        uv, descriptors = extracted(self._extractor, goal.image.image)
        there = self._usable(goal, target, uv)
        if np.count_nonzero(there) < self._matching:
            raise ParameterError("detector.features", self._too_few(len(uv), int(np.count_nonzero(there))))
        return uv[there], descriptors[there]

    def _too_few(self, found: int, usable: int) -> str:
        """What is wrong with the goal's picture, in which so many key points are found and so many of them are usable."""
        plane = self._matching > self.least
        wanted = f"{self._matching} key points or more, as many as tell a plane," if plane else f"least = {self.least} key points or more"
        words = f"must find {wanted} in the goal's picture: {self.features.kind} finds {found}"
        if found < self._matching:
            return f"{words}; use a target with more texture{', or ransac: none' if plane and found >= self.least else ''}"
        if self.within == "board":
            return f"{words}, of which {usable} lie on the target's board; use a goal that shows it larger, or within: picture"
        return f"{words}, of which {usable} have a depth there; use a goal that shows more of the target's plane, or a depth camera"

    def _usable(self, goal: Goal, target: Target, uv: Array) -> NDArray[np.bool_]:
        """Which points uv (M, 2) of the goal's picture have a depth, and lie on the target's board where only those are asked for."""
        if len(uv) == 0:
            return np.zeros(0, dtype=bool)
        p = points_of(goal_of_points(goal, uv))
        there = np.asarray(np.isfinite(p).all(axis=1))
        half = target.board_half_m
        if self.within == "board" and half is not None:
            with np.errstate(invalid="ignore"):
                there &= (np.abs(p[:, :2]) <= half).all(axis=1)
        return there

    def look(self, memory: KeypointsMemory, camera: Camera, target: Target) -> Look | None:
        """None: the whole picture."""

    def detect(
        self,
        memory: KeypointsMemory,
        picture: Picture | None,
        view: TruthView | None,
        camera: Camera,
        target: Target,
        rng: np.random.Generator,
    ) -> tuple[KeypointsMemory, Detection]:
        """Matched pixels (K, 2), NaN in empty rows, and the goal's view of the same points.

        Raises:
            ParameterError: there is no picture, or `begin` was not called.
        """
        image = None if picture is None else picture.completed().image
        if image is None:
            raise ParameterError("picture", "is missing: detector keypoints needs one whole picture")
        if not isinstance(memory, KeypointsMemory):
            raise ParameterError("memory", "must be that of `begin`, which learns the goal's picture")
        dim = grey(image)
        slots = self._followed(memory, dim, camera)
        since, why = memory.since + 1, ""
        if slots is None or self._due(slots, since):
            kept = (slots.uv_goal[slots.taken], slots.uv[slots.taken]) if slots is not None else None
            pairs = self._matches(memory, image, target)
            found, agreeing = self._chosen(memory, pairs, kept, dim, camera)
            slots, since, why = memory.slots.placed(*found), 0, self._why(len(pairs[0]), agreeing, len(found[0]))
        if np.count_nonzero(slots.taken) < self.least:
            slots = memory.slots.unseen()  # those of the last picture: a law that coasts knows what it saw there
        memory = replace(memory, slots=slots, last=dim if isinstance(self.track, Klt) else None, since=since)
        return memory, Detection(slots.uv, goal=goal_of_points(memory.goal, slots.uv_goal), ids=slots.ids, why=why)

    def _why(self, matching: int, agreeing: int, measured: int) -> str:
        """Why nothing is reported though points match; "" where too few do, or enough are measured."""
        words = f"detector keypoints: {matching} points match the goal's picture, of which {agreeing} agree with one plane"
        if measured >= self.least or matching < max(self.least, LEAST_INLIERS):
            return ""
        if agreeing < self.least:
            return f"{words}: the target may have too little texture, or parts that look alike, or show too little of itself"
        words = f"{words}; of those tried the patches of {measured} are found, fewer than least = {self.least}"
        return f"{words}: the others are cut by the border or not alike; subpixel: false does without patches"

    def _due(self, slots: Slots, since: int) -> bool:
        """Whether points that were followed are to be matched with the goal's picture."""
        assert isinstance(self.track, Klt)
        keep = max(self.least, self.best // 2) if self.track.keep is None else self.track.keep
        return since >= self.track.redetect_every or int(np.count_nonzero(slots.taken)) < keep

    def _followed(self, memory: KeypointsMemory, dim: Image, camera: Camera) -> Slots | None:
        """The last picture's points where they are now, without those that are lost; None where points are not followed."""
        if memory.last is None or not isinstance(self.track, Klt):
            return None
        slots = memory.slots.moved(followed(self.track, memory.last, dim, memory.slots.uv))
        there = slots.taken
        found = planar_map(camera, slots.uv_goal[there], slots.uv[there], self.ransac_px) if there.any() else None
        if found is None:
            return slots
        plane, agree = found
        uv = slots.uv.copy()
        if self.ransac == "homography":
            uv[np.flatnonzero(there)[~agree]] = np.nan
        if self.subpixel:
            uv[there] = self._refined(memory, slots.uv_goal[there], uv[there], dim, plane)
        return slots.moved(uv)

    def _matches(self, memory: KeypointsMemory, image: Image, target: Target) -> Pairs:
        """All matches with the goal's picture, the best first."""
        if self._extractor is not None and memory.learned is not None:
            uv, descriptors = extracted(self._extractor, image)
            i, j, _ = mutual_matches(memory.learned[1], descriptors, self.ratio)
            return memory.learned[0][i], uv[j]
        assert memory.goal.image is not None
        uv_goal, uv, distance = matched(cast(Matcher, self.features), memory.goal.image.image, image)
        order = np.argsort(distance, kind="stable")
        order = order[self._usable(memory.goal, target, uv_goal)[order]]
        return uv_goal[order], uv[order]

    def _chosen(self, memory: KeypointsMemory, pairs: Pairs, kept: Pairs | None, dim: Image, camera: Camera) -> tuple[Pairs, int]:
        """The pairs that are reported: those that were followed, then others by distance or spread; and how many there were to choose."""
        first = 0 if kept is None else len(kept[0])
        if kept is not None:
            new = ~among(pairs[0], kept[0])
            pairs = np.concatenate([kept[0], pairs[0][new]]), np.concatenate([kept[1], pairs[1][new]])
        found = planar_map(camera, *pairs, self.ransac_px) if self.ransac == "homography" or self.subpixel else None
        if self.ransac == "homography":
            pairs, first = those(pairs, np.zeros(len(pairs[0]), dtype=bool) if found is None else found[1], first)
        agreeing = len(pairs[0])
        if found is None or not self.subpixel:
            return self._best(pairs, first, self.best), agreeing
        return self._measured(memory, *those(pairs, whole(dim, *pairs, found[0].derivatives(pairs[0])), first), dim, found[0]), agreeing

    def _measured(self, memory: KeypointsMemory, pairs: Pairs, first: int, dim: Image, plane: PlanarMap) -> Pairs:
        """The best pairs whose patches are found; where some are not, the next ones are tried in their place, up to a limit."""
        tried = max(round(SPARE * self.best), LEAST_TRIED)
        most = FURTHER * tried
        while True:
            some = self._best(pairs, first, tried)
            uv = self._refined(memory, *some, dim, plane)
            there = np.flatnonzero(np.isfinite(uv[:, 0]))[: self.best]
            if len(there) == self.best or len(some[0]) < tried or tried >= most:
                return some[0][there], uv[there]
            tried *= 2

    def _best(self, pairs: Pairs, first: int, most: int) -> Pairs:
        """At most `most` of the pairs, which are in the order of their distance; the `first` ones are among them."""
        index = spread_out(pairs[0], most, first) if self.choose == "spread" else np.arange(min(most, len(pairs[0])))
        return pairs[0][index], pairs[1][index]

    def _refined(self, memory: KeypointsMemory, uv_goal: Array, uv: Array, dim: Image, plane: PlanarMap) -> Array:
        """Places (M, 2) below a pixel; NaN where the pictures are not alike, or a patch has slipped off the plane."""
        found = refined(memory.smooth, smooth(dim), uv_goal, uv, plane.derivatives(uv_goal))
        better = planar_map(plane.camera, uv_goal, found, SLIPPED_PX) if self.ransac == "homography" else None
        return found if better is None else np.where(better[1][:, None], found, np.nan)
