"""Clearances, found in few samples and with views asked while it matters, against asking all of them everywhere."""

from functools import cache

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from support.forms import form, silhouettes_of
from support.silhouettes import sphere_silhouettes

from pipeline.rig.cameras import CameraCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation.silhouette import FINE_PX, MARGIN_PX, Silhouette
from pipeline.views.clearance import MAX_RAYS, body_sphere, clearances_px
from pipeline.views.distance_field import HALF_EDGE_MM, distance_field
from pipeline.views.prepared import PreparedViews, prepare_views

RIG = as_built(nominal_rig(), seed=8)
N_SAMPLES = 1500


@cache
def views() -> PreparedViews:
    rng = np.random.default_rng(2)
    return prepare_views(silhouettes_of(form("polyhedron", rng).mesh, RIG, rng), RIG)


def values_mm(camera: CameraCalibration, silhouette: Silhouette, points_mm: np.ndarray) -> np.ndarray:
    pixels_uv, depths_mm = camera.project(points_mm)
    place = (pixels_uv - silhouette.offset_uv).T[::-1] / FINE_PX
    found_px = map_coordinates(silhouette.fine_px, place, order=1, cval=-MARGIN_PX)
    return np.asarray(found_px * depths_mm / camera.focal_px)


def searched_px(index: int, sphere: tuple[np.ndarray, float], overruled: int) -> np.ndarray:
    """Clearances (MAX_RAYS,) of one view: the highest of `N_SAMPLES` values along each ray."""
    camera, silhouette = views().calibrations[index], views().silhouettes[index]
    center_mm, radius_mm = sphere
    outline_uv = silhouette.outline_uv
    rays = camera.rays(outline_uv[np.linspace(0, len(outline_uv), MAX_RAYS, endpoint=False).astype(int)])
    closest_mm = (center_mm - camera.center_mm) @ rays.T
    along_mm = closest_mm[:, None] + np.linspace(-radius_mm, radius_mm, N_SAMPLES)
    points_mm = (camera.center_mm + along_mm[..., None] * rays[:, None]).reshape(-1, 3)
    others = views().without([camera.id])
    pairs = zip(others.calibrations, others.silhouettes, strict=True)
    field_mm = np.sort([values_mm(*view, points_mm) for view in pairs], axis=0)[overruled]
    return np.asarray(field_mm.reshape(along_mm.shape).max(axis=1) * camera.focal_px / closest_mm)


@pytest.mark.parametrize("overruled", [0, 2])
def test_clearances_are_those_of_a_search_everywhere(overruled: int) -> None:
    field = distance_field(views(), overruled)
    sphere = body_sphere(field)
    assert sphere is not None
    found_px = clearances_px(views(), field, sphere)
    settled_px = clearances_px(views(), field, sphere, RIG.camera_ids)
    for index in (0, 13):
        expected_px = searched_px(index, sphere, overruled)
        missed_px = expected_px - found_px[index]  # the last samples are half a pixel from the peak at most
        assert np.median(missed_px) < 0.05
        assert missed_px.max() < 0.5
        assert missed_px.min() > -0.1
        np.testing.assert_array_equal(np.minimum(settled_px[index], 0), np.minimum(found_px[index], 0))


def test_rays_that_miss_the_body_by_far_have_their_clearance_too() -> None:
    silhouettes = sphere_silhouettes(RIG, (0.0, 0.0, 0.0), 5.0)
    moved = sphere_silhouettes(RIG, (4.0, 0.0, 0.0), 5.0, RIG.camera_ids[12:13])
    seen = prepare_views({**silhouettes, **moved}, RIG)
    sphere = body_sphere(distance_field(seen, 1))
    assert sphere is not None
    found_px = clearances_px(seen, distance_field(seen, 0), sphere)[12]
    assert found_px.min() < -25
    assert np.isfinite(found_px).all()


def test_the_sphere_holds_the_body_and_is_not_much_larger() -> None:
    seen = prepare_views(sphere_silhouettes(RIG, (2.0, -3.0, 1.0), 6.0), RIG)
    sphere = body_sphere(distance_field(seen, 0))
    assert sphere is not None
    center_mm, radius_mm = sphere
    reach_mm = np.linalg.norm(center_mm - [2.0, -3.0, 1.0]) + 6.0
    assert reach_mm < radius_mm < 2.5 * 6.0 + 2


def test_views_without_a_body_in_common_have_no_sphere() -> None:
    apart = {
        camera: silhouette
        for number, camera in enumerate(RIG.camera_ids)
        for silhouette in sphere_silhouettes(RIG, (0, 0, 15.0 * (-1) ** number), 2.0, [camera]).values()
    }
    assert HALF_EDGE_MM > 15
    assert body_sphere(distance_field(prepare_views(apart, RIG), 0)) is None
