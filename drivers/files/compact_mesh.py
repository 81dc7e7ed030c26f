"""Meshes in a fifth of the space of PLY: vertices on a grid, differences from row to row, zstd.

`stonefall-mesh/1` is that name and a line feed, then the CRC-32 of all that follows: the numbers of vertices and faces
(uint32, little-endian, as is the checksum), and one zstd frame of 4-byte integers, byte plane by byte plane, the lowest
first: x of all vertices in steps of `STEP_MM`, each the difference to the vertex before; y; z; the corners of all
faces, each the difference to the corner before. They are zigzag coded: 0, -1, 1, -2 ... are 0, 1, 2, 3 ...

`stonefall-mesh/2` is the same with the greys of all vertices at the end of that frame, a byte each: the difference to
the vertex before, modulo 256. Only meshes with greys are written so.
"""

import struct
from pathlib import Path
from zlib import crc32

import numpy as np
from imagecodecs import ZstdError, zstd_decode, zstd_encode
from numpy.typing import NDArray

from drivers.errors import RecordingError
from pipeline.arrays import Faces, Greys, PointsMM
from pipeline.formats import unread_format

MAGIC, MAGIC_WITH_GREYS = b"stonefall-mesh/1\n", b"stonefall-mesh/2\n"
CHECKSUM, COUNTS = struct.Struct("<I"), struct.Struct("<II")
STEP_MM = 2.0**-11
"""Grid of the coordinates: they are off by 0.00025 mm at most, and exact in single precision within 8 m."""
LEVEL = 3
"""Of zstd: higher ones take several times as long for a tenth less."""


def write_compact_mesh(path: Path, vertices_mm: PointsMM, faces: Faces, greys: Greys | None = None) -> None:
    """Write vertices (N, 3), their greys (N,) if they have any, and faces (M, 3); neither durable nor atomic."""
    steps = np.rint(vertices_mm / STEP_MM).astype(np.int32)
    zero = np.int32(0)  # of their type, so that all stay in 4 bytes
    coordinates = np.diff(steps, axis=0, prepend=zero).T.ravel()
    corners = np.diff(faces.astype(np.int32).ravel(), prepend=zero)
    numbers = np.concatenate([coordinates, corners])
    zigzag = ((numbers << 1) ^ (numbers >> 31)).astype("<i4")
    planes = zigzag.view(np.uint8).reshape(-1, 4).T.tobytes()
    if greys is not None:
        planes += np.diff(greys, prepend=np.uint8(0)).tobytes()
    content = COUNTS.pack(len(vertices_mm), len(faces)) + zstd_encode(planes, level=LEVEL)
    magic = MAGIC if greys is None else MAGIC_WITH_GREYS
    path.write_bytes(magic + CHECKSUM.pack(crc32(content)) + content)


def read_compact_mesh(path: Path) -> tuple[PointsMM, Faces, Greys | None]:
    """Return vertices (N, 3), faces (M, 3), and the greys of the vertices (N,) if they have any.

    Raises
    ------
    RecordingError
        The file cannot be read, is no compact mesh, or is damaged.
    """
    try:
        file = path.read_bytes()
    except OSError as err:
        raise RecordingError(path, f"cannot be read: {err.strerror}") from err
    has_greys = file.startswith(MAGIC_WITH_GREYS)
    if not has_greys and not file.startswith(MAGIC):
        if file.startswith(MAGIC[: MAGIC.index(b"/")]):
            begins = file.partition(b"\n")[0][:32].decode("ascii", "replace")
            raise RecordingError(path, f"format: {unread_format(begins, MAGIC_WITH_GREYS.decode().strip())}")
        raise RecordingError(path, f"is damaged, or not {MAGIC.decode().strip()}")
    content = file[len(MAGIC) + CHECKSUM.size :]
    try:
        if CHECKSUM.unpack_from(file, len(MAGIC))[0] != crc32(content):
            raise ValueError("its checksum is wrong")
        n_vertices, n_faces = COUNTS.unpack_from(content)
        n_numbers = 3 * (n_vertices + n_faces)
        planes = _unpacked(content[COUNTS.size :], 4 * n_numbers + (n_vertices if has_greys else 0))
        numbers = _numbers(planes[: 4 * n_numbers])
        greys = np.cumsum(planes[4 * n_numbers :], dtype=np.uint8) if has_greys else None
        steps = np.cumsum(numbers[: 3 * n_vertices].reshape(3, n_vertices), axis=1, dtype=np.int32)
        faces = np.cumsum(numbers[3 * n_vertices :]).reshape(n_faces, 3)
        if n_faces and not 0 <= faces.min() <= faces.max() < n_vertices:
            raise ValueError("corners without a vertex")
    except (ValueError, struct.error, ZstdError) as err:
        raise RecordingError(path, f"is damaged: {err}") from err
    return steps.T.astype(np.float64) * STEP_MM, faces, greys


def _unpacked(packed: bytes, n_bytes: int) -> NDArray[np.uint8]:
    planes = np.frombuffer(zstd_decode(packed, out=n_bytes) if n_bytes else b"", np.uint8)
    if len(planes) != n_bytes:
        raise ValueError("it is too short")
    return planes


def _numbers(planes: NDArray[np.uint8]) -> NDArray[np.int64]:
    zigzag = np.ascontiguousarray(planes.reshape(4, -1).T).view("<u4").ravel()
    return (zigzag >> 1).astype(np.int64) ^ -(zigzag & 1).astype(np.int64)
