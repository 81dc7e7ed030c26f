"""The heights that the search for boxes takes from a few vertices, against those of all of them."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipeline.measuring import boxes
from pipeline.measuring.convex import convex_body


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(6, 400), st.floats(1e-5, 0.05), st.booleans())
def test_no_vertex_is_higher_than_those_looked_at(seed: int, n: int, radius: float, is_round: bool) -> None:
    rng = np.random.default_rng(seed)
    points_mm = rng.normal(size=(n, 3))
    if is_round:
        points_mm /= np.linalg.norm(points_mm, axis=1, keepdims=True)
    body = convex_body(points_mm * rng.uniform(3, 12, size=3))
    kept, frames, turns = boxes._room(1), boxes._room(boxes.N_CHILDREN), boxes._turns(len(body.vertices_mm))
    kept.axes[:], kept.touching[:] = Rotation.random(rng=rng).as_matrix(), 0
    boxes._settle(body.edges, kept, 0, True)

    boxes._turn(body.edges, kept, 1, radius, True, turns, frames)

    for axis in range(3):
        e, after, last = (kept.axes[0, (axis + k) % 3] for k in range(3))
        turned = e + np.outer(turns.towards, after) - np.outer(turns.away, last)
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        np.testing.assert_allclose(
            turns.width_mm[axis], np.ptp(turned @ body.vertices_mm.T, axis=1), rtol=1e-12
        )
    assert not turns.is_queued.any()
