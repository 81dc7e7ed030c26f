"""Where exactly a body ends that was found roughly: grey levels decide between its core and what is possible.

A pixel at the edge mixes body and background, I = c s + (1 - c) B. With the background B known and
the body's grey level s carried outwards from just inside the edge, the coverage c follows, and the
edge is where c = 1/2: half-way between the *local* grey levels on both sides, whatever the texture,
the light or a gradient of the background. A symmetric blur does not move it.

Who found the body does not matter: a comparison with the empty rig or a network gives the core and
the possible pixels, never the edge.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from pipeline.compiled import compiled
from pipeline.frames import Frame
from pipeline.segmentation.edge import Contours, Edge
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN, Silhouette, ViewStatus
from pipeline.segmentation.steepest import to_steepest

Grey = NDArray[np.uint8]
Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

REACH_PX = 6
"""The body's grey level is the mean of the core up to so far away along rows and columns."""
FAR_PX = 32
"""The same for slivers too thin for a core, and edges beside the unknown, that ask further around."""
N_SAMPLES = 3
"""Every so many-th part of that reach is asked: (2 N_SAMPLES + 1)^2 pixels."""
BLOCK_PX = 4
"""The level is the same for the pixels of a block of this edge."""
MIN_CONTRAST = 0.12
"""Of the body's level to the background, as a share of it; below, grey levels do not tell them apart."""
HOLE_PX = 400
"""Holes up to this area are glints on the body, larger ones are seen through."""
N_ROUNDS = 4
"""How often what is unknown may grow beside an edge that is not the body's."""
BESIDE_GAP = 3
"""So many points beside an edge that was not seen are not either."""
LEAST_COVERAGE = 0.025
"""Coverages are cut off here and at one less this before their probit is taken."""


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
    view = _View(
        image=image if image.flags.c_contiguous and image.flags.writeable else image.copy(),
        expected=expected,
        gain=np.float32(gain),
        known=known,
        open_cells=np.flatnonzero(np.asarray(possible) & (known == OUTSIDE)),
        halvings=int(is_half),
    )
    labels = _doubled(known, image.shape) if is_half else known.copy()
    levels = _carried(view)
    if not (_decide(view, levels, np.float32(min_contrast), labels) or np.any(core)):
        return Delineation(labels=labels, edge=None)
    for _ in range(N_ROUNDS):  # what became unknown belongs to the body, whose edge is then further out
        body, contours = _largest_with_holes_filled(labels, hole_px)
        if body is not labels:
            labels = np.where(labels == UNKNOWN, UNKNOWN, INSIDE * body)
        points_uv, seen = _crossings(view, levels, body, labels, np.concatenate(contours)[:, 0])
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


class _View(NamedTuple):
    """What decides between core and possible."""

    image: Grey | Array  # (h, w)
    expected: Array  # (h, w)
    gain: np.float32  # factor on `expected`
    known: Grey  # INSIDE the core, or UNKNOWN, else OUTSIDE; (h, w) or half of it
    open_cells: NDArray[np.int64]  # (N,) flat indices of its pixels that are to be decided
    halvings: int  # 1 if it is of half the size, else 0


