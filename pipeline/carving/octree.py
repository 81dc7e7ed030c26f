"""Which blocks of voxels the surface may cut, by halving blocks that it may cut.

A view decides about a block when the pixel of the block's centre is further from the silhouette's edge than any
part of the block can be from that pixel: then the block lies within the viewing cone, or outside. A block that is
outside of enough views is dropped, and a view that a block lies within is not asked again about its parts.

A block includes one voxel beyond it on every side, so that no cell of marching cubes that begins or ends in it is
cut unseen, and so that the field of a view it lies within is larger than the distance of two voxels: such a view
has no part in a value that marching cubes interpolates. How far parts of a block are from its centre in the image
is bounded, not computed: by the block's extents across and along the optical axis, and the most that a lens bends.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.carving.views import Pinholes, View, look
from pipeline.compiled import compiled

Array = NDArray[np.float32]
Blocks = NDArray[np.int32]
"""First voxels (B, 3)."""
States = NDArray[np.uint8]
"""What each view says about each block (B, V)."""

UNDECIDED, WITHIN, OUTSIDE = 0, 1, 2
"""What a view says."""
EDGES = (16, 8, 4)
"""Of the blocks, in voxels, from coarse to fine."""
HALVES = 8
"""Of a block."""
LEAF = EDGES[-1]
"""Edge of the finest blocks."""
SPACING_PX = 4
"""Only every so many-th pixel of a distance field is looked at: those of all views stay in the cache."""
SLACK_PX = 1.5
"""Distances far from an edge, and those between such pixels, are less too large than this."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Octree:
    """The hull in blocks; what is in none is outside."""

    leaves: Blocks  # (L, 3) that the surface may cut
    states: States  # (L, V) what is known of them
    solid: tuple[tuple[Blocks, int], ...]  # within the hull, with their edges in voxels


