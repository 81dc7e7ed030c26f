"""Which blocks of voxels the surface may cut, by halving blocks that it may cut.

A view decides about a block when the pixel of the block's centre is further from the silhouette's edge than any
part of the block can be from that pixel: then the block lies within the viewing cone, or outside. A block that is
outside of enough views is dropped, and a view that a block lies within is not asked again about its parts.

A block includes one voxel beyond it on every side, so that no cell of marching cubes that begins or ends in it is
cut unseen. The parts of the finest blocks, of 2^3 samples, are cells' ends alone: what is within a view, or outside,
by more than a voxel has no part in what marching cubes interpolates. How far parts of a block are from its centre in
the image is bounded, not computed: by the block's extents across and along the optical axis, and the most that a
lens bends.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.carving.interpolation import interpolate
from pipeline.carving.views import HALVES, Pinholes, View, look
from pipeline.compiled import compiled, compiled_within
from pipeline.segmentation.silhouette import SPACING_PX

Array = NDArray[np.float32]
Blocks = NDArray[np.int32]
"""First voxels (B, 3)."""
Flags = NDArray[np.uint8]
Halves = NDArray[np.uint8]
"""A bit for each half of a block."""

EDGES = (16, 8, 4)
"""Of the blocks, in voxels, from coarse to fine."""
LEAF = EDGES[-1]
"""Edge of the finest blocks."""
SLACK_PX = 1.0
"""Distances far from an edge, and those between nodes, are less too large than this."""
BESIDE_PART = 11**0.5 / 2
"""From the centre of a leaf's part to the furthest sample next to one of its samples, (3, 1, 1) / 2, in voxels."""
CHUNK = 64
"""So many blocks are looked at at once: what is known of them stays in the cache."""
ALL = np.uint8(255)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Octree:
    """The hull in blocks; what is in none is outside."""

    leaves: Blocks  # (L, 3) that the surface may cut
    parts: Halves  # (L,) of them that may be cut
    within: Halves  # (L, V) parts that lie within a view
    solid: tuple[tuple[Blocks, int], ...]  # within the hull, with their edges in voxels


