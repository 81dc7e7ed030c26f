"""A hull that points are added to is that of all of them, and its facets know their neighbours."""

import numpy as np
import pytest
import scipy.spatial
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.extents import examples

from pipeline.geometry.growing_hull import (
    Facets,
    Growth,
    facets_of,
    grow,
    growth_for,
    put_above,
    start,
)
from pipeline.geometry.quickhull import restart_by_qhull

Array = NDArray[np.float64]
TOLERANCE = 1e-9


def random_points(n: int, rng: np.random.Generator) -> Array:
    """On a box and a ball in turns: many in one plane, many corners."""
    points = rng.normal(size=(n, 3))
    points[::2] /= np.abs(points[::2]).max(axis=1, keepdims=True)
    points[1::2] /= np.linalg.norm(points[1::2], axis=1, keepdims=True) / 1.2
    return points


def add(points: Array, which: NDArray[np.int32], growth: Growth) -> None:
    facets = np.flatnonzero(growth.above[: growth.counts[0]] == -1)
    planes = growth.planes[facets, :4]
    for point in which:
        heights = planes[:, :3] @ points[point] + planes[:, 3]
        if heights.max() > growth.tolerance:
            put_above(growth, facets[heights.argmax()], point, heights.max())
    if not grow(points, growth):
        restart_by_qhull(points, np.arange(which.max() + 1, dtype=np.int32), growth)


def assert_is_hull_of(points: Array, facets: Facets) -> None:
    heights = points @ facets.planes[:, :3].T + facets.planes[:, 3]
    assert heights.max() < 3 * TOLERANCE
    at_corners = np.take_along_axis(heights, facets.corners.T, axis=0)
    np.testing.assert_allclose(at_corners, 0, atol=1e-9)
    a, b, c = points[facets.corners.T]
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    assert volume == pytest.approx(scipy.spatial.ConvexHull(points).volume, rel=1e-7)
    number = np.arange(len(facets.corners))
    for side in range(3):
        beyond = facets.across[:, side]
        start_of, end_of = facets.corners[:, side], facets.corners[:, (side + 1) % 3]
        back = np.argmax(facets.corners[beyond] == end_of[:, None], axis=1)
        assert (facets.corners[beyond, (back + 1) % 3] == start_of).all()
        assert (facets.across[beyond, back] == number).all()


@examples(0.15)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(30, 400), is_restarted=st.booleans())
def test_batches_of_points(seed: int, n: int, is_restarted: bool) -> None:
    points = random_points(n, np.random.default_rng(seed))
    first, *batches = np.array_split(np.arange(n, dtype=np.int32), 4)
    growth = growth_for(n, 2.4, TOLERANCE)
    assert start(points, first, growth)
    assert grow(points, growth)
    if is_restarted:
        restart_by_qhull(points, first, growth)
    for batch in batches:
        add(points, batch, growth)
    assert_is_hull_of(points, facets_of(growth))


@pytest.mark.parametrize("n_dimensions", [0, 1, 2])
def test_points_in_a_plane_begin_no_hull(n_dimensions: int) -> None:
    points = random_points(30, np.random.default_rng(1))
    points[:, n_dimensions:] = 3.0
    assert not start(points, np.arange(30, dtype=np.int32), growth_for(30, 2.4, TOLERANCE))
