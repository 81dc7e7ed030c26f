"""The sub-pixel edge of a body that was found roughly, placed by grey levels alone.

A pixel at the edge mixes body and background, I = c s + (1 - c) B. With the background B known and
the body's grey level s extrapolated from just inside the edge, the coverage c follows, and the
edge is where c = 1/2: half-way between the *local* grey levels on both sides, whatever the texture,
the light or a gradient of the background. A symmetric blur does not move it. From there each point is
moved to the steepest slope across the edge (`edge_refinement`).

How the body was found does not matter: a comparison with the empty rig or a network gives a trimap
(core, possible and unknown pixels), never the edge.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from math import ceil

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import FloatImage, GreyImage, Mask, PointsUV
from pipeline.frames import Frame
from pipeline.segmentation.detail import is_wall, told_by_detail
from pipeline.segmentation.edge_refinement import (
    N_COLUMNS,
    SHARP_SIGMA_PX,
    find_doubtful,
    move_to_steepest,
    undo_shrinkage,
)
from pipeline.segmentation.edge_width import local_sigmas_px, outline_sigmas_px, sigmas_across_px
from pipeline.segmentation.local_threshold import CELL_PX, OPEN, RegionLevels, find_crossings, threshold
from pipeline.segmentation.noise import TYPICAL_NOISE, SensorNoise
from pipeline.segmentation.outline_fill import closed_up, redraw
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN, FoundBy, Silhouette, ViewStatus
from pipeline.segmentation.subpixel_edge import SubpixelEdge
from pipeline.segmentation.unseen_edge import bridge_gaps, fill_doubtful_hole, make_unknown

Contours = Sequence[NDArray[np.int32]]
"""Pixels (N, 1, 2) around components, as OpenCV gives them."""

MIN_CONTRAST = 0.12
"""Least contrast of body and background, as a share of the background; below, grey levels do not tell them apart."""
HOLE_PX = 400
"""Holes up to this area are glints on the body, larger ones are seen through."""
PART_SHARE = 0.02
"""Share of the largest component's area from which on another is a part of the body: a second body was ruled out."""
MAX_ROUNDS = 4
"""How often the unknown may grow where an edge turns out not to be the body's."""
NOISE_ROWS, MAX_TURNS = 16, 64
"""Every 16th row is looked at; with more changes between body and background in a row, on average, there is no body but
a broken sensor: to follow 100 000 contours takes seconds."""
MAX_SHARP_SIGMA_PX = 1.25
"""Sigma up to which most of an edge counts as sharp: steps of 2 px still see all of it."""
MAX_DOUBTFUL_SHARE = 0.005
"""Share of doubtful points of an outline taken for sharp from which on its widest parts decide."""
CORE_SIGMAS = 3.0
"""Sigmas by which the core of a blurred body begins further within."""
MAX_SCALE = 8.0
"""Greatest width of an edge, relative to a sharp one: its profile then still ends within a silhouette's margin."""
LOW_CONTRAST = 0.05
"""Least difference of a body from the wall in the second look, which detail has told from each other."""
MIN_CAMOUFLAGED_PX = 10
"""Pixels of the body that looked like wall, but for their detail, from which on grey levels are in doubt elsewhere."""
GAP_MARGIN = 3
"""Points beside an unseen stretch of edge that are discarded as well."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Delineation:
    """The body in a region of an image."""

    labels: GreyImage  # (h, w) OUTSIDE, UNKNOWN or INSIDE
    edge: SubpixelEdge | None
    """The edge of the body and of the unknown pixels that it may extend behind; `None` where nothing is inside."""
    edge_sigma_px: float | None = None  # blur of most of the edge, `None` where it cannot be measured
    sigmas_across_px: tuple[float, float] | None = None  # of a blurred edge: across u and across v
    is_camouflaged: bool = False  # whether some of the body looked like wall but for its detail


def delineate(
    image: GreyImage,
    expected: GreyImage,
    trimap: GreyImage,
    *,
    gain: float = 1.0,
    noise: SensorNoise = TYPICAL_NOISE,
    min_contrast: float = MIN_CONTRAST,
    hole_px: int = HOLE_PX,
) -> Delineation:
    """Find the largest body and its sub-pixel edge, between its core and the border of what is possible.

    Where that leaves holes, or stretches of the outline unseen, what has detail is body.

    Arrays must be contiguous and writable: compiled loops are compiled again for other kinds.

    Parameters
    ----------
    image
        (h, w) grey levels of the region of an image that is looked at.
    expected
        (h, w) grey levels of the background, in this light once `gain` is applied.
    trimap
        (h / 2, w / 2), rounded up, of cells of 2 x 2 pixels: INSIDE what is surely body, and not at its blurred edge
        (its grey level is extrapolated outwards); UNKNOWN where grey levels mean nothing; elsewhere OPEN if it may
        be body, or else OUTSIDE.
    gain
        Factor on `expected`.
    noise
        That of the image's pixels.
    min_contrast
        Least difference of the body's level from `expected`, as a share of it; below, pixels are unknown.
    hole_px
        Holes of the body up to this area are filled.
    """
    region = RegionLevels(image=image, expected=expected, gain=np.float32(gain), trimap=trimap)
    found = _delineated(region, min_contrast, hole_px, noise)
    if found.edge is not None and len(found.edge.ends) == 2 and found.edge.seen.all():
        return found
    cells = slice(None, None, CELL_PX), slice(None, None, CELL_PX)
    is_core, is_bare = told_by_detail(image[cells], expected[cells], gain, noise)
    is_bare &= trimap != UNKNOWN
    region = region._replace(trimap=np.where(is_core, INSIDE, trimap))
    again = _delineated(region, LOW_CONTRAST, hole_px, noise, is_bare)
    n_found = int(np.count_nonzero((again.labels == INSIDE) & (found.labels == OUTSIDE)))
    return replace(again, is_camouflaged=n_found > MIN_CAMOUFLAGED_PX)


def _delineated(
    region: RegionLevels, min_contrast: float, hole_px: int, noise: SensorNoise, bare: Mask | None = None
) -> Delineation:
    trimap = region.trimap
    labels, levels, is_inside = threshold(region, min_contrast)
    if not is_inside or _is_noise(labels):
        return Delineation(labels=labels, edge=None)
    contours = _trace(region, labels, levels, hole_px, noise)
    sigma_px, widest_px = outline_sigmas_px(region, *_outer(contours))
    n_doubtful, is_blurred = 0, sigma_px > MAX_SHARP_SIGMA_PX
    if not is_blurred:
        n_doubtful = _place_edge(region, labels, contours, min_contrast, is_blurred)
        is_blurred = widest_px > MAX_SHARP_SIGMA_PX and n_doubtful > MAX_DOUBTFUL_SHARE * len(
            contours.points_uv
        )
    across_px = None
    if is_blurred:  # the edge reaches into the core: its level is not the body's
        across_px = sigmas_across_px(region, *_outer(contours))
        region = region._replace(trimap=_with_deeper_core(trimap, widest_px))
        labels, levels, _ = threshold(region, min_contrast)
        contours = _trace(region, labels, levels, hole_px, noise)
        n_doubtful = _place_edge(region, labels, contours, min_contrast, is_blurred)
    for _ in range(MAX_ROUNDS - 1):
        if n_doubtful == 0:
            break
        # what became unknown belongs to the body, whose edge is then further out
        contours = _trace(region, labels, levels, hole_px, noise)
        n_doubtful = _place_edge(region, labels, contours, min_contrast, is_blurred)
    points_uv, seen = _outer(contours)
    if 0 < np.count_nonzero(seen) < len(seen) and bridge_gaps(labels, points_uv, seen):
        contours = _trace(region, labels, levels, hole_px, noise)
        _place_edge(region, labels, contours, min_contrast, is_blurred)
    if bare is not None:  # the body does not reach where the wall is seen
        height, width = labels.shape
        is_wall_there = bare.repeat(CELL_PX, axis=0).repeat(CELL_PX, axis=1)[:height, :width]
        labels[is_wall_there & (labels == UNKNOWN)] = OUTSIDE
        contours = _trace(region, labels, levels, hole_px, noise)
        _place_edge(region, labels, contours, min_contrast, is_blurred)
    body, points_uv, ends = contours.body, contours.points_uv, contours.ends
    seen = contours.seen.view(np.uint8)
    if is_blurred:
        body = redraw(points_uv, ends, labels)
        points_uv, seen, ends = closed_up(points_uv, seen, ends)
    if np.count_nonzero(seen) < len(seen):
        # the last points before a gap already bend towards what hides the edge
        around = seen.take(np.arange(-GAP_MARGIN, len(seen) + GAP_MARGIN), mode="wrap")
        seen = np.lib.stride_tricks.sliding_window_view(around, 2 * GAP_MARGIN + 1).min(axis=1)
    edge = SubpixelEdge(body=body, points_uv=points_uv, ends=ends, seen=seen.view(np.bool_))
    return Delineation(labels=labels, edge=edge, edge_sigma_px=sigma_px or None, sigmas_across_px=across_px)


def _trace(
    region: RegionLevels, labels: GreyImage, levels: FloatImage, hole_px: int, noise: SensorNoise
) -> SubpixelEdge:
    """Return the contours of the largest body in `labels` (h, w), their points half-way between the local levels."""
    body, contours = _largest_with_holes_filled(labels, hole_px)
    if len(contours) > 1:
        contours = [contours[0], *_seen_through(region, body, labels, contours[1:], noise)]
    pixels_uv = (contours[0] if len(contours) == 1 else np.concatenate(contours))[:, 0]
    ends = np.array([0, *accumulate(map(len, contours))])
    points_uv, seen = np.empty(pixels_uv.shape), np.empty(len(pixels_uv), np.uint8)
    find_crossings(region, levels, body, labels, pixels_uv, points_uv, seen)
    return SubpixelEdge(body=body, points_uv=points_uv, ends=ends, seen=seen.view(np.bool_))


def _seen_through(
    region: RegionLevels, body: GreyImage, labels: GreyImage, holes: Contours, noise: SensorNoise
) -> Contours:
    """Return the holes that show the wall; the others are filled: body, as bright there as the wall."""
    kept = []
    for hole in holes:
        within = np.zeros_like(body)
        cv2.drawContours(within, [hole], 0, 1, cv2.FILLED)
        within &= body == OUTSIDE
        if is_wall(within, region.image, region.expected, float(region.gain), noise):
            kept.append(hole)
        else:
            body[within != 0] = labels[within != 0] = INSIDE
    return kept


def _outer(contours: SubpixelEdge) -> tuple[PointsUV, GreyImage]:
    """Return the points of the outer contour, and whether each is seen: views, which can be changed in place."""
    return contours.points_uv[: contours.ends[1]], contours.seen[: contours.ends[1]].view(np.uint8)


def _with_deeper_core(trimap: GreyImage, sigma_px: float) -> GreyImage:
    """Return the trimap with a core that begins `CORE_SIGMAS` further within: what it loses is open."""
    side = 2 * ceil(CORE_SIGMAS * sigma_px / CELL_PX) + 1
    core = (trimap == INSIDE).view(np.uint8)
    deeper = cv2.erode(core, np.ones((side, side), np.uint8), borderValue=0)
    return np.where((core != 0) & (deeper == 0), OPEN, trimap)


def _place_edge(
    region: RegionLevels, labels: GreyImage, contours: SubpixelEdge, min_contrast: float, is_blurred: bool
) -> int:
    """Move all points to where the edge is steepest; return how many turn out not to lie on the body's.

    A blurred edge is looked at in units of its width, twice, since half-way between the levels is further off there.
    """
    points_uv, seen = contours.points_uv, contours.seen.view(np.uint8)
    scales = np.ones(len(points_uv), np.float32)
    scratch = np.empty((len(points_uv), N_COLUMNS), np.float32)
    n_doubtful = 0
    for first, end in pairwise(contours.ends.tolist()):
        own = slice(first, end)
        edge = points_uv[own], seen[own], scales[own], scratch[own]
        if is_blurred:
            sigmas_px = local_sigmas_px(region, points_uv[own], seen[own])
            scales[own] = np.nan_to_num(sigmas_px / SHARP_SIGMA_PX, nan=1.0).clip(1.0, MAX_SCALE)
            move_to_steepest(region, *edge)
        move_to_steepest(region, *edge)
        n = find_doubtful(region, np.float32(min_contrast), labels, *edge)
        if first > 0:
            fill_doubtful_hole(labels, points_uv[own], n + int(np.count_nonzero(seen[own] == 0)))
        n_doubtful += n
        if is_blurred:
            undo_shrinkage(*edge)
    return n_doubtful


def silhouette_of(
    frame: Frame,
    corner_uv: tuple[int, int],
    delineation: Delineation,
    found_by: FoundBy = FoundBy.BACKGROUND,
) -> Silhouette:
    """Return the silhouette in a frame, from the delineation of its region with this upper left corner.

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
    outline_uv, border_uv = delineation.edge.outline_uv, delineation.edge.border_uv
    for points_uv in (outline_uv, border_uv):
        for axis in range(2):  # to add both to each point takes ten times as long
            points_uv[:, axis] += corner_uv[axis]
    return Silhouette(
        camera=frame.camera,
        status=ViewStatus.OK,
        image_size_px=(width_px, height_px),
        offset_uv=corner_uv,
        labels=labels,
        outline_uv=outline_uv,
        border_uv=border_uv,
        edge_sigma_px=delineation.edge_sigma_px,
        sigmas_across_px=delineation.sigmas_across_px,
        distances=delineation.edge,
        is_camouflaged=delineation.is_camouflaged,
        found_by=found_by,
    )


