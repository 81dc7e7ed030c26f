"""Stones as scans of crushed rock show them: broken faces, dents of 1 to 3 mm, sharp ridges, roughness down to 0.3 mm.

They are star-shaped around their middle. The dents lie where no silhouette shows them.
"""

import numpy as np
import trimesh

from pipeline.arrays import Floats, PointsMM, Values
from pipeline.synthesis.bodies import Body, body_from_mesh
from pipeline.synthesis.stones import (
    STONE_FORMS,
    StoneForm,
    greatest_distance,
    polytope_radii,
    unit_vectors,
    wave_noise,
)

SUBDIVISIONS = 6  # 81 920 faces; edges of 0.1 mm at 9 mm, of 0.3 mm at 31 mm
SIZES_MM = (9.0, 31.0)
N_DENTS = (3, 6)
DENT_DEPTHS_MM = (1.0, 3.0)
MAX_DEPTH = 0.12
"""Depth of a dent relative to the stone's size, at most: a small stone has no deep ones."""
DENT_WIDTH = (1.0, 2.2)
"""Radius of a dent relative to its depth: its flanks are steep."""
RIDGE_MM, RIDGE_HEIGHT_MM = 5.0, 0.25
ROUGHNESS_MM = ((2.0, 0.05), (1.0, 0.03), (0.5, 0.015))
"""Wavelength and standard deviation of the octaves of a broken face."""
N_WAVES = 16


def scanned_stone(size_mm: float, rng: np.random.Generator, form: StoneForm | None = None) -> Body:
    """Return a random stone whose greatest diameter (max Feret) is `size_mm`."""
    form = form or STONE_FORMS["irregular"]
    sphere = trimesh.creation.icosphere(subdivisions=SUBDIVISIONS)
    directions = np.asarray(sphere.vertices)
    width = rng.uniform(*form.width_to_length)
    axes = np.array([1.0, width, width * rng.uniform(*form.thickness_to_width)])
    points_mm = polytope_radii(directions, form, rng)[:, None] * directions * axes
    points_mm *= size_mm / greatest_distance(points_mm)
    inward_mm = dents_mm(points_mm, size_mm, rng) + _relief_mm(points_mm, rng)
    radii_mm = np.linalg.norm(points_mm, axis=1)
    points_mm *= ((radii_mm - inward_mm) / radii_mm)[:, None]
    points_mm *= size_mm / greatest_distance(points_mm)
    return body_from_mesh("scanned", trimesh.Trimesh(points_mm, sphere.faces, process=False))


def dents_mm(points_mm: PointsMM, size_mm: float, rng: np.random.Generator) -> Values:
    """Return by how far dents push the points (N, 3) of a surface inward; where they overlap the deepest counts."""
    count = int(rng.integers(*N_DENTS, endpoint=True))
    result = np.zeros(len(points_mm))
    for direction in unit_vectors(count, rng):
        depth_mm = min(rng.uniform(*DENT_DEPTHS_MM), MAX_DEPTH * size_mm)
        center_mm = points_mm[np.argmax(points_mm @ direction / np.linalg.norm(points_mm, axis=1))]
        radius_mm = depth_mm * rng.uniform(*DENT_WIDTH)
        # not quite round, as conchoidal fractures are
        stretch = 1 + 0.25 * wave_noise(points_mm, 2 * radius_mm, N_WAVES, rng)
        away = np.linalg.norm(points_mm - center_mm, axis=1) / (radius_mm * np.clip(stretch, 0.5, 1.5))
        result = np.maximum(result, depth_mm * _bowl(away))
    return result


def _bowl(away: Values) -> Values:
    """Return the depth of a dent of depth and radius 1, whose rim is sharp and whose bottom is round."""
    return np.asarray(np.sqrt(np.clip(1 - away**2, 0, 1)))


def _relief_mm(points_mm: Floats, rng: np.random.Generator) -> Values:
    """Return the depth below the ridges, which are sharp, and the roughness."""
    ridges = np.abs(wave_noise(points_mm, RIDGE_MM, N_WAVES, rng))
    roughness = sum(
        sd_mm * wave_noise(points_mm, wavelength, N_WAVES, rng) for wavelength, sd_mm in ROUGHNESS_MM
    )
    return np.asarray(RIDGE_HEIGHT_MM * ridges + roughness)
