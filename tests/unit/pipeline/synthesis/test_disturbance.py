"""Disturbances are physical: factors and summands of light, fixed to one camera."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from support import rendered

from pipeline.rig.cameras import CameraCalibration
from pipeline.synthesis.background import WALL_GREY
from pipeline.synthesis.bodies import sphere
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.disturbance import (
    DENSEST_DUST,
    VEIL_SHARE,
    Disturbance,
    cast_shadow,
    dimmed_sector,
    dust,
    flicker,
)
from pipeline.synthesis.renderer import RenderedRig, View, illuminate, photograph, simulate_rig, view_of

SIZE_PX = (1280, 1024)


@cache
def simulated() -> RenderedRig:
    """Two cameras of the rig."""
    rig = rendered.rig()
    return simulate_rig(rig.subset(rig.camera_ids[5:7]), np.random.default_rng(1))


@pytest.fixture(scope="module")
def camera() -> CameraCalibration:
    return simulated().rig.cameras[0]


def view(camera: CameraCalibration, disturbance: Disturbance) -> View:
    """Return the view of a sphere before the camera, always in the same light."""
    surface = illuminate(rendered.placed(sphere()), np.random.default_rng(0))
    return view_of([surface], camera, simulated(), disturbance)


@pytest.mark.parametrize("strength", [0.0, 0.2, 1.0])
def test_dust_leaves_the_mean_transmission_that_was_asked_for(strength: float) -> None:
    dusty = dust(strength, np.random.default_rng(3), SIZE_PX)

    transmission = np.asarray(dusty.transmission)
    assert transmission.mean() == pytest.approx(1 - DENSEST_DUST * strength, abs=2e-3)
    assert np.ptp(transmission) >= 0.3 * strength  # in patches
    np.testing.assert_allclose(dusty.veil, VEIL_SHARE * WALL_GREY * (1 - transmission), atol=1e-3)
    assert np.abs(np.diff(transmission, axis=0)).max() < 0.03  # out of focus


def test_dust_is_drawn_from_the_generator_alone() -> None:
    first, again, other = (dust(0.5, np.random.default_rng(seed), SIZE_PX) for seed in (1, 1, 2))
    assert np.array_equal(first.transmission, again.transmission)
    assert not np.array_equal(first.transmission, other.transmission)


def test_dust_dims_all_that_is_seen_and_veils_it(camera: CameraCalibration) -> None:
    dusty = dust(0.6, np.random.default_rng(4), SIZE_PX)
    clean = view(camera, Disturbance()).radiance()
    np.testing.assert_allclose(
        view(camera, dusty).radiance(), clean * dusty.transmission + dusty.veil, rtol=1e-5
    )


def test_flicker_is_one_factor(camera: CameraCalibration) -> None:
    clean = view(camera, Disturbance()).radiance()
    np.testing.assert_allclose(view(camera, flicker(0.6)).radiance(), 0.6 * clean, rtol=1e-4)


def test_a_shadow_lies_behind_the_body(camera: CameraCalibration) -> None:
    shadow = cast_shadow(0.6, np.random.default_rng(5), SIZE_PX)
    clean, shadowed = view(camera, Disturbance()), view(camera, shadow)
    layer = clean.layers[0]
    inside = layer.coverage > 0.999
    place = layer.rows, layer.columns
    behind = 0.001 * WALL_GREY  # of it is seen through the edge
    np.testing.assert_allclose(
        shadowed.radiance()[place][inside], clean.radiance()[place][inside], atol=behind
    )
    left = shadowed.wall / clean.wall
    assert left.min() == pytest.approx(0.4, abs=0.05)
    assert left.max() > 0.95


@pytest.mark.parametrize(("side", "darker"), [(-1, "wall"), (1, "body")])
def test_a_panel_that_fails_is_dark_itself_and_leaves_the_side_that_looks_at_it_dark(
    camera: CameraCalibration, side: int, darker: str
) -> None:
    dimmed = dimmed_sector(rendered.rig(), camera, 0.8, side * camera.center_mm)
    mean = {"wall": np.mean(dimmed.wall_light), "body": np.mean(dimmed.body_light)}
    other = {"wall": "body", "body": "wall"}[darker]
    assert mean[darker] < 0.85
    assert mean[other] > 0.98


def test_a_long_exposure_smears_along_the_fall(camera: CameraCalibration) -> None:
    def edge_px(profile: NDArray[np.float32]) -> float:
        """Return the width of the rise from 10 to 90 %."""
        rise = profile[: np.argmax(profile > 0.999)]
        return float(np.count_nonzero((rise > 0.1) & (rise < 0.9)))

    sharp, smeared = (view(camera, Disturbance(exposure_us=us)).layers[0].coverage for us in (20.0, 100.0))
    middle = smeared.shape[0] // 2, smeared.shape[1] // 2
    assert edge_px(smeared[:, middle[1]]) >= edge_px(sharp[:, sharp.shape[1] // 2]) + 2
    assert edge_px(smeared[middle[0]]) <= edge_px(sharp[sharp.shape[0] // 2]) + 1


def test_one_disturbed_camera_changes_no_other_view_and_no_disturbance_changes_nothing() -> None:
    first = simulated().rig.camera_ids[0]

    def images(disturbances: dict[str, Disturbance]) -> dict[str, NDArray[np.uint8]]:
        return photograph([], simulated(), stream(1, 2), disturbances)

    plain = images({})
    assert all(np.array_equal(plain[id], image) for id, image in images({first: Disturbance()}).items())
    noisy = images({first: Disturbance(read_noise=4.0)})
    assert {id for id, image in noisy.items() if not np.array_equal(plain[id], image)} == {first}
    noise = noisy[first].astype(float) - plain[first]
    assert 2 < noise.std() < 5  # the same random numbers, times more


@pytest.mark.parametrize("strength", [-0.1, 1.1])
def test_a_strength_is_a_share(strength: float) -> None:
    with pytest.raises(ValueError, match=r"strength must be 0\.\.1"):
        dust(strength, np.random.default_rng(0), SIZE_PX)
    with pytest.raises(ValueError, match=r"strength must be 0\.\.1"):
        cast_shadow(strength, np.random.default_rng(0), SIZE_PX)
