"""What the estimate's loops compute is what numpy says in a line."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples

from pipeline.estimate.inner import TOLERANCE, TOUCH_MM, _approach
from pipeline.estimate.smoothness import REACH_DEG, local_share
from pipeline.estimate.tangents import SLACK_MM, segments_mm
from pipeline.geometry.growing_hull import facets_of, grow, growth_for, start

seeds = st.integers(0, 2**32 - 1)


def unit_vectors(n: int, rng: np.random.Generator) -> np.ndarray:
    vectors = rng.normal(size=(n, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


@examples(0.1)
@given(seed=seeds, n=st.integers(30, 200))
def test_segments_are_what_all_planes_leave(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    normals, directions = unit_vectors(n, rng), unit_vectors(50, rng)
    offsets_mm, points_mm = rng.uniform(5, 10, n), rng.uniform(-3, 3, (50, 3))
    low_mm, high_mm = segments_mm(normals, offsets_mm, points_mm, directions)
    slopes = directions @ normals.T
    ends_mm = (offsets_mm + SLACK_MM - points_mm @ normals.T) / slopes
    expected_low_mm = np.where(slopes < 0, ends_mm, -np.inf).max(axis=1)
    expected_high_mm = np.where(slopes > 0, ends_mm, np.inf).min(axis=1)
    np.testing.assert_allclose(low_mm, expected_low_mm, rtol=1e-4)
    np.testing.assert_allclose(high_mm, expected_high_mm, rtol=1e-4)


@examples(0.1)
@given(seed=seeds, n=st.integers(1, 300))
def test_local_share_is_a_weighted_mean(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    normals, shares = unit_vectors(n, rng), rng.uniform(0, 1, n)
    weights = np.maximum(normals @ normals.T - np.cos(np.deg2rad(REACH_DEG)), 0)
    np.testing.assert_allclose(
        local_share(normals, shares), weights @ shares / weights.sum(axis=1), rtol=1e-5
    )


@examples(0.1)
@given(seed=seeds, n_corners=st.integers(10, 60))
def test_rays_approach_a_body(seed: int, n_corners: int) -> None:
    """Nowhere on a segment is the highest plane much lower than at the point that was found."""
    rng = np.random.default_rng(seed)
    n = n_corners + 40
    lines = np.column_stack(
        [12 * unit_vectors(n, rng), unit_vectors(n, rng), np.full(n, -8.0), np.full(n, 8.0)]
    )
    points_mm = 10 * unit_vectors(n, rng)
    growth = growth_for(n, 20.0, TOLERANCE)
    corners, rays = np.split(np.arange(n, dtype=np.int32), [n_corners])
    assert start(points_mm, corners, growth)
    assert grow(points_mm, growth)
    planes = facets_of(growth).planes
    missed = _approach(lines, rays, growth, points_mm)
    assert set(missed) <= set(rays)
    along_mm = lines[:, None, :3] + np.linspace(-8, 8, 400)[:, None] * lines[:, None, 3:6]
    least_mm = (along_mm @ planes[:, :3].T + planes[:, 3]).max(axis=2).min(axis=1)
    found_mm = (points_mm @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    far = rays[least_mm[rays] > TOUCH_MM + 0.1]
    assert set(far) <= set(missed)
    assert np.quantile(found_mm[missed] - least_mm[missed], 0.8) < 0.05
    assert grow(points_mm, growth)
    planes = facets_of(growth).planes
    assert (points_mm[missed] @ planes[:, :3].T + planes[:, 3]).max() < 1e-6
