"""The rectangle of an image that the network sees, and the background in it."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.segmentation.background import COARSE
from pipeline.segmentation.lit_background import LitBackground
from pipeline.segmentation.network_region import Region, region_around, whole_image_region


def test_squares_hold_what_is_looked_at() -> None:
    shape = (1024, 1280)
    square = region_around((900, 700, 300, 200), 44, shape, 256, 256)
    assert (square.scale, square.width, square.height) == (2, 256, 256)
    rows, columns = square.within(shape)
    assert (rows.stop - rows.start, columns.stop - columns.start) == (512, 512)
    assert rows.start <= 656 < 944 <= rows.stop
    assert columns.start <= 856 < 1244 <= columns.stop
    near = region_around((900, 700, 300, 200), 44, shape, 256, 16)
    assert (near.scale, near.width, near.height) == (2, 224, 160)
    all_of = whole_image_region(shape, 256, 256)
    assert (all_of.scale, all_of.left, all_of.top) == (5, 0, -128)
    assert all_of.within(shape) == (slice(0, 1024), slice(0, 1280))
    part, (rows, columns) = all_of.part((10, 100, 20, 30), 20)
    assert part == Region(left=0, top=272, scale=5, width=52, height=72)
    assert (rows, columns) == (slice(80, 152), slice(0, 52))


@given(
    st.integers(0, 1200),
    st.integers(0, 900),
    st.integers(1, 400),
    st.integers(1, 400),
    st.integers(0, 44),
    st.sampled_from([16, 256]),
)
def test_rectangles_hold_a_box_and_begin_with_a_block(
    x: int, y: int, width: int, height: int, margin_px: int, step: int
) -> None:
    shape = (1022, 1279)
    width, height = min(width, shape[1] - x), min(height, shape[0] - y)
    square = region_around((x, y, width, height), margin_px, shape, 256, step)
    assert (square.left % COARSE, square.top % COARSE) == (0, 0)
    assert (square.width % step, square.height % step) == (0, 0)
    assert max(square.width, square.height) <= 256
    rows, columns = square.within(shape)
    near_px = max(margin_px - COARSE // 2 - 1, 0)
    last_u, last_v = (length // COARSE * COARSE for length in reversed(shape))  # where the last block ends
    assert columns.start <= max(x - near_px, 0)
    assert min(x + width + near_px, last_u) <= columns.stop
    assert rows.start <= max(y - near_px, 0)
    assert min(y + height + near_px, last_v) <= rows.stop


@pytest.mark.parametrize("box", [(0, 0, 1280, 1024), (500, 300, 100, 100), (1000, 800, 250, 200)])
@pytest.mark.parametrize("step", [16, 256])
def test_there_and_back_again(box: tuple[int, int, int, int], step: int) -> None:
    """A smooth image survives the way to the network's pixels and back."""
    v, u = np.mgrid[:1024, :1280].astype(np.float32)
    smooth = 100 + 50 * np.sin(u / 200) * np.cos(v / 170)
    image = np.rint(smooth).astype(np.uint8)
    region = region_around(box, 0, image.shape, 256, step)
    reduced, sampled = (np.empty((region.height, region.width), np.float32) for _ in range(2))
    region.reduce(image, 1.0, reduced)
    region.sample(cv2.resize(smooth, (320, 256), interpolation=cv2.INTER_AREA), 0.5, sampled)
    inside = (slice(region.height // 6, -region.height // 6), slice(region.width // 6, -region.width // 6))
    np.testing.assert_allclose(2 * sampled[inside], reduced[inside], atol=1.0)
    rows, columns = region.within(image.shape)
    back = region.enlarged(reduced, image.shape)
    np.testing.assert_allclose(back[5:-5, 5:-5], smooth[rows, columns][5:-5, 5:-5], atol=1.0)
    mask = (reduced > 100).view(np.uint8)
    blocks = region.halved(mask, image.shape)
    assert np.mean(blocks != (image[rows, columns] > 100)[::2, ::2]) < 0.03
    at_centres = region.at_centres(image[rows, columns], image.shape)
    assert np.abs(at_centres - reduced)[at_centres > 0].max() < 1.5
    assert np.count_nonzero(at_centres) * region.scale**2 == pytest.approx(
        image[rows, columns].size, rel=0.04
    )


@pytest.mark.parametrize("box", [(0, 0, 1280, 1024), (1000, 800, 250, 200)])
def test_the_background_is_computed_where_it_is_needed(
    box: tuple[int, int, int, int],
) -> None:
    rng = np.random.default_rng(3)
    shape = (1024, 1280)
    empty = rng.integers(50, 200, shape).astype(np.uint8)
    region = region_around(box, 0, shape, 256, 16)
    place = region.within(shape)
    light = np.linspace(0.9, 1.1, region.width, dtype=np.float32) + np.zeros((region.height, 1), np.float32)
    view = LitBackground(region=region, shape=shape, light=light, levels=np.ascontiguousarray(empty[place]))
    needed = (rng.random(light.shape) < 0.4).view(np.uint8)
    at = tuple(
        (np.arange(part.start, part.stop) - first) // region.scale
        for part, first in zip(place, (region.top, region.left), strict=True)
    )
    image = np.rint(empty[place] * light[np.ix_(*at)]).astype(np.uint8)
    everywhere = np.where(needed[np.ix_(*at)], image, 0)
    np.testing.assert_allclose(view.lit_levels(needed).astype(int), everywhere.astype(int), atol=1)
    assert not view.differing(image, needed, 0.02, 1.0).any()
    changed = image - 10 * (np.ix_(*at)[1] > region.width // 2).astype(np.uint8)
    found = view.differing(changed, needed, 0.0, 5.0)
    right = np.arange(region.width) > region.width // 2 + 1
    inner = slice(30, -30)
    np.testing.assert_array_equal(found[inner, inner][:, right[inner]], needed[inner, inner][:, right[inner]])
    assert not found[:, : region.width // 2].any()
