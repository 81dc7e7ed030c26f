"""Self-intersections of a shifted mesh: triangles that cross, and shifts that are smoothed until none do."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from pipeline.arrays import Faces, Flags, Floats, Indices, PointsMM, Vector
from pipeline.compiled import compiled, compiled_within
from pipeline.geometry.bounds import bounds

Boxes = Annotated[Floats, "(F, 2, 3)"]

N_SMOOTHED, N_RETREATS, N_HALVED = 10, 24, 6
"""Repairs that smooth, and then those that go back to the surface before: of most folds one is enough. The
first of these go half the way, the others whole and for good."""
RETREAT = 0.5
"""Share of the way back by which one of the first moves what crosses."""
CELL_MM = 0.35
"""Edge of the cells in which triangles are compared: about that of a triangle, and half as much again."""
MOST_CELLS = 128
"""Cells along an axis; those of larger bodies are larger."""


def without_crossings(
    vertices_mm: PointsMM, faces: Faces, before_mm: Sequence[PointsMM] = ()
) -> PointsMM | None:
    """Return the vertices (V, 3), smoothed where the surface crosses itself; None if it still would.

    Where smoothing does not help, ever more goes back to the first surface of `before_mm` (V, 3), which is repaired
    by the next ones.
    """
    vertices_mm, is_new = vertices_mm.copy(), np.ones(len(vertices_mm), np.bool_)
    safe_mm, is_back = None, np.zeros(len(vertices_mm), np.bool_)
    for repair in range(N_SMOOTHED + N_RETREATS):
        crossing = crossing_vertices(vertices_mm, faces, is_new)
        if not crossing.any():
            return vertices_mm
        turn = repair - N_SMOOTHED
        if turn == 0 and before_mm:
            safe_mm = without_crossings(before_mm[0], faces, before_mm[1:])
        if turn >= 0 and safe_mm is None:
            return None
        for _ in range(repair // 2 if turn < 0 else 2 + turn // 2):
            crossing = _widened(crossing, faces)
        moving = _widened(crossing, faces)
        around = faces[moving[faces].any(axis=1)]
        if safe_mm is None:
            for _ in range(2 + repair // 2):
                _smooth(vertices_mm, around, moving)
        else:
            shifts_mm = vertices_mm - safe_mm
            shifts_mm[crossing] *= 1 - RETREAT
            _smooth(shifts_mm, around, moving)
            if turn >= N_HALVED:
                is_back |= crossing
                shifts_mm[is_back] = 0.0
                moving |= is_back
            vertices_mm = np.where(moving[:, None], safe_mm + shifts_mm, vertices_mm)
        is_new = moving  # what crossed has moved: triangles that stayed cross none that stayed
    return None


def crossing_vertices(vertices_mm: PointsMM, faces: Faces, is_new: Flags | None = None) -> Flags:
    """Mark vertices (V,) of triangles that cross another one with which they share no vertex.

    With `is_new` (V,), only pairs are compared one of which has such a vertex.
    """
    low_mm, high_mm = bounds(vertices_mm)
    extents_mm = high_mm - low_mm
    edge_mm = max(CELL_MM, float(extents_mm.max()) / MOST_CELLS)
    counts = np.floor(extents_mm / edge_mm).astype(np.int64) + 1
    starts = np.zeros(int(counts.prod()) + 1, np.int64)
    boxes_mm = np.empty((len(faces), 2, 3))
    _fill_boxes(vertices_mm, faces, boxes_mm)
    _count(boxes_mm, low_mm, edge_mm, counts, starts)
    members = np.empty(int(starts[-1]), np.int64)
    crossing = np.zeros(len(vertices_mm), np.bool_)
    _fill(boxes_mm, low_mm, edge_mm, counts, starts, members)
    is_compared = np.asarray(np.full(len(faces), True) if is_new is None else is_new[faces].any(axis=1))
    _compare(vertices_mm, faces, boxes_mm, starts, members, is_compared, crossing)
    return crossing


@compiled
def _fill_boxes(vertices_mm: PointsMM, faces: Faces, boxes_mm: Boxes) -> None:
    """Fill in the lowest and the highest coordinates of the triangles."""
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        for axis in range(3):
            x, y, z = vertices_mm[a, axis], vertices_mm[b, axis], vertices_mm[c, axis]
            boxes_mm[face, 0, axis] = min(x, y, z)
            boxes_mm[face, 1, axis] = max(x, y, z)


@compiled_within
def _cells_of(boxes_mm: Boxes, face: int, axis: int, low_mm: Vector, edge_mm: float) -> tuple[int, int]:
    return (
        int((boxes_mm[face, 0, axis] - low_mm[axis]) / edge_mm),
        int((boxes_mm[face, 1, axis] - low_mm[axis]) / edge_mm),
    )


@compiled
def _count(boxes_mm: Boxes, low_mm: Vector, edge_mm: float, counts: Indices, starts: Indices) -> None:
    """Fill in where the triangles of each cell end."""
    for face in range(len(boxes_mm)):
        x0, x1 = _cells_of(boxes_mm, face, 0, low_mm, edge_mm)
        y0, y1 = _cells_of(boxes_mm, face, 1, low_mm, edge_mm)
        z0, z1 = _cells_of(boxes_mm, face, 2, low_mm, edge_mm)
        for x in range(x0, x1 + 1):
            for y in range(y0, y1 + 1):
                for z in range(z0, z1 + 1):
                    starts[(x * counts[1] + y) * counts[2] + z + 1] += 1
    for cell in range(len(starts) - 1):
        starts[cell + 1] += starts[cell]


@compiled
def _fill(
    boxes_mm: Boxes, low_mm: Vector, edge_mm: float, counts: Indices, starts: Indices, members: Indices
) -> None:
    """Fill in the triangles of each cell, from its end to its start."""
    free = starts[1:].copy()
    for face in range(len(boxes_mm)):
        x0, x1 = _cells_of(boxes_mm, face, 0, low_mm, edge_mm)
        y0, y1 = _cells_of(boxes_mm, face, 1, low_mm, edge_mm)
        z0, z1 = _cells_of(boxes_mm, face, 2, low_mm, edge_mm)
        for x in range(x0, x1 + 1):
            for y in range(y0, y1 + 1):
                for z in range(z0, z1 + 1):
                    cell = (x * counts[1] + y) * counts[2] + z
                    free[cell] -= 1
                    members[free[cell]] = face


@compiled
def _compare(
    vertices_mm: PointsMM,
    faces: Faces,
    boxes_mm: Boxes,
    starts: Indices,
    members: Indices,
    is_compared: Flags,
    crossing: Flags,
) -> None:
    """Flag the vertices of triangles that cross; most pairs are ruled out side by side, by box and common vertices."""
    most = 0
    for cell in range(len(starts) - 1):
        most = max(most, starts[cell + 1] - starts[cell])
    low, high, corners = np.empty((3, most)), np.empty((3, most)), np.empty((3, most), faces.dtype)
    is_near = np.empty(most, faces.dtype)  # as wide as what is compared, to go side by side
    for cell in range(len(starts) - 1):
        begin, n = starts[cell], starts[cell + 1] - starts[cell]
        n_compared = 0
        for one in range(n):
            n_compared += is_compared[members[begin + one]]
        if n_compared == 0:
            continue
        for one in range(n):
            i = members[begin + one]
            for k in range(3):
                low[k, one], high[k, one] = boxes_mm[i, 0, k], boxes_mm[i, 1, k]
                corners[k, one] = faces[i, k]
            a, b, c = faces[i, 0], faces[i, 1], faces[i, 2]
            x0, y0, z0 = low[0, one], low[1, one], low[2, one]
            x1, y1, z1 = high[0, one], high[1, one], high[2, one]
            n_near = 0
            for other in range(one):
                p, q, r = corners[0, other], corners[1, other], corners[2, other]
                meets = (
                    (x0 <= high[0, other])
                    & (low[0, other] <= x1)
                    & (y0 <= high[1, other])
                    & (low[1, other] <= y1)
                    & (z0 <= high[2, other])
                    & (low[2, other] <= z1)
                )
                shares_a, shares_b = (a == p) | (a == q) | (a == r), (b == p) | (b == q) | (b == r)
                shares_c = (c == p) | (c == q) | (c == r)
                is_near[other] = meets & ~(shares_a | shares_b | shares_c)
                n_near += is_near[other]
            if n_near == 0:
                continue
            for other in range(one):
                j = members[begin + other]
                if not (is_near[other] and (is_compared[i] or is_compared[j])):
                    continue
                p, q, r = faces[j, 0], faces[j, 1], faces[j, 2]
                if _cross(vertices_mm, a, b, c, p, q, r):
                    crossing[a] = crossing[b] = crossing[c] = True
                    crossing[p] = crossing[q] = crossing[r] = True


@compiled
def _widened(flags: Flags, faces: Faces) -> Flags:
    """Return the flags (V,) of all vertices that share a face with a flagged one."""
    wide = flags.copy()
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        if flags[a] or flags[b] or flags[c]:
            wide[a] = wide[b] = wide[c] = True
    return wide


@compiled
def _smooth(vertices_mm: PointsMM, around: Faces, moving: Flags) -> None:
    """Move vertices (V, 3) that are `moving` to the mean of themselves and their neighbours, by the faces `around`."""
    sums, counts = np.zeros_like(vertices_mm), np.ones(len(vertices_mm))
    for face in range(len(around)):
        for k in range(3):
            # each edge belongs to two faces, once in each direction
            a, b = around[face, k], around[face, (k + 1) % 3]
            counts[a] += 1
            for axis in range(3):
                sums[a, axis] += vertices_mm[b, axis]
    for face in range(len(around)):
        for k in range(3):
            a = around[face, k]
            if moving[a] and counts[a] > 0:
                for axis in range(3):
                    vertices_mm[a, axis] = (vertices_mm[a, axis] + sums[a, axis]) / counts[a]
                counts[a] = 0


@compiled_within
def _cross(vertices_mm: PointsMM, a: int, b: int, c: int, p: int, q: int, r: int) -> bool:
    """True when two triangles cross: an edge of one passes through the other."""
    if _is_beside(vertices_mm, a, b, c, p, q, r) or _is_beside(vertices_mm, p, q, r, a, b, c):
        return False  # as most that are near, for a quarter of the work
    return (
        _passes_through(vertices_mm, a, b, p, q, r)
        or _passes_through(vertices_mm, b, c, p, q, r)
        or _passes_through(vertices_mm, c, a, p, q, r)
        or _passes_through(vertices_mm, p, q, a, b, c)
        or _passes_through(vertices_mm, q, r, a, b, c)
        or _passes_through(vertices_mm, r, p, a, b, c)
    )


@compiled_within
def _is_beside(vertices_mm: PointsMM, a: int, b: int, c: int, p: int, q: int, r: int) -> bool:
    """True when p, q and r all lie on one side of the plane of a, b and c."""
    one, two, three = (
        _volume6(vertices_mm, p, a, b, c),
        _volume6(vertices_mm, q, a, b, c),
        _volume6(vertices_mm, r, a, b, c),
    )
    return (one > 0 and two > 0 and three > 0) or (one < 0 and two < 0 and three < 0)


@compiled_within
def _passes_through(vertices_mm: PointsMM, a: int, b: int, p: int, q: int, r: int) -> bool:
    """True when the segment from a to b passes through the triangle p, q, r."""
    one, other = _volume6(vertices_mm, a, p, q, r), _volume6(vertices_mm, b, p, q, r)
    if one * other >= 0:
        return False
    first = _volume6(vertices_mm, a, b, p, q)
    second = _volume6(vertices_mm, a, b, q, r)
    third = _volume6(vertices_mm, a, b, r, p)
    return (first > 0 and second > 0 and third > 0) or (first < 0 and second < 0 and third < 0)


@compiled_within
def _volume6(vertices_mm: PointsMM, a: int, b: int, c: int, d: int) -> float:
    """Return six times the signed volume of a tetrahedron."""
    ux, uy, uz = (
        vertices_mm[b, 0] - vertices_mm[a, 0],
        vertices_mm[b, 1] - vertices_mm[a, 1],
        vertices_mm[b, 2] - vertices_mm[a, 2],
    )
    vx, vy, vz = (
        vertices_mm[c, 0] - vertices_mm[a, 0],
        vertices_mm[c, 1] - vertices_mm[a, 1],
        vertices_mm[c, 2] - vertices_mm[a, 2],
    )
    wx, wy, wz = (
        vertices_mm[d, 0] - vertices_mm[a, 0],
        vertices_mm[d, 1] - vertices_mm[a, 1],
        vertices_mm[d, 2] - vertices_mm[a, 2],
    )
    return ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx)
