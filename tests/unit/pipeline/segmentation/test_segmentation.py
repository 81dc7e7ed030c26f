"""Silhouettes on rendered images: the edge is unbiased, and what cannot be decided is unknown."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.special import ndtr
from support import rendered
from support.extents import examples
from support.silhouettes import distances_of, sphere_silhouette

from pipeline.frames import CameraId, Frame
from pipeline.segmentation import ViewStatus, segment_all
from pipeline.segmentation.background import learn_background
from pipeline.segmentation.delineation import delineate
from pipeline.segmentation.light import flash_gain
from pipeline.segmentation.local_threshold import trimap_of
from pipeline.segmentation.silhouette import FINE_PX, INSIDE, OUTSIDE, UNKNOWN, Silhouette
from pipeline.segmentation.subtraction import BackgroundSegmenter, SegmentationParameters
from pipeline.synthesis.bodies import sphere

SEGMENTER = BackgroundSegmenter()
CENTER_MM = np.array([0.5, -0.3, 0.2])
RIG = rendered.rig()


def outline_errors_px(silhouette: Silhouette, center_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return distances of the outline to the true outline of the 15 mm sphere, positive outside."""
    camera = RIG.subset([silhouette.camera]).cameras[0]
    offset = center_mm - camera.center_mm
    angle = np.arccos(camera.rays(silhouette.outline_uv) @ offset / np.linalg.norm(offset))
    return (angle - np.arcsin(7.5 / np.linalg.norm(offset))) * camera.focal_px


def with_image(frame: Frame, image: NDArray[np.generic]) -> Frame:
    return replace(frame, image=np.clip(np.rint(image), 0, 255).astype(np.uint8))


def test_edge_of_a_sphere_is_unbiased_in_every_view() -> None:
    silhouettes = segment_all(rendered.sphere_bundle().frames, rendered.background(), SEGMENTER)
    assert len(silhouettes) == 16
    for silhouette in silhouettes.values():
        assert silhouette.status is ViewStatus.OK
        errors_px = outline_errors_px(silhouette, CENTER_MM)
        assert len(errors_px) > 700
        assert abs(errors_px.mean()) < 0.05, silhouette.camera
        assert errors_px.std() < 0.1, silhouette.camera


@pytest.mark.parametrize("gain", [0.6, 0.9, 1.1])
def test_strength_of_the_flash_does_not_move_the_edge(gain: float) -> None:
    frame = rendered.sphere_bundle().frames[CameraId("c02")]
    silhouette = SEGMENTER(with_image(frame, gain * frame.image.astype(float)), rendered.background())
    assert abs(outline_errors_px(silhouette, CENTER_MM).mean()) < 0.05


def test_a_body_brighter_than_the_wall_is_found_as_well() -> None:
    background = {k: replace(b, mean=b.mean * 0.5) for k, b in rendered.background().items()}
    frame = rendered.sphere_bundle().frames[CameraId("c02")]
    camera = RIG.subset([frame.camera]).cameras[0]
    wall = background[frame.camera].mean
    body = np.zeros(wall.shape, np.float32)
    truth = sphere_silhouette(camera, CENTER_MM, 7.5)
    (u, v), (h, w) = truth.offset_uv, distances_of(truth).shape
    body[v : v + h, u : u + w] = np.clip(distances_of(truth) + 0.5, 0, 1)
    body = cv2.GaussianBlur(body, (0, 0), 0.7)
    silhouette = SEGMENTER(with_image(frame, wall * (1 - body) + 210 * body), background)
    assert abs(outline_errors_px(silhouette, CENTER_MM).mean()) < 0.05


@pytest.mark.parametrize("shading", ["lit from the camera", "lit from one side", "light vein"])
def test_light_parts_of_a_body_belong_to_it(shading: str) -> None:
    camera = CameraId("c02")
    wall = rendered.background()[camera].mean
    truth = sphere_silhouette(RIG.subset([camera]).cameras[0], CENTER_MM, 7.5)
    depth = np.clip(distances_of(truth), 0, None) / 156
    rows, columns = np.mgrid[: depth.shape[0], : depth.shape[1]]
    match shading:
        case "lit from the camera":
            grey = 60 + 80 * np.sqrt(np.clip(2 * depth - depth**2, 0, 1))
        case "lit from one side":
            grey = 60 + 80 * columns / columns.max()
        case _:
            grey = np.where(np.abs(columns - rows - 20) < 9, 145, 70)
    share = np.clip(distances_of(truth) + 0.5, 0, 1)
    (u, v), (h, w) = truth.offset_uv, share.shape
    image = wall.astype(float)
    image[v : v + h, u : u + w] = image[v : v + h, u : u + w] * (1 - share) + grey * share
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    frame = with_image(rendered.sphere_bundle().frames[camera], image)
    silhouette = SEGMENTER(frame, rendered.background())
    assert silhouette.status is ViewStatus.OK
    errors_px = outline_errors_px(silhouette, CENTER_MM)
    # a light that falls to the rim leaves its gradient over the carried level: a tenth of the contrast
    assert abs(errors_px.mean()) < 0.2
    assert np.abs(errors_px).max() < 4
    inside = truth.label_image() == INSIDE
    assert (silhouette.label_image()[inside] == INSIDE).mean() > 0.99


