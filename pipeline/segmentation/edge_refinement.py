"""The edge where grey levels change most, and whether it is the body's: for points roughly on it.

Half-way between two grey levels is the edge only if both levels are known, and beside a wet or shaded rim
the body's is not. The steepest slope across the edge needs neither, and no symmetric blur moves it. Whether
it is the body's edge, and not that of a highlight within it, the empty background tells: just outside of
the body's edge the image is what was expected there.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled, compiled_within, whole
from pipeline.segmentation.local_threshold import GreyLevels
from pipeline.segmentation.silhouette import OUTSIDE, UNKNOWN
from pipeline.segmentation.subpixel_edge import along

Grey = NDArray[np.uint8]
Array = NDArray[np.float32]

TANGENT_REACH = 3
"""The edge runs from the point so many before to the one so many after."""
BACK, ON = whole(-1), whole(1)
"""Steps along it."""
STEP_PX = np.float32(0.5)
"""Of the profile across the edge."""
N_SLOPES = 7
"""Steps at which the slope is taken: it is steepest at one of them, the first and last excepted."""
SPAN = 4
"""Steps over which a slope is taken: 2 px, three times the lens's blur."""
N_STEPS = N_SLOPES + SPAN
LANES = 8
"""Slopes are kept in rows of so many, which the processor adds at once."""
SMOOTH, INWARDS, REST, BEHIND, HEIGHT, N_NOTES = LANES, 16, 18, 19, 20, 21
"""What is noted of each point, after the slopes across the edge there: these smoothed along it, its inward normal (2,),
what is left of the body just outside, the level there, and the greatest slope; and the length of it all."""
LEAST_SLOPE = np.float32(0.04)
"""Of an edge, as a share of what is behind over `SPAN`; grain and noise have less."""
BEYOND_PX = np.float32(3.0)
"""So far outside of an edge neither lens nor motion show the body."""
REST_SHARE = np.float32(0.3)
"""Of the least contrast of a body: a greater difference from the expected there is still body,"""
LEAST_REST = np.float32(8.0)
"""if it is beyond noise as well, in grey levels."""
WEIGHTS = tuple(np.array([1, 4, 6, 4, 1], np.float32) / 16)
"""Of a point and its neighbours along the edge, against noise."""
DOUBT_PX = 4
"""Around a doubtful point so much is unknown."""


