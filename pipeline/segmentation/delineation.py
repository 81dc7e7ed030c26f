"""Where exactly a body ends that was found roughly: grey levels decide between its core and what is possible.

A pixel at the edge mixes body and background, I = c s + (1 - c) B. With the background B known and
the body's grey level s carried outwards from just inside the edge, the coverage c follows, and the
edge is where c = 1/2: half-way between the *local* grey levels on both sides, whatever the texture,
the light or a gradient of the background. A symmetric blur does not move it.

Who found the body does not matter: a comparison with the empty rig or a network gives the core and
the possible pixels, never the edge.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from pipeline.frames import Frame
from pipeline.segmentation.edge import Contours, Edge
from pipeline.segmentation.grey_levels import GreyLevels, carried, crossings, decide
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN, Silhouette, ViewStatus
from pipeline.segmentation.steepest import to_steepest

Grey = NDArray[np.uint8]
Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

MIN_CONTRAST = 0.12
"""Of the body's level to the background, as a share of it; below, grey levels do not tell them apart."""
HOLE_PX = 400
"""Holes up to this area are glints on the body, larger ones are seen through."""
N_ROUNDS = 4
"""How often what is unknown may grow beside an edge that is not the body's."""
BESIDE_GAP = 3
"""So many points beside an edge that was not seen are not either."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Delineation:
    """The body in a region of an image."""

    labels: Grey  # (h, w) OUTSIDE, UNKNOWN or INSIDE
    edge: Edge | None
    """Of the body and of the unknown pixels that it may extend behind; `None` where nothing is inside."""


def delineate(
    image: Grey | Array,
    expected: Array,
    core: Mask,
    possible: Mask,
    unknown: Mask,
    *,
    gain: float = 1.0,
    min_contrast: float = MIN_CONTRAST,
    hole_px: int = HOLE_PX,
) -> Delineation:
    """The largest body with its sub-pixel edge between `core` and the border of `possible`.

    Parameters
    ----------
    image
        (h, w) grey levels of a region.
    expected
        (h, w) grey level of what is behind the body, in this light once `gain` is applied.
    core
        Surely body, and not at its blurred edge: its grey level is carried outwards. This mask and the next
        two are (h, w), or of half that size, rounded up, where each pixel stands for a block of 2 x 2.
    possible
        Outside of it nothing is body.
    unknown
        Grey levels mean nothing here, unless it is core.
    gain
        Factor on `expected`, which is looked at only near the edge.
    min_contrast
        Least difference of the body's level from `expected`, as a share of it; below, pixels are unknown.
    hole_px
        Holes of the body up to this area are filled.
    """
    known = np.maximum(INSIDE * core, UNKNOWN * unknown)
    is_half = core.shape != image.shape
    view = GreyLevels(
        image=image if image.flags.c_contiguous and image.flags.writeable else image.copy(),
        expected=expected,
        gain=np.float32(gain),
        known=known,
        open_cells=np.flatnonzero(np.asarray(possible) & (known == OUTSIDE)),
        halvings=int(is_half),
    )
    labels = _doubled(known, image.shape) if is_half else known.copy()
    levels = carried(view)
    if not (decide(view, levels, np.float32(min_contrast), labels) or np.any(core)):
        return Delineation(labels=labels, edge=None)
    for _ in range(N_ROUNDS):  # what became unknown belongs to the body, whose edge is then further out
        body, contours = _largest_with_holes_filled(labels, hole_px)
        if body is not labels:
            labels = np.where(labels == UNKNOWN, UNKNOWN, INSIDE * body)
        points_uv, seen = crossings(view, levels, body, labels, np.concatenate(contours)[:, 0])
        n_doubtful = 0
        for part in np.split(np.arange(len(seen)), np.cumsum([len(contour) for contour in contours[:-1]])):
            along = slice(part[0], part[-1] + 1)
            n_doubtful += to_steepest(
                view.image,
                expected,
                view.gain,
                np.float32(min_contrast),
                labels,
                points_uv[along],
                seen[along],
            )
        if n_doubtful == 0:
            break
    # the last points before a gap already bend towards what hides the edge
    seen = minimum_filter1d(seen, 2 * BESIDE_GAP + 1, mode="wrap")
    edge = Edge(body=body, contours=contours, points_uv=points_uv, seen=seen.view(np.bool_))
    return Delineation(labels=labels, edge=edge)


def silhouette_of(
    frame: Frame, corner_uv: tuple[int, int], delineation: Delineation, found_by: str = "background"
) -> Silhouette:
    """The silhouette in a frame, of whose region with this upper left corner `delineation` is.

    The region must reach `MARGIN_PX` beyond the body, or to the border of the image.
    """
    height_px, width_px = frame.image.shape
    (left, top), (height, width) = corner_uv, delineation.labels.shape
    if delineation.edge is None:
        return no_body(frame, ViewStatus.EMPTY, found_by)
    labels = delineation.labels
    if (
        (top == 0 and INSIDE in labels[0])
        or (left == 0 and INSIDE in labels[:, 0])
        or (top + height == height_px and INSIDE in labels[-1])
        or (left + width == width_px and INSIDE in labels[:, -1])
    ):
        return no_body(frame, ViewStatus.CLIPPED, found_by)
    return Silhouette(
        camera=frame.camera,
        status=ViewStatus.OK,
        image_size_px=(width_px, height_px),
        offset_uv=corner_uv,
        labels=labels,
        outline_uv=delineation.edge.outline_uv + np.array(corner_uv),
        measure_distance=delineation.edge.distance_px,
        found_by=found_by,
    )


def no_body(frame: Frame, status: ViewStatus, found_by: str = "background") -> Silhouette:
    """What a frame gives that shows no usable body."""
    height_px, width_px = frame.image.shape
    return Silhouette(
        camera=frame.camera, status=status, image_size_px=(width_px, height_px), found_by=found_by
    )


def _doubled(mask: Grey, shape: tuple[int, ...]) -> Grey:
    """The mask at twice its size, cut to this shape."""
    height, width = mask.shape
    doubled = np.empty((height, 2, 2 * width), np.uint8)
    doubled[:] = (mask * np.uint16(0x0101)).view(np.uint8)[:, None]  # the same byte twice
    return np.ascontiguousarray(doubled.reshape(2 * height, 2 * width)[: shape[0], : shape[1]])


def _largest_with_holes_filled(labels: Grey, hole_px: int) -> tuple[Grey, Contours]:
    """The component of `labels` (h, w) with most of the inside, and its contours, the outer one first.

    A connected body's silhouette is connected. The component may be `labels` themselves.
    """
    found, hierarchy = cv2.findContours(labels, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    contours = [np.asarray(contour, np.int32) for contour in found]
    if len(contours) == 1:
        return labels, contours
    largest, size = 0, -1
    for index, contour in enumerate(contours):
        if hierarchy[0][index][3] >= 0 or cv2.contourArea(contour) + len(contour) <= size:
            continue  # a hole, or too small to win
        u, v, width, height = cv2.boundingRect(contour)
        part = np.zeros((height, width), np.uint8)
        cv2.drawContours(part, [contour], 0, 1, cv2.FILLED, offset=(-u, -v))
        is_inside = labels[v : v + height, u : u + width] == INSIDE
        n_inside = int(np.count_nonzero(is_inside & part.view(np.bool_)))
        if n_inside > size:
            largest, size = index, n_inside
    body, kept = np.zeros_like(labels), [contours[largest]]
    cv2.drawContours(body, contours, largest, 1, cv2.FILLED)
    hole = int(hierarchy[0][largest][2])
    while hole >= 0:
        if cv2.contourArea(contours[hole]) > hole_px:
            cv2.drawContours(body, contours, hole, 0, cv2.FILLED)
            cv2.drawContours(body, contours, hole, 1, 1)  # a hole's contour runs on the body's pixels
            kept.append(contours[hole])
        hole = int(hierarchy[0][hole][0])
    return body, kept
