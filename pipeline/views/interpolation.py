"""Bilinear interpolation of an image at many places at once."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Singles
from pipeline.compiled import compiled


@compiled
def interpolate(
    flat: Annotated[Singles, "(H W,)"],
    height: int,
    width: int,
    per_px: np.float32,
    places_uv: Annotated[Singles, "(2, N)"],
    n: int,
    nodes: Annotated[NDArray[np.int32], "(N,)"],
    weights: Annotated[Singles, "(2, N)"],
    values: Annotated[Singles, "(N,)"],
) -> None:
    """Fill in the `values` of the first `n` places (u, v); beyond the image that of its nearest border.

    The image (H, W) is what `flat` begins with, and has `per_px` nodes a pixel.

    Two loops are faster than one: without indirect access the first is done for 8 places at a time. What it leaves
    to the second are the `nodes` to the upper left, and the `weights` of those to the right and below.
    """
    zero, last_u, last_v = np.float32(0), np.float32(width - 1), np.float32(height - 1)
    stride = np.int32(width)
    last_column, last_row = np.int32(width - 2), np.int32(height - 2)
    for place in range(n):
        u = min(max(per_px * places_uv[0, place], zero), last_u)
        v = min(max(per_px * places_uv[1, place], zero), last_v)
        column, row = min(np.int32(u), last_column), min(np.int32(v), last_row)
        nodes[place] = np.int32(row * stride) + column
        weights[0, place], weights[1, place] = u - np.float32(column), v - np.float32(row)
    down, one = np.uint64(width), np.uint64(1)
    for place in range(n):
        right, below = weights[0, place], weights[1, place]
        above = np.uint64(nodes[place])
        under = above + down
        upper = flat[above] + right * (flat[above + one] - flat[above])
        lower = flat[under] + right * (flat[under + one] - flat[under])
        values[place] = upper + below * (lower - upper)
