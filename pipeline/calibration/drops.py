"""A ball in the views of one exposure: what a calibration is made from."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import CameraId

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BallView:
    """One ball in one view."""

    outline_uv: Array
    """(N, 2) sub-pixel points of the outline, evenly spread in angle where it was seen, outliers removed."""
    center_uv: Array
    """(2,) of the fitted ellipse, hence the centroid of the silhouette; not the image of the ball's centre."""
    radius_px: float  # mean of the ellipse's semi-axes
    rms_px: float  # of the outline against that ellipse


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BallDrop:
    """One exposure of a ball."""

    name: str
    diameter_mm: float | None  # as entered; `None` when unknown
    views: Mapping[CameraId, BallView]
    refused: Mapping[CameraId, str] = field(default_factory=dict)  # views left out, each with the reason
    fall_ns: int | None = None
    """From the light gate to the exposure, but for an unknown constant: it is the difference of two devices'
    clocks. For the direction of the fall."""
