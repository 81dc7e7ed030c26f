"""Shifts of all nodes from those that something is known of: a membrane, held by evidence and stretched between it."""

from pipeline.arrays import Indices32, Values
from pipeline.compiled import compiled, compiled_within
from pipeline.refinement.nodes import MAX_NEIGHBOURS, Nodes

STIFFNESS = 0.03
"""Pull towards the mean of a node's neighbours, where full evidence pulls by 1: it hardly moves what is known."""
HOME = 0.0003
"""Pull of the estimate wherever nothing else is known: several nodes away from all evidence it has its way."""
N_SWEEPS = 20
"""There and back over all nodes: enough for places of ten nodes across."""


def stretched(
    shifts_mm: Values, sure: Values, anchors: Values, nodes: Nodes, n_sweeps: int = N_SWEEPS
) -> Values:
    """Return the shifts (K,) of a membrane that evidence of weight `sure` pulls to `shifts_mm`, `anchors` to zero.

    A surface has no holes: a node of which no pair of views tells anything, as on the wall of a dent, lies between its
    neighbours, not back at the estimate. It is the most probable surface (maximum a posteriori) if differences of
    neighbours are normally distributed.
    """
    found_mm = shifts_mm.copy()
    _stretch(shifts_mm, sure, anchors, nodes.neighbours, n_sweeps, found_mm)
    return found_mm


@compiled
def _stretch(
    shifts_mm: Values,
    sure: Values,
    anchors: Values,
    neighbours: Indices32,
    n_sweeps: int,
    found_mm: Values,
) -> None:
    for i in range(len(found_mm)):
        found_mm[i] *= sure[i] / (sure[i] + anchors[i] + HOME)
    for _ in range(n_sweeps):
        for i in range(len(found_mm)):
            found_mm[i] = _balanced(i, shifts_mm, sure, anchors, neighbours, found_mm)
        for i in range(len(found_mm) - 1, -1, -1):
            found_mm[i] = _balanced(i, shifts_mm, sure, anchors, neighbours, found_mm)


@compiled_within
def _balanced(
    i: int, shifts_mm: Values, sure: Values, anchors: Values, neighbours: Indices32, found_mm: Values
) -> float:
    """Return the shift at which all that pulls on a node is in balance."""
    pull, total = sure[i] * shifts_mm[i], sure[i] + anchors[i] + HOME
    for k in range(MAX_NEIGHBOURS):
        j = neighbours[i, k]
        if j >= 0:
            pull += STIFFNESS / MAX_NEIGHBOURS * found_mm[j]
            total += STIFFNESS / MAX_NEIGHBOURS
    return pull / total
