"""The membrane that evidence holds, and that is stretched between it."""

import numpy as np
from unit.pipeline.refinement.test_nodes import ball, nodes_of

from pipeline.refinement.membrane import stretched

DEEP_MM = 1.0


def test_a_hole_in_the_evidence_lies_as_deep_as_what_surrounds_it():
    nodes = nodes_of(ball())
    from_hole_mm = np.linalg.norm(nodes.points_mm - nodes.points_mm[0], axis=1)
    sure = (from_hole_mm > 1.5 * nodes.spacing_mm).astype(float)
    shifts_mm = stretched(DEEP_MM * sure, sure, np.zeros(len(sure)), nodes)
    assert (sure == 0).sum() > 3
    assert shifts_mm[sure == 0].min() > 0.95 * DEEP_MM


def test_the_estimate_stays_far_from_all_evidence_and_where_it_is_anchored():
    nodes = nodes_of(ball())
    one = np.zeros(len(nodes.points_mm))
    one[0] = 1.0
    nothing = np.zeros_like(one)
    np.testing.assert_array_equal(stretched(DEEP_MM * one, nothing, nothing, nodes), 0.0)
    shifts_mm = stretched(DEEP_MM * one, one, 1 - one, nodes)
    assert shifts_mm[0] > 0.9 * DEEP_MM
    assert np.abs(shifts_mm[1:]).max() < 0.1 * DEEP_MM


def test_one_doubtful_node_follows_its_sure_neighbours():
    nodes = nodes_of(ball())
    sure = np.ones(len(nodes.points_mm))
    sure[0] = 0.001
    shifts_mm = stretched(DEEP_MM * (sure < 1), sure, np.zeros(len(sure)), nodes)
    assert abs(shifts_mm[0]) < 0.1 * DEEP_MM
