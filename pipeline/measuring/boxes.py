"""The smallest box around a body and the smallest square it passes: searches over rotations.

Both depend on nothing but the widths w(e) of the body along the axes of an orthonormal frame:

- a box along the frame holds the body if its edges are w(e1), w(e2), w(e3);
- the body passes along e3 through a square with sides along e1 and e2 and edge max(w(e1), w(e2)).

Both have many local minima. A beam of the best frames, chosen among 20 000 coarse ones (`near_frames`), is turned
by smaller and smaller angles; frames that come close to a better one, or fall behind, give way to others.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled, whole
from pipeline.measuring.convex import ConvexBody, Edges, touch, unit
from pipeline.measuring.directions import COVERING_RAD, half_sphere, near_frames

Array = NDArray[np.float64]
Indices = NDArray[np.int32]

FIRST = whole(0)
"""Frame of a list."""
N_RANKED = 200
"""Coarse frames among which the starts are chosen."""
N_STARTS = 40
START_SPACING_RAD = 0.1
BEAM = 16
"""Frames followed while a turn may still lead from one local minimum to another."""
NARROW_BEAM = 5
"""Frames followed at turns of less than `NARROW_RAD`."""
NARROW_RAD = 0.006
MAX_LAG = 0.5
"""A frame is given up that is worse than the best known by more than this share for each rad of the latest turn."""
N_CHILDREN = 4
"""Of the turns of a frame so many are looked at closely."""
ZOOM = 0.6
FINAL_RADIUS_RAD = 2e-5
"""Turning a body of extent D by this changes a width by at most 2e-5 D."""
N_STEPS = 7
"""Turns about each axis, from minus to plus the radius."""
N_TURNS = N_STEPS**2  # of one axis: about itself it does not turn


class _Frames(NamedTuple):
    """Orthonormal frames and what is known of them."""

    axes: Array  # (F, 3, 3) axes in rows
    touching: Indices  # (3 F, 2) vertices at the upper and the lower plane of each axis
    width_mm: Array  # (3 F,)
    score: Array  # (F,) what is to be least; infinite: not wanted


class _Turns(NamedTuple):
    """Small turns of any axis, and room for what they measure."""

    towards: Array  # (N_TURNS,) how far, in rad, towards the axis after it
    away: Array  # (N_TURNS,) and away from the last one
    shrink: Array  # (N_TURNS,) what makes it a unit vector again
    height_mm: Array  # (2, N_TURNS) of the plane above the body and of the one below it
    width_mm: Array  # (3, N_TURNS) for each axis of a frame
    queue: Indices  # (N,) vertices
    is_queued: NDArray[np.bool_]  # (N,)


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
    """The widths (3,) along the axes of the best frame; where it is no box the third is 0."""
    triples = near_frames()
    scores = np.empty(len(triples))
    _score_all(body.width_mm, triples, is_box, scores)
    ranked = np.argpartition(scores, N_RANKED)[:N_RANKED]
    starts = triples[ranked]
    frames, kept = _room(N_RANKED), _room(N_STARTS)
    frames.axes[:] = half_sphere().directions[starts]
    frames.touching[:] = body.touching[starts.reshape(-1)]
    frames.score[:] = scores[ranked]
    best_mm = np.zeros(3)
    _search(body.edges, frames, kept, is_box, _turns(len(body.vertices_mm)), best_mm)
    return best_mm


def _room(n: int) -> _Frames:
    return _Frames(np.empty((n, 3, 3)), np.empty((3 * n, 2), np.int32), np.empty(3 * n), np.empty(n))


def _turns(n_vertices: int) -> _Turns:
    towards, away, shrink = np.empty((3, N_TURNS))
    height_mm, width_mm = np.empty((2, N_TURNS)), np.empty((3, N_TURNS))
    queue, is_queued = np.empty(n_vertices, np.int32), np.zeros(n_vertices, np.bool_)
    return _Turns(towards, away, shrink, height_mm, width_mm, queue, is_queued)


@compiled
def _score_all(width_mm: Array, triples: Indices, is_box: bool, scores: Array) -> None:
    for i in range(len(triples)):
        a_mm, b_mm, c_mm = width_mm[triples[i, 0]], width_mm[triples[i, 1]], width_mm[triples[i, 2]]
        scores[i] = _score(a_mm, b_mm, c_mm, is_box)


@compiled
def _score(a_mm: float, b_mm: float, c_mm: float, is_box: bool) -> float:
    return a_mm * b_mm * c_mm if is_box else max(a_mm, b_mm)


@compiled
def _search(
    edges: Edges, frames: _Frames, kept: _Frames, is_box: bool, turns: _Turns, best_mm: Array
) -> None:
    """Set the widths (3,) of the best frame, starting from some of those given, whose room is used again."""
    n_frames, n_most = len(frames.score), len(kept.score)
    spacing_rad, limit = START_SPACING_RAD, np.inf
    radius, best = COVERING_RAD, np.inf
    while True:
        n_kept = _choose(edges, frames, n_frames, is_box, kept, n_most, spacing_rad, limit)
        for i in range(n_kept):
            if kept.score[i] < best:
                best = kept.score[i]
                for axis in range(3 if is_box else 2):
                    best_mm[axis] = kept.width_mm[3 * i + axis]
        if radius < FINAL_RADIUS_RAD:
            return
        n_frames = _turn(edges, kept, n_kept, radius, is_box, turns, frames)
        n_most = BEAM if radius >= NARROW_RAD else NARROW_BEAM
        spacing_rad, limit = radius / 2, best * (1 + MAX_LAG * radius)
        radius *= ZOOM


@compiled
def _choose(
    edges: Edges,
    frames: _Frames,
    n_frames: int,
    is_box: bool,
    kept: _Frames,
    n_most: int,
    spacing_rad: float,
    limit: float,
) -> int:
    """Keep the best of some frames, best first, none a near twin of a better one; returns how many."""
    cos_spacing = np.cos(spacing_rad)
    for n_kept in range(n_most):
        best = FIRST
        for i in range(n_frames):
            if frames.score[i] < frames.score[best]:
                best = i
        if not frames.score[best] < limit:
            return n_kept
        _copy(frames, best, kept, n_kept)
        _settle(edges, kept, n_kept, is_box)
        for i in range(n_frames):
            if i == best or _are_twins(frames.axes, i, best, cos_spacing):
                frames.score[i] = np.inf
    return n_most


@compiled
def _copy(frames: _Frames, i: int, to_frames: _Frames, to_i: int) -> None:
    """Copy axes and touching vertices."""
    for axis in range(3):
        for k in range(3):
            to_frames.axes[to_i, axis, k] = frames.axes[i, axis, k]
        for k in range(2):
            to_frames.touching[3 * to_i + axis, k] = frames.touching[3 * i + axis, k]


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
    for axis in range(3 if is_box else 2):
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
    edges: Edges, kept: _Frames, n_kept: int, radius: float, is_box: bool, turns: _Turns, frames: _Frames
) -> int:
    """For each of the frames kept the best of those turned by (x, y, z) in a cube of +-radius; returns how many.

    To first order e1 turns with y and z only, e2 with x and z, e3 with x and y: the widths along 3 m^2
    directions give the score at m^3 rotations.
    """
    axes, width_mm, shrink = kept.axes, turns.width_mm, turns.shrink
    step = 2 * radius / (N_STEPS - 1)
    for i in range(N_STEPS):
        for j in range(N_STEPS):
            towards, away = i * step - radius, j * step - radius
            turns.towards[N_STEPS * i + j], turns.away[N_STEPS * i + j] = towards, away
            shrink[N_STEPS * i + j] = 1 / np.sqrt(1 + towards * towards + away * away)
    for parent in range(n_kept):
        for axis in range(3 if is_box else 2):
            for end in range(2):
                _measure_heights(edges, kept, parent, axis, end, radius, turns)
            for turn in range(N_TURNS):
                both_mm = turns.height_mm[0, turn] + turns.height_mm[1, turn]
                width_mm[axis, turn] = both_mm * shrink[turn]
        children = range(parent * N_CHILDREN, (parent + 1) * N_CHILDREN)
        for child in children:
            _copy(kept, parent, frames, child)
            frames.score[child] = np.inf
        worst = parent * N_CHILDREN
        for x in range(N_STEPS):
            for y in range(N_STEPS):
                for z in range(N_STEPS):
                    first, second, third = N_STEPS * z + y, N_STEPS * x + z, N_STEPS * y + x
                    score = _score(width_mm[0, first], width_mm[1, second], width_mm[2, third], is_box)
                    if score >= frames.score[worst]:
                        continue
                    frames.score[worst] = score
                    about_x, about_y, about_z = x * step - radius, y * step - radius, z * step - radius
                    for k in range(3):
                        e1, e2, e3 = axes[parent, 0, k], axes[parent, 1, k], axes[parent, 2, k]
                        frames.axes[worst, 0, k] = (e1 + about_z * e2 - about_y * e3) * shrink[first]
                        frames.axes[worst, 1, k] = (e2 + about_x * e3 - about_z * e1) * shrink[second]
                        frames.axes[worst, 2, k] = (e3 + about_y * e1 - about_x * e2) * shrink[third]
                    for child in children:
                        if frames.score[child] > frames.score[worst]:
                            worst = child
    return n_kept * N_CHILDREN


@compiled
def _measure_heights(
    edges: Edges, kept: _Frames, frame: int, axis: int, end: int, radius: float, turns: _Turns
) -> None:
    """Heights of the body's upper (`end` 0) or lower plane along an axis turned in all ways.

    The vertices that touch in one of these ways are connected. So, from the one that touches now outwards,
    those are looked at which the turns may lift as high as it.
    """
    axes, points, height_mm = kept.axes, edges.vertices_mm, turns.height_mm
    sense = 1.0 - 2.0 * end
    after, last = (axis + 1) % 3, (axis + 2) % 3
    x, y, z = sense * axes[frame, axis, 0], sense * axes[frame, axis, 1], sense * axes[frame, axis, 2]
    u, v, w = sense * axes[frame, after, 0], sense * axes[frame, after, 1], sense * axes[frame, after, 2]
    a, b, c = sense * axes[frame, last, 0], sense * axes[frame, last, 1], sense * axes[frame, last, 2]
    top = kept.touching[3 * frame + axis, end]
    px, py, pz = points[top, 0], points[top, 1], points[top, 2]
    top_mm = px * x + py * y + pz * z
    top_after_mm, top_last_mm = px * u + py * v + pz * w, px * a + py * b + pz * c
    for turn in range(N_TURNS):
        height_mm[end, turn] = -np.inf
    turns.queue[0], turns.is_queued[top] = top, True
    n_seen, n_queued = 0, 1
    while n_seen < n_queued:
        vertex = turns.queue[n_seen]
        n_seen += 1
        px, py, pz = points[vertex, 0], points[vertex, 1], points[vertex, 2]
        own_mm = px * x + py * y + pz * z
        after_mm, last_mm = px * u + py * v + pz * w, px * a + py * b + pz * c
        if own_mm + radius * (abs(after_mm - top_after_mm) + abs(last_mm - top_last_mm)) < top_mm:
            continue
        for turn in range(N_TURNS):
            turned_mm = own_mm + turns.towards[turn] * after_mm - turns.away[turn] * last_mm
            height_mm[end, turn] = max(height_mm[end, turn], turned_mm)
        for k in range(edges.first[vertex], edges.first[vertex + 1]):
            other = edges.neighbors[k]
            if not turns.is_queued[other]:
                turns.queue[n_queued], turns.is_queued[other] = other, True
                n_queued += 1
    for k in range(n_queued):
        turns.is_queued[turns.queue[k]] = False
