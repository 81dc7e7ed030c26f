"""Write meshes as binary PLY, which every mesh program reads."""

from pathlib import Path

import numpy as np

from pipeline.arrays import Faces, Greys, PointsMM

HEADER = """\
ply
format binary_little_endian 1.0
comment vertices in mm
element vertex {n_vertices}
property float x
property float y
property float z
{colors}element face {n_faces}
property list uchar int vertex_indices
end_header
"""
COLORS = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
VERTEX = np.dtype([("position_mm", "<f4", 3), ("color", "u1", 3)])
FACE = np.dtype([("n_corners", "u1"), ("a", "<i4"), ("b", "<i4"), ("c", "<i4")])


def write_mesh(path: Path, vertices_mm: PointsMM, faces: Faces, greys: Greys | None = None) -> None:
    """Write vertices (N, 3) in single precision, with their greys (N,) as colours, and faces (M, 3).

    Neither durable nor atomic.
    """
    path.write_bytes(ply_bytes(vertices_mm, faces, greys))


def ply_bytes(vertices_mm: PointsMM, faces: Faces, greys: Greys | None = None) -> bytes:
    """Return the file that `write_mesh` writes."""
    rows = np.empty(len(faces), FACE)
    rows["n_corners"], (rows["a"], rows["b"], rows["c"]) = 3, faces.T
    vertices = vertices_mm.astype("<f4")
    if greys is not None:
        vertices, positions = np.empty(len(vertices), VERTEX), vertices
        vertices["position_mm"], vertices["color"] = positions, greys[:, None]
    header = HEADER.format(
        n_vertices=len(vertices), n_faces=len(faces), colors="" if greys is None else COLORS
    ).encode("ascii")
    return header + vertices.tobytes() + rows.tobytes()
