"""Values of the field at the samples of leaves, each in the views that are undecided about it.

Where the surface is, a view counts only with samples near its silhouette's edge: of the 2^3 samples of each part of
a leaf none is asked in a view that the part lies within, far enough for it to have no part in what marching cubes
interpolates, and none once all are outside by more than a voxel.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.carving.octree import LEAF, SLACK_PX, WITHIN, Blocks, States
from pipeline.carving.views import Pinholes, look
from pipeline.compiled import compiled
from pipeline.segmentation.silhouette import MARGIN_PX, UNKNOWN

Array = NDArray[np.float32]
Grey = NDArray[np.uint8]

PARTS = 8
"""Of a leaf, and samples of a part."""
SAMPLES = LEAF**3
"""Of a leaf, part by part."""


@compiled
def offset_of(sample: int) -> tuple[int, int, int]:
    """Where a leaf's sample is, from its first one."""
    part, within = sample // PARTS, sample % PARTS
    return (
        2 * (part >> 2 & 1) + (within >> 2 & 1),
        2 * (part >> 1 & 1) + (within >> 1 & 1),
        2 * (part & 1) + (within & 1),
    )


def steps_of(pinholes: Pinholes, pitch_mm: float) -> Array:
    """From a leaf's first sample to all of them, then to the centres of its parts, in cameras' frames (V, 3, P)."""
    parts = 2 * np.indices((2, 2, 2)).reshape(3, PARTS, 1)
    within = np.indices((2, 2, 2)).reshape(3, 1, PARTS)
    offsets = np.concatenate([(parts + within).reshape(3, SAMPLES), parts[:, :, 0] + 0.5], axis=1)
    return (pitch_mm * pinholes.R @ offsets).astype(np.float32)


@compiled
def lower(
    values_mm: Array,
    open_parts: Grey,
    leaves: Blocks,
    states: States,
    n: int,
    pitch_mm: float,
    pinholes: Pinholes,
    view: int,
    steps_mm: Array,
    distance_px: Array,
) -> None:
    """Enter a view's signed distances to its viewing cone into the smallest so far (M, L, SAMPLES), in order.

    `open_parts` (L,) has a bit for each part of a leaf that may still be cut.
    """
    height, width = distance_px.shape
    flat_px = distance_px.reshape(-1)
    last_u, last_v = np.float32(width - 1), np.float32(height - 1)
    zero = np.float32(0)
    per_focal = np.float32(1 / pinholes.focals_px[view])
    # from a part's centre to its samples, and one voxel on
    across_mm = np.float32((pinholes.across[view] / 2 + 1) * pitch_mm)
    along_mm = np.float32((pinholes.along[view] / 2 + 1) * pitch_mm)
    stretch_px = np.float32(pinholes.stretches_px[view])
    seen = np.empty((4, SAMPLES + PARTS), np.float32)
    low = (1 - n) / 2
    chosen = np.empty(PARTS, np.int64)
    for leaf in range(len(leaves)):
        if states[leaf, view] == WITHIN or open_parts[leaf] == 0:
            continue
        x, y, z = (
            pitch_mm * (low + leaves[leaf, 0]),
            pitch_mm * (low + leaves[leaf, 1]),
            pitch_mm * (low + leaves[leaf, 2]),
        )
        look(pinholes, view, x, y, z, steps_mm, seen)
        n_chosen = 0
        for part in range(PARTS):
            u, v, z = seen[0, SAMPLES + part], seen[1, SAMPLES + part], seen[2, SAMPLES + part]
            reach_mm = across_mm + seen[3, SAMPLES + part] * along_mm
            reach_px = stretch_px * reach_mm / (z - along_mm) + np.float32(SLACK_PX)
            near_u, near_v = min(max(u, zero), last_u), min(max(v, zero), last_v)
            at = np.uint64(int(near_v + np.float32(0.5)) * width + int(near_u + np.float32(0.5)))
            to_end_px = min(min(u, last_u - u), min(v, last_v - v))
            is_within = (z > along_mm) & (min(flat_px[at], to_end_px) > reach_px)
            chosen[n_chosen] = part
            n_chosen += (not is_within) & (open_parts[leaf] >> part & 1)
        for part in chosen[:n_chosen]:
            highest_mm = np.float32(-np.inf)
            for sample in range(PARTS * part, PARTS * part + PARTS):
                u, v, z = seen[0, sample], seen[1, sample], seen[2, sample]
                value_px = np.float32(-MARGIN_PX)
                if u >= 0 and u <= last_u and v >= 0 and v <= last_v and z > 0:
                    column, row = min(int(u), width - 2), min(int(v), height - 2)
                    right, below = u - np.float32(column), v - np.float32(row)
                    at = np.uint64(row * width + column)
                    under, one = at + np.uint64(width), np.uint64(1)
                    first_px = flat_px[at] + right * (flat_px[at + one] - flat_px[at])
                    second_px = flat_px[under] + right * (flat_px[under + one] - flat_px[under])
                    value_px = first_px + below * (second_px - first_px)
                seen[2, sample] = value_px * abs(z) * per_focal
            for rank in range(len(values_mm)):
                highest_mm = np.float32(-np.inf)
                for sample in range(PARTS * part, PARTS * part + PARTS):
                    known_mm, value_mm = values_mm[rank, leaf, sample], seen[2, sample]
                    values_mm[rank, leaf, sample] = min(known_mm, value_mm)
                    seen[2, sample] = max(known_mm, value_mm)
                    highest_mm = max(highest_mm, min(known_mm, value_mm))
            if highest_mm < -pitch_mm:
                open_parts[leaf] &= ~np.uint8(1 << part)


