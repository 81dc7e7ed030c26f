"""The background learns light and dust, never a stone; the light of one exposure is estimated from that exposure."""

from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.extents import examples

from pipeline.frames import CameraId, Frame
from pipeline.segmentation.background import (
    CHANGED_SHARE,
    COARSE,
    MAX_REFUSED,
    SETTLED_FRAMES,
    CameraBackground,
    coarsen,
    learn_background,
)
from pipeline.segmentation.light import flash_gain
from pipeline.segmentation.pixel_comparison import sampled
from pipeline.segmentation.subtraction import BackgroundSegmenter, ComparedView, compare_view

C02 = CameraId("c02")
HEIGHT, WIDTH = 512, 640
V, U = np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j].astype(np.float32)


@cache
def wall() -> NDArray[np.float32]:
    """Return a wall with vignetting, a seam and two dark dots."""
    grey = 200 * (1 - 0.06 * (U**2 + V**2))
    grey[:, 300:306] *= 0.85
    for center in ((120, 90), (500, 400)):
        cv2.circle(grey, center, 14, 60, -1)
    return cv2.GaussianBlur(grey, (0, 0), 3).astype(np.float32)


def seen(grey: NDArray[np.float32], seed: int) -> Frame:
    """Return a frame of these grey levels with the sensor's noise."""
    noisy = grey + np.random.default_rng(seed).normal(0, 2, grey.shape)
    image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return Frame(camera=C02, image=image, frame_id=seed, device_ns=0, received_ns=0)


def with_disc(
    center_uv: tuple[float, float], radius_px: float, grey: float = 70.0, share: float = 1.0
) -> NDArray[np.float32]:
    """Return the wall behind a body, or behind a cloud that covers a share of it."""
    distance = np.hypot((U + 1) / 2 * (WIDTH - 1) - center_uv[0], (V + 1) / 2 * (HEIGHT - 1) - center_uv[1])
    cover = share * np.clip(radius_px - distance + 0.5, 0, 1)
    return (wall() * (1 - cover) + grey * cover).astype(np.float32)


@cache
def learnt() -> CameraBackground:
    return after({}, *(wall() for _ in range(SETTLED_FRAMES)))


def after(model: dict[CameraId, CameraBackground], *greys: NDArray[np.float32]) -> CameraBackground:
    for seed, grey in enumerate(greys):
        model = dict(learn_background(model, {C02: seen(grey, seed)}))
    return model[C02]


def deviation(known: CameraBackground) -> float:
    """Return the greatest error of the model against the wall, in blocks that average the noise."""
    return float(np.abs(coarsen(known.mean) - coarsen(wall())).max())


def test_noise_averages_out() -> None:
    assert deviation(learnt()) < 2.5
    assert learnt().n_frames == SETTLED_FRAMES


@examples(0.12)
@given(
    st.integers(0, 3),
    st.floats(4, 60),
    st.lists(st.tuples(st.floats(-20, 660), st.floats(-20, 532)), min_size=1, max_size=6, unique=True),
)
def test_no_flying_body_gets_in(tone: int, radius_px: float, places: list[tuple[float, float]]) -> None:
    """A grain of 0.4 mm or a stone of 6, whole or half in the frame, exposure after exposure."""
    apart = [places[0]]  # bodies that fly are not twice in one place
    apart += [at for at in places[1:] if np.hypot(at[0] - apart[-1][0], at[1] - apart[-1][1]) > radius_px]
    grey = (20.0, 70.0, 120.0, 250.0)[tone]
    known = after({C02: learnt()}, *(with_disc(place, radius_px, grey) for place in apart))
    assert deviation(known) < 4


def test_a_cloud_of_dust_is_waited_for() -> None:
    rng = np.random.default_rng(1)
    places = rng.uniform(0, 500, size=(6, 2))
    known = after({C02: learnt()}, *(with_disc((u, v), 150, 90, 0.4) for u, v in places))
    assert known.mean is learnt().mean


def test_a_body_that_hangs_is_the_rig() -> None:
    hanging = with_disc((300, 250), 40)
    known = after({C02: learnt()}, *(hanging for _ in range(MAX_REFUSED - 1)))
    assert deviation(known) < 4
    known = after({C02: known}, hanging)
    assert np.abs(coarsen(known.mean) - coarsen(hanging)).max() < 6


def test_a_spot_that_stays_is_learnt_in_its_place() -> None:
    spotted = with_disc((400, 200), 8, 120)
    known = after({C02: learnt()}, *(spotted for _ in range(MAX_REFUSED)))
    assert np.abs(coarsen(known.mean) - coarsen(spotted)).max() < 4
    assert known.n_frames == SETTLED_FRAMES + MAX_REFUSED
    assert np.mean(np.abs(coarsen(spotted) - coarsen(wall())) > 20) < CHANGED_SHARE


def test_light_that_fades_over_an_hour_is_followed() -> None:
    """A panel that loses 30 % of its light on one side, one exposure a minute."""
    fading = [(wall() * (1 - 0.3 * minute / 60 * (1 + U) / 2)).astype(np.float32) for minute in range(61)]
    known = after({C02: learnt()}, *fading)
    assert known.n_frames == SETTLED_FRAMES + 61
    ratio = coarsen(known.mean) / coarsen(fading[-1])
    assert ratio.max() / ratio.min() < 1.08, "ten minutes behind; the light itself has 1.43"


