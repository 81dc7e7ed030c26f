"""Some of the nodes, and what is found better for them."""

import numpy as np
from unit.pipeline.refinement.test_nodes import ball, nodes_of

from pipeline.refinement.nodes import of_nodes, widened
from pipeline.refinement.search import Found


def test_some_nodes_keep_those_of_their_neighbours_that_are_among_them() -> None:
    nodes = nodes_of(ball())
    chosen = nodes.points_mm[:, 2] > 0
    some, numbers = of_nodes(nodes, chosen), np.flatnonzero(chosen)
    np.testing.assert_array_equal(some.points_mm, nodes.points_mm[chosen])
    for at, number in enumerate(numbers):
        kept = [i for i in nodes.neighbours[number] if i >= 0 and chosen[i]]
        assert [numbers[i] for i in some.neighbours[at] if i >= 0] == kept


def test_flags_widen_by_one_ring() -> None:
    nodes = nodes_of(ball())
    one = np.zeros(len(nodes.points_mm), np.bool_)
    one[7] = True
    assert set(np.flatnonzero(widened(one, nodes))) >= {
        7,
        *(i for i in range(len(one)) if 7 in nodes.neighbours[i]),
    }
    assert np.count_nonzero(widened(one, nodes)) < 20


def test_only_what_looks_more_alike_takes_the_place_of_what_was_found() -> None:
    def found(scores: list[float], step_mm: float) -> Found:
        n = len(scores)
        return Found(
            before_mm=np.full(n, 1.0),
            steps_mm=np.full(n, step_mm),
            sure=np.ones(n),
            is_peak=np.ones(n, np.bool_),
            scores=np.array(scores),
        )

    chosen = np.array([True, False, True, False])
    merged, is_new = found([0.2, 0.2, 0.9, 0.2], 0.0).with_better(found([0.8, 0.8], 0.5), chosen)
    np.testing.assert_array_equal(is_new, [True, False, False, False])
    np.testing.assert_array_equal(merged.shifts_mm, [1.5, 1.0, 1.0, 1.0])
