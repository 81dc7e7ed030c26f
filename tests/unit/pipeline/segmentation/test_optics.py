"""The optical figures of a view are what the renderer put into it."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import rendered
from support.extents import examples
from support.silhouettes import sphere_silhouette

from pipeline.frames import CameraId, Frame
from pipeline.segmentation.background import BackgroundModel, learn_background
from pipeline.segmentation.optics import (
    BLOCK_PX,
    MIN_LIGHT,
    SAMPLED_ROWS,
    SPOT_CONTRAST,
    SURROUNDINGS_BLOCKS,
    _fill_levels,
    _fill_light,
    _fit_plane,
    _spots_share,
    observe_all,
    observe_optics,
)
from pipeline.segmentation.silhouette import Silhouette, ViewStatus
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.bodies import sphere
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.disturbance import UNDISTURBED, Disturbance, dimmed_sector, dust, flicker
from pipeline.synthesis.exposure import ExposureParameters
from pipeline.synthesis.renderer import PlacedBody, RenderedRig, photograph, simulate_rig
from pipeline.view_optics import ViewOptics

C05 = CameraId("c05")
RIG = rendered.rig()
CAMERA = RIG.subset([C05]).cameras[0]
SIZE_PX = CAMERA.image_size_px
CENTER_MM = (0.5, -0.3, 0.2)
STILL = ExposureParameters(exposure_us=0.0, flash_sd=0.0, camera_flash_sd=0.0)


@cache
def view() -> RenderedRig:
    """One camera of the rig, flashes always equal, nothing moves."""
    return simulate_rig(RIG.subset([C05]), stream(5, 0), STILL)


def exposed(
    *bodies: PlacedBody,
    number: int = 0,
    trouble: Disturbance = UNDISTURBED,
    simulated: RenderedRig | None = None,
) -> Frame:
    images = photograph(bodies, simulated or view(), stream(5, 1, number), {C05: trouble})
    return Frame(camera=C05, image=images[C05], frame_id=number, device_ns=0, received_ns=0)


@cache
def background() -> BackgroundModel:
    model: BackgroundModel = {}
    for number in range(5):
        model = learn_background(model, {C05: exposed(number=100 + number)})
    return model


def of_empty(trouble: Disturbance) -> ViewOptics:
    optics = observe_optics(exposed(trouble=trouble), background(), None)
    assert optics is not None
    return optics


def of_sphere(simulated: RenderedRig | None = None, trouble: Disturbance = UNDISTURBED) -> ViewOptics:
    frame = exposed(rendered.placed(sphere(), CENTER_MM), number=1, simulated=simulated, trouble=trouble)
    optics = observe_optics(frame, background(), truth())
    assert optics is not None
    return optics


@cache
def truth() -> Silhouette:
    return sphere_silhouette(CAMERA, np.array(CENTER_MM), 7.5)


def transmitted(trouble: Disturbance) -> float:
    """Return the mean light on the wall with this disturbance, the veil included."""
    clean = view().backgrounds[C05].radiance
    is_wall = clean > 0.5 * np.median(clean)
    return float(np.mean((clean * trouble.transmission + trouble.veil)[is_wall] / clean[is_wall]))


def test_a_clean_view() -> None:
    for optics in (of_empty(UNDISTURBED), of_sphere()):
        assert optics.brightness == pytest.approx(1, abs=0.003)
        assert optics.gradient_uv == pytest.approx((0, 0), abs=0.002)
        assert optics.dust < 0.006
        assert optics.spots_share == 0
        assert optics.saturated_share == 0
        assert optics.noise_grey == pytest.approx(np.sqrt(0.8**2 + 0.016 * 200), rel=0.06)
    assert of_empty(UNDISTURBED).edge_width_px is None


@pytest.mark.parametrize("read_noise", [3.0, 5.0])
def test_noise(read_noise: float) -> None:
    optics = of_empty(Disturbance(read_noise=read_noise))
    # the background of five frames was learnt with less noise than is taken off for it
    assert optics.noise_grey == pytest.approx(np.sqrt(read_noise**2 + 0.016 * 200), rel=0.1)


@pytest.mark.parametrize("blur_px", [0.7, 1.4, 2.5])
def test_edge_width_is_that_of_the_blur(blur_px: float) -> None:
    simulated = replace(view(), parameters=replace(STILL, blur_px=blur_px))
    optics = of_sphere(simulated)
    assert optics.edge_width_px is not None
    # 10 to 90 % of a Gaussian; the pixel's own width and the interpolations of the profile add 0.4 px2
    assert optics.edge_width_px == pytest.approx(2.563 * np.sqrt(blur_px**2 + 0.4), rel=0.04)
    assert optics.contrast is not None
    assert 0.4 < optics.contrast < 0.9


def test_motion_widens_the_edge() -> None:
    moving = of_sphere(trouble=Disturbance(exposure_us=100.0))
    still = of_sphere()
    assert moving.edge_width_px is not None
    assert still.edge_width_px is not None
    assert moving.edge_width_px > still.edge_width_px + 0.7


def segmented(parameters: ExposureParameters) -> ViewOptics:
    """The figures of the sphere, exposed so, by the silhouette that is found of it."""
    simulated = replace(view(), parameters=parameters)
    frame = exposed(rendered.placed(sphere(), CENTER_MM), number=1, simulated=simulated)
    optics = observe_optics(frame, background(), BackgroundSegmenter()(frame, background()))
    assert optics is not None
    return optics


def test_an_edge_too_wide_for_a_profile_has_the_width_of_the_silhouette() -> None:
    optics = segmented(replace(STILL, blur_px=6.0))
    assert optics.edge_width_px == pytest.approx(2.563 * 6.0, rel=0.1)
    assert optics.edge_widths_uv_px == pytest.approx((2.563 * 6.0, 2.563 * 6.0), rel=0.1)


def test_motion_widens_edges_along_the_fall_alone() -> None:
    optics = segmented(replace(STILL, exposure_us=180.0))
    assert optics.edge_widths_uv_px is not None
    u_px, v_px = optics.edge_widths_uv_px
    assert u_px < 3.2
    assert v_px > 5
    assert segmented(STILL).edge_widths_uv_px is None


def test_dust_is_seen_as_it_grows() -> None:
    figures = []
    for strength in (0.0, 0.1, 0.25, 0.5, 1.0):
        trouble = dust(strength, np.random.default_rng(3), SIZE_PX)
        optics = of_empty(trouble)
        assert optics.brightness == pytest.approx(transmitted(trouble), abs=0.03)
        figures.append(optics.dust)
    assert figures == sorted(figures)
    assert figures[1] > 0.01
    # patches of `dust` take a fifth of the light, a veil gives some of it back
    assert figures[-1] == pytest.approx(0.2, abs=0.05)


def test_a_speck_is_a_spot() -> None:
    v, u = np.mgrid[: SIZE_PX[1], : SIZE_PX[0]]
    transmission = np.ones(v.shape, np.float32)
    transmission[np.hypot(u - 200, v - 250) < 60] = 0.8
    optics = of_empty(Disturbance(transmission=transmission))
    assert optics.spots_share == pytest.approx(np.pi * 60**2 / v.size, rel=0.3)
    assert optics.dust < 0.01


@pytest.mark.parametrize("factor", [0.7, 0.95])
def test_a_weak_flash_is_brightness_alone(factor: float) -> None:
    optics = of_sphere(trouble=flicker(factor))
    assert optics.brightness == pytest.approx(factor, abs=0.005)
    assert optics.dust < 0.01
    assert optics.gradient_uv == pytest.approx((0, 0), abs=0.004)


def test_a_panel_beside_the_view_tilts_its_light() -> None:
    neighbour = RIG.subset([CameraId("c09")]).cameras[0]  # 57 degrees beside
    trouble = dimmed_sector(RIG, CAMERA, 1.0, -neighbour.center_mm)
    optics = of_empty(trouble)
    light = np.asarray(trouble.wall_light)
    left, right = light[:, :100].mean(), light[:, -100:].mean()
    top, bottom = light[:100].mean(), light[-100:].mean()
    expected = (right - left) / light.mean(), (bottom - top) / light.mean()
    assert optics.gradient_uv == pytest.approx(expected, rel=0.25, abs=0.02)
    assert np.hypot(*optics.gradient_uv) > 0.15


def test_saturation_is_counted() -> None:
    frame = exposed(trouble=flicker(1.35))
    optics = observe_optics(frame, background(), None)
    assert optics is not None
    assert optics.saturated_share == pytest.approx(np.mean(frame.image == 255), rel=0.05)
    assert optics.saturated_share > 0.1


@pytest.mark.parametrize("status", [ViewStatus.MULTIPLE, ViewStatus.CLIPPED])
def test_bodies_that_have_no_place_do_not_count_as_dark_wall(status: ViewStatus) -> None:
    several = Silhouette(camera=C05, status=status, image_size_px=SIZE_PX)
    assert observe_all({C05: exposed()}, background(), {C05: several}) == {}


def test_views_without_an_outline_have_figures_too() -> None:
    nothing = Silhouette(camera=C05, status=ViewStatus.EMPTY, image_size_px=SIZE_PX)
    optics = observe_optics(exposed(), background(), nothing)
    assert optics is not None
    assert (optics.edge_width_px, optics.contrast) == (None, None)
    assert optics.brightness == pytest.approx(1, abs=0.003)


@pytest.mark.parametrize("model", [{}, {C05: replace(background()[C05], mean=np.ones((10, 10), np.float32))}])
def test_without_a_background_to_compare_with_there_are_none(model: Mapping) -> None:
    assert observe_optics(exposed(), model, None) is None


@st.composite
def lights(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Return uneven light (h, w), and where there is wall."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    shape = draw(st.integers(2, 20)), draw(st.integers(2, 24))
    light = (1 + draw(st.floats(0, 0.2)) * rng.normal(size=shape)).astype(np.float32)
    is_wall = rng.random(shape) < draw(st.floats(0.3, 1))
    is_wall[0, 0] = True
    return light, is_wall


def sums_of(light: np.ndarray, is_wall: np.ndarray) -> np.ndarray:
    """Return the sums that `_fill_light` forms in each column."""
    v = np.broadcast_to((2 * np.arange(len(light))[:, None] + 1) / len(light) - 1, light.shape)
    return np.stack(
        [
            np.where(is_wall, x, 0).sum(axis=0, dtype=float)
            for x in (np.ones(v.shape), v, v * v, light, v * light)
        ]
    )


@examples(0.3)
@given(lights(), st.integers(0, 2**32), st.integers(-3, 15), st.integers(0, 15))
def test_the_light_is_that_of_rows_of_blocks(
    case: tuple[np.ndarray, np.ndarray], seed: int, more_rows: int, more_columns: int
) -> None:
    flat_field, is_wall = 255 * case[0], case[1]
    height, width = is_wall.shape
    shape = BLOCK_PX * height + more_rows, BLOCK_PX * width + more_columns
    image = np.random.default_rng(seed).integers(200, 256, shape, np.uint8)
    looked_at = image[np.arange(height)[:, None] * BLOCK_PX + SAMPLED_ROWS, : BLOCK_PX * width]
    means = looked_at.reshape(height, 2, width, BLOCK_PX).mean(axis=(1, 3))
    light, sums = np.empty(is_wall.shape, np.float32), np.zeros((5, width))
    room = np.zeros((2, width * BLOCK_PX), np.uint16)
    saturated_share = _fill_light(image, flat_field, is_wall, room, room[0].view(np.uint64), light, sums)
    assert saturated_share == pytest.approx(np.mean(looked_at == 255))
    assert light == pytest.approx(np.where(is_wall, means / np.maximum(flat_field, 1), 0), rel=1e-5)
    assert sums == pytest.approx(sums_of(light, is_wall), abs=1e-6)


@given(lights())
def test_the_plane_is_that_of_least_squares(case: tuple[np.ndarray, np.ndarray]) -> None:
    light, is_wall = case
    v, u = ((2 * at + 1) / size - 1 for at, size in zip(np.indices(light.shape), light.shape, strict=True))
    terms = np.stack([np.ones_like(u), u, v], axis=-1)
    found, levels = np.array(_fit_plane(sums_of(light, is_wall))), np.empty_like(light)
    room = np.zeros((2, light.shape[1]), np.float32)
    total, n_dark = _fill_levels(light, is_wall, tuple(found.tolist()), levels, room)
    assert total == pytest.approx(levels.sum(), rel=1e-4)
    assert n_dark == np.count_nonzero(light[is_wall] < np.float32(1 - SPOT_CONTRAST) * light.max())
    assert levels == pytest.approx(light / np.maximum(terms @ found, MIN_LIGHT), rel=1e-5)
    # no other plane is nearer, but for the little that keeps places on one line from having none
    misses, best = (light - terms @ found)[is_wall], np.linalg.lstsq(terms[is_wall], light[is_wall])[0]
    assert misses @ misses <= np.sum((light[is_wall] - terms[is_wall] @ best) ** 2) + 0.01


@given(lights())
def test_spots_are_darker_than_the_wall_around_them(case: tuple[np.ndarray, np.ndarray]) -> None:
    light, is_wall = case
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(np.where(is_wall, light, np.nan), SURROUNDINGS_BLOCKS // 2, constant_values=np.nan),
        (SURROUNDINGS_BLOCKS, SURROUNDINGS_BLOCKS),
    )
    with np.errstate(invalid="ignore"):
        below = light / np.nanmean(np.where(is_wall[..., None, None], around, 1.0), axis=(2, 3)) - (
            1 - SPOT_CONTRAST
        )
    least, most = (np.mean(below[is_wall] < margin) for margin in (-1e-6, 1e-6))
    assert least <= _spots_share(np.where(is_wall, light, np.float32(0)), is_wall) <= most
