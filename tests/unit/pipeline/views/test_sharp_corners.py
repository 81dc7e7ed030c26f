"""Corners of outlines that a blur has rounded are put back, and what is round by itself is left."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.views.outline_hull import stack_outlines
from pipeline.views.sharp_corners import sharpened

Array = NDArray[np.float64]
SIZE_PX, FINE = 160, 8


def blurred_outline(polygon_px: Array, sigma_px: float) -> Array:
    """The half level of a polygon's Gaussian blur, in points about a pixel apart."""
    image = np.zeros((SIZE_PX * FINE, SIZE_PX * FINE), np.uint8)
    cv2.fillPoly(image, [np.rint(polygon_px * FINE * 16).astype(np.int32)], 255, shift=4)
    blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma_px * FINE)
    contours, _ = cv2.findContours(
        (blurred > 127.5).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    return contours[0][::FINE, 0] / FINE


def regular(n_corners: int, radius_px: float = 60.0) -> Array:
    angles = 0.3 + 2 * np.pi / n_corners * np.arange(n_corners)
    return SIZE_PX / 2 + radius_px * np.column_stack([np.cos(angles), np.sin(angles)])


def reach_of(points_uv: Array, polygon_px: Array) -> Array:
    """How far points reach beyond each corner of a regular polygon, from its middle."""
    outwards = (polygon_px - SIZE_PX / 2) / np.linalg.norm(polygon_px[0] - SIZE_PX / 2)
    return ((points_uv - SIZE_PX / 2) @ outwards.T).max(axis=0) - np.linalg.norm(polygon_px[0] - SIZE_PX / 2)


def at_corners(outline_uv: Array, polygon_px: Array, sigma_px: float) -> Array:
    chosen = ((outline_uv - SIZE_PX / 2) @ (polygon_px - SIZE_PX / 2).T).argmax(axis=0)[None]
    return sharpened(stack_outlines([outline_uv]), np.array([sigma_px]), chosen)[0]


@pytest.mark.parametrize("sigma_px", [1.0, 2.5])
@pytest.mark.parametrize("n_corners", [4, 6])
def test_a_blurred_corner_is_put_back(n_corners: int, sigma_px: float) -> None:
    polygon_px = regular(n_corners)
    outline_uv = blurred_outline(polygon_px, sigma_px)
    assert reach_of(outline_uv, polygon_px).max() < -0.3 * sigma_px
    moved_uv = at_corners(outline_uv, polygon_px, sigma_px)
    assert np.abs(reach_of(moved_uv, polygon_px)).max() < 0.15 * sigma_px + 0.1


def test_an_arc_stays() -> None:
    polygon_px = regular(400)
    outline_uv = blurred_outline(polygon_px, 1.0)
    moved_uv = at_corners(outline_uv, polygon_px, 1.0)
    assert np.abs(reach_of(moved_uv, polygon_px)).max() < 0.15


def test_without_blur_or_beside_a_gap_nothing_moves() -> None:
    polygon_px = regular(4)
    outline_uv = blurred_outline(polygon_px, 1.0)
    chosen = ((outline_uv - SIZE_PX / 2) @ (polygon_px - SIZE_PX / 2).T).argmax(axis=0)[None]
    still_uv = sharpened(stack_outlines([outline_uv]), np.zeros(1), chosen)
    np.testing.assert_array_equal(still_uv, outline_uv[chosen])
    corner = int(chosen[0, 0])
    gapped_uv = np.delete(np.roll(outline_uv, -corner, axis=0), np.arange(5, 10), axis=0)
    moved_uv = sharpened(stack_outlines([gapped_uv]), np.ones(1), np.zeros((1, 1), np.int64))
    np.testing.assert_array_equal(moved_uv[0], gapped_uv[:1])


def test_no_outline_reaches_beyond_its_polygon() -> None:
    rng = np.random.default_rng(3)
    turns = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    outwards = np.array([np.cos(turns), np.sin(turns)])
    squares_before = squares_after = 0.0
    for _ in range(20):
        angles = np.sort(rng.uniform(0, 2 * np.pi, size=7))
        polygon_px = SIZE_PX / 2 + 60 * np.column_stack([np.cos(angles), np.sin(angles)])
        outline_uv = blurred_outline(polygon_px, 1.5)
        chosen = (outline_uv @ outwards).argmax(axis=0)[None]
        moved_uv = sharpened(stack_outlines([outline_uv]), np.array([1.5]), chosen)[0]
        beyond_px = (moved_uv @ outwards).max(axis=0) - (polygon_px @ outwards).max(axis=0)
        before_px = (outline_uv @ outwards).max(axis=0) - (polygon_px @ outwards).max(axis=0)
        assert beyond_px.max() < 0.5
        squares_before += np.square(before_px).sum()
        squares_after += np.square(beyond_px).sum()
    assert squares_after < 0.7 * squares_before  # corners of more than 100 degrees stay
