"""Values of the field at the samples of leaves, each in the views that are undecided about it.

Where the surface is, a view counts only with samples near its silhouette's edge: of the 2^3 samples of each part of
a leaf none is asked in a view that the part lies within, far enough for it to have no part in what marching cubes
interpolates, and none once all are outside by more than a voxel.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.carving.interpolation import interpolate, room_for
from pipeline.carving.octree import CHUNK, LEAF, Blocks, Halves
from pipeline.carving.views import HALVES, Pinholes, look
from pipeline.compiled import compiled
from pipeline.segmentation.silhouette import MARGIN_PX, UNKNOWN

Array = NDArray[np.float32]
Grey = NDArray[np.uint8]
Parts = NDArray[np.int32]
"""Part p of leaf l is number 8 l + p; where it is in the leaf, `views.HALVES` tells, as for its samples."""


@compiled
def undecided(within: Halves, parts: Halves, view: int) -> Parts:
    """The parts that may be cut and do not lie within a view."""
    found = np.empty(HALVES * len(parts) + 1, np.int32)
    n_found = 0
    for leaf in range(len(parts)):
        asked = parts[leaf] & ~within[leaf, view]
        if asked:
            for part in range(HALVES):
                found[n_found] = HALVES * leaf + part
                n_found += asked >> part & 1
    return found[:n_found]


@compiled
def look_at_samples(
    leaves: Blocks, parts: Parts, n: int, pitch_mm: float, pinholes: Pinholes, view: int, seen: Array
) -> None:
    """How a camera sees the samples of at most CHUNK parts: as `look`."""
    centres_mm = np.empty((3, CHUNK), np.float32)
    to_centre = np.float32(1 - n / 2)
    pitch = np.float32(pitch_mm)
    for index in range(len(parts)):
        leaf, part = parts[index] // HALVES, parts[index] % HALVES
        for axis in range(3):
            first = leaves[leaf, axis] + 2 * (part >> 2 - axis & 1)
            centres_mm[axis, index] = pitch * (np.float32(first) + to_centre)
    look(pinholes, view, centres_mm, len(parts), pitch_mm / 2, seen)


@compiled
def lower(
    values_mm: Array,
    leaves: Blocks,
    parts: Parts,
    n: int,
    pitch_mm: float,
    pinholes: Pinholes,
    view: int,
    distance_px: Array,
) -> None:
    """Enter a view's signed distances to its viewing cone into the smallest so far (M, HALVES, PARTS), in order."""
    height, width = distance_px.shape
    flat_px = distance_px.reshape(-1)
    last_u, last_v = np.float32(width - 1), np.float32(height - 1)
    per_focal, beyond_px = np.float32(1) / pinholes.focals_px[view], np.float32(-MARGIN_PX)
    seen = np.empty((HALVES, 4, CHUNK), np.float32)
    places, found = room_for(CHUNK), np.empty(CHUNK, np.float32)
    for begin in range(0, len(parts), CHUNK):
        chunk = parts[begin : begin + CHUNK]
        look_at_samples(leaves, chunk, n, pitch_mm, pinholes, view, seen)
        for sample in range(HALVES):
            interpolate(flat_px, 0, height, width, seen[sample], len(chunk), places, found)
            for index in range(len(chunk)):
                u, v, depth_mm = seen[sample, 0, index], seen[sample, 1, index], seen[sample, 2, index]
                is_seen = (u >= 0) & (u <= last_u) & (v >= 0) & (v <= last_v) & (depth_mm > 0)
                found[index] = (found[index] if is_seen else beyond_px) * abs(depth_mm) * per_focal
            for rank in range(len(values_mm)):
                for index in range(len(chunk)):
                    part = np.uint64(chunk[index])
                    known_mm, value_mm = values_mm[rank, sample, part], found[index]
                    values_mm[rank, sample, part] = min(known_mm, value_mm)
                    found[index] = max(known_mm, value_mm)


