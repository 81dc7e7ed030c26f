"""The search for boxes: widths that it takes from a few vertices, and that it finds what it starts from."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.extents import examples

from pipeline.measuring import boxes
from pipeline.measuring.convex import convex_body
from pipeline.measuring.directions import half_sphere, near_frames


@examples(0.25)
@given(st.integers(0, 2**32 - 1), st.integers(6, 400), st.floats(1e-5, 0.05), st.booleans())
def test_no_vertex_is_higher_than_those_looked_at(seed: int, n: int, radius: float, is_round: bool) -> None:
    rng = np.random.default_rng(seed)
    points_mm = rng.normal(size=(n, 3))
    if is_round:
        points_mm /= np.linalg.norm(points_mm, axis=1, keepdims=True)
    body = convex_body(points_mm * rng.uniform(3, 12, size=3))
    frame, turns = boxes._empty_frames(1), boxes._turns(len(body.vertices_mm))
    frame.axes[0] = Rotation.random(rng=rng).as_matrix()
    heights_mm = frame.axes[0] @ body.vertices_mm.T
    frame.touching[:] = np.column_stack([heights_mm.argmax(axis=1), heights_mm.argmin(axis=1)])

    for axis in range(3):
        boxes._turn(body.edges, frame, 0, axis, radius, turns)

        e, after, last = (frame.axes[0, (axis + k) % 3] for k in range(3))
        towards, away = radius * turns.steps
        turned = e + np.outer(towards, after) - np.outer(away, last)
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        np.testing.assert_allclose(
            turns.width_mm[axis], np.ptp(turned @ body.vertices_mm.T, axis=1), rtol=1e-12
        )
    assert not turns.queue[1].any()


def test_frames_of_a_neighbourhood_are_near_and_nearly_orthogonal() -> None:
    axes = half_sphere().directions[near_frames()]  # (3, N_NEIGHBORS, C, 3)

    products = np.abs(np.einsum("ahci,bhci->habc", axes, axes))
    assert products[:, ~np.eye(3, dtype=bool)].max() < 0.08
    assert (np.sort(near_frames(), axis=0)[0] != np.sort(near_frames(), axis=0)[2]).all()


@examples(0.5)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 3.0))
def test_a_cube_with_a_bump_passes_along_it(seed: int, bump_mm: float) -> None:
    """Only the right frame tells which axis is the widest: a coarse one may stand the cube on another face."""
    rng = np.random.default_rng(seed)
    corners_mm = 7.5 * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    top_mm = np.array([*rng.uniform(-7, 7, size=2), 7.5 + bump_mm])
    body = convex_body(Rotation.random(rng=rng).apply(np.vstack([corners_mm, top_mm])))
    edge_mm, axes = boxes.smallest_square(body)
    assert edge_mm < 15.015
    np.testing.assert_allclose(np.ptp(axes[:2] @ body.vertices_mm.T, axis=1).max(), edge_mm)
