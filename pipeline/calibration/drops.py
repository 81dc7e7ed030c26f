"""The input of a calibration: one ball in the views of one exposure."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from pipeline.arrays import PointsUV, Vector2
from pipeline.frames import CameraId


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BallView:
    """One ball in one view."""

    outline_uv: PointsUV
    """Sub-pixel points of the outline, evenly spread in angle where it was seen, outliers removed."""
    center_uv: Vector2
    """Centre of the fitted ellipse, hence the centroid of the silhouette; not the image of the ball's centre."""
    radius_px: float  # mean of the ellipse's semi-axes
    rms_px: float  # distance of the outline from that ellipse
    edge_sigma_px: float | None = None  # blur of the edge, as sigma; `None` where it was not measured


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BallDrop:
    """One exposure of a ball."""

    name: str
    diameter_mm: float | None  # as entered; `None`: unknown
    views: Mapping[CameraId, BallView]
    refused: Mapping[CameraId, str] = field(default_factory=dict)  # unusable views, each with the reason
    fall_ns: int | None = None
    """Time from the light gate to the exposure plus an unknown constant, as it is the difference of two devices'
    clocks; it serves to find the direction of the fall."""
