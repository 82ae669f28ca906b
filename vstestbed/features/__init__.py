"""Image features: what a law servoes on. Each gives s (`measure`), L (`interaction`) and s - s* (`error`)."""

from vstestbed.features.base import Feature
from vstestbed.features.point import Point
from vstestbed.spec import OneOf

FEATURES = OneOf("feature", Point, default="point")

__all__ = ["FEATURES", "Feature", "Point"]
