"""Meshes of other programs: what they write is read whole, and what is no mesh is called by its name."""

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import RecordingError
from drivers.files.mesh_parsing import parse_mesh

CUT_CUBE = (
    ((0, 0, 0), (10, 0, 0), (10, 10, 0), (0, 10, 0), (0, 0, 10), (10, 0, 10), (0, 10, 10)),
    ((5, 10, 10), (10, 5, 10), (10, 10, 5)),
)
"""Corners of a cube of 10 mm, and of the cut that takes one away."""
POINTS_MM = np.array(CUT_CUBE[0] + CUT_CUBE[1], np.float64)
POLYGONS = [
    *((0, 3, 2, 1), (0, 1, 5, 4), (0, 4, 6), (0, 6, 3)),
    *((1, 2, 9, 8, 5), (2, 3, 6, 7, 9), (4, 5, 8, 7, 6), (7, 8, 9)),
]
"""Four corners on average, as the first has: a reader that takes all for quads finds the length that it expects."""
TRIANGLES = [(f[0], f[i], f[i + 1]) for f in POLYGONS for i in range(1, len(f) - 1)]
VOLUME_MM3 = 1000 - 5**3 / 6
FORMATS = {"<": "binary_little_endian", ">": "binary_big_endian"}
CUBE_STL = trimesh.exchange.stl.export_stl(trimesh.creation.box([10, 10, 10]))


def header(order: str, elements: str, comment: str = "") -> bytes:
    text = f"ply\nformat {FORMATS[order]} 1.0\n{comment}element vertex {len(POINTS_MM)}\n"
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    return (text + axes + elements + "end_header\n").encode("latin-1")


def polygon_ply(order: str, kinds: tuple[str, str] = ("uchar", "int"), codes: str = "Bi") -> bytes:
    count, index = codes
    rows = b"".join(struct.pack(f"{order}{count}{len(f)}{index}H", len(f), *f, 7) for f in POLYGONS)
    faces = (
        f"element face {len(POLYGONS)}\nproperty list {' '.join(kinds)} vertex_index\nproperty ushort scan\n"
    )
    points = POINTS_MM.astype(f"{order}f4").tobytes()
    return header(order, "element edge 1\nproperty int vertex1\n" + faces) + points + b"\0" * 4 + rows


def strip_ply(strips: list[list[int]]) -> bytes:
    indices = [index for strip in strips for index in (*strip, -1)]
    elements = header("<", "element tristrips 1\nproperty list int int vertex_indices\n")
    points = POINTS_MM.astype("<f4").tobytes()
    return elements + points + struct.pack(f"<i{len(indices)}i", len(indices), *indices)


def text_stl(name: str = "Körper", start: str = "") -> bytes:
    cube = trimesh.exchange.stl.export_stl_ascii(trimesh.creation.box([10, 10, 10]))
    return f"{start}solid {name}{cube[cube.index(chr(10)) :]} {name}".encode("latin-1")


def obj(faces: str) -> bytes:
    return "".join(f"v {x} {y} {z}\n" for x, y, z in POINTS_MM).encode() + faces.encode("latin-1")


@pytest.mark.parametrize(
    ("name", "content", "volume_mm3"),
    [
        ("mixed.ply", polygon_ply("<"), VOLUME_MM3),
        ("big.ply", polygon_ply(">"), VOLUME_MM3),
        ("old.ply", polygon_ply("<", ("int", "ushort"), "iH"), VOLUME_MM3),
        ("new.ply", polygon_ply(">", ("uint8", "int32")), VOLUME_MM3),
        ("behind.ply", polygon_ply("<") + b"more", VOLUME_MM3),
        ("named.ply", polygon_ply("<").replace(b" 1.0\n", b" 1.0\ncomment K\xf6rper\n", 1), VOLUME_MM3),
        ("strips.ply", strip_ply([list(f) for f in TRIANGLES]), VOLUME_MM3),  # assimp #6296
        ("windows.ply", polygon_ply("<").replace(b"\nend_header\n", b"\r\nend_header\r\n", 1), VOLUME_MM3),
        ("text.stl", text_stl(), 1000.0),
        ("blank.stl", text_stl(start="\n  "), 1000.0),  # numpy-stl #156
        ("binary.stl", CUBE_STL + bytes(40), 1000.0),
        ("solid.stl", b"solid K\xf6rper".ljust(80) + CUBE_STL[80:] + b"\0", 1000.0),
        (
            "quads.obj",
            obj("o Körper\n" + "\n".join("f " + " ".join(f"{i + 1}//" for i in f) for f in POLYGONS)),
            VOLUME_MM3,
        ),
        (
            "wrapped.obj",
            obj("\n".join("f \\\n" + " ".join(str(i + 1) for i in f) for f in POLYGONS)),
            VOLUME_MM3,
        ),
    ],
)
def test_what_other_programs_write_is_read_whole(
    tmp_path: Path, name: str, content: bytes, volume_mm3: float
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    mesh = parse_mesh(path)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(volume_mm3)


def test_a_strip_turns_every_second_triangle_and_flat_ones_only_link(tmp_path: Path) -> None:
    path = tmp_path / "strip.ply"
    path.write_bytes(strip_ply([[0, 1, 3, 2], [4, 5, 6, 6, 7, 8]]))
    assert parse_mesh(path).faces.tolist() == [[0, 1, 3], [3, 1, 2], [4, 5, 6], [7, 6, 8]]


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("scan.ply", header("<", "") + bytes(120), "has 10 points and no faces: a cloud of points"),
        (
            "scan.ply",
            header(">", "element face 0\nproperty list uchar int x\n") + bytes(120),
            "has 10 points",
        ),
        ("scan.obj", obj("p 1 2 3\n"), "has 10 points and no faces"),
        ("from0.obj", obj("".join(f"f {a}/1 {b}/2 {c}/3\n" for a, b, c in TRIANGLES)), "count from 1"),
        ("cut.ply", polygon_ply("<")[:-9], "is damaged, or not PLY"),
        ("far.ply", polygon_ply("<").replace(b"\x09\0\0\0", b"\x63\0\0\0"), "is damaged, or not PLY"),
        ("many.ply", polygon_ply("<").replace(b"face 8", b"face 4000000000", 1), "is damaged, or not PLY"),
        ("cut.stl", CUBE_STL[:300], "is damaged, or not STL: announces 12 triangles, and has 4"),
        ("other.ply", CUBE_STL, "is damaged, or not PLY"),
    ],
)
def test_what_is_no_mesh_is_called_by_its_name(
    tmp_path: Path, name: str, content: bytes, problem: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(RecordingError) as caught:
        parse_mesh(path)
    assert problem in caught.value.problem


@given(st.sampled_from("<>"), st.integers(0, 700), st.binary(min_size=1, max_size=20))
def test_a_damaged_ply_is_a_mesh_or_an_error_of_its_own(
    tmp_path_factory: pytest.TempPathFactory, order: str, at: int, damage: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "damaged.ply"
    good = polygon_ply(order)
    path.write_bytes(good[:at] + damage + good[at + len(damage) :])
    try:
        mesh = parse_mesh(path)
    except RecordingError:
        return
    assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices)
