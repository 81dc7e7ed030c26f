"""The blocks of voxels that the surface may cut, found by splitting blocks that it may cut.

A view decides about a block when the pixel of the block's centre is further from the silhouette's edge than any
part of the block can be from that pixel: then the block lies within the viewing cone, or outside. A block that is
outside of enough views is dropped, and a view that a block lies within is not evaluated again for its octants.

A block includes one voxel beyond it on every side, so that no cell of marching cubes that begins or ends in it is
cut unseen. The octants of the finest blocks, of 2^3 samples, are cells' ends alone: what is within a view, or outside,
by more than a voxel has no part in what marching cubes interpolates. How far points of a block are from its centre in
the image is bounded, not computed: by the block's extents across and along the optical axis, and the most that a
lens bends.
"""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Singles
from pipeline.carving.pinholes import CHUNK, OCTANTS, Pinholes, project_octants
from pipeline.compiled import compiled, compiled_within, whole
from pipeline.segmentation.silhouette import COARSE_PX
from pipeline.views.interpolation import interpolate
from pipeline.views.prepared import PreparedViews

Blocks = Annotated[NDArray[np.int32], "(B, 3)"]
"""First voxels of blocks."""
OctantBits = NDArray[np.uint8]
"""A bit for each octant of a block."""

EDGES = (16, 8, 4)
"""Edges of the blocks, in voxels, from coarse to fine."""
LEAF = EDGES[-1]
"""Edge of the finest blocks."""
SLACK_PX = 1.0
"""Bound of the error of distances far from an edge, and of those between nodes: they are less too large than this."""
BESIDE_OCTANT = 11**0.5 / 2
"""From the centre of a leaf's octant to the furthest sample next to one of its samples, (3, 1, 1) / 2, in voxels."""
ALL = np.uint8(255)
FIRST = whole(0)
"""Number of blocks found at first."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Octree:
    """The hull in blocks; what is in none is outside."""

    leaves: Blocks  # (L, 3) that the surface may cut
    cut: OctantBits  # (L,) octants of them that may be cut
    within: OctantBits  # (L, V) octants that lie within a view
    solid: tuple[tuple[Blocks, int], ...]  # blocks within the hull, with their edges in voxels


class _Judgement(NamedTuple):
    """The judgement of V views on the octants of B blocks."""

    within: OctantBits  # (B, V) those that lie within each view
    excluded: OctantBits  # (M, B) in row m those that more than m views exclude
    unsure: OctantBits  # (M, B) and those that lie not within more than m views


def build_octree(views: PreparedViews, pinholes: Pinholes, n: int, size_mm: float, overruled: int) -> Octree:
    """Find the blocks of n^3 voxels in a cube around the origin; `overruled` views may exclude what is not carved."""
    pitch_mm = size_mm / n
    coarse_px = [silhouette.coarse_px for silhouette in views.silhouettes]
    shapes = np.array([image.shape for image in coarse_px])
    nodes = np.column_stack([shapes, np.cumsum(shapes.prod(axis=1)) - shapes.prod(axis=1)])
    images = pinholes, np.concatenate([image.reshape(-1) for image in coarse_px]), nodes
    first = 2 * EDGES[0] * np.indices((-(-n // (2 * EDGES[0])),) * 3, np.int32).reshape(3, -1).T
    blocks, known = np.ascontiguousarray(first), np.zeros((len(first), len(views)), np.uint8)
    solid = []
    for edge in EDGES:
        half_mm = np.float32((edge + 1) / 2 * pitch_mm)
        reach_mm = half_mm * np.array([pinholes.across, pinholes.along], np.float32)
        centers_mm = centers_of(blocks, 2 * edge, n, pitch_mm)
        judgement = _judge(centers_mm, known, edge / 2 * pitch_mm, images, reach_mm, overruled)
        blocks, known, uncut = _split(blocks, judgement, edge, n)
        solid.append((uncut, edge))
    reach_mm = np.full((2, len(views)), np.float32(BESIDE_OCTANT * pitch_mm))
    centers_mm = centers_of(blocks, LEAF, n, pitch_mm)
    judgement = _judge(centers_mm, known, LEAF / 4 * pitch_mm, images, reach_mm, overruled)
    return Octree(
        leaves=blocks, cut=~judgement.excluded[overruled], within=judgement.within, solid=tuple(solid)
    )


def centers_of(blocks: Blocks, edge: int, n: int, pitch_mm: float) -> Annotated[Singles, "(3, B)"]:
    """Return the centres (3, B) of blocks with this edge in a grid of n^3 voxels."""
    centers_mm = np.array(blocks.T, np.float32, order="C")
    centers_mm += np.float32((edge - n) / 2)
    centers_mm *= np.float32(pitch_mm)
    return centers_mm


def _judge(
    centers_mm: Singles,
    known: NDArray[np.uint8],
    quarter_mm: float,
    images: tuple[Pinholes, Singles, NDArray[np.int64]],
    reach_mm: Singles,
    overruled: int,
) -> _Judgement:
    """Judge the octants of blocks around `centers_mm` (3, B) with edges of four times `quarter_mm`.

    An octant reaches `reach_mm` (2, V) at right angles to each view's optical axis, and along it. `known` (B, V) is 1
    where all of a block is within a view, and else 0.
    """
    n_blocks = len(known)
    counts = np.zeros((2, overruled + 1, n_blocks), np.uint8)
    judgement = _Judgement(known * ALL, counts[0], counts[1])
    undecided = np.empty(n_blocks + 1, np.int32)
    _ask_views(centers_mm, quarter_mm, *images, reach_mm, undecided, judgement)
    return judgement


@compiled
def _ask_views(
    centers_mm: Singles,
    quarter_mm: float,
    pinholes: Pinholes,
    distances_px: Singles,
    nodes: NDArray[np.int64],
    reach_mm: Singles,
    undecided: NDArray[np.int32],
    judgement: _Judgement,
) -> None:
    """Complete a judgement; `undecided` (B + 1,) is scratch.

    `nodes` (V, 3) are the heights and widths of the views' coarse distances and where they begin.
    """
    within, excluded, unsure = judgement.within, judgement.excluded, judgement.unsure
    projected, weights = np.empty((OCTANTS, 4, CHUNK), np.float32), np.empty((2, CHUNK), np.float32)
    at, inwards_px = np.empty(CHUNK, np.int32), np.empty(CHUNK, np.float32)
    bits = np.empty((2, CHUNK), np.uint8)
    n_blocks, last, per_px = len(within), len(excluded) - 1, np.float32(1 / COARSE_PX)
    for view in range(len(nodes)):
        n_undecided = FIRST
        for block in range(n_blocks):
            undecided[n_undecided] = block
            n_undecided += (within[block, view] == 0) & (excluded[last, block] != ALL)
        height, width = nodes[view, 0], nodes[view, 1]
        image_px = distances_px[nodes[view, 2] :]
        for begin in range(0, n_undecided, CHUNK):
            n = CHUNK if begin + CHUNK < n_undecided else n_undecided - begin
            project_octants(pinholes, view, centers_mm, undecided, begin, n, quarter_mm, projected)
            for cube in range(n):
                bits[0, cube], bits[1, cube] = 0, 0
            for octant in range(OCTANTS):
                places, stretch_px = projected[octant], pinholes.stretches_px[view]
                interpolate(image_px, height, width, per_px, places, n, at, weights, inwards_px)
                _decide(places, inwards_px, n, height, width, stretch_px, reach_mm, view, octant, bits)
            for cube in range(n):
                block = undecided[begin + cube]
                within[block, view] = bits[0, cube]
                _count(excluded, block, bits[1, cube])
                _count(unsure, block, np.uint8(~bits[0, cube]))


@compiled_within
def _decide(
    places: Singles,
    inwards_px: Singles,
    n: int,
    height: int,
    width: int,
    stretch_px: np.float32,
    reach_mm: Singles,
    view: int,
    octant: int,
    bits: OctantBits,
) -> None:
    """Set the octant's bit where all around the first `n` places is within the silhouette, and where outside."""
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
        bits[0, cube] |= np.uint8(np.uint8(is_in) << octant)
        bits[1, cube] |= np.uint8(np.uint8(is_out) << octant)


