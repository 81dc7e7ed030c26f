"""A body as grey as the wall behind it: its detail tells it, and a hole is one only if it shows the wall."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples

from pipeline.arrays import Floats, GreyImage, Mask
from pipeline.frames import CameraId, Frame
from pipeline.segmentation.background import CameraBackground
from pipeline.segmentation.detail import HALO, is_wall, told_by_detail
from pipeline.segmentation.noise import TYPICAL_NOISE, SensorNoise, sensor_noise
from pipeline.segmentation.silhouette import OUTSIDE, ViewStatus
from pipeline.segmentation.subtraction import BackgroundSegmenter

SIZE_PX, WALL = 512, 160.0
CAMERA = CameraId("c01")


def noisy(levels: Floats, rng: np.random.Generator) -> GreyImage:
    sd = np.sqrt(np.maximum(TYPICAL_NOISE.variance_grey2(levels), 0))
    return np.clip(np.rint(levels + sd * rng.normal(size=levels.shape)), 0, 255).astype(np.uint8)


def disc(radius_px: float) -> Floats:
    """Return coverages (h, w) of a disc in the middle, with an edge as a lens in focus shows it."""
    v, u = np.mgrid[:SIZE_PX, :SIZE_PX] - SIZE_PX / 2
    return np.asarray(cv2.GaussianBlur((np.hypot(u, v) < radius_px).astype(float), (0, 0), 0.9))


def grain(rng: np.random.Generator, sd_grey: float) -> Floats:
    """Return the grain (h, w) of rock: a few pixels wide, and with twice as much for twice the length (1/f)."""
    sum_of_scales = sum(
        scale * cv2.GaussianBlur(rng.normal(size=(SIZE_PX, SIZE_PX)), (0, 0), scale)
        for scale in (1.5, 3, 6, 12)
    )
    return np.asarray(sd_grey * sum_of_scales / sum_of_scales.std())


def spotted(share: float) -> Floats:
    """Return a wall (h, w) with one soft spot, in its middle darker by a share."""
    v, u = np.mgrid[:SIZE_PX, :SIZE_PX] - SIZE_PX / 2
    return np.asarray(WALL * (1 - share * np.exp(-(u**2 + v**2) / (2 * 60.0**2))))


@given(st.integers(0, 2**32 - 1), st.floats(0.3, 0.7), st.floats(6, 20))
@examples(0.4)
def test_no_body_is_seen_through_before_a_spot_of_any_grey(seed: int, share: float, sd_grey: float) -> None:
    """The middle of the body is as grey as the spot: only its grain tells the two apart."""
    rng = np.random.default_rng(seed)
    wall, covered = spotted(share), disc(90)
    body = WALL * (1 - share) + 10 - 40 * (1 - disc(40)) + grain(rng, sd_grey)
    image = noisy(wall * (1 - covered) + body * covered, rng)
    background = {CAMERA: CameraBackground(mean=wall.astype(np.float32), n_frames=5)}
    frame = Frame(camera=CAMERA, image=image, frame_id=0, device_ns=0, received_ns=0)
    found = BackgroundSegmenter()(frame, background)
    assert found.status is ViewStatus.OK
    inner = cv2.erode((covered > 0.5).astype(np.uint8), np.ones((2 * 2 * HALO + 1,) * 2, np.uint8)) != 0
    assert not (inner & (found.label_image() == OUTSIDE)).any()


def test_noise_is_no_detail_and_a_grainy_body_has_none_beside_it() -> None:
    rng = np.random.default_rng(0)
    wall = np.full((SIZE_PX, SIZE_PX), WALL)
    assert not told_by_detail(noisy(wall, rng), wall.astype(np.uint8), 1.0, TYPICAL_NOISE)[0].any()
    covered = disc(90)
    image = noisy(wall * (1 - covered) + (WALL + grain(rng, 12)) * covered, rng)
    found, _ = told_by_detail(image, wall.astype(np.uint8), 1.0, TYPICAL_NOISE)
    assert not (found & (covered < 0.5)).any()
    inner = cv2.erode((covered > 0.5).astype(np.uint8), np.ones((4 * HALO + 1,) * 2, np.uint8)) != 0
    assert found[inner].mean() > 0.9


@pytest.mark.parametrize(("spread_grey", "expected"), [(0.0, True), (60.0, False)])
def test_a_hole_shows_the_wall_if_nothing_but_noise_differs(spread_grey: float, expected: bool) -> None:
    """A smooth pale patch of the body, whose mean is the wall's, before a wall that is not as even."""
    wall = spotted(0.4)
    seen = wall + spread_grey * np.linspace(-1, 1, SIZE_PX)
    hole = (disc(40) > 0.5).view(np.uint8)
    image = noisy(seen, np.random.default_rng(0))
    assert is_wall(hole, image, np.rint(wall).astype(np.uint8), 1.0, TYPICAL_NOISE) is expected


def test_a_slit_is_not_seen_through() -> None:
    wall = np.full((SIZE_PX, SIZE_PX), WALL)
    slit: Mask = np.zeros(wall.shape, np.bool_)
    slit[100:400, 250:255] = True
    image = noisy(wall, np.random.default_rng(0))
    assert not is_wall(slit.view(np.uint8), image, wall.astype(np.uint8), 1.0, TYPICAL_NOISE)


@pytest.mark.parametrize("noise", [TYPICAL_NOISE, SensorNoise(0.4, 0.01), SensorNoise(9.0, 0.2)])
def test_the_noise_of_a_sensor_is_found_at_all_levels_that_the_wall_has(noise: SensorNoise) -> None:
    rng = np.random.default_rng(0)
    wall = spotted(0.9)
    levels = wall + np.sqrt(np.maximum(noise.variance_grey2(wall) - 1 / 12, 0)) * rng.normal(size=wall.shape)
    found = sensor_noise(np.rint(np.tile(levels, (2, 2))).clip(0, 255).astype(np.float32))
    grey = np.array([30.0, 100.0, 160.0])
    np.testing.assert_allclose(found.variance_grey2(grey), noise.variance_grey2(grey), rtol=0.35)


def test_a_wall_of_one_grey_tells_the_noise_there() -> None:
    rng = np.random.default_rng(0)
    empty = np.rint(WALL + 4.0 * rng.normal(size=(1024, 1280))).astype(np.float32)
    found = sensor_noise(empty)
    assert found.variance_grey2(np.array([WALL]))[0] == pytest.approx(16 + 1 / 12, rel=0.05)
    assert found.read_grey2 > 0
    assert found.photons_grey > 0
