"""Greys of rock as photographs show them: random fields whose amplitude falls as 1/f, shaped into minerals and bands.

Images of natural surfaces have a power that falls as 1/f^2 (Ruderman 1994); a section of a solid field has it where
the field's own falls as 1/f^3. Grains are what the field's finest part, 0.1 to 1 mm, makes of that: details of all
sizes that the pixels still resolve, unlike the crystals of one size of `rock_patterns.py`. Reflectances are guesses.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfftn
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from pipeline.arrays import Floats, PointsMM, Values
from pipeline.synthesis.bodies import Body, SurfaceKind

Pattern = Callable[[PointsMM], Values]
"""Values (N,) at points (N, 3) of the body."""

GRAIN_MM = (0.1, 1.0)
"""Wavelengths of grains: from two pixels on."""
FINE_SAMPLES, FINE_STEP_MM = 128, 0.05
COARSE_SAMPLES, COARSE_STEP_MM = 64, 0.4
"""Samples along an edge of the two cells of noise that repeat, and their distance: 6.4 and 25.6 mm."""
SPLIT_MM = 3.2
"""Wavelength that divides the two: half of the fine cell's edge."""
SLOPE = -3.0
"""Exponent of the power of noise in a volume; a section has one of -2, its amplitude falls as 1/f."""
MINERALS = ((0.18, -1.6), (0.30, -0.2), (0.52, 0.67))
"""Share and level of dark mica, quartz and feldspar."""
BANDS_MM = (0.7, 9.0)
FLATNESS = 3.0
"""How much longer grains of gneiss are along the bands than across them."""
VEIN_MM, VEIN_SPACING_MM = 0.5, 9.0
PEBBLES_MM = 3.5
"""Cube root of the mean volume of a pebble."""
FRAGMENTS = ((0.6, -0.8), (0.4, 1.2))
"""Share and level of the dark and the pale fragments of a breccia."""
CEMENT_MM = 0.5
"""Width of the matrix between pebbles."""
BORDER_MM = 0.4
"""Width of the border between a black and a pale half."""
N_STANDARDIZED = 20_000


@dataclass(frozen=True, slots=True, kw_only=True)
class RockLook:
    """Grey levels of a kind of rock before a wall of 185; ranges are (low, high) of uniform distributions."""

    grey: tuple[float, float]
    contrast: tuple[float, float]  # relative standard deviation


ROCK_LOOKS: Mapping[SurfaceKind, RockLook] = {
    SurfaceKind.GRAINED: RockLook(grey=(75, 105), contrast=(0.25, 0.35)),
    SurfaceKind.GNEISS: RockLook(grey=(75, 105), contrast=(0.25, 0.35)),
    SurfaceKind.VEINED: RockLook(grey=(40, 60), contrast=(0.5, 0.7)),
    SurfaceKind.CONGLOMERATE: RockLook(grey=(75, 100), contrast=(0.25, 0.35)),
    SurfaceKind.BRECCIA: RockLook(grey=(66, 74), contrast=(0.32, 0.36)),
    SurfaceKind.LIMESTONE: RockLook(grey=(145, 165), contrast=(0.05, 0.09)),
    SurfaceKind.BASALT: RockLook(grey=(10, 15), contrast=(0.12, 0.18)),
    SurfaceKind.HALVES: RockLook(grey=(65, 80), contrast=(0.75, 0.85)),
    SurfaceKind.DUSTY: RockLook(grey=(85, 105), contrast=(0.25, 0.35)),
}
SPECTRUM_TRUE = frozenset(ROCK_LOOKS)
"""Surfaces whose textures are those of this module."""


def rock_look(body: Body, surface: SurfaceKind, rng: np.random.Generator, gloss: float = 0.0) -> Body:
    """Return the body with a surface of `ROCK_LOOKS`."""
    look = ROCK_LOOKS[surface]
    grey, contrast = rng.uniform(*look.grey), rng.uniform(*look.contrast)
    return replace(body, surface=surface, grey=grey, contrast=contrast, gloss=gloss)


def rock_texture(surface: SurfaceKind, radius_mm: float, rng: np.random.Generator) -> Pattern:
    """Return the texture of a body of this radius, of zero mean and unit variance over its volume."""
    pattern = _TEXTURES[surface](SpectralNoise(rng), rng)
    points_mm = rng.uniform(-radius_mm, radius_mm, size=(N_STANDARDIZED, 3))
    greys = pattern(points_mm[np.linalg.norm(points_mm, axis=1) < radius_mm])
    mean, sd = greys.mean(), greys.std()
    return lambda points_mm: (pattern(points_mm) - mean) / sd


