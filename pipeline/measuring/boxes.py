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
BEAM = 12
"""Frames followed while the zoom may still jump from one local minimum to another."""
NARROW_BEAM = 3
NARROW_RAD = 0.01
N_CHILDREN = 4
"""Neighbours of a frame that are looked at closely."""
START_SPACING_RAD = 0.1
ZOOM = 0.6
FINAL_RADIUS_RAD = 2e-5
"""Turning a body of extent D by this changes a width by at most 2e-5 D."""
GRID = np.linspace(-1.0, 1.0, 7)


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
    directions, _ = half_sphere()
    triples = near_frames()
    scores = objective(*width_mm[triples].T)
    ranked = triples[np.argpartition(scores, N_RANKED)[:N_RANKED]]
    frames = _orthonormal(directions[ranked[:, 0]], directions[ranked[:, 1]])
    frames = _best(frames, vertices_mm, objective, BEAM, START_SPACING_RAD)
    radius = COVERING_RAD
    while radius > FINAL_RADIUS_RAD:
        reached_mm = _reachable(vertices_mm, frames, 2 * radius)
        children = _neighbours(reached_mm, frames, radius, objective)
        n_kept = BEAM if radius > NARROW_RAD else NARROW_BEAM
        frames = _best(np.concatenate([frames, children]), reached_mm, objective, n_kept, radius / 2)
        radius *= ZOOM
    return frames[0]


def _best(frames: Array, vertices_mm: Array, objective: Objective, n: int, spacing_rad: float) -> Array:
    """The best n of the frames (K, 3, 3), best first, none a near twin of a better one."""
    values = objective(*_widths(vertices_mm, frames.reshape(-1, 3)).reshape(-1, 3).T)
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
    w1, w2, w3 = _widths(vertices_mm, directions.reshape(-1, 3)).reshape(3, len(frames), m, m)
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


def _widths(vertices_mm: Array, directions: Array) -> Array:
    heights = directions @ vertices_mm.T
    return np.asarray(heights.max(axis=1) - heights.min(axis=1))
