"""Values of the field at the samples of leaves, each in the views that are undecided about it.

Where the surface is, a view counts only with samples near its silhouette's edge: of the 2^3 samples of each octant of
a leaf none is evaluated in a view that the octant lies within, far enough for it to have no part in what marching
cubes interpolates, and none once all are outside by more than a voxel.

Octant o of leaf l has index 8 l + o. Both the octants in a leaf and the samples in an octant are numbered as
`pipeline.carving.pinholes.OCTANTS` tells.
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import GreyImage, Singles
from pipeline.carving.octree import Blocks, OctantBits
from pipeline.carving.pinholes import CHUNK, OCTANTS, Pinholes, project_octants
from pipeline.compiled import compiled, whole
from pipeline.segmentation.silhouette import FINE_PX, MARGIN_PX, UNKNOWN
from pipeline.views.interpolation import interpolate

OctantIndices = NDArray[np.int32]
SampleValues = Annotated[Singles, "(8, 8 L)"]
"""Values of the samples of all octants of L leaves."""

FIRST = whole(0)
"""Number of octants found at first."""


@compiled
def find_undecided(within: OctantBits, cut: OctantBits, view: int, octants: OctantIndices) -> int:
    """Fill in the octants (8 L + 1,) that may be cut and do not lie within a view; return how many."""
    n_found = FIRST
    for leaf in range(len(cut)):
        undecided = cut[leaf] & ~within[leaf, view]
        if undecided:
            for octant in range(OCTANTS):
                octants[n_found] = OCTANTS * leaf + octant
                n_found += undecided >> octant & 1
    return n_found


@compiled
def lower_distances(
    smallest_mm: Annotated[Singles, "(M, 8, 8 L)"],
    centers_mm: Annotated[Singles, "(3, 8 L)"],
    octants: OctantIndices,
    n_octants: int,
    half_pitch_mm: float,
    pinholes: Pinholes,
    view: int,
    fine_px: Singles,
) -> None:
    """Enter a view's signed distances to its viewing cone into the smallest so far, in ascending order.

    Only those of the samples of the first `n_octants` of `octants`; `centers_mm` are those of all octants.
    """
    height, width = fine_px.shape
    flat_px = fine_px.reshape(-1)
    last_u, last_v = np.float32(FINE_PX * width - 1), np.float32(FINE_PX * height - 1)
    per_focal, beyond_px = np.float32(1) / pinholes.focals_px[view], np.float32(-MARGIN_PX)
    projected, weights = np.empty((OCTANTS, 4, CHUNK), np.float32), np.empty((2, CHUNK), np.float32)
    at, values, per_px = np.empty(CHUNK, np.int32), np.empty(CHUNK, np.float32), np.float32(1 / FINE_PX)
    for begin in range(0, n_octants, CHUNK):
        n = CHUNK if begin + CHUNK < n_octants else n_octants - begin
        project_octants(pinholes, view, centers_mm, octants, begin, n, half_pitch_mm, projected)
        for sample in range(OCTANTS):
            interpolate(flat_px, height, width, per_px, projected[sample], n, at, weights, values)
            for index in range(n):
                u, v, depth_mm = (
                    projected[sample, 0, index], projected[sample, 1, index], projected[sample, 2, index],
                )  # fmt: skip
                is_seen = (u >= 0) & (u <= last_u) & (v >= 0) & (v <= last_v) & (depth_mm > 0)
                values[index] = (values[index] if is_seen else beyond_px) * abs(depth_mm) * per_focal
            for rank in range(len(smallest_mm)):
                for index in range(n):
                    octant = np.uint64(octants[begin + index])
                    known_mm, value_mm = smallest_mm[rank, sample, octant], values[index]
                    is_less = value_mm < known_mm
                    smallest_mm[rank, sample, octant] = value_mm if is_less else known_mm
                    values[index] = known_mm if is_less else value_mm


@compiled
def count_view(
    counts: SampleValues,
    centers_mm: Annotated[Singles, "(3, 8 L)"],
    octants: OctantIndices,
    n_octants: int,
    half_pitch_mm: float,
    pinholes: Pinholes,
    view: int,
    labels: GreyImage,
) -> None:
    """Add 1 to the counts of samples, as in `lower_distances`, whose nearest pixel is not outside in a view."""
    height, width = labels.shape
    flat = labels.reshape(-1)
    projected, at = np.empty((OCTANTS, 4, CHUNK), np.float32), np.empty(CHUNK, np.int32)
    zero, half, columns, rows = np.float32(0), np.float32(0.5), np.float32(width), np.float32(height)
    for begin in range(0, n_octants, CHUNK):
        n = CHUNK if begin + CHUNK < n_octants else n_octants - begin
        project_octants(pinholes, view, centers_mm, octants, begin, n, half_pitch_mm, projected)
        for sample in range(OCTANTS):
            for index in range(n):
                u, v = projected[sample, 0, index] + half, projected[sample, 1, index] + half
                is_in_front = projected[sample, 2, index] > zero
                is_seen = (u >= zero) & (u < columns) & (v >= zero) & (v < rows) & is_in_front
                column, row = np.int32(u if is_seen else zero), np.int32(v if is_seen else zero)
                at[index] = np.int32(row * np.int32(width)) + column if is_seen else np.int32(-1)
            for index in range(n):
                label = flat[np.uint64(max(at[index], 0))]
                counts[sample, np.uint64(octants[begin + index])] += (label >= UNKNOWN) & (at[index] >= 0)


@compiled
def count_enclosing_views(within: OctantBits) -> SampleValues:
    """Return for each sample the number of views that its octant lies within."""
    n_leaves, n_views = within.shape
    counts = np.empty((OCTANTS, OCTANTS * n_leaves), np.float32)
    for leaf in range(n_leaves):
        for octant in range(OCTANTS):
            n_within = 0
            for view in range(n_views):
                n_within += within[leaf, view] >> octant & 1
            for sample in range(OCTANTS):
                counts[sample, OCTANTS * leaf + octant] = n_within
    return counts


@compiled
def fill_blocks(field: Singles, corner: NDArray[np.int64], blocks: Blocks, edge: int, inside: float) -> None:
    """Write the value `inside` into solid blocks of a field that begins at voxel `corner`."""
    for block in range(len(blocks)):
        i0, j0, k0 = blocks[block, 0] - corner[0], blocks[block, 1] - corner[1], blocks[block, 2] - corner[2]
        for i in range(i0, i0 + edge):
            for j in range(j0, j0 + edge):
                for k in range(k0, k0 + edge):
                    field[i, j, k] = inside


@compiled
def write_leaves(
    field: Singles,
    corner: NDArray[np.int64],
    leaves: Blocks,
    cut: OctantBits,
    values: SampleValues,
    level: float,
    inside: float,
    outside: float,
) -> None:
    """Write the samples' values into a field that begins at voxel `corner`, cut off at `inside`.

    Octants that cannot be cut become `outside`.
    """
    flat, row, plane = field.reshape(-1), field.shape[2], field.shape[1] * field.shape[2]
    highest, lowest, on_level = np.float32(inside), np.float32(outside), np.float32(level)
    for leaf in range(len(leaves)):
        i, j, k = leaves[leaf, 0] - corner[0], leaves[leaf, 1] - corner[1], leaves[leaf, 2] - corner[2]
        for octant in range(OCTANTS):
            first = plane * (i + (octant >> 1 & 2)) + row * (j + (octant & 2)) + k + 2 * (octant & 1)
            is_cut = cut[leaf] >> octant & 1
            for sample in range(OCTANTS):
                value = min(values[sample, OCTANTS * leaf + octant], highest)
                if value == on_level:  # would make triangles without area
                    value += np.float32(1e-4)
                at = first + plane * (sample >> 2) + row * (sample >> 1 & 1) + (sample & 1)
                flat[np.uint64(at)] = value if is_cut else lowest