def octree_of(views: Sequence[View], pinholes: Pinholes, n: int, size_mm: float, overruled: int) -> Octree:
    """The blocks of n^3 voxels in a cube around the origin; `overruled` views may exclude what is not carved."""
    pitch_mm = size_mm / n
    coarse_px = [silhouette.coarse_px for _, silhouette in views]
    shapes = np.array([image.shape for image in coarse_px])
    nodes = np.column_stack([shapes, np.cumsum(shapes.prod(axis=1)) - shapes.prod(axis=1)])
    looked_at = pinholes, np.concatenate([image.reshape(-1) for image in coarse_px]), nodes
    first = 2 * EDGES[0] * np.indices((-(-n // (2 * EDGES[0])),) * 3, np.int32).reshape(3, -1).T
    blocks, known = np.ascontiguousarray(first), np.zeros((len(first), len(views)), np.uint8)
    solid = []
    for edge in EDGES:
        half_mm = (edge + 1) / 2 * pitch_mm
        reach_mm = half_mm * pinholes.across, half_mm * pinholes.along
        centres_mm = centres_of(blocks, 2 * edge, n, pitch_mm)
        found = _judged(centres_mm, known, edge / 2 * pitch_mm, *looked_at, *reach_mm, overruled)
        blocks, known, whole = _halved(blocks, *found, edge, n)
        solid.append((whole, edge))
    reach_mm = (np.full(len(views), BESIDE_PART * pitch_mm, np.float32),) * 2
    centres_mm = centres_of(blocks, LEAF, n, pitch_mm)
    within, excluded, _ = _judged(centres_mm, known, LEAF / 4 * pitch_mm, *looked_at, *reach_mm, overruled)
    return Octree(leaves=blocks, parts=~excluded, within=within, solid=tuple(solid))


def centres_of(blocks: Blocks, edge: int, n: int, pitch_mm: float) -> Array:
    """Centres (3, B) of blocks with this edge in a grid of n^3 voxels."""
    return np.ascontiguousarray((pitch_mm * (blocks + (edge - n) / 2)).T, np.float32)


@compiled
def _judged(
    centres_mm: Array,
    known: Flags,
    half_mm: float,
    pinholes: Pinholes,
    distances_px: Array,
    nodes: NDArray[np.int64],
    across_mm: Array,
    along_mm: Array,
    overruled: int,
) -> tuple[Halves, Halves, Halves]:
    """Halves of blocks around `centres_mm` (3, B) that lie within each view (B, V), and two more kinds (B,).

    Those that more than `overruled` views exclude, and those that lie not within more than so many views. `half_mm`
    is half of a half's edge; a half reaches `across_mm` (V,) at right angles to each view's optical axis, `along_mm`
    (V,) along it. `known` (B, V) is not 0 where all of a block is within a view. `nodes` (V, 3) are the heights and
    widths of the views' coarse distances and where they begin.
    """
    n_blocks, n_views = known.shape
    within = np.empty((n_blocks, n_views), np.uint8)
    excluded = np.empty((overruled + 1, n_blocks), np.uint8)
    unsure = np.empty((overruled + 1, n_blocks), np.uint8)
    for row in range(overruled + 1):
        for block in range(n_blocks):
            excluded[row, block], unsure[row, block] = 0, 0
    asked, at = np.empty(n_blocks + 1, np.int32), np.empty(CHUNK, np.int32)
    seen, weights = np.empty((HALVES, 4, CHUNK), np.float32), np.empty((2, CHUNK), np.float32)
    inwards_px, per_px = np.empty(CHUNK, np.float32), np.float32(1 / SPACING_PX)
    is_within, is_outside = np.empty(CHUNK, np.uint8), np.empty(CHUNK, np.uint8)
    for view in range(n_views):
        n_asked = 0
        for block in range(n_blocks):
            asked[n_asked] = block
            within[block, view] = ALL if known[block, view] else 0
            n_asked += (known[block, view] == 0) & (excluded[overruled, block] != ALL)
        height, width = nodes[view, 0], nodes[view, 1]
        image_px = distances_px[nodes[view, 2] :]
        reach_mm = across_mm[view], along_mm[view]
        for begin in range(0, n_asked, CHUNK):
            chunk = asked[begin : min(begin + CHUNK, n_asked)]
            look(pinholes, view, centres_mm, chunk, half_mm, seen)
            for cube in range(len(chunk)):
                is_within[cube], is_outside[cube] = 0, 0
            for half in range(HALVES):
                places, n = seen[half], len(chunk)
                interpolate(image_px, height, width, per_px, places, n, at, weights, inwards_px)
                _decide(
                    *(places, inwards_px, n, height, width, pinholes.stretches_px[view], reach_mm),
                    *(half, is_within, is_outside),
                )
            for cube in range(len(chunk)):
                within[chunk[cube], view] = is_within[cube]
                _count(excluded, chunk[cube], is_outside[cube])
                _count(unsure, chunk[cube], np.uint8(~is_within[cube]))
    return within, excluded[overruled], unsure[overruled]


@compiled_within
def _decide(
    seen: Array,
    inwards_px: Array,
    n_cubes: int,
    height: int,
    width: int,
    stretch_px: np.float32,
    reach_mm: tuple[np.float32, np.float32],
    half: int,
    is_within: Halves,
    is_outside: Halves,
) -> None:
    """Set the bit of this half where it is within the silhouette, and where outside."""
    across_mm, along_mm = reach_mm
    slack_px, unbounded, spacing_px = np.float32(SLACK_PX), np.float32(np.inf), np.float32(SPACING_PX)
    last_u, last_v = spacing_px * np.float32(width - 1), spacing_px * np.float32(height - 1)
    for cube in range(n_cubes):
        u, v, depth_mm, slope = seen[0, cube], seen[1, cube], seen[2, cube], seen[3, cube]
        reach_px = stretch_px * (across_mm + along_mm * slope) / (depth_mm - along_mm) + slack_px
        reach_px = reach_px if depth_mm > along_mm else unbounded  # the camera may be within
        # the region ends at the last nodes, and a node further the silhouette
        to_end_px = min(min(u, last_u - u), min(v, last_v - v))
        is_in = min(inwards_px[cube], to_end_px) > reach_px
        is_out = max(-inwards_px[cube], -to_end_px - spacing_px) > reach_px
        is_within[cube] |= np.uint8(np.uint8(is_in) << half)
        is_outside[cube] |= np.uint8(np.uint8(is_out) << half)


@compiled_within
def _count(counted: Halves, block: int, halves: np.uint8) -> None:
    """Count a view for halves of a block: row m of `counted` (M, B) has those for which there are more than m."""
    for row in range(len(counted)):
        before = counted[row, block]
        counted[row, block] = before | halves
        halves = before & halves


@compiled
def _halved(
    blocks: Blocks, within: Halves, excluded: Halves, unsure: Halves, edge: int, n: int
) -> tuple[Blocks, Flags, Blocks]:
    """Of the halves of blocks, with this edge, those that may be cut, which views they lie within, and solid ones.

    A block at the border of the grid is never solid: the surface closes there.
    """
    n_views = within.shape[1]
    cut, solid = np.empty((HALVES * len(blocks), 3), np.int32), np.empty((HALVES * len(blocks), 3), np.int32)
    known = np.empty((HALVES * len(blocks), n_views), np.uint8)
    n_cut, n_solid = 0, 0
    for block in range(len(blocks)):
        for half in range(HALVES):
            i = blocks[block, 0] + edge * (half >> 2 & 1)
            j = blocks[block, 1] + edge * (half >> 1 & 1)
            k = blocks[block, 2] + edge * (half & 1)
            if max(i, j, k) >= n or excluded[block] >> half & 1:
                continue
            if not unsure[block] >> half & 1 and min(i, j, k) > 0 and max(i, j, k) + edge < n:
                solid[n_solid, 0], solid[n_solid, 1], solid[n_solid, 2] = i, j, k
                n_solid += 1
            else:
                cut[n_cut, 0], cut[n_cut, 1], cut[n_cut, 2] = i, j, k
                for view in range(n_views):
                    known[n_cut, view] = within[block, view] >> half & 1
                n_cut += 1
    return cut[:n_cut], known[:n_cut], solid[:n_solid]
