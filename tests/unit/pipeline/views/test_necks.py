"""A silhouette is that of two bodies if it is narrow between them; a whole stone's is not."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.parts import views_of

from pipeline.arrays import GreyImage
from pipeline.frames import CameraId
from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation.silhouette import INSIDE, UNKNOWN, Silhouette, ViewStatus
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.stones import STONE_FORMS, stone
from pipeline.views.necks import shows_neck

RIG = as_built(nominal_rig(), 4)
SIZE_PX = (640, 512)


def silhouette(labels: GreyImage) -> Silhouette:
    height, width = labels.shape
    return Silhouette(
        camera=CameraId("c01"), status=ViewStatus.OK, image_size_px=(width, height), labels=labels
    )


def discs(*radii_px: float, apart_px: float, angle: float) -> GreyImage:
    """Two discs, their centres so far apart."""
    image = np.zeros(SIZE_PX[::-1], np.uint8)
    along = apart_px * np.array([np.cos(angle), np.sin(angle)])
    for radius_px, at in zip(radii_px, (-along / 2, along / 2), strict=True):
        center = np.rint(8 * (at + np.array(SIZE_PX) / 2)).astype(int)
        cv2.circle(image, center.tolist(), round(8 * radius_px), int(INSIDE), cv2.FILLED, shift=3)
    return image


@given(st.floats(50, 120), st.floats(0.3, 1), st.floats(0.98, 1), st.floats(0, 2 * np.pi))
def test_discs_that_touch_are_two_bodies(
    radius_px: float, share: float, nearness: float, angle: float
) -> None:
    both = discs(radius_px, share * radius_px, apart_px=nearness * (1 + share) * radius_px, angle=angle)
    assert shows_neck([silhouette(both)])


@given(st.floats(10, 120), st.floats(0.1, 1), st.floats(0, 0.7), st.floats(0, 2 * np.pi))
def test_discs_of_which_each_covers_much_of_the_other_are_one(
    radius_px: float, share: float, nearness: float, angle: float
) -> None:
    both = discs(radius_px, share * radius_px, apart_px=nearness * max(share, 0.3) * radius_px, angle=angle)
    assert not shows_neck([silhouette(both)])


@pytest.mark.parametrize("form", STONE_FORMS)
def test_a_stone_alone_is_one(form: str) -> None:
    rng = stream(6, len(form))
    for _ in range(4):
        points_mm = stone(form, float(rng.uniform(5, 36)), rng).mesh.vertices
        seen = views_of(RIG, [points_mm @ Rotation.random(rng=rng).as_matrix().T])
        labels = (np.where(view.parts.numbers > 0, INSIDE, 0).astype(np.uint8) for view in seen)
        assert not shows_neck(silhouette(each.repeat(4, axis=0).repeat(4, axis=1)) for each in labels)


def test_what_is_unknown_beside_a_body_is_no_other() -> None:
    beside = discs(60.0, 30.0, apart_px=92.0, angle=0.3)
    columns = np.arange(SIZE_PX[0])
    assert shows_neck([silhouette(beside)])
    assert not shows_neck([silhouette(np.where((beside > 0) & (columns > 330), UNKNOWN, beside))])
    assert not shows_neck([silhouette(np.zeros((0, 0), np.uint8))])
