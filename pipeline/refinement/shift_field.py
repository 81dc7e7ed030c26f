"""Shifts of nodes, and what they are between the nodes: at those of the next pass, at vertices of the mesh."""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Directions, Floats, PointsMM, Values
from pipeline.refinement.nodes import Nodes, interpolated, smoothed
from pipeline.uncertainty import PixelSupport

SPREAD = 0.6
"""Standard deviation of the interpolation between nodes, in their spacing."""
OUTWARD_MM = 0.08
"""Shift outward that is taken for chance: silhouettes say where faces are, and each extreme finds what stands out."""
INWARD_MM = 0.01
"""Shift inward of which half is taken for chance, as there is no hull to end it.

Without it volumes of small stones are 0.1 % smaller; with twice of it those of rough ones 0.1 % larger.
"""
RELIEF_MM, RELIEF_ROUNDS = 0.02, 40
"""Shifts outward (rms of a wide neighbourhood) where only half of that is, and the smoothing over neighbours.

On an even face chance puts out single nodes; on a rough one what stands out is found as well as what lies deep.
"""
MIN_ALONG = 0.5
"""Least cosine between the normal and the way to the hull's vertex with which a shift outward goes there in full."""
LEAST_WEIGHT = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Field:
    """Shifts of nodes, inward."""

    nodes: Nodes
    shifts_mm: Values  # (K,)
    weights: Values  # (K,) of the pixels and of the silhouettes
    sure: Values  # (K,) of the pixels
    peaked: Values  # (K,) of the pixels where patches deeper and shallower are less alike
    support: PixelSupport  # of the nodes but those at sharp edges, which silhouettes see


def carried_over(field: Field, nodes: Nodes) -> tuple[Values, Values]:
    """Return the shifts of the pass before at other nodes (K,), and the weights of its peaks."""
    values = _spread(field, np.column_stack([field.shifts_mm, field.peaked]), nodes.points_mm, nodes.normals)
    return values[:, 0], values[:, 1]


def vertex_shifts(field: Field, vertices_mm: PointsMM, normals: Directions, room_mm: PointsMM) -> PointsMM:
    """Return the shifts (V, 3) of vertices: inward along the nodes' normals, or outward as far as to the hull's vertex.

    `room_mm` (V, 3) leads from each vertex to the hull's.
    """
    shifts_mm = _unsmoothed(field)
    relief_mm2 = smoothed(field.nodes, np.minimum(shifts_mm, 0) ** 2, RELIEF_ROUNDS)
    chance_mm = OUTWARD_MM / (1 + relief_mm2**2 / RELIEF_MM**4)
    values = np.column_stack([shifts_mm, chance_mm, field.nodes.normals])
    found = _spread(field, values, vertices_mm, normals)
    inward_mm, chance_mm, outward = found[:, 0], found[:, 1], found[:, 2:]
    outward /= np.maximum(np.linalg.norm(outward, axis=1), 1e-12)[:, None]
    lengths_mm = np.linalg.norm(room_mm, axis=1)
    along_mm = np.maximum(np.einsum("vk,vk->v", room_mm, outward), MIN_ALONG * lengths_mm)
    share = np.clip((-inward_mm - chance_mm) / np.maximum(along_mm, 1e-12), 0, 1)
    inward_mm = np.maximum(inward_mm, 0.0)
    inward_mm *= inward_mm**2 / (inward_mm**2 + INWARD_MM**2)
    return np.asarray(share[:, None] * room_mm - inward_mm[:, None] * outward)


def _unsmoothed(field: Field) -> Values:
    """Return shifts (K,) of which, once they are spread over the surface, more is left of what was found.

    What spreading takes from each node is added to it beforehand (twicing, Tukey 1977), as far as it has evidence:
    where there is none, a hump is more likely an error than a shape.
    """
    spread_mm = _spread(field, field.shifts_mm[:, None], field.nodes.points_mm, field.nodes.normals)[:, 0]
    return np.asarray(field.shifts_mm + np.minimum(field.sure, 1) * (field.shifts_mm - spread_mm))


def _spread(field: Field, values: Floats, points_mm: PointsMM, normals: Directions) -> Floats:
    """Return values of the nodes (K, C) at points of the surface (N, 3)."""
    weights = np.maximum(field.weights, LEAST_WEIGHT)
    return interpolated(points_mm, normals, field.nodes, values, weights, SPREAD * field.nodes.spacing_mm)
