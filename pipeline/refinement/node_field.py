"""Depth and confidence of every node, from the scores of one pass."""

from typing import Annotated

import numpy as np

from pipeline.arrays import Directions, Flags, Floats, Indices32, PointsMM, Singles, Values
from pipeline.compiled import compiled, compiled_within
from pipeline.refinement.cells import nearest_within
from pipeline.refinement.nodes import MAX_NEIGHBOURS, Nodes, smoothed
from pipeline.refinement.passes import ALIKE, DOUBTFUL, EVIDENCE, PEAKED, RIDGE, TOUCH_MM

MAX_SLOPE = 2.5
CHANCE_MM = (0.017, 0.068)
"""Mean size of shifts that surfaces have by chance, with full confidence and with none."""
CHANCE_ROUNDS = 40
"""Smoothings for that mean: of relief there is more around, a hump on an even face stands alone."""
SPIKE_MM = 0.03
"""Distance of a node from the median of its neighbours that is chance where they agree."""
SPIKE_SPREADS = 2.0
"""Further distance that is allowed, in mean distances of the neighbours from their median."""


def tangent_axes(normals: Directions) -> Annotated[Floats, "(K, 2, 3)"]:
    """Return two unit vectors across each normal (K, 3), and to each other."""
    axes = np.empty((len(normals), 2, 3))
    _span(normals, axes)
    return axes


@compiled
def _span(normals: Directions, axes: Annotated[Floats, "(K, 2, 3)"]) -> None:
    for i in range(len(normals)):
        first, second = _axes_of(normals[i, 0], normals[i, 1], normals[i, 2])
        for k in range(3):
            axes[i, 0, k], axes[i, 1, k] = first[k], second[k]


