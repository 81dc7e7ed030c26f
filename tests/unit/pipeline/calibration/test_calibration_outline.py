"""Balls in images: their outlines are accurate, and other bodies are refused."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import rendered
from support.synthetic_rigs import rig_of

from pipeline.calibration.ball_outline import ball_view, observe_ball
from pipeline.calibration.bundle_adjustment import N_CAMERA, Solution, linearized
from pipeline.calibration.drops import BallDrop, BallView
from pipeline.calibration.ellipse import fit_ellipse
from pipeline.calibration.sphere_image import sightings_of, view_offsets_px
from pipeline.frames import CameraId, FrameBundle
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation.background import learn_background
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.bodies import ball, cube
from pipeline.synthesis.bundles import render_bundle, render_empty, stream, without_views
from pipeline.synthesis.exposure import ExposureParameters
from pipeline.synthesis.renderer import simulate_rig

AT_MM = (4.0, -6.0, 5.0)
CAMERA = CameraId("c06")


@pytest.fixture(scope="module")
def bundle() -> FrameBundle:
    return rendered.bundle_of(rendered.placed(ball(), AT_MM), number=40)


def seen(bundle: FrameBundle) -> BallDrop:
    return observe_ball(bundle, rendered.background(), BackgroundSegmenter(), 10.0)


def offsets_px(drop: BallDrop, rig: RigCalibration, at_mm: Sequence[float]) -> np.ndarray:
    """Return by how much each view (V, 3) is too large, and off in u and v."""
    truth = Solution(
        initial=rig.cameras,
        parameters=np.zeros((len(rig.cameras), N_CAMERA)),
        centers_mm=np.array([at_mm]),
    )
    sightings = sightings_of([drop], rig.camera_ids)
    return view_offsets_px(sightings, linearized(truth, sightings).residuals_px)


def with_dot(bundle: FrameBundle, view: BallView, share: float) -> FrameBundle:
    """A dark dot of this share of the ball's radius stuck to it."""
    frame = bundle.frames[CAMERA]
    image = frame.image.copy()
    at_uv = np.rint(view.center_uv + view.radius_px * np.array([0.6, 0.8])).astype(int)
    cv2.circle(image, at_uv.tolist(), round(share * view.radius_px), 45, cv2.FILLED)
    return replace(bundle, frames={CAMERA: replace(frame, image=image)})


@pytest.mark.full
def test_outline_is_that_of_the_exact_projection(bundle: FrameBundle) -> None:
    drop = seen(bundle)
    assert not drop.refused
    found_px = offsets_px(drop, rendered.rig(), AT_MM)
    assert len(found_px) == 16
    assert abs(found_px[:, 0].mean()) < 0.01, "0.01 percent of every length"
    assert np.abs(found_px).max() < 0.04


def test_dot_at_the_edge_is_removed(bundle: FrameBundle) -> None:
    plain = seen(bundle).views[CAMERA]
    spotted = seen(with_dot(bundle, plain, 0.3)).views[CAMERA]
    assert len(spotted.outline_uv) < 0.95 * len(plain.outline_uv)
    assert np.linalg.norm(spotted.center_uv - plain.center_uv) < 0.03
    assert abs(spotted.radius_px - plain.radius_px) < 0.03


def test_body_that_hides_too_much_refuses_the_view(bundle: FrameBundle) -> None:
    drop = seen(with_dot(bundle, seen(bundle).views[CAMERA], 1.2))
    assert not drop.views
    assert "not a ball" in drop.refused[CAMERA] or "not round" in drop.refused[CAMERA]


def test_cut_off_ball_is_refused_where_it_is_cut_off() -> None:
    drop = seen(rendered.bundle_of(rendered.placed(ball(), (24.0, 3.0, -2.0)), number=41))
    assert drop.refused
    assert all("cut off" in reason for reason in drop.refused.values())
    whole_px = offsets_px(drop, rendered.rig(), (24.0, 3.0, -2.0))
    assert np.abs(whole_px).max() < 0.05, "what is kept is sound"


def test_cube_is_no_ball() -> None:
    bundle = rendered.bundle_of(rendered.placed(cube(10.0)), number=42)
    drop = seen(replace(bundle, frames={CAMERA: bundle.frames[CAMERA]}))
    assert set(drop.refused) == {CAMERA}


def test_missing_images_are_told(bundle: FrameBundle) -> None:
    lost = [camera for camera in bundle.frames if camera != CAMERA]
    drop = seen(without_views(bundle, lost, "cable pulled"))
    assert set(drop.views) == {CAMERA}
    assert drop.refused["c01"] == "no image: cable pulled"


def test_motion_moves_neither_centre_nor_size() -> None:
    rig = rig_of("c05", "c10")
    simulated = simulate_rig(rig, stream(7, 0), ExposureParameters(exposure_us=100))
    background = learn_background({}, render_empty(simulated, stream(7, 1), sequence=1).frames)
    placed = rendered.placed(ball(), (3.0, 2.0, -4.0))
    bundle = render_bundle([placed], simulated, stream(7, 2), sequence=2)
    drop = observe_ball(bundle, background, BackgroundSegmenter(), 10.0)
    assert np.abs(offsets_px(drop, rig, (3.0, 2.0, -4.0))).max() < 0.05


def test_fall_time_is_a_difference_of_clocks(bundle: FrameBundle) -> None:
    later = replace(
        bundle,
        frames={
            camera: replace(frame, device_ns=frame.device_ns + 3_000_000)
            for camera, frame in bundle.frames.items()
        },
    )
    before, after = (observe_ball(each, {}, BackgroundSegmenter(), None).fall_ns for each in (bundle, later))
    assert before is not None
    assert after == before + 3_000_000


def test_view_without_background_is_refused(bundle: FrameBundle) -> None:
    silhouette = BackgroundSegmenter()(bundle.frames[CAMERA], {})
    assert ball_view(silhouette) == "the empty view of this camera is unknown"


@given(
    radius_px=st.floats(20, 400),
    ellipticity=st.floats(0, 0.005),
    tilt=st.floats(0, np.pi),
    hidden=st.floats(0, 0.3),
    bulge_px=st.floats(2, 60),
    seed=st.integers(0, 1000),
)
def test_ellipse_ignores_what_sticks_to_it(
    radius_px: float, ellipticity: float, tilt: float, hidden: float, bulge_px: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    angles = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    center_uv = rng.uniform(300, 900, size=2)
    radii_px = radius_px * (1 + ellipticity * np.cos(2 * (angles - tilt))) + rng.normal(0, 0.03, angles.shape)
    is_hidden = angles < 2 * np.pi * hidden
    radii_px[is_hidden] += bulge_px
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    ellipse = fit_ellipse(center_uv + radii_px[:, None] * directions)
    assert np.linalg.norm(ellipse.center_uv - center_uv) < 0.03
    assert ellipse.radius_px == pytest.approx(radius_px, abs=0.02)
    assert not ellipse.is_inlier[is_hidden].any()
    assert ellipse.is_inlier[~is_hidden].mean() > 0.97
