"""Grey values of the surface: how bright each vertex of a mesh is, from the views that see it best.

Nodes choose the views that see the surface around them; each vertex takes the views of the nearest node, as far as they
see the vertex too. Views are made equally bright by how they differ where they overlap, and what follows from the
direction of the surface alone is taken for its shading and divided out.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import (
    Directions,
    Faces,
    Floats,
    Greys,
    Indices,
    Indices32,
    PointsMM,
    Singles,
    Values,
)
from pipeline.compiled import compiled
from pipeline.meshing import ParticleMesh
from pipeline.refinement.nodes import spread_nodes, vertex_normals
from pipeline.refinement.refine import made_up_ball
from pipeline.refinement.sightings import (
    COARSE,
    PhotoViews,
    depth_maps,
    hidden_beyond_mm,
    photo_views,
    project_into,
    sightings,
)

SPACING_MM = 0.8
"""Spacing of the nodes: they choose views, the grey is each vertex's own."""
VERTEX_STEP = 4
"""Step through the vertices, which are far closer than nodes: the others need not be looked at to choose nodes."""
MAX_VIEWS = 3
"""Views whose mean a vertex is: more blur its texture, as none lies quite right."""
LEAST_GREY, MOST_GREY = 2.0, 250.0
"""Grey levels between which a pixel says how bright the surface is, and not only that it is darker or brighter."""
SATURATED_SHARE = 1e-3
"""Weight of a brighter one beside others."""
EQUAL_PAIRS = 1.0
"""Pairs of greys that views are equally bright by, where there are no others."""
UNSHADED_NODES = 10.0
"""Nodes by which nothing is shaded: so the mottles of a small stone are not taken for shading."""
LEAST_COSINE = 0.1
"""Least cosine between normal and line of sight of a vertex."""


def vertex_greys(mesh: ParticleMesh, views: PhotoViews) -> Greys | None:
    """Return the grey of each vertex (N,), as cameras would see it in even light; None if no view shows any.

    A vertex that no view shows has the grey of the nearest that one does.
    """
    normals = vertex_normals(mesh.vertices_mm, mesh.faces)
    some_mm, some_normals = (
        np.ascontiguousarray(each[::VERTEX_STEP]) for each in (mesh.vertices_mm, normals)
    )
    nodes = spread_nodes(some_mm, some_normals, SPACING_MM)
    at_nodes = VERTEX_STEP * nodes.chosen
    maps = depth_maps(views, nodes.points_mm)
    chosen, _ = sightings(views, maps, nodes.points_mm, nodes.normals, 0.0, MAX_VIEWS)
    seen_by = chosen[_nearest(mesh.faces, at_nodes, len(normals))]
    greys = np.zeros(seen_by.shape, np.float32)
    weights = np.zeros(seen_by.shape, np.float32)
    _look(
        views.regions,
        maps,
        views.lenses,
        views.R,
        views.t_mm,
        views.centers_mm,
        mesh.vertices_mm,
        normals,
        seen_by,
        greys,
        weights,
    )
    brightness = _brightness(greys[at_nodes], weights[at_nodes], seen_by[at_nodes], len(maps))
    means = np.full(len(normals), -1.0)
    _average(greys, weights, seen_by, brightness, means)
    is_seen = means >= 0
    if not is_seen.any():
        return None
    means /= _shading(normals, means, at_nodes[is_seen[at_nodes]])
    if not is_seen.all():
        means = means[is_seen][_nearest(mesh.faces, np.flatnonzero(is_seen), len(means))]
    return np.clip(np.rint(means), 0, 255).astype(np.uint8)


def warm_up() -> Greys | None:
    """Look at a made-up ball, which compiles what the first stone would wait for."""
    ball, frames, prepared = made_up_ball()
    return vertex_greys(ball, photo_views(frames, prepared, ball.vertices_mm))


def _nearest(faces: Faces, seeds: Indices, n_vertices: int) -> Indices:
    """Return the index of the seed that is nearest to each vertex (N,) along edges."""
    owners = np.full(n_vertices, -1)
    owners[seeds] = np.arange(len(seeds))
    _flood(faces, owners, np.where(owners < 0, len(faces), 0))
    return np.maximum(owners, 0)  # no vertex is cut off from all seeds: a mesh is one surface


@compiled
def _flood(faces: Faces, owners: Indices, reached_in: Indices) -> None:
    """Let owners spread, over one edge in a round, to vertices that have none (-1), until none changes."""
    is_spreading, n_rounds = True, 0
    while is_spreading:
        is_spreading = False
        n_rounds += 1
        for face in range(len(faces)):
            for k in range(3):
                to = faces[face, k]
                if owners[to] >= 0:
                    continue
                for other in (faces[face, (k + 1) % 3], faces[face, (k + 2) % 3]):
                    if reached_in[other] < n_rounds and owners[to] < 0:
                        owners[to], reached_in[to] = owners[other], n_rounds
                        is_spreading = True


