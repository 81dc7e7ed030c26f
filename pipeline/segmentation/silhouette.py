"""One particle in one view: three-state labels and the signed distance to its sub-pixel edge."""

from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import CameraId

OUTSIDE, UNKNOWN, INSIDE = np.uint8(0), np.uint8(128), np.uint8(255)

MARGIN_PX = 40
"""Width of the known surroundings of a silhouette; further out, all is outside by at least this much."""

FINE_PX, COARSE_PX = 2, 6
"""Between the nodes of a field of distances, the first of which is the region's first pixel. A voxel is 2.3 px wide
and more."""

MAX_STEP_PX = 3.0
"""Neighbouring points of an outline are closer; further apart, the edge between them was not seen."""


class ViewStatus(StrEnum):
    """What a view shows."""

    OK = "ok"
    EMPTY = "empty"
    MULTIPLE = "multiple"
    CLIPPED = "clipped"
    NO_BACKGROUND = "no_background"


class Distances(Protocol):
    """Computes signed distances to an edge, which costs as much as finding it and is not always asked for."""

    def coarse_px(self) -> NDArray[np.float32]:
        """(h / COARSE_PX, w / COARSE_PX), both rounded up: `Silhouette.coarse_px`."""

    def fine_px(self, coarse_px: NDArray[np.float32]) -> NDArray[np.float32]:
        """(h / FINE_PX, w / FINE_PX), both rounded up, from the coarse ones: `Silhouette.fine_px`."""


@dataclass(frozen=True, eq=False)
class KnownDistances:
    """Distances that need not be computed."""

    distance_px: NDArray[np.float32]  # (h, w)

    def coarse_px(self) -> NDArray[np.float32]:
        """Those of the coarse nodes."""
        return np.ascontiguousarray(self.distance_px[::COARSE_PX, ::COARSE_PX])

    def fine_px(self, coarse_px: NDArray[np.float32]) -> NDArray[np.float32]:
        """Those of the fine nodes."""
        return np.ascontiguousarray(self.distance_px[::FINE_PX, ::FINE_PX])


NOWHERE = KnownDistances(np.zeros((0, 0), np.float32))


@dataclass(frozen=True, kw_only=True, eq=False)
class Silhouette:
    """Arrays cover a region of interest only; its pixel (0, 0) is `offset_uv` of the image.

    A status other than `OK` leaves the arrays empty: such a view carves nothing.
    """

    camera: CameraId
    status: ViewStatus
    image_size_px: tuple[int, int]  # W, H
    offset_uv: tuple[int, int] = (0, 0)
    labels: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0), np.uint8))
    """(h, w): OUTSIDE, UNKNOWN or INSIDE."""
    outline_uv: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    """(N, 2) points on the edge in image coordinates, in order, only where the edge was seen."""
    distances: Distances = NOWHERE
    found_by: str = "background"
    """Name of the segmenter that made it."""
    fallback: str | None = None
    """Why it was not the one that was wanted."""

    @cached_property
    def coarse_px(self) -> NDArray[np.float32]:
        """(h / COARSE_PX, w / COARSE_PX), rounded up: as `fine_px`, up to 3 px too small, hardly ever too large."""
        return self.distances.coarse_px()

    @cached_property
    def fine_px(self) -> NDArray[np.float32]:
        """(h / FINE_PX, w / FINE_PX), rounded up: signed distances in px of pixel centres to the edge.

        That is the edge of *inside or unknown*; they are positive within.
        """
        return self.distances.fine_px(self.coarse_px)

    @property
    def is_usable(self) -> bool:
        return self.status is ViewStatus.OK

    def label_image(self) -> NDArray[np.uint8]:
        """(H, W) labels of the whole image."""
        width_px, height_px = self.image_size_px
        image = np.full((height_px, width_px), OUTSIDE)
        u, v = self.offset_uv
        height, width = self.labels.shape
        image[v : v + height, u : u + width] = self.labels
        return image


def is_beside_gap(outline_uv: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Points (N,) of an outline (N, 2) from which the edge goes on unseen: the body may reach further there."""
    before = np.linalg.norm(outline_uv - np.roll(outline_uv, 1, axis=0), axis=1) > MAX_STEP_PX
    return before | np.roll(before, -1)


SilhouetteSet = dict[CameraId, Silhouette]
