"""Distances of many pixels at once, between those of the pixels around them."""

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled

Array = NDArray[np.float32]


@compiled
def interpolate(
    flat: Array,
    height: int,
    width: int,
    per_px: np.float32,
    seen: Array,
    n: int,
    at: NDArray[np.int32],
    weights: Array,
    found: Array,
) -> None:
    """Values (N,) at the first `n` places u, v in `seen` of the image that `flat` begins with; beyond, at its border.

    The image has so many pixels per px.

    Two loops are faster than one: without indirect access the first is done for 8 places at a time. What it leaves
    to the second is in `at` (N,), the pixels to the upper left, and `weights` (2, N).
    """
    zero, last_u, last_v = np.float32(0), np.float32(width - 1), np.float32(height - 1)
    stride = np.int32(width)
    most_column, most_row = np.int32(width - 2), np.int32(height - 2)
    for place in range(n):
        u = min(max(per_px * seen[0, place], zero), last_u)
        v = min(max(per_px * seen[1, place], zero), last_v)
        column, row = min(np.int32(u), most_column), min(np.int32(v), most_row)
        at[place] = np.int32(row * stride) + column
        weights[0, place], weights[1, place] = u - np.float32(column), v - np.float32(row)
    down, one = np.uint64(width), np.uint64(1)
    for place in range(n):
        right, below = weights[0, place], weights[1, place]
        above = np.uint64(at[place])
        under = above + down
        upper = flat[above] + right * (flat[above + one] - flat[above])
        lower = flat[under] + right * (flat[under + one] - flat[under])
        found[place] = upper + below * (lower - upper)
