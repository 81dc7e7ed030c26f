"""What a lens of finite aperture does to an image: discs of wall and surface, vignetting, glare, presets."""

from dataclasses import replace

import numpy as np
import pytest
from support.extents import first_quick
from support.synthetic_rigs import QUIET, rig_of, upright

from pipeline.arrays import FloatImage
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration
from pipeline.synthesis.background import DOT_RADIUS_MM, build_wall, render_backgrounds
from pipeline.synthesis.bodies import ball, sphere
from pipeline.synthesis.exposure import LENS_PRESETS, ExposureParameters, LensPreset, expose
from pipeline.synthesis.pixel_coverage import window_around
from pipeline.synthesis.renderer import PlacedBody, illuminate, photograph, simulate_rig, view_of
from pipeline.synthesis.shading import surface_image
from pipeline.synthesis.thin_lens import ThinLens, disc_kernel

C05, C07 = CameraId("c05"), CameraId("c07")
BLACK_SPHERE = upright(replace(sphere(), grey=0.0))


def radiance_of(rig: RigCalibration, parameters: ExposureParameters, *bodies: PlacedBody) -> FloatImage:
    """Return what the first camera sees, before the sensor."""
    simulated = simulate_rig(rig, np.random.default_rng(0), parameters)
    surfaces = [illuminate(placed, np.random.default_rng(0)) for placed in bodies]
    return view_of(surfaces, rig.cameras[0], simulated).radiance()


@pytest.mark.parametrize(("focal_px", "px_per_mm"), [(6250, 0.868), (6818, 0.947)])
def test_the_published_lens_blurs_by_almost_a_pixel_for_each_mm(focal_px: float, px_per_mm: float) -> None:
    discs_px = ThinLens(f_number=2.0).disc_px(np.array([299.5, 300.0, 300.5]), focal_px)
    assert discs_px[1] == 0
    assert discs_px[[0, 2]] == pytest.approx(px_per_mm / 2, rel=0.01)


@pytest.mark.parametrize("diameter_px", [0.0, 0.4, 3.0, 11.7, 32.5])
def test_a_disc_is_even_and_loses_no_light(diameter_px: float) -> None:
    kernel = disc_kernel(diameter_px)
    assert kernel.sum() == pytest.approx(1, abs=1e-5)
    assert np.array_equal(kernel, kernel[::-1, ::-1])
    u = np.arange(len(kernel)) - len(kernel) // 2
    assert (kernel * u**2).sum() == pytest.approx(diameter_px**2 / 16, abs=0.18)  # pixels add 1/6


def test_the_wall_is_blurred_by_a_disc_of_its_own() -> None:
    """Seen from 600 mm the aperture of a camera opposite has a radius of 125 px, the disc at F2.0 one of 65."""
    rig = rig_of("c05")
    camera = rig.cameras[0]
    opposite = replace(camera, id=CameraId("c99"), R=camera.R @ np.diag([-1, -1, 1]))
    opposite = replace(opposite, t_mm=-opposite.R @ (-camera.center_mm))
    pair = replace(rig, cameras=(camera, opposite))
    wall = build_wall(pair, np.random.default_rng(0))
    dark, pale = (
        replace(wall, disc_reflectances=np.where(wall.disc_radii_mm <= DOT_RADIUS_MM[1], 1.0, aperture))
        for aperture in (0.1, 0.9)
    )

    def row(lens: ThinLens | None) -> FloatImage:
        """Return how dark the aperture is, 0..1, along the middle row of the image."""
        seen = [
            render_backgrounds(pair, each, np.random.default_rng(0), lens)[camera.id].radiance[512]
            for each in (dark, pale)
        ]
        missing = seen[1] - seen[0]
        return missing / missing.max()

    sharp, f8, f2 = row(None), row(ThinLens(f_number=8.0)), row(ThinLens(f_number=2.0))

    def width_px(values: FloatImage) -> float:
        """Return the width of the aperture's left border, from 10 to 90 % of its depth."""
        at_px = np.interp([0.1, 0.9], values[400:640], np.arange(400, 640))
        return float(at_px[1] - at_px[0])

    # a disc of diameter d rises from 10 to 90 % over 0.687 d; the disc's own border is curved
    assert width_px(f2) == pytest.approx(0.687 * 130, rel=0.1)
    assert width_px(f8) == pytest.approx(0.687 * 32.6, rel=0.15)
    assert width_px(sharp) == pytest.approx(2.563 * 8, rel=0.15)


def test_the_surface_is_blurred_by_the_disc_of_its_own_depth() -> None:
    """Texture is kept where the sphere is in focus and lost where it is nearest to the camera, 7 mm before it."""
    camera = rig_of("c05").cameras[0]
    surface = illuminate(upright(replace(sphere(), contrast=0.5)), np.random.default_rng(0))
    pixels_uv, depths_mm = camera.project(surface.mesh.vertices)
    face_disc_px = ThinLens(f_number=2.0).disc_px(depths_mm, camera.focal_px)[surface.mesh.faces].mean(axis=1)
    window = window_around(pixels_uv, 8)
    sharp = surface_image(surface.scene, surface.face_radiance, camera, window)
    blurred = surface_image(surface.scene, surface.face_radiance, camera, window, face_disc_px)

    def roughness(image: FloatImage, inner_px: float, outer_px: float) -> float:
        v, u = np.indices(image.shape)
        from_middle = np.hypot(u - image.shape[1] / 2, v - image.shape[0] / 2)
        ring = (from_middle >= inner_px) & (from_middle < outer_px)
        return float(np.abs(image - np.roll(image, 2, axis=1))[ring].mean())

    assert roughness(blurred, 0, 40) < 0.6 * roughness(sharp, 0, 40)
    assert roughness(blurred, 148, 154) > 0.75 * roughness(sharp, 148, 154)
    assert blurred.mean() == pytest.approx(sharp.mean(), rel=0.01)


