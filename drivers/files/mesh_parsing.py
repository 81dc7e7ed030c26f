"""Read meshes with the parsers of trimesh, which check little: damage shows as any error, or not at all."""

import logging
import re
import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import RecordingError
from drivers.files.bounded import read_bounded
from drivers.files.ply_parsing import ply_header, read_binary_ply

if TYPE_CHECKING:
    import trimesh

logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # tracebacks of damage that is reported here

MESH_DAMAGE = (
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,
    NameError,  # of a local variable that was never set
    MemoryError,  # for as many vertices as the header claims
    ImportError,  # trimesh asks for an encoding detector where a text file holds binary data
    struct.error,
)
"""Errors of trimesh's parsers on damaged files, beside `HeaderError` of STL."""
MAX_MESH_BYTES = 64 << 20
"""Largest file that is parsed, which takes some twenty times as much memory: 1.3 million triangles of a binary STL."""
VERTEX_0 = re.compile(rb"^[ \t]*f[ \t](?:[^\n]*[ \t])?0+(?=[/\s]|\Z)", re.MULTILINE)
"""Face of an OBJ that has the vertex 0, which there is none of: trimesh takes it for the last."""
STL_HEADER_BYTES, STL_TRIANGLE_BYTES = 84, 50


def parse_mesh(path: Path) -> "trimesh.Trimesh":
    """Read a mesh as its suffix says, as it is in the file; its faces have vertices, which need not be finite.

    Raises
    ------
    RecordingError
        The file cannot be read, is no such mesh, or a cloud of points.
    """
    import trimesh  # here: with its dependencies it takes a tenth of the daemon's start

    file_type = path.suffix[1:].lower()
    try:
        content = read_bounded(path, MAX_MESH_BYTES)
    except OSError as err:
        raise RecordingError(path, f"cannot be read: {err.strerror}") from err
    if file_type == "obj" and VERTEX_0.search(content):
        raise RecordingError(path, "has faces with the vertex 0: vertices of an OBJ count from 1")
    readers: list[Callable[[], trimesh.Trimesh]] = [
        lambda: trimesh.load_mesh(BytesIO(_tidied(content, file_type)), file_type, process=False)
    ]
    if file_type == "ply":
        readers.append(lambda: trimesh.Trimesh(*read_binary_ply(content), process=False))
    for read in readers:
        try:
            mesh = read()
            faces = mesh.faces
            has_all_vertices = faces.size == 0 or 0 <= faces.min() <= faces.max() < len(mesh.vertices)
        except (*MESH_DAMAGE, trimesh.exchange.stl.HeaderError) as err:
            cause: Exception | None = err
            continue
        # noise is decoded to nothing where a detector of encodings is installed
        if has_all_vertices and (faces.size or not content):
            return mesh
        cause = None
    raise RecordingError(path, _problem(content, file_type)) from cause


def _tidied(content: bytes, file_type: str) -> bytes:
    """Return a file without what hinders trimesh: names in other encodings, and bytes behind the last triangle."""
    if file_type == "ply":
        end = content.find(b"end_header")
        return content if content[:end].isascii() else _ascii(content[:end]) + content[end:]
    if file_type == "stl" and not re.match(rb"\s*solid\b[^\0]*?\bvertex\b", content, re.IGNORECASE):
        end = STL_HEADER_BYTES + STL_TRIANGLE_BYTES * _n_announced(content)
        return content[:end] if end > STL_HEADER_BYTES else content
    return content if content.isascii() else _ascii(content)


def _ascii(text: bytes) -> bytes:
    return text.decode("latin-1").encode("ascii", "replace")


def _n_announced(content: bytes) -> int:
    """Return the number of triangles that the header of a binary STL announces."""
    header = content[:STL_HEADER_BYTES]
    return struct.unpack("<I", header[-4:])[0] if len(header) == STL_HEADER_BYTES else 0


def _problem(content: bytes, file_type: str) -> str:
    """Return the problem of a file that cannot be read as a mesh."""
    n_points = 0
    if file_type == "obj" and not re.search(rb"^\s*f\s", content, re.MULTILINE):
        n_points = len(re.findall(rb"^\s*v\s", content, re.MULTILINE))
    elif file_type == "ply":
        try:
            rows = {element.name: element.n_rows for element in ply_header(content)[1]}
        except (ValueError, LookupError):
            rows = {}
        n_points = 0 if rows.get("face") or rows.get("tristrips") else rows.get("vertex", 0)
    if n_points:
        return f"has {n_points} points and no faces: a cloud of points, not a mesh"
    damage = f"is damaged, or not {file_type.upper()}"
    if file_type == "stl" and b"facet" not in content and len(content) >= STL_HEADER_BYTES:
        n_there = (len(content) - STL_HEADER_BYTES) // STL_TRIANGLE_BYTES
        return f"{damage}: announces {_n_announced(content)} triangles, and has {n_there}"
    return damage