@compiled
def to_steepest(
    view: GreyLevels,
    min_contrast: np.float32,
    labels: Grey,
    points_uv: NDArray[np.float64],
    seen: Grey,
    notes: Array,
) -> int:
    """Move the seen points (N, 2) of a contour, the body on its right, to the steepest slope across it.

    Pixels of `labels` (h, w) outside of the body, beside a point that does not lie on its edge, become
    unknown. The number of such points is returned. `notes` (N, `N_NOTES`) are room for what is known of each point.
    """
    n_points = len(points_uv)
    _note_inwards(labels.shape, points_uv, seen, notes)
    _note_slopes(view, points_uv, seen, notes)
    for i in range(n_points):
        notes[i, REST] = 0
        if not seen[i]:
            continue
        for k in range(LANES):
            notes[i, SMOOTH + k] = 0
        for j in range(len(WEIGHTS)):
            near = along(i, j - len(WEIGHTS) // 2, n_points)
            near = near if seen[near] else i
            for k in range(LANES):
                notes[i, SMOOTH + k] += WEIGHTS[j] * notes[near, k]
        best = N_SLOPES // 2  # of equals: without noise several are, where an edge runs between pixels
        for k in range(1, N_SLOPES - 1):
            if abs(notes[i, SMOOTH + k]) > abs(notes[i, SMOOTH + best]):
                best = k
        at = SMOOTH + best
        before, highest, after = abs(notes[i, at - 1]), abs(notes[i, at]), abs(notes[i, at + 1])
        bend = min(before - 2 * highest + after, np.float32(-1e-3))
        top = min(max((before - after) / (2 * bend), np.float32(-0.5)), np.float32(0.5))
        depth_px = (np.float32(best - N_SLOPES // 2) + top) * STEP_PX
        points_uv[i, 0] += depth_px * notes[i, INWARDS]
        points_uv[i, 1] += depth_px * notes[i, INWARDS + 1]
        u = int(points_uv[i, 0] - BEYOND_PX * notes[i, INWARDS] + 0.5)
        v = int(points_uv[i, 1] - BEYOND_PX * notes[i, INWARDS + 1] + 0.5)
        behind = view.gain * np.float32(view.expected[v, u])
        notes[i, BEHIND], notes[i, HEIGHT] = behind, highest
        if labels[v, u] == OUTSIDE:
            notes[i, REST] = behind - np.float32(view.image[v, u])
    n_doubtful = 0
    for i in range(n_points):
        if not seen[i]:
            continue
        rest = np.float32(0)
        for j in range(len(WEIGHTS)):
            rest += WEIGHTS[j] * notes[along(i, j - len(WEIGHTS) // 2, n_points), REST]
        behind = notes[i, BEHIND]
        least_rest = max(REST_SHARE * min_contrast * behind, LEAST_REST)
        if notes[i, HEIGHT] < LEAST_SLOPE * behind or abs(rest) > least_rest:
            n_doubtful += 1
            _doubt(labels, int(points_uv[i, 0] + 0.5), int(points_uv[i, 1] + 0.5))
    return n_doubtful


@compiled_within
def _note_inwards(shape: tuple[int, int], points_uv: NDArray[np.float64], seen: Grey, notes: Array) -> None:
    """Note inward normals of a contour; points that have none, or are at the border of the region, are not seen."""
    height, width = shape
    n_points = len(points_uv)
    far_px = BEYOND_PX + np.float32(2)
    for i in range(n_points):
        before = after = i
        for _ in range(TANGENT_REACH):
            previous, following = along(before, BACK, n_points), along(after, ON, n_points)
            before = previous if seen[previous] else before
            after = following if seen[following] else after
        du = np.float32(points_uv[after, 0] - points_uv[before, 0])
        dv = np.float32(points_uv[after, 1] - points_uv[before, 1])
        length = max(np.sqrt(du * du + dv * dv), np.float32(1e-6))
        notes[i, INWARDS], notes[i, INWARDS + 1] = dv / length, -du / length
        u, v = points_uv[i, 0], points_uv[i, 1]
        if before == after or not (far_px <= min(u, v) and u < width - far_px and v < height - far_px):
            seen[i] = 0


@compiled_within
def _note_slopes(view: GreyLevels, points_uv: NDArray[np.float64], seen: Grey, notes: Array) -> None:
    """Note how the grey level changes across the edge, over `SPAN` steps, at `N_SLOPES` of them."""
    # unsigned indices of a flat image: numba asks of any other whether it is negative
    width, one = np.uint64(view.image.shape[1]), np.uint64(1)
    image, expected = view.image.ravel(), view.expected.ravel()
    half = np.float32(0.5) * view.gain
    profile, right, down = (
        np.empty(N_STEPS, np.float32),
        np.empty(N_STEPS, np.float32),
        np.empty(N_STEPS, np.float32),
    )
    at = np.empty(N_STEPS, np.int64)
    for i in range(len(points_uv)):
        if not seen[i]:
            continue
        point_u, point_v = np.float32(points_uv[i, 0]), np.float32(points_uv[i, 1])
        for k in range(N_STEPS):
            depth_px = np.float32(k - N_STEPS // 2) * STEP_PX
            u, v = point_u + depth_px * notes[i, INWARDS], point_v + depth_px * notes[i, INWARDS + 1]
            x, y = np.int32(u), np.int32(v)
            right[k], down[k] = u - np.float32(x), v - np.float32(y)
            at[k] = y * np.int64(width) + x
        for k in range(N_STEPS):
            pixel = np.uint64(at[k])
            upper, lower = np.float32(image[pixel]), np.float32(image[pixel + width])
            upper += right[k] * (np.float32(image[pixel + one]) - upper)
            lower += right[k] * (np.float32(image[pixel + width + one]) - lower)
            # at the edge half of what is behind shines through: so its own slope has no share in the sum's
            profile[k] = half * np.float32(expected[pixel]) - upper - down[k] * (lower - upper)
        for k in range(N_SLOPES):
            notes[i, k] = profile[k + SPAN] - profile[k]
        for k in range(N_SLOPES, LANES):
            notes[i, k] = 0


@compiled_within
def _doubt(labels: Grey, u: int, v: int) -> None:
    """What is outside around a point is unknown."""
    height, width = labels.shape
    for y in range(max(v - DOUBT_PX, 0), min(v + DOUBT_PX + 1, height)):
        for x in range(max(u - DOUBT_PX, 0), min(u + DOUBT_PX + 1, width)):
            if labels[y, x] == OUTSIDE and (y - v) ** 2 + (x - u) ** 2 <= DOUBT_PX**2:
                labels[y, x] = UNKNOWN
