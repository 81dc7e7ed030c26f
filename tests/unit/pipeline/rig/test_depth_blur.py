"""The a-priori width of an edge."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.rig.cameras import Lens
from pipeline.rig.depth_blur import SIGMA_OF_DISC, expected_sigma_px
from pipeline.rig.design import nominal_rig

LENS = Lens(focal_length_mm=25.0, f_number=2.0, focus_mm=300.0, blur_px=0.9)
CAMERA = replace(nominal_rig().cameras[0], lens=LENS)


def test_ten_millimetres_out_of_focus_is_the_published_disc() -> None:
    sigmas_px = expected_sigma_px(CAMERA, np.array([300.0, 310.0]))
    assert sigmas_px is not None
    assert sigmas_px[0] == pytest.approx(0.9)
    disc_px = 6250 * 12.5 * (1 / 300 - 1 / 310)  # 8.4
    assert sigmas_px[1] == pytest.approx(np.hypot(0.9, SIGMA_OF_DISC * disc_px))


def test_sigma_of_a_disc_is_what_the_width_of_its_edge_is_measured_as() -> None:
    x = np.linspace(-0.5, 0.5, 20001)
    line = np.sqrt(0.25 - x**2)  # the disc, summed along the edge
    coverage = np.cumsum(line) / line.sum()
    spread = (coverage * (1 - coverage)).sum() * (x[1] - x[0])
    assert pytest.approx(np.sqrt(np.pi) * spread, rel=1e-4) == SIGMA_OF_DISC


def test_without_a_lens_nothing_is_expected() -> None:
    assert expected_sigma_px(nominal_rig().cameras[0], np.array([300.0])) is None


@given(st.floats(0.5, 30), st.floats(0.5, 30), st.sampled_from([-1, 1]))
def test_edges_widen_away_from_the_focus(near_mm: float, further_mm: float, side: int) -> None:
    depths_mm = 300 + side * np.array([0, near_mm, near_mm + further_mm])
    sigmas_px = expected_sigma_px(CAMERA, depths_mm)
    assert sigmas_px is not None
    assert sigmas_px[0] < sigmas_px[1] < sigmas_px[2]