def test_empty_view() -> None:
    silhouettes = segment_all(rendered.bundle_of(number=1).frames, rendered.background(), SEGMENTER)
    assert {silhouette.status for silhouette in silhouettes.values()} == {ViewStatus.EMPTY}


def test_two_bodies_are_seen_wherever_they_do_not_overlap() -> None:
    bundle = rendered.bundle_of(
        rendered.placed(sphere(8.0), (8, 0, 3)), rendered.placed(sphere(6.0), (-7, 2, -4)), number=2
    )
    silhouettes = segment_all(bundle.frames, rendered.background(), SEGMENTER)
    statuses = [silhouette.status for silhouette in silhouettes.values()]
    assert statuses.count(ViewStatus.MULTIPLE) >= 12


def test_a_body_cut_by_the_border_is_told() -> None:
    bundle = rendered.bundle_of(rendered.placed(sphere(), (0, 0, -24)), number=3)
    for camera, silhouette in segment_all(bundle.frames, rendered.background(), SEGMENTER).items():
        view = RIG.subset([camera]).cameras[0]
        truth = sphere_silhouette(view, np.array([0, 0, -24.0]), 7.5)
        low, high = truth.outline_uv.min(axis=0), truth.outline_uv.max(axis=0)
        is_cut = (low < 0).any() or high[0] > 1279 or high[1] > 1023
        assert silhouette.status is (ViewStatus.CLIPPED if is_cut else ViewStatus.OK), camera


