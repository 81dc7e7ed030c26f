"""Compact meshes: what was written is read to within half a step, and damage is refused."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from support.quick_and_full import examples

from drivers.errors import RecordingError
from drivers.files.compact_mesh import STEP_MM, read_compact_mesh, write_compact_mesh
from drivers.files.mesh_file import ply_bytes

COORDINATES = st.floats(-1e5, 1e5, allow_nan=False)


@examples(0.5)
@given(
    vertices=hnp.arrays(np.float64, st.tuples(st.integers(1, 30), st.just(3)), elements=COORDINATES),
    data=st.data(),
)
def test_a_round_trip_moves_no_vertex_and_keeps_every_face(
    vertices: np.ndarray, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    corners = st.integers(0, len(vertices) - 1)
    faces = data.draw(hnp.arrays(np.int32, st.tuples(st.integers(0, 30), st.just(3)), elements=corners))
    path = tmp_path_factory.mktemp("mesh") / "mesh.sfmesh"
    write_compact_mesh(path, vertices, faces)
    read_vertices, read_faces = read_compact_mesh(path)
    np.testing.assert_array_equal(read_faces, faces)
    assert np.abs(read_vertices - vertices).max() <= STEP_MM / 2
    write_compact_mesh(path, read_vertices, read_faces)
    np.testing.assert_array_equal(read_compact_mesh(path)[0], read_vertices)


def test_a_body_stays_closed_and_keeps_its_volume_in_less_space(tmp_path: Path) -> None:
    body = trimesh.creation.icosphere(subdivisions=6, radius=32.0)
    write_compact_mesh(tmp_path / "mesh.sfmesh", body.vertices, body.faces)
    read = trimesh.Trimesh(*read_compact_mesh(tmp_path / "mesh.sfmesh"), process=False)
    assert read.is_watertight
    assert read.volume == pytest.approx(body.volume, rel=1e-6)
    assert np.abs(read.vertices - body.vertices).max() <= 0.00025
    np.testing.assert_array_equal(read.vertices, read.vertices.astype(np.float32))  # exact as PLY, too
    assert (tmp_path / "mesh.sfmesh").stat().st_size < len(ply_bytes(body.vertices, body.faces)) / 3


@pytest.mark.parametrize("damage", ["garbage", "nothing", "cut head", "cut", "longer", "flipped", "counts"])
def test_a_damaged_file_is_refused(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "mesh.sfmesh"
    body = trimesh.creation.box((10, 20, 30))
    write_compact_mesh(path, body.vertices, body.faces)
    whole = path.read_bytes()
    path.write_bytes(
        {
            "garbage": b"garbage",
            "nothing": b"",
            "cut head": whole[:20],
            "cut": whole[:-1],
            "longer": whole + b"\0",
            "flipped": whole[:-1] + bytes([whole[-1] ^ 1]),
            "counts": whole[:21] + b"\xff\xff\xff\xff" + whole[25:],
        }[damage]
    )
    with pytest.raises(RecordingError, match=r"mesh\.sfmesh: is damaged"):
        read_compact_mesh(path)


def test_corners_without_a_vertex_are_refused(tmp_path: Path) -> None:
    write_compact_mesh(tmp_path / "mesh.sfmesh", np.zeros((2, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(RecordingError, match="corners without a vertex"):
        read_compact_mesh(tmp_path / "mesh.sfmesh")
