"""Corners of outlines as sharp as before the blur rounded them.

Where a body has a corner, a blur of sigma s moves its outline inwards: by L = sqrt(2 / pi) tan(b / 2) s for straight
edges that turn by b (exact for small b, within 4 % up to a right angle). The straight edges meet beyond the outline; by
how far, the outline itself tells. As far as L can explain that distance D, the corner is put back, by D - sqrt(D^2 -
L^2): a sharp corner to where its edges meet, one that is round by itself hardly at all, by L^2 / 2D, which is
what a blur takes from an arc.
"""

import numpy as np

from pipeline.arrays import Indices, PointsUV, Values
from pipeline.compiled import compiled, compiled_within
from pipeline.segmentation.silhouette import MAX_STEP_PX
from pipeline.views.outline_hull import StackedOutlines, ViewCorners

BLUR_SIGMAS = 4.0
"""Distance from a corner, in sigmas of the blur, from which the edges beside it are as straight as the body's."""
NEAR_SIGMAS = 2.0
"""Distance from where the edges meet, in sigmas, up to which a point is of their corner."""
EDGE_POINTS = 12
"""Points of each edge, about a pixel apart, through which its line is laid."""
ROUNDING = 1.25
"""Factor by which a corner is rounded more than by the blur: the edge is smoothed along itself against noise."""
MIN_TURN_RAD, MAX_TURN_RAD = np.deg2rad(10), np.deg2rad(100)
"""Range of turns: less is no corner, and the blur of sharper ones is not known as well."""


def sharpened(outlines: StackedOutlines, sigmas_px: Values, chosen: ViewCorners) -> PointsUV:
    """Return copies (V, A, 2) of chosen points (V, A), moved out to the corners that they belong to.

    `sigmas_px` (V,) are the blurs of the views; where that is zero, nothing is moved.
    """
    moved_uv = outlines.points_uv[chosen]
    _sharpen(outlines.points_uv, outlines.ends, sigmas_px, chosen, moved_uv)
    return moved_uv


@compiled
def _sharpen(
    points: PointsUV, ends: Indices, sigmas_px: Values, chosen: ViewCorners, moved_uv: PointsUV
) -> None:
    """Fill in what `sharpened` returns."""
    for view in range(chosen.shape[0]):
        begin, n, sigma_px = ends[view], ends[view + 1] - ends[view], ROUNDING * sigmas_px[view]
        skipped = int(BLUR_SIGMAS * sigma_px + 1)
        if sigma_px == 0 or n < 4 * (skipped + EDGE_POINTS):
            continue
        for i in range(chosen.shape[1]):
            corner = chosen[view, i]
            has_gap, au, av, adu, adv = _edge_beside(points, begin, n, corner, skipped, 1)
            has_another, bu, bv, bdu, bdv = _edge_beside(points, begin, n, corner, skipped, -1)
            turn = np.arccos(min(max(-(adu * bdu + adv * bdv), -1.0), 1.0))
            if has_gap or has_another or not MIN_TURN_RAD < turn < MAX_TURN_RAD:
                continue
            # where the lines meet, t points back from a along the first, r from b along the second
            cross = adu * bdv - adv * bdu
            t = ((bu - au) * bdv - (bv - av) * bdu) / cross
            r = ((bu - au) * adv - (bv - av) * adu) / cross
            meet_u, meet_v = au + t * adu, av + t * adv
            away_px = np.hypot(meet_u - points[corner, 0], meet_v - points[corner, 1])
            if t > 0 or r > 0 or away_px > NEAR_SIGMAS * sigma_px + 1:  # a hollow, or another corner's edges
                continue
            # along the bisector
            length = np.hypot(adu + bdu, adv + bdv)
            out_u, out_v = -(adu + bdu) / length, -(adv + bdv) / length
            rounded_px = np.inf
            for k in range(-skipped, skipped + 1):
                near = begin + (corner - begin + k) % n
                height_px = (meet_u - points[near, 0]) * out_u + (meet_v - points[near, 1]) * out_v
                rounded_px = min(rounded_px, height_px)
            blurred_px = np.sqrt(2 / np.pi) * np.tan(turn / 2) * sigma_px
            share = 1.0
            if rounded_px > blurred_px:
                share -= np.sqrt(1 - (blurred_px / rounded_px) ** 2)
            moved_uv[view, i, 0] += share * (meet_u - points[corner, 0])
            moved_uv[view, i, 1] += share * (meet_v - points[corner, 1])


@compiled_within
def _edge_beside(
    points: PointsUV, begin: int, n: int, corner: int, skipped: int, sense: int
) -> tuple[bool, float, float, float, float]:
    """Return the edge of an outline beside a corner: True for a gap near it, a point, and the direction away."""
    half = EDGE_POINTS // 2
    near_u = near_v = far_u = far_v = 0.0
    has_gap = False
    previous = corner
    for k in range(1, skipped + 2 * half):
        at = begin + (corner - begin + sense * k) % n
        u, v = points[at, 0] - points[previous, 0], points[at, 1] - points[previous, 1]
        has_gap |= u * u + v * v > MAX_STEP_PX * MAX_STEP_PX
        previous = at
        if k >= skipped + half:
            far_u, far_v = far_u + points[at, 0] / half, far_v + points[at, 1] / half
        elif k >= skipped:
            near_u, near_v = near_u + points[at, 0] / half, near_v + points[at, 1] / half
    length = max(np.hypot(far_u - near_u, far_v - near_v), 1e-9)
    return has_gap, near_u, near_v, (far_u - near_u) / length, (far_v - near_v) / length
