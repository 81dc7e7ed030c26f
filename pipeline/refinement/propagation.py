"""Depths of all nodes together: min-sum belief propagation with a linear cost between neighbours."""

from typing import Annotated

import numpy as np

from pipeline.arrays import Indices32, Singles
from pipeline.compiled import compiled

N_ROUNDS = 6
"""Even: forth and back over the nodes in turn; ten find the same depths."""


def propagate(
    costs: Annotated[Singles, "(K, L)"], neighbours: Indices32, per_step: float
) -> Annotated[Singles, "(K, L)"]:
    """Return the cost of each depth of each node with what its neighbours say of it.

    Neighbours whose depths differ pay `per_step` for each step of depth.
    """
    reverse = np.full_like(neighbours, -1)
    beliefs = costs.copy()
    messages = np.zeros((*neighbours.shape, costs.shape[1]), np.float32)
    _propagate(costs, neighbours, reverse, np.float32(per_step), messages, beliefs)
    return beliefs


@compiled
def _propagate(
    costs: Singles,
    neighbours: Indices32,
    reverse: Indices32,
    per_step: np.float32,
    messages: Singles,
    beliefs: Singles,
) -> None:
    n_nodes, n_depths = costs.shape
    n_links = neighbours.shape[1]
    for i in range(n_nodes):
        for k in range(n_links):
            j = neighbours[i, k]
            if j >= 0:
                for m in range(n_links):
                    if neighbours[j, m] == i:
                        reverse[i, k] = m
    totals, sent = np.empty(n_depths, np.float32), np.empty(n_depths, np.float32)
    for turn in range(N_ROUNDS):
        for at in range(n_nodes):
            i = at if turn % 2 == 0 else n_nodes - 1 - at
            for depth in range(n_depths):
                totals[depth] = costs[i, depth]
            for k in range(n_links):
                if neighbours[i, k] >= 0:
                    for depth in range(n_depths):
                        totals[depth] += messages[i, k, depth]
            for k in range(n_links):
                if reverse[i, k] < 0:
                    continue
                least = totals[0] - messages[i, k, 0]
                for depth in range(n_depths):
                    sent[depth] = totals[depth] - messages[i, k, depth]
                    least = min(least, sent[depth])
                for depth in range(1, n_depths):
                    sent[depth] = min(sent[depth], sent[depth - 1] + per_step)
                for depth in range(n_depths - 2, -1, -1):
                    sent[depth] = min(sent[depth], sent[depth + 1] + per_step)
                j, m = neighbours[i, k], reverse[i, k]
                for depth in range(n_depths):
                    messages[j, m, depth] = sent[depth] - least
    for i in range(n_nodes):
        for k in range(n_links):
            if reverse[i, k] >= 0:
                for depth in range(n_depths):
                    beliefs[i, depth] += messages[i, k, depth]
