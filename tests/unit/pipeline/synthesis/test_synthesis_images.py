from dataclasses import replace

import cv2
import numpy as np
import pytest
import skimage.measure
from numpy.typing import NDArray
from support.synthetic_rigs import QUIET, rig_of, upright

from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.synthesis.background import DOT_RADIUS_MM, build_wall, render_backgrounds
from pipeline.synthesis.bodies import ball, cube, cylinder, sphere
from pipeline.synthesis.exposure import ExposureParameters, blur_kernel, expose
from pipeline.synthesis.renderer import PlacedBody, RenderedRig, photograph, simulate_rig
from pipeline.synthesis.stones import stone

C05, C07 = CameraId("c05"), CameraId("c07")


def simulated(rig: RigCalibration, parameters: ExposureParameters = QUIET, seed: int = 0) -> RenderedRig:
    return simulate_rig(rig, np.random.default_rng(seed), parameters)


@pytest.fixture(scope="module")
def full() -> RenderedRig:
    """One camera at full resolution."""
    return simulated(rig_of("c05"))


@pytest.fixture(scope="module")
def coarse() -> RenderedRig:
    """Two cameras in opposite quarters, 320 x 256."""
    return simulated(rig_of("c05", "c07", binning=4))


def darkening(rig: RenderedRig, placed: PlacedBody) -> NDArray[np.float64]:
    """Return the covered share of each pixel of the first camera: a black body absorbs all light."""
    black = replace(placed, body=replace(placed.body, grey=0.0))
    image = photograph([black], rig, np.random.default_rng(0))[C05]
    return 1 - image / rig.backgrounds[C05].radiance.astype(np.float64)