class SpectralNoise:
    """Noise in space whose power falls as a power of the frequency, between wavelengths of 0.1 and 25.6 mm."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._fine = _cell(FINE_SAMPLES, FINE_STEP_MM, GRAIN_MM[0], SPLIT_MM, rng)
        self._coarse = _cell(COARSE_SAMPLES, COARSE_STEP_MM, SPLIT_MM, COARSE_SAMPLES * COARSE_STEP_MM, rng)
        octaves = np.log2([SPLIT_MM / GRAIN_MM[0], COARSE_SAMPLES * COARSE_STEP_MM / SPLIT_MM])
        self._weights = np.sqrt(octaves / octaves.sum())  # each octave has the same power
        self._rng = rng

    def everywhere(self) -> Pattern:
        """Return noise of all wavelengths, in a pose of its own."""
        fine, coarse = self.grains(), _posed(self._coarse, COARSE_STEP_MM, self._rng)
        return lambda points_mm: self._weights[0] * fine(points_mm) + self._weights[1] * coarse(points_mm)

    def grains(self) -> Pattern:
        """Return its fine part alone, in a pose of its own."""
        return _posed(self._fine, FINE_STEP_MM, self._rng)

    def smooth(self) -> Pattern:
        """Return its coarse part alone, in a pose of its own."""
        return _posed(self._coarse, COARSE_STEP_MM, self._rng)


def _cell(n: int, step_mm: float, shortest_mm: float, longest_mm: float, rng: np.random.Generator) -> Floats:
    """Return a cell (n, n, n) of noise that repeats, of unit variance."""
    along = np.fft.fftfreq(n, step_mm).astype(np.float32)
    halved = np.fft.rfftfreq(n, step_mm).astype(np.float32)
    frequency = np.sqrt(along[:, None, None] ** 2 + along[:, None] ** 2 + halved**2)
    is_within = (frequency >= 0.999 / longest_mm) & (frequency < 1 / shortest_mm)
    amplitude = np.where(is_within, np.maximum(frequency, 1e-6) ** (SLOPE / 2), 0).astype(np.float32)
    parts = rng.standard_normal((2, *frequency.shape), dtype=np.float32)
    cell = irfftn(amplitude * (parts[0] + 1j * parts[1]), s=(n, n, n))
    return np.asarray(cell / cell.std(), np.float32)


def _posed(cell: Floats, step_mm: float, rng: np.random.Generator) -> Pattern:
    """Return noise of a cell, turned and displaced at random: what it repeats is on no surface twice."""
    axes, offset = Rotation.random(rng=rng).as_matrix(), rng.uniform(0, len(cell), size=3)

    def pattern(points_mm: PointsMM) -> Values:
        at = points_mm @ axes / step_mm + offset
        return np.asarray(map_coordinates(cell, at.T, order=1, mode="grid-wrap"), float)

    return pattern


def _grained(noise: SpectralNoise, rng: np.random.Generator) -> Pattern:
    """Return granite: grains of three minerals, each with greys of its own."""
    grains, within = noise.grains(), noise.everywhere()
    shares, levels = np.array(MINERALS).T
    limits = np.quantile(grains(rng.uniform(-10, 10, size=(N_STANDARDIZED, 3))), np.cumsum(shares)[:-1])

    def pattern(points_mm: PointsMM) -> Values:
        value = grains(points_mm)
        steps = np.clip((value[:, None] - limits) / 0.2 + 0.5, 0, 1)  # grains have soft borders
        return np.asarray(levels[0] + steps @ np.diff(levels) + 0.5 * within(points_mm))

    return pattern


def _gneiss(noise: SpectralNoise, rng: np.random.Generator) -> Pattern:
    """Return bands of widths on all scales, folded, of grains that are flat along them."""
    axes = Rotation.random(rng=rng).as_matrix()
    flattened = FLATNESS ** np.array([-1 / 3, -1 / 3, 2 / 3])
    grains, folds, within = noise.grains(), noise.smooth(), noise.everywhere()
    wavelengths_mm = np.geomspace(*BANDS_MM, 24)
    phases = rng.uniform(0, 2 * np.pi, size=len(wavelengths_mm))

    def pattern(points_mm: PointsMM) -> Values:
        height_mm = points_mm @ axes[:, 2] + 0.8 * folds(points_mm)
        bands = np.sin(2 * np.pi * height_mm[:, None] / wavelengths_mm + phases).sum(axis=1)
        bands = np.tanh(2 * np.sqrt(2 / len(wavelengths_mm)) * bands)
        return np.asarray(bands + 0.5 * grains(points_mm @ axes * flattened) + 0.3 * within(points_mm))

    return pattern


def _veined(noise: SpectralNoise, rng: np.random.Generator) -> Pattern:
    """Return a dark rock with bright veins, which are where smooth sheets meet the surface."""
    within, course = noise.everywhere(), noise.smooth()
    normals = rng.normal(size=(3, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets_mm = rng.uniform(0, VEIN_SPACING_MM, size=3)

    def pattern(points_mm: PointsMM) -> Values:
        along_mm = points_mm @ normals.T + offsets_mm + 0.8 * course(points_mm)[:, None]
        away_mm = np.abs(along_mm - VEIN_SPACING_MM * np.round(along_mm / VEIN_SPACING_MM)).min(axis=1)
        return np.asarray(4 * np.exp(-((away_mm / (VEIN_MM / 2)) ** 2)) + 0.6 * within(points_mm))

    return pattern


def _conglomerate(noise: SpectralNoise, rng: np.random.Generator) -> Pattern:
    """Return pebbles of many greys in a matrix of grains."""
    return _fragments(lambda count: rng.normal(size=count), -0.5, noise, rng)


def _fragments(
    draw_greys: Callable[[int], Values], matrix: float, noise: SpectralNoise, rng: np.random.Generator
) -> Pattern:
    """Return fragments of the greys that are drawn for them, in a matrix of grains of this mean."""
    half_mm = 20.0
    count = round((2 * half_mm / PEBBLES_MM) ** 3)
    seeds = cKDTree(rng.uniform(-half_mm, half_mm, size=(count, 3)))
    greys, grains, within = draw_greys(count), noise.grains(), noise.everywhere()

    def pattern(points_mm: PointsMM) -> Values:
        wavy_mm = points_mm + 0.3 * within(points_mm)[:, None]
        apart_mm, nearest = seeds.query(wavy_mm, k=2)
        is_fragment = np.clip((apart_mm[:, 1] - apart_mm[:, 0] - CEMENT_MM) / 0.2 + 0.5, 0, 1)
        fragments = greys[nearest[:, 0]] + 0.25 * within(points_mm)
        return np.asarray(is_fragment * fragments + (1 - is_fragment) * (0.8 * grains(points_mm) + matrix))

    return pattern


def _breccia(noise: SpectralNoise, rng: np.random.Generator) -> Pattern:
    """Return pale fragments, all of one grey, in a dark matrix."""
    shares, levels = np.array(FRAGMENTS).T
    return _fragments(lambda count: rng.choice(levels, size=count, p=shares), -0.8, noise, rng)


def _even_rock(noise: SpectralNoise, rng: np.random.Generator) -> Pattern:
    """Return the bare noise, as in limestone and basalt."""
    return noise.everywhere()


def _halves(noise: SpectralNoise, rng: np.random.Generator) -> Pattern:
    """Return a black and a pale half, with greys in proportion to their own."""
    normal, course, within = rng.normal(size=3), noise.smooth(), noise.everywhere()
    normal /= np.linalg.norm(normal)

    def pattern(points_mm: PointsMM) -> Values:
        side = np.tanh((points_mm @ normal + 0.5 * course(points_mm)) / (BORDER_MM / 2))
        return np.asarray(side + (1 + 0.8 * side) * 0.2 * within(points_mm))

    return pattern


def _dusty(noise: SpectralNoise, rng: np.random.Generator) -> Pattern:
    """Return granite under patches of dust, thicker on one side."""
    granite, patches, within = _grained(noise, rng), noise.everywhere(), noise.everywhere()
    side = rng.normal(size=3)
    side /= np.linalg.norm(side)

    def pattern(points_mm: PointsMM) -> Values:
        thickness = 0.3 + 0.5 * patches(points_mm) + points_mm @ side / 12
        covered = 0.9 * np.clip(thickness + 0.5, 0, 1)
        return np.asarray((1 - covered) * granite(points_mm) + covered * (2.2 + 0.2 * within(points_mm)))

    return pattern


_TEXTURES: Mapping[SurfaceKind, Callable[[SpectralNoise, np.random.Generator], Pattern]] = {
    SurfaceKind.GRAINED: _grained,
    SurfaceKind.GNEISS: _gneiss,
    SurfaceKind.VEINED: _veined,
    SurfaceKind.CONGLOMERATE: _conglomerate,
    SurfaceKind.BRECCIA: _breccia,
    SurfaceKind.LIMESTONE: _even_rock,
    SurfaceKind.BASALT: _even_rock,
    SurfaceKind.HALVES: _halves,
    SurfaceKind.DUSTY: _dusty,
}
