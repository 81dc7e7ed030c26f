"""Errors of silhouettes of discs, where every error is known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.special import ndtr
from support.extents import examples

from pipeline.evaluation.silhouette_errors import VISIBLE_GREY, silhouette_errors, true_edge, true_status
from pipeline.evaluation.silhouette_picture import (
    CAPTION_PX,
    COLUMNS,
    MARGIN_SHARE,
    PANEL_PX,
    TITLE_PX,
    silhouette_picture,
)
from pipeline.frames import CameraId
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN, Silhouette, ViewStatus
from pipeline.segmentation.subtraction import SegmentationParameters

WIDTH, HEIGHT = 160, 120
MIDDLE = (80.0, 60.0)
RADIUS_PX = 30.0


def radii(center_uv: tuple[float, float]) -> NDArray[np.float64]:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    return np.hypot(u - center_uv[0], v - center_uv[1])


def disc(radius_px: float, center_uv: tuple[float, float] = MIDDLE) -> NDArray[np.float32]:
    """Return the coverage (H, W) by a disc behind a lens that blurs 0.7 px."""
    return ndtr((radius_px - radii(center_uv)) / 0.7).astype(np.float32)


def silhouette(
    labels: NDArray[np.uint8], radius_px: float = RADIUS_PX, center_uv: tuple[float, float] = MIDDLE
) -> Silhouette:
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    outline_uv = radius_px * np.stack([np.cos(angle), np.sin(angle)], axis=1) + center_uv
    return Silhouette(
        camera=CameraId("c01"),
        status=ViewStatus.OK,
        image_size_px=(WIDTH, HEIGHT),
        labels=labels,
        outline_uv=outline_uv,
    )


def labels_of(radius_px: float, center_uv: tuple[float, float] = MIDDLE) -> NDArray[np.uint8]:
    return np.where(radii(center_uv) < radius_px, INSIDE, OUTSIDE)


DISC = disc(RADIUS_PX)
PERFECT = labels_of(RADIUS_PX)
WHOLE = true_edge(DISC)


@examples(0.2)
@given(
    radius_px=st.floats(15, 40),
    shift_u=st.floats(-0.5, 0.5),
    shift_v=st.floats(-0.5, 0.5),
    too_large_px=st.floats(-2.5, 2.5),
)
def test_an_outline_too_large_by_so_much_is_biased_by_so_much(
    radius_px: float, shift_u: float, shift_v: float, too_large_px: float
) -> None:
    center_uv = (MIDDLE[0] + shift_u, MIDDLE[1] + shift_v)
    truth = true_edge(disc(radius_px, center_uv))
    drawn_px = radius_px + too_large_px
    errors = silhouette_errors(silhouette(labels_of(drawn_px, center_uv), drawn_px, center_uv), truth)
    assert errors.bias_px == pytest.approx(too_large_px, abs=0.01)
    assert errors.rms_px == pytest.approx(abs(too_large_px), abs=0.01)
    assert errors.seen_share == 1
    ratio = (drawn_px / radius_px) ** 2
    assert errors.iou == pytest.approx(min(ratio, 1 / ratio), abs=1 / radius_px)  # to whole pixels
    assert errors.unknown_share == 0


def test_a_shifted_outline_has_no_bias_but_a_root_mean_square() -> None:
    errors = silhouette_errors(silhouette(PERFECT, center_uv=(MIDDLE[0] + 1, MIDDLE[1])), WHOLE)
    assert errors.bias_px == pytest.approx(0, abs=0.03)
    assert errors.rms_px == pytest.approx(np.sqrt(0.5), abs=0.02)  # of cos over all angles


def test_a_perfect_silhouette_has_no_errors() -> None:
    errors = silhouette_errors(silhouette(PERFECT), WHOLE)
    assert errors.iou > 0.99
    assert errors.wrong_share == 0
    assert errors.seen_share == 1
    assert errors.rms_px < 0.03


def test_unknown_pixels_are_neither_right_nor_wrong() -> None:
    labels = PERFECT.copy()
    labels[:, : int(MIDDLE[0])] = UNKNOWN
    errors = silhouette_errors(silhouette(labels), WHOLE)
    assert errors.iou > 0.99
    assert errors.wrong_share == 0
    assert errors.unknown_share == pytest.approx(0.5, abs=0.03)


def test_what_is_wrong_with_certainty_is_counted_beyond_the_rim() -> None:
    missing, added = PERFECT.copy(), PERFECT.copy()
    missing[55:65, 75:85] = OUTSIDE
    added[5:15, 5:15] = INSIDE
    area = np.count_nonzero(DISC > 0.5)
    for labels in (missing, added):
        errors = silhouette_errors(silhouette(labels), WHOLE)
        assert errors.wrong_share == pytest.approx(100 / area)
        assert errors.iou < silhouette_errors(silhouette(PERFECT), WHOLE).iou
    a_pixel_larger = silhouette_errors(silhouette(labels_of(RADIUS_PX + 0.9)), WHOLE)
    assert a_pixel_larger.wrong_share == 0


def test_edges_are_judged_where_they_are_visible_only() -> None:
    contrast = np.full_like(DISC, 2 * VISIBLE_GREY)
    contrast[:, : int(MIDDLE[0])] = VISIBLE_GREY / 2
    truth = true_edge(DISC, contrast)
    assert truth.is_visible.mean() == pytest.approx(0.5, abs=0.02)
    found = silhouette(PERFECT)
    astray = found.outline_uv.copy()
    astray[found.outline_uv[:, 0] < MIDDLE[0] - 1, 0] -= 2.0
    errors = silhouette_errors(replace(found, outline_uv=astray), truth)
    assert errors.rms_px < 0.1
    assert len(errors.offsets_px) == pytest.approx(len(found.outline_uv) / 2, abs=6)
    assert silhouette_errors(replace(found, outline_uv=astray), WHOLE).rms_px > 1


def test_the_share_of_the_outline_that_was_seen() -> None:
    found = silhouette(PERFECT)
    right = found.outline_uv[found.outline_uv[:, 0] > MIDDLE[0]]
    assert silhouette_errors(replace(found, outline_uv=right), WHOLE).seen_share == pytest.approx(
        0.5, abs=0.05
    )
    assert silhouette_errors(silhouette(PERFECT, RADIUS_PX + 4), WHOLE).seen_share == 0
    none = silhouette_errors(replace(found, outline_uv=np.zeros((0, 2))), WHOLE)
    assert none.seen_share == 0
    assert np.isnan(none.bias_px)
    assert np.isnan(none.rms_px)


def test_the_largest_body_counts() -> None:
    both = np.maximum(DISC, disc(8, (20.0, 20.0)))
    truth = true_edge(both)
    assert np.array_equal(truth.body, WHOLE.body)
    assert silhouette_errors(silhouette(PERFECT), truth).rms_px < 0.03


def test_a_body_cut_by_the_image_has_a_closed_edge() -> None:
    truth = true_edge(disc(RADIUS_PX, (0.0, MIDDLE[1])))
    assert np.linalg.norm(np.diff(truth.points_uv, axis=0, append=truth.points_uv[:1]), axis=1).max() < 1.5
    assert truth.body.sum() == pytest.approx(np.pi * RADIUS_PX**2 / 2, rel=0.03)


@pytest.mark.parametrize(
    ("coverage", "status"),
    [
        (DISC, ViewStatus.OK),
        (disc(5), ViewStatus.EMPTY),
        (np.maximum(DISC, disc(11, (20.0, 20.0))), ViewStatus.MULTIPLE),
        (np.maximum(DISC, disc(8, (20.0, 20.0))), ViewStatus.OK),
        (disc(RADIUS_PX, (0.0, MIDDLE[1])), ViewStatus.CLIPPED),
    ],
)
def test_what_should_be_said_of_a_view(coverage: NDArray[np.float32], status: ViewStatus) -> None:
    assert true_status(coverage, SegmentationParameters()) is status


def test_a_silhouette_starts_where_its_region_does() -> None:
    rows, columns = slice(20, 100), slice(40, 130)
    found = replace(silhouette(PERFECT[rows, columns]), offset_uv=(columns.start, rows.start))
    assert silhouette_errors(found, WHOLE).iou == silhouette_errors(silhouette(PERFECT), WHOLE).iou


def test_nothing_to_compare_is_refused() -> None:
    with pytest.raises(ValueError, match="no body"):
        true_edge(np.zeros((HEIGHT, WIDTH), np.float32))
    with pytest.raises(ValueError, match="camera c01: a view that is empty"):
        silhouette_errors(replace(silhouette(PERFECT), status=ViewStatus.EMPTY), WHOLE)
    with pytest.raises(ValueError, match="camera c01: the silhouette is of an image"):
        silhouette_errors(replace(silhouette(PERFECT), image_size_px=(WIDTH + 1, HEIGHT)), WHOLE)


def test_a_picture_shows_what_is_wrong() -> None:
    labels = PERFECT.copy()
    labels[58:62, 78:82] = UNKNOWN
    image = np.where(DISC > 0.5, 60, 200).astype(np.uint8)
    contrast = np.where(np.arange(WIDTH) < MIDDLE[0], 0, 2 * VISIBLE_GREY).astype(np.float32)
    truth = true_edge(DISC, np.broadcast_to(contrast, DISC.shape))
    found = {"good": (silhouette(labels), ""), "too small": (silhouette(PERFECT, RADIUS_PX / 2), "a remark")}
    picture = silhouette_picture(image, truth, DISC > 0.5, found, "a disc")
    assert picture.shape == (TITLE_PX + PANEL_PX + CAPTION_PX, COLUMNS * PANEL_PX, 3)
    good, too_small, blank = np.split(picture[TITLE_PX : TITLE_PX + PANEL_PX].astype(int), COLUMNS, axis=1)
    middle = PANEL_PX // 2
    red, green, blue = good[middle, middle]  # orange over the stone
    assert red > green > blue
    assert (good[:5, :5] == 200).all()
    # the true edge is blue at the left, green at the right, where it is visible; a red line is inside of it
    left, right = too_small[middle, :middle], too_small[middle, middle:]
    assert (left[:, 2] - left[:, 0]).max() > 100
    assert (right[:, 1] - right[:, 0]).max() > 100
    scale = PANEL_PX / (2 * RADIUS_PX * (1 + 2 * MARGIN_SHARE))
    redness = right[:, 0] - right[:, 1]
    assert abs(int(np.argmax(redness)) - RADIUS_PX / 2 * scale) < 3
    assert (blank == 255).all()
