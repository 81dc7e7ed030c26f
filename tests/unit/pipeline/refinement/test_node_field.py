"""Depths of nodes among their neighbours."""

import numpy as np
from unit.pipeline.refinement.test_nodes import SPACING_MM, ball, nodes_of

from pipeline.refinement.node_field import (
    CHANCE_MM,
    SPIKE_MM,
    beyond_chance,
    depths_of,
    flat_gate,
    without_spikes,
)


def test_a_node_that_is_deep_alone_is_put_beside_its_neighbours_and_a_dent_stays():
    nodes = nodes_of(ball())
    dent_mm = np.maximum(1.5 - np.linalg.norm(nodes.points_mm - [5.0, 0.0, 0.0], axis=1) / 2, 0)
    spiked_mm = dent_mm.copy()
    alone = int(np.argmin(nodes.points_mm[:, 0]))
    spiked_mm[alone] = 2.0
    smooth_mm = without_spikes(spiked_mm, nodes, 0.4 * SPACING_MM)
    assert smooth_mm[alone] == SPIKE_MM
    np.testing.assert_allclose(np.delete(smooth_mm, alone), np.delete(dent_mm, alone), atol=0.15)


def test_a_node_leaves_its_neighbours_as_far_as_they_leave_each_other_and_no_further_than_asked():
    nodes = nodes_of(ball())
    uneven_mm = np.random.default_rng(0).normal(0, 0.1, len(nodes.points_mm))
    free_mm = without_spikes(uneven_mm, nodes, np.inf)
    assert (free_mm == uneven_mm).mean() > 0.8
    limited_mm = without_spikes(uneven_mm, nodes, SPIKE_MM)
    assert np.abs(limited_mm - uneven_mm).max() > 0.1


def test_shifts_by_chance_vanish_and_larger_ones_stay():
    nodes = nodes_of(ball())
    sure = np.ones(len(nodes.points_mm))
    for times, low, high in ((0.25, 0, 0.01), (1, 0.5, 0.5), (2, 0.9, 1), (5, 0.99, 1)):
        shifts_mm = np.full(len(sure), times * CHANCE_MM[0])
        share = beyond_chance(shifts_mm, sure, nodes) / shifts_mm
        assert low - 1e-9 <= share.min() <= share.max() <= high + 1e-9


def test_a_hump_alone_on_an_even_face_is_chance_and_amid_others_it_stays():
    nodes = nodes_of(ball())
    is_hump = np.linalg.norm(nodes.points_mm - nodes.points_mm[0], axis=1) < 1.5 * SPACING_MM
    assert is_hump.sum() > 4
    for roughness_mm, low, high in ((0.004, 0, 0.3), (0.06, 0.95, 1)):
        rough_mm = np.random.default_rng(0).normal(0, roughness_mm, len(is_hump))
        shifts_mm = np.where(is_hump, 0.05, rough_mm)
        left = beyond_chance(shifts_mm, np.ones(len(is_hump)), nodes)[is_hump] / 0.05
        assert low <= left.min() <= left.max() <= high


def test_a_depth_at_the_end_of_those_tried_is_no_peak():
    nodes = nodes_of(ball())
    depths_mm = np.linspace(-0.35, 0.35, 8)
    peaks_mm = np.where(nodes.points_mm[:, 0] > 0, 0.12, 0.8)
    scores = np.exp(-(((depths_mm - peaks_mm[:, None]) / 0.2) ** 2)).astype(np.float32)
    found_mm, _, is_peak = depths_of(1 - scores, scores, depths_mm, nodes, np.ones(len(peaks_mm)))
    np.testing.assert_array_equal(is_peak, peaks_mm < 0.35)
    np.testing.assert_allclose(found_mm, np.where(is_peak, peaks_mm, 0.35), atol=0.01)


def test_a_node_all_of_whose_neighbours_are_near_edges_lies_on_no_face_either():
    """As at the corner of a cube, where a lone node of the rounding would follow the texture of three faces."""
    nodes = nodes_of(ball())
    near = nodes.neighbours[0][nodes.neighbours[0] >= 0]
    around = np.setdiff1d(nodes.neighbours[near], [-1, 0, *near])
    at_edge = np.zeros(len(nodes.points_mm), np.bool_)
    at_edge[around] = True
    gate = flat_gate(nodes._replace(at_edge=at_edge), np.zeros(len(at_edge)))
    assert gate[0] == 0
    assert gate[int(np.argmax(np.linalg.norm(nodes.points_mm - nodes.points_mm[0], axis=1)))] == 1
