"""Square fiducial tags (AprilTag, ArUco): found and decoded by OpenCV, refined along their edges,
tracked in windows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import compress
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Picture, Regions, Window
from vstestbed.core.geometry import Array
from vstestbed.core.lazy import cv2
from vstestbed.core.quantity import PositivePixels
from vstestbed.core.spec import spec
from vstestbed.targets.base import Target
from vstestbed.targets.markers import Marker, Tag
from vstestbed.vision.base import Detection, DetectorBase, Move, TruthView, windows_round
from vstestbed.vision.local_features import brightness
from vstestbed.vision.pnp import solve_pose_from_rays

# Subpixel corners of tags: the four edges measured in the grey image and intersected, good to
# hundredths of a pixel.

# positions along an edge at which it is measured, shares of its length, without the blurred corners
ALONG = np.linspace(0.1, 0.9, 16)
# these positions on the sides of the unit square (4, 2, S), and the sides' outward normals
SIDES = np.array(
    [
        [ALONG, 0 * ALONG],
        [0 * ALONG + 1, ALONG],
        [1 - ALONG, 0 * ALONG + 1],
        [0 * ALONG, 1 - ALONG],
    ]
)
OUTWARDS = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]])[:, :, None]
ACROSS = np.linspace(-1, 1, 25)  # samples of one profile across an edge, in units of its reach
ENDS = 3  # samples at each end of a profile whose mean is its black or white level
# half length of a profile in modules: it ends within the black border and within the white quiet
# zone ...
REACH = 0.65
MOST_REACH_PX = 4.0  # ... and its limit [px], beyond any blur of the order of a pixel
Edges = tuple[Array, Array, Array, Array]
"""The measured edges of N tags: corners (N, 4, 2) [px]; largest distance of a measured point from
its line (N,) [px]; least step from black to white as a share of the tag's median step (N,); least
distance of a profile's ends from the picture's border (N,) [px], negative outside.
"""


def measure_edges(grey: Image, corners: Array, modules: int) -> Edges:
    """The edges of tags of so many modules a side; their corners (N, 4, 2) [px], clockwise from the
    upper left, are known to half a module.

    Profiles of intensity I are sampled across an edge along the tag's own rows and columns, mapped
    into the image by the corners' homography, so that they end within one module also on a tilted
    tag. Along a profile of length 2 r from black b to white w the edge lies at r (1 - 2 mean(I -
    b)/(w - b)), which no symmetrical blur shifts. Lines are fitted to these points by total least
    squares; their intersections are the corners.
    """
    # parallel lines give NaN, which fails every check of a tag
    with np.errstate(divide="ignore", invalid="ignore"):
        edges = _measured_once(grey, corners, modules)
        for _ in range(3):
            # another round would move them by a fraction of that
            if np.abs(edges[0] - corners).max() < 0.02:
                break
            corners = edges[0]
            edges = _measured_once(grey, edges[0], modules)
    return edges


def _measured_once(grey: Image, corners: Array, modules: int) -> Edges:
    size = np.array([grey.shape[1], grey.shape[0]]) - 1
    middle, reach = _profiles(corners, modules)
    where = (middle[..., None, :] + ACROSS[:, None] * reach[..., None, :]).astype(np.float32)
    u, v = np.moveaxis(where.reshape(1, -1, 2), -1, 0)
    profile = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    profile = profile.astype(float).reshape(where.shape[:-1])
    # The edge's place in each profile, from -1 at its inner to 1 at its outer end, and the step's
    # height.
    black = profile[..., :ENDS].mean(axis=-1)
    white = profile[..., -ENDS:].mean(axis=-1)
    step = white - black
    mean = np.trapezoid(profile, axis=-1) / (len(ACROSS) - 1)
    share = np.clip(1 - 2 * (mean - black) / np.maximum(step, 1.0), -1, 1)
    measured, misfit = _cross(middle + share[..., None] * reach)
    contrast = step.min(axis=(1, 2)) / np.maximum(np.median(step, axis=(1, 2)), 1.0)
    # Samples outside of the image repeat its border pixels; a negative distance rejects the tag.
    border = np.minimum(where, size - where).min(axis=(1, 2, 3, 4))
    return measured, np.abs(misfit).max(axis=(1, 2)), contrast, border


def _profiles(corners: Array, modules: int) -> tuple[Array, Array]:
    """Midpoints of the profiles and the vectors from there to their outer ends, both (N, 4, S, 2)
    [px].

    Homography of the unit square from its corners: Heckbert 1989, Fundamentals of Texture Mapping
    and Image Warping, section 2.2.3.
    """
    a, b, c, d = (corners[:, k] for k in range(4))
    e = b - c
    f = d - c
    s = a - b + c - d
    area = _cross2(e, f)
    g = _cross2(s, f) / area
    h = _cross2(e, s) / area
    H = np.zeros((len(corners), 3, 3))
    H[:, :2, 0] = b - a + g[:, None] * b
    H[:, :2, 1] = d - a + h[:, None] * d
    H[:, :2, 2] = a
    H[:, 2] = np.stack([g, h, np.ones_like(g)], axis=-1)
    out = REACH / modules * OUTWARDS
    reach = (_mapped(H, SIDES + out) - _mapped(H, SIDES - out)) / 2
    long = np.linalg.norm(reach, axis=-1, keepdims=True)
    return _mapped(H, SIDES), reach * np.minimum(1, MOST_REACH_PX / np.maximum(long, 1e-9))


def _cross2(p: Array, q: Array) -> Array:
    return p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]


def _mapped(H: Array, p: Array) -> Array:
    """Points (4, 2, S) of the unit square mapped into the image by homographies (N, 3, 3), shape
    (N, 4, S, 2).
    """
    q = np.einsum("nij,ejs->nesi", H[:, :, :2], p) + H[:, None, None, :, 2]
    return q[..., :2] / q[..., 2:]


def _cross(points: Array) -> tuple[Array, Array]:
    """Intersections (N, 4, 2) of the lines through points (N, 4, S, 2), and the points' distances
    from their lines (N, 4, S).
    """
    mean = points.mean(axis=2)
    d = points - mean[:, :, None]
    xx = (d[..., 0] ** 2).sum(-1)
    yy = (d[..., 1] ** 2).sum(-1)
    xy = (d[..., 0] * d[..., 1]).sum(-1)
    # the scatter matrix's minor axis, in closed form
    angle = np.arctan2(2 * xy, xx - yy) / 2 + np.pi / 2
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    lines = np.concatenate([normal, -(normal * mean).sum(-1, keepdims=True)], axis=-1)
    # Homogeneous lines: their cross product is the point of intersection.
    crossed = np.cross(np.roll(lines, 1, axis=1), lines)
    return crossed[..., :2] / crossed[..., 2:], (d * normal[:, :, None]).sum(-1)


# Printed tags: images of each family's tags, for the textures of the scene.

# texels along a module: a power of two, so that the edges stay between texels at every level of
# OpenGL's mipmap
PX_PER_MODULE = 16


@lru_cache
def dictionary(family: str) -> Any:
    """OpenCV's dictionary of a family of tags."""
    kind, _, name = family.partition("_")
    word = f"DICT_APRILTAG_{name}" if kind == "apriltag" else f"DICT_{name.upper()}"
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, word))


