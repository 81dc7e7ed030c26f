"""Points of the surface, aligned to the grey levels of their views: shifts found, and none where nothing is shown."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from support.render_cache import kept_rendered
from support.rendered import SEED, background, rig, simulated

from pipeline.arrays import PointsMM, Values
from pipeline.frames import FrameBundle
from pipeline.geometry.icosphere import icosphere
from pipeline.meshing import ParticleMesh
from pipeline.refinement.grey_alignment import BLUR_PX, _looked, aligned
from pipeline.refinement.sightings import PhotoViews, photo_views
from pipeline.rig.lens import region_pixel
from pipeline.segmentation import segment_all
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.bodies import SurfaceKind, sphere
from pipeline.synthesis.bundles import render_bundle, stream
from pipeline.synthesis.renderer import PlacedBody
from pipeline.views.prepared import prepare_views

RADIUS_MM = 7.5
HULL_MM = 2 * RADIUS_MM * icosphere(subdivisions=5)[0]
NO_TOUCHES = np.empty((0, 3))
ROCK = replace(sphere(), surface=SurfaceKind.GRAINED, contrast=0.25)


@kept_rendered
def exposed() -> FrameBundle:
    placed = PlacedBody(body=ROCK, R=np.eye(3), offset_mm=np.zeros(3))
    return render_bundle([placed], simulated(), stream(SEED, 61), sequence=1)


@cache
def ball() -> ParticleMesh:
    directions, faces = icosphere(subdivisions=5)
    return ParticleMesh(RADIUS_MM * directions, faces)


@cache
def views() -> PhotoViews:
    frames = exposed().frames
    silhouettes = segment_all(frames, background(), BackgroundSegmenter())
    return photo_views(frames, prepare_views(silhouettes, rig()), ball().vertices_mm, background())


def heights_mm(points_mm: PointsMM) -> Values:
    """Return the distances (N,) of points from the sphere, mm, positive outside."""
    return np.asarray(np.linalg.norm(points_mm, axis=1) - RADIUS_MM)


def relief(wavelength_mm: float, height_mm: float) -> PointsMM:
    """Return the sphere with waves on it, which its pictures do not show."""
    vertices_mm = ball().vertices_mm
    waves = np.prod(np.sin(2 * np.pi * vertices_mm / wavelength_mm), axis=1)
    return np.asarray(vertices_mm * (1 + height_mm * waves / RADIUS_MM)[:, None])


def rms_mm(lengths_mm: Values) -> float:
    return float(np.sqrt(np.mean(lengths_mm**2)))


@pytest.mark.parametrize("wavelength_mm", [3.0, 6.0])
def test_relief_that_pictures_do_not_show_is_taken_off(wavelength_mm: float) -> None:
    wavy_mm = relief(wavelength_mm, 0.15)
    found_mm = aligned(wavy_mm, ball().faces, HULL_MM, NO_TOUCHES, views(), 1.0)
    assert rms_mm(heights_mm(found_mm)) < 0.4 * rms_mm(heights_mm(wavy_mm))


@pytest.mark.parametrize("off_mm", [-0.03, 0.03])
def test_a_surface_that_is_off_everywhere_is_found(off_mm: float) -> None:
    """Means of the surroundings that are not found again after a step would hold it."""
    off_mm_by_vertex = ball().vertices_mm * (1 + off_mm / RADIUS_MM)
    found_mm = aligned(off_mm_by_vertex, ball().faces, HULL_MM, NO_TOUCHES, views(), 1.0)
    assert abs(heights_mm(found_mm).mean()) < 0.35 * abs(off_mm)


def test_near_the_hull_no_point_moves_further_inward_than_it_may_outward() -> None:
    wavy_mm = relief(3.0, 0.15)
    hull_mm = wavy_mm * (1 + 0.004 / RADIUS_MM)
    found_mm = aligned(wavy_mm, ball().faces, hull_mm, NO_TOUCHES, views(), 1.0)
    assert np.linalg.norm(found_mm - wavy_mm, axis=1).max() <= 0.0041


def test_a_surface_that_is_right_stays() -> None:
    found_mm = aligned(ball().vertices_mm, ball().faces, HULL_MM, NO_TOUCHES, views(), 1.0)
    assert abs(heights_mm(found_mm).mean()) < 0.003
    assert rms_mm(heights_mm(found_mm)) < 0.01


def test_noise_alone_moves_nothing() -> None:
    noise = np.random.default_rng(0).normal(60, 1.2, views().regions.shape)
    blank = views()._replace(regions=np.rint(noise).astype(np.uint8))
    wavy_mm = relief(6.0, 0.1)
    found_mm = aligned(wavy_mm, ball().faces, HULL_MM, NO_TOUCHES, blank, 1.0)
    assert rms_mm(np.linalg.norm(found_mm - wavy_mm, axis=1)) < 0.01


def test_points_that_tangent_rays_touch_stay() -> None:
    wavy_mm = relief(6.0, 0.1)
    free_mm, held_mm = (
        aligned(wavy_mm, ball().faces, HULL_MM, touches_mm, views(), 1.0)
        for touches_mm in (NO_TOUCHES, wavy_mm[wavy_mm[:, 2] > 0])
    )
    above = wavy_mm[:, 2] > 1.0
    moved = [rms_mm(np.linalg.norm((each - wavy_mm)[above], axis=1)) for each in (free_mm, held_mm)]
    assert moved[1] < 0.5 * moved[0]


def test_points_look_at_the_same_grey_levels_as_in_whole_blurred_images():
    points_mm, seen = ball().vertices_mm[::50].copy(), views()
    seen_by = np.tile(np.arange(len(seen.regions), dtype=np.int32), (len(points_mm), 1))
    greys, _ = _looked(seen, points_mm, points_mm / RADIUS_MM, seen_by)
    for view, region in enumerate(seen.regions):
        kernel = cv2.getGaussianKernel(5, BLUR_PX)
        image = np.asarray(cv2.sepFilter2D(region, cv2.CV_32F, kernel, kernel))
        in_camera_mm = points_mm @ seen.R[view].T + seen.t_mm[view]
        at_px = in_camera_mm[:, :2] / in_camera_mm[:, 2:]
        pixels = [region_pixel(tuple(seen.lenses[view]), x, y) for x, y in at_px]
        expected = cv2.remap(image, np.array(pixels, np.float32)[:, None], None, cv2.INTER_LINEAR)[:, 0]
        is_seen = greys[:, view] >= 0
        assert is_seen.mean() > 0.9
        np.testing.assert_allclose(greys[is_seen, view], expected[is_seen], atol=1.0)
