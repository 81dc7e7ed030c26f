"""Rays through the inner body's faces, found by walking, are those that a search of all faces finds."""

import numpy as np
import pytest
from support.silhouettes import sphere_silhouettes

from pipeline.estimate.smooth_support import inner_of
from pipeline.estimate.surface import InnerSurface, inner_surface
from pipeline.estimate.tangents import find_tangents
from pipeline.rig.design import as_built, nominal_rig
from pipeline.views.prepared import prepare_views

RIG = as_built(nominal_rig(), seed=6)
CENTER_MM = np.array([0.4, -0.3, 0.2])
VIEWS = prepare_views(sphere_silhouettes(RIG, CENTER_MM), RIG)


def surface(points_mm: np.ndarray) -> InnerSurface:
    found = inner_surface(VIEWS, CENTER_MM, points_mm)
    assert not isinstance(found, str)
    return found


@pytest.mark.parametrize("seed", [1, 2])
def test_the_walk_ends_in_the_face_that_ends_the_ray(seed: int) -> None:
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    _, inner = inner_of(find_tangents(VIEWS, CENTER_MM))
    assert inner is not None
    planes = inner.facets.planes
    nearest_mm = 1 / (directions @ (planes[:, :3] / -planes[:, 3:]).T).max(axis=1)
    distances_mm = rng.uniform(1, 20, size=2000)
    found = surface(CENTER_MM + directions * distances_mm[:, None])
    np.testing.assert_allclose(found.radii * distances_mm, nearest_mm, rtol=1e-12)
    # the corners' weights give the bulge of the sphere above its facets
    assert nearest_mm.mean() < 7.49
    outer_mm = (found.radii + found.half_heights) * distances_mm
    assert outer_mm.mean() == pytest.approx(7.5, abs=0.01)


def test_the_order_of_the_rays_does_not_matter() -> None:
    points_mm = CENTER_MM + np.random.default_rng(3).normal(size=(500, 3))
    order = np.random.default_rng(4).permutation(len(points_mm))
    there, shuffled = surface(points_mm), surface(points_mm[order])
    np.testing.assert_allclose(shuffled.radii, there.radii[order], rtol=1e-12)
    np.testing.assert_allclose(shuffled.half_heights, there.half_heights[order], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(shuffled.local_share, there.local_share[order], rtol=1e-9)
