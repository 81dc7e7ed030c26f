"""What follows from the evidence: every cause makes the uncertainty greater, and the causes add up."""

from dataclasses import replace
from math import hypot, pi, sqrt

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples

from pipeline.uncertainty import Cause, Evidence, PixelSupport, ViewEvidence, uncertainty
from pipeline.uncertainty.model import UNSEEN_RISE

SHARP = ViewEvidence(
    pixel_mm=0.048,
    edge_sigma_px=1.0,
    motion_sigma_px=0.0,
    noise_grey=2.0,
    step_grey=140.0,
    undecided_share=0.0,
    calibration_px=0.05,
    tangency_px=0.05,
    residual_px=0.02,
)


def seen(n_views: int = 16, open_share: float = 0.0, **changed: float | None) -> Evidence:
    """Evidence of a 15 mm sphere whose views are all alike."""
    volume_mm3 = pi * 15**3 / 6
    return Evidence(
        views=(replace(SHARP, **changed),) * n_views,
        volume_mm3=volume_mm3,
        area_mm2=pi * 15**2,
        hull_mm3=1.007 * volume_mm3,
        is_estimated=True,
        length_sd_percent=0.05,
        open_share=open_share,
    )


VIEWS = st.builds(
    ViewEvidence,
    pixel_mm=st.floats(0.02, 0.2),
    edge_sigma_px=st.floats(0, 12),
    motion_sigma_px=st.floats(0, 12),
    noise_grey=st.floats(0, 60),
    step_grey=st.floats(10, 250),
    undecided_share=st.floats(0, 1),
    calibration_px=st.floats(0, 3),
    tangency_px=st.none() | st.floats(0, 50),
    residual_px=st.floats(0, 20),
)
EVIDENCE = st.builds(
    Evidence,
    views=st.lists(VIEWS, min_size=1, max_size=16).map(tuple),
    volume_mm3=st.floats(10, 1e5),
    area_mm2=st.floats(50, 1e5),
    hull_mm3=st.floats(10, 2e5),
    is_estimated=st.booleans(),
    length_sd_percent=st.floats(0, 5),
    open_share=st.floats(0, 1),
    pixels=st.builds(
        PixelSupport,
        share=st.floats(0, 1),
        blank_share=st.floats(0, 1),
        depth_mm=st.floats(0, 2),
        relief_mm=st.floats(0, 0.2),
    ),
)


@given(EVIDENCE)
@examples(0.5)
def test_variances_of_all_causes_add_up(evidence: Evidence) -> None:
    found = uncertainty(evidence)
    assert (
        set(found.surface_mm) == set(found.volume_percent) == set(Cause) - {Cause.RUSH}
    )  # a word for HIDDEN
    assert all(sd >= 0 for sd in (*found.surface_mm.values(), *found.volume_percent.values()))
    assert found.surface_sd_mm**2 == pytest.approx(sum(sd**2 for sd in found.surface_mm.values()))
    assert found.volume_sd_percent**2 == pytest.approx(sum(sd**2 for sd in found.volume_percent.values()))
    assert sum(found.by_cause.values()) == pytest.approx(1)


@pytest.mark.parametrize(
    ("cause", "changes"),
    [
        (Cause.FOCUS, [{"edge_sigma_px": px} for px in (1.0, 1.5, 3.0, 8.0)]),
        (Cause.MOTION, [{"edge_sigma_px": 9.0, "motion_sigma_px": px} for px in (0.0, 1.0, 3.0, 8.0)]),
        (Cause.CONTRAST, [{"step_grey": grey} for grey in (140.0, 100.0, 60.0)]),
        (Cause.NOISE, [{"noise_grey": grey} for grey in (1.0, 3.0, 7.0, 20.0)]),
        (Cause.NOISE, [{"step_grey": grey} for grey in (200.0, 100.0, 50.0)]),
        (Cause.UNSEEN, [{"open_share": share} for share in (0.0, 0.01, 0.1, 0.5, 1.0)]),
        (Cause.UNSEEN, [{"open_share": 0.5, "undecided_share": share} for share in (0.0, 0.01, 0.1, 0.5)]),
        (Cause.DISAGREEMENT, [{"tangency_px": px} for px in (0.3, 1.0, 10.0)]),
        (Cause.DISAGREEMENT, [{"residual_px": px} for px in (0.3, 1.0, 10.0)]),
        (Cause.CALIBRATION, [{"calibration_px": px} for px in (0.01, 0.1, 1.0)]),
    ],
)
def test_more_of_a_cause_is_more_uncertainty(cause: Cause, changes: list[dict[str, float]]) -> None:
    found = [uncertainty(seen(**changed)) for changed in changes]
    by_cause = [(each.surface_mm[cause], each.volume_percent[cause]) for each in found]
    assert by_cause == sorted(set(by_cause))


