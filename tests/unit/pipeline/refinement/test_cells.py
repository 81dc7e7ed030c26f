"""Points in cells: the nearest within a reach, as a k-d tree finds them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from pipeline.refinement.cells import nearest_within


@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.floats(0.05, 2.0))
def test_distances_are_those_of_a_k_d_tree(seed: int, n_others: int, reach_mm: float):
    rng = np.random.default_rng(seed)
    points_mm, others_mm = rng.uniform(-2, 2, (40, 3)), rng.uniform(-1, 3, (n_others, 3))
    expected_mm = cKDTree(others_mm).query(points_mm, distance_upper_bound=reach_mm)[0]
    np.testing.assert_array_equal(nearest_within(points_mm, others_mm, reach_mm), expected_mm)


def test_no_point_is_near_where_there_are_none():
    assert np.isinf(nearest_within(np.zeros((3, 3)), np.zeros((0, 3)), 1.0)).all()