def test_noise_is_no_body(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise of a broken sensor: following the contours of one such view took a minute, and every stone its deadline."""
    contours: list[int] = []
    find = cv2.findContours

    def counting(labels: NDArray[np.uint8], *how: int) -> tuple[tuple[NDArray[np.int32], ...], object]:
        found, hierarchy = find(labels, *how)
        contours.append(len(found))
        return found, hierarchy

    monkeypatch.setattr(cv2, "findContours", counting)
    frame = rendered.sphere_bundle().frames[CameraId("c02")]
    image = np.random.default_rng(1).integers(0, 256, frame.image.shape, np.uint8)
    assert SEGMENTER(replace(frame, image=image), rendered.background()).status is ViewStatus.EMPTY
    assert contours
    assert max(contours) < 1000


def test_a_camera_without_background_is_told() -> None:
    frame = rendered.sphere_bundle().frames[CameraId("c02")]
    assert SEGMENTER(frame, {}).status is ViewStatus.NO_BACKGROUND
    other = {frame.camera: replace(rendered.background()[frame.camera], mean=np.ones((10, 10), np.float32))}
    assert SEGMENTER(frame, other).status is ViewStatus.NO_BACKGROUND


def dotted(center_uv: tuple[int, int], radius_px: int) -> tuple[Frame, dict]:
    """Return view c02 of the sphere with a dark dot of the background at a given place, half hidden or not."""
    camera = CameraId("c02")
    frame, known = rendered.sphere_bundle().frames[camera], rendered.background()[camera]
    dot = np.zeros(known.mean.shape, np.float32)
    cv2.circle(dot, center_uv, radius_px, 1.0, -1)
    dot = 0.85 * cv2.GaussianBlur(dot, (0, 0), 4)
    body = np.zeros(known.mean.shape, np.float32)
    truth = sphere_silhouette(RIG.subset([camera]).cameras[0], CENTER_MM, 7.5)
    (u, v), (h, w) = truth.offset_uv, distances_of(truth).shape
    body[v : v + h, u : u + w] = np.clip(distances_of(truth) + 0.5, 0, 1)
    image = frame.image * (1 - dot * (1 - body))
    return with_image(frame, image), {camera: replace(known, mean=known.mean * (1 - dot))}


@examples(0.08)
@given(st.floats(0, 2 * np.pi), st.floats(-25, 25), st.integers(12, 30))
def test_a_dark_dot_at_the_edge_is_unknown_not_guessed(angle: float, off_px: float, radius_px: int) -> None:
    truth = sphere_silhouette(RIG.subset([CameraId("c02")]).cameras[0], CENTER_MM, 7.5)
    middle = truth.outline_uv.mean(axis=0)
    reach_px = np.linalg.norm(truth.outline_uv - middle, axis=1).mean() + off_px
    u, v = (middle + reach_px * np.array([np.cos(angle), np.sin(angle)])).round().astype(int)
    frame, background = dotted((int(u), int(v)), radius_px)
    silhouette = SEGMENTER(frame, background)
    assert silhouette.status is ViewStatus.OK
    labels, expected = silhouette.label_image(), truth.label_image()
    assert labels[v, u] in (UNKNOWN, expected[v, u])  # detail tells the body before a dot that is as dark
    # where the truth is more than a pixel away from the edge, what is decided is right
    clear = np.zeros(labels.shape, np.float32)
    (left, top), (h, w) = truth.offset_uv, distances_of(truth).shape
    clear[top : top + h, left : left + w] = distances_of(truth)
    decided_inside, decided_outside = labels == INSIDE, labels == OUTSIDE
    assert not (decided_inside & (clear < -1)).any()
    assert not (decided_outside & (clear > 1)).any()
    assert (labels == UNKNOWN).sum() < 4 * np.pi * (radius_px + 6) ** 2
    assert (expected == INSIDE).sum() > 0
    # unknown pixels do not carve: the distance never denies the body
    offset_u, offset_v = silhouette.offset_uv
    height, width = silhouette.labels.shape
    inside_truth = clear[offset_v : offset_v + height : FINE_PX, offset_u : offset_u + width : FINE_PX] > 1
    assert silhouette.fine_px[inside_truth].min() > -0.5


@examples(0.3)
@given(st.floats(0.1, 1.4), st.floats(-3, 3), st.floats(0.6, 1.0))
def test_distance_to_a_straight_edge_is_exact(angle: float, shift_px: float, blur_px: float) -> None:
    """Along rows or columns, just between two, an edge has the same slope half a pixel to either side."""
    v, u = np.mgrid[0:80, 0:80].astype(float)
    true_px = (u - 40) * np.cos(angle) + (v - 40) * np.sin(angle) + shift_px
    coverage = ndtr(true_px / blur_px)
    grey = (
        200 - 180 * coverage + np.random.default_rng(0).random(coverage.shape)
    )  # so that rounding moves no edge
    image, expected = grey.astype(np.uint8), np.full(coverage.shape, 200, np.uint8)
    few_px = true_px[::2, ::2]
    edge = delineate(image, expected, trimap_of(few_px > 4.5, few_px > -4.5, few_px > 99)).edge
    assert edge is not None
    errors_px, outline = (
        edge.fine_px(edge.coarse_px()) - true_px[::FINE_PX, ::FINE_PX],
        edge.outline_uv,
    )
    within = ((np.abs(true_px) < 5) & (np.abs(u - 40) < 25) & (np.abs(v - 40) < 25))[::FINE_PX, ::FINE_PX]
    assert np.abs(errors_px)[within].max() < 0.1
    assert abs(errors_px[within].mean()) < 0.06
    errors = (outline[:, 0] - 40) * np.cos(angle) + (outline[:, 1] - 40) * np.sin(angle) + shift_px
    inner = (np.abs(outline - 40) < 30).all(axis=1)
    assert np.abs(errors[inner]).max() < 0.1


def test_background_is_the_mean_of_empty_frames_with_the_flash_divided_out() -> None:
    camera = CameraId("c01")
    frame = rendered.bundle_of(number=4).frames[camera]
    bright = with_image(frame, 1.05 * frame.image.astype(float))
    model = learn_background({}, {camera: frame})
    for _ in range(3):
        model = learn_background(model, {camera: bright})
    assert model[camera].n_frames == 4
    assert np.abs(model[camera].mean - frame.image).mean() < 0.6, "five percent would be ten grey levels"


def test_background_forgets_slowly() -> None:
    camera = CameraId("c01")
    frame = rendered.bundle_of(number=4).frames[camera]
    dusty_image = frame.image.astype(float)
    dusty_image[100:120, 100:120] *= 0.8
    dusty, model = with_image(frame, dusty_image), learn_background({}, {camera: frame})
    for _ in range(60):
        model = learn_background(model, {camera: dusty})
    assert model[camera].mean[105:115, 105:115].mean() == pytest.approx(
        dusty.image[105:115, 105:115].mean(), rel=0.01
    )


def test_background_never_learns_a_stone() -> None:
    camera = CameraId("c01")
    model = rendered.background()
    after = learn_background(model, {camera: rendered.sphere_bundle().frames[camera]})
    assert after[camera].mean is model[camera].mean
    assert after[camera].n_frames == model[camera].n_frames


def test_background_that_began_with_a_stone_is_learnt_anew() -> None:
    camera = CameraId("c01")
    model = learn_background({}, {camera: rendered.sphere_bundle().frames[camera]})
    empty = rendered.bundle_of(number=4).frames[camera]
    for _ in range(4):
        model = learn_background(model, {camera: empty})
    assert np.abs(model[camera].mean - empty.image).mean() < 0.1


def test_flash_gain_is_found_beside_a_large_body() -> None:
    wall = np.full((256, 320), 200, np.float32)
    image = 1.07 * wall
    image[:, :150] = 60
    assert flash_gain(image, wall) == pytest.approx(1.07, rel=1e-3)


@pytest.mark.parametrize("wrong", [{"min_contrast": 0.0}, {"dark_share": 1.0}, {"min_body_px": 3.0}])
def test_segmentation_parameters_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        SegmentationParameters(**wrong)
