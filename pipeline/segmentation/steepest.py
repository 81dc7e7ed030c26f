"""The edge where grey levels change most, and whether it is the body's: for points roughly on it.

Half-way between two grey levels is the edge only if both levels are known, and beside a wet or shaded rim
the body's is not. The steepest slope across the edge needs neither, and no symmetric blur moves it. Whether
it is the body's edge, and not that of a highlight within it, the empty background tells: just outside of
the body's edge the image is what was expected there.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.segmentation.silhouette import OUTSIDE, UNKNOWN

Grey = NDArray[np.uint8]
Array = NDArray[np.float32]

TANGENT_REACH = 3
"""The edge runs from the point so many before to the one so many after."""
STEP_PX = np.float32(0.5)
"""Of the profile across the edge."""
N_SLOPES = 7
"""Steps at which the slope is taken: it is steepest at one of them, the first and last excepted."""
SPAN = 4
"""Steps over which a slope is taken: 2 px, three times the lens's blur."""
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
    image: Grey | Array,
    expected: Array,
    gain: np.float32,
    min_contrast: np.float32,
    labels: Grey,
    points_uv: NDArray[np.float64],
    seen: Grey,
) -> int:
    """Move the seen points (N, 2) of a contour, the body on its right, to the steepest slope across it.

    Pixels of `labels` (h, w) outside of the body, beside a point that does not lie on its edge, become
    unknown. The number of such points is returned.
    """
    height, width = image.shape
    n_points, n_steps = len(points_uv), N_SLOPES + SPAN
    far_px = BEYOND_PX + np.float32(2)
    inwards = np.zeros((n_points, 2), np.float32)
    slopes = np.zeros((n_points, N_SLOPES), np.float32)
    profile = np.zeros(n_steps, np.float32)
    for i in range(n_points):
        before = after = i
        for _ in range(TANGENT_REACH):
            previous, following = _along(before, -1, n_points), _along(after, 1, n_points)
            before = previous if seen[previous] else before
            after = following if seen[following] else after
        du = np.float32(points_uv[after, 0] - points_uv[before, 0])
        dv = np.float32(points_uv[after, 1] - points_uv[before, 1])
        length = max(np.sqrt(du * du + dv * dv), np.float32(1e-6))
        du, dv = dv / length, -du / length
        inwards[i, 0], inwards[i, 1] = du, dv
        point_u, point_v = np.float32(points_uv[i, 0]), np.float32(points_uv[i, 1])
        if not (far_px <= min(point_u, point_v) and point_u < width - far_px and point_v < height - far_px):
            seen[i] = 0  # at the border of the region
        if before == after:
            seen[i] = 0  # alone, and an edge without direction
        if not seen[i]:
            continue
        for k in range(n_steps):
            depth_px = np.float32(k - n_steps // 2) * STEP_PX
            u, v = point_u + depth_px * du, point_v + depth_px * dv
            x, y = int(u), int(v)
            a, b = u - np.float32(x), v - np.float32(y)
            upper, lower = np.float32(image[y, x]), np.float32(image[y + 1, x])
            upper += a * (np.float32(image[y, x + 1]) - upper)
            lower += a * (np.float32(image[y + 1, x + 1]) - lower)
            # at the edge half of what is behind shines through: so its own slope has no share in the sum's
            profile[k] = np.float32(0.5) * gain * expected[y, x] - upper - b * (lower - upper)
        for k in range(N_SLOPES):
            slopes[i, k] = profile[k + SPAN] - profile[k]
    rests = np.zeros(n_points, np.float32)  # of the body, just outside of the edge, in grey levels
    behinds = np.zeros(n_points, np.float32)
    heights = np.zeros(n_points, np.float32)
    smooth = np.zeros(N_SLOPES, np.float32)
    for i in range(n_points):
        if not seen[i]:
            continue
        smooth[:] = 0
        for j in range(len(WEIGHTS)):
            near = _along(i, j - len(WEIGHTS) // 2, n_points)
            near = near if seen[near] else i
            for k in range(N_SLOPES):
                smooth[k] += WEIGHTS[j] * slopes[near, k]
        best = 1
        for k in range(1, N_SLOPES - 1):
            if abs(smooth[k]) > abs(smooth[best]):
                best = k
        before, highest, after = abs(smooth[best - 1]), abs(smooth[best]), abs(smooth[best + 1])
        bend = min(before - 2 * highest + after, np.float32(-1e-3))
        top = min(max((before - after) / (2 * bend), np.float32(-0.5)), np.float32(0.5))
        depth_px = (best - N_SLOPES // 2 + top) * STEP_PX
        points_uv[i, 0] += depth_px * inwards[i, 0]
        points_uv[i, 1] += depth_px * inwards[i, 1]
        u = int(points_uv[i, 0] - BEYOND_PX * inwards[i, 0] + 0.5)
        v = int(points_uv[i, 1] - BEYOND_PX * inwards[i, 1] + 0.5)
        behinds[i], heights[i] = gain * expected[v, u], highest
        if labels[v, u] == OUTSIDE:
            rests[i] = behinds[i] - np.float32(image[v, u])
    n_doubtful = 0
    for i in range(n_points):
        rest = np.float32(0)
        for j in range(len(WEIGHTS)):
            rest += WEIGHTS[j] * rests[_along(i, j - len(WEIGHTS) // 2, n_points)]
        least_rest = max(REST_SHARE * min_contrast * behinds[i], LEAST_REST)
        if seen[i] and (heights[i] < LEAST_SLOPE * behinds[i] or abs(rest) > least_rest):
            n_doubtful += 1
            u, v = int(points_uv[i, 0] + 0.5), int(points_uv[i, 1] + 0.5)
            for y in range(max(v - DOUBT_PX, 0), min(v + DOUBT_PX + 1, height)):
                for x in range(max(u - DOUBT_PX, 0), min(u + DOUBT_PX + 1, width)):
                    if labels[y, x] == OUTSIDE and (y - v) ** 2 + (x - u) ** 2 <= DOUBT_PX**2:
                        labels[y, x] = UNKNOWN
    return n_doubtful


@compiled
def _along(i: int, steps: int, n: int) -> int:
    """The index of the point so many steps after number i of n around a closed line, at most one turn away."""
    after = i + steps
    if after < 0:
        return max(after + n, 0)
    return after if after < n else min(after - n, n - 1)