@compiled
def count(
    counts: Array,
    leaves: Blocks,
    parts: Parts,
    n: int,
    pitch_mm: float,
    pinholes: Pinholes,
    view: int,
    labels: Grey,
) -> None:
    """Add 1 to the samples (HALVES, PARTS) whose nearest pixel is inside or unknown in a view."""
    height, width = labels.shape
    flat = labels.reshape(-1)
    seen = np.empty((HALVES, 4, CHUNK), np.float32)
    at = np.empty(CHUNK, np.int32)
    zero, half, columns, rows = np.float32(0), np.float32(0.5), np.float32(width), np.float32(height)
    for begin in range(0, len(parts), CHUNK):
        chunk = parts[begin : begin + CHUNK]
        look_at_samples(leaves, chunk, n, pitch_mm, pinholes, view, seen)
        for sample in range(HALVES):
            for index in range(len(chunk)):
                u, v = seen[sample, 0, index] + half, seen[sample, 1, index] + half
                is_seen = (
                    (u >= zero) & (u < columns) & (v >= zero) & (v < rows) & (seen[sample, 2, index] > zero)
                )
                column, row = np.int32(u if is_seen else zero), np.int32(v if is_seen else zero)
                at[index] = np.int32(row * np.int32(width)) + column if is_seen else np.int32(-1)
            for index in range(len(chunk)):
                label = flat[np.uint64(max(at[index], 0))]
                counts[sample, np.uint64(chunk[index])] += (label >= UNKNOWN) & (at[index] >= 0)


@compiled
def count_within(within: Halves) -> Array:
    """How many views (HALVES, PARTS) the samples' part lies within."""
    n_leaves, n_views = within.shape
    counts = np.empty((HALVES, HALVES * n_leaves), np.float32)
    for leaf in range(n_leaves):
        for part in range(HALVES):
            n_within = 0
            for view in range(n_views):
                n_within += within[leaf, view] >> part & 1
            for sample in range(HALVES):
                counts[sample, HALVES * leaf + part] = n_within
    return counts


@compiled
def fill(field: Array, corner: NDArray[np.int64], blocks: Blocks, edge: int, inside: float) -> None:
    """Write what is inside into solid blocks of a field that begins at voxel `corner`."""
    for block in range(len(blocks)):
        i0, j0, k0 = blocks[block, 0] - corner[0], blocks[block, 1] - corner[1], blocks[block, 2] - corner[2]
        for i in range(i0, i0 + edge):
            for j in range(j0, j0 + edge):
                for k in range(k0, k0 + edge):
                    field[i, j, k] = inside


@compiled
def place(
    field: Array,
    corner: NDArray[np.int64],
    leaves: Blocks,
    parts: Halves,
    values: Array,
    n: int,
    level: float,
    inside: float,
    outside: float,
) -> bool:
    """Write the values (HALVES, PARTS) of leaves into a field that begins at voxel `corner`.

    Of a part that cannot be cut, and what is inside at the border of the grid, becomes `outside`; whether there is
    any of the latter is returned.
    """
    flat, row, plane = field.reshape(-1), field.shape[2], field.shape[1] * field.shape[2]
    touches_border = False
    for leaf in range(len(leaves)):
        i0, j0, k0 = leaves[leaf, 0], leaves[leaf, 1], leaves[leaf, 2]
        is_at_border = min(i0, j0, k0) == 0 or max(i0, j0, k0) + LEAF == n
        for part in range(HALVES):
            is_left = parts[leaf] >> part & 1
            for sample in range(HALVES):
                i = i0 + 2 * (part >> 2 & 1) + (sample >> 2 & 1)
                j = j0 + 2 * (part >> 1 & 1) + (sample >> 1 & 1)
                k = k0 + 2 * (part & 1) + (sample & 1)
                value = min(values[sample, HALVES * leaf + part], np.float32(inside))
                if not is_left:
                    value = np.float32(outside)
                elif value == level:  # would make triangles without area
                    value += np.float32(1e-4)
                if is_at_border and value > level and (min(i, j, k) == 0 or max(i, j, k) == n - 1):
                    touches_border, value = True, np.float32(outside)
                at = plane * (i - corner[0]) + row * (j - corner[1]) + k - corner[2]
                flat[np.uint64(at)] = value
    return touches_border
