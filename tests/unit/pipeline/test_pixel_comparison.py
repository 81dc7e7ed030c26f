"""What compiled loops mark is what numpy and OpenCV say, pixel by pixel."""

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.segmentation.comparison import (
    DARK,
    DIFFERS,
    NOISE_GREY,
    Thresholds,
    limits_around,
    marked,
    sampled,
)
from pipeline.segmentation.grey_levels import OPEN, limits_from, spread
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN

THRESHOLDS = Thresholds(gain=np.float32(0.9), min_contrast=np.float32(0.12), dark=np.uint8(100))
CROSS = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3)), np.uint8)
DISC = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5)), np.uint8)

seeds = st.integers(0, 2**32 - 1)
sides = st.integers(1, 40)


def view(height: int, width: int, seed: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """A wall with dark dots, and an image of it with blobs before it."""
    rng = np.random.default_rng(seed)
    wall = np.full((height, width), 200, np.uint8)
    wall[rng.random((height, width)) < 0.02] = 40
    blobs = cv2.blur(rng.random((height, width), np.float32), (5, 5)) > 0.5
    return wall, np.where(blobs, np.uint8(60), np.uint8(0.9 * wall))


def reference(seen: NDArray[np.uint8], wall: NDArray[np.uint8]) -> NDArray[np.uint8]:
    behind = np.float32(0.9) * wall.astype(np.float32)
    differs = np.abs(seen - behind) > np.float32(0.12) * behind + NOISE_GREY
    return np.where(wall < 100, DARK, differs * DIFFERS)


@given(sides, sides, seeds)
@settings(max_examples=30)
def test_the_middle_of_each_block_is_sampled(height: int, width: int, seed: int) -> None:
    _, image = view(height, width, seed)
    expected = image[2::4, 2::4][: height // 4, : width // 4]
    np.testing.assert_array_equal(sampled(image), expected)


@given(sides, sides, seeds)
@settings(max_examples=30)
def test_what_differs_is_marked_and_what_is_dark(height: int, width: int, seed: int) -> None:
    wall, image = view(height, width, seed)
    np.testing.assert_array_equal(marked(image, wall, wall, THRESHOLDS), reference(image, wall))


@given(sides, sides, st.integers(0, 9), st.integers(0, 9), seeds)
@settings(max_examples=60)
def test_the_core_is_eroded_and_the_possible_dilated(
    height: int, width: int, left: int, top: int, seed: int
) -> None:
    """By a disc and a cross; beyond the border nothing differs."""
    wall, picture = view(height + top, width + left, seed)
    image = picture[top:, left:].copy()
    levels = wall[top:].copy()  # begins elsewhere
    limits = limits_around(picture, wall, (left, top), levels, (left, 0), image.shape, THRESHOLDS)
    marks = reference(image[::2, ::2], wall[top::2, left::2])
    differs = np.pad((marks == DIFFERS).view(np.uint8), 2)
    is_dark = np.pad((marks == DARK).view(np.uint8), 2)
    core, possible, unknown = (
        mask[2:-2, 2:-2] > 0
        for mask in (
            cv2.erode(differs, DISC),
            cv2.dilate(differs, CROSS),
            cv2.dilate(is_dark, np.ones((3, 3), np.uint8)),
        )
    )
    np.testing.assert_array_equal(limits, limits_from(core, possible, unknown))


@given(sides, sides, seeds)
@settings(max_examples=30)
def test_limits_are_spread_over_pixels(height: int, width: int, seed: int) -> None:
    limits = np.random.default_rng(seed).choice([INSIDE, UNKNOWN, OUTSIDE, OPEN], (height, width))
    ends, twice = spread(limits)
    labels = np.where(limits == OPEN, OUTSIDE, limits)
    is_open = np.pad(limits == OPEN, ((0, 0), (1, 1)))
    np.testing.assert_array_equal(ends, np.argwhere(is_open[:, 1:] != is_open[:, :-1]))
    np.testing.assert_array_equal(twice.view(np.uint8), labels.repeat(2, axis=0).repeat(2, axis=1))
