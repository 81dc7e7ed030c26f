"""Read meshes with the parsers of trimesh, which check little: damage shows as any error, or not at all."""

import logging
import struct
from io import SEEK_END
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import RecordingError

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


def parse_mesh(path: Path) -> "trimesh.Trimesh":
    """Read a mesh as its suffix says, as it is in the file; its faces have vertices, which need not be finite.

    Raises
    ------
    RecordingError
        The file cannot be read, or is no such mesh.
    """
    import trimesh  # here: with its dependencies it takes a tenth of the daemon's start

    file_type = path.suffix[1:].lower()
    damaged = RecordingError(path, f"is damaged, or not {file_type.upper()}")
    try:
        with path.open("rb") as file:
            mesh = trimesh.load_mesh(file, file_type=file_type, process=False)
            is_empty = file.seek(0, SEEK_END) == 0
        faces = mesh.faces
        has_all_vertices = faces.size == 0 or 0 <= faces.min() <= faces.max() < len(mesh.vertices)
    except OSError as err:
        raise RecordingError(path, f"cannot be read: {err.strerror}") from err
    except (*MESH_DAMAGE, trimesh.exchange.stl.HeaderError) as err:
        raise damaged from err
    # noise is decoded to nothing where a detector of encodings is installed
    if not has_all_vertices or (faces.size == 0 and not is_empty):
        raise damaged
    return mesh
