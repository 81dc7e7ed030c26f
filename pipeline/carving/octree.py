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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.carving.interpolation import interpolate, room_for
from pipeline.carving.views import HALVES, Pinholes, View, look
from pipeline.compiled import compiled
from pipeline.segmentation.silhouette import SPACING_PX, Silhouette

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


class Coarse(NamedTuple):
    """Distances of V views at every `SPACING_PX`-th pixel."""

    flat_px: Array  # one view's after the other's
    shapes: NDArray[np.int32]  # (V, 2)
    firsts: NDArray[np.int32]  # (V,) of each view


class Reach(NamedTuple):
    """How far a block reaches from its centre."""

    across_mm: Array  # (V,) at right angles to each view's optical axis
    along_mm: Array  # (V,) along it


def octree_of(views: Sequence[View], pinholes: Pinholes, n: int, size_mm: float, overruled: int) -> Octree:
    """The blocks of n^3 voxels in a cube around the origin; `overruled` views may exclude what is not carved."""
    coarse, pitch_mm = _coarse_of([silhouette for _, silhouette in views]), size_mm / n
    first = 2 * EDGES[0] * np.indices((-(-n // (2 * EDGES[0])),) * 3, np.int32).reshape(3, -1).T
    blocks, known = np.ascontiguousarray(first), np.zeros((len(first), len(views)), np.uint8)
    solid = []
    for edge in EDGES:
        half_mm = np.float32((edge + 1) / 2 * pitch_mm)
        reach = Reach(half_mm * pinholes.across, half_mm * pinholes.along)
        within, left, inside = _judged(blocks, known, edge, n, pitch_mm, pinholes, reach, coarse, overruled)
        blocks, known, whole = _halved(blocks, within, left, inside, edge, n)
        solid.append((whole, edge))
    reach = Reach(*np.full((2, len(views)), BESIDE_PART * pitch_mm, np.float32))
    within, left, _ = _judged(blocks, known, LEAF // 2, n, pitch_mm, pinholes, reach, coarse, overruled)
    return Octree(leaves=blocks, parts=left, within=within, solid=tuple(solid))


def _coarse_of(silhouettes: Sequence[Silhouette]) -> Coarse:
    images = [silhouette.coarse_px for silhouette in silhouettes]
    shapes = np.array([image.shape for image in images], np.int32)
    sizes = shapes.prod(axis=1)
    return Coarse(
        flat_px=np.concatenate([image.reshape(-1) for image in images]),
        shapes=shapes,
        firsts=(sizes.cumsum() - sizes).astype(np.int32),
    )


@compiled
def _judged(
    blocks: Blocks,
    known: Flags,
    edge: int,
    n: int,
    pitch_mm: float,
    pinholes: Pinholes,
    reach: Reach,
    coarse: Coarse,
    overruled: int,
) -> tuple[Halves, Halves, Halves]:
    """Halves of blocks, with this edge, that lie within each view (B, V); that are left (B,); and inside (B,).

    `known` (B, V) is not 0 where all of a block is within a view.
    """
    n_blocks, n_views = known.shape
    within = np.zeros((n_blocks, n_views), np.uint8)
    excluded, undecided = np.zeros((2, overruled + 1, n_blocks), np.uint8)
    asked = np.empty(n_blocks + 1, np.int32)
    centres_mm, seen = np.empty((3, CHUNK), np.float32), np.empty((HALVES, 4, CHUNK), np.float32)
    places, inwards_px = room_for(CHUNK), np.empty(CHUNK, np.float32)
    is_within, is_outside = np.empty((2, CHUNK), np.uint8)
    to_centre, pitch = np.float32(edge - n / 2), np.float32(pitch_mm)
    for view in range(n_views):
        n_asked = 0
        for block in range(n_blocks):
            asked[n_asked] = block
            within[block, view] = ALL if known[block, view] else 0
            n_asked += (known[block, view] == 0) & (excluded[overruled, block] != ALL)
        height, width, first = coarse.shapes[view, 0], coarse.shapes[view, 1], coarse.firsts[view]
        for begin in range(0, n_asked, CHUNK):
            chunk = asked[begin : min(begin + CHUNK, n_asked)]
            for cube in range(len(chunk)):
                for axis in range(3):
                    centres_mm[axis, cube] = pitch * (np.float32(blocks[chunk[cube], axis]) + to_centre)
                is_within[cube], is_outside[cube] = 0, 0
            look(pinholes, view, centres_mm, len(chunk), edge / 2 * pitch_mm, seen)
            for half in range(HALVES):
                _to_nodes(seen[half], len(chunk), pinholes, view, reach)
                interpolate(coarse.flat_px, first, height, width, seen[half], len(chunk), places, inwards_px)
                _decide(seen[half], inwards_px, len(chunk), height, width, half, is_within, is_outside)
            for cube in range(len(chunk)):
                within[chunk[cube], view] = is_within[cube]
                _count(excluded, chunk[cube], is_outside[cube])
                _count(undecided, chunk[cube], ALL ^ is_within[cube])
    left = ~excluded[overruled]
    return within, left, left & ~undecided[overruled]


@compiled
def _to_nodes(seen: Array, n_cubes: int, pinholes: Pinholes, view: int, reach: Reach) -> None:
    """Pixels become nodes, and depths the distances (C,) in px up to which parts of cubes may be from their centres."""
    per_px, slack_px, unbounded = np.float32(1 / SPACING_PX), np.float32(SLACK_PX), np.float32(np.inf)
    stretch_px, across_mm, along_mm = pinholes.stretches_px[view], reach.across_mm[view], reach.along_mm[view]
    for cube in range(n_cubes):
        nearest_mm = seen[2, cube] - along_mm
        reach_px = stretch_px * (across_mm + along_mm * seen[3, cube]) / nearest_mm + slack_px
        seen[0, cube] *= per_px
        seen[1, cube] *= per_px
        seen[2, cube] = reach_px if nearest_mm > 0 else unbounded  # the camera may be within


@compiled
def _decide(
    seen: Array,
    inwards_px: Array,
    n_cubes: int,
    height: int,
    width: int,
    half: int,
    is_within: Halves,
    is_outside: Halves,
) -> None:
    """Set the bit of this half where it is within the silhouette, and where outside."""
    scale, last_u, last_v = np.float32(SPACING_PX), np.float32(width - 1), np.float32(height - 1)
    for cube in range(n_cubes):
        u, v, reach_px = seen[0, cube], seen[1, cube], seen[2, cube]
        # the region ends at the last nodes, and a node further the silhouette
        to_end_px = scale * min(min(u, last_u - u), min(v, last_v - v))
        is_in = min(inwards_px[cube], to_end_px) > reach_px
        is_out = max(-inwards_px[cube], -to_end_px - scale) > reach_px
        is_within[cube] |= np.uint8(np.uint8(is_in) << half)
        is_outside[cube] |= np.uint8(np.uint8(is_out) << half)


@compiled
def _count(counted: Halves, block: int, halves: np.uint8) -> None:
    """Count a view for halves of a block: row m of `counted` (M, B) has those for which there are more than m."""
    for row in range(len(counted)):
        before = counted[row, block]
        counted[row, block] = before | halves
        halves = before & halves


@compiled
def _halved(
    blocks: Blocks, within: Halves, left: Halves, inside: Halves, edge: int, n: int
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
