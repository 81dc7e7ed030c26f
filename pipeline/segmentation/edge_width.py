"""The width of a blurred edge, place by place along a contour, from grey profiles across it.

Lens, depth and motion blur each stretch of an outline differently. With the coverage c across an edge, from 0 to 1,
the integral of c (1 - c) is half the mean distance of two points of the blur's spread: sigma / sqrt(pi) for a
Gaussian, and within 3 % of that for a disc or a box of the same sigma. It needs no place of the edge, and noise of
both signs cancels in it to first order. No edge is wider than its steepest slope allows.
"""

from math import pi, sqrt

import numpy as np

from pipeline.arrays import GreyImage, PointsUV, Singles
from pipeline.compiled import compiled, compiled_within
from pipeline.segmentation.local_threshold import RegionLevels
from pipeline.segmentation.subpixel_edge import cyclic_index

TANGENT_POINTS = 5
"""Points, about a pixel apart, to either side, between which the direction of the edge is taken."""
N_HALF, N_STEPS = 8, 17
"""Samples of a profile to either side of the edge, and of all of it."""
REACHES_PX = (8.0, 16.0, 32.0)
"""Extents of a profile to either side; the shortest whose ends lie on both plateaus counts."""
REACH_SIGMAS = 3.2
"""Least reach of a profile, in sigmas of the edge that it finds."""
LINES_PX = (-2.0, 0.0, 2.0)
"""Places along the edge of the lines whose mean is a profile: it halves the noise."""
N_PLATEAU = 3
MIN_STEP_GREY = np.float32(16)
"""Lowest step of an edge whose width is measured; less is lost in the noise."""
MARGIN = np.float32(0.3)
"""Coverages are clipped to this beyond 0 and 1: what is further off is texture."""
PER_SIGMA = np.float32(sqrt(pi))
LEAST_LEVEL = np.float32(0.1)
"""Coverage below which no slope is the edge's."""
PER_OUTER = np.float32(1.15 * sqrt(pi / 2))
"""Sigmas for a pixel's worth of body outside of the steepest slope, relative to the level there: a Gaussian's and 15 %.
Within it the body's own shading, such as a rim that shines, goes on rising."""
STEEP_ENOUGH = np.float32(1.15 / sqrt(2 * pi))
"""Sigmas that an edge of slope 1 has at most, 15 % more than a Gaussian: two steps beside one another, such as those of
a bright rim, are not one wide edge."""
MAX_PLACES = 48
"""Places of a contour at which the width of its edge is looked at before all else."""
MOST, NEARLY_ALL = 0.8, 0.95
"""Shares of these places whose width is no more than what is returned."""
MIN_PLACES = 3
"""Fewest places whose median tells the width of edges of one direction."""
STEEPNESS = 1.7
"""Ratio of rise and run of an edge that counts as across one axis of the image: within 30 degrees of it."""
EVERY = 3
"""Points of a contour from place to place where every width is needed."""
SMOOTHED_PLACES = 9
"""Places over which the median of widths is taken: texture beside an edge makes single ones wrong."""


