"""Marching cubes' table of triangles, for each of the 256 ways in which a cube's corners are inside or outside.

On each face of the cube the surface cuts off every run of inside corners separately, also where only opposite
corners are inside. The neighbouring cube sees the same corners on that face and cuts them off along the same
lines, in the opposite sense. So the lines on a cube's faces close to loops, and the surface of all cubes
together is closed, whatever the field (Lorensen and Cline's table of 1987 leaves holes there).

Corner 4 dx + 2 dy + dz of a cube is at (dx, dy, dz) from its first.
"""

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Loop = list[int]
"""Corners around a face, or edges in the order in which the surface crosses them."""

CORNERS = tuple((c >> 2 & 1, c >> 1 & 1, c & 1) for c in range(8))
"""Offset (dx, dy, dz) of each corner."""
EDGES = tuple(
    (corner, corner + (4 >> axis)) for axis in range(3) for corner in range(8) if not corner & 4 >> axis
)
"""Corners (low, high) of each edge: four along x, four along y, four along z."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CubeCases:
    """Crossed edges and triangles of each case; bit c of a case is set where corner c is inside."""

    edges: NDArray[np.uint8]  # (256, 12) edges that the surface crosses
    n_edges: NDArray[np.uint8]  # (256,)
    triangles: NDArray[np.uint8]  # (256, 5, 3) edges of the vertices, counter-clockwise seen from outside
    n_triangles: NDArray[np.uint8]  # (256,)


@cache
def cube_cases() -> CubeCases:
    """Return the table. No diagonal of a loop lies on a face of the cube, where its neighbour could have it too."""
    edges, n_edges = np.zeros((256, len(EDGES)), np.uint8), np.zeros(256, np.uint8)
    triangles, n_triangles = np.zeros((256, 5, 3), np.uint8), np.zeros(256, np.uint8)
    for case in range(256):
        crossed = [edge for edge, (low, high) in enumerate(EDGES) if (case >> low ^ case >> high) & 1]
        n_edges[case] = len(crossed)
        edges[case, : len(crossed)] = crossed
        for loop in _loops(case):
            first, *others = next(rotated for rotated in _rotations(loop) if _spans_no_face(rotated))
            for second, third in pairwise(others):
                triangles[case, n_triangles[case]] = first, second, third
                n_triangles[case] += 1
    return CubeCases(edges=edges, n_edges=n_edges, triangles=triangles, n_triangles=n_triangles)


def _faces() -> list[Loop]:
    """Return the corners of the six faces, counter-clockwise seen from outside."""
    faces = []
    for axis in range(3):
        step, u, v = (4 >> (axis + turn) % 3 for turn in range(3))
        faces += [[0, v, u + v, u], [step, step + u, step + u + v, step + v]]
    return faces


def _loops(case: int) -> list[Loop]:
    """Return the edges that the surface crosses, in order around each of its pieces, counter-clockwise from outside."""
    edge_between = {frozenset(ends): edge for edge, ends in enumerate(EDGES)}
    following: dict[int, int] = {}
    for face in _faces():
        is_inside = [bool(case >> corner & 1) for corner in face]
        for last in range(4):
            if not is_inside[last] or is_inside[(last + 1) % 4]:
                continue
            first = last  # ends of the run of inside corners
            while is_inside[first - 1]:
                first -= 1
            entered = edge_between[frozenset((face[first - 1], face[first]))]
            following[entered] = edge_between[frozenset((face[last], face[(last + 1) % 4]))]
    loops = []
    while following:
        loop = [min(following)]
        while (edge := following.pop(loop[-1])) != loop[0]:
            loop.append(edge)
        loops.append(loop)
    return loops


def _rotations(loop: Loop) -> list[Loop]:
    return [loop[start:] + loop[:start] for start in range(len(loop))]


def _spans_no_face(loop: Loop) -> bool:
    """True when no diagonal from the loop's first edge lies on a face of the cube."""
    diagonals = [{*EDGES[loop[0]], *EDGES[other]} for other in loop[2:-1]]
    return not any(corners <= set(face) for corners in diagonals for face in _faces())