def no_body(frame: Frame, status: ViewStatus, found_by: FoundBy = FoundBy.BACKGROUND) -> Silhouette:
    """Return the silhouette of a frame without a usable body."""
    height_px, width_px = frame.image.shape
    return Silhouette(
        camera=frame.camera, status=status, image_size_px=(width_px, height_px), found_by=found_by
    )


def _is_noise(labels: GreyImage) -> bool:
    """True when labels (h, w) change too often along the rows for a body."""
    rows = labels[::NOISE_ROWS]
    return bool(np.count_nonzero(rows[:, 1:] != rows[:, :-1]) > MAX_TURNS * len(rows))


def _largest_with_holes_filled(labels: GreyImage, hole_px: int) -> tuple[GreyImage, Contours]:
    """Return the component of `labels` (h, w) with most of the inside, and its contours, the outer one first.

    A connected body's silhouette is connected: what lies between large parts of it is unknown. Small components are
    written into `labels` as outside, small holes as inside; unknown pixels stay. The component may be `labels` itself.
    """
    found, hierarchy = cv2.findContours(labels, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    contours = [np.asarray(contour, np.int32) for contour in found]
    if len(contours) == 1:
        return labels, contours
    outer = [index for index in range(len(contours)) if hierarchy[0][index][3] < 0]
    outer.sort(key=lambda index: -cv2.contourArea(contours[index]))
    n_inside = {index: _count_inside(labels, contours[index]) for index in outer}
    largest = max(outer, key=lambda index: n_inside[index])
    parts = [contours[index] for index in outer if n_inside[index] > PART_SHARE * n_inside[largest]]
    if len(parts) > 1 and n_inside[largest] > 0:
        make_unknown(labels, np.asarray(cv2.convexHull(np.concatenate(parts)), np.float64)[:, 0])
        return _largest_with_holes_filled(labels, hole_px)
    is_known = (labels != UNKNOWN).view(np.uint8)
    body = labels if cv2.countNonZero(is_known) == labels.size else labels.copy()
    kept = [contours[largest]]
    for other in outer:
        if other != largest:
            cv2.drawContours(body, [contours[other]], 0, int(OUTSIDE), cv2.FILLED)
    hole = int(hierarchy[0][largest][2])
    while hole >= 0:
        if cv2.contourArea(contours[hole]) > hole_px:
            kept.append(contours[hole])
        else:
            cv2.drawContours(body, [contours[hole]], 0, int(INSIDE), cv2.FILLED)
        hole = int(hierarchy[0][hole][0])
    if body is not labels:
        cv2.copyTo(body, is_known, labels)
    return body, kept


def _count_inside(labels: GreyImage, contour: NDArray[np.int32]) -> int:
    """Return the number of pixels of labels (h, w) that are inside and within an outer contour."""
    u, v, width, height = cv2.boundingRect(contour)
    part = np.zeros((height, width), np.uint8)
    cv2.drawContours(part, [contour], 0, int(INSIDE), cv2.FILLED, offset=(-u, -v))
    return int(np.count_nonzero(labels[v : v + height, u : u + width] & part == INSIDE))