def tag_picture(tag: Tag, number: int, px: int = PX_PER_MODULE) -> NDArray[np.uint8]:
    """A tag with its quiet zone of one module, `px` pixels a module: 0 and 255, shape (px
    (modules + 2),) * 2.
    """
    black = cv2.aruco.generateImageMarker(dictionary(tag.family), number, tag.modules * px)
    return np.pad(black, px, constant_values=255)


def printed(marker: Marker, i: int) -> tuple[str, bytes]:
    """Name and PNG file of what is printed on marker i of a target.
    Raises TypeError: nothing is.
    """
    # the one marker with a print; the picture comes from OpenCV, which targets do without
    if not isinstance(marker, Tag):
        raise TypeError(f"nothing is printed on a {marker.kind}")
    number = marker.first_id + i
    _, file = cv2.imencode(".png", tag_picture(marker, number))
    return f"{marker.family}_{number}", file.tobytes()


# index of the camera's panel in which a tag is seen, and its corners (4, 2) there [px]
Found = tuple[int, Array]
# margin of a window as a share of the tag's size, for the white quiet zone that OpenCV needs;
# besides the margin in pixels
QUIET = 0.25


@dataclass(frozen=True, slots=True)
class TagsState:
    """Each tag's corners (4, 2) in the last picture [px] (None for a lost one), their last known
    moves [px], the last known pose.
    """

    corners: tuple[Array | None, ...] = ()
    moves: tuple[Move, ...] = ()
    T_camera_target: Array | None = None


