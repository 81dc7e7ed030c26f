"""Both segmenters on the same views, and what only the network segmenter can do."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples
from support.networks import GPU, darkness_network, difference_network, start_on_gpu

from pipeline.evaluation.hard_cases import HardCase, HardView, hard_view
from pipeline.frames import CameraId, Frame
from pipeline.segmentation import (
    BackgroundModel,
    Segmenter,
    Silhouette,
    ViewStatus,
    edge_refinement,
    edge_width,
    local_threshold,
    subpixel_edge,
)
from pipeline.segmentation.background import CameraBackground
from pipeline.segmentation.expected_view import extrapolated
from pipeline.segmentation.network import load_network
from pipeline.segmentation.network_segmenter import NetworkSegmenter
from pipeline.segmentation.segmenter_choice import ChoosingSegmenter
from pipeline.segmentation.silhouette import FINE_PX, INSIDE, MARGIN_PX, OUTSIDE, UNKNOWN
from pipeline.segmentation.subtraction import BackgroundSegmenter, SegmentationParameters
from service.processing.segmenters import warm_up

PARAMETERS = SegmentationParameters()
CAMERA = CameraId("c01")


@cache
def network_segmenter() -> NetworkSegmenter:
    return NetworkSegmenter(load_network(difference_network()), PARAMETERS)


SEGMENTERS: Mapping[str, Callable[[], Segmenter]] = {
    "background": lambda: BackgroundSegmenter(PARAMETERS),
    "network": network_segmenter,
}


@cache
def clean(size_mm: float) -> HardView:
    return hard_view(HardCase.CLEAN, 31, size_mm=size_mm)


def frame_of(image: np.ndarray) -> Frame:
    return Frame(camera=CAMERA, image=image.astype(np.uint8), frame_id=1, device_ns=0, received_ns=0)


def scene(
    *discs: tuple[int, int, int], size_px: tuple[int, int] = (640, 512), grey: float = 70.0
) -> tuple[Frame, BackgroundModel]:
    """Return blurred dark discs (u, v, radius) before a wall of 200, without noise."""
    width, height = size_px
    v, u = np.mgrid[:height, :width].astype(np.float32)
    covered = np.zeros((height, width), np.float32)
    for center_u, center_v, radius in discs:
        covered = np.maximum(covered, np.clip(radius + 0.5 - np.hypot(u - center_u, v - center_v), 0, 1))
    covered = cv2.GaussianBlur(covered, (0, 0), 0.8)
    wall = np.full((height, width), 200, np.float32)
    background = {CAMERA: CameraBackground(mean=wall, n_frames=3)}
    return frame_of(np.rint(200 + covered * (grey - 200))), background


def off_disc_px(silhouette: Silhouette, center_uv: tuple[float, float], radius_px: float) -> np.ndarray:
    return np.linalg.norm(silhouette.outline_uv - center_uv, axis=1) - radius_px


@pytest.mark.parametrize("name", SEGMENTERS)
def test_a_disc_is_found_to_a_fraction_of_a_pixel(name: str) -> None:
    silhouette = SEGMENTERS[name]()(*scene((300, 250, 120)))
    assert (silhouette.status, silhouette.found_by) == (ViewStatus.OK, name)
    off_px = off_disc_px(silhouette, (300, 250), 120)
    assert len(off_px) > 600
    assert abs(off_px.mean()) < 0.05
    assert np.abs(off_px).max() < 0.3
    # the known surroundings of a body are as wide as carving needs them
    rows, columns = np.nonzero(silhouette.labels)
    height, width = silhouette.labels.shape
    assert min(rows.min(), columns.min(), height - 1 - rows.max(), width - 1 - columns.max()) >= MARGIN_PX


@pytest.mark.parametrize("name", SEGMENTERS)
@pytest.mark.parametrize(
    ("discs", "status"),
    [
        ((), ViewStatus.EMPTY),
        (((300, 250, 7),), ViewStatus.EMPTY),
        (((200, 250, 80), (450, 250, 30)), ViewStatus.MULTIPLE),
        (((600, 250, 80),), ViewStatus.CLIPPED),
        (((300, 10, 40),), ViewStatus.CLIPPED),
        (((200, 250, 80), (450, 250, 8)), ViewStatus.OK),
    ],
    ids=["nothing", "dust", "two", "cut at the right", "cut at the top", "dust beside it"],
)
def test_statuses(name: str, discs: tuple[tuple[int, int, int], ...], status: ViewStatus) -> None:
    silhouette = SEGMENTERS[name]()(*scene(*discs))
    assert silhouette.status is status
    assert silhouette.is_usable is (silhouette.labels.size > 0)


@pytest.mark.parametrize("size_mm", [8, 25])
def test_both_place_the_same_edge_on_a_clean_view(size_mm: float) -> None:
    view = clean(size_mm)
    classical, neural = (make()(view.frame, view.background) for make in SEGMENTERS.values())
    off_px = off_outline_px(neural, classical)
    assert abs(off_px.mean()) < 0.02
    assert np.sqrt((off_px**2).mean()) < 0.1
    labels, others = classical.label_image(), neural.label_image()
    assert np.mean((labels != others) & (labels != UNKNOWN) & (others != UNKNOWN)) < 1e-4


def test_without_a_background_the_light_around_the_body_will_do() -> None:
    frame, _ = scene((600, 500, 120), size_px=(1280, 1024))
    assert SEGMENTERS["background"]()(frame, {}).status is ViewStatus.NO_BACKGROUND
    v, u = np.mgrid[:1024, :1280]
    uneven = np.rint(frame.image * (1 + u / 8000 - v / 9000 - ((u - 640) / 2500) ** 2))
    silhouette = network_segmenter()(frame_of(uneven), {})
    assert silhouette.status is ViewStatus.OK
    off_px = off_disc_px(silhouette, (600, 500), 120)
    assert abs(off_px.mean()) < 0.05
    assert np.abs(off_px).max() < 0.3


def off_outline_px(silhouette: Silhouette, other: Silhouette) -> np.ndarray:
    """Return how far the outline points of one silhouette are outside of another's edge."""
    u, v = ((silhouette.outline_uv - other.offset_uv).T / FINE_PX).astype(np.float32)
    return -cv2.remap(other.fine_px, u[:, None], v[:, None], cv2.INTER_LINEAR).ravel()


