"""Sub-pixel refinement of points roughly on an edge: moved to the steepest slope across it, and verified.

Half-way between two grey levels is the edge only if both levels are known, and beside a wet or shaded rim
the body's is not. The steepest slope across the edge needs neither, and no symmetric blur moves it. Whether
it is the body's edge, and not that of a highlight within it, the empty background tells: just outside of
the body's edge the image is what was expected there.
"""

import numpy as np

from pipeline.arrays import GreyImage, PointsUV, Singles
from pipeline.compiled import compiled, compiled_within, whole
from pipeline.segmentation.local_threshold import RegionLevels
from pipeline.segmentation.silhouette import OUTSIDE, UNKNOWN
from pipeline.segmentation.subpixel_edge import cyclic_index

TANGENT_POINTS = 3
"""Points before and after, between which the edge's direction is taken."""
BACKWARD, FORWARD = whole(-1), whole(1)
"""Steps along the contour."""
STEP_PX = np.float32(0.5)
"""Spacing of the profile across the edge."""
N_SLOPES = 7
"""Steps at which the slope is taken: it is steepest at one of them, the first and last excepted."""
SLOPE_STEPS = 4
"""Steps over which a slope is taken: 2 px, three times the lens's blur."""
N_STEPS = N_SLOPES + SLOPE_STEPS
LANES = 8
"""Slopes are kept in rows of this length, which the processor adds at once."""
SMOOTHED, NORMAL, RESIDUAL, BACKGROUND, PEAK_SLOPE, IS_OFF, N_COLUMNS = LANES, 16, 18, 19, 20, 21, 22
"""Columns of the scratch array, after the slopes across the edge at a point: these smoothed along the edge, the inward
normal (2,), what is left of the body just outside, the background's level there, the greatest slope, and whether it
seems not to be the body's edge."""
MIN_SLOPE_SHARE = np.float32(1 / 3)
"""Least slope of an edge over `SLOPE_STEPS`, as a share of a body's least contrast; grain and noise have less."""
OUTSIDE_PX = np.float32(3.0)
"""Distance outside of a sharp edge from which on neither lens nor motion show the body."""
OUTSIDE_SCALES = np.float32(2.3)
"""The same of a wide edge, in units of its width: less than 1 % of the body shows there."""
RESIDUAL_SHARE = np.float32(0.3)
"""Share of a body's least contrast: where the image differs more from the expected there, it is still body."""
MAX_NOISE_GREY = np.float32(8.0)
"""Difference, in grey levels, that may be noise: less is never taken for body."""
BINOMIAL = tuple(np.array([1, 4, 6, 4, 1], np.float32) / 16)
"""Smoothing kernel along the edge, against noise."""
UNKNOWN_RADIUS_PX = np.float32(4)
"""Radius of what becomes unknown around a doubtful point."""
SHARP_SIGMA_PX = np.float32(0.85)
"""Sigma of an edge of scale 1, as `edge_width` measures it on images in focus: lens, motion and pixels."""
CURVATURE_SIGMAS = np.float32(3)
"""Half the chord over which a curvature is taken."""
MAX_BEND = np.float32(0.3)
"""Greatest curvature, relative to a circle's of the blur's sigma, whose shrinkage is undone: beyond is a corner."""


