"""Values of the field at the samples of leaves, each in the views that are undecided about it.

Where the surface is, a view counts only with samples near its silhouette's edge: of the 2^3 samples of each part of
a leaf none is asked in a view that the part lies within, far enough for it to have no part in what marching cubes
interpolates, and none once all are outside by more than a voxel.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.carving.interpolation import interpolate
from pipeline.carving.octree import Blocks, Halves
from pipeline.carving.views import CHUNK, HALVES, Pinholes, look
from pipeline.compiled import compiled, whole
from pipeline.segmentation.silhouette import FINE_PX, MARGIN_PX, UNKNOWN

Array = NDArray[np.float32]
Grey = NDArray[np.uint8]
Parts = NDArray[np.int32]
"""Part p of leaf l is number 8 l + p; where it is in the leaf, `views.HALVES` tells, as for its samples."""
FIRST = whole(0)
"""Of what is found."""


@compiled
def undecided(within: Halves, parts: Halves, view: int, found: Parts) -> int:
    """Set the parts (N + 1,) that may be cut and do not lie within a view; returns how many."""
    n_found = FIRST
    for leaf in range(len(parts)):
        asked = parts[leaf] & ~within[leaf, view]
        if asked:
            for part in range(HALVES):
                found[n_found] = HALVES * leaf + part
                n_found += asked >> part & 1
    return n_found


@compiled
def lower(
    values_mm: Array,
    centres_mm: Array,
    parts: Parts,
    n_parts: int,
    half_mm: float,
    pinholes: Pinholes,
    view: int,
    fine_px: Array,
) -> None:
    """Enter a view's signed distances to its viewing cone into the smallest so far (M, HALVES, PARTS), in order.

    Only those of the first `n_parts` of some parts, of all with their centres (3, PARTS) and half the pitch.
    """
    height, width = fine_px.shape
    flat_px = fine_px.reshape(-1)
    last_u, last_v = np.float32(FINE_PX * width - 1), np.float32(FINE_PX * height - 1)
    per_focal, beyond_px = np.float32(1) / pinholes.focals_px[view], np.float32(-MARGIN_PX)
    seen, weights = np.empty((HALVES, 4, CHUNK), np.float32), np.empty((2, CHUNK), np.float32)
    at, found, per_px = np.empty(CHUNK, np.int32), np.empty(CHUNK, np.float32), np.float32(1 / FINE_PX)
    for begin in range(0, n_parts, CHUNK):
        n = CHUNK if begin + CHUNK < n_parts else n_parts - begin
        look(pinholes, view, centres_mm, parts, begin, n, half_mm, seen)
        for sample in range(HALVES):
            interpolate(flat_px, height, width, per_px, seen[sample], n, at, weights, found)
            for index in range(n):
                u, v, depth_mm = seen[sample, 0, index], seen[sample, 1, index], seen[sample, 2, index]
                is_seen = (u >= 0) & (u <= last_u) & (v >= 0) & (v <= last_v) & (depth_mm > 0)
                found[index] = (found[index] if is_seen else beyond_px) * abs(depth_mm) * per_focal
            for rank in range(len(values_mm)):
                for index in range(n):
                    part = np.uint64(parts[begin + index])
                    known_mm, value_mm = values_mm[rank, sample, part], found[index]
                    is_less = value_mm < known_mm
                    values_mm[rank, sample, part] = value_mm if is_less else known_mm
                    found[index] = known_mm if is_less else value_mm


@compiled
def count(
    counts: Array,
    centres_mm: Array,
    parts: Parts,
    n_parts: int,
    half_mm: float,
    pinholes: Pinholes,
    view: int,
    labels: Grey,
) -> None:
    """Add 1 to the samples (HALVES, PARTS) of parts, as in `lower`, whose nearest pixel is not outside in a view."""
    height, width = labels.shape
    flat = labels.reshape(-1)
    seen, at = np.empty((HALVES, 4, CHUNK), np.float32), np.empty(CHUNK, np.int32)
    zero, half, columns, rows = np.float32(0), np.float32(0.5), np.float32(width), np.float32(height)
    for begin in range(0, n_parts, CHUNK):
        n = CHUNK if begin + CHUNK < n_parts else n_parts - begin
        look(pinholes, view, centres_mm, parts, begin, n, half_mm, seen)
        for sample in range(HALVES):
            for index in range(n):
                u, v = seen[sample, 0, index] + half, seen[sample, 1, index] + half
                is_seen = (
                    (u >= zero) & (u < columns) & (v >= zero) & (v < rows) & (seen[sample, 2, index] > zero)
                )
                column, row = np.int32(u if is_seen else zero), np.int32(v if is_seen else zero)
                at[index] = np.int32(row * np.int32(width)) + column if is_seen else np.int32(-1)
            for index in range(n):
                label = flat[np.uint64(max(at[index], 0))]
                counts[sample, np.uint64(parts[begin + index])] += (label >= UNKNOWN) & (at[index] >= 0)


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
    level: float,
    inside: float,
    outside: float,
) -> None:
    """Write the values (HALVES, PARTS) of leaves into a field that begins at voxel `corner`.

    Parts that cannot be cut become `outside`.
    """
    flat, row, plane = field.reshape(-1), field.shape[2], field.shape[1] * field.shape[2]
    highest, lowest, on_level = np.float32(inside), np.float32(outside), np.float32(level)
    for leaf in range(len(leaves)):
        i, j, k = leaves[leaf, 0] - corner[0], leaves[leaf, 1] - corner[1], leaves[leaf, 2] - corner[2]
        for part in range(HALVES):
            first = plane * (i + (part >> 1 & 2)) + row * (j + (part & 2)) + k + 2 * (part & 1)
            is_left = parts[leaf] >> part & 1
            for sample in range(HALVES):
                value = min(values[sample, HALVES * leaf + part], highest)
                if value == on_level:  # would make triangles without area
                    value += np.float32(1e-4)
                at = first + plane * (sample >> 2) + row * (sample >> 1 & 1) + (sample & 1)
                flat[np.uint64(at)] = value if is_left else lowest
