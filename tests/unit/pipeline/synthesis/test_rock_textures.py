"""Textures have the spectrum, the greys and the detail that photographs of rock have."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from pipeline.synthesis.background import DULL_WALL_GREY
from pipeline.synthesis.bodies import SurfaceKind, sphere
from pipeline.synthesis.rock_patterns import rock_pattern
from pipeline.synthesis.rock_textures import (
    COARSE_SAMPLES,
    COARSE_STEP_MM,
    GRAIN_MM,
    ROCK_LOOKS,
    SPECTRUM_TRUE,
    Pattern,
    SpectralNoise,
    rock_look,
)

RADIUS_MM = 7.5
POINTS_MM = np.random.default_rng(0).uniform(-RADIUS_MM, RADIUS_MM, size=(12_000, 3))
POINTS_MM = POINTS_MM[np.linalg.norm(POINTS_MM, axis=1) < RADIUS_MM]


def pattern_of(surface: SurfaceKind, seed: int = 1) -> Pattern:
    pattern = rock_pattern(replace(sphere(), surface=surface), np.random.default_rng(seed))
    assert pattern is not None
    return pattern


def power_by_frequency(pattern: Pattern, edge_mm: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies per mm, and the mean power of a plane section of the pattern at each."""
    at_mm = (np.arange(n) - n / 2) * edge_mm / n
    x, y = np.meshgrid(at_mm, at_mm)
    points_mm = np.stack([x, 0.6 * y, 0.8 * y], axis=-1).reshape(-1, 3)
    window = np.hanning(n)[:, None] * np.hanning(n)
    power = np.abs(np.fft.fft2(pattern(points_mm).reshape(n, n) * window)) ** 2
    along = np.fft.fftfreq(n, edge_mm / n)
    frequency = np.hypot(along[:, None], along)
    edges = np.geomspace(3 / edge_mm, n / edge_mm / 4, 9)
    middle = np.sqrt(edges[1:] * edges[:-1])
    found = [power[(frequency >= low) & (frequency < high)].mean() for low, high in pairwise(edges)]
    return middle, np.array(found)


def slope(pattern: Pattern, edge_mm: float, n: int) -> float:
    """The exponent with which the power of a section falls."""
    frequency, power = power_by_frequency(pattern, edge_mm, n)
    return float(np.polyfit(np.log(frequency), np.log(power), 1)[0])


def test_the_amplitude_of_a_section_falls_as_one_over_the_frequency() -> None:
    """Its power as 1/f^2, from millimetres down to grains."""
    for seed in (1, 2):
        noise = SpectralNoise(np.random.default_rng(seed)).everywhere()
        assert slope(noise, edge_mm=24.0, n=256) == pytest.approx(-2, abs=0.35)


@pytest.mark.parametrize("surface", [SurfaceKind.GRAINED, SurfaceKind.BASALT])
def test_rock_keeps_about_that_spectrum(surface: SurfaceKind) -> None:
    assert -2.6 < slope(pattern_of(surface), edge_mm=16.0, n=256) < -1.0


def test_noise_does_not_repeat_within_a_stone_and_has_no_preferred_side() -> None:
    noise = SpectralNoise(np.random.default_rng(3)).everywhere()
    greys = noise(POINTS_MM)

    def likeness(shift_mm: np.ndarray) -> float:
        return float(np.corrcoef(greys, noise(POINTS_MM + shift_mm))[0, 1])

    assert max(abs(likeness(axis * COARSE_SAMPLES * COARSE_STEP_MM / 4)) for axis in np.eye(3)) < 0.5
    beside = [likeness(0.3 * axis) for axis in np.eye(3)]
    assert min(beside) > 0.4
    assert max(beside) - min(beside) < 0.1


@pytest.mark.parametrize("surface", sorted(SPECTRUM_TRUE))
def test_textures_are_the_same_at_every_call_and_of_zero_mean_and_unit_variance(surface: SurfaceKind) -> None:
    pattern = pattern_of(surface)
    greys = pattern(POINTS_MM)
    assert abs(greys.mean()) < 0.1
    assert greys.std() == pytest.approx(1, abs=0.1)
    assert np.allclose(greys[::-1], pattern(POINTS_MM[::-1]), atol=1e-9)
    assert not np.allclose(greys, pattern_of(surface, seed=2)(POINTS_MM))


@pytest.mark.parametrize("surface", sorted(SPECTRUM_TRUE - {SurfaceKind.HALVES, SurfaceKind.VEINED}))
def test_textures_have_grains_that_the_pixels_resolve(surface: SurfaceKind) -> None:
    """Points two pixels apart are alike, those a millimetre apart much less."""
    pattern = pattern_of(surface)
    greys, steps = pattern(POINTS_MM), np.random.default_rng(4).normal(size=POINTS_MM.shape)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    near, far = (np.corrcoef(greys, pattern(POINTS_MM + at * steps))[0, 1] for at in GRAIN_MM)
    assert near > 0.55
    assert far < near - 0.2


def test_greys_are_those_of_basalt_of_the_wall_and_of_both() -> None:
    rng = np.random.default_rng(5)
    basalt, limestone, halves = (
        rock_look(sphere(), surface, rng)
        for surface in (SurfaceKind.BASALT, SurfaceKind.LIMESTONE, SurfaceKind.HALVES)
    )
    assert 10 <= basalt.grey <= 15
    assert 0.75 < limestone.grey / DULL_WALL_GREY < 1
    assert limestone.contrast < 0.1
    greys = halves.grey * (1 + halves.contrast * pattern_of(SurfaceKind.HALVES)(POINTS_MM))
    assert np.mean(greys < 30) > 0.3
    assert np.mean(greys > 100) > 0.3


def test_veins_are_narrow_and_bright() -> None:
    greys = pattern_of(SurfaceKind.VEINED)(POINTS_MM)
    assert 0.03 < np.mean(greys > 1.5) < 0.25


def test_each_look_follows_from_the_generator() -> None:
    for surface in ROCK_LOOKS:
        first, again = (rock_look(sphere(), surface, np.random.default_rng(6), gloss=0.8) for _ in range(2))
        assert (first.grey, first.contrast) == (again.grey, again.contrast)
        assert (first.surface, first.gloss) == (surface, 0.8)
