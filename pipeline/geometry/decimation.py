"""Meshes with fewer vertices, for pictures and quick looks: all vertices within a cell of a grid become one."""

import numpy as np

from pipeline.arrays import Faces, Greys, PointsMM

CELLS_PER_AREA = 1.5
"""Cells of a cubic grid that a surface meets on average, for each square of their edge."""
AXIS_BITS = 21  # of a cell's number


def decimated(
    vertices_mm: PointsMM, faces: Faces, greys: Greys | None, n_vertices: int
) -> tuple[PointsMM, Faces, Greys | None]:
    """Return vertices, faces and greys of a mesh with about `n_vertices` vertices, each the mean of those in a cell.

    A mesh that has no more is returned as it is. The surface moves by half a cell at most where it is flat, and corners
    are cut. A closed mesh stays closed: each edge has as many faces on one side as on the other, though more than one
    where the surface touches itself within a cell (Rossignac and Borrel, "Multi-resolution 3D approximations", 1993).
    """
    if len(vertices_mm) <= n_vertices:
        return vertices_mm, faces, greys
    a, b, c = (vertices_mm[faces[:, k]] for k in range(3))
    area_mm2 = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    cell_mm = np.sqrt(CELLS_PER_AREA * area_mm2 / n_vertices)
    cells = ((vertices_mm - vertices_mm.min(axis=0)) / cell_mm).astype(np.int64)
    _, merged, counts = np.unique(
        cells @ [1 << 2 * AXIS_BITS, 1 << AXIS_BITS, 1], return_inverse=True, return_counts=True
    )
    mean_mm = np.column_stack([np.bincount(merged, vertices_mm[:, k]) for k in range(3)]) / counts[:, None]
    mean_greys = None if greys is None else np.rint(np.bincount(merged, greys) / counts).astype(np.uint8)
    return mean_mm, _without_folds(merged[faces], len(counts)), mean_greys


def _without_folds(faces: Faces, n_vertices: int) -> Faces:
    """Return the faces that have three corners, less those that lie on each other and face opposite sides."""
    first, second, third = faces.T
    faces = faces[(first != second) & (second != third) & (third != first)]
    first, second, third = faces.T
    turns = np.sign((second - first) * (third - second) * (first - third))
    corners = np.sort(faces, axis=1)
    _, at, of_face = np.unique(
        (corners[:, 0] * n_vertices + corners[:, 1]) * n_vertices + corners[:, 2],
        return_index=True,
        return_inverse=True,
    )
    n_left = np.bincount(of_face, turns).astype(np.int64)  # negative: in the order of the corners
    left = np.where(n_left[:, None] > 0, corners[at][:, ::-1], corners[at])
    return np.repeat(left, np.abs(n_left), axis=0)
