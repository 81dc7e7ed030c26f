"""Compact meshes: what was written is read to within half a step, and damage is refused."""

import struct
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from imagecodecs import zstd_encode
from support.extents import examples

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
    greys = data.draw(st.none() | hnp.arrays(np.uint8, len(vertices)))
    path = tmp_path_factory.mktemp("mesh") / "mesh.sfmesh"
    write_compact_mesh(path, vertices, faces, greys)
    read_vertices, read_faces, read_greys = read_compact_mesh(path)
    np.testing.assert_array_equal(read_faces, faces)
    np.testing.assert_array_equal(read_greys, greys)
    assert np.abs(read_vertices - vertices).max() <= STEP_MM / 2
    write_compact_mesh(path, read_vertices, read_faces)
    np.testing.assert_array_equal(read_compact_mesh(path)[0], read_vertices)


def test_a_body_stays_closed_and_keeps_its_volume_in_less_space(tmp_path: Path) -> None:
    body = trimesh.creation.icosphere(subdivisions=6, radius=32.0)
    write_compact_mesh(tmp_path / "mesh.sfmesh", body.vertices, body.faces)
    vertices_mm, faces, _ = read_compact_mesh(tmp_path / "mesh.sfmesh")
    read = trimesh.Trimesh(vertices_mm, faces, process=False)
    assert read.is_watertight
    assert read.volume == pytest.approx(body.volume, rel=1e-6)
    assert np.abs(read.vertices - body.vertices).max() <= 0.00025
    np.testing.assert_array_equal(read.vertices, read.vertices.astype(np.float32))  # exact as PLY, too
    assert (tmp_path / "mesh.sfmesh").stat().st_size < len(ply_bytes(body.vertices, body.faces)) / 3


def test_a_mesh_without_greys_stays_in_the_first_format(tmp_path: Path) -> None:
    """As its description has it, so that what was written before greys were is read."""
    path = tmp_path / "mesh.sfmesh"
    content = struct.pack("<II", 3, 1) + zstd_encode(bytes([0, 4, 3, 0, 0, 0, 0, 4, 3, 0, 2, 2, *[0] * 36]))
    path.write_bytes(b"stonefall-mesh/1\n" + struct.pack("<I", crc32(content)) + content)
    vertices_mm, faces, greys = read_compact_mesh(path)
    steps = np.array([[0, 0, 0], [2, 0, 2], [0, 0, 0]])
    np.testing.assert_array_equal(vertices_mm, steps * STEP_MM)
    np.testing.assert_array_equal(faces, [[0, 1, 2]])
    assert greys is None
    write_compact_mesh(path, vertices_mm, faces)
    assert path.read_bytes().startswith(b"stonefall-mesh/1\n")
    write_compact_mesh(path, vertices_mm, faces, np.array([7, 255, 0], np.uint8))
    assert path.read_bytes().startswith(b"stonefall-mesh/2\n")


@pytest.mark.parametrize("with_greys", [False, True])
@pytest.mark.parametrize("damage", ["garbage", "nothing", "cut head", "cut", "longer", "flipped", "counts"])
def test_a_damaged_file_is_refused(tmp_path: Path, damage: str, with_greys: bool) -> None:
    path = tmp_path / "mesh.sfmesh"
    body = trimesh.creation.box((10, 20, 30))
    write_compact_mesh(path, body.vertices, body.faces, np.full(8, 50, np.uint8) if with_greys else None)
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


@pytest.mark.parametrize(("name", "n_bytes"), [(b"1", 0), (b"2", 0), (b"2", 59), (b"2", 61)])
def test_a_file_of_another_length_than_its_counts_say_is_refused(
    tmp_path: Path, name: bytes, n_bytes: int
) -> None:
    content = struct.pack("<II", 4, 1) + zstd_encode(bytes(n_bytes))
    (tmp_path / "mesh.sfmesh").write_bytes(
        b"stonefall-mesh/" + name + b"\n" + struct.pack("<I", crc32(content)) + content
    )
    with pytest.raises(RecordingError, match=r"mesh\.sfmesh: is damaged"):
        read_compact_mesh(tmp_path / "mesh.sfmesh")


def test_corners_without_a_vertex_are_refused(tmp_path: Path) -> None:
    write_compact_mesh(tmp_path / "mesh.sfmesh", np.zeros((2, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(RecordingError, match="corners without a vertex"):
        read_compact_mesh(tmp_path / "mesh.sfmesh")


def test_a_file_of_a_later_version_is_not_called_damaged(tmp_path: Path) -> None:
    (path := tmp_path / "mesh.sfmesh").write_bytes(b"stonefall-mesh/3\n" + bytes(40))
    with pytest.raises(RecordingError, match='is "stonefall-mesh/3", of a later version: update stonefall'):
        read_compact_mesh(path)
