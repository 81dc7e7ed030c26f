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

from pipeline.carving.interpolation import interpolate, room_for
from pipeline.carving.views import HALVES, Pinholes, View, look
from pipeline.compiled import compiled
from pipeline.segmentation.silhouette import SPACING_PX

Array = NDArray[np.float32]
Blocks = NDArray[np.int32]
"""First voxels (B, 3)."""
Halves = NDArray[np.uint8]
"""A bit for each half of a block."""

EDGES = (16, 8, 4)
"""Of the blocks, in voxels, from coarse to fine."""
LEAF = EDGES[-1]
"""Edge of the finest blocks."""
SLACK_PX = 1.5
"""Distances far from an edge, and those between nodes, are less too large than this."""
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
    coarse_px = [silhouette.coarse_px for _, silhouette in views]
    shapes = np.array([distances_px.shape for distances_px in coarse_px])
    firsts = np.cumsum(shapes.prod(axis=1)) - shapes.prod(axis=1)
    nodes = np.column_stack([shapes, firsts]).astype(np.int32)
    distances_px = np.concatenate([each.reshape(-1) for each in coarse_px])
    asked = (n, size_mm / n, pinholes, distances_px, nodes, overruled)
    first = 2 * EDGES[0] * np.indices((-(-n // (2 * EDGES[0])),) * 3, np.int32).reshape(3, -1).T
    blocks, known = np.ascontiguousarray(first), np.zeros((len(first), len(views)), np.uint8)
    solid = []
    for edge in EDGES:
        within, left, inside = _judged(blocks, known, edge, 0.5 * edge + 0.5, 0.0, *asked)
        blocks, known, whole = _halved(blocks, within, left, inside, edge, n)
        solid.append((whole, edge))
    within, left, _ = _judged(blocks, known, LEAF // 2, 0.25 * LEAF - 0.5, 1.0, *asked)
    return Octree(leaves=blocks, parts=left, within=within, solid=tuple(solid))


@compiled
def _judged(
    blocks: Blocks,
    known: NDArray[np.uint8],
    edge: int,
    reach: float,
    beyond: float,
    n: int,
    pitch_mm: float,
    pinholes: Pinholes,
    distances_px: Array,
    nodes: NDArray[np.int32],
    overruled: int,
) -> tuple[Halves, Halves, Halves]:
    """Halves of blocks, with this edge, that lie within each view (B, V); that are left (B,); and inside (B,).

    A half is taken to be a cube of half edge `reach` with `beyond` more around it, in voxels. `known` (B, V) is not 0
    where all of a block is within a view.
    """
    n_blocks, n_views = known.shape
    within = np.zeros((n_blocks, n_views), np.uint8)
    # of more than so many views: what they exclude, and what is not within them
    excluded = np.zeros((overruled + 1, n_blocks), np.uint8)
    undecided = np.zeros((overruled + 1, n_blocks), np.uint8)
    asked = np.empty(n_blocks + 1, np.int32)
    centres_mm, seen = np.empty((3, CHUNK), np.float32), np.empty((HALVES, 4, CHUNK), np.float32)
    is_within, is_outside = np.empty(CHUNK, np.uint8), np.empty(CHUNK, np.uint8)
    to_centre = np.float32(edge - n / 2)
    places, inwards_px = room_for(CHUNK), np.empty(CHUNK, np.float32)
    pitch, per_px = np.float32(pitch_mm), np.float32(1 / SPACING_PX)
    for view in range(n_views):
        n_asked = 0
        for block in range(n_blocks):
            asked[n_asked] = block
            within[block, view] = ALL if known[block, view] else 0
            n_asked += (known[block, view] == 0) & (excluded[overruled, block] != ALL)
        across_mm = pitch * np.float32(reach * pinholes.across[view] + beyond)
        along_mm = pitch * np.float32(reach * pinholes.along[view] + beyond)
        stretch_px = pinholes.stretches_px[view]
        height, width, start = nodes[view, 0], nodes[view, 1], nodes[view, 2]
        for first in range(0, n_asked, CHUNK):
            n_cubes = min(CHUNK, n_asked - first)
            for cube in range(n_cubes):
                block = asked[first + cube]
                for axis in range(3):
                    centres_mm[axis, cube] = pitch * (np.float32(blocks[block, axis]) + to_centre)
                is_within[cube], is_outside[cube] = 0, 0
            look(pinholes, view, centres_mm, n_cubes, edge / 2 * pitch_mm, seen)
            for half in range(HALVES):
                for cube in range(n_cubes):
                    depth_mm = seen[half, 2, cube]
                    reach_mm = across_mm + along_mm * seen[half, 3, cube]
                    reach_px = stretch_px * reach_mm / (depth_mm - along_mm) + np.float32(SLACK_PX)
                    # the camera may be within
                    seen[half, 2, cube] = reach_px if depth_mm > along_mm else np.float32(np.inf)
                    seen[half, 0, cube] *= per_px
                    seen[half, 1, cube] *= per_px
                interpolate(
                    *(
                        distances_px,
                        start,
                        height,
                        width,
                        seen[half, 0],
                        seen[half, 1],
                        n_cubes,
                        places,
                        inwards_px,
                    )
                )
                _decided(seen[half], inwards_px, n_cubes, height, width, half, is_within, is_outside)
            for cube in range(n_cubes):
                block = asked[first + cube]
                within[block, view] = is_within[cube]
                out, unsure = is_outside[cube], ~is_within[cube]
                for rank in range(overruled + 1):
                    excluded[rank, block], out = excluded[rank, block] | out, excluded[rank, block] & out
                    undecided[rank, block], unsure = (
                        undecided[rank, block] | unsure,
                        undecided[rank, block] & unsure,
                    )
    left = ~excluded[overruled]
    return within, left, left & ~undecided[overruled]


@compiled
def _decided(
    seen: Array,
    inwards_px: Array,
    n_cubes: int,
    height: int,
    width: int,
    half: int,
    within: Halves,
    outside: Halves,
) -> None:
    """Set the bit of this half where cubes (C,) seen (4, C) are within the silhouette, and where outside."""
    scale = np.float32(SPACING_PX)
    last_u, last_v = np.float32(width - 1), np.float32(height - 1)
    for cube in range(n_cubes):
        u, v, reach_px = seen[0, cube], seen[1, cube], seen[2, cube]
        # the region ends at the last nodes, and beyond it the silhouette
        to_end_px = scale * min(min(u, last_u - u), min(v, last_v - v))
        is_within = min(inwards_px[cube], to_end_px) > reach_px
        is_outside = max(-inwards_px[cube], -to_end_px - scale) > reach_px
        within[cube] |= np.uint8(np.uint8(is_within) << half)
        outside[cube] |= np.uint8(np.uint8(is_outside) << half)


@compiled
def _halved(
    blocks: Blocks, within: Halves, left: Halves, inside: Halves, edge: int, n: int
) -> tuple[Blocks, NDArray[np.uint8], Blocks]:
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
            if max(i, j, k) >= n or not left[block] >> half & 1:
                continue
            if inside[block] >> half & 1 and min(i, j, k) > 0 and max(i, j, k) + edge < n:
                solid[n_solid, 0], solid[n_solid, 1], solid[n_solid, 2] = i, j, k
                n_solid += 1
            else:
                cut[n_cut, 0], cut[n_cut, 1], cut[n_cut, 2] = i, j, k
                for view in range(n_views):
                    known[n_cut, view] = within[block, view] >> half & 1
                n_cut += 1
    return cut[:n_cut], known[:n_cut], solid[:n_solid]
