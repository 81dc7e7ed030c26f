"""Compiled loops mark the same pixels as numpy and OpenCV."""

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.extents import examples

from pipeline.segmentation.background import COARSE, coarsen
from pipeline.segmentation.light import EVEN, LIGHT_BLOCK, MAX_WALL_DEVIATION
from pipeline.segmentation.local_threshold import OPEN, RegionLevels, threshold, trimap_of
from pipeline.segmentation.pixel_comparison import (
    DARK,
    DIFFERS,
    NOISE_GREY,
    Thresholds,
    background_trimap,
    compare,
    sampled,
)
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN

THRESHOLDS = Thresholds(gain=np.float32(0.9), min_contrast=np.float32(0.12), dark=np.uint8(100))
CROSS = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3)), np.uint8)
DISC = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5)), np.uint8)

seeds = st.integers(0, 2**32 - 1)
sides = st.integers(1, 40)


def view(height: int, width: int, seed: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return a wall with dark dots, and an image of it with blobs before it."""
    rng = np.random.default_rng(seed)
    wall = np.full((height, width), 200, np.uint8)
    wall[rng.random((height, width)) < 0.02] = 40
    blobs = cv2.blur(rng.random((height, width), np.float32), (5, 5)) > 0.5
    return wall, np.where(blobs, np.uint8(60), np.uint8(0.9 * wall))


def reference(seen: NDArray[np.uint8], wall: NDArray[np.uint8]) -> NDArray[np.uint8]:
    behind = np.float32(0.9) * wall.astype(np.float32)
    differs = np.abs(seen - behind) > np.float32(0.12) * behind + NOISE_GREY
    return np.where(wall < 100, DARK, differs * DIFFERS)


@given(st.integers(4, 160), st.integers(4, 160), seeds)
@examples(0.3)
def test_a_pixel_of_each_block_is_compared_and_the_light_of_larger_ones(
    height: int, width: int, seed: int
) -> None:
    wall, image = view(height, width, seed)
    samples, empty = sampled(image), sampled(wall)
    lit = coarsen(coarsen(wall.astype(np.float32)))
    is_plain = lit > 150
    assert samples.shape == (height // COARSE, width // COARSE)
    np.testing.assert_array_equal(samples, image[2::COARSE, 2::COARSE][: len(samples), : samples.shape[1]])
    marks, light = np.empty_like(samples), np.empty_like(lit)
    *box, n_uneven = compare(samples, empty, empty, lit, is_plain, THRESHOLDS, marks, light)
    np.testing.assert_array_equal(marks, reference(samples, empty))
    rows, columns = np.nonzero(marks == DIFFERS)
    if len(rows):
        assert box == [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    else:
        assert box[3] == 0
    if min(samples.shape) < LIGHT_BLOCK:
        assert n_uneven == 0
        return
    ratio = coarsen(samples.astype(np.float32)) / (np.float32(0.9) * lit)
    np.testing.assert_allclose(light, ratio, rtol=1e-5)
    error = np.abs(light - 1)
    assert n_uneven == np.count_nonzero(is_plain & (error > EVEN) & (error < MAX_WALL_DEVIATION))


@given(sides, sides, seeds)
@examples(0.6)
def test_the_core_is_eroded_and_the_possible_dilated(height: int, width: int, seed: int) -> None:
    """By a disc and a cross; beyond the border nothing differs."""
    wall, image = view(height, width, seed)
    trimap = background_trimap(image, wall, wall, THRESHOLDS)
    marks = reference(image[::2, ::2], wall[::2, ::2])
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
    np.testing.assert_array_equal(trimap, trimap_of(core, possible, unknown))


@given(sides, sides, st.integers(0, 1), seeds)
@examples(0.3)
def test_what_is_open_is_decided_by_the_level_beside_it_and_the_rest_is_as_it_was(
    height: int, width: int, odd: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    trimap = rng.choice([INSIDE, UNKNOWN, OUTSIDE, OPEN], (height, width))
    image = rng.integers(20, 200, (2 * height - odd, 2 * width - odd), np.uint8)
    wall = np.full_like(image, 130)
    labels, levels, is_inside = threshold(RegionLevels(image, wall, np.float32(1), trimap), 0.12)
    of_pixels = trimap.repeat(2, axis=0).repeat(2, axis=1)[: image.shape[0], : image.shape[1]]
    np.testing.assert_array_equal(labels[of_pixels != OPEN], of_pixels[of_pixels != OPEN])
    for y, x in np.argwhere(trimap == OPEN):
        near = (slice(max(y // 2 * 2 - 2, 0), y // 2 * 2 + 4), slice(max(x // 2 * 2 - 2, 0), x // 2 * 2 + 4))
        core = image[::2, ::2][near][trimap[near] == INSIDE]
        level = levels[y // 2, x // 2]
        if len(core):
            np.testing.assert_allclose(level, core.mean(), rtol=1e-6)
        contrast, covered = 130 - level, 130 - image[2 * y : 2 * y + 2, 2 * x : 2 * x + 2].astype(np.float32)
        found = np.where((covered - contrast / 2) * contrast > 0, INSIDE, OUTSIDE)
        found = np.full_like(found, UNKNOWN) if abs(contrast) < np.float32(0.12) * 130 else found
        np.testing.assert_array_equal(labels[2 * y : 2 * y + 2, 2 * x : 2 * x + 2], found)
    assert is_inside == (INSIDE in labels)