@compiled
def _carried(view: _View) -> Array:
    """Grey level of the body, the same for the pixels of a block (h / BLOCK_PX, w / BLOCK_PX).

    NaN where nothing is to be decided.
    """
    image, known, halvings = view.image, view.known, view.halvings
    height, width = image.shape
    levels = np.full((height // BLOCK_PX + 1, width // BLOCK_PX + 1), np.nan, np.float32)
    typical = np.float32(np.nan)
    for cell in view.open_cells:
        row, column = cell // known.shape[1], cell % known.shape[1]
        # and for the pixels next to it, between which the edge may run
        first_y, last_y = max((row << halvings) - 1, 0) // BLOCK_PX, ((row + 1) << halvings) // BLOCK_PX
        first_x, last_x = max((column << halvings) - 1, 0) // BLOCK_PX, ((column + 1) << halvings) // BLOCK_PX
        for y in range(first_y, min(last_y + 1, levels.shape[0])):
            for x in range(first_x, min(last_x + 1, levels.shape[1])):
                if not np.isnan(levels[y, x]):
                    continue
                v, u = y * BLOCK_PX + BLOCK_PX // 2, x * BLOCK_PX + BLOCK_PX // 2
                level = _mean_around(image, known, halvings, v, u, REACH_PX)
                if np.isnan(level):
                    level = _mean_around(image, known, halvings, v, u, FAR_PX)
                if np.isnan(level):  # no core far and wide: what may be body, its edge included
                    if np.isnan(typical):
                        typical = np.float32(0)
                        for other in view.open_cells:
                            other_row, other_column = other // known.shape[1], other % known.shape[1]
                            typical += np.float32(image[other_row << halvings, other_column << halvings])
                        typical /= len(view.open_cells)
                    level = typical
                levels[y, x] = level
    return levels


@compiled
def _mean_around(
    image: Grey | Array, known: Grey, halvings: int, v: int, u: int, reach_px: int
) -> np.float32:
    """Mean of the core's pixels in a sparse window, NaN of none."""
    height, width = image.shape
    step = max(reach_px // N_SAMPLES, 1)
    reach_px = N_SAMPLES * step
    total, n = np.float32(0), np.float32(0)
    for y in range(max(v - reach_px, v % step), min(v + reach_px + 1, height), step):
        for x in range(max(u - reach_px, u % step), min(u + reach_px + 1, width), step):
            if known[y >> halvings, x >> halvings] == INSIDE:
                total += np.float32(image[y, x])
                n += np.float32(1)
    return total / n


@compiled
def _decide(view: _View, levels: Array, min_contrast: np.float32, labels: Grey) -> bool:
    """Label what is possible and not yet known (h, w); whether any of it is inside."""
    image, expected, gain, halvings = view.image, view.expected, view.gain, view.halvings
    (height, width), n_columns = image.shape, view.known.shape[1]
    is_inside = False
    for cell in view.open_cells:
        row, column = cell // n_columns, cell % n_columns
        for v in range(row << halvings, min((row + 1) << halvings, height)):
            for u in range(column << halvings, min((column + 1) << halvings, width)):
                behind = gain * expected[v, u]
                contrast = behind - levels[v // BLOCK_PX, u // BLOCK_PX]
                if abs(contrast) < min_contrast * behind:
                    labels[v, u] = UNKNOWN
                elif (behind - image[v, u]) / contrast > 0.5:
                    labels[v, u] = INSIDE
                    is_inside = True
    return is_inside


@compiled
def _crossings(
    view: _View, levels: Array, body: Grey, labels: Grey, pixels_uv: NDArray[np.int32]
) -> tuple[NDArray[np.float64], Grey]:
    """Points (N, 2): the mean crossing of the edge beside each pixel (N, 2), and whether it was seen (N,).

    Under a Gaussian blur of any width the probit of the coverage is linear across the edge.
    """
    image, expected, gain = view.image, view.expected, view.gain
    known, halvings = view.known, view.halvings
    height, width = body.shape
    points_uv, seen = np.empty((len(pixels_uv), 2)), np.ones(len(pixels_uv), np.uint8)
    for i in range(len(pixels_uv)):
        u, v = pixels_uv[i, 0], pixels_uv[i, 1]
        within, n = 0.0, 0
        points_uv[i] = 0
        for neighbour in range(-1, 4):
            x, y = u, v  # the pixel itself first
            if neighbour >= 0:
                x += (neighbour == 0) - (neighbour == 1)
                y += (neighbour == 2) - (neighbour == 3)
                if not (0 <= x < width and 0 <= y < height) or body[y, x]:
                    continue
            coverage = 1.0
            if known[y >> halvings, x >> halvings] != INSIDE:
                behind = gain * expected[y, x]
                coverage = float((behind - image[y, x]) / (behind - levels[y // BLOCK_PX, x // BLOCK_PX]))
            probit = _probit(min(max(coverage, LEAST_COVERAGE), 1 - LEAST_COVERAGE))
            if labels[y, x] == UNKNOWN:
                seen[i] = 0
            if neighbour < 0:
                within = probit
                continue
            share = 0.5
            if seen[i] and within >= 0 >= probit and within > probit:
                share = within / (within - probit)
            points_uv[i, 0] += u + share * (x - u)
            points_uv[i, 1] += v + share * (y - v)
            n += 1
        if n > 0:
            points_uv[i] /= n
        else:  # at the border of the region
            points_uv[i, 0], points_uv[i, 1], seen[i] = u, v, 0
    return points_uv, seen


@compiled
def _probit(coverage: float) -> float:
    """Quantile of the normal distribution for 0.025..0.975, the middle of P. J. Acklam's approximation (1e-8)."""
    q = coverage - 0.5
    r = q * q
    above = (
        (((-39.69683028665376 * r + 220.9460984245205) * r - 275.9285104469687) * r + 138.3577518672690) * r
        - 30.66479806614716
    ) * r + 2.506628277459239
    below = (
        (((-54.47609879822406 * r + 161.5858368580409) * r - 155.6989798598866) * r + 66.80131188771972) * r
        - 13.28068155288572
    ) * r + 1.0
    return q * above / below
