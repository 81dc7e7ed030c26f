"""Edges as wide as lens, depth, motion and noise make them: found where the sharp ones are, with their width."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates
from support.extents import examples

from pipeline.arrays import Floats, GreyImage, PointsUV
from pipeline.segmentation.delineation import Delineation, delineate
from pipeline.segmentation.edge_width import local_sigmas_px, outline_sigmas_px
from pipeline.segmentation.local_threshold import RegionLevels, trimap_of
from pipeline.segmentation.noise import QUIET_GREY, noise_grey, smoothed
from pipeline.segmentation.outline_fill import closed_up, redraw
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN

SIZE_PX = 400
WALL, BODY = 200.0, 60.0
CENTER_UV = np.array([201.3, 198.6])
OVERSAMPLED = 4


def disc_px(radius_px: float) -> Floats:
    """Distances (h, w) to the edge of a disc, positive within."""
    v, u = np.mgrid[:SIZE_PX, :SIZE_PX].astype(float)
    return radius_px - np.hypot(u - CENTER_UV[0], v - CENTER_UV[1])


def disc_image(radius_px: float, blur: Floats, noise: float = 0.5) -> GreyImage:
    """A disc seen through a blur given as a kernel of `OVERSAMPLED` times as many pixels."""
    size = OVERSAMPLED * SIZE_PX
    v, u = (np.mgrid[:size, :size] + 0.5) / OVERSAMPLED - 0.5
    inside = np.clip(OVERSAMPLED * (radius_px - np.hypot(u - CENTER_UV[0], v - CENTER_UV[1])) + 0.5, 0, 1)
    spread = cv2.filter2D(inside, cv2.CV_64F, blur / blur.sum())
    coverage = cv2.resize(spread, (SIZE_PX, SIZE_PX), interpolation=cv2.INTER_AREA)
    grey = WALL + (BODY - WALL) * coverage + noise * np.random.default_rng(1).normal(size=coverage.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def gaussian(sigma_px: float) -> Floats:
    side = 2 * int(np.ceil(4 * OVERSAMPLED * sigma_px)) + 1
    line = cv2.getGaussianKernel(side, OVERSAMPLED * sigma_px)
    return np.asarray(line @ line.T)


def aperture(diameter_px: float) -> Floats:
    radius = OVERSAMPLED * diameter_px / 2
    v, u = np.mgrid[-int(radius) - 1 : int(radius) + 2, -int(radius) - 1 : int(radius) + 2]
    return np.clip(radius + 0.5 - np.hypot(u, v), 0, 1)


def sweep(length_px: float) -> Floats:
    return np.ones((max(round(OVERSAMPLED * length_px), 1), 1))


def delineated(image: GreyImage, radius_px: float) -> Delineation:
    true_px = disc_px(radius_px)[::2, ::2]
    trimap = trimap_of(true_px > 6.0, true_px > -25.0, np.zeros(true_px.shape, bool))
    return delineate(image, np.full(image.shape, WALL, np.uint8), trimap)


def outline_of(found: Delineation) -> PointsUV:
    assert found.edge is not None
    return found.edge.outline_uv


BLURS = {
    "lens": (gaussian(0.7), 0.7),
    "lens 2": (gaussian(2), 2.0),
    "lens 4": (gaussian(4), 4.0),
    "aperture 8": (aperture(8), 2.0),
    "aperture 14": (aperture(14), 3.5),
}


@pytest.mark.parametrize("name", BLURS)
@pytest.mark.parametrize("radius_px", [50.0, 120.0])
def test_a_blurred_disc_is_as_large_as_a_sharp_one(name: str, radius_px: float) -> None:
    kernel, sigma_px = BLURS[name]
    found = delineated(disc_image(radius_px, kernel), radius_px)
    outline_uv = outline_of(found)
    assert found.edge is not None
    assert found.edge.seen.mean() > 0.98
    middle_uv = (
        np.linalg.lstsq(np.c_[outline_uv, np.ones(len(outline_uv))], (outline_uv**2).sum(axis=1))[0][:2] / 2
    )
    assert np.allclose(middle_uv, CENTER_UV, atol=0.02)
    radii_px = np.linalg.norm(outline_uv - CENTER_UV, axis=1)
    # uncorrected, the edge lies sigma^2 / 2 r further within, for an aperture a third more: up to 0.18 px
    assert radii_px.mean() == pytest.approx(radius_px, abs=0.1 if "aperture" in name else 0.01)
    assert radii_px.std() < 0.1
    assert found.edge_sigma_px == pytest.approx(np.hypot(sigma_px, 0.5), rel=0.05)


@pytest.mark.parametrize("length_px", [5.0, 9.0])
def test_motion_moves_no_edge(length_px: float) -> None:
    found = delineated(disc_image(100, sweep(length_px)), 100)
    depths_px = map_coordinates(disc_px(100), outline_of(found).T[::-1], order=1)
    assert abs(depths_px.mean()) < 0.05
    assert np.quantile(np.abs(depths_px), 0.98) < 0.8
    assert np.abs(depths_px).max() < 1.2, "an even sweep is as steep anywhere"


def test_distances_to_a_blurred_edge_are_exact() -> None:
    found = delineated(disc_image(100, gaussian(3)), 100)
    assert found.edge is not None
    errors_px = found.edge.fine_px(found.edge.coarse_px()) - disc_px(100)[::2, ::2]
    near = np.abs(disc_px(100)[::2, ::2]) < 5
    assert np.abs(errors_px[near]).max() < 0.3
    far = np.abs(disc_px(100)[::2, ::2]) > 8
    assert ((errors_px + disc_px(100)[::2, ::2] > 0) == (disc_px(100)[::2, ::2] > 0))[far].all()


@examples(0.2)
@given(st.floats(0.6, 5.0), st.floats(0, 6), st.floats(-3, 3))
def test_the_width_of_an_edge_is_measured_wherever_it_is_looked_for(
    sigma_px: float, noise: float, off_px: float
) -> None:
    image = np.clip(
        WALL
        + (BODY - WALL) * cv2.GaussianBlur((disc_px(100) > 0).astype(np.float32), (0, 0), sigma_px)
        + noise * np.random.default_rng(0).normal(size=(SIZE_PX, SIZE_PX)),
        0,
        255,
    ).astype(np.uint8)
    angles = -np.linspace(0, 2 * np.pi, 628, endpoint=False)  # the body on the right, v downwards
    points_uv = CENTER_UV + (100 + off_px) * np.column_stack([np.cos(angles), np.sin(angles)])
    region = RegionLevels(
        image, np.full(image.shape, WALL, np.uint8), np.float32(1), np.zeros((200, 200), np.uint8)
    )
    seen = np.ones(len(points_uv), np.uint8)
    local_px = local_sigmas_px(region, points_uv, seen)
    assert np.median(local_px) == pytest.approx(np.hypot(sigma_px, 0.45), rel=0.1, abs=0.12)
    most_px, nearly_all_px = outline_sigmas_px(region, points_uv, seen)
    assert np.median(local_px) - 0.1 < most_px <= nearly_all_px < 1.6 * np.median(local_px)


def test_noise_is_measured_and_smoothed_away() -> None:
    rng = np.random.default_rng(2)
    sharp = disc_image(150, gaussian(0.7), noise=0)
    for noise in (1.0, 7.0, 12.0):
        image = np.clip(np.rint(sharp + noise * rng.normal(size=sharp.shape)), 0, 255).astype(np.uint8)
        assert noise_grey(image) == pytest.approx(noise, rel=0.15, abs=0.6)
        quiet = smoothed(image, noise)
        left = (quiet.astype(float) - sharp)[np.abs(disc_px(150)) > 15].std()
        assert left < (QUIET_GREY if noise > QUIET_GREY else 1.1 * noise)
        found = delineated(quiet, 150)
        radii_px = np.linalg.norm(outline_of(found) - CENTER_UV, axis=1)
        assert radii_px.mean() == pytest.approx(150, abs=0.05)
        assert found.edge is not None
        assert found.edge.seen.mean() > 0.98


def square_with(patch: tuple[slice, slice]) -> tuple[GreyImage, GreyImage]:
    """A dark square of 200 px whose `patch` looks just like the wall, and the trimap of what differs."""
    image = np.full((SIZE_PX, SIZE_PX), WALL)
    image[100:300, 100:300] = BODY
    image[patch] = WALL - 9  # not quite the wall's grey: just outside of a true edge it would be
    image = cv2.GaussianBlur(image, (0, 0), 0.8) + np.random.default_rng(3).normal(size=image.shape)
    seen = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    differs = (np.abs(image - WALL) > 0.12 * WALL).astype(np.uint8)
    core = cv2.erode(differs, np.ones((13, 13)))
    possible = cv2.dilate(differs, np.ones((9, 9)))
    return seen, trimap_of(*(mask[::2, ::2] > 0 for mask in (core, possible, np.zeros_like(core))))


@pytest.mark.parametrize(
    "patch",
    [
        (slice(100, 130), slice(170, 230)),  # at a side
        (slice(100, 140), slice(260, 300)),  # a corner
        (slice(180, 220), slice(180, 230)),  # within
    ],
)
def test_a_patch_that_looks_like_the_wall_is_not_carved(patch: tuple[slice, slice]) -> None:
    image, trimap = square_with(patch)
    found = delineate(image, np.full(image.shape, WALL, np.uint8), trimap)
    assert found.edge is not None
    body = np.zeros(image.shape, bool)
    body[102:298, 102:298] = True
    assert (found.labels[body] != OUTSIDE).mean() > 0.999
    assert (found.labels[body] == INSIDE).mean() > 0.8
    distances_px = found.edge.fine_px(found.edge.coarse_px())
    assert distances_px[body[::2, ::2]].min() > -1.5
    far = np.ones(image.shape, bool)
    far[60:340, 60:340] = False
    assert (found.labels[far] == OUTSIDE).all()


def test_contours_are_closed_up_and_redrawn() -> None:
    square_uv = np.array([[10.0, 10.0], [30.0, 10.0], [30.0, 30.0], [10.0, 30.0]])
    ends = np.array([0, 4])
    points_uv, seen, new_ends = closed_up(square_uv, np.ones(4, np.uint8), ends)
    assert new_ends[1] == len(points_uv)
    steps_px = np.linalg.norm(points_uv - np.roll(points_uv, 1, axis=0), axis=1)
    assert steps_px.max() <= 1.5
    assert seen.sum() == 4, "nothing was seen between points far apart"
    labels = np.full((40, 40), OUTSIDE)
    labels[5, 5], labels[20, 20] = UNKNOWN, UNKNOWN
    body = redraw(points_uv, new_ends, labels)
    assert (body == INSIDE).sum() == (labels == INSIDE).sum() + 1 == 20 * 20
    assert labels[5, 5] == OUTSIDE, "nothing that may be body lies outside of its contours"
    assert labels[20, 20] == UNKNOWN
    same_uv, _, same_ends = closed_up(points_uv, seen, new_ends)
    assert same_uv is points_uv
    assert same_ends is new_ends


def test_a_dark_rim_makes_no_edge_narrower() -> None:
    """Beyond the rim the body is brighter, so that a long profile counts more than all of it as covered there."""
    depth_px = disc_px(100)
    rim = np.where(depth_px > 8, 30.0, 0.0)
    image = cv2.GaussianBlur(WALL + np.where(depth_px > 0, BODY - WALL + rim, 0.0), (0, 0), 3.0)
    image += 0.5 * np.random.default_rng(5).normal(size=image.shape)
    found = delineated(np.clip(np.rint(image), 0, 255).astype(np.uint8), 100)
    assert found.edge_sigma_px == pytest.approx(3.0, rel=0.2)
    assert UNKNOWN not in found.labels