@spec
class Tags(DetectorBase):
    """Markers that are fiducial tags, identified by their number; a marker's pixel is the image of
    its tag's centre.

    OpenCV finds and decodes the tags, with corners good to a pixel. From there each edge is
    measured in the grey image and the four lines are intersected (`measure_edges`): corners to .01
    px, without a constant offset. (OpenCV's own refinements leave .4 to .7 px on rendered tags of
    20 to 75 px.) The diagonals of the corners' rays intersect in the centre's ray, whatever the
    perspective and the lens. The pose is solved from all corners; one tag suffices.

    A tracked tag is searched in a window around its predicted position; when one is not found
    there, the whole image of the same exposure is searched. A tag is rejected if it touches the
    image's border, if it is misread, or if a point of its edges is off its line or without contrast
    (occlusion). Tags need about 2 px a module.

    Args:
        astray_px: largest distance of an edge's point from the edge's line [px].
        misread: how many of a tag's modules may be read wrongly; 3 finds more of the tags under 2
            px a module, and also tags whose inner modules are occluded.
        contrast: least step from black to white at an edge's point, as a share of the tag's median
            step [1].
        window_margin_px: margin of a window around the predicted tag and its quiet zone, besides
            half of its last move [px].

    Reference: Garrido-Jurado et al. 2014, doi:10.1016/j.patcog.2014.01.005 (finding and reading
    square tags).
    """

    kind: Literal["tags"] = "tags"
    astray_px: PositivePixels = 1.0
    misread: Annotated[int, Ge(0), Le(3)] = 0
    contrast: Annotated[float, Gt(0), Lt(1)] = 0.4
    window_margin_px: Annotated[int, Ge(2), Le(8192)] = 8
    needs_image: ClassVar[bool] = True
    markers: ClassVar[tuple[str, ...]] = ("tag",)

    def init(self) -> TagsState:
        """Nothing seen yet."""
        return TagsState()

    def regions_of_interest(
        self, state: TagsState, camera: Camera, target: Target
    ) -> Regions | None:
        """The windows of the next picture; None for everything,
        always so in a camera with panels.
        """
        windows = self._windows(state, camera)
        return None if windows is None else (tuple(windows),)

    def detect(
        self,
        state: TagsState,
        picture: Picture | None,
        view: TruthView | None,
        camera: Camera,
        target: Target,
        rng: np.random.Generator,
    ) -> tuple[TagsState, Detection]:
        """Tag centres (N, 2) [px] in one picture, NaN where not seen, and the pose (4, 4) where it
        can be solved.
        """
        picture = self._given(picture)
        tag = target.marker
        n = len(target.points)
        assert isinstance(tag, Tag)  # a scenario refuses others
        found = self._track(_greys(picture), state, camera, tag, n)
        if found is None:
            found = self._search(_greys(picture.completed()), camera, tag, n)
        uv, T = _measure(found, state.T_camera_target, camera, target, tag)
        corners = tuple(found[i][1] if i in found else None for i in range(n))
        kept = T if T is not None else state.T_camera_target
        after = TagsState(corners, _moves(state, corners), kept)
        return after, Detection(uv=uv, T_camera_target=T)

    def _windows(self, state: TagsState, camera: Camera) -> list[Window] | None:
        boxes = [None if c is None else _box(c) for c in state.corners]
        return windows_round(boxes, state.moves, camera, self.window_margin_px)

    def _track(
        self, greys: list[Image | None], state: TagsState, camera: Camera, tag: Tag, n: int
    ) -> dict[int, Found] | None:
        """All tags, each from a window of its own; None where one is lost and the whole image must
        be searched.
        """
        windows = self._windows(state, camera)
        grey = greys[0]
        if windows is None or grey is None:
            return None
        rough: dict[int, Array] = {}
        for i, window in enumerate(windows):
            quads = _read(grey, window, tag, n, self.misread)
            if i not in quads:
                return None
            rough[i] = quads[i]
        whole = self._whole(grey, rough, tag)
        return {i: (0, corners) for i, corners in whole.items()} if len(whole) == n else None

    def _search(
        self, greys: list[Image | None], camera: Camera, tag: Tag, n: int
    ) -> dict[int, Found]:
        """The tags found in whole images; where panels overlap,
        in the panel whose axis is nearer.
        """
        found: dict[int, Found] = {}
        cosines: dict[int, float] = {}
        for panel, grey in enumerate(greys):
            if grey is None:
                continue
            rough = _read(grey, (0, 0, grey.shape[1], grey.shape[0]), tag, n, self.misread)
            for i, corners in self._whole(grey, rough, tag).items():
                cosine = float(camera.panels[panel].lens.ray(corners.mean(axis=0))[2])
                if cosine > cosines.get(i, -2.0):
                    cosines[i] = cosine
                    found[i] = panel, corners
        return found

    def _whole(self, grey: Image, rough: dict[int, Array], tag: Tag) -> dict[int, Array]:
        if not rough:
            return {}
        measured, astray, contrast, border = measure_edges(
            grey, np.stack(list(rough.values())), tag.modules
        )
        good = (astray <= self.astray_px) & (contrast >= self.contrast) & (border >= 0)
        return dict(compress(zip(rough, measured, strict=True), good))


