"""The sharpness of a body's outline: the median grey profile across it."""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import PointsUV, Singles
from pipeline.compiled import compiled
from pipeline.frames import Image

MAX_PROFILES = 48
"""Places along the outline at which its profile is taken."""
MIN_PROFILES = 24
MIN_OUTLINE_PX = 150
"""Shortest outline, in points about a pixel apart, that is judged: smaller bodies have no plateau within the edge."""
REACH_PX, STEP_PX, N_STEPS = 12.0, 0.8, 31
"""Extent of a profile to either side of the edge, its spacing, and its number of samples."""
PLATEAU_PX = 8.0
"""Distance from the edge beyond which blur (up to 5 px of motion) mixes nothing in."""
N_PLATEAU = int((REACH_PX - PLATEAU_PX) / STEP_PX) + 1
TANGENT_POINTS = 6
"""Points of the outline, about a pixel apart, to either side, between which its direction is taken."""
MIN_STEP_GREY = 16.0
"""Lowest step of an edge; less is lost in the noise."""
RISE_SHARES = 0.1, 0.9
"""Shares of an edge's rise between which its width is measured."""


@dataclass(frozen=True, slots=True)
class EdgeProfile:
    """Sharpness and contrast of a body's outline in one view."""

    width_px: float  # from 10 to 90 %
    contrast: float  # of body and wall, as a share of the wall's level


def edge_profile(image: Image, outline_uv: PointsUV) -> EdgeProfile | None:
    """Return width and contrast of the median profile across an outline; `None` where too little of it stands out."""
    if len(outline_uv) < MIN_OUTLINE_PX:
        return None
    every = max(1, len(outline_uv) // MAX_PROFILES)
    n_places = len(outline_uv) // every + 1
    rises, contrasts = np.empty((N_STEPS, n_places), np.float32), np.empty(n_places, np.float32)
    n_clear = _fill_profiles(image, outline_uv, every, rises, contrasts)
    if n_clear < MIN_PROFILES:
        return None
    low, high = (_step_reaching(rises, n_clear, share) for share in RISE_SHARES)
    return EdgeProfile((high - low) * STEP_PX, _upper_median(contrasts, n_clear))


@compiled
def _step_reaching(rises: Singles, n: int, share: float) -> float:
    """Return where the median of the first `n` profiles, columns of `rises` (N_STEPS, P), reaches a share, in steps."""
    for step in range(N_STEPS):
        n_above = 0
        for i in range(n):
            n_above += rises[step, i] >= share
        if n_above >= n - n // 2:
            after = _upper_median(rises[step], n)
            before = _upper_median(rises[max(step - 1, 0)], n)
            return step - (after - share) / max(after - before, 1e-6) if step > 0 else 0.0
    return N_STEPS - 1.0


@compiled
def _upper_median(values: Singles, n: int) -> float:
    """Return the upper median of the first `n` values (N,), which are sorted in place."""
    for i in range(1, n):
        value, place = values[i], i
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
    return values[n // 2]


@compiled
def _fill_profiles(image: Image, outline_uv: PointsUV, every: int, rises: Singles, contrasts: Singles) -> int:
    """Fill in profiles across an outline at every `every`-th point where it is unbroken; return how many.

    They are rises (N_STEPS, P) outwards, 0..1, and contrasts (P,).
    """
    height, width = image.shape
    pixels, one, down = image.reshape(-1), np.uint64(1), np.uint64(width)
    n_points = len(outline_uv)
    doubled_area = 0.0  # positive for an outline that runs clockwise as seen
    u, v = outline_uv[-1, 0], outline_uv[-1, 1]
    for i in range(0, n_points, every):
        before_u, before_v, u, v = u, v, outline_uv[i, 0], outline_uv[i, 1]
        doubled_area += before_u * v - u * before_v
    n_clear = 0
    for i in range(0, n_points, every):
        before, after = i - TANGENT_POINTS, i + TANGENT_POINTS
        after = after if after < n_points else after - n_points
        along_u = outline_uv[after, 0] - outline_uv[before, 0]
        along_v = outline_uv[after, 1] - outline_uv[before, 1]
        length = np.sqrt(along_u**2 + along_v**2)
        if not TANGENT_POINTS < length < 3 * TANGENT_POINTS:
            continue
        step = STEP_PX / (length if doubled_area > 0 else -length)
        step_u, step_v = step * along_v, -step * along_u
        first_u = outline_uv[i, 0] - REACH_PX / STEP_PX * step_u
        first_v = outline_uv[i, 1] - REACH_PX / STEP_PX * step_v
        for k in range(N_STEPS):
            u = min(max(first_u + k * step_u, 0.0), width - 1.001)
            v = min(max(first_v + k * step_v, 0.0), height - 1.001)
            x, y = int(u), int(v)
            at = np.uint64(y * width + x)
            left, below = float(pixels[at]), float(pixels[at + down])
            upper = left + (u - x) * (float(pixels[at + one]) - left)
            lower = below + (u - x) * (float(pixels[at + down + one]) - below)
            rises[k, n_clear] = upper + (v - y) * (lower - upper)
        within, beyond = 0.0, 0.0
        for k in range(N_PLATEAU):
            within += rises[k, n_clear] / N_PLATEAU
            beyond += rises[N_STEPS - 1 - k, n_clear] / N_PLATEAU
        if abs(beyond - within) > MIN_STEP_GREY:
            for k in range(N_STEPS):
                rises[k, n_clear] = (rises[k, n_clear] - within) / (beyond - within)
            contrasts[n_clear] = abs(beyond - within) / max(beyond, 1.0)
            n_clear += 1
    return n_clear
