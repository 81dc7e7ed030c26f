"""Meshes on disk are what other programs read."""

from pathlib import Path

import numpy as np
import trimesh

from drivers.files.mesh_file import ply_bytes, write_mesh


def test_another_program_reads_what_was_written(tmp_path: Path) -> None:
    body = trimesh.creation.icosphere(subdivisions=1, radius=7.3)
    write_mesh(tmp_path / "mesh.ply", body.vertices, body.faces)
    read = trimesh.load_mesh(tmp_path / "mesh.ply", process=False)
    np.testing.assert_array_equal(read.vertices, body.vertices.astype(np.float32))
    np.testing.assert_array_equal(read.faces, body.faces)


def test_greys_are_colours_of_the_vertices_to_other_programs(tmp_path: Path) -> None:
    body = trimesh.creation.icosphere(subdivisions=1, radius=7.3)
    greys = np.random.default_rng(0).integers(0, 256, len(body.vertices), dtype=np.uint8)
    write_mesh(tmp_path / "mesh.ply", body.vertices, body.faces, greys)
    read = trimesh.load_mesh(tmp_path / "mesh.ply", process=False)
    np.testing.assert_array_equal(read.vertices, body.vertices.astype(np.float32))
    np.testing.assert_array_equal(read.faces, body.faces)
    np.testing.assert_array_equal(read.visual.vertex_colors[:, :3], np.repeat(greys[:, None], 3, axis=1))


def test_without_greys_a_file_is_positions_and_faces_alone() -> None:
    body = trimesh.creation.box()
    header, content = ply_bytes(body.vertices, body.faces).split(b"end_header\n")
    assert b"red" not in header
    assert len(content) == 12 * len(body.vertices) + 13 * len(body.faces)
