"""Carving that evaluates the field only where the surface is."""

from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Singles
from pipeline.carving.hull import N_VIEWS, CarvingParameters, VisualHull
from pipeline.carving.octree import LEAF, Octree, build_octree, centers_of
from pipeline.carving.pinholes import OCTANTS, Pinholes, pinholes_of
from pipeline.carving.samples import (
    SampleValues,
    count_enclosing_views,
    count_view,
    fill_blocks,
    find_undecided,
    lower_distances,
    write_leaves,
)
from pipeline.geometry.bounds import bounds
from pipeline.rig.design import nominal_rig
from pipeline.segmentation.ball_silhouettes import ball_silhouettes
from pipeline.views.prepared import PreparedViews, prepare_views


def carve(views: PreparedViews, parameters: CarvingParameters) -> VisualHull:
    """Return the largest body consistent with every silhouette but `max_disagreeing_views`.

    Unknown pixels carve nothing.

    Raises
    ------
    ValueError
        Fewer than two views, beside those that may disagree.
    """
    n_overruled = parameters.max_disagreeing_views
    if len(views) < 2 + n_overruled:
        raise ValueError(f"{len(views)} usable silhouettes are too few to carve")
    n, pitch_mm = parameters.n, parameters.pitch_mm
    pinholes = pinholes_of(views, parameters.size_mm)
    octree = build_octree(views, pinholes, n, parameters.size_mm, n_overruled)
    if parameters.field == "view_count":
        values = _counts(views, pinholes, octree, parameters)
        level, inside, outside = (
            len(views) - n_overruled - (N_VIEWS - parameters.isolevel),
            float(len(views)),
            0.0,
        )
    else:
        values = _distances_mm(views, pinholes, octree, parameters)
        level, inside, outside = 0.0, 2 * pitch_mm, -pitch_mm
    if len(octree.leaves) == 0:
        corner, shape = np.zeros(3, np.int64), (0, 0, 0)
    else:  # the box of the leaves in a shell of outside, so that its surface is closed
        first, last = bounds(octree.leaves)
        corner = first.astype(np.int64) - 1
        shape = tuple(last + LEAF + 1 - corner)
    field = np.zeros(shape, np.float32)
    for blocks, edge in octree.solid:
        fill_blocks(field, corner, blocks, edge, inside)
    write_leaves(field, corner, octree.leaves, octree.cut, values, level, inside, outside)
    return VisualHull(
        field=field,
        leaves=octree.leaves - corner.astype(np.int32),
        level=level,
        origin_mm=np.asarray(pitch_mm * (corner + (1 - n) / 2), np.float64),
        pitch_mm=pitch_mm,
        touches_border=_close(field, corner, n, level, outside),
    )


def warm_up(parameters: CarvingParameters) -> VisualHull:
    """Carve a coarse hull of a made-up ball, which compiles what the first stone would wait for."""
    rig = nominal_rig()
    return carve(prepare_views(ball_silhouettes(rig), rig), replace(parameters, n=32))


def _distances_mm(
    views: PreparedViews, pinholes: Pinholes, octree: Octree, parameters: CarvingParameters
) -> SampleValues:
    """Return the samples' signed distances to the viewing cones' intersection, cut off at about a voxel."""
    n_octants = OCTANTS * len(octree.leaves)
    smallest_mm = np.full((parameters.max_disagreeing_views + 1, OCTANTS, n_octants), np.inf, np.float32)
    centers_mm, half_pitch_mm = _octant_centers_mm(octree, parameters), parameters.pitch_mm / 2
    octants = np.empty(n_octants + 1, np.int32)
    for view, silhouette in enumerate(views.silhouettes):
        n = find_undecided(octree.within, octree.cut, view, octants)
        lower_distances(
            smallest_mm, centers_mm, octants, n, half_pitch_mm, pinholes, view, silhouette.fine_px
        )
    return smallest_mm[-1]


def _counts(
    views: PreparedViews, pinholes: Pinholes, octree: Octree, parameters: CarvingParameters
) -> SampleValues:
    """Return the paper's S: how many silhouettes contain the nearest pixel of each sample's projection."""
    counts = count_enclosing_views(octree.within)
    centers_mm, half_pitch_mm = _octant_centers_mm(octree, parameters), parameters.pitch_mm / 2
    octants = np.empty(counts.shape[1] + 1, np.int32)
    for view, silhouette in enumerate(views.silhouettes):
        n = find_undecided(octree.within, octree.cut, view, octants)
        count_view(counts, centers_mm, octants, n, half_pitch_mm, pinholes, view, silhouette.labels)
    return counts


def _octant_centers_mm(octree: Octree, parameters: CarvingParameters) -> Annotated[Singles, "(3, 8 L)"]:
    """Return the centres of the leaves' octants in the world frame."""
    steps_mm = np.float32(LEAF // 2 * parameters.pitch_mm) * np.indices((2, 2, 2), np.float32)
    firsts_mm = centers_of(octree.leaves, LEAF // 2, parameters.n, parameters.pitch_mm)
    centers_mm = np.repeat(firsts_mm, OCTANTS, axis=1)
    centers_mm += np.tile(steps_mm.reshape(3, OCTANTS), len(octree.leaves))
    return centers_mm


def _close(field: Singles, corner: NDArray[np.int64], n: int, level: float, outside: float) -> bool:
    """Set what is inside at the border of the grid to `outside`; return whether anything was.

    The field begins at voxel `corner` of the grid.
    """
    touches_border = False
    for axis in range(3):
        for border in (0, n - 1):
            at = border - corner[axis]
            if 0 <= at < field.shape[axis]:
                samples = np.moveaxis(field, axis, 0)[at]
                is_inside = samples > level
                samples[is_inside] = outside
                touches_border |= bool(is_inside.any())
    return touches_border
