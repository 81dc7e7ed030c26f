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

from pipeline.carving.interpolation import interpolate
from pipeline.carving.views import CHUNK, HALVES, Pinholes, View, look
from pipeline.compiled import compiled, compiled_within, whole
from pipeline.segmentation.silhouette import COARSE_PX

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
ALL = np.uint8(255)
FIRST = whole(0)
"""Of what is found."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Octree:
    """The hull in blocks; what is in none is outside."""

    leaves: Blocks  # (L, 3) that the surface may cut
    parts: Halves  # (L,) of them that may be cut
    within: Halves  # (L, V) parts that lie within a view
    solid: tuple[tuple[Blocks, int], ...]  # within the hull, with their edges in voxels


class _Judgement(NamedTuple):
    """What views say about the halves of B blocks."""

    within: Halves  # (B, V) those that lie within each view
    excluded: Halves  # (M, B) in row m those that more than m views exclude
    unsure: Halves  # (M, B) and those that lie not within more than m views


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
        half_mm = np.float32((edge + 1) / 2 * pitch_mm)
        reach_mm = half_mm * np.array([pinholes.across, pinholes.along], np.float32)
        centres_mm = centres_of(blocks, 2 * edge, n, pitch_mm)
        judgement = _judged(centres_mm, known, edge / 2 * pitch_mm, looked_at, reach_mm, overruled)
        blocks, known, uncut = _halved(blocks, judgement, edge, n)
        solid.append((uncut, edge))
    reach_mm = np.full((2, len(views)), np.float32(BESIDE_PART * pitch_mm))
    centres_mm = centres_of(blocks, LEAF, n, pitch_mm)
    judgement = _judged(centres_mm, known, LEAF / 4 * pitch_mm, looked_at, reach_mm, overruled)
    parts = ~judgement.excluded[overruled]
    return Octree(leaves=blocks, parts=parts, within=judgement.within, solid=tuple(solid))


def centres_of(blocks: Blocks, edge: int, n: int, pitch_mm: float) -> Array:
    """Centres (3, B) of blocks with this edge in a grid of n^3 voxels."""
    centres_mm = np.array(blocks.T, np.float32, order="C")
    centres_mm += np.float32((edge - n) / 2)
    centres_mm *= np.float32(pitch_mm)
    return centres_mm


def _judged(
    centres_mm: Array,
    known: Flags,
    half_mm: float,
    looked_at: tuple[Pinholes, Array, NDArray[np.int64]],
    reach_mm: Array,
    overruled: int,
) -> _Judgement:
    """Of the halves of blocks around `centres_mm` (3, B); half of a half's edge is `half_mm`.

    A half reaches `reach_mm` (2, V) at right angles to each view's optical axis, and along it. `known` (B, V) is 1
    where all of a block is within a view, and else 0.
    """
    n_blocks = len(known)
    counts = np.zeros((2, overruled + 1, n_blocks), np.uint8)
    judgement = _Judgement(known * ALL, counts[0], counts[1])
    asked = np.empty(n_blocks + 1, np.int32)
    _judge(centres_mm, half_mm, *looked_at, reach_mm, asked, judgement)
    return judgement


@compiled
def _judge(
    centres_mm: Array,
    half_mm: float,
    pinholes: Pinholes,
    distances_px: Array,
    nodes: NDArray[np.int64],
    reach_mm: Array,
    asked: NDArray[np.int32],
    judgement: _Judgement,
) -> None:
    """Complete a judgement; there is room for the blocks `asked` about (B + 1,).

    `nodes` (V, 3) are the heights and widths of the views' coarse distances and where they begin.
    """
    within, excluded, unsure = judgement.within, judgement.excluded, judgement.unsure
    seen, weights = np.empty((HALVES, 4, CHUNK), np.float32), np.empty((2, CHUNK), np.float32)
    at, inwards_px = np.empty(CHUNK, np.int32), np.empty(CHUNK, np.float32)
    bits = np.empty((2, CHUNK), np.uint8)
    n_blocks, last, per_px = len(within), len(excluded) - 1, np.float32(1 / COARSE_PX)
    for view in range(len(nodes)):
        n_asked = FIRST
        for block in range(n_blocks):
            asked[n_asked] = block
            n_asked += (within[block, view] == 0) & (excluded[last, block] != ALL)
        height, width = nodes[view, 0], nodes[view, 1]
        image_px = distances_px[nodes[view, 2] :]
        for begin in range(0, n_asked, CHUNK):
            n = CHUNK if begin + CHUNK < n_asked else n_asked - begin
            look(pinholes, view, centres_mm, asked, begin, n, half_mm, seen)
            for cube in range(n):
                bits[0, cube], bits[1, cube] = 0, 0
            for half in range(HALVES):
                places, stretch_px = seen[half], pinholes.stretches_px[view]
                interpolate(image_px, height, width, per_px, places, n, at, weights, inwards_px)
                _decide(places, inwards_px, n, height, width, stretch_px, reach_mm, view, half, bits)
            for cube in range(n):
                block = asked[begin + cube]
                within[block, view] = bits[0, cube]
                _count(excluded, block, bits[1, cube])
                _count(unsure, block, np.uint8(~bits[0, cube]))


@compiled_within
def _decide(
    places: Array,
    inwards_px: Array,
    n: int,
    height: int,
    width: int,
    stretch_px: np.float32,
    reach_mm: Array,
    view: int,
    half: int,
    bits: Halves,
) -> None:
    """Set the bit of this half where all around the first `n` places is within the silhouette, and where outside."""
    across_mm, along_mm = reach_mm[0, view], reach_mm[1, view]
    slack_px, unbounded, spacing_px = np.float32(SLACK_PX), np.float32(np.inf), np.float32(COARSE_PX)
    last_u, last_v = spacing_px * np.float32(width - 1), spacing_px * np.float32(height - 1)
    for cube in range(n):
        u, v, depth_mm, slope = places[0, cube], places[1, cube], places[2, cube], places[3, cube]
        reach_px = stretch_px * (across_mm + along_mm * slope) / (depth_mm - along_mm) + slack_px
        reach_px = reach_px if depth_mm > along_mm else unbounded  # the camera may be within
        # the region ends at the last nodes, and a node further the silhouette
        to_end_px = min(min(u, last_u - u), min(v, last_v - v))
        is_in = min(inwards_px[cube], to_end_px) > reach_px
        is_out = max(-inwards_px[cube], -to_end_px - spacing_px) > reach_px
        bits[0, cube] |= np.uint8(np.uint8(is_in) << half)
        bits[1, cube] |= np.uint8(np.uint8(is_out) << half)


@compiled_within
def _count(counted: Halves, block: int, halves: np.uint8) -> None:
    """Count a view for halves of a block: row m of `counted` (M, B) has those for which there are more than m."""
    for row in range(len(counted)):
        before = counted[row, block]
        counted[row, block] = before | halves
        halves = before & halves


def _halved(blocks: Blocks, judgement: _Judgement, edge: int, n: int) -> tuple[Blocks, Flags, Blocks]:
    """Of the halves of blocks, with this edge, those that may be cut, which views they lie within, and solid ones."""
    n_halves, n_views = HALVES * len(blocks), judgement.within.shape[1]
    cut, solid = np.empty((2, n_halves, 3), np.int32)
    known = np.empty((n_halves, n_views), np.uint8)
    n_cut, n_solid = _halve(blocks, judgement, edge, n, cut, known, solid)
    return cut[:n_cut], known[:n_cut], solid[:n_solid]


@compiled
def _halve(
    blocks: Blocks, judgement: _Judgement, edge: int, n: int, cut: Blocks, known: Flags, solid: Blocks
) -> tuple[int, int]:
    """Set what `_halved` finds, and tell how many may be cut, and how many are solid.

    A block at the border of the grid is never solid: the surface closes there.
    """
    within, last = judgement.within, len(judgement.excluded) - 1
    n_cut = n_solid = FIRST
    for block in range(len(blocks)):
        excluded, unsure = judgement.excluded[last, block], judgement.unsure[last, block]
        for half in range(HALVES):
            i = blocks[block, 0] + edge * (half >> 2 & 1)
            j = blocks[block, 1] + edge * (half >> 1 & 1)
            k = blocks[block, 2] + edge * (half & 1)
            if excluded >> half & 1 or i >= n or j >= n or k >= n:
                continue
            is_at_border = i == 0 or j == 0 or k == 0 or i + edge >= n or j + edge >= n or k + edge >= n
            if unsure >> half & 1 or is_at_border:
                cut[n_cut, 0], cut[n_cut, 1], cut[n_cut, 2] = i, j, k
                for view in range(within.shape[1]):
                    known[n_cut, view] = within[block, view] >> half & 1
                n_cut += 1
            else:
                solid[n_solid, 0], solid[n_solid, 1], solid[n_solid, 2] = i, j, k
                n_solid += 1
    return n_cut, n_solid