def test_motion_is_not_taken_for_defocus() -> None:
    moving = uncertainty(seen(edge_sigma_px=hypot(1.0, 3.0), motion_sigma_px=3.0)).surface_mm
    blurred = uncertainty(seen(edge_sigma_px=hypot(1.0, 3.0))).surface_mm
    assert moving[Cause.FOCUS] == pytest.approx(0, abs=1e-9)
    assert moving[Cause.MOTION] == pytest.approx(blurred[Cause.FOCUS])


def test_smoothing_against_noise_is_not_taken_for_defocus() -> None:
    noisy = uncertainty(seen(noise_grey=10.0, edge_sigma_px=hypot(1.0, 1.4))).surface_mm
    assert noisy[Cause.FOCUS] == pytest.approx(0, abs=1e-9)
    assert noisy[Cause.NOISE] > 0.01


def test_what_noise_explains_is_no_disagreement() -> None:
    quiet = uncertainty(seen(tangency_px=0.1)).surface_mm
    noisy = uncertainty(seen(tangency_px=0.1, noise_grey=12.0)).surface_mm
    assert noisy[Cause.DISAGREEMENT] == 0 < quiet[Cause.DISAGREEMENT]


def test_a_greater_gap_between_hull_and_body_is_more_uncertainty() -> None:
    gaps = [replace(seen(), hull_mm3=factor * seen().volume_mm3) for factor in (1.0, 1.01, 1.1, 1.3)]
    sds = [uncertainty(gap).surface_mm[Cause.VIEWS] for gap in gaps]
    assert sds[0] == 0
    assert sds == sorted(set(sds))
    as_hull = replace(gaps[1], is_estimated=False)
    assert uncertainty(as_hull).surface_mm[Cause.VIEWS] > 10 * sds[1]


def test_a_wrong_scale_moves_the_surface_as_it_does_a_sphere() -> None:
    """One percent of the length is 0.075 mm of the radius and three percent of the volume."""
    found = uncertainty(replace(seen(calibration_px=0.0), length_sd_percent=1.0))
    assert found.surface_mm[Cause.CALIBRATION] == pytest.approx(0.075)
    assert found.volume_percent[Cause.CALIBRATION] == pytest.approx(3)


def test_pixels_leave_dents_where_they_support_nothing_and_relief_where_they_do() -> None:
    shares_and_depths = (0.0, 1.0, 0.2), (0.5, 0.4, 0.1), (0.5, 0.4, 0.0), (1.0, 0.0, 0.2)
    hidden = [
        uncertainty(replace(seen(), pixels=PixelSupport(share=share, blank_share=blank, depth_mm=depth_mm)))
        for share, blank, depth_mm in shares_and_depths
    ]
    for sds in ("surface_mm", "volume_percent"):
        none_shown, half_dented, half_even, all_shown = (getattr(of, sds)[Cause.HIDDEN] for of in hidden)
        assert none_shown > half_dented > 2 * half_even > 2 * all_shown
    rough = uncertainty(replace(seen(), pixels=PixelSupport(share=1.0, blank_share=0.0, relief_mm=0.05)))
    assert rough.surface_mm[Cause.HIDDEN] > 0.05
    assert rough.volume_percent[Cause.HIDDEN] < 100 * 0.05 * seen().area_mm2 / seen().volume_mm3


def test_an_opening_that_no_view_decides_about_is_volume() -> None:
    """A tenth of each view's area unknown, of the surface open: a tenth of the volume and what rises, or less."""
    found = uncertainty(seen(open_share=0.1, undecided_share=0.1)).volume_percent[Cause.UNSEEN]
    assert found == pytest.approx(hypot(10, 100 * 0.1 * 3 * UNSEEN_RISE) / sqrt(3))


def test_what_one_view_leaves_unknown_and_others_see_is_known() -> None:
    assert uncertainty(seen(undecided_share=0.5)).surface_mm[Cause.UNSEEN] == 0


def test_what_pixels_show_is_not_unseen() -> None:
    shown = replace(seen(open_share=0.3), pixels=PixelSupport(share=1.0))
    assert uncertainty(shown).surface_mm[Cause.UNSEEN] == 0


def test_outlines_without_any_pair_still_have_an_uncertainty() -> None:
    assert uncertainty(seen(tangency_px=None)).surface_sd_mm > 0
