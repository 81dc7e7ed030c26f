"""The convex hull against qhull's, and its vertices found by climbing."""

import numpy as np
import pytest
import scipy.spatial
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.extents import examples

from pipeline.geometry import quickhull
from pipeline.geometry.quickhull import TOLERANCE, hull_facets
from pipeline.measuring.convex import convex_body
from pipeline.measuring.directions import half_sphere
from pipeline.measuring.solid import solid_of

Array = NDArray[np.float64]
ROUNDING = 1e-12


def lattice(n: int) -> Array:
    """Points of a cube, on its faces and inside: many in one plane, many on one line."""
    return np.stack(np.meshgrid(*[np.linspace(-5, 5, n)] * 3), axis=-1).reshape(-1, 3)


def rough_ball(n: int, rng: np.random.Generator) -> Array:
    points = rng.normal(size=(n, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True) * rng.uniform(9.9, 10, size=(n, 1))


def assert_is_hull(points: Array) -> None:
    facets, normals = hull_facets(points)
    solid = solid_of(points, facets)  # closed, and oriented
    extent = np.ptp(points, axis=0).max()
    corners = points[facets]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(outward, axis=1)
    large = areas > 1e-6 * extent**2  # normals of slivers are nothing but rounding
    np.testing.assert_allclose(outward[large] / areas[large, None], normals[large], atol=1e-6)
    outside = points @ normals[large].T - np.einsum("ij,ij->i", corners[:, 0], normals)[large]
    assert outside.max() <= (TOLERANCE + ROUNDING) * extent
    hull = scipy.spatial.ConvexHull(points)
    missing = hull.volume - solid.volume_mm3
    assert -ROUNDING * extent**3 <= missing <= TOLERANCE * extent * hull.area


@examples(0.3)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(4, 600))
def test_random_points(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    assert_is_hull(rng.normal(size=(n, 3)) * rng.uniform(1, 20, size=3) + rng.uniform(-100, 100, size=3))


@examples(0.1)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(100, 1500))
def test_points_that_are_nearly_all_on_the_hull(seed: int, n: int) -> None:
    assert_is_hull(rough_ball(n, np.random.default_rng(seed)))


@pytest.mark.parametrize("seed", [None, 1, 2, 3])
def test_points_in_planes_and_on_lines(seed: int | None) -> None:
    rotation = np.eye(3) if seed is None else Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    points = lattice(9) @ rotation.T
    assert_is_hull(points)
    facets, _ = hull_facets(points)
    assert solid_of(points, facets).volume_mm3 == pytest.approx(1000, rel=1e-9)


def test_points_in_one_plane_have_no_hull() -> None:
    with pytest.raises(scipy.spatial.QhullError):
        hull_facets(lattice(5) * [1, 1, 0])


def test_where_the_horizon_is_no_ring_qhull_helps(monkeypatch: pytest.MonkeyPatch) -> None:
    points = rough_ball(300, np.random.default_rng(0))
    monkeypatch.setattr(quickhull, "grow", lambda points, growth: False)
    assert_is_hull(points)


@examples(0.1)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(8, 1500))
def test_no_vertex_is_higher_than_the_one_climbed_to(seed: int, n: int) -> None:
    body = convex_body(rough_ball(n, np.random.default_rng(seed)))
    heights = half_sphere().directions @ body.vertices_mm.T
    np.testing.assert_allclose(body.width_mm, np.ptp(heights, axis=1), rtol=1e-12)