def test_smooth_light_moves_no_edge() -> None:
    frame, background = scene((300, 250, 120))
    v, u = np.mgrid[: frame.image.shape[0], : frame.image.shape[1]]
    light = 1 + 0.08 * np.sin(u / 120) * np.cos(v / 150)
    dimmed = frame_of(np.rint(frame.image * light))
    off_px = off_disc_px(network_segmenter()(dimmed, background), (300, 250), 120)
    assert abs(off_px.mean()) < 0.05
    assert np.abs(off_px).max() < 0.3


def test_an_edge_without_contrast_is_unknown() -> None:
    """The network sees the disc, but its grey levels are too near to the wall's to place an edge."""
    sensitive = NetworkSegmenter(load_network(difference_network(threshold=0.04)), PARAMETERS)
    silhouette = sensitive(*scene((300, 250, 120), grey=184))
    assert silhouette.is_usable
    labels = silhouette.label_image()
    v, u = np.mgrid[: labels.shape[0], : labels.shape[1]]
    radius = np.hypot(u - 300, v - 250)
    assert np.all(labels[np.abs(radius - 120) < 2] == UNKNOWN)
    assert np.all(labels[radius < 100] == INSIDE)
    assert np.all(labels[radius > 140] == OUTSIDE)
    assert len(silhouette.outline_uv) == 0


def test_what_the_network_cannot_decide_is_unknown() -> None:
    """A grey patch at the disc for which P(body) is about a half."""
    frame, background = scene((300, 250, 120))
    image = frame.image.copy()
    half = round(200 * (1 - 0.12))  # the threshold of the network that compares
    image[220:280, 400:460] = np.minimum(image[220:280, 400:460], half)
    undecided = NetworkSegmenter(load_network(difference_network(nearby_px=1)), PARAMETERS)
    silhouette = undecided(frame_of(image), background)
    labels = silhouette.label_image()
    assert np.mean(labels[230:270, 430:450] == UNKNOWN) > 0.95
    assert np.all(labels[245:255, 290:310] == INSIDE)


def test_a_u2net_finds_and_grey_levels_place_the_edge() -> None:
    segmenter = NetworkSegmenter(load_network(darkness_network()), PARAMETERS)
    for background in (scene()[1], {}):
        silhouette = segmenter(scene((300, 250, 120))[0], background)
        assert (silhouette.status, silhouette.found_by) == (ViewStatus.OK, "u2net")
        off_px = off_disc_px(silhouette, (300, 250), 120)
        assert abs(off_px.mean()) < 0.05
        assert np.abs(off_px).max() < 0.3


def test_a_u2net_finds_nothing_in_an_empty_image() -> None:
    segmenter = NetworkSegmenter(load_network(darkness_network()), PARAMETERS)
    frame, background = scene()
    noisy = frame.image + np.random.default_rng(1).normal(0, 2, frame.image.shape)
    assert segmenter(frame_of(noisy), background).status is ViewStatus.EMPTY


