"""Meshes on disk are what other programs read."""

from pathlib import Path

import numpy as np
import trimesh

from drivers.files.mesh_file import write_mesh


def test_another_program_reads_what_was_written(tmp_path: Path) -> None:
    body = trimesh.creation.icosphere(subdivisions=1, radius=7.3)
    write_mesh(tmp_path / "mesh.ply", body.vertices, body.faces)
    read = trimesh.load_mesh(tmp_path / "mesh.ply", process=False)
    np.testing.assert_array_equal(read.vertices, body.vertices.astype(np.float32))
    np.testing.assert_array_equal(read.faces, body.faces)
