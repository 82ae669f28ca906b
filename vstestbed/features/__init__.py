"""Image features: what a law servoes on. Each gives s (`measure`), L (`interaction`) and s - s* (`error`)."""

from vstestbed.core.spec import OneOf
from vstestbed.features.base import Feature
from vstestbed.features.line import Line
from vstestbed.features.log_depth import LogDepth
from vstestbed.features.point import Point
from vstestbed.features.polar import Polar
from vstestbed.features.polygon import Polygon
from vstestbed.features.spherical import Spherical
from vstestbed.features.theta_u import ThetaU
from vstestbed.features.translation import Translation

FEATURES = OneOf("feature", Point, Polar, Spherical, Polygon, Line, default="point")
"""What pixels tell; depth and pose as measurements (LogDepth, ThetaU, Translation) are the business of other laws."""

__all__ = ["FEATURES", "Feature", "Line", "LogDepth", "Point", "Polar", "Polygon", "Spherical", "ThetaU", "Translation"]
