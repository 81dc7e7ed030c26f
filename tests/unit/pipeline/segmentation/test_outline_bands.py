"""Shares that differ around a body and at its rim, against dilations and erosions by OpenCV."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples

from pipeline.arrays import Mask
from pipeline.segmentation.outline_bands import BandImages, band_shares
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN


def grown(mask: Mask, blocks: int) -> Mask:
    square = np.ones((2 * blocks + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(mask.astype(np.uint8), square) > 0)


@examples(0.3)
@given(
    st.integers(0, 2**32 - 1), st.integers(4, 30), st.integers(4, 30), st.integers(0, 9), st.integers(0, 9)
)
def test_the_wall_beside_a_body_and_its_rim_are_compared(
    seed: int, n_rows: int, n_columns: int, left: int, top: int
) -> None:
    rng = np.random.default_rng(seed)
    seen, empty, wall = rng.integers(1, 256, (3, n_rows, n_columns), np.uint8)
    height, width = (
        rng.integers(min(8, 4 * n - at), 4 * n - at + 1) for n, at in ((n_rows, top), (n_columns, left))
    )
    body = cv2.blur(rng.random((height, width), np.float32), (9, 9))
    labels = np.where(body > 0.53, INSIDE, np.where(body > 0.5, UNKNOWN, OUTSIDE))
    images = BandImages(
        seen=seen, expected=empty, gain=np.float32(0.9), empty_rig=wall, min_wall_grey=np.uint8(90)
    )
    max_error, clear_contrast = rng.uniform(0, 2, 2)
    shares = band_shares(labels, (left, top), images, max_error, clear_contrast)

    first, last = -(-np.array([top, left]) // 4), np.array([top + height, left + width]) // 4
    place = tuple(slice(*at) for at in zip(first, last, strict=True))
    of_blocks = labels[4 * first[0] + 2 - top :: 4, 4 * first[1] + 2 - left :: 4]
    of_blocks = of_blocks[: last[0] - first[0], : last[1] - first[1]]
    inside, covered = of_blocks == INSIDE, of_blocks != OUTSIDE
    error = np.abs(cv2.blur(seen[place], (3, 3)) / (np.float32(0.9) * empty[place]) - 1)
    is_wall = wall[place] >= 90
    is_around = grown(inside, 8) & ~grown(covered, 2) & is_wall
    is_rim = ~grown(~covered, 1) & grown(~inside, 3) & is_wall
    differing, faint = error[is_around] > max_error, error[is_rim] <= clear_contrast
    assert shares.wall == pytest.approx(differing.mean() if differing.size else 0.0)
    assert shares.rim == pytest.approx(faint.mean() if faint.size else 0.0)
