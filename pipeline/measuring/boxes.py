"""The smallest box around a body and the smallest square it passes: searches over rotations.

Both depend on nothing but the widths w(e) of the body along the axes of an orthonormal frame:

- a box along the frame holds the body if its edges are w(e1), w(e2), w(e3);
- the body passes along e3 through a square with sides along e1 and e2 and edge max(w(e1), w(e2)).

The best of some 75 000 coarse frames (`near_frames`) start a local search that zooms in.
"""

from collections.abc import Callable

import numpy as np
import scipy.spatial
from numpy.typing import NDArray

from pipeline.measuring.calipers import widths
from pipeline.measuring.directions import COVERING_RAD, half_sphere, near_frames

Array = NDArray[np.float64]
Objective = Callable[[Array, Array, Array], Array]
"""From the widths along the three axes to what is to be least; broadcasts."""

N_RANKED = 400
"""Coarse frames among which the starts are chosen."""
N_STARTS = 12
N_FINALISTS = 4
"""Starts still followed after the first zoom."""
START_SPACING_RAD = 0.15
MAX_MOVES = 4
"""Steps at one radius; on smooth bodies the least value lies in a long flat valley."""
ZOOM = 0.4
FINAL_RADIUS_RAD = 2e-5
"""Turning a body of extent D by this changes a width by at most 2e-5 D."""
GRID = np.linspace(-1.0, 1.0, 5)


def min_box_mm(vertices_mm: Array, width_mm: Array) -> Array:
    """Edges (3,), longest first, of the box of least volume around the vertices (N, 3).

    `width_mm` are the `widths` along `half_sphere()`.
    """
    frame = _least(vertices_mm, width_mm, lambda a, b, c: a * b * c)
    return np.sort(widths(vertices_mm, frame)[0])[::-1]


def sieve_size_mm(vertices_mm: Array, width_mm: Array) -> float:
    """Edge of the smallest square hole the convex hull of the vertices (N, 3) passes by translation.

    The least of max(w(e1), w(e2)) over all pairs of orthogonal directions: the smallest square around
    a projection, over all directions of projection.
    """
    frame = _least(vertices_mm, width_mm, lambda a, b, _: np.maximum(a, b))
    return float(widths(vertices_mm, frame[:2])[0].max())


def _least(vertices_mm: Array, width_mm: Array, objective: Objective) -> Array:
    """The frame (3, 3), axes in rows, with the least objective."""
    frames = _starts(width_mm, objective)
    values = _values(vertices_mm, frames, objective)
    radius = COVERING_RAD
    while radius > FINAL_RADIUS_RAD:
        for _ in range(MAX_MOVES):
            reached_mm = _reachable(vertices_mm, frames, 2 * radius)
            turned, on_border = _best_neighbours(reached_mm, frames, radius, objective)
            turned_values = _values(reached_mm, turned, objective)
            better = turned_values < values
            frames = np.where(better[:, None, None], turned, frames)
            values = np.where(better, turned_values, values)
            if not (better & on_border).any():
                break
        finalists = np.argsort(values)[:N_FINALISTS]
        frames, values = frames[finalists], values[finalists]
        radius *= ZOOM
    return frames[0]


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


def _starts(width_mm: Array, objective: Objective) -> Array:
    """The best coarse frames (K, 3, 3), none a near twin of a better one."""
    directions, _ = half_sphere()
    triples = near_frames()
    first, second, third = width_mm[triples].T
    scores = objective(first, second, third)
    ranked = np.argpartition(scores, N_RANKED)[:N_RANKED]
    ranked = ranked[np.argsort(scores[ranked])]
    frames = _orthonormal(directions[triples[ranked, 0]], directions[triples[ranked, 1]])
    starts = []
    while len(frames) and len(starts) < N_STARTS:
        starts.append(frames[0])
        # twins have the same three axes in any order, up to the spacing
        nearest = np.abs(frames @ frames[0].T).max(axis=2).min(axis=1)
        frames = frames[nearest < np.cos(START_SPACING_RAD)]
    return np.array(starts)


def _best_neighbours(
    vertices_mm: Array, frames: Array, radius: float, objective: Objective
) -> tuple[Array, NDArray[np.bool_]]:
    """For each frame the best of the frames turned by (x, y, z) in a cube of +-radius, and whether it is
    on the cube's border.

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
    width_mm = _widths(vertices_mm, directions.reshape(-1, 3))
    w1, w2, w3 = width_mm.reshape(3, len(frames), m, m)
    values = objective(w1[:, None, :, :], w2[:, :, None, :], w3[:, :, :, None])
    x, y, z = np.unravel_index(values.reshape(len(frames), -1).argmin(axis=1), (m, m, m))
    turn = steps[np.stack([x, y, z])][:, :, None]
    e1, e2, e3 = frames[:, 0], frames[:, 1], frames[:, 2]
    turned = _orthonormal(e1 + turn[2] * e2 - turn[1] * e3, e2 - turn[2] * e1 + turn[0] * e3)
    on_border = (np.stack([x, y, z]) % (m - 1) == 0).any(axis=0)
    return turned, on_border


def _values(vertices_mm: Array, frames: Array, objective: Objective) -> Array:
    width_mm = _widths(vertices_mm, frames.reshape(-1, 3))
    first, second, third = width_mm.reshape(-1, 3).T
    return objective(first, second, third)


def _orthonormal(first: Array, second: Array) -> Array:
    """Frames (K, 3, 3) whose first axis is `first` (K, 3) and whose second is near `second` (K, 3)."""
    e1 = first / np.linalg.norm(first, axis=1, keepdims=True)
    e2 = second - np.sum(second * e1, axis=1, keepdims=True) * e1
    e2 /= np.linalg.norm(e2, axis=1, keepdims=True)
    return np.stack([e1, e2, np.cross(e1, e2)], axis=1)


def _widths(vertices_mm: Array, directions: Array) -> Array:
    heights = directions @ vertices_mm.T
    return np.asarray(heights.max(axis=1) - heights.min(axis=1))
