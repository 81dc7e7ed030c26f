"""Scanned-like stones have dents of 1 to 3 mm that no silhouette shows, and ridges."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from pipeline.synthesis.bodies import Body
from pipeline.synthesis.scanned_stones import DENT_DEPTHS_MM, MAX_DEPTH, SIZES_MM, dents_mm, scanned_stone
from pipeline.synthesis.stones import greatest_distance, unit_vectors


def depths_below_hull_mm(body: Body) -> np.ndarray:
    """Depth of each 40th vertex below the convex hull."""
    hull = ConvexHull(body.mesh.vertices)
    return -(body.mesh.vertices[::40] @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)


@pytest.mark.parametrize("size_mm", SIZES_MM)
def test_size_and_closed_surface(size_mm: float) -> None:
    body = scanned_stone(size_mm, np.random.default_rng(1))
    assert greatest_distance(body.mesh.vertices) == pytest.approx(size_mm)
    assert body.mesh.is_watertight
    assert body.mesh.euler_number == 2
    np.testing.assert_allclose(body.mesh.center_mass, 0, atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_dents_are_deep(seed: int) -> None:
    points_mm = 12 * unit_vectors(5_000, np.random.default_rng(0))
    depths_mm = dents_mm(points_mm, 24.0, np.random.default_rng(seed))
    assert DENT_DEPTHS_MM[0] < depths_mm.max() < DENT_DEPTHS_MM[1]
    assert depths_mm.min() == 0
    assert 0.02 < np.mean(depths_mm > 0) < 0.6


def test_small_stones_have_shallower_dents() -> None:
    points_mm = 4.5 * unit_vectors(5_000, np.random.default_rng(0))
    for seed in range(4):
        assert dents_mm(points_mm, 9.0, np.random.default_rng(seed)).max() <= 9.0 * MAX_DEPTH


def test_stones_have_dents_below_all_that_silhouettes_see() -> None:
    deepest = [
        depths_below_hull_mm(scanned_stone(22.0, np.random.default_rng(seed))).max() for seed in (1, 2, 3)
    ]
    assert min(deepest) > 0.8
    assert max(deepest) < 4.5


def test_ridges_are_sharp() -> None:
    """Some edges between dents and broken faces turn by more than 40 degrees, though facets are small."""
    body = scanned_stone(22.0, np.random.default_rng(1))
    assert np.quantile(np.rad2deg(body.mesh.face_adjacency_angles), 0.999) > 40


def test_stones_follow_from_the_generator() -> None:
    first, again = (scanned_stone(15.0, np.random.default_rng(2)) for _ in range(2))
    assert np.array_equal(first.mesh.vertices, again.mesh.vertices)
