"""Depths of nodes among their neighbours."""

import numpy as np
from unit.pipeline.refinement.test_nodes import SPACING_MM, ball, nodes_of

from pipeline.refinement.node_field import without_spikes


def test_a_node_that_is_deep_alone_is_put_beside_its_neighbours_and_a_dent_stays():
    nodes = nodes_of(ball())
    dent_mm = np.maximum(1.5 - np.linalg.norm(nodes.points_mm - [5.0, 0.0, 0.0], axis=1) / 2, 0)
    spiked_mm = dent_mm.copy()
    alone = int(np.argmin(nodes.points_mm[:, 0]))
    spiked_mm[alone] = 2.0
    smooth_mm = without_spikes(spiked_mm, nodes, 0.4 * SPACING_MM)
    assert smooth_mm[alone] == 0.4 * SPACING_MM
    np.testing.assert_allclose(np.delete(smooth_mm, alone), np.delete(dent_mm, alone), atol=0.15)
    np.testing.assert_array_equal(without_spikes(spiked_mm, nodes, np.inf), spiked_mm)
