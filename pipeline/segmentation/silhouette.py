"""One particle in one view: three-state labels and the signed distance to its sub-pixel edge."""

from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Protocol

import numpy as np

from pipeline.arrays import Flags, FloatImage, GreyImage, PointsUV
from pipeline.frames import CameraId

OUTSIDE, UNKNOWN, INSIDE = np.uint8(0), np.uint8(128), np.uint8(255)
"""Labels of pixels; an unknown pixel never carves."""

MARGIN_PX = 40
"""Width of the known surroundings of a silhouette; further out, all is outside by at least this much."""

FINE_PX, COARSE_PX = 2, 6
"""Spacing of the nodes of a fine and a coarse distance field, the first of which is the region's first pixel. A voxel
is at least 2.3 px wide."""

MAX_STEP_PX = 3.0
"""Distance of neighbouring points of an outline; further apart, the edge between them was not seen."""


class ViewStatus(StrEnum):
    """What a view shows."""

    OK = "ok"
    EMPTY = "empty"
    MULTIPLE = "multiple"  # several bodies
    CLIPPED = "clipped"  # the body reaches the border of the image
    NO_BACKGROUND = "no_background"  # nothing to compare with


class FoundBy(StrEnum):
    """The segmenter that a silhouette, or the decision that there is none, is from."""

    BACKGROUND = "background"
    NETWORK = "network"
    U2NET = "u2net"
    MASK = "mask"
    """No segmenter of ours: the image was a mask already."""


class Distances(Protocol):
    """Computes signed distances to an edge, which costs as much as finding it and is not always needed."""

    def coarse_px(self) -> FloatImage:
        """Compute `Silhouette.coarse_px` (h / COARSE_PX, w / COARSE_PX), both rounded up."""

    def fine_px(self, coarse_px: FloatImage) -> FloatImage:
        """Compute `Silhouette.fine_px` (h / FINE_PX, w / FINE_PX), both rounded up, from the coarse ones."""


@dataclass(frozen=True, eq=False)
class KnownDistances:
    """Distances that are known for every pixel."""

    distance_px: FloatImage

    def coarse_px(self) -> FloatImage:
        """Return the distances of the coarse nodes."""
        return np.ascontiguousarray(self.distance_px[::COARSE_PX, ::COARSE_PX])

    def fine_px(self, coarse_px: FloatImage) -> FloatImage:
        """Return the distances of the fine nodes."""
        return np.ascontiguousarray(self.distance_px[::FINE_PX, ::FINE_PX])


NO_DISTANCES = KnownDistances(np.zeros((0, 0), np.float32))


@dataclass(frozen=True, kw_only=True, eq=False)
class Silhouette:
    """What one view shows of a particle: labels, outline and distances in a region of interest.

    Pixel (0, 0) of the region is `offset_uv` of the image. A status other than `OK` leaves the arrays empty: such a
    view carves nothing.
    """

    camera: CameraId
    status: ViewStatus
    image_size_px: tuple[int, int]  # W, H
    offset_uv: tuple[int, int] = (0, 0)
    labels: GreyImage = field(default_factory=lambda: np.zeros((0, 0), np.uint8))
    """(h, w): OUTSIDE, UNKNOWN or INSIDE."""
    outline_uv: PointsUV = field(default_factory=lambda: np.zeros((0, 2)))
    """Points on the edge in image coordinates, in order, only where the edge was seen."""
    border_uv: PointsUV = field(default_factory=lambda: np.zeros((0, 2)))
    """Points in order around all that may be body, unseen edge included; the outline where none are given."""
    edge_sigma_px: float | None = None
    """Blur of the edge, as sigma: most of the outline has no more; None where it was not measured."""
    sigmas_across_px: tuple[float, float] | None = None
    """Blur of the edges across u, and of those across v; None for a sharp edge, or without one of the two."""
    distances: Distances = NO_DISTANCES
    is_camouflaged: bool = False
    """Whether some of the body is as grey as the wall behind it, and was found by its detail alone."""
    found_by: FoundBy = FoundBy.BACKGROUND
    fallback: str | None = None
    """Why it is not by the segmenter that was asked first; reasons joined by "; "."""
    network_trouble: str | None = None
    """Why the network does not run as it should; None if it does, or was not asked."""

    @cached_property
    def coarse_px(self) -> FloatImage:
        """Signed distances (h / COARSE_PX, w / COARSE_PX): as `fine_px`, up to 3 px too small, rarely too large."""
        return self.distances.coarse_px()

    @cached_property
    def fine_px(self) -> FloatImage:
        """Signed distances (h / FINE_PX, w / FINE_PX), rounded up, in px of pixel centres to the edge.

        That is the edge of *inside or unknown*; distances are positive within.
        """
        return self.distances.fine_px(self.coarse_px)

    @property
    def reach_uv(self) -> PointsUV:
        """Points (N, 2) in order around all that may be body."""
        return self.border_uv if len(self.border_uv) else self.outline_uv

    @property
    def is_usable(self) -> bool:
        return self.status is ViewStatus.OK

    def label_image(self) -> GreyImage:
        """Return the labels of the whole image (H, W)."""
        width_px, height_px = self.image_size_px
        image = np.full((height_px, width_px), OUTSIDE)
        u, v = self.offset_uv
        height, width = self.labels.shape
        image[v : v + height, u : u + width] = self.labels
        return image


def is_beside_gap(outline_uv: PointsUV) -> Flags:
    """Mark points of an outline (N, 2) that border on an unseen stretch: the body may reach further there."""
    before = np.linalg.norm(outline_uv - np.roll(outline_uv, 1, axis=0), axis=1) > MAX_STEP_PX
    return before | np.roll(before, -1)


SilhouetteSet = dict[CameraId, Silhouette]