@compiled_within
def _axes_of(x: float, y: float, z: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return two unit vectors across a normal, the first of them across an axis of the world as well."""
    a, b, c = _cross(x, y, z, 1.0, 0.0, 0.0) if abs(x) < 0.7 else _cross(x, y, z, 0.0, 1.0, 0.0)
    length = np.sqrt(a * a + b * b + c * c)
    a, b, c = a / length, b / length, c / length
    return (a, b, c), _cross(x, y, z, a, b, c)


@compiled_within
def _cross(x: float, y: float, z: float, a: float, b: float, c: float) -> tuple[float, float, float]:
    return y * c - z * b, z * a - x * c, x * b - y * a


def facing(points_mm: PointsMM, nodes: Nodes) -> Directions:
    """Return the normals (K, 3) of the shifted surface: of planes through each node by its neighbours."""
    ridge_mm2 = 0.05 * nodes.spacing_mm**2  # of the regression: a node with few neighbours keeps its normal
    turned = np.empty((len(points_mm), 3))
    _fit_planes(points_mm, nodes.normals, nodes.neighbours, ridge_mm2, turned)
    return turned


@compiled
def _fit_planes(
    points_mm: PointsMM,
    normals: Directions,
    neighbours: Indices32,
    ridge_mm2: float,
    turned: Directions,
) -> None:
    """Fill in the normal of each node's plane: least squares say how steeply its neighbours rise."""
    for i in range(len(points_mm)):
        first, second = _axes_of(normals[i, 0], normals[i, 1], normals[i, 2])
        ss, st, tt, sh, th = ridge_mm2, 0.0, ridge_mm2, 0.0, 0.0
        for k in range(MAX_NEIGHBOURS):
            j = neighbours[i, k]
            if j < 0:
                break
            s = t = h = 0.0
            for axis in range(3):
                offset_mm = points_mm[j, axis] - points_mm[i, axis]
                s += offset_mm * first[axis]
                t += offset_mm * second[axis]
                h += offset_mm * normals[i, axis]
            ss, st, tt, sh, th = ss + s * s, st + s * t, tt + t * t, sh + s * h, th + t * h
        along_first = min(max((tt * sh - st * th) / (ss * tt - st * st), -MAX_SLOPE), MAX_SLOPE)
        along_second = min(max((ss * th - st * sh) / (ss * tt - st * st), -MAX_SLOPE), MAX_SLOPE)
        length2 = 0.0
        for axis in range(3):
            turned[i, axis] = normals[i, axis] - along_first * first[axis] - along_second * second[axis]
            length2 += turned[i, axis] * turned[i, axis]
        for axis in range(3):
            turned[i, axis] /= np.sqrt(length2)


def mean_curvatures(nodes: Nodes) -> Values:
    """Return the mean curvature (1/mm) of the surface around each node (K,), positive where it is convex."""
    curvatures = np.empty(len(nodes.points_mm))
    _fit_curvatures(nodes.points_mm, nodes.normals, nodes.neighbours, curvatures)
    return curvatures


@compiled
def _fit_curvatures(
    points_mm: PointsMM, normals: Directions, neighbours: Indices32, curvatures: Values
) -> None:
    """Fill in the curvature of the sphere through each node that lies nearest to its neighbours."""
    for i in range(len(points_mm)):
        fall_mm, squares_mm2 = 0.0, 1e-9
        for k in range(MAX_NEIGHBOURS):
            j = neighbours[i, k]
            if j < 0:
                continue
            for axis in range(3):
                offset_mm = points_mm[j, axis] - points_mm[i, axis]
                fall_mm -= offset_mm * normals[i, axis]
                squares_mm2 += offset_mm * offset_mm
        curvatures[i] = 2 * fall_mm / squares_mm2


def flat_gate(nodes: Nodes, touches: Values) -> Values:
    """Return 1 for nodes (K,) where patches lie on one face, 0 at sharp convex edges of the body, by their own normals.

    Tangent rays touch an edge of the body, `touches` (K,), and none those of the estimate that span a dent.
    """
    closed = np.empty(len(touches))
    _close(nodes.points_mm, nodes.normals, nodes.neighbours, nodes.at_edge, touches, closed)
    has = nodes.neighbours >= 0
    # their patches reach over it
    gate = 1 - np.maximum(closed, np.where(has, closed[nodes.neighbours], 0.0).max(axis=1))
    # a node at a corner, all of whose neighbours are at edges, is on no face either
    return np.minimum(gate, np.where(has, gate[nodes.neighbours], 0.0).max(axis=1))


@compiled
def _close(
    points_mm: PointsMM,
    normals: Directions,
    neighbours: Indices32,
    at_edge: Flags,
    touches: Values,
    closed: Values,
) -> None:
    """Fill in how sharp the body's convex edge is at each node: 0 on a face, 1 where all patches mislead."""
    for i in range(len(points_mm)):
        n, touched, rise_mm = 1, touches[i], 0.0
        x, y, z = normals[i, 0], normals[i, 1], normals[i, 2]
        for k in range(MAX_NEIGHBOURS):
            j = neighbours[i, k]
            if j < 0:
                continue
            n += 1
            touched = max(touched, touches[j])
            x, y, z = x + normals[j, 0], y + normals[j, 1], z + normals[j, 2]
            for axis in range(3):
                rise_mm += (points_mm[j, axis] - points_mm[i, axis]) * normals[i, axis]
        sharpness = 1 - np.sqrt(x * x + y * y + z * z) / n
        edge = min(max((sharpness - RIDGE[0]) / (RIDGE[1] - RIDGE[0]), 0.0), 1.0)
        closed[i] = 1.0 if at_edge[i] else (edge * touched**0.25 if rise_mm < 0 else 0.0)


def touch_weights(points_mm: PointsMM, touches_mm: PointsMM) -> Values:
    """Return 1 for points (K,) where a tangent ray touches, less beside it, 0 far from all."""
    distances_mm = nearest_within(points_mm, touches_mm, 3 * TOUCH_MM)
    return np.asarray(np.exp(-((distances_mm / TOUCH_MM) ** 2)))


def depths_of(
    beliefs: Singles, scores: Singles, depths_mm: Values, nodes: Nodes, gate: Values
) -> tuple[Values, Values, Flags]:
    """Return the most believed depth of each node (K,), its weight, and whether it is a peak.

    It lies between the steps, by a parabola. The weight is 0 where the neighbourhood has no evidence. The first and the
    last depth are no peaks: the surface may lie beyond.
    """
    rows = np.arange(len(beliefs))
    best = beliefs.argmin(axis=1)
    inner = np.clip(best, 1, len(depths_mm) - 2)
    before, at, after = (beliefs[rows, inner + step].astype(float) for step in (-1, 0, 1))
    curvature = np.maximum(before - 2 * at + after, 1e-6)
    part = np.where(best == inner, np.clip(0.5 * (before - after) / curvature, -0.5, 0.5), 0.0)
    sure = np.clip((scores[rows, best] - ALIKE[0]) / (ALIKE[1] - ALIKE[0]), 0, 1)
    sure = gate * sure * np.clip(curvature / PEAKED, 0.05, 1)
    region = np.clip(smoothed(nodes, sure, 2) / EVIDENCE - 1, 0, 1)
    found_mm = depths_mm[best] + part * (depths_mm[1] - depths_mm[0])
    return found_mm, np.maximum(sure, DOUBTFUL) * region, best == inner


def without_spikes(shifts_mm: Values, nodes: Nodes, most_mm: float) -> Values:
    """Return shifts (K,) of which none is much further from the median of its neighbours than they are, nor `most_mm`.

    A patch that reaches over an edge, or takes one of many equal crystals for another, is wrong alone.
    """
    has = nodes.neighbours >= 0
    n = np.maximum(has.sum(axis=1), 1)
    around_mm = np.where(has, shifts_mm[nodes.neighbours], np.inf)
    around_mm[~has.any(axis=1)] = 0.0
    ordered_mm, rows = np.sort(around_mm, axis=1), np.arange(len(n))
    median_mm = (ordered_mm[rows, (n - 1) // 2] + ordered_mm[rows, n // 2]) / 2
    spreads_mm = np.abs(around_mm - median_mm[:, None]).sum(axis=1, where=has) / n
    limits_mm = np.minimum(most_mm, SPIKE_MM + SPIKE_SPREADS * spreads_mm)
    return np.asarray(np.clip(shifts_mm, median_mm - limits_mm, median_mm + limits_mm))


def beyond_chance(shifts_mm: Values, sure: Values, nodes: Nodes) -> Values:
    """Return shifts (K,) that vanish where those of a neighbourhood are no larger than chance has them.

    Twice as large, they stay.
    """
    chance_mm = CHANCE_MM[1] + np.minimum(sure, 1) * (CHANCE_MM[0] - CHANCE_MM[1])
    sizes_mm = smoothed(nodes, np.abs(shifts_mm), CHANCE_ROUNDS)
    return np.asarray(shifts_mm * sizes_mm**4 / (sizes_mm**4 + chance_mm**4))
