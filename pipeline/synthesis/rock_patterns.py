"""The grey of rock over its volume, of which a surface shows a section: crystals of granite, bands of gneiss.

Sizes and shares are those of common rocks (Le Maitre 2002; Fettes and Desmons 2007), reflectances are guesses.
"""

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from pipeline.arrays import PointsMM, Values
from pipeline.synthesis.bodies import Body, SurfaceKind
from pipeline.synthesis.rock_textures import SPECTRUM_TRUE, rock_texture
from pipeline.synthesis.stones import wave_noise

Pattern = Callable[[PointsMM], Values]
"""Values (N,) at points (N, 3) of the body: of about zero mean and unit variance over its volume."""

MINERALS = ((0.15, 0.35), (0.30, 0.90), (0.55, 1.23))
"""Share and relative reflectance of biotite, quartz and feldspar."""
CRYSTAL_MM = 1.0
"""Cube root of the mean volume of a crystal; most are 0.5 to 2 mm wide."""
BOUNDARY_MM = 0.1
"""Width over which one crystal passes into the next: two pixels, so that all views sample the same boundary."""
FLATNESS = 3.0
"""How much wider a crystal of gneiss is along the bands than across them."""
BANDS_MM = (2.0, 3.1, 5.3)
"""Wavelengths of the bands."""
FOLD_MM, FOLD_WAVELENGTH_MM = 0.8, 12.0
BAND_SHARE = 0.8
"""Standard deviation of the bands; crystals make up for the rest."""


def rock_pattern(body: Body, rng: np.random.Generator) -> Pattern | None:
    """Return the pattern of the body's rock; `None` of a surface that does not show one."""
    match body.surface:
        case SurfaceKind.GRANITE:
            return _crystals(np.full(3, body.radius_mm), rng)
        case SurfaceKind.BANDED:
            return _bands(body.radius_mm, rng)
        case surface if surface in SPECTRUM_TRUE:
            return rock_texture(surface, body.radius_mm, rng)
        case _:
            return None


def _crystals(half_mm: Values, rng: np.random.Generator) -> Pattern:
    """Return the pattern of crystals, the Voronoi cells of random points in a box of half edges (3,)."""
    shares, reflectances = np.array(MINERALS).T
    mean = shares @ reflectances
    levels = (reflectances - mean) / np.sqrt(shares @ (reflectances - mean) ** 2)
    count = 2 + round(np.prod(2 * half_mm) / CRYSTAL_MM**3)
    seeds = cKDTree(rng.uniform(-half_mm, half_mm, size=(count, 3)))
    grey = rng.choice(levels, size=count, p=shares)

    def pattern(points_mm: PointsMM) -> Values:
        apart_mm, nearest = seeds.query(points_mm, k=2)
        own = np.clip(0.5 + (apart_mm[:, 1] - apart_mm[:, 0]) / BOUNDARY_MM, 0, 1)
        return np.asarray(own * grey[nearest[:, 0]] + (1 - own) * grey[nearest[:, 1]])

    return pattern


def _bands(radius_mm: float, rng: np.random.Generator) -> Pattern:
    """Return the pattern of folded bands, with flat crystals along them."""
    axes = Rotation.random(rng=rng).as_matrix()
    flattened = FLATNESS ** np.array([-1 / 3, -1 / 3, 2 / 3])
    crystals = _crystals((radius_mm + FOLD_MM) * flattened, rng)
    phases = rng.uniform(0, 2 * np.pi, size=len(BANDS_MM))
    folds_seed = int(rng.integers(1 << 31))

    def pattern(points_mm: PointsMM) -> Values:
        points_mm = points_mm @ axes
        # the same folds at every call
        folds = wave_noise(points_mm, FOLD_WAVELENGTH_MM, 4, np.random.default_rng(folds_seed))
        points_mm[:, 2] += FOLD_MM * folds
        turns = 2 * np.pi * points_mm[:, 2:] / BANDS_MM + phases
        bands = np.sqrt(2 / len(BANDS_MM)) * np.sin(turns).sum(axis=1)
        return BAND_SHARE * bands + np.sqrt(1 - BAND_SHARE**2) * crystals(points_mm * flattened)

    return pattern
