"""The share of each pixel that a body covers, computed from its projected silhouette edges, not sampled.

Seen from one point, the triangles of a closed surface that face the camera tile the body's image
once or more. Their common border (the edges between a front and a back face) therefore gives the
winding number of the tiling, and a point is covered where it is not zero. Along a line of constant v
the crossings of the border are exact; across, each pixel has `LINES_PER_PIXEL` lines (midpoint rule),
so that the covered area has no bias and an error of at most 1/32 px on an exactly horizontal edge.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Faces, Flags, FloatImage, Floats, Indices, PointsUV, Values

LINES_PER_PIXEL = 16
"""Scan lines in each row of pixels."""


class Window(NamedTuple):
    """A block of whole pixels; it may reach beyond the image."""

    left: int
    top: int
    width: int
    height: int


def window_around(pixels_uv: PointsUV, margin_px: float) -> Window:
    """Return the smallest window that contains pixels (N, 2) and a margin."""
    low = np.floor(pixels_uv.min(axis=0) - margin_px).astype(int)
    high = np.ceil(pixels_uv.max(axis=0) + margin_px).astype(int) + 1
    return Window(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))


def intersection(a: Window, b: Window) -> Window | None:
    """Return the intersection of two windows, `None` if it is empty."""
    left, top = max(a.left, b.left), max(a.top, b.top)
    right, bottom = min(a.left + a.width, b.left + b.width), min(a.top + a.height, b.top + b.height)
    return Window(left, top, right - left, bottom - top) if left < right and top < bottom else None


class MeshEdges(NamedTuple):
    """The undirected edges of a closed mesh, and the edges of each face."""

    vertices: NDArray[np.int64]  # (E, 2)
    face_edges: NDArray[np.int64]  # (F, 3) indices of edges
    signs: NDArray[np.int64]  # (F, 3) 1 where the face runs from the first vertex to the second, else -1


def mesh_edges(faces: Faces) -> MeshEdges:
    """Return the edges of faces (F, 3)."""
    starts, ends = faces, np.roll(faces, -1, axis=1)
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    n_vertices = int(faces.max()) + 1
    keys, index = np.unique(low * n_vertices + high, return_inverse=True)
    vertices = np.column_stack([keys // n_vertices, keys % n_vertices])
    return MeshEdges(vertices, index.reshape(faces.shape), np.where(starts == low, 1, -1))


def silhouette_edges(edges: MeshEdges, is_front: Flags) -> NDArray[np.int64]:
    """Return the directed edges (B, 2) of vertices around the faces (F,) that look to the camera: closed loops."""
    turns = np.bincount(
        edges.face_edges[is_front].ravel(), edges.signs[is_front].ravel(), len(edges.vertices)
    ).astype(np.int64)
    forward = np.repeat(edges.vertices, np.maximum(turns, 0), axis=0)
    backward = np.repeat(edges.vertices[:, ::-1], np.maximum(-turns, 0), axis=0)
    return np.concatenate([forward, backward])


def coverage(starts_uv: PointsUV, ends_uv: PointsUV, window: Window) -> FloatImage:
    """Return the covered share 0..1 (height, width) of the window's pixels.

    The directed silhouette edges run from `starts_uv` to `ends_uv` (E, 2) and form closed loops.

    Raises
    ------
    ValueError
        The loops are not closed: the mesh has holes.
    """
    lines, crossings, turns = _crossings(starts_uv, ends_uv, window)
    order = np.lexsort((crossings, lines))
    lines, crossings, winding = lines[order], crossings[order], np.cumsum(turns[order])
    before = np.concatenate([[0], winding[:-1]])  # every line ends with winding 0
    begins, ends = (before == 0) & (winding != 0), (before != 0) & (winding == 0)
    if winding.size and winding[-1] != 0:
        raise ValueError("the silhouette edges form no closed loops: the mesh has holes")
    area = _area_right_of(lines[begins], crossings[begins], window)
    area -= _area_right_of(lines[ends], crossings[ends], window)
    return np.asarray(area / LINES_PER_PIXEL, dtype=np.float32)


def _crossings(starts_uv: PointsUV, ends_uv: PointsUV, window: Window) -> tuple[Indices, Values, Indices]:
    """Return line index, u (in pixels from the window's left border) and direction of each crossing (N,)."""
    scale = np.array([1.0, LINES_PER_PIXEL])
    # line k lies at y = k + 1/2
    starts = (starts_uv - [window.left - 0.5, window.top - 0.5]) * scale
    ends = (ends_uv - [window.left - 0.5, window.top - 0.5]) * scale
    turns = np.sign(ends[:, 1] - starts[:, 1]).astype(np.int64)
    low, high = np.sort([starts[:, 1], ends[:, 1]], axis=0)
    first = np.maximum(np.ceil(low - 0.5), 0).astype(np.int64)
    stop = np.minimum(np.ceil(high - 0.5), window.height * LINES_PER_PIXEL).astype(np.int64)
    counts = np.maximum(stop - first, 0)
    edges = np.repeat(np.arange(len(starts)), counts)
    lines = first[edges] + np.arange(len(edges)) - np.repeat(np.cumsum(counts) - counts, counts)
    slopes = (ends[:, 0] - starts[:, 0])[edges] / (ends[:, 1] - starts[:, 1])[edges]
    crossings = starts[edges, 0] + (lines + 0.5 - starts[edges, 1]) * slopes
    return lines, crossings, turns[edges]


def _area_right_of(lines: Indices, crossings: Values, window: Window) -> Floats:
    """Return the sum (height, width) over crossings of the share of each pixel that lies right of the crossing."""
    width = window.width + 2  # room for what lies beyond the right border
    clipped = np.clip(crossings, 0, window.width)
    columns = np.floor(clipped).astype(np.int64)
    cells = lines // LINES_PER_PIXEL * width + columns
    beyond = clipped - columns
    n_cells = window.height * width
    steps = np.bincount(cells, 1 - beyond, n_cells) + np.bincount(cells + 1, beyond, n_cells)
    return np.asarray(np.cumsum(steps.reshape(window.height, width), axis=1)[:, : window.width])
