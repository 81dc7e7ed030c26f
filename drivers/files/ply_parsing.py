"""Read binary PLY with polygons of any number of corners, or strips of triangles: what trimesh's parser cannot."""

import re
import struct
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from pipeline.arrays import Faces, PointsMM

HEADER = re.compile(rb"ply\s.*?\nend_header\r?\n", re.DOTALL)
OLD_TYPES = ("char", "uchar", "short", "ushort", "int", "uint", "float", "double")
TYPES = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64")
CODES = dict(zip(OLD_TYPES + TYPES, 2 * "bBhHiIfd", strict=True))
"""Characters of `struct` by the names of types."""
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
CORNERS = ("vertex_indices", "vertex_index")


@dataclass(frozen=True, slots=True)
class Property:
    """A number of each row of an element, or a list of them, whose length has the type `count`."""

    name: str
    code: str
    count: str = ""


@dataclass(frozen=True, slots=True)
class Element:
    """Rows of a PLY file that have the same properties."""

    name: str
    n_rows: int
    properties: list[Property] = field(default_factory=list)


def ply_header(content: bytes) -> tuple[str, list[Element], int]:
    """Return format, elements and length of a header; raise `ValueError` or `LookupError` if it is none."""
    found = HEADER.match(content)
    if found is None:
        raise ValueError("no header")
    elements: list[Element] = []
    form = ""
    for line in found[0].decode("latin-1").splitlines():
        match line.split():
            case ["format", form, _]:
                pass
            case ["element", name, n_rows]:
                elements.append(Element(name, int(n_rows)))
            case ["property", "list", count, kind, name]:
                elements[-1].properties.append(Property(name, CODES[kind], CODES[count]))
            case ["property", kind, name]:
                elements[-1].properties.append(Property(name, CODES[kind]))
    return form, elements, found.end()


def read_binary_ply(content: bytes) -> tuple[PointsMM, Faces]:
    """Return vertices (N, 3) and faces (M, 3): polygons are cut into triangles from their first corners.

    What follows the last element is ignored. Raises `ValueError`, `LookupError` or `struct.error` for what is damaged
    or no binary PLY.
    """
    form, elements, at = ply_header(content)
    order = ORDERS[form]
    vertices = np.empty((0, 3))
    corners = array("q")  # three for each triangle; a list of tuples takes ten times the memory
    for element in elements:
        if any(each.count for each in element.properties):
            for _ in range(element.n_rows):
                for each in element.properties:
                    n = 1
                    if each.count:
                        (n,) = struct.unpack_from(order + each.count, content, at)
                        at += struct.calcsize(each.count)
                    values = struct.unpack_from(f"{order}{n}{each.code}", content, at)
                    at += struct.calcsize(f"{order}{n}{each.code}")
                    if each.name in CORNERS:
                        parts = _strips(values) if element.name == "tristrips" else _fan(values)
                        corners.extend(chain.from_iterable(parts))
        else:
            row = np.dtype([(each.name, order + each.code) for each in element.properties])
            rows = np.frombuffer(content, row, element.n_rows, at)
            at += rows.nbytes
            if element.name == "vertex":
                vertices = np.column_stack([rows[axis] for axis in "xyz"]).astype(np.float64)
    return vertices, np.array(corners, np.int64).reshape(-1, 3)


def _fan(corners: Sequence[int]) -> Iterator[Sequence[int]]:
    return ((corners[0], corners[i], corners[i + 1]) for i in range(1, len(corners) - 1))


def _strips(indices: Sequence[int]) -> Iterator[Sequence[int]]:
    """Yield the triangles of strips, of which each ends at -1; every second one is turned, and flat ones only link."""
    start = 0
    for i, index in enumerate(indices):
        if index < 0:
            start = i + 1
        elif i >= start + 2:
            a, b, c = indices[i - 2 : i + 1]
            if len({a, b, c}) == 3:
                yield (a, b, c) if (i - start) % 2 == 0 else (b, a, c)
