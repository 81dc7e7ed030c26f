"""The paper's segmentation: the mask of a network is the silhouette."""

import numpy as np
import pytest
from support.networks import darkness_network

from pipeline.errors import ModelError
from pipeline.frames import CameraId, Frame, Image
from pipeline.segmentation.mask_segmenter import MaskSegmenter, silhouette_of_mask
from pipeline.segmentation.network import load_network
from pipeline.segmentation.silhouette import MARGIN_PX, FoundBy, ViewStatus

V, U = np.mgrid[:1024, :1280]


def frame_of(image: Image) -> Frame:
    return Frame(camera=CameraId("c01"), image=image, frame_id=1, device_ns=0, received_ns=0)


def disc(u: float, v: float, radius_px: float) -> Image:
    return np.where(np.hypot(U - u, V - v) < radius_px, 60, 200).astype(np.uint8)


def test_the_largest_contour_of_the_mask_is_the_silhouette() -> None:
    """At 320 x 320 an image has cells of 4 x 3.2 px, whose edges grow linear again: a disc keeps its size."""
    image = np.minimum(disc(600, 500, 100), disc(200, 200, 20))
    found = MaskSegmenter(load_network(darkness_network()))(frame_of(image), {})
    assert (found.status, found.found_by) == (ViewStatus.OK, "u2net")
    radii_px = np.hypot(*(found.outline_uv - [600, 500]).T)
    assert radii_px.mean() == pytest.approx(100, abs=1.0)
    assert radii_px.std() < 1.0
    assert found.edge_sigma_px is None  # nothing is known of its edge, so that no result is good
    assert found.offset_uv[0] == pytest.approx(500 - MARGIN_PX, abs=2)


def test_distances_are_those_to_the_edge_between_pixels() -> None:
    found = silhouette_of_mask(frame_of(disc(600, 500, 100)), disc(600, 500, 100) < 100, FoundBy.U2NET)
    v, u = np.mgrid[: found.labels.shape[0] : 2, : found.labels.shape[1] : 2]
    left, top = found.offset_uv
    expected_px = 100 - np.hypot(u + left - 600, v + top - 500)
    assert found.fine_px == pytest.approx(expected_px, abs=1.0)
    assert ((found.fine_px > 0) == (found.labels[::2, ::2] == 255)).all()


def test_holes_are_filled_and_other_bodies_left_out() -> None:
    mask = np.zeros(U.shape, bool)
    mask[300:500, 300:500] = True
    mask[350:400, 350:400] = False
    mask[700:720, 700:720] = True
    found = silhouette_of_mask(frame_of(mask.view(np.uint8)), mask, FoundBy.U2NET)
    assert np.count_nonzero(found.label_image() == 255) == 200 * 200
    assert found.outline_uv.min(axis=0) == pytest.approx([299.5, 299.5], abs=0.01)


def test_views_without_a_whole_body_say_so() -> None:
    nothing = np.zeros(U.shape, bool)
    assert (
        silhouette_of_mask(frame_of(nothing.view(np.uint8)), nothing, FoundBy.U2NET).status
        is ViewStatus.EMPTY
    )
    cut = nothing.copy()
    cut[:100, 300:400] = True
    assert silhouette_of_mask(frame_of(cut.view(np.uint8)), cut, FoundBy.U2NET).status is ViewStatus.CLIPPED


def test_a_network_that_fails_finds_nothing_and_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    network = load_network(darkness_network())

    def fail(view: object) -> None:
        raise ModelError("no memory")

    monkeypatch.setattr(type(network), "probability", lambda self, view: fail(view))
    found = MaskSegmenter(network)(frame_of(disc(600, 500, 100)), {})
    assert (found.status, found.network_trouble) == (ViewStatus.EMPTY, "no memory")