@compiled
def count(
    counts: Array,
    leaves: Blocks,
    states: States,
    n: int,
    pitch_mm: float,
    pinholes: Pinholes,
    view: int,
    steps_mm: Array,
    labels: Grey,
) -> None:
    """Add 1 to the samples (L, SAMPLES) whose nearest pixel is inside or unknown in a view."""
    height, width = labels.shape
    seen = np.empty((4, SAMPLES + PARTS), np.float32)
    low = (1 - n) / 2
    half = np.float32(0.5)
    for leaf in range(len(leaves)):
        if states[leaf, view] == WITHIN:
            for sample in range(SAMPLES):
                counts[leaf, sample] += 1
            continue
        x, y, z = (
            pitch_mm * (low + leaves[leaf, 0]),
            pitch_mm * (low + leaves[leaf, 1]),
            pitch_mm * (low + leaves[leaf, 2]),
        )
        look(pinholes, view, x, y, z, steps_mm, seen)
        for sample in range(SAMPLES):
            u, v = seen[0, sample] + half, seen[1, sample] + half
            if u >= 0 and u < width and v >= 0 and v < height and seen[2, sample] > 0:
                counts[leaf, sample] += labels[np.uint64(v), np.uint64(u)] >= UNKNOWN


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
    values: Array,
    n: int,
    level: float,
    inside: float,
    outside: float,
) -> bool:
    """Write the values (L, SAMPLES) of leaves into a field that begins at voxel `corner`.

    What is inside at the border of the grid becomes `outside`; whether there is any is returned.
    """
    flat, row, plane = field.reshape(-1), field.shape[2], field.shape[1] * field.shape[2]
    steps = np.empty(SAMPLES, np.int64)
    for sample in range(SAMPLES):
        i, j, k = offset_of(sample)
        steps[sample] = plane * i + row * j + k
    touches_border = False
    for leaf in range(len(leaves)):
        i0, j0, k0 = leaves[leaf, 0], leaves[leaf, 1], leaves[leaf, 2]
        first = plane * (i0 - corner[0]) + row * (j0 - corner[1]) + k0 - corner[2]
        is_at_border = min(i0, j0, k0) == 0 or max(i0, j0, k0) + LEAF == n
        for sample in range(SAMPLES):
            value = min(values[leaf, sample], np.float32(inside))
            if value == level:  # would make triangles without area
                value += np.float32(1e-4)
            if is_at_border and value > level:
                i, j, k = offset_of(sample)
                if min(i0 + i, j0 + j, k0 + k) == 0 or max(i0 + i, j0 + j, k0 + k) == n - 1:
                    touches_border, value = True, np.float32(outside)
            flat[np.uint64(first + steps[sample])] = value
    return touches_border
