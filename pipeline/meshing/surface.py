"""Closed triangle mesh of the visual hull, by marching cubes over its field (the paper's eq. (11))."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import skimage  # imports its submodules on use

from pipeline.arrays import Faces, PointsMM
from pipeline.carving import VisualHull, all_leaves
from pipeline.meshing.connected_surfaces import largest_surface
from pipeline.meshing.cubes import march


class Mesher(StrEnum):
    """Implementation of marching cubes; the words are those of configuration and `stonefall measure --mesher`."""

    OWN = "own"
    """Over the octree's leaves."""
    SKIMAGE = "skimage"
    """scikit-image's over the whole field, the reference: slower, and it holds the GIL."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshingParameters:
    """Parameters of turning the field into a mesh."""

    mesher: Mesher = (
        Mesher.OWN
    )  # or "skimage": scikit-image's, slower, which all threads of a worker wait for


@dataclass(frozen=True, slots=True, eq=False)
class ParticleMesh:
    """Closed surface in the world frame; faces counter-clockwise seen from outside."""

    vertices_mm: PointsMM
    faces: Faces


def mesh_hull(hull: VisualHull, mesher: Mesher = Mesher.OWN) -> ParticleMesh | None:
    """Return the largest connected surface of the hull, in mm, or `None` if the hull is empty.

    Where the hull reaches the border of the grid (`hull.touches_border`) the surface is closed along it.
    """
    if mesher is Mesher.SKIMAGE:
        vertices, faces = _skimage_surface(hull)
    else:
        vertices, faces = march(hull.field, hull.level, hull.leaves)
    if len(faces) == 0:
        return None
    vertices, faces = largest_surface(vertices, faces)
    for axis, column in enumerate(vertices.T):  # column by column takes a third of the time
        column *= hull.pitch_mm
        column += hull.origin_mm[axis]
    return ParticleMesh(vertices, faces)


def _skimage_surface(hull: VisualHull) -> tuple[PointsMM, Faces]:
    if not (hull.field > hull.level).any():
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    vertices, faces, _, _ = skimage.measure.marching_cubes(
        hull.field, hull.level, gradient_direction="ascent", allow_degenerate=False
    )
    return vertices.astype(np.float64), faces.astype(np.int64)


def warm_up() -> ParticleMesh | None:
    """Mesh a small ball, which compiles the loops of this package before the first stone."""
    samples = np.indices((8, 8, 8))
    return mesh_hull(
        VisualHull(
            field=(3 - np.linalg.norm(samples - 3.6, axis=0)).astype(np.float32),
            leaves=all_leaves((8, 8, 8)),
            level=0.0,
            origin_mm=np.zeros(3),
            pitch_mm=1.0,
            touches_border=False,
        )
    )
