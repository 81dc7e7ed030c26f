from dataclasses import replace

import numpy as np
import pytest

from pipeline.synthesis.bodies import SurfaceKind, sphere
from pipeline.synthesis.rock_patterns import Pattern, rock_pattern

POINTS_MM = np.random.default_rng(0).uniform(-4, 4, size=(20_000, 3))


def pattern_of(surface: SurfaceKind, seed: int = 1) -> Pattern:
    pattern = rock_pattern(replace(sphere(), surface=surface), np.random.default_rng(seed))
    assert pattern is not None
    return pattern


def correlation(pattern: Pattern, apart_mm: float) -> float:
    """Return how alike the greys at points so far apart are, on the average over directions."""
    steps = np.random.default_rng(1).normal(size=POINTS_MM.shape)
    steps *= apart_mm / np.linalg.norm(steps, axis=1, keepdims=True)
    return float(np.corrcoef(pattern(POINTS_MM), pattern(POINTS_MM + steps))[0, 1])


@pytest.mark.parametrize("surface", [SurfaceKind.GRANITE, SurfaceKind.BANDED])
def test_patterns_have_zero_mean_and_unit_variance_and_are_the_same_at_every_call(
    surface: SurfaceKind,
) -> None:
    pattern = pattern_of(surface)
    greys = pattern(POINTS_MM)
    assert abs(greys.mean()) < 0.2
    assert greys.std() == pytest.approx(1, abs=0.15)
    assert np.array_equal(greys[::-1], pattern(POINTS_MM[::-1]))
    assert not np.allclose(greys, pattern_of(surface, seed=2)(POINTS_MM))


def test_granite_is_of_crystals_of_three_minerals() -> None:
    pattern = pattern_of(SurfaceKind.GRANITE)
    levels, counts = np.unique(np.round(pattern(POINTS_MM), 6), return_counts=True)
    assert counts[np.argsort(counts)[-3:]].sum() > 0.7 * len(POINTS_MM), "but for the boundaries"
    assert np.ptp(levels) > 2
    assert correlation(pattern, 0.25) > 0.5
    assert abs(correlation(pattern, 2.0)) < 0.1, "crystals are smaller"


def test_gneiss_changes_across_its_bands_more_than_along_them() -> None:
    pattern = pattern_of(SurfaceKind.BANDED)
    axes = np.vstack([np.eye(3), np.random.default_rng(2).normal(size=(200, 3))])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    greys = pattern(POINTS_MM[:2000])
    changes = [np.abs(pattern(POINTS_MM[:2000] + 0.5 * axis) - greys).mean() for axis in axes]
    assert max(changes) > 1.7 * min(changes)


@pytest.mark.parametrize("surface", [SurfaceKind.MOTTLED, SurfaceKind.PLAIN])
def test_other_surfaces_have_no_pattern(surface: SurfaceKind) -> None:
    assert rock_pattern(replace(sphere(), surface=surface), np.random.default_rng(1)) is None
