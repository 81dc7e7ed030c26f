"""Carving only where the surface is."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.carving.hull import CarvingParameters, VisualHull
from pipeline.carving.octree import LEAF, Octree, centres_of, octree_of
from pipeline.carving.samples import count, count_within, fill, lower, place, undecided
from pipeline.carving.views import HALVES, Pinholes, View, pinholes_of, usable_views
from pipeline.frames import CameraId
from pipeline.geometry.bounds import bounds
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import nominal_rig
from pipeline.segmentation.ball_silhouettes import ball_silhouettes
from pipeline.segmentation.silhouette import Silhouette

Array = NDArray[np.float32]


def carve(
    silhouettes: Mapping[CameraId, Silhouette], rig: RigCalibration, parameters: CarvingParameters
) -> VisualHull:
    """Largest body consistent with every usable silhouette but `max_disagreeing_views`.

    Unknown pixels, and views without a usable silhouette, carve nothing.

    Raises
    ------
    ValueError
        Fewer than two usable silhouettes, or a camera that the rig does not know.
    """
    views = usable_views(silhouettes, rig)
    n_overruled = parameters.max_disagreeing_views
    if len(views) < 2 + n_overruled:
        raise ValueError(f"{len(views)} usable silhouettes are too few to carve")
    n, pitch_mm = parameters.n, parameters.pitch_mm
    pinholes = pinholes_of(views, parameters.size_mm)
    octree = octree_of(views, pinholes, n, parameters.size_mm, n_overruled)
    if parameters.field == "view_count":
        values = _counts(views, pinholes, octree, parameters)
        level, inside, outside = len(views) - n_overruled - 0.5, float(len(views)), 0.0
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
        fill(field, corner, blocks, edge, inside)
    place(field, corner, octree.leaves, octree.parts, values, level, inside, outside)
    return VisualHull(
        field=field,
        leaves=octree.leaves - corner.astype(np.int32),
        level=level,
        origin_mm=np.asarray(pitch_mm * (corner + (1 - n) / 2), np.float64),
        pitch_mm=pitch_mm,
        touches_border=_close(field, corner, n, level, outside),
    )


def warm_up(parameters: CarvingParameters) -> VisualHull:
    """A coarse hull of a ball: compiles what the first stone would wait for."""
    rig = nominal_rig()
    return carve(ball_silhouettes(rig), rig, replace(parameters, n=32))


def _distances_mm(
    views: Sequence[View], pinholes: Pinholes, octree: Octree, parameters: CarvingParameters
) -> Array:
    """Signed distances (HALVES, PARTS) to the viewing cones' intersection, cut off at about a voxel."""
    n_parts = HALVES * len(octree.leaves)
    smallest_mm = np.full((parameters.max_disagreeing_views + 1, HALVES, n_parts), np.inf, np.float32)
    centres_mm, half_mm = _part_centres(octree, parameters), parameters.pitch_mm / 2
    parts = np.empty(n_parts + 1, np.int32)
    for view, (_, silhouette) in enumerate(views):
        n = undecided(octree.within, octree.parts, view, parts)
        lower(smallest_mm, centres_mm, parts, n, half_mm, pinholes, view, silhouette.fine_px)
    return smallest_mm[-1]


def _counts(
    views: Sequence[View], pinholes: Pinholes, octree: Octree, parameters: CarvingParameters
) -> Array:
    """The paper's S (HALVES, PARTS): how many silhouettes contain the nearest pixel of each sample's projection."""
    counts = count_within(octree.within)
    centres_mm, half_mm = _part_centres(octree, parameters), parameters.pitch_mm / 2
    parts = np.empty(counts.shape[1] + 1, np.int32)
    for view, (_, silhouette) in enumerate(views):
        n = undecided(octree.within, octree.parts, view, parts)
        count(counts, centres_mm, parts, n, half_mm, pinholes, view, silhouette.labels)
    return counts


def _part_centres(octree: Octree, parameters: CarvingParameters) -> Array:
    """(3, PARTS) in the world frame."""
    steps_mm = np.float32(LEAF // 2 * parameters.pitch_mm) * np.indices((2, 2, 2), np.float32)
    firsts_mm = centres_of(octree.leaves, LEAF // 2, parameters.n, parameters.pitch_mm)
    centres_mm = np.repeat(firsts_mm, HALVES, axis=1)
    centres_mm += np.tile(steps_mm.reshape(3, HALVES), len(octree.leaves))
    return centres_mm


def _close(field: Array, corner: NDArray[np.int64], n: int, level: float, outside: float) -> bool:
    """Whether a field that begins at voxel `corner` is inside anywhere at the border of the grid; it no longer is."""
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
