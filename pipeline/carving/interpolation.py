"""Distances of many pixels at once, between those of the pixels around them."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled

Array = NDArray[np.float32]


class Places(NamedTuple):
    """Room for N places in an image."""

    at: NDArray[np.int32]  # (N,) flat indices of the pixels to the upper left
    right: Array  # (N,) from there
    below: Array  # (N,)


@compiled
def room_for(n: int) -> Any:
    """`Places`."""
    return Places(np.empty(n, np.int32), np.empty(n, np.float32), np.empty(n, np.float32))


@compiled
def interpolate(
    flat: Array, first: int, height: int, width: int, seen: Array, n: int, places: Places, found: Array
) -> None:
    """Values (N,) of an image, one of several in `flat`, at the first `n` places u, v in `seen`; beyond, at its border.

    Two loops are faster than one: without indirect access the first is done for 8 places at a time.
    """
    zero, last_u, last_v = np.float32(0), np.float32(width - 1), np.float32(height - 1)
    most_column, most_row = np.int32(width - 2), np.int32(height - 2)
    at, right, below = places
    start, stride = np.int32(first), np.int32(width)
    for place in range(n):
        near_u, near_v = min(max(seen[0, place], zero), last_u), min(max(seen[1, place], zero), last_v)
        column, row = min(np.int32(near_u), most_column), min(np.int32(near_v), most_row)
        at[place] = np.int32(start + np.int32(row * stride) + column)
        right[place], below[place] = near_u - np.float32(column), near_v - np.float32(row)
    down = np.uint64(width)
    for place in range(n):
        above = np.uint64(at[place])
        under, one = above + down, np.uint64(1)
        upper = flat[above] + right[place] * (flat[above + one] - flat[above])
        lower = flat[under] + right[place] * (flat[under + one] - flat[under])
        found[place] = upper + below[place] * (lower - upper)
