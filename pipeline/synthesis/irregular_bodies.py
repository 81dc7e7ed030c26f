"""Bodies that are no rounded polytopes: concave, not star-shaped, or rough in another way than the stones.

Each is the zero level set of an implicit function on a grid, composed of simple ones: they are negative inside,
the minimum of two is their union, the maximum their intersection. The mesh is the body, whatever the grid:
measurements are judged against exactly what was photographed. No method is tuned on these bodies.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import trimesh

from pipeline.arrays import Directions, Floats, Values, Vector
from pipeline.carving import VisualHull, all_leaves
from pipeline.measuring.calipers import max_feret
from pipeline.measuring.convex import convex_body
from pipeline.meshing import mesh_hull
from pipeline.synthesis.bodies import Body, body_from_mesh

ImplicitForm = Callable[[Floats, np.random.Generator], Values]
"""Values (N,) at points (N, 3) in the cube from -1 to 1: approximate signed distances to the surface."""

N_GRID = 80
"""Samples along an edge of the cube: facets of 0.025 of its half edge."""
HURST = 0.8
"""Heights of a fracture surface grow with this power of the distance (Bouchaud, Lapasset and Planes 1990)."""
ROUGHNESS = 0.03
"""Rms of the noise, relative to the half edge of the cube."""


def irregular_body(form: str, size_mm: float, rng: np.random.Generator) -> Body:
    """Return a random body of a form in `IRREGULAR_FORMS`, whose greatest diameter (max Feret) is `size_mm`."""
    axis = np.linspace(-1, 1, N_GRID)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    field = -IRREGULAR_FORMS[form](points, rng).reshape((N_GRID,) * 3).astype(np.float32)
    field[field == 0] = 1e-6  # a sample on the surface would make triangles without area
    if any((field.take(end, along) > 0).any() for along in range(3) for end in (0, -1)):
        raise ValueError(f"a {form} body leaves its grid")
    surface = mesh_hull(
        VisualHull(
            field=field,
            leaves=all_leaves(field.shape),
            level=0.0,
            origin_mm=np.full(3, -1.0),
            pitch_mm=axis[1] - axis[0],
            touches_border=False,
        )
    )
    if surface is None:
        raise ValueError(f"a {form} body is empty")
    vertices = surface.vertices_mm
    vertices = vertices * (size_mm / np.linalg.norm(max_feret(convex_body(vertices))))
    body = body_from_mesh(form, trimesh.Trimesh(vertices, surface.faces, process=False))
    return replace(body, grey=rng.uniform(45, 80), contrast=rng.uniform(0.12, 0.25))


def _dented(points: Floats, rng: np.random.Generator) -> Values:
    """Return an ellipsoid with spherical dents."""
    axes = rng.uniform(0.6, 0.9, size=3)
    field = _ellipsoid(points, axes)
    for direction in _directions(3, rng):
        bite, depth = rng.uniform([0.3, 0.1], [0.6, 0.25])
        reach = 1 / np.linalg.norm(direction / axes) - depth
        field = np.maximum(field, bite - np.linalg.norm(points - (reach + bite) * direction, axis=1))
    return field


def _tromino(points: Floats, rng: np.random.Generator) -> Values:
    """Return an L of two bars at a right angle."""
    thick, long, short, deep = rng.uniform([0.22, 0.65, 0.4, 0.2], [0.32, 0.8, 0.65, 0.4])
    corner = np.array([-0.4, -0.4, 0.0])
    bars = [
        _box(points - corner - [long - thick, 0, 0], np.array([long, thick, deep])),
        _box(points - corner - [0, short - thick, 0], np.array([thick, short, deep])),
    ]
    return np.asarray(np.minimum(*bars))


def _horseshoe(points: Floats, rng: np.random.Generator) -> Values:
    """Return a U of two bars on a third; no point sees all of its surface."""
    thick, long, wide, deep = rng.uniform([0.15, 0.45, 0.5, 0.2], [0.25, 0.75, 0.7, 0.4])
    bars = [_box(points - [0, (wide - thick) * side, 0], np.array([long, thick, deep])) for side in (-1, 1)]
    return np.asarray(
        np.min([*bars, _box(points - [thick - long, 0, 0], np.array([thick, wide, deep]))], axis=0)
    )


def _two_lobed(points: Floats, rng: np.random.Generator) -> Values:
    """Return two overlapping ellipsoids with a rounded neck."""
    apart = rng.uniform(0.22, 0.33)  # small enough that they overlap
    left = _ellipsoid(points - [apart, 0, 0], rng.uniform(0.38, 0.55, size=3))
    right = _ellipsoid(points - [-apart, 0, 0], rng.uniform(0.3, 0.5, size=3))
    neck = rng.uniform(0.03, 0.1)
    return np.asarray(-neck * np.logaddexp(-left / neck, -right / neck))


def _rough(points: Floats, rng: np.random.Generator) -> Values:
    """Return an ellipsoid whose surface is displaced by self-affine noise, down to the scale of the grid."""
    frequency = np.sqrt(sum(f**2 for f in np.meshgrid(*[np.fft.fftfreq(N_GRID)] * 3, indexing="ij")))
    frequency[0, 0, 0] = np.inf
    # the power of self-affine noise of Hurst exponent H in a volume falls as the frequency to -(2 H + 3)
    spectrum = np.fft.fftn(rng.normal(size=(N_GRID,) * 3)) * frequency ** -(HURST + 1.5)
    noise = np.fft.ifftn(spectrum * (frequency > 2 / N_GRID)).real.reshape(-1)
    return _ellipsoid(points, rng.uniform(0.5, 0.8, size=3)) + ROUGHNESS / noise.std() * noise


def _splinter(points: Floats, rng: np.random.Generator) -> Values:
    """Return a polyhedron with sharp edges: an ellipsoid cut by random planes."""
    axes = rng.uniform([0.7, 0.4, 0.25], [0.85, 0.65, 0.45])
    scaled = points / axes
    planes = [
        scaled @ normal - distance
        for normal, distance in zip(_directions(14, rng), rng.uniform(0.55, 0.9, size=14), strict=True)
    ]
    return np.asarray(np.max([_ellipsoid(points, axes), *(axes.min() * plane for plane in planes)], axis=0))


IRREGULAR_FORMS: dict[str, ImplicitForm] = {
    "dented": _dented,
    "tromino": _tromino,
    "horseshoe": _horseshoe,
    "two-lobed": _two_lobed,
    "rough": _rough,
    "splinter": _splinter,
}


def _ellipsoid(points: Floats, axes: Vector) -> Values:
    return np.asarray((np.linalg.norm(points / axes, axis=1) - 1) * axes.min())


def _box(points: Floats, half: Vector) -> Values:
    return np.asarray((np.abs(points) - half).max(axis=1))


def _directions(count: int, rng: np.random.Generator) -> Directions:
    vectors = rng.normal(size=(count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