def octree_of(views: Sequence[View], pinholes: Pinholes, n: int, size_mm: float, overruled: int) -> Octree:
    """The blocks of n^3 voxels in a cube around the origin; `overruled` views may exclude what is not carved."""
    sizes_px = np.array([silhouette.distance_px.shape for _, silhouette in views])
    nodes = (sizes_px - 1) // SPACING_PX + 1
    distances_px = np.zeros((len(views), *nodes.max(axis=0) + 1), np.float32)
    for sparse, (rows, columns), (_, silhouette) in zip(distances_px, nodes, views, strict=True):
        sparse[:rows, :columns] = silhouette.distance_px[::SPACING_PX, ::SPACING_PX]
    first = 2 * EDGES[0] * np.indices((-(-n // (2 * EDGES[0])),) * 3, np.int32).reshape(3, -1).T
    blocks, states = np.ascontiguousarray(first), np.zeros((len(first), len(views)), np.uint8)
    solid = []
    for edge in EDGES:
        steps_mm = edge * size_mm / n * pinholes.R @ np.indices((2, 2, 2)).reshape(3, HALVES)
        blocks, states, within, n_cut, n_within = _halved(
            *(blocks, states, edge, n, size_mm / n, pinholes, steps_mm.astype(np.float32)),
            *(distances_px, nodes, overruled),
        )
        blocks, states = blocks[:n_cut], states[:n_cut]
        solid.append((within[:n_within], edge))
    return Octree(leaves=blocks, states=states, solid=tuple(solid))


@compiled
def _halved(
    blocks: Blocks,
    states: States,
    edge: int,
    n: int,
    pitch_mm: float,
    pinholes: Pinholes,
    steps_mm: Array,
    distances_px: Array,
    nodes: NDArray[np.int64],
    overruled: int,
) -> tuple[Blocks, States, Blocks, int, int]:
    """Of the halves of blocks, of this edge, those that may be cut, what is known of them, and those that are solid.

    The last two numbers are how many those are; what comes after them in the arrays means nothing.
    A block at the border of the grid is never solid: the surface closes there.
    """
    n_views = len(nodes)
    most = HALVES * len(blocks)
    cut, cut_states = np.empty((most, 3), np.int32), np.empty((most, n_views), np.uint8)
    solid = np.empty((most, 3), np.int32)
    n_cut, n_solid = 0, 0
    to_centre = (edge - n) / 2
    half_mm = (edge + 1) / 2 * pitch_mm
    seen = np.empty((4, HALVES), np.float32)
    new_states = np.empty((HALVES, n_views), np.uint8)
    n_within, n_outside = np.empty(HALVES, np.int64), np.empty(HALVES, np.int64)
    for block in range(len(blocks)):
        i, j, k = blocks[block, 0], blocks[block, 1], blocks[block, 2]
        x_mm, y_mm, z_mm = pitch_mm * (i + to_centre), pitch_mm * (j + to_centre), pitch_mm * (k + to_centre)
        for half in range(HALVES):
            n_within[half], n_outside[half] = 0, 0
        for view in range(n_views):
            known = states[block, view]
            if known == UNDECIDED:
                look(pinholes, view, x_mm, y_mm, z_mm, steps_mm, seen)
                across_mm = np.float32(half_mm * pinholes.across[view])
                along_mm = np.float32(half_mm * pinholes.along[view])
                stretch_px = np.float32(pinholes.stretches_px[view])
                for half in range(HALVES):
                    depth_mm, reach_mm = seen[2, half], across_mm + along_mm * seen[3, half]
                    reach_px = stretch_px * reach_mm / (depth_mm - along_mm) + np.float32(SLACK_PX)
                    # the camera may be within
                    seen[2, half] = reach_px if depth_mm > along_mm else np.float32(np.inf)
            n_left = 0
            for half in range(HALVES):
                state = known
                if known == UNDECIDED:
                    state = _judged(seen[0, half], seen[1, half], seen[2, half], view, distances_px, nodes)
                new_states[half, view] = state
                n_within[half] += state == WITHIN
                n_outside[half] += state == OUTSIDE
                n_left += n_outside[half] <= overruled
            if n_left == 0:
                break
        for half in range(HALVES):
            i = blocks[block, 0] + edge * (half >> 2 & 1)
            j = blocks[block, 1] + edge * (half >> 1 & 1)
            k = blocks[block, 2] + edge * (half & 1)
            if max(i, j, k) >= n or n_outside[half] > overruled:
                continue
            if n_views - n_within[half] <= overruled and min(i, j, k) > 0 and max(i, j, k) + edge < n:
                solid[n_solid, 0], solid[n_solid, 1], solid[n_solid, 2] = i, j, k
                n_solid += 1
            else:
                cut[n_cut, 0], cut[n_cut, 1], cut[n_cut, 2] = i, j, k
                for view in range(n_views):
                    cut_states[n_cut, view] = new_states[half, view]
                n_cut += 1
    return cut, cut_states, solid, n_cut, n_solid


@compiled
def _judged(
    u: np.float32,
    v: np.float32,
    reach_px: np.float32,
    view: int,
    distances_px: Array,
    nodes: NDArray[np.int64],
) -> int:
    """What a view says about what reaches so far around a pixel."""
    u, v = u / np.float32(SPACING_PX), v / np.float32(SPACING_PX)
    zero, last_u, last_v = np.float32(0), np.float32(nodes[view, 1] - 1), np.float32(nodes[view, 0] - 1)
    near_u, near_v = min(max(u, zero), last_u), min(max(v, zero), last_v)
    column, row = np.uint64(near_u), np.uint64(near_v)
    right, below = near_u - np.float32(column), near_v - np.float32(row)
    next_column, next_row = column + np.uint64(1), row + np.uint64(1)
    first, second = distances_px[view, row, column], distances_px[view, next_row, column]
    upper = first + right * (distances_px[view, row, next_column] - first)
    lower = second + right * (distances_px[view, next_row, next_column] - second)
    inwards_px = upper + below * (lower - upper)
    # the region ends at the last nodes, and beyond it the silhouette
    to_end_px = np.float32(SPACING_PX) * min(min(u, last_u - u), min(v, last_v - v))
    beyond_px = np.float32(SPACING_PX) * (max(abs(u - near_u), abs(v - near_v)) - np.float32(1))
    is_within = min(inwards_px, to_end_px) > reach_px
    is_outside = max(-inwards_px, beyond_px) > reach_px
    return WITHIN * is_within + OUTSIDE * is_outside  # a branch would be guessed wrong half of the time