def test_the_clean_flat_field_is_kept_whatever_the_mean_learns() -> None:
    dusty = (wall() * (1 - 0.08 * np.exp(-(U**2 + V**2) / 0.1))).astype(np.float32)
    known = after({C02: learnt()}, *(dusty for _ in range(30)))
    assert np.abs(known.mean[250:260, 310:330] / wall()[250:260, 310:330] - 1).max() > 0.05
    assert known.flat_field is learnt().flat_field


def test_a_flat_field_begun_with_a_stone_goes_with_it() -> None:
    known = after({}, with_disc((300, 250), 60), *(wall() for _ in range(SETTLED_FRAMES + 2)))
    assert np.abs(known.flat_field / coarsen(coarsen(wall())) - 1).max() < 0.02


def test_a_rig_that_was_dirty_when_first_seen_is_clean_once_it_is_cleaned() -> None:
    dusty = (wall() * (1 - 0.25 * np.exp(-((U - 0.4) ** 2 + V**2) / 0.1))).astype(np.float32)
    known = after(
        {}, *(dusty for _ in range(SETTLED_FRAMES)), *(wall() for _ in range(MAX_REFUSED + SETTLED_FRAMES))
    )
    assert np.abs(known.flat_field / coarsen(coarsen(wall())) - 1).max() < 0.02
    known = after({C02: learnt()}, *(dusty for _ in range(MAX_REFUSED + 1)))
    assert known.flat_field is learnt().flat_field, "dust alone renews nothing"
    known = after({C02: known}, *(wall() for _ in range(MAX_REFUSED + 1)))
    assert known.flat_field is learnt().flat_field


def compared_view(image: NDArray[np.uint8], known: CameraBackground) -> ComparedView:
    blocks = sampled(image)
    return compare_view(blocks, known, BackgroundSegmenter().thresholds(blocks, known), noise=0.0)


def light_of(grey: NDArray[np.float32], seed: int = 7) -> NDArray[np.float32]:
    """Return the light that the segmenter finds, from one pixel of each block."""
    empty = compared_view(seen(grey, seed).image, learnt())
    gain = np.full(empty.seen.shape, empty.gain, np.float32)
    return gain if empty.light is None else gain * empty.light


LIGHTS = {
    "as before": np.ones_like(U),
    "weaker": np.full_like(U, 0.7),
    "one-sided": 0.85 + 0.15 * V,
    "a panel's border": 0.85 - 0.15 * np.tanh(1.5 * U),
    "a patch of dust": 1 - 0.2 * np.exp(-((U - 0.5) ** 2 + (V - 0.3) ** 2) / 0.4),
}


@pytest.mark.parametrize("radius_px", [0, 40, 150, 200])
@pytest.mark.parametrize("name", LIGHTS)
def test_the_light_is_that_of_the_wall_and_never_the_body(name: str, radius_px: int) -> None:
    light = LIGHTS[name].astype(np.float32)
    found = light_of(with_disc((320, 250), radius_px) * light)
    beside = coarsen(with_disc((320, 250), radius_px + 8, 0.0) * np.float32(1)) > 40  # dots and body left out
    beside &= coarsen(np.hypot(U, V).astype(np.float32)) < 0.95  # in the corners a quadratic may go astray
    error = np.abs(found / coarsen(light) - 1)[beside]
    smooth = name in ("as before", "weaker", "one-sided")
    assert error.max() < (0.01 if smooth else 0.08)
    assert np.sqrt(np.mean(error**2)) < (0.003 if smooth else 0.02)


@pytest.mark.parametrize("grey", [130.0, 165.0, 250.0])
def test_a_bright_body_lights_nothing(grey: float) -> None:
    tilted = (0.9 + 0.1 * U).astype(np.float32)
    assert np.abs(light_of(with_disc((320, 250), 150, grey) * tilted) / coarsen(tilted) - 1).max() < 0.03


@pytest.mark.parametrize("free", [8, 33, 130])
def test_a_body_that_leaves_a_strip_of_the_wall(free: int) -> None:
    """A visible tenth of the view determines the light; with less the light is finite at least."""
    tilted = (0.9 + 0.1 * U).astype(np.float32)
    hidden = np.where(np.arange(WIDTH) < free, wall(), 60) * tilted
    found = light_of(hidden.astype(np.float32))
    assert np.isfinite(found).all()
    if free > 0.1 * WIDTH:
        columns = slice(0, free // COARSE - 8)
        assert np.median(np.abs(found / coarsen(tilted) - 1)[:, columns]) < 0.02


def test_an_even_light_is_a_factor() -> None:
    for radius_px in (0, 40, 200):
        image = seen(0.9 * with_disc((320, 250), radius_px), 1).image
        assert compared_view(image, learnt()).light is None


@pytest.mark.parametrize("shape", [(4, 5), (15, 17), (100, 64)])
def test_images_of_any_size_are_judged(shape: tuple[int, int]) -> None:
    known = CameraBackground(mean=np.full(shape, 100, np.float32), n_frames=1)
    image = np.full(shape, 120, np.uint8)
    empty = compared_view(image, known)
    assert empty.light is None
    assert empty.gain == pytest.approx(1.2)
    assert empty.gain == flash_gain(sampled(image), known.coarse)
    assert known.coarse.shape == (shape[0] // COARSE, shape[1] // COARSE)
    assert flash_gain(coarsen(1.2 * known.mean), known.coarse) == pytest.approx(1.2)
