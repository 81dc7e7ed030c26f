"""One bad view is found and named; the good ones are not condemned with it."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.extents import examples
from support.forms import silhouettes_of
from support.silhouettes import sphere_silhouette, sphere_silhouettes

from pipeline.frames import CameraId
from pipeline.rig import lens
from pipeline.rig.design import as_built, nominal_rig
from pipeline.views import clearance, distance_field, outline_hull, tangent_planes
from pipeline.views import epipolar_tangency as tangency
from pipeline.views.consistency import ConsistencyParameters, check_consistency, warm_up
from pipeline.views.prepared import prepare_views

RIG = as_built(nominal_rig(), seed=6)
PARAMETERS = ConsistencyParameters()
CENTER_MM = np.array([1.0, -1.0, 0.5])


def seen_instead(camera: CameraId, center_mm: tuple[float, float, float], radius_mm: float) -> dict:
    silhouettes = sphere_silhouettes(RIG, CENTER_MM)
    view = RIG.subset([camera]).cameras[0]
    return {**silhouettes, camera: sphere_silhouette(view, np.array(center_mm), radius_mm)}


def test_after_the_warm_up_nothing_is_left_to_compile_and_good_views_agree() -> None:
    kernels = [
        distance_field._lower,
        distance_field._narrow,
        clearance._cast_rays,
        tangent_planes._clip,
        tangency._touch,
        outline_hull._look_for_gaps,
        lens._undistort,
    ]
    assert warm_up().is_consistent
    compiled = [kernel.signatures for kernel in kernels]
    assert all(compiled)
    found = check_consistency(prepare_views(sphere_silhouettes(RIG, CENTER_MM), RIG), PARAMETERS)
    assert found.is_consistent
    assert not found.suspects
    assert set(found.residuals_px) == set(RIG.camera_ids)
    assert max(found.residuals_px.values()) < 0.2
    assert [kernel.signatures for kernel in kernels] == compiled


@pytest.mark.parametrize(
    ("center_mm", "radius_mm"),
    [
        pytest.param((1.0, -1.0, 2.0), 7.5, id="one and a half millimetres too high"),
        pytest.param((1.0, -1.0, 0.5), 9.0, id="too large"),
        pytest.param((1.0, -1.0, 0.5), 4.0, id="too small"),
        pytest.param((12.0, 8.0, 6.0), 5.0, id="another stone elsewhere"),
    ],
)
@pytest.mark.parametrize("camera", ["c01", "c10"])
def test_the_wrong_view_is_named_and_no_other(
    camera: CameraId, center_mm: tuple[float, float, float], radius_mm: float
) -> None:
    found = check_consistency(prepare_views(seen_instead(camera, center_mm, radius_mm), RIG), PARAMETERS)
    assert list(found.suspects) == [camera]
    assert found.is_consistent
    assert camera not in found.residuals_px


@examples(0.04)
@given(st.lists(st.sampled_from(RIG.camera_ids), min_size=2, max_size=2, unique=True))
def test_two_wrong_views_are_named(cameras: list[CameraId]) -> None:
    silhouettes = sphere_silhouettes(RIG, CENTER_MM)
    for camera, offset_mm in zip(cameras, (2.0, -2.0), strict=True):
        view = RIG.subset([camera]).cameras[0]
        silhouettes[camera] = sphere_silhouette(view, CENTER_MM + np.array([0, 0, offset_mm]), 7.5)
    found = check_consistency(prepare_views(silhouettes, RIG), PARAMETERS)
    assert set(found.suspects) == set(cameras)
    assert found.is_consistent


def test_more_wrong_views_than_may_be_dropped_are_not_one_body() -> None:
    silhouettes = sphere_silhouettes(RIG, CENTER_MM)
    for number, camera in enumerate(RIG.camera_ids[::2]):
        view = RIG.subset([camera]).cameras[0]
        silhouettes[camera] = sphere_silhouette(view, CENTER_MM + np.array([0, 0, 2 + number]), 7.5)
    assert not check_consistency(prepare_views(silhouettes, RIG), PARAMETERS).is_consistent


def test_views_of_nothing_in_common_are_inconsistent() -> None:
    silhouettes = {
        camera.id: sphere_silhouette(camera, np.array([0, 0, 15.0 * (-1) ** number]), 2.0)
        for number, camera in enumerate(RIG.cameras)
    }
    found = check_consistency(prepare_views(silhouettes, RIG), PARAMETERS)
    assert not found.is_consistent


def test_a_view_that_alone_bounds_a_side_is_not_condemned() -> None:
    # without c01, nobody else but c11 sees along two faces of this cube: the hull without it is far larger
    turn = Rotation.from_rotvec([-47.97, -61.94, 67.18], degrees=True).as_matrix()
    cube = trimesh.creation.box(extents=[15.0] * 3)
    placed = trimesh.Trimesh(cube.vertices @ turn.T + [-2.4, -2.08, -0.45], cube.faces)
    silhouettes = silhouettes_of(placed, RIG, np.random.default_rng(1))
    del silhouettes[CameraId("c01")]
    found = check_consistency(prepare_views(silhouettes, RIG), PARAMETERS)
    assert not found.suspects
    assert found.is_consistent
