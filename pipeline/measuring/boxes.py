"""The smallest box around a body and the smallest square it passes: searches over rotations.

Both depend on nothing but the widths w(e) of the body along the axes of an orthonormal frame:

- a box along the frame holds the body if its edges are w(e1), w(e2), w(e3);
- the body passes along e3 through a square with sides along e1 and e2 and edge max(w(e1), w(e2)).

Both have many local minima. A beam of the best frames, chosen among 75 000 coarse ones (`near_frames`),
is turned by smaller and smaller angles; frames that come close to a better one give way to others.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.measuring.convex import ConvexBody, Edges, highest, touch, unit
from pipeline.measuring.directions import COVERING_RAD, half_sphere, near_frames

Array = NDArray[np.float64]
Indices = NDArray[np.int32]

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
FINAL_RADIUS_RAD = 2e-5
"""Turning a body of extent D by this changes a width by at most 2e-5 D."""
N_STEPS = 7
"""Turns about each axis, from minus to plus the radius."""


class _Frames(NamedTuple):
    """Orthonormal frames and what is known of them."""

    axes: Array  # (F, 3, 3) axes in rows
    touching: Indices  # (3 F, 2) vertices at the upper and the lower plane of each axis
    width_mm: Array  # (3 F,)
    score: Array  # (F,) what is to be least; infinite: not wanted


def min_box_mm(body: ConvexBody) -> Array:
    """Edges (3,), longest first, of the box of least volume around the body."""
    return np.sort(_least(body, is_box=True))[::-1]


def sieve_size_mm(body: ConvexBody) -> float:
    """Edge of the smallest square hole the body passes by translation.

    The least of max(w(e1), w(e2)) over all pairs of orthogonal directions: the smallest square around
    a projection, over all directions of projection.
    """
    return float(_least(body, is_box=False)[:2].max())


def _least(body: ConvexBody, is_box: bool) -> Array:
    """The widths (3,) along the axes of the best frame."""
    triples = near_frames()
    scores = np.empty(len(triples))
    _score_all(body.width_mm, triples, is_box, scores)
    starts = triples[np.argpartition(scores, N_RANKED)[:N_RANKED]]
    frames, kept = _room(max(N_RANKED, BEAM * (1 + N_CHILDREN))), _room(BEAM)
    frames.axes[:N_RANKED] = half_sphere().directions[starts]
    frames.touching[: 3 * N_RANKED] = body.touching[starts.reshape(-1)]
    grid_mm = np.empty((3, N_STEPS, N_STEPS))
    n_kept = _choose(body.edges, frames, N_RANKED, is_box, kept, BEAM, START_SPACING_RAD)
    radius = COVERING_RAD
    while radius > FINAL_RADIUS_RAD:
        n_most = BEAM if radius >= NARROW_RAD else NARROW_BEAM
        n_frames = _turn(body.edges, kept, min(n_kept, n_most), radius, is_box, grid_mm, frames)
        n_kept = _choose(body.edges, frames, n_frames, is_box, kept, n_most, radius / 2)
        radius *= ZOOM
    return kept.width_mm[:3]


def _room(n: int) -> _Frames:
    return _Frames(np.empty((n, 3, 3)), np.empty((3 * n, 2), np.int32), np.empty(3 * n), np.empty(n))


@compiled
def _score_all(width_mm: Array, triples: Indices, is_box: bool, scores: Array) -> None:
    for i in range(len(triples)):
        a_mm, b_mm, c_mm = width_mm[triples[i, 0]], width_mm[triples[i, 1]], width_mm[triples[i, 2]]
        scores[i] = _score(a_mm, b_mm, c_mm, is_box)


@compiled
def _score(a_mm: float, b_mm: float, c_mm: float, is_box: bool) -> float:
    return a_mm * b_mm * c_mm if is_box else max(a_mm, b_mm)


@compiled
def _choose(
    edges: Edges, frames: _Frames, n_frames: int, is_box: bool, kept: _Frames, n_most: int, spacing_rad: float
) -> int:
    """Keep the best of some frames, best first, none a near twin of a better one; returns how many."""
    cos_spacing = np.cos(spacing_rad)
    for i in range(n_frames):
        _settle(edges, frames, i, is_box)
    for n_kept in range(n_most):
        best = n_kept  # or any other
        for i in range(n_frames):
            if frames.score[i] < frames.score[best]:
                best = i
        if frames.score[best] == np.inf:
            return n_kept
        for axis in range(3):
            for k in range(3):
                kept.axes[n_kept, axis, k] = frames.axes[best, axis, k]
            for k in range(2):
                kept.touching[3 * n_kept + axis, k] = frames.touching[3 * best + axis, k]
            kept.width_mm[3 * n_kept + axis] = frames.width_mm[3 * best + axis]
        for i in range(n_frames):
            if _are_twins(frames.axes, i, best, cos_spacing):
                frames.score[i] = np.inf
    return n_most


@compiled
def _settle(edges: Edges, frames: _Frames, i: int, is_box: bool) -> None:
    """Make a frame orthonormal, keeping its first axis; climb to where it touches."""
    axes = frames.axes
    x, y, z = unit(axes[i, 0, 0], axes[i, 0, 1], axes[i, 0, 2])
    u, v, w = axes[i, 1, 0], axes[i, 1, 1], axes[i, 1, 2]
    along = u * x + v * y + w * z
    u, v, w = unit(u - along * x, v - along * y, w - along * z)
    axes[i, 0, 0], axes[i, 0, 1], axes[i, 0, 2] = x, y, z
    axes[i, 1, 0], axes[i, 1, 1], axes[i, 1, 2] = u, v, w
    axes[i, 2, 0], axes[i, 2, 1], axes[i, 2, 2] = y * w - z * v, z * u - x * w, x * v - y * u
    for axis in range(3):
        x, y, z = axes[i, axis, 0], axes[i, axis, 1], axes[i, axis, 2]
        frames.width_mm[3 * i + axis] = touch(edges, x, y, z, frames.touching, 3 * i + axis)
    width_mm = frames.width_mm
    frames.score[i] = _score(width_mm[3 * i], width_mm[3 * i + 1], width_mm[3 * i + 2], is_box)


@compiled
def _are_twins(axes: Array, i: int, j: int, cos_spacing: float) -> bool:
    """Whether two frames have nearly the same three axes, in any order and sense."""
    for k in range(3):
        nearest = 0.0
        for m in range(3):
            cosine = (
                axes[i, k, 0] * axes[j, m, 0] + axes[i, k, 1] * axes[j, m, 1] + axes[i, k, 2] * axes[j, m, 2]
            )
            nearest = max(nearest, abs(cosine))
        if nearest < cos_spacing:
            return False
    return True


@compiled
def _turn(
    edges: Edges, kept: _Frames, n_kept: int, radius: float, is_box: bool, grid_mm: Array, frames: _Frames
) -> int:
    """The frames kept, and for each the best of those turned by (x, y, z) in a cube of +-radius; returns how many.

    To first order e1 turns with y and z only, e2 with x and z, e3 with x and y: the widths of 3 m^2
    directions `grid_mm` give the score at m^3 rotations.
    """
    axes = kept.axes
    n_steps = grid_mm.shape[1]
    step = 2 * radius / (n_steps - 1)
    for parent in range(n_kept):
        for axis in range(3):
            if is_box or axis < 2:
                _measure_grid(edges, kept, parent, axis, radius, grid_mm)
        own = parent * (1 + N_CHILDREN)
        for i in range(own, own + 1 + N_CHILDREN):
            frames.score[i] = np.inf
            for axis in range(3):
                for k in range(3):
                    frames.axes[i, axis, k] = axes[parent, axis, k]
                for k in range(2):
                    frames.touching[3 * i + axis, k] = kept.touching[3 * parent + axis, k]
        worst = own + 1
        for x in range(n_steps):
            for y in range(n_steps):
                for z in range(n_steps):
                    score = _score(grid_mm[0, z, y], grid_mm[1, x, z], grid_mm[2, y, x], is_box)
                    if score >= frames.score[worst]:
                        continue
                    frames.score[worst] = score
                    about_x, about_y, about_z = x * step - radius, y * step - radius, z * step - radius
                    for k in range(3):
                        e1, e2, e3 = axes[parent, 0, k], axes[parent, 1, k], axes[parent, 2, k]
                        frames.axes[worst, 0, k] = e1 + about_z * e2 - about_y * e3
                        frames.axes[worst, 1, k] = e2 - about_z * e1 + about_x * e3
                    for i in range(own + 1, own + 1 + N_CHILDREN):
                        if frames.score[i] > frames.score[worst]:
                            worst = i
    return n_kept * (1 + N_CHILDREN)


@compiled
def _measure_grid(edges: Edges, kept: _Frames, frame: int, axis: int, radius: float, grid_mm: Array) -> None:
    """Widths of an axis turned by -radius to +radius towards the next axis and away from the one after."""
    axes, points = kept.axes, edges.vertices_mm
    n_steps = grid_mm.shape[1]
    step = 2 * radius / (n_steps - 1)
    after, last = (axis + 1) % 3, (axis + 2) % 3
    upper, lower = kept.touching[3 * frame + axis, 0], kept.touching[3 * frame + axis, 1]
    # vertices that touch in the four corners of the grid do so between them
    is_same = True
    for place in range(4 + n_steps * n_steps):
        i, j = (place - 4) // n_steps, (place - 4) % n_steps
        if place < 4:
            i, j = (place & 1) * (n_steps - 1), (place >> 1) * (n_steps - 1)
        towards, away = i * step - radius, j * step - radius
        x = axes[frame, axis, 0] + towards * axes[frame, after, 0] - away * axes[frame, last, 0]
        y = axes[frame, axis, 1] + towards * axes[frame, after, 1] - away * axes[frame, last, 1]
        z = axes[frame, axis, 2] + towards * axes[frame, after, 2] - away * axes[frame, last, 2]
        if place < 4 or not is_same:
            was_upper, was_lower = upper, lower
            upper, lower = highest(edges, x, y, z, upper), highest(edges, -x, -y, -z, lower)
            is_same = is_same and (place == 0 or (upper == was_upper and lower == was_lower))
        if place >= 4:
            dx, dy, dz = (
                points[upper, 0] - points[lower, 0],
                points[upper, 1] - points[lower, 1],
                points[upper, 2] - points[lower, 2],
            )
            length = np.sqrt(1 + towards * towards + away * away)
            grid_mm[axis, i, j] = (dx * x + dy * y + dz * z) / length