@compiled_within
def _count(counted: OctantBits, block: int, octants: np.uint8) -> None:
    """Count a view for octants of a block: row m of `counted` (M, B) has those for which there are more than m."""
    for row in range(len(counted)):
        before = counted[row, block]
        counted[row, block] = before | octants
        octants = before & octants


def _split(
    blocks: Blocks, judgement: _Judgement, edge: int, n: int
) -> tuple[Blocks, NDArray[np.uint8], Blocks]:
    """Return blocks' octants, with this edge, that may be cut, which views these lie within (B, V), and solid ones."""
    n_octants, n_views = OCTANTS * len(blocks), judgement.within.shape[1]
    cut, solid = np.empty((2, n_octants, 3), np.int32)
    known = np.empty((n_octants, n_views), np.uint8)
    n_cut, n_solid = _write_octants(blocks, judgement, edge, n, cut, known, solid)
    return cut[:n_cut], known[:n_cut], solid[:n_solid]


@compiled
def _write_octants(
    blocks: Blocks,
    judgement: _Judgement,
    edge: int,
    n: int,
    cut: Blocks,
    known: NDArray[np.uint8],
    solid: Blocks,
) -> tuple[int, int]:
    """Fill in what `_split` returns, and return how many octants may be cut and how many are solid.

    A block at the border of the grid is never solid: the surface closes there.
    """
    within, last = judgement.within, len(judgement.excluded) - 1
    n_cut = n_solid = FIRST
    for block in range(len(blocks)):
        excluded, unsure = judgement.excluded[last, block], judgement.unsure[last, block]
        for octant in range(OCTANTS):
            i = blocks[block, 0] + edge * (octant >> 2 & 1)
            j = blocks[block, 1] + edge * (octant >> 1 & 1)
            k = blocks[block, 2] + edge * (octant & 1)
            if excluded >> octant & 1 or i >= n or j >= n or k >= n:
                continue
            is_at_border = i == 0 or j == 0 or k == 0 or i + edge >= n or j + edge >= n or k + edge >= n
            if unsure >> octant & 1 or is_at_border:
                cut[n_cut, 0], cut[n_cut, 1], cut[n_cut, 2] = i, j, k
                for view in range(within.shape[1]):
                    known[n_cut, view] = within[block, view] >> octant & 1
                n_cut += 1
            else:
                solid[n_solid, 0], solid[n_solid, 1], solid[n_solid, 2] = i, j, k
                n_solid += 1
    return n_cut, n_solid