def _moves(state: TagsState, corners: Sequence[Array | None]) -> tuple[Move, ...]:
    """How each tag has moved since the last picture [px]; the last known move of one that was not
    seen then, or is not now.
    """
    if not state.corners:
        return ((0.0, 0.0),) * len(corners)
    moves: list[Move] = []
    for before, now, move in zip(state.corners, corners, state.moves, strict=True):
        if before is not None and now is not None:
            du, dv = (now - before).mean(axis=0).tolist()
            move = du, dv
        moves.append(move)
    return tuple(moves)


def _greys(picture: Picture) -> list[Image | None]:
    return [None if image is None else brightness(image) for image in picture.images]


def _read(grey: Image, window: Window, tag: Tag, n: int, misread: int) -> dict[int, Array]:
    """OpenCV's corners (4, 2) [px], by marker, of the target's tags that it decodes in a window of
    the image.
    """
    left, top, right, bottom = window
    quads, markers, _ = _reader(tag.family, tag.first_id, n, misread).detectMarkers(
        grey[top:bottom, left:right]
    )
    rough: dict[int, Array] = {}
    if markers is None:
        return rough
    for quad, marker in zip(quads, markers.ravel().tolist(), strict=True):
        corners = quad.reshape(4, 2).astype(float)
        out = corners - corners.mean(axis=0)
        # OpenCV's corners are centres of the outermost black pixels, and lie so far inside the
        # black square.
        inside = math.sqrt(0.5) * out / np.linalg.norm(out, axis=1, keepdims=True)
        rough[marker] = corners + (left, top) + inside
    return rough


@lru_cache
def _reader(family: str, first: int, n: int, misread: int) -> Any:
    """OpenCV's detector for n tags of a family, numbered from 0: searched ten times as fast as the
    whole family of 587.
    """
    whole = dictionary(family)
    how = cv2.aruco.DetectorParameters()
    how.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    how.errorCorrectionRate = 1.0
    own = cv2.aruco.Dictionary(whole.bytesList[first : first + n], whole.markerSize, misread)
    return cv2.aruco.ArucoDetector(own, how)


def _measure(
    found: dict[int, Found], previous: Array | None, camera: Camera, target: Target, tag: Tag
) -> tuple[Array, Array | None]:
    """Images of all centres (N, 2) [px] in the camera's own image, and the pose, from the corners
    (4, 2) of the tags found.
    """
    uv = np.full((len(target.points), 2), np.nan)
    if not found:
        return uv, None
    seen = list(found)
    rays = np.stack([camera.panels[panel].ray(corners) for panel, corners in found.values()])
    # normals of the planes through the camera and each diagonal
    diagonals = np.cross(rays[:, :2], rays[:, 2:])
    centre = np.cross(diagonals[:, 0], diagonals[:, 1])
    # The planes intersect in a line through the camera; of its two directions take the one towards
    # the corners.
    centre *= np.sign((centre * rays.sum(axis=1)).sum(axis=-1, keepdims=True))
    uv[seen] = camera.project(centre)
    points = target.points[seen][:, None] + tag.corners
    return uv, solve_pose_from_rays(rays.reshape(-1, 3), points.reshape(-1, 3), previous)


def _box(corners: Array) -> Window:
    low = corners.min(axis=0)
    high = corners.max(axis=0)
    room = QUIET * (high - low).max()
    left, top = (low - room).tolist()
    right, bottom = (high + room + 1).tolist()
    return int(left), int(top), math.ceil(right), math.ceil(bottom)