def test_dust_far_away_does_not_hide_a_small_stone() -> None:
    """Two specks widen the region; the stone is then looked at closer."""
    frame, background = scene((640, 500, 60), (100, 100, 9), (1200, 900, 9), size_px=(1280, 1024))
    parameters = replace(PARAMETERS, second_body_share=0.02, min_body_px=200)
    silhouette = NetworkSegmenter(network_segmenter().network, parameters)(frame, background)
    assert silhouette.status is ViewStatus.OK
    off_px = off_disc_px(silhouette, (640, 500), 60)
    assert abs(off_px.mean()) < 0.05


@examples(0.2)
@given(st.integers(0, 2**32 - 1), st.sampled_from([(64, 64), (67, 130), (5, 3)]))
def test_a_level_is_extrapolated_from_where_it_is_known(seed: int, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    slope = 100 + 0.1 * u + 0.05 * v
    is_known = (rng.random(shape) < 0.4).astype(np.uint8)
    is_known[:, shape[1] // 2 : shape[1] // 2 + 10] = 0
    is_known[0, 0] = 1  # nothing known at all is the last line's
    values = np.where(is_known, slope, np.float32(np.nan))
    level = extrapolated(values, is_known)
    assert np.abs(level - slope).max() < 4  # windows reach up to a few tens of pixels
    np.testing.assert_allclose(extrapolated(np.full(shape, 7, np.float32), is_known), 7, rtol=1e-6)
    np.testing.assert_array_equal(extrapolated(values, np.zeros(shape, np.uint8)), 1)


def test_a_gpu_that_fails_in_a_run_flags_what_it_finds_from_then_on() -> None:
    """E5: out of memory, the CPU goes on and every result says so."""
    network = load_network(difference_network(), (GPU,), start=start_on_gpu(n_runs=1))
    segmenter = NetworkSegmenter(network, PARAMETERS)
    frame, background = scene((300, 250, 120))
    good, flagged = segmenter(frame, background), segmenter(frame, background)
    assert (good.status, good.fallback, good.network_trouble) == (ViewStatus.OK, None, None)
    assert flagged.fallback is not None
    assert flagged.fallback.startswith(f"{GPU} failed, the CPU computes: ")
    np.testing.assert_array_equal(flagged.outline_uv, good.outline_uv)
    # and through the choice between the two segmenters, where a stone needs the network
    choosing = ChoosingSegmenter(classical=BackgroundSegmenter(PARAMETERS), network=segmenter)
    chosen = choosing(frame, {})
    assert (chosen.found_by, chosen.fallback) == ("network", f"no background yet; {flagged.fallback}")
    assert flagged.network_trouble == chosen.network_trouble == flagged.fallback
    wanted = replace(choosing, wanted="onnx")(frame, background)
    assert (wanted.found_by, wanted.fallback) == ("network", flagged.fallback)
    assert segmenter(*scene()).fallback == flagged.fallback


def test_after_the_warm_up_nothing_is_left_to_compile() -> None:
    kernels = [
        local_threshold._label_cells,
        edge_refinement.move_to_steepest,
        edge_refinement.find_doubtful,
        edge_width.measure_widths,
        subpixel_edge._interpolated,
        subpixel_edge._keep_nearest,
    ]
    segmenter = network_segmenter()
    warm_up(ChoosingSegmenter(classical=BackgroundSegmenter(PARAMETERS), network=segmenter))
    compiled = [len(kernel.signatures) for kernel in kernels]
    assert all(compiled)
    for disc in ((300, 250, 80), (320, 256, 190), (100, 200, 80)):
        frame, background = scene(disc)
        assert segmenter(frame, background).is_usable
        assert segmenter(frame, {}).is_usable
    assert [len(kernel.signatures) for kernel in kernels] == compiled


def test_a_highlight_the_network_misses_is_unknown() -> None:
    """A glint at the edge, brighter than the wall: whatever it is, it is not the wall."""
    frame, background = scene((300, 250, 120), grey=20)
    v, u = np.mgrid[: frame.image.shape[0], : frame.image.shape[1]]
    glint = (np.hypot(u - 300, v - 250) < 120) & (np.hypot(u - 300, v - 250) > 106) & (np.abs(v - 250) < 30)
    image = np.where(glint & (u > 300), 216, frame.image)
    segmenter = NetworkSegmenter(load_network(darkness_network()), PARAMETERS)
    silhouette = segmenter(frame_of(image), background)
    labels = silhouette.label_image()
    assert not np.any(labels[glint & (u > 300)] == OUTSIDE)
    off_px = off_disc_px(silhouette, (300, 250), 120)
    assert np.abs(off_px[np.abs(silhouette.outline_uv[:, 1] - 250) > 60]).max() < 0.3
