"""The smallest box around a body and the smallest square it passes: searches over rotations.

Both depend on nothing but the widths w(e) of the body along the axes of an orthonormal frame:

- a box along the frame holds the body if its edges are w(e1), w(e2), w(e3);
- the body passes along e3 through a square with sides along e1 and e2 and edge max(w(e1), w(e2)).

Both have many local minima. A beam of the best frames, chosen among 75 000 coarse ones (`near_frames`),
is turned by smaller and smaller angles; frames that come close to a better one give way to others.
"""

from collections.abc import Callable

import numpy as np
import scipy.spatial
from numpy.typing import NDArray

from pipeline.measuring.convex import ConvexBody, widths
from pipeline.measuring.directions import COVERING_RAD, half_sphere, near_frames

Array = NDArray[np.float64]
Objective = Callable[[Array, Array, Array], Array]
"""From the widths along the three axes to what is to be least; broadcasts."""

N_RANKED = 400
"""Coarse frames among which the starts are chosen."""
BEAM = 12
"""Frames followed while a turn may still lead from one local minimum to another."""
NARROW_BEAM = 5
"""Frames followed at turns of less than `NARROW_RAD`."""
NARROW_RAD = 0.006
N_CHILDREN = 4
"""Neighbours of a frame that are looked at closely."""
START_SPACING_RAD = 0.1
ZOOM = 0.6
TOTAL_TURN = 4.5
"""All turns still to come, sqrt(3) r (1 + ZOOM + ZOOM^2 + ...), are less than this times the radius r."""
SMOOTH_VERTICES = 4000
"""A body with more vertices than this is smooth: few local minima, wide ones, and coarse turns need not
look at all the vertices."""
SMOOTH_NARROW_RAD = 0.02
FINAL_RADIUS_RAD = 2e-5
"""Turning a body of extent D by this changes a width by at most 2e-5 D."""
GRID = np.linspace(-1.0, 1.0, 7)


def min_box_mm(body: ConvexBody) -> Array:
    """Edges (3,), longest first, of the box of least volume around the body."""
    frame = _least(body, lambda a, b, c: a * b * c)
    return np.sort(widths(body.vertices_mm, frame))[::-1]


def sieve_size_mm(body: ConvexBody) -> float:
    """Edge of the smallest square hole the body passes by translation.

    The least of max(w(e1), w(e2)) over all pairs of orthogonal directions: the smallest square around
    a projection, over all directions of projection.
    """
    frame = _least(body, lambda a, b, _: np.maximum(a, b))
    return float(widths(body.vertices_mm, frame[:2]).max())


def _least(body: ConvexBody, objective: Objective) -> Array:
    """The frame (3, 3), axes in rows, with the least objective."""
    directions, _ = half_sphere()
    triples = near_frames()
    scores = objective(*body.width_mm[triples].T)
    ranked = triples[np.argpartition(scores, N_RANKED)[:N_RANKED]]
    frames = _orthonormal(directions[ranked[:, 0]], directions[ranked[:, 1]])
    is_smooth = len(body.vertices_mm) > SMOOTH_VERTICES
    vertices_mm = body.touching_mm if is_smooth else body.vertices_mm
    narrow_rad = SMOOTH_NARROW_RAD if is_smooth else NARROW_RAD
    frames = _best(frames, vertices_mm, objective, BEAM, START_SPACING_RAD)
    radius, n_kept = COVERING_RAD, BEAM
    while radius > FINAL_RADIUS_RAD:
        if n_kept == BEAM and radius < narrow_rad:
            n_kept, vertices_mm, frames = NARROW_BEAM, body.vertices_mm, frames[:NARROW_BEAM]
        vertices_mm = _reachable(vertices_mm, frames, TOTAL_TURN * radius)
        children = _neighbours(vertices_mm, frames, radius, objective)
        frames = _best(np.concatenate([frames, children]), vertices_mm, objective, n_kept, radius / 2)
        radius *= ZOOM
    return frames[0]


def _best(frames: Array, vertices_mm: Array, objective: Objective, n: int, spacing_rad: float) -> Array:
    """The best n of the frames (K, 3, 3), best first, none a near twin of a better one."""
    values = objective(*widths(vertices_mm, frames.reshape(-1, 3)).reshape(-1, 3).T)
    frames = frames[np.argsort(values)]
    kept: list[Array] = []
    while len(frames) and len(kept) < n:
        kept.append(frames[0])
        # twins have the same three axes, in any order
        cosines = np.abs(frames @ frames[0].T).max(axis=2).min(axis=1)
        frames = frames[cosines < np.cos(spacing_rad)]
    return np.array(kept)


def _reachable(vertices_mm: Array, frames: Array, angle_rad: float) -> Array:
    """The vertices that may touch a plane normal to an axis of the frames turned by up to an angle.

    From the vertex t touching now, p takes over only if it lies less than tan(angle) |p - t| deeper.
    """
    axes = np.concatenate([frames, -frames]).reshape(-1, 3)
    heights = axes @ vertices_mm.T
    touching = heights.argmax(axis=1)
    depths = np.take_along_axis(heights, touching[:, None], axis=1) - heights
    distances = scipy.spatial.distance.cdist(vertices_mm[touching], vertices_mm)
    return vertices_mm[(depths <= np.tan(angle_rad) * distances).any(axis=0)]


def _neighbours(vertices_mm: Array, frames: Array, radius: float, objective: Objective) -> Array:
    """For each frame the best `N_CHILDREN` of the frames turned by (x, y, z) in a cube of +-radius.

    To first order e1 turns with y and z only, e2 with x and z, e3 with x and y: the widths of 3 m^2
    directions give the objective at m^3 rotations.
    """
    m = len(GRID)
    steps = GRID * radius
    e1, e2, e3 = (frames[:, k, None, None, :] for k in range(3))
    first, second = steps[:, None, None], steps[None, :, None]
    directions = np.stack(
        [
            e1 + second * e2 - first * e3,  # y, z
            e2 - second * e1 + first * e3,  # x, z
            e3 + second * e1 - first * e2,  # x, y
        ]
    )
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    w1, w2, w3 = widths(vertices_mm, directions.reshape(-1, 3)).reshape(3, len(frames), m, m)
    values = objective(w1[:, None, :, :], w2[:, :, None, :], w3[:, :, :, None]).reshape(len(frames), -1)
    best = np.argpartition(values, N_CHILDREN, axis=1)[:, :N_CHILDREN]
    x, y, z = (steps[index].reshape(-1, 1) for index in np.unravel_index(best, (m, m, m)))
    e1, e2, e3 = (np.repeat(frames[:, k], N_CHILDREN, axis=0) for k in range(3))
    return _orthonormal(e1 + z * e2 - y * e3, e2 - z * e1 + x * e3)


def _orthonormal(first: Array, second: Array) -> Array:
    """Frames (K, 3, 3) whose first axis is `first` (K, 3) and whose second is near `second` (K, 3)."""
    e1 = first / np.linalg.norm(first, axis=1, keepdims=True)
    e2 = second - np.sum(second * e1, axis=1, keepdims=True) * e1
    e2 /= np.linalg.norm(e2, axis=1, keepdims=True)
    return np.stack([e1, e2, np.cross(e1, e2)], axis=1)
