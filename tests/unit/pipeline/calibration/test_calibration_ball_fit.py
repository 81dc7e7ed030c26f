import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.ball_drops import ball_view, drop

from pipeline.calibration.ball_fit import fit_ball
from pipeline.calibration.drops import BallDrop
from pipeline.rig.cameras import CameraCalibration
from pipeline.rig.design import as_built, nominal_rig

RIG = as_built(nominal_rig(), 4)
OFFSET = st.floats(-9, 9)


@given(center_mm=st.tuples(OFFSET, OFFSET, OFFSET), diameter_mm=st.floats(5, 20))
def test_an_exact_ball_is_found_where_it_is(center_mm: tuple[float, float, float], diameter_mm: float):
    fit = fit_ball(drop("ball", RIG, center_mm, diameter_mm), RIG)
    assert fit is not None
    assert fit.center_mm == pytest.approx(center_mm, abs=1e-5)
    assert fit.diameter_mm == pytest.approx(diameter_mm, abs=1e-5)
    assert fit.vertical_minus_horizontal_mm == pytest.approx(0, abs=1e-5)
    assert max(fit.residuals_px.values()) < 1e-3


@given(uneven_mm=st.floats(-0.3, 0.3), edge_px=st.floats(-0.5, 0.5))
def test_blur_shows_and_the_edge_does_not_look_like_it(uneven_mm: float, edge_px: float):
    views = {camera.id: ball_view(uneven_outline_uv(camera, uneven_mm)) for camera in RIG.cameras}
    fit = fit_ball(BallDrop(name="ball", diameter_mm=10.0, views=views), RIG)
    assert fit is not None
    assert fit.vertical_minus_horizontal_mm == pytest.approx(uneven_mm, abs=2e-3)
    exact = fit_ball(drop("ball", RIG, (1, 2, 3), edge_offset_px=edge_px), RIG)
    assert exact is not None
    assert exact.vertical_minus_horizontal_mm == pytest.approx(0, abs=2e-3)


def uneven_outline_uv(camera: CameraCalibration, uneven_mm: float) -> np.ndarray:
    """The outline of a ball of 10 mm at the centre whose radius grows with the vertical part of its normal."""
    away_mm = -camera.center_mm
    distance_mm = float(np.linalg.norm(away_mm))
    axis = away_mm / distance_mm
    right = np.cross(axis, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    angle = np.linspace(0, 2 * np.pi, 120, endpoint=False)[:, None]
    around = np.cos(angle) * right + np.sin(angle) * np.cross(axis, right)
    radius_mm = 5 + uneven_mm / 2 * (around[:, 2:] ** 2 - 1 / 3)
    sine = radius_mm / distance_mm
    directions = np.sqrt(1 - sine**2) * axis + sine * around
    return camera.project(camera.center_mm + distance_mm * directions)[0]


def test_a_camera_that_was_turned_stands_out():
    turned = RIG.cameras[5]
    seen = drop("ball", RIG, (1.0, 2.0, -3.0))
    shifted = ball_view(seen.views[turned.id].outline_uv + np.array([3.0, 0.0]))
    views = {**seen.views, turned.id: shifted}
    fit = fit_ball(BallDrop(name="ball", diameter_mm=10.0, views=views), RIG)
    assert fit is not None
    assert max(fit.residuals_px, key=lambda camera: fit.residuals_px[camera]) == turned.id
    assert fit.residuals_px[turned.id] == pytest.approx(3.0, rel=0.15)


def test_one_view_is_no_ball():
    seen = drop("ball", RIG, (0.0, 0.0, 0.0))
    first = RIG.cameras[0].id
    alone = BallDrop(name="ball", diameter_mm=10.0, views={first: seen.views[first]})
    assert fit_ball(alone, RIG) is None