@compiled
def _look(
    regions: NDArray[np.uint8],
    maps: Singles,
    lenses: Floats,
    R: Floats,
    t_mm: PointsMM,
    centers_mm: PointsMM,
    points_mm: PointsMM,
    normals: Directions,
    seen_by: Indices32,
    greys: Singles,
    weights: Singles,
) -> None:
    """Fill in the grey (N, MAX_VIEWS) of each point in its views and their weights: 0 where it is hidden."""
    for i in range(len(points_mm)):
        x, y, z = points_mm[i, 0], points_mm[i, 1], points_mm[i, 2]
        for at in range(seen_by.shape[1]):
            view = seen_by[i, at]
            if view < 0:
                break
            dx, dy, dz = centers_mm[view, 0] - x, centers_mm[view, 1] - y, centers_mm[view, 2] - z
            distance = np.sqrt(dx * dx + dy * dy + dz * dz)
            cosine = (dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]) / distance
            if cosine <= LEAST_COSINE:
                continue
            u, v, depth = project_into(lenses[view], R[view], t_mm[view], x, y, z)
            column, row = int(np.floor(u)), int(np.floor(v))
            if column < 0 or row < 0 or column >= regions.shape[2] - 1 or row >= regions.shape[1] - 1:
                continue
            nearest = maps[view, row // COARSE, column // COARSE]
            if not (nearest < np.inf) or depth > nearest + hidden_beyond_mm(lenses[view, 0], depth, cosine):
                continue
            part_u, part_v = u - column, v - row
            above = regions[view, row, column] * (1 - part_u) + regions[view, row, column + 1] * part_u
            below = (
                regions[view, row + 1, column] * (1 - part_u) + regions[view, row + 1, column + 1] * part_u
            )
            grey = above * (1 - part_v) + below * part_v
            share = 1.0 if grey <= MOST_GREY else SATURATED_SHARE
            greys[i, at], weights[i, at] = grey, share * cosine * cosine


@compiled
def _average(greys: Singles, weights: Singles, seen_by: Indices32, brightness: Values, means: Values) -> None:
    """Fill in the mean grey of each point that is seen, as in a view of brightness 1."""
    for i in range(len(means)):
        total, weight = 0.0, 0.0
        for at in range(greys.shape[1]):
            if weights[i, at] > 0:
                total += weights[i, at] * greys[i, at] / brightness[seen_by[i, at]]
                weight += weights[i, at]
        if weight > 0:
            means[i] = total / weight


def _brightness(greys: Singles, weights: Singles, seen_by: Indices32, n_views: int) -> Values:
    """Return the relative brightness of each view (V,), by the median differences of nodes that two views share."""
    is_used = (weights > 0) & (greys >= LEAST_GREY) & (greys <= MOST_GREY)
    logs = np.log(np.where(is_used, greys, 1.0))
    firsts, seconds = np.triu_indices(seen_by.shape[1], 1)
    both = is_used[:, firsts] & is_used[:, seconds]
    one, other = seen_by[:, firsts][both], seen_by[:, seconds][both]
    swapped = np.where(one < other, 1.0, -1.0)
    differences = swapped * (logs[:, firsts] - logs[:, seconds])[both]
    pairs = np.minimum(one, other) * n_views + np.maximum(one, other)
    order = np.lexsort((differences, pairs))
    keys, starts, counts = np.unique(pairs[order], return_index=True, return_counts=True)
    medians = differences[order][starts + counts // 2]
    matrix, right = np.diag(np.full(n_views, EQUAL_PAIRS)), np.zeros(n_views)
    a, b = keys // n_views, keys % n_views
    matrix[a, b] = matrix[b, a] = -counts
    np.add.at(matrix, (a, a), counts)
    np.add.at(matrix, (b, b), counts)
    np.add.at(right, a, counts * medians)
    np.add.at(right, b, -counts * medians)
    gains = np.linalg.solve(matrix, right)
    return np.exp(gains - np.median(gains))


def _shading(normals: Directions, means: Values, nodes: Indices) -> Values:
    """Return the light on each vertex (N,), the mean as 1: spherical harmonics to order 2 of what these nodes show."""
    logs = np.log(np.maximum(means[nodes], LEAST_GREY))
    seen = _harmonics(normals[nodes])
    matrix = seen.T @ seen + UNSHADED_NODES * np.eye(seen.shape[1])
    coefficients = np.linalg.solve(matrix, seen.T @ (logs - logs.sum() / max(len(logs), 1)))
    return np.exp(_harmonics(normals) @ coefficients)


def _harmonics(normals: Directions) -> Floats:
    """Return the real spherical harmonics of order 1 and 2 (N, 8), each with a mean square of 1."""
    x, y, z = normals.T
    first = np.sqrt(3) * normals
    second = np.sqrt(15) * np.column_stack([x * y, y * z, z * x, (x * x - y * y) / 2])
    return np.column_stack([first, second, np.sqrt(5) / 2 * (3 * z * z - 1)])