def moments(weights: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return centroid and variances (2,) as (u, v) of what is clearly covered."""
    weights = np.where(weights > 0.02, weights, 0)
    axes = np.arange(weights.shape[1]), np.arange(weights.shape[0])
    sums = weights.sum(axis=0), weights.sum(axis=1)
    centroid = np.array([np.average(x, weights=w) for x, w in zip(axes, sums, strict=True)])
    spread = [np.average((x - c) ** 2, weights=w) for x, w, c in zip(axes, sums, centroid, strict=True)]
    return centroid, np.array(spread)


def test_the_half_way_contour_is_the_outline(full: RenderedRig) -> None:
    covered = darkening(full, upright(sphere()))
    contour = max(skimage.measure.find_contours(covered, 0.5), key=len)
    center = full.rig.cameras[0].K[[1, 0], 2]
    radii_px = np.linalg.norm(contour - center, axis=1)
    expected_px = 6250 * 7.5 / np.sqrt(300**2 - 7.5**2)
    assert radii_px.mean() == pytest.approx(expected_px, abs=0.02)
    assert radii_px.std() < 0.05


def test_motion_blurs_along_the_fall_and_keeps_the_middle(full: RenderedRig) -> None:
    moving = replace(full, parameters=replace(QUIET, exposure_us=100))
    still_center, still_spread = moments(darkening(full, upright(ball())))
    center, spread = moments(darkening(moving, upright(ball())))
    assert np.abs(center - still_center).max() < 0.02
    # an even sweep of length L adds L^2 / 12; the camera looks up by 18 degrees
    length_px = 2430 * 100e-6 * 6250 / 300 * np.cos(np.deg2rad(18))
    assert spread[1] - still_spread[1] == pytest.approx(length_px**2 / 12, rel=0.1)
    assert abs(spread[0] - still_spread[0]) < 0.2


@pytest.mark.parametrize("motion_uv", [(0.0, 0.0), (0.0, 1.0), (3.0, -4.0)])
def test_the_kernel_has_the_variance_of_lens_and_motion(motion_uv: tuple[float, float]) -> None:
    kernel = blur_kernel(0.7, np.array(motion_uv))
    assert kernel.sum() == pytest.approx(1, abs=1e-6)
    assert np.allclose(kernel, kernel[::-1, ::-1])
    radius = len(kernel) // 2
    v, u = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    assert (kernel * u**2).sum() == pytest.approx(0.49 + motion_uv[0] ** 2 / 12, rel=0.01)
    assert (kernel * v**2).sum() == pytest.approx(0.49 + motion_uv[1] ** 2 / 12, rel=0.01)


def test_edges_are_as_wide_as_the_lens_makes_them(full: RenderedRig) -> None:
    """Across a straight edge the profile is an error function of the lens's and the pixel's width."""
    covered = darkening(full, upright(cube(), offset_mm=(0, 0, 0)))
    row = covered[512]
    slopes = np.abs(np.diff(row[: row.argmax()]))
    assert slopes.max() == pytest.approx(1 / np.sqrt(2 * np.pi * (0.49 + 1 / 12)), rel=0.2)


def test_equal_seeds_give_equal_pixels() -> None:
    rig = rig_of("c05", "c07", binning=4)
    images = []
    for seed in (1, 1, 2):
        rng = np.random.default_rng(seed)
        scene = simulate_rig(rig, rng)
        images.append(photograph([upright(stone("flaky", 20, rng))], scene, rng))
    assert all(np.array_equal(images[0][camera], images[1][camera]) for camera in rig.camera_ids)
    assert not any(np.array_equal(images[0][camera], images[2][camera]) for camera in rig.camera_ids)


def test_stones_are_dark_and_textured_on_a_bright_ground(coarse: RenderedRig) -> None:
    body = stone("irregular", 25, np.random.default_rng(3))
    lit = replace(coarse, parameters=ExposureParameters())
    image = photograph([upright(body)], lit, np.random.default_rng(0))[C05]
    inside = image[108:148, 140:180].astype(float)
    assert 40 < inside.mean() < 90
    assert 3 < inside.std() < 25
    assert 160 < np.median(image[:, :60]) < 235
    # no dark rim: the outermost ring of the body is about as bright as its inside
    covered = darkening(coarse, upright(body)) > 0.995
    ring = covered & ~cv2.erode(covered.astype(np.uint8), np.ones((9, 9))).astype(bool)
    assert image[ring].mean() == pytest.approx(inside.mean(), rel=0.25)


def test_two_bodies_are_seen_apart(coarse: RenderedRig) -> None:
    pair = [upright(ball(), (0, -9, 0)), upright(cylinder(), (0, 9, 0))]
    image = photograph(pair, coarse, np.random.default_rng(0))[C05]
    dark = (image < 100).astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(dark)
    assert (stats[1:, cv2.CC_STAT_AREA] > 1000).sum() == 2


def test_the_nearer_body_hides_the_farther(coarse: RenderedRig) -> None:
    # c05 looks along (-1, 0, 0) turned by 45 degrees of azimuth, c07 from the other side
    toward = coarse.rig.cameras[0].center_mm / 300
    pale, dark = replace(ball(), grey=120.0), replace(ball(), grey=30.0)
    pair = [upright(pale, 15 * toward), upright(dark, -15 * toward)]
    for bodies in (pair, pair[::-1]):
        images = photograph(bodies, coarse, np.random.default_rng(0))
        assert images[C05][128, 160] > 90
    facing = coarse.rig.cameras[1].center_mm / 300
    pair = [upright(pale, -15 * facing), upright(dark, 15 * facing)]
    assert photograph(pair, coarse, np.random.default_rng(0))[C07][128, 160] < 60


def test_a_body_cut_by_the_border_is_the_same_where_it_is_seen() -> None:
    rig = rig_of("c05", binning=4)
    camera = rig.cameras[0]
    K = camera.K.copy()
    K[1, 2] -= 120  # the same camera, its sensor 120 px lower
    low = replace(rig, cameras=(replace(camera, K=K),))
    body = upright(sphere())
    whole, cut = darkening(simulated(rig), body), darkening(simulated(low), body)
    assert cut[0].max() > 0.99
    np.testing.assert_allclose(cut[:100], whole[120:220], atol=0.02)


def test_a_body_beyond_the_view_leaves_it_empty(coarse: RenderedRig) -> None:
    empty = photograph([], coarse, np.random.default_rng(0))
    far = photograph([upright(ball(), (0, 0, 60))], coarse, np.random.default_rng(0))
    assert all(np.array_equal(empty[camera], far[camera]) for camera in empty)


def test_empty_frames_share_their_pattern_and_differ_by_the_flash(coarse: RenderedRig) -> None:
    flickering = replace(coarse, parameters=replace(QUIET, flash_sd=0.01))
    rng = np.random.default_rng(0)
    images = [photograph([], flickering, rng)[C05].astype(float) for _ in range(40)]
    background = coarse.backgrounds[C05].radiance
    flashes = np.array([image.sum() / background.sum(dtype=np.float64) for image in images])
    assert 0.006 < flashes.std() < 0.014
    for image, flash in zip(images, flashes, strict=True):
        assert np.abs(image - flash * background).max() < 0.6  # rounding


def test_noise_grows_with_the_light() -> None:
    parameters = ExposureParameters()
    rng = np.random.default_rng(0)
    sigmas = []
    for grey in (50.0, 200.0):
        image = expose(np.full((300, 300), grey, dtype=np.float32), parameters, rng)
        assert image.mean() == pytest.approx(grey, abs=0.05)
        sigmas.append(image.std())
    # rounding adds 1/12 to 0.8^2 + 0.016 x grey
    assert sigmas == pytest.approx([np.sqrt(0.64 + 0.8 + 1 / 12), np.sqrt(0.64 + 3.2 + 1 / 12)], rel=0.02)


def test_every_view_is_bright_and_uneven_with_a_few_dark_dots() -> None:
    rig = as_built(nominal_rig(), 3).subset(CameraId(f"c{i:02d}") for i in (1, 6, 9, 14, 16))
    counts = []
    for background in simulated(rig).backgrounds.values():
        radiance = background.radiance
        assert 165 < np.median(radiance) < 230
        assert radiance.max() < 250
        assert np.ptp(cv2.resize(radiance, (5, 4), interpolation=cv2.INTER_AREA)) > 5
        _, _, stats, _ = cv2.connectedComponentsWithStats(
            (radiance < 0.7 * np.median(radiance)).astype(np.uint8)
        )
        whole = [
            area
            for left, top, width, height, area in stats[1:]
            if left > 0 and top > 0 and left + width < 1280 and top + height < 1024
        ]
        radii_px = np.sqrt(np.array(whole) / np.pi)
        assert ((radii_px > 3) & (radii_px < 45)).all()
        counts.append(len(whole))
    assert 0.5 <= np.mean(counts) <= 4


def test_the_aperture_of_an_opposite_camera_is_where_the_geometry_puts_it() -> None:
    rig = nominal_rig()
    camera = rig.cameras[4]
    opposite = replace(camera, id=CameraId("c99"), R=camera.R @ np.diag([-1, -1, 1]))
    opposite = replace(opposite, t_mm=-opposite.R @ (-camera.center_mm))
    pair = replace(rig, cameras=(camera, opposite))
    rng = np.random.default_rng(0)
    wall = build_wall(pair, rng)
    is_dot = wall.disc_radii_mm <= DOT_RADIUS_MM[1]
    bare = replace(wall, disc_reflectances=np.where(is_dot, 1.0, wall.disc_reflectances))
    radiance = render_backgrounds(pair, bare, rng)[camera.id].radiance
    dark = radiance < 0.5 * np.median(radiance)
    v, u = np.nonzero(dark)
    expected_uv = camera.project(opposite.center_mm[None, :])[0][0]
    assert np.abs([u.mean(), v.mean()] - expected_uv).max() < 1
    assert np.sqrt(dark.sum() / np.pi) == pytest.approx(12 / 600 * 6250, rel=0.03)


def test_no_aperture_and_no_hole_is_in_a_nominal_view() -> None:
    rig = nominal_rig()
    rng = np.random.default_rng(0)
    wall = build_wall(rig, rng)
    is_dot = wall.disc_radii_mm <= DOT_RADIUS_MM[1]
    bare = replace(wall, disc_reflectances=np.where(is_dot, 1.0, wall.disc_reflectances))
    views = render_backgrounds(rig.subset([CameraId("c02"), CameraId("c07")]), bare, rng)
    for background in views.values():
        assert background.radiance.min() > 0.6 * np.median(background.radiance)
