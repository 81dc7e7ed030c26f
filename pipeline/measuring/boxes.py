"""Search over rotations for the box of least volume around a body and for the smallest square it passes through.

Both depend only on the widths w(e) of the body along the axes of an orthonormal frame:

- the box along the frame that just holds the body has the edges w(e1), w(e2), w(e3);
- the body passes along its widest axis through a square with an edge of the middle one of w(e1), w(e2), w(e3).

Both have many local minima, so this is a beam search: the best frames among 10 000 coarse ones (`near_frames`) are
rotated by smaller and smaller angles; frames that come close to a better one, or fall behind, are dropped.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats, Indices32, Values, Vector
from pipeline.compiled import compiled, compiled_within, whole
from pipeline.measuring.convex import ConvexBody, Edges, touch, unit
from pipeline.measuring.directions import COVERING_RAD, half_sphere, near_frames

FIRST = whole(0)
"""Typed constant for the compiled loops: index of the first frame."""
N_COARSE = whole(40)
"""Number of coarse frames, each of another neighbourhood, from which the starts are chosen."""
N_STARTS = 20
"""Number of frames from which the search starts."""
START_SPACING_RAD = 0.1
"""Least rotation between two of them."""
BEAM = 16
"""Beam width while a rotation may still lead from one local minimum to another."""
NARROW_BEAM = 6
"""Beam width once the search radius is below `NARROW_RAD`."""
NARROW_RAD = 0.006
MAX_LAG = 0.5
"""A frame is dropped whose score exceeds the best by more than this share per rad of the search radius."""
N_CHILDREN = 4
"""Number of rotations of a frame that are followed up, the best by the first-order score."""
ZOOM, NARROW_ZOOM = 0.6, 0.5
"""Factors of the search radius from one round to the next, above and below `NARROW_RAD`."""
FINAL_RADIUS_RAD = 1e-5
"""The search ends here: rotating a body of extent D by this changes a width by at most 1e-5 D."""
N_STEPS = 7
"""Number of rotation angles about each axis, from minus to plus the search radius."""
N_TURNS = N_STEPS**2
"""Number of directions that an axis takes: rotating about itself does not move it."""


class _Frames(NamedTuple):
    """F candidate frames of the search."""

    axes: Floats  # (F, 3, 3) axes in rows
    touching: Indices32  # (3 F, 2) vertices at the upper and the lower tangent plane of each axis
    score: Values  # (F,) volume of the box, or edge of the square; infinite: dropped


class _Turns(NamedTuple):
    """Small rotations of an axis, and work arrays for the widths along the rotated axes."""

    steps: Floats  # (2, N_TURNS) towards the next axis and away from the one after it, in units of the search radius
    width_mm: Floats  # (4, N_TURNS) for each axis of a frame; the last row is scratch space
    queue: Indices32  # (2, N) queue of vertices, and for each vertex whether it has been queued


def smallest_around_mm(body: ConvexBody) -> tuple[Vector, float]:
    """Return the edges, longest first, of the box of least volume, and that of the smallest square hole passed.

    The body passes by translation. The hole is the minimum of max(w(e1), w(e2)) over all pairs of orthogonal
    directions: the smallest square around a projection, over all directions of projection.
    """
    one_mm, two_mm, three_mm = body.width_mm[near_frames()]
    box_mm, _ = _least_widths(body, one_mm * two_mm * three_mm, True)
    square_mm, _ = smallest_square(body)
    return np.sort(box_mm)[::-1], square_mm


def smallest_square(body: ConvexBody) -> tuple[float, Floats]:
    """Return the edge of the smallest square hole that the body passes, and the frame (3, 3) in which it does.

    Rows of the frame are the directions of the square's sides, and the direction in which the body passes.
    """
    one_mm, two_mm, three_mm = body.width_mm[near_frames()]
    median_mm = np.maximum(np.minimum(one_mm, two_mm), np.minimum(np.maximum(one_mm, two_mm), three_mm))
    widths_mm, axes = _least_widths(body, median_mm, False)
    order = widths_mm.argsort()
    return float(widths_mm[order[1]]), axes[order]


def _least_widths(body: ConvexBody, scores: Floats, is_box: bool) -> tuple[Vector, Floats]:
    """Return the widths along the best frame's axes, and these axes, in rows.

    `scores` are those of `near_frames`.
    """
    neighborhoods = np.argpartition(scores.min(axis=0), N_COARSE)[:N_COARSE]
    best = scores[:, neighborhoods].argmin(axis=0)
    coarse = near_frames()[:, best, neighborhoods].T
    frames, kept = _empty_frames(N_CHILDREN * N_STARTS), _empty_frames(N_STARTS)
    frames.axes[:N_COARSE] = half_sphere().directions[coarse]
    frames.touching[: 3 * N_COARSE] = body.touching[coarse.reshape(-1)]
    frames.score[:N_COARSE] = scores[best, neighborhoods]
    widths_mm, best_mm, best_axes = np.zeros(3), np.zeros(3), np.zeros((3, 3))
    _search(body.edges, frames, kept, is_box, _turns(len(body.vertices_mm)), widths_mm, best_mm, best_axes)
    return best_mm, best_axes


def _empty_frames(n: int) -> _Frames:
    return _Frames(np.empty((n, 3, 3)), np.empty((3 * n, 2), np.int32), np.empty(n))


@cache
def _steps() -> Floats:
    steps = np.linspace(-1, 1, N_STEPS)
    return np.array([np.repeat(steps, N_STEPS), np.tile(steps, N_STEPS)])


def _turns(n_vertices: int) -> _Turns:
    return _Turns(_steps(), np.empty((4, N_TURNS)), np.zeros((2, n_vertices), np.int32))


@compiled
def _search(
    edges: Edges,
    frames: _Frames,
    kept: _Frames,
    is_box: bool,
    turns: _Turns,
    widths_mm: Vector,
    best_mm: Vector,
    best_axes: Floats,
) -> None:
    """Set `best_mm` to the widths of the best frame, and `best_axes` to its axes.

    `frames` starts with the `N_COARSE` coarse ones.
    """
    n_frames, n_most, spacing_rad, limit = N_COARSE, N_STARTS, START_SPACING_RAD, np.inf
    radius, best = COVERING_RAD, np.inf
    while True:
        n_kept, cos_spacing = FIRST, np.cos(spacing_rad)
        while n_kept < n_most:
            nearest = _lowest(frames.score, n_frames)
            if not frames.score[nearest] < limit:
                break
            _keep(edges, frames, nearest, kept, n_kept, widths_mm)
            score = _score(widths_mm[0], widths_mm[1], widths_mm[2], is_box)
            kept.score[n_kept] = score
            if score < best:
                best = score
                best_mm[:] = widths_mm
                best_axes[:] = kept.axes[n_kept]
            _drop_similar(frames, n_frames, nearest, cos_spacing)
            n_kept += 1
        if radius < FINAL_RADIUS_RAD:
            return
        for parent in range(n_kept):
            for axis in range(3):
                _turn(edges, kept, parent, axis, radius, turns)
            _add_children(kept, parent, turns.width_mm, radius, is_box, frames)
        n_frames = N_CHILDREN * n_kept
        is_wide = radius >= NARROW_RAD
        n_most = BEAM if is_wide else NARROW_BEAM
        spacing_rad, limit = radius / 2, best * (1 + MAX_LAG * radius)
        radius *= ZOOM if is_wide else NARROW_ZOOM


@compiled_within
def _lowest(score: Values, n: int) -> int:
    best = FIRST
    for i in range(1, n):
        if score[i] < score[best]:
            best = i
    return best


@compiled_within
def _score(a_mm: float, b_mm: float, c_mm: float, is_box: bool) -> float:
    if is_box:
        return a_mm * b_mm * c_mm
    return max(min(a_mm, b_mm), min(max(a_mm, b_mm), c_mm))


@compiled_within
def _keep(edges: Edges, frames: _Frames, i: int, kept: _Frames, to_i: int, widths_mm: Vector) -> None:
    """Copy frame `i` to `kept`, made orthonormal about its first axis, and set its tangent vertices and widths."""
    axes = frames.axes
    x, y, z = unit(axes[i, 0, 0], axes[i, 0, 1], axes[i, 0, 2])
    u, v, w = axes[i, 1, 0], axes[i, 1, 1], axes[i, 1, 2]
    along = u * x + v * y + w * z
    u, v, w = unit(u - along * x, v - along * y, w - along * z)
    axes = kept.axes
    axes[to_i, 0, 0], axes[to_i, 0, 1], axes[to_i, 0, 2] = x, y, z
    axes[to_i, 1, 0], axes[to_i, 1, 1], axes[to_i, 1, 2] = u, v, w
    axes[to_i, 2, 0], axes[to_i, 2, 1], axes[to_i, 2, 2] = y * w - z * v, z * u - x * w, x * v - y * u
    for axis in range(3):
        row = 3 * to_i + axis
        for end in range(2):
            kept.touching[row, end] = frames.touching[3 * i + axis, end]
        x, y, z = axes[to_i, axis, 0], axes[to_i, axis, 1], axes[to_i, axis, 2]
        widths_mm[axis] = touch(edges, x, y, z, kept.touching, row)


@compiled_within
def _drop_similar(frames: _Frames, n_frames: int, best: int, cos_spacing: float) -> None:
    """Drop frames with nearly the same three axes as the best, in any order and sense, and the best itself."""
    axes = frames.axes
    for i in range(n_frames):
        n_near = FIRST
        for k in range(3):
            if n_near < k or frames.score[i] == np.inf:
                break
            for m in range(3):
                cosine = (
                    axes[i, k, 0] * axes[best, m, 0]
                    + axes[i, k, 1] * axes[best, m, 1]
                    + axes[i, k, 2] * axes[best, m, 2]
                )
                n_near += abs(cosine) >= cos_spacing
        if n_near == 3:
            frames.score[i] = np.inf
    frames.score[best] = np.inf


@compiled_within
def _turn(edges: Edges, kept: _Frames, frame: int, axis: int, radius: float, turns: _Turns) -> None:
    """Set the widths of the body along an axis of a frame for all `N_TURNS` rotations of it.

    The vertices that touch a tangent plane of any rotated axis are connected by edges. So the search spreads from the
    vertex that touches now to those neighbours that a rotation may lift as high as it.
    """
    axes, points, steps, width_mm, queue = (
        kept.axes,
        edges.vertices_mm,
        turns.steps,
        turns.width_mm,
        turns.queue,
    )
    after, last = (axis + 1) % 3, (axis + 2) % 3
    for turn in range(N_TURNS):
        width_mm[axis, turn] = 0.0
    for end in range(2):
        sense = 1.0 - 2.0 * end
        x, y, z = sense * axes[frame, axis, 0], sense * axes[frame, axis, 1], sense * axes[frame, axis, 2]
        far = sense * radius
        u, v, w = far * axes[frame, after, 0], far * axes[frame, after, 1], far * axes[frame, after, 2]
        a, b, c = far * axes[frame, last, 0], far * axes[frame, last, 1], far * axes[frame, last, 2]
        for turn in range(N_TURNS):
            width_mm[3, turn] = -np.inf
        top = kept.touching[3 * frame + axis, end]
        top_mm = top_after_mm = top_last_mm = 0.0
        queue[0, 0], queue[1, top] = top, 1
        n_seen, n_queued = 0, 1
        while n_seen < n_queued:
            vertex = queue[0, n_seen]
            px, py, pz = points[vertex, 0], points[vertex, 1], points[vertex, 2]
            own_mm = px * x + py * y + pz * z
            after_mm, last_mm = px * u + py * v + pz * w, px * a + py * b + pz * c
            if n_seen == 0:
                top_mm, top_after_mm, top_last_mm = own_mm, after_mm, last_mm
            n_seen += 1
            if own_mm + abs(after_mm - top_after_mm) + abs(last_mm - top_last_mm) < top_mm:
                continue
            for turn in range(N_TURNS):
                turned_mm, top_turned_mm = (
                    own_mm + steps[0, turn] * after_mm - steps[1, turn] * last_mm,
                    width_mm[3, turn],
                )
                width_mm[3, turn] = turned_mm if turned_mm > top_turned_mm else top_turned_mm
            for k in range(edges.first[vertex], edges.first[vertex + 1]):
                other = edges.neighbors[k]
                if queue[1, other] == 0:
                    queue[0, n_queued], queue[1, other] = other, 1
                    n_queued += 1
        for k in range(n_queued):
            queue[1, queue[0, k]] = 0
        for turn in range(N_TURNS):
            width_mm[axis, turn] += width_mm[3, turn]
    for turn in range(N_TURNS):  # to first order a rotated axis is too long
        towards, away = radius * steps[0, turn], radius * steps[1, turn]
        width_mm[axis, turn] /= np.sqrt(1 + towards * towards + away * away)


@compiled_within
def _add_children(
    kept: _Frames, parent: int, width_mm: Floats, radius: float, is_box: bool, frames: _Frames
) -> None:
    """Set the `N_CHILDREN` best frames among the rotations of a frame by (x, y, z) in a cube of +-radius.

    To first order e1 moves with y and z only, e2 with x and z, e3 with x and y: the widths along 3 m^2
    directions give the score at m^3 rotations.
    """
    axes = kept.axes
    first_child = N_CHILDREN * parent
    for child in range(first_child, first_child + N_CHILDREN):
        frames.score[child] = np.inf
        for axis in range(3):
            for end in range(2):
                frames.touching[3 * child + axis, end] = kept.touching[3 * parent + axis, end]
    worst = first_child
    step = 2 * radius / (N_STEPS - 1)
    for i in range(N_STEPS):
        for j in range(N_STEPS):
            for k in range(N_STEPS):
                a_mm, b_mm = width_mm[0, N_STEPS * k + j], width_mm[1, N_STEPS * i + k]
                score = _score(a_mm, b_mm, width_mm[2, N_STEPS * j + i], is_box)
                if score >= frames.score[worst]:
                    continue
                frames.score[worst] = score
                x, y, z = i * step - radius, j * step - radius, k * step - radius
                for m in range(3):
                    e1, e2, e3 = axes[parent, 0, m], axes[parent, 1, m], axes[parent, 2, m]
                    frames.axes[worst, 0, m] = (e1 + z * e2 - y * e3) / np.sqrt(1 + y * y + z * z)
                    frames.axes[worst, 1, m] = (e2 + x * e3 - z * e1) / np.sqrt(1 + z * z + x * x)
                    frames.axes[worst, 2, m] = (e3 + y * e1 - x * e2) / np.sqrt(1 + x * x + y * y)
                for child in range(first_child, first_child + N_CHILDREN):
                    if frames.score[child] > frames.score[worst]:
                        worst = child
