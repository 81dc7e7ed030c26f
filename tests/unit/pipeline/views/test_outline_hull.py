"""The corners of an outline's hull against what defines them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples

from pipeline.segmentation.silhouette import is_beside_gap
from pipeline.views.outline_hull import hull_corners, is_edge_seen, stack_outlines

ANGLES = np.linspace(0, 2 * np.pi, 500)
OUTWARDS = np.stack([np.cos(ANGLES), np.sin(ANGLES)])


def outline(seed: int, n: int, grid: bool) -> np.ndarray:
    """A bumpy closed curve; on a grid many points share a row, a column or even a place."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(n) / n
    radius = 40 * (1 + 0.2 * np.cos(3 * angle + rng.uniform(0, 6))) + rng.normal(size=n)
    points = np.stack([600 + radius * np.cos(angle), 500 + radius * np.sin(angle)], axis=1)
    return np.round(points) if grid else points


@examples(0.4)
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(3, 200), max_size=4), st.booleans())
def test_the_corners_reach_as_far_as_all_points_and_turn_one_way(
    seed: int, lengths: list[int], grid: bool
) -> None:
    outlines = stack_outlines([outline(seed + n, n, grid) for n in lengths])
    corners, is_closed = hull_corners(outlines)
    trusted = is_edge_seen(outlines, corners, 1)
    for view, n in enumerate(lengths):
        points = outline(seed + n, n, grid)
        n_corners = len(np.unique(corners[view]))
        assert (corners[view, n_corners:] == corners[view, 0]).all()
        hull = outlines.points_uv[corners[view, :n_corners]]
        np.testing.assert_allclose((hull @ OUTWARDS).max(axis=0), (points @ OUTWARDS).max(axis=0), rtol=1e-12)
        ahead, behind = np.roll(hull, -1, axis=0) - hull, hull - np.roll(hull, 1, axis=0)
        assert (behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0] > 0).all()
        gaps = is_beside_gap(points)
        assert np.array_equal(trusted[view], ~gaps[corners[view] - outlines.ends[view]])
        assert is_closed[view] == (not gaps.any())


def test_near_a_gap_no_corner_is_trusted() -> None:
    angle = 2 * np.pi * np.delete(np.arange(600), range(300, 310)) / 600
    circle = 500 + 100 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    outlines = stack_outlines([circle, circle])
    corners, _ = hull_corners(outlines)
    assert corners.shape == (2, len(circle))
    for reach in (1, 5):
        trusted = is_edge_seen(outlines, corners, reach)
        for view in range(2):
            doubtful = corners[view, ~trusted[view]] - view * len(circle)
            assert set(doubtful) == set(range(300 - reach, 300 + reach))
