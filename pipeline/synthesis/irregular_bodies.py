"""Bodies that are no rounded polytopes: concave, not star-shaped, or rough in another way than the stones.

Each is the level set of a field on a grid, so that any form can be made of simple ones: fields are negative
inside, the lesser of two is their union, the greater their common part. The mesh is the body, whatever the
grid: what is judged against it is judged against exactly what was photographed. No method is tuned on these.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from pipeline.carving import VisualHull, all_leaves
from pipeline.measuring.calipers import max_feret
from pipeline.measuring.convex import convex_body
from pipeline.meshing import mesh_hull
from pipeline.synthesis.bodies import Body, body_from_mesh

Array = NDArray[np.float64]
Field = Callable[[Array, np.random.Generator], Array]
"""Values (N,) at points (N, 3) within the cube from -1 to 1, about a distance to the surface."""

N_GRID = 80
"""Samples an edge of the cube: facets of 0.025 of its half edge."""
HURST = 0.8
"""Heights of a fracture surface grow with this power of the distance (Bouchaud, Lapasset and Planes 1990)."""
ROUGHNESS = 0.03
"""Rms of the noise, relative to the half edge of the cube."""


def irregular(form: str, size_mm: float, rng: np.random.Generator) -> Body:
    """A random body of a form in `IRREGULAR_FORMS`; its greatest diameter is `size_mm`."""
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


def _dented(points: Array, rng: np.random.Generator) -> Array:
    """An ellipsoid with bites taken out of it."""
    axes = rng.uniform(0.6, 0.9, size=3)
    field = _ellipsoid(points, axes)
    for direction in _directions(3, rng):
        bite, depth = rng.uniform([0.3, 0.1], [0.6, 0.25])
        reach = 1 / np.linalg.norm(direction / axes) - depth
        field = np.maximum(field, bite - np.linalg.norm(points - (reach + bite) * direction, axis=1))
    return field


def _tromino(points: Array, rng: np.random.Generator) -> Array:
    """An L of two bars at a right angle."""
    thick, long, short, deep = rng.uniform([0.22, 0.65, 0.4, 0.2], [0.32, 0.8, 0.65, 0.4])
    corner = np.array([-0.4, -0.4, 0.0])
    bars = [
        _box(points - corner - [long - thick, 0, 0], np.array([long, thick, deep])),
        _box(points - corner - [0, short - thick, 0], np.array([thick, short, deep])),
    ]
    return np.asarray(np.minimum(*bars))


def _horseshoe(points: Array, rng: np.random.Generator) -> Array:
    """Two bars on a third; no point sees all of its surface."""
    thick, long, wide, deep = rng.uniform([0.15, 0.45, 0.5, 0.2], [0.25, 0.75, 0.7, 0.4])
    bars = [_box(points - [0, (wide - thick) * side, 0], np.array([long, thick, deep])) for side in (-1, 1)]
    return np.asarray(
        np.min([*bars, _box(points - [thick - long, 0, 0], np.array([thick, wide, deep]))], axis=0)
    )


def _two_lobed(points: Array, rng: np.random.Generator) -> Array:
    """Two stones grown together, with a rounded neck."""
    apart = rng.uniform(0.22, 0.33)  # always less than both reach
    left = _ellipsoid(points - [apart, 0, 0], rng.uniform(0.38, 0.55, size=3))
    right = _ellipsoid(points - [-apart, 0, 0], rng.uniform(0.3, 0.5, size=3))
    neck = rng.uniform(0.03, 0.1)
    return np.asarray(-neck * np.logaddexp(-left / neck, -right / neck))


def _rough(points: Array, rng: np.random.Generator) -> Array:
    """An ellipsoid whose surface is moved by noise that is the same on all scales, down to the grid."""
    frequency = np.sqrt(sum(f**2 for f in np.meshgrid(*[np.fft.fftfreq(N_GRID)] * 3, indexing="ij")))
    frequency[0, 0, 0] = np.inf
    # of noise in a volume that is self-affine with H the power falls with the frequency to -(2 H + 3)
    spectrum = np.fft.fftn(rng.normal(size=(N_GRID,) * 3)) * frequency ** -(HURST + 1.5)
    noise = np.fft.ifftn(spectrum * (frequency > 2 / N_GRID)).real.reshape(-1)
    return _ellipsoid(points, rng.uniform(0.5, 0.8, size=3)) + ROUGHNESS / noise.std() * noise


def _splinter(points: Array, rng: np.random.Generator) -> Array:
    """A polyhedron with sharp edges: what random planes leave of an ellipsoid."""
    axes = rng.uniform([0.7, 0.4, 0.25], [0.85, 0.65, 0.45])
    scaled = points / axes
    planes = [
        scaled @ normal - distance
        for normal, distance in zip(_directions(14, rng), rng.uniform(0.55, 0.9, size=14), strict=True)
    ]
    return np.asarray(np.max([_ellipsoid(points, axes), *(axes.min() * plane for plane in planes)], axis=0))


IRREGULAR_FORMS: dict[str, Field] = {
    "dented": _dented,
    "tromino": _tromino,
    "horseshoe": _horseshoe,
    "two-lobed": _two_lobed,
    "rough": _rough,
    "splinter": _splinter,
}

"""Each is described by its function."""


def _ellipsoid(points: Array, axes: Array) -> Array:
    return np.asarray((np.linalg.norm(points / axes, axis=1) - 1) * axes.min())


def _box(points: Array, half: Array) -> Array:
    return np.asarray((np.abs(points) - half).max(axis=1))


def _directions(count: int, rng: np.random.Generator) -> Array:
    vectors = rng.normal(size=(count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
