"""Coverage through an aperture against rays, against a pinhole's, and against the formula of the blur disc."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from support.aperture_rays import coverage_by_rays
from support.extents import first_quick
from support.synthetic_rigs import rig_of

from pipeline.arrays import FloatImage, Floats
from pipeline.rig.cameras import CameraCalibration
from pipeline.rig.design import as_built
from pipeline.synthesis.bodies import Body, ball, cube, sphere
from pipeline.synthesis.defocused_coverage import defocused_coverage
from pipeline.synthesis.pixel_coverage import Window, mesh_edges, window_around
from pipeline.synthesis.thin_lens import ThinLens

CAMERA = as_built(rig_of("c05"), 3).cameras[0]
ON_AXIS = rig_of("c05").cameras[0]  # without distortion, looks at the origin from 300 mm
F2 = ThinLens(f_number=2.0)
PINHOLE = ThinLens(f_number=10_000.0)


def seen(
    body: Body, lens: ThinLens, camera: CameraCalibration = ON_AXIS, farther_mm: float = 0.0
) -> tuple[trimesh.Trimesh, Window, FloatImage]:
    """Return a tilted body that far behind the middle, in the world frame, the window around it, and its coverage."""
    tilt = Rotation.from_euler("xyz", [20, 35, 50], degrees=True).as_matrix()
    vertices_mm = body.mesh.vertices @ tilt.T + farther_mm * camera.R[2]
    mesh = trimesh.Trimesh(vertices_mm, body.mesh.faces, process=False)
    pixels_uv, depths_mm = camera.project(vertices_mm)
    # of the largest disc, so that images of different lenses compare
    window = window_around(pixels_uv, float(F2.disc_px(depths_mm, camera.focal_px).max()))
    points_mm = vertices_mm @ camera.R.T + camera.t_mm
    return (
        mesh,
        window,
        defocused_coverage(points_mm, mesh.faces, mesh_edges(mesh.faces), camera, lens, window),
    )


def variances(weights: FloatImage) -> Floats:
    """Return the variances (2,) of where the weights are, along u and v."""
    sums = weights.sum(axis=0, dtype=np.float64), weights.sum(axis=1, dtype=np.float64)
    means = [np.average(np.arange(len(each)), weights=each) for each in sums]
    return np.array(
        [
            np.average((np.arange(len(each)) - mean) ** 2, weights=each)
            for each, mean in zip(sums, means, strict=True)
        ]
    )


@pytest.mark.parametrize("body", first_quick([cube(4.0), sphere(4.0)]), ids=lambda body: body.name)
@pytest.mark.parametrize("farther_mm", first_quick([-9.0, 12.0]))
@pytest.mark.full
def test_it_is_the_share_of_rays_that_hit(body: Body, farther_mm: float) -> None:
    mesh, window, covered = seen(body, F2, CAMERA, farther_mm)
    by_rays = coverage_by_rays(
        mesh,
        CAMERA,
        aperture_mm=12.5,
        focus_mm=300.0,
        corner_uv=(window.left, window.top),
        size_px=(window.width, window.height),
    )
    error = covered - by_rays
    at_edge = (by_rays > 0) & (by_rays < 1)
    assert np.sqrt((error[at_edge] ** 2).mean()) < 0.008  # the rays' own is 0.005
    assert np.abs(error).max() < 0.03
    assert covered.sum() == pytest.approx(by_rays.sum(), rel=2e-4)


@pytest.mark.parametrize("farther_mm", [-20.0, 20.0])
def test_a_ball_is_spread_over_a_disc_of_the_diameter_of_the_formula(farther_mm: float) -> None:
    """An even disc of diameter d adds d^2 / 16 to the variance along any direction."""
    _, _, sharp = seen(ball(1.0), PINHOLE, farther_mm=farther_mm)
    _, _, covered = seen(ball(1.0), F2, farther_mm=farther_mm)
    disc_px = 6250 * 12.5 * abs(1 / 300 - 1 / (300 + farther_mm))
    np.testing.assert_allclose(variances(covered) - variances(sharp), disc_px**2 / 16, rtol=0.01)
    assert covered.sum() == pytest.approx(sharp.sum(), rel=1e-3)


def test_what_is_in_focus_is_as_sharp_as_through_a_pinhole() -> None:
    """Each point of the aperture sees an outline of its own, some 0.2 mm nearer or farther."""
    rim_mm = 300 - 7.5**2 / 300
    _, _, sharp = seen(sphere(), PINHOLE)
    _, _, covered = seen(sphere(), ThinLens(f_number=2.0, focus_mm=rim_mm))
    assert np.abs(covered - sharp).max() < 0.04
    assert covered.sum() == pytest.approx(sharp.sum(), rel=2e-4)


def test_a_straight_edge_is_half_covered_where_a_pinhole_has_it() -> None:
    """However far out of focus: here a face of 30 mm, 20 mm behind the plane in focus, blurred over 16 px."""
    mesh = trimesh.creation.box(extents=[30.0, 30.0, 0.01])
    points_mm = mesh.vertices + np.array([0.0, 0.0, 320.0])
    edges, window = mesh_edges(mesh.faces), Window(600, 500, 500, 20)
    rows = [
        defocused_coverage(points_mm, mesh.faces, edges, ON_AXIS, lens, window)[10] for lens in (PINHOLE, F2)
    ]
    assert np.count_nonzero((rows[1] > 0.01) & (rows[1] < 0.99)) > 14
    assert rows[1].sum(dtype=np.float64) == pytest.approx(rows[0].sum(dtype=np.float64), abs=0.01)
    border_px = rows[0].sum(dtype=np.float64)
    assert np.interp(border_px - 0.5, np.arange(500), rows[1]) == pytest.approx(0.5, abs=0.005)


def test_a_window_shows_what_a_larger_one_shows_there() -> None:
    mesh, window, whole = seen(cube(4.0), F2, farther_mm=9.0)
    points_mm = mesh.vertices @ ON_AXIS.R.T + ON_AXIS.t_mm
    part = Window(window.left + 30, window.top + 40, 50, 45)
    covered = defocused_coverage(points_mm, mesh.faces, mesh_edges(mesh.faces), ON_AXIS, F2, part)
    np.testing.assert_allclose(covered, whole[40:85, 30:80], atol=1e-5)
