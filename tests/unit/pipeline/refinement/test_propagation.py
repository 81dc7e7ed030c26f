"""Belief propagation: nodes without an opinion follow those around them."""

import numpy as np

from pipeline.refinement.propagation import propagate

N_NODES, N_DEPTHS = 15, 8


def chain() -> np.ndarray:
    links = np.full((N_NODES, 8), -1, np.int32)
    links[1:, 0] = np.arange(N_NODES - 1)
    links[:-1, 1] = np.arange(1, N_NODES)
    return links


def test_alone_each_node_keeps_its_own_costs():
    costs = np.random.default_rng(0).uniform(size=(N_NODES, N_DEPTHS)).astype(np.float32)
    apart = np.full((N_NODES, 8), -1, np.int32)
    np.testing.assert_array_equal(propagate(costs, apart, 0.1), costs)


def test_a_node_without_opinion_takes_that_of_its_neighbours():
    costs = np.ones((N_NODES, N_DEPTHS), np.float32)
    costs[:, 5] = 0
    costs[7] = 0.5  # indifferent
    assert (propagate(costs, chain(), 0.1).argmin(axis=1) == 5).all()


def test_a_step_that_many_see_stays_a_step():
    costs = np.ones((N_NODES, N_DEPTHS), np.float32)
    costs[:7, 1] = costs[7:, 6] = 0
    depths = propagate(costs, chain(), 0.1).argmin(axis=1)
    np.testing.assert_array_equal(depths, [1] * 7 + [6] * 8)
