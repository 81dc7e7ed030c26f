"""Write meshes as binary PLY, which every mesh program reads."""

from pathlib import Path

import numpy as np

from pipeline.arrays import Faces, PointsMM

HEADER = """\
ply
format binary_little_endian 1.0
comment vertices in mm
element vertex {n_vertices}
property float x
property float y
property float z
element face {n_faces}
property list uchar int vertex_indices
end_header
"""
FACE = np.dtype([("n_corners", "u1"), ("a", "<i4"), ("b", "<i4"), ("c", "<i4")])


def write_mesh(path: Path, vertices_mm: PointsMM, faces: Faces) -> None:
    """Write vertices (N, 3) in single precision and faces (M, 3); neither durable nor atomic."""
    path.write_bytes(ply_bytes(vertices_mm, faces))


def ply_bytes(vertices_mm: PointsMM, faces: Faces) -> bytes:
    """Return the file that `write_mesh` writes."""
    rows = np.empty(len(faces), FACE)
    rows["n_corners"], (rows["a"], rows["b"], rows["c"]) = 3, faces.T
    header = HEADER.format(n_vertices=len(vertices_mm), n_faces=len(faces)).encode("ascii")
    return header + vertices_mm.astype("<f4").tobytes() + rows.tobytes()