def test_vignetting_darkens_wall_and_body_alike_to_the_corners() -> None:
    rig = rig_of("c05")
    plain, shaded = (
        radiance_of(rig, replace(QUIET, lens=ThinLens(f_number=2.0, corner_loss=loss)), upright(sphere()))
        for loss in (0.0, 0.2)
    )
    share = shaded / plain
    assert share[0, 0] == pytest.approx(0.8, abs=1e-3)
    assert share[512, 640] == pytest.approx(1, abs=1e-4)
    v, u = np.indices(share.shape)
    squared = ((u - 639.5) ** 2 + (v - 511.5) ** 2) / (640**2 + 512**2)
    np.testing.assert_allclose(share, 1 - 0.2 * squared, atol=1e-4)


def test_the_image_of_an_even_wall_falls_by_the_fourth_power_of_the_cosine() -> None:
    camera = rig_of("c05").cameras[0]
    seen = ThinLens(f_number=8.0).vignetting(camera)
    ray = camera.rays(np.array([[0.0, 0.0]]))[0]
    assert seen[0, 0] == pytest.approx((ray @ camera.R[2]) ** 4, rel=1e-5)


def test_glare_lightens_what_is_dark_beside_the_wall_and_conserves_light() -> None:
    rig = rig_of("c05")
    clean, glaring = (
        radiance_of(rig, replace(QUIET, lens=ThinLens(f_number=8.0, glare_share=share)), BLACK_SPHERE)
        for share in (0.0, 0.02)
    )
    assert glaring.mean() == pytest.approx(clean.mean(), rel=1e-3)
    middle, rim = glaring[512, 640], glaring[512, 640 + 145]
    assert clean[512, 640] < 1e-3
    wall_share = np.exp(
        -(156.3**2) / (2 * 60**2)
    )  # of the spread around the middle that lies beyond the sphere
    assert middle == pytest.approx(0.02 * clean.max() * wall_share, rel=0.1)
    assert 0.3 < rim / (0.02 * clean.max()) < 0.5


@pytest.mark.parametrize("full_well_e", [5_000.0, 20_000.0])
def test_noise_is_that_of_the_electrons(full_well_e: float) -> None:
    parameters = ExposureParameters().with_sensor(full_well_e=full_well_e, read_noise_e=30.0)
    image = expose(np.full((400, 400), 200.0, np.float32), parameters, np.random.default_rng(0))
    electrons = 200 / 255 * full_well_e
    sigma_grey = np.sqrt(electrons + 30**2) * 255 / full_well_e
    assert image.std() == pytest.approx(np.sqrt(sigma_grey**2 + 1 / 12), rel=0.01)


def test_the_defaults_are_a_sensor_of_16_000_electrons() -> None:
    default = ExposureParameters()
    sensor = default.with_sensor(full_well_e=15_937.5, read_noise_e=50.0)
    assert (sensor.shot_noise, sensor.read_noise) == pytest.approx((default.shot_noise, default.read_noise))


def test_sharp_is_the_default_and_the_others_are_their_f_numbers() -> None:
    assert LENS_PRESETS[LensPreset.SHARP] == ExposureParameters()
    f_numbers = {
        name: preset.lens.f_number for name, preset in LENS_PRESETS.items() if preset.lens is not None
    }
    assert f_numbers == {LensPreset.F2: 2.0, LensPreset.F4: 4.0, LensPreset.F8: 8.0}


@pytest.mark.parametrize("preset", first_quick(LensPreset))
def test_the_nearer_body_hides_the_farther_through_any_lens(preset: LensPreset) -> None:
    rig = rig_of("c05", "c07", binning=4)
    pale, dark = replace(ball(), grey=120.0), replace(ball(), grey=30.0)
    simulated = simulate_rig(rig, np.random.default_rng(0), LENS_PRESETS[preset])
    toward = rig.cameras[0].center_mm / 300
    pair = [upright(pale, 15 * toward), upright(dark, -15 * toward)]
    for bodies in (pair, pair[::-1]):
        assert photograph(bodies, simulated, np.random.default_rng(0))[C05][128, 160] > 90
    facing = rig.cameras[1].center_mm / 300
    pair = [upright(pale, -15 * facing), upright(dark, 15 * facing)]
    assert photograph(pair, simulated, np.random.default_rng(0))[C07][128, 160] < 60


@pytest.mark.parametrize(
    "fault", [{"f_number": 0.0}, {"focus_mm": -1.0}, {"corner_loss": 1.0}, {"glare_share": -0.1}]
)
def test_impossible_lenses_are_refused(fault: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(fault))):
        ThinLens(**{"f_number": 2.0, **fault})