@compiled
def move_to_steepest(
    region: RegionLevels, points_uv: PointsUV, seen: GreyImage, scales: Singles, scratch: Singles
) -> None:
    """Move the seen points (N, 2) of a contour, the body on its right, to the steepest slope across it.

    All lengths are in units of the edge's width at each point: `scales` (N,), 1 for a sharp one. `scratch` is
    (N, `N_COLUMNS`), and tells `find_doubtful` what it needs.
    """
    n_points = len(points_uv)
    _write_normals(region.image.shape, points_uv, seen, scales, scratch)
    _write_slopes(region, points_uv, seen, scales, scratch)
    for i in range(n_points):
        if not seen[i]:
            continue
        for k in range(LANES):
            scratch[i, SMOOTHED + k] = 0
        for j in range(len(BINOMIAL)):
            near = _neighbour(i, j, scales[i], n_points)
            near = near if seen[near] else i
            for k in range(LANES):
                scratch[i, SMOOTHED + k] += BINOMIAL[j] * scratch[near, k]
        best = (
            N_SLOPES // 2
        )  # wins among equals, which there are without noise where an edge runs between pixels
        for k in range(1, N_SLOPES - 1):
            if abs(scratch[i, SMOOTHED + k]) > abs(scratch[i, SMOOTHED + best]):
                best = k
        at = SMOOTHED + best
        before, highest, after = abs(scratch[i, at - 1]), abs(scratch[i, at]), abs(scratch[i, at + 1])
        bend = min(before - 2 * highest + after, np.float32(-1e-3))
        top = min(max((before - after) / (2 * bend), np.float32(-0.5)), np.float32(0.5))
        depth_px = (np.float32(best - N_SLOPES // 2) + top) * STEP_PX * scales[i]
        points_uv[i, 0] += depth_px * scratch[i, NORMAL]
        points_uv[i, 1] += depth_px * scratch[i, NORMAL + 1]
        scratch[i, PEAK_SLOPE] = highest


@compiled
def find_doubtful(
    region: RegionLevels,
    min_contrast: np.float32,
    labels: GreyImage,
    points_uv: PointsUV,
    seen: GreyImage,
    scales: Singles,
    scratch: Singles,
) -> int:
    """Return the number of seen points (N, 2), moved by `move_to_steepest`, that turn out to lie off the body's edge.

    Pixels of `labels` (h, w) outside of the body and beside such a point become unknown. Noise alone puts a point off
    now and then, hardly ever two side by side.
    """
    n_points = len(points_uv)
    for i in range(n_points):
        scratch[i, RESIDUAL] = 0
        if not seen[i]:
            continue
        outside_px = max(OUTSIDE_PX, OUTSIDE_SCALES * scales[i])
        u = int(points_uv[i, 0] - outside_px * scratch[i, NORMAL] + 0.5)
        v = int(points_uv[i, 1] - outside_px * scratch[i, NORMAL + 1] + 0.5)
        background = region.gain * np.float32(region.expected[v, u])
        scratch[i, BACKGROUND] = background
        if labels[v, u] == OUTSIDE:
            scratch[i, RESIDUAL] = background - np.float32(region.image[v, u])
    for i in range(n_points):
        scratch[i, IS_OFF] = 0
        if not seen[i]:
            continue
        residual = np.float32(0)
        for j in range(len(BINOMIAL)):
            residual += BINOMIAL[j] * scratch[_neighbour(i, j, scales[i], n_points), RESIDUAL]
        background = scratch[i, BACKGROUND]
        max_residual = max(RESIDUAL_SHARE * min_contrast * background, MAX_NOISE_GREY)
        is_off = (
            scratch[i, PEAK_SLOPE] < MIN_SLOPE_SHARE * min_contrast * background
            or abs(residual) > max_residual
        )
        scratch[i, IS_OFF] = np.float32(is_off)
    n_doubtful = 0
    for i in range(n_points):
        after, before = cyclic_index(i, FORWARD, n_points), cyclic_index(i, BACKWARD, n_points)
        if scratch[i, IS_OFF] and (scratch[before, IS_OFF] or scratch[after, IS_OFF]):
            n_doubtful += 1
            radius_px = int(UNKNOWN_RADIUS_PX * scales[i])
            _mark_unknown(labels, int(points_uv[i, 0] + 0.5), int(points_uv[i, 1] + 0.5), radius_px)
    return n_doubtful


@compiled
def undo_shrinkage(points_uv: PointsUV, seen: GreyImage, scales: Singles, scratch: Singles) -> None:
    """Move the seen points (N, 2) of a wide edge to where the body's would be without blur.

    A blur of variance s^2 moves the edge of a disc of curvature k inwards by k s^2 / 2, whether half-way between the
    levels or where it is steepest (Verbeek and van Vliet 1994), and that of a hole outwards.
    """
    n_points = len(points_uv)
    for i in range(n_points):
        scratch[i, RESIDUAL] = 0
        sigma_px = SHARP_SIGMA_PX * scales[i]
        reach = int(CURVATURE_SIGMAS * sigma_px + 1)
        after, before = cyclic_index(i, reach, n_points), cyclic_index(i, -reach, n_points)
        if not (seen[i] and seen[after] and seen[before]):
            continue
        chord_u, chord_v = (
            points_uv[after, 0] - points_uv[before, 0],
            points_uv[after, 1] - points_uv[before, 1],
        )
        middle_u = (points_uv[after, 0] + points_uv[before, 0]) / 2 - points_uv[i, 0]
        middle_v = (points_uv[after, 1] + points_uv[before, 1]) / 2 - points_uv[i, 1]
        sagitta_px = middle_u * scratch[i, NORMAL] + middle_v * scratch[i, NORMAL + 1]
        curvature = np.float32(8 * sagitta_px / max(chord_u * chord_u + chord_v * chord_v, 1.0))
        most = MAX_BEND / sigma_px
        scratch[i, RESIDUAL] = sigma_px * sigma_px / 2 * min(max(curvature, -most), most)
    for i in range(n_points):
        points_uv[i, 0] -= scratch[i, RESIDUAL] * scratch[i, NORMAL]
        points_uv[i, 1] -= scratch[i, RESIDUAL] * scratch[i, NORMAL + 1]


@compiled_within
def _neighbour(i: int, j: int, scale: np.float32, n_points: int) -> int:
    """Return the index of the j-th point that is smoothed over, around point i."""
    return cyclic_index(i, (j - len(BINOMIAL) // 2) * int(scale + np.float32(0.5)), n_points)


@compiled_within
def _write_normals(
    shape: tuple[int, int], points_uv: PointsUV, seen: GreyImage, scales: Singles, scratch: Singles
) -> None:
    """Write inward normals of a contour; points without one, or at the border of the region, become unseen."""
    height, width = shape
    n_points = len(points_uv)
    for i in range(n_points):
        far_px = (OUTSIDE_PX + np.float32(2)) * scales[i]
        before = after = i
        for _ in range(int(TANGENT_POINTS * scales[i])):
            previous, following = (
                cyclic_index(before, BACKWARD, n_points),
                cyclic_index(after, FORWARD, n_points),
            )
            before = previous if seen[previous] else before
            after = following if seen[following] else after
        du = np.float32(points_uv[after, 0] - points_uv[before, 0])
        dv = np.float32(points_uv[after, 1] - points_uv[before, 1])
        length = max(np.sqrt(du * du + dv * dv), np.float32(1e-6))
        scratch[i, NORMAL], scratch[i, NORMAL + 1] = dv / length, -du / length
        u, v = points_uv[i, 0], points_uv[i, 1]
        if before == after or not (far_px <= min(u, v) and u < width - far_px and v < height - far_px):
            seen[i] = 0


@compiled_within
def _write_slopes(
    region: RegionLevels, points_uv: PointsUV, seen: GreyImage, scales: Singles, scratch: Singles
) -> None:
    """Write how the grey level changes across the edge, over `SLOPE_STEPS` steps, at `N_SLOPES` of them."""
    # unsigned indices of a flat image: numba asks of any other whether it is negative
    width, one = np.uint64(region.image.shape[1]), np.uint64(1)
    image, expected = region.image.ravel(), region.expected.ravel()
    half = np.float32(0.5) * region.gain
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
            depth_px = np.float32(k - N_STEPS // 2) * STEP_PX * scales[i]
            u, v = point_u + depth_px * scratch[i, NORMAL], point_v + depth_px * scratch[i, NORMAL + 1]
            x, y = np.int32(u), np.int32(v)
            right[k], down[k] = u - np.float32(x), v - np.float32(y)
            at[k] = y * np.int64(width) + x
        for k in range(N_STEPS):
            pixel = np.uint64(at[k])
            upper, lower = np.float32(image[pixel]), np.float32(image[pixel + width])
            upper += right[k] * (np.float32(image[pixel + one]) - upper)
            lower += right[k] * (np.float32(image[pixel + width + one]) - lower)
            # half of the background shows through at the edge: with that half subtracted, its own slope cancels
            profile[k] = half * np.float32(expected[pixel]) - upper - down[k] * (lower - upper)
        for k in range(N_SLOPES):
            scratch[i, k] = profile[k + SLOPE_STEPS] - profile[k]
        for k in range(N_SLOPES, LANES):
            scratch[i, k] = 0


@compiled_within
def _mark_unknown(labels: GreyImage, u: int, v: int, radius_px: int) -> None:
    """Label unknown what is outside around a point."""
    height, width = labels.shape
    for y in range(max(v - radius_px, 0), min(v + radius_px + 1, height)):
        for x in range(max(u - radius_px, 0), min(u + radius_px + 1, width)):
            if labels[y, x] == OUTSIDE and (y - v) ** 2 + (x - u) ** 2 <= radius_px**2:
                labels[y, x] = UNKNOWN
