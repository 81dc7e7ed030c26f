"""Random stones as they leave a crusher, in the five classes of the paper.

A stone is a rounded polytope: the gauge of an ellipsoid and of random planes, combined as a p-norm
(the larger p, the sharper the edges), with a few shallow dents and with roughness on several scales.
"""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from scipy.spatial.distance import pdist

from pipeline.arrays import Directions, Floats, Values
from pipeline.synthesis.bodies import SPHERE_SUBDIVISIONS, Body, body_from_mesh


@dataclass(frozen=True, slots=True, kw_only=True)
class StoneForm:
    """The class of a stone; ranges are (low, high) of uniform distributions."""

    width_to_length: tuple[float, float]
    thickness_to_width: tuple[float, float]
    n_facets: int
    facet_distance: tuple[float, float]  # from the centre; 1 touches the ellipsoid
    sharpness: float  # p of the norm
    dent_depth: float  # of each dent, relative to the radius
    roughness: float  # rms of the coarsest octave, relative to the radius


STONE_FORMS = {
    "round": StoneForm(
        width_to_length=(0.85, 0.95),
        thickness_to_width=(0.82, 0.95),
        n_facets=8,
        facet_distance=(0.90, 0.99),
        sharpness=14.0,
        dent_depth=0.02,
        roughness=0.006,
    ),
    "irregular": StoneForm(
        width_to_length=(0.68, 0.85),
        thickness_to_width=(0.65, 0.85),
        n_facets=16,
        facet_distance=(0.75, 0.95),
        sharpness=25.0,
        dent_depth=0.05,
        roughness=0.016,
    ),
    "angular": StoneForm(
        width_to_length=(0.75, 0.92),
        thickness_to_width=(0.70, 0.90),
        n_facets=24,
        facet_distance=(0.68, 0.88),
        sharpness=110.0,
        dent_depth=0.03,
        roughness=0.012,
    ),
    "flaky": StoneForm(
        width_to_length=(0.70, 0.90),
        thickness_to_width=(0.30, 0.45),
        n_facets=18,
        facet_distance=(0.72, 0.92),
        sharpness=70.0,
        dent_depth=0.03,
        roughness=0.012,
    ),
    "elongated": StoneForm(
        width_to_length=(0.40, 0.52),
        thickness_to_width=(0.75, 0.95),
        n_facets=18,
        facet_distance=(0.72, 0.92),
        sharpness=70.0,
        dent_depth=0.03,
        roughness=0.012,
    ),
}

N_DENTS = 4
OCTAVES_PER_RADIUS = (1.2, 0.6, 0.3, 0.15)
"""Wavelengths of the roughness; the shortest is four edges of the mesh."""
WAVES_PER_OCTAVE = 10


def stone(form_name: str, size_mm: float, rng: np.random.Generator) -> Body:
    """Return a random stone of a class in `STONE_FORMS`, whose greatest diameter (max Feret) is `size_mm`."""
    form = STONE_FORMS[form_name]
    sphere = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS)
    directions = np.asarray(sphere.vertices)
    width = rng.uniform(*form.width_to_length)
    axes = np.array([1.0, width, width * rng.uniform(*form.thickness_to_width)])

    radii = polytope_radii(directions, form, rng)
    radii *= _dents(directions, form.dent_depth, rng)
    radii *= 1 + _roughness(directions * axes, form.roughness, rng)

    points = radii[:, None] * directions * axes
    points *= size_mm / greatest_distance(points)
    body = body_from_mesh(form_name, trimesh.Trimesh(points, sphere.faces, process=False))
    return replace(body, grey=rng.uniform(45, 80), contrast=rng.uniform(0.12, 0.25))


def greatest_distance(points: Floats) -> float:
    """Return the greatest distance between any two of points (N, 3) around the origin."""
    radii = np.linalg.norm(points, axis=1)
    at_least = np.linalg.norm(points - points[np.argmax(radii)], axis=1).max()
    return float(pdist(points[radii + radii.max() >= at_least]).max())


def random_size_mm(rng: np.random.Generator) -> float:
    """Return a random size between 5 and 40 mm, mostly between 8 and 30."""
    low, high = [(5.0, 8.0), (30.0, 40.0), (8.0, 30.0)][min(int(rng.integers(10)), 2)]
    return float(rng.uniform(low, high))


def polytope_radii(directions: Directions, form: StoneForm, rng: np.random.Generator) -> Values:
    normals = unit_vectors(form.n_facets, rng)
    distances = rng.uniform(*form.facet_distance, size=form.n_facets)
    gauges = np.maximum(directions @ normals.T, 0) / distances  # (V, n_facets)
    return np.asarray((1 + (gauges**form.sharpness).sum(axis=1)) ** (-1 / form.sharpness))


def _dents(directions: Directions, depth: float, rng: np.random.Generator) -> Values:
    centers = unit_vectors(N_DENTS, rng)
    widths = rng.uniform(0.25, 0.5, size=N_DENTS)  # rad
    return np.asarray(1 - depth * np.exp(-(1 - directions @ centers.T) / (widths**2 / 2)).sum(axis=1))


def _roughness(points: Floats, rms: float, rng: np.random.Generator) -> Values:
    total = np.zeros(len(points))
    for wavelength in OCTAVES_PER_RADIUS:
        amplitude = rms * (wavelength / OCTAVES_PER_RADIUS[0]) ** 0.9
        total += amplitude * wave_noise(points, wavelength, WAVES_PER_OCTAVE, rng)
    return total


def wave_noise(points: Floats, wavelength: float, n_waves: int, rng: np.random.Generator) -> Values:
    """Return smooth noise (N,) of zero mean and unit variance at points (N, 3): a sum of random plane waves."""
    waves = 2 * np.pi / wavelength * unit_vectors(n_waves, rng)
    phases = rng.uniform(0, 2 * np.pi, size=n_waves)
    return np.asarray(np.sqrt(2 / n_waves) * np.cos(points @ waves.T + phases).sum(axis=1))


def unit_vectors(count: int, rng: np.random.Generator) -> Directions:
    vectors = rng.normal(size=(count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
