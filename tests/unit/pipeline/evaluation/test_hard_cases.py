"""Hard views are reproducible, and their truth is what was rendered."""

from functools import cache

import cv2
import numpy as np
import pytest
from support.extents import first_quick

from pipeline.evaluation.hard_cases import HardCase, HardView, hard_view
from pipeline.segmentation.light import flash_gain


@cache
def view(case: HardCase, seed: int = 31, with_background: bool = True) -> HardView:
    return hard_view(case, seed, with_background=with_background, size_mm=14.0)


def expected(hard: HardView) -> np.ndarray:
    """Return what the empty rig would show in this flash, without any disturbance."""
    known = hard.background[hard.frame.camera]
    return known.mean * flash_gain(hard.frame.image.astype(np.float32), known.mean)


@pytest.mark.parametrize("case", first_quick(HardCase))
def test_every_case_has_a_body_whose_truth_is_known(case: HardCase) -> None:
    hard = view(case)
    shape = hard.frame.image.shape
    assert hard.case is case
    assert hard.coverage.shape == hard.contrast.shape == shape == (1024, 1280)
    assert hard.background[hard.frame.camera].mean.shape == shape
    assert hard.coverage.min() >= -1e-5
    assert hard.coverage.max() == pytest.approx(1, abs=1e-5)
    # 14 mm are up to 290 px
    assert 2_000 < hard.coverage.sum() < (66_000 if case is not HardCase.SEVERAL else 200_000)
    assert not hard.contrast[hard.coverage <= 0].any()


def test_the_same_seed_gives_the_same_view() -> None:
    first, again = view(HardCase.DUST), hard_view(HardCase.DUST, 31, size_mm=14.0)
    assert np.array_equal(first.frame.image, again.frame.image)
    assert np.array_equal(first.coverage, again.coverage)
    assert not np.array_equal(first.frame.image, view(HardCase.DUST, 32).frame.image)


def test_what_was_photographed_covers_as_much_as_the_truth_says() -> None:
    hard = view(HardCase.CLEAN)
    behind = expected(hard)
    missing = np.clip(behind - hard.frame.image, 0, None)[hard.coverage > 0]
    covered = missing.sum() / np.median((behind - hard.frame.image)[hard.coverage > 0.999])
    assert covered == pytest.approx(hard.coverage.sum(), rel=0.05)  # the stone is mottled
    is_far = hard.coverage == 0
    assert np.abs(hard.frame.image - behind)[is_far].mean() < 2.5


def test_the_truth_is_in_focus_where_the_image_is_not() -> None:
    def dark_px_beside_body(hard: HardView) -> int:
        is_dark = hard.frame.image < 0.9 * expected(hard)
        near = cv2.dilate((hard.coverage > 0).astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
        return np.count_nonzero(is_dark & near & (hard.coverage < 0.02))

    assert dark_px_beside_body(view(HardCase.CLEAN)) < 50
    assert dark_px_beside_body(view(HardCase.DEFOCUS)) > 500  # of an outline of about 600 px


def test_a_view_without_background_knows_of_none() -> None:
    assert view(HardCase.DUST, with_background=False).background == {}


def test_an_aperture_lies_behind_the_edge_of_a_stone_as_dark() -> None:
    hard = view(HardCase.APERTURE)
    behind = hard.background[hard.frame.camera].mean
    at_edge = np.abs(hard.coverage - 0.5) < 0.3
    before_aperture = at_edge & (behind < 40)
    assert before_aperture.sum() > 0.1 * at_edge.sum()
    assert np.median(hard.contrast[before_aperture]) < 50 < np.median(hard.contrast[at_edge & (behind > 150)])


def test_dust_and_shadow_are_not_in_the_background() -> None:
    for case in (HardCase.DUST, HardCase.SHADOW):
        hard = view(case)
        ratio = (hard.frame.image / expected(hard))[hard.coverage == 0]
        assert np.ptp(np.quantile(ratio, [0.02, 0.98])) > 0.1


def test_a_wet_stone_mirrors_the_light() -> None:
    wet, dry = (
        view(case).frame.image[view(case).coverage > 0.999] for case in (HardCase.WET, HardCase.CLEAN)
    )
    assert np.quantile(wet, 0.995) > 1.5 * np.quantile(dry, 0.995)


@pytest.mark.full
def test_there_are_several_bodies_and_fragments() -> None:

    for case in (HardCase.SEVERAL, HardCase.FRAGMENTS):
        contours, _ = cv2.findContours(
            (view(case).coverage > 0.5).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
        )
        assert len(contours) > 1