def outline_sigmas_px(region: RegionLevels, points_uv: PointsUV, seen: GreyImage) -> tuple[float, float]:
    """Return the sigmas that most of a contour's edge (N, 2), and nearly all, do not exceed; 0 without any."""
    sigmas_px = _sigmas_px(region, points_uv, seen, max(1, len(points_uv) // MAX_PLACES))
    known = np.sort(sigmas_px[np.isfinite(sigmas_px)])
    if not len(known):
        return 0.0, 0.0
    return float(known[int(MOST * len(known))]), float(known[int(NEARLY_ALL * len(known))])


def sigmas_across_px(
    region: RegionLevels, points_uv: PointsUV, seen: GreyImage
) -> tuple[float, float] | None:
    """Return the median sigma of a contour's edges (N, 2) across u, and of those across v; `None` without either."""
    every = max(1, len(points_uv) // MAX_PLACES)
    sigmas_px = _sigmas_px(region, points_uv, seen, every)
    along_uv = np.roll(points_uv, -TANGENT_POINTS, axis=0) - np.roll(points_uv, TANGENT_POINTS, axis=0)
    along_u, along_v = np.abs(along_uv[::every][: len(sigmas_px)]).T
    is_known = np.isfinite(sigmas_px)
    across_u = sigmas_px[is_known & (along_v > STEEPNESS * along_u)]
    across_v = sigmas_px[is_known & (along_u > STEEPNESS * along_v)]
    if min(len(across_u), len(across_v)) < MIN_PLACES:
        return None
    return float(np.median(across_u)), float(np.median(across_v))


def local_sigmas_px(region: RegionLevels, points_uv: PointsUV, seen: GreyImage) -> Singles:
    """Return the sigma (N,) of the edge at each point of a contour; where none can be measured, that nearby."""
    sigmas_px = _sigmas_px(region, points_uv, seen, EVERY)
    is_known = np.isfinite(sigmas_px)
    if not is_known.any():
        return np.full(len(points_uv), np.nan, np.float32)
    places = np.arange(len(sigmas_px))
    filled = np.interp(places, places[is_known], sigmas_px[is_known], period=len(places))
    around = filled.take(np.arange(-(SMOOTHED_PLACES // 2), len(places) + SMOOTHED_PLACES // 2), mode="wrap")
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(around, SMOOTHED_PLACES), axis=1)
    return np.interp(np.arange(len(points_uv)), EVERY * places, smooth, period=len(points_uv)).astype(
        np.float32
    )


def _sigmas_px(region: RegionLevels, points_uv: PointsUV, seen: GreyImage, every: int) -> Singles:
    """Return the sigma (P,) at every `every`-th point of a contour, NaN where it cannot be measured."""
    sigmas_px = np.empty(len(points_uv) // every + 1, np.float32)
    return sigmas_px[: measure_widths(region, points_uv, seen, every, sigmas_px)]


@compiled
def measure_widths(
    region: RegionLevels, points_uv: PointsUV, seen: GreyImage, every: int, sigmas_px: Singles
) -> int:
    """Write the sigma at every `every`-th point (N, 2) of a contour, the body on its right; return how many.

    NaN stands for a place without a profile: not seen, without contrast, or wider than any reach.
    """
    n_points, n = len(points_uv), 0
    profile = np.empty(N_STEPS, np.float32)
    for i in range(0, n_points, every):
        sigmas_px[n] = np.nan
        after, before = cyclic_index(i, TANGENT_POINTS, n_points), cyclic_index(i, -TANGENT_POINTS, n_points)
        along_u, along_v = (
            points_uv[after, 0] - points_uv[before, 0],
            points_uv[after, 1] - points_uv[before, 1],
        )
        length = np.sqrt(along_u * along_u + along_v * along_v)
        if seen[i] and length > TANGENT_POINTS:
            along_u, along_v = along_u / length, along_v / length
            least_px = np.float32(0)  # a profile that ends too early finds less of the edge, never more
            for reach in range(len(REACHES_PX)):
                reach_px = REACHES_PX[reach]
                if not _fill_profile(
                    region, points_uv[i, 0], points_uv[i, 1], along_u, along_v, reach_px, profile
                ):
                    break
                sigma_px, offset_px = _width(profile, np.float32(reach_px / N_HALF))
                sigma_px = max(sigma_px, least_px)
                if REACH_SIGMAS * sigma_px + abs(offset_px) <= reach_px:
                    sigmas_px[n] = sigma_px
                    break
                if np.isfinite(sigma_px):
                    least_px = sigma_px
        n += 1
    return n


@compiled_within
def _fill_profile(
    region: RegionLevels,
    u: float,
    v: float,
    along_u: float,
    along_v: float,
    reach_px: float,
    profile: Singles,
) -> bool:
    """Fill in what covers the background along the inward normal of an edge; return whether it is in the region."""
    image, expected = region.image, region.expected
    height, width = image.shape
    for k in range(N_STEPS):
        depth_px = reach_px / N_HALF * (k - N_HALF)
        total = np.float32(0)
        for line in range(len(LINES_PX)):
            at_u = u + depth_px * along_v + LINES_PX[line] * along_u
            at_v = v - depth_px * along_u + LINES_PX[line] * along_v
            x, y = int(at_u), int(at_v)
            if at_u < 0 or at_v < 0 or x >= width - 1 or y >= height - 1:
                return False
            right, down = np.float32(at_u - x), np.float32(at_v - y)
            upper = np.float32(image[y, x]) + right * (np.float32(image[y, x + 1]) - np.float32(image[y, x]))
            lower = np.float32(image[y + 1, x]) + right * (
                np.float32(image[y + 1, x + 1]) - np.float32(image[y + 1, x])
            )
            total += region.gain * np.float32(expected[y, x]) - upper - down * (lower - upper)
        profile[k] = total / np.float32(len(LINES_PX))
    return True


@compiled_within
def _width(profile: Singles, step_px: np.float32) -> tuple[np.float32, np.float32]:
    """Return the sigma of the edge in a profile, infinite where its step is too low, and its distance inwards."""
    within, beyond = np.float32(0), np.float32(0)
    for k in range(N_PLATEAU):
        beyond += profile[k] / np.float32(N_PLATEAU)
        within += profile[N_STEPS - 1 - k] / np.float32(N_PLATEAU)
    rise = within - beyond
    if abs(rise) < MIN_STEP_GREY:
        return np.float32(np.inf), np.float32(0)
    spread, outside, before = np.float32(0), np.float32(-0.5), np.float32(0)
    steepest, covered, outer = np.float32(1e-3), np.float32(0), np.float32(np.inf)
    for k in range(N_STEPS):
        coverage = min(max((profile[k] - beyond) / rise, -MARGIN), np.float32(1) + MARGIN)
        spread += coverage * (np.float32(1) - coverage)
        outside += np.float32(1) - coverage
        slope, level = coverage - before, (coverage + before) / 2
        if slope > steepest and level > LEAST_LEVEL:
            steepest, outer = slope, max(covered + (before + level) / 4, np.float32(0)) / level
        covered += level
        before = coverage
    sigma = min(PER_SIGMA * max(spread, np.float32(0)), STEEP_ENOUGH / steepest, PER_OUTER * outer)
    return step_px * sigma, step_px * (outside - np.float32(N_HALF))
