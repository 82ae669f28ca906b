"""Image features: what a law servoes on. Each gives s (`measure`), L (`interaction`) and s - s*
(`error`).
"""

from dataclasses import fields

from vstestbed.core.registry import Contract, Registry
from vstestbed.features.base import Feature
from vstestbed.features.line import LineFeature, Segment
from vstestbed.features.moments import Ellipse, Moments
from vstestbed.features.observation import Goal, Observation
from vstestbed.features.points import Point, Polar, Spherical, StereoPoint
from vstestbed.features.polygon import Polygon
from vstestbed.features.pose import ThetaU

# A feature is computed for the current view and for the goal view: its inputs must be fields of
# both.
_IN_BOTH = {
    f.name
    for f in fields(Observation)
    if hasattr(Goal, f.name) or f.name in Goal.__dataclass_fields__
}
_VIEW_FIELDS = sorted({*_IN_BOTH, "xyw"})
FEATURES = Registry(
    "feature",
    *(Point, Polar, Spherical, StereoPoint, Polygon, LineFeature, Segment, Moments, Ellipse),
    default="point",
    contract=Contract(Feature, words={"inputs": _VIEW_FIELDS}),
)
"""Features of image points, for `ibvs`; ThetaU takes a rotation, and other laws combine it with
others.
"""

__all__ = [
    "FEATURES",
    "Ellipse",
    "Feature",
    "LineFeature",
    "Moments",
    "Point",
    "Polar",
    "Polygon",
    "Segment",
    "Spherical",
    "StereoPoint",
    "ThetaU",
]
