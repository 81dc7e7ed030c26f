"""The visual hull against bodies whose hull is known."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples, first_quick
from support.silhouettes import sphere_silhouettes

from pipeline.carving import CarvingParameters, VisualHull, all_leaves, carve
from pipeline.frames import CameraId
from pipeline.meshing import mesh_hull
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation.silhouette import OUTSIDE, UNKNOWN, KnownDistances, Silhouette, ViewStatus
from pipeline.views.prepared import prepare_views

RIG = as_built(nominal_rig(), seed=5)
COARSE = CarvingParameters(n=128)
SPHERE_MM3 = 4 / 3 * np.pi * 7.5**3


def meshed(hull: VisualHull) -> trimesh.Trimesh:
    mesh = mesh_hull(hull)
    assert mesh is not None
    return trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)


def occupied(hull: VisualHull) -> set[tuple[int, ...]]:
    """Voxels inside, as indices of the whole grid."""
    low = np.round(hull.origin_mm / hull.pitch_mm - 0.5).astype(int)
    return set(map(tuple, np.argwhere(hull.field > hull.level) + low))


def test_sub_voxel_hull_of_a_sphere_has_the_volume_of_its_sixteen_cones() -> None:
    mesh = meshed(carve(prepare_views(sphere_silhouettes(RIG), RIG), CarvingParameters()))
    # the exact hull of the design is +0.76 %; marching cubes cuts the ridges by 0.05 %
    assert mesh.volume / SPHERE_MM3 == pytest.approx(1.0071, abs=0.0008)
    radii = np.linalg.norm(mesh.vertices, axis=1)
    assert radii.min() > 7.5 - 0.01, "over-carved"
    assert np.abs(radii - 7.5).mean() < 0.025


@pytest.mark.full
def test_view_count_field_erodes_as_the_paper_s_does() -> None:
    mesh = meshed(carve(prepare_views(sphere_silhouettes(RIG), RIG), CarvingParameters(field="view_count")))
    assert mesh.volume / SPHERE_MM3 == pytest.approx(0.991, abs=0.003)
    assert mesh.area / (4 * np.pi * 7.5**2) == pytest.approx(1.056, abs=0.01), "the staircase costs area"


def test_view_count_is_the_number_of_views_in_every_voxel_near_the_surface() -> None:
    hull = carve(
        prepare_views(sphere_silhouettes(RIG, radius_mm=5), RIG), CarvingParameters(n=64, field="view_count")
    )
    assert hull.level == 15.5
    for i, j, k in np.argwhere((hull.field > 0) & (hull.field < 16))[::97]:
        point = hull.origin_mm + hull.pitch_mm * np.array([i, j, k])
        inside = 0
        for camera in RIG.cameras:
            offset = -camera.center_mm
            ray = point - camera.center_mm
            cosine = ray @ offset / np.linalg.norm(ray) / np.linalg.norm(offset)
            inside += np.arccos(cosine) < np.arcsin(5 / np.linalg.norm(offset))
        assert abs(inside - hull.field[i, j, k]) <= 1, "a voxel beside an edge may round either way"


@pytest.mark.parametrize("field", ["sub_voxel", "view_count"])
def test_axes_are_x_y_z(field: str) -> None:
    center_mm = (6.0, -4.0, 3.0)
    parameters = CarvingParameters(n=128, field=field)
    mesh = meshed(carve(prepare_views(sphere_silhouettes(RIG, center_mm, 3.0), RIG), parameters))
    assert mesh.center_mass == pytest.approx(center_mm, abs=0.05)


@pytest.mark.parametrize("field", ["sub_voxel", "view_count"])
@pytest.mark.parametrize("radius_mm", first_quick([4.0, 1.0, 18.0]))
def test_mesh_is_closed_and_faces_outwards(field: str, radius_mm: float) -> None:
    parameters = CarvingParameters(field=field)
    mesh = meshed(carve(prepare_views(sphere_silhouettes(RIG, (0.3, 0.2, -0.4), radius_mm), RIG), parameters))
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.body_count == 1


@examples(0.12)
@given(st.sets(st.sampled_from(RIG.camera_ids), min_size=3, max_size=15), st.sampled_from(RIG.camera_ids))
def test_adding_a_view_never_adds_a_voxel(cameras: set[CameraId], added: CameraId) -> None:
    parameters = CarvingParameters(n=64)
    fewer = carve(prepare_views(sphere_silhouettes(RIG, (1, 2, 3), 5, cameras), RIG), parameters)
    more = carve(prepare_views(sphere_silhouettes(RIG, (1, 2, 3), 5, cameras | {added}), RIG), parameters)
    assert occupied(more) <= occupied(fewer)


@examples(0.1)
@given(st.floats(1.5, 10), *[st.floats(-6, 6)] * 3)
def test_hull_contains_the_body(radius_mm: float, x: float, y: float, z: float) -> None:
    mesh = meshed(carve(prepare_views(sphere_silhouettes(RIG, (x, y, z), radius_mm), RIG), COARSE))
    distances = np.linalg.norm(mesh.vertices - [x, y, z], axis=1)
    # at a vertex linear interpolation errs by the sagitta of one voxel at most
    assert distances.min() > radius_mm - COARSE.pitch_mm**2 / (8 * radius_mm) - 0.01


def turned(rig: RigCalibration, angle: float) -> RigCalibration:
    from dataclasses import replace

    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    cameras = tuple(replace(camera, R=camera.R @ turn.T) for camera in rig.cameras)
    return replace(rig, cameras=cameras)


def test_turning_rig_and_body_together_changes_nothing() -> None:
    still = meshed(carve(prepare_views(sphere_silhouettes(RIG, (3, 0, 1), 6), RIG), COARSE))
    rig = turned(RIG, np.pi / 2)
    moved = meshed(carve(prepare_views(sphere_silhouettes(rig, (0, 3, 1), 6), rig), COARSE))
    assert moved.volume == pytest.approx(still.volume, rel=1e-4)


def test_unknown_pixels_do_not_carve() -> None:
    silhouettes = sphere_silhouettes(RIG)
    whole = carve(prepare_views(silhouettes, RIG), COARSE)
    without = carve(prepare_views({k: s for k, s in silhouettes.items() if k != "c03"}, RIG), COARSE)
    seen = silhouettes[CameraId("c03")]
    blind = Silhouette(
        camera=seen.camera,
        status=ViewStatus.OK,
        image_size_px=seen.image_size_px,
        offset_uv=(0, 0),
        labels=np.full((1024, 1280), UNKNOWN),
        distances=KnownDistances(np.full((1024, 1280), 40, np.float32)),
    )
    assert occupied(carve(prepare_views({**silhouettes, CameraId("c03"): blind}, RIG), COARSE)) == occupied(
        without
    )
    assert occupied(whole) < occupied(without)


def test_views_that_may_disagree_do_not_carve_alone() -> None:
    silhouettes = sphere_silhouettes(RIG)
    seen = silhouettes[CameraId("c07")]
    wrong = Silhouette(
        camera=seen.camera,
        status=ViewStatus.OK,
        image_size_px=seen.image_size_px,
        offset_uv=seen.offset_uv,
        labels=np.full_like(seen.labels, OUTSIDE),
        distances=KnownDistances(np.full(seen.labels.shape, -40, np.float32)),
    )
    silhouettes[CameraId("c07")] = wrong
    assert carve(prepare_views(silhouettes, RIG), COARSE).field.size == 0
    for field in ("sub_voxel", "view_count"):
        robust = CarvingParameters(n=128, field=field, max_disagreeing_views=1)
        assert meshed(carve(prepare_views(silhouettes, RIG), robust)).volume > 0.96 * SPHERE_MM3


def test_a_body_that_leaves_the_grid_is_told() -> None:
    assert carve(prepare_views(sphere_silhouettes(RIG, (0, 0, 20), 7), RIG), COARSE).touches_border
    assert not carve(prepare_views(sphere_silhouettes(RIG, (0, 0, 16), 7), RIG), COARSE).touches_border


def test_islands_are_left_out_of_the_mesh() -> None:
    hull = carve(prepare_views(sphere_silhouettes(RIG, radius_mm=5), RIG), COARSE)
    field = np.pad(hull.field, ((0, 12), (0, 0), (0, 0)), constant_values=-hull.pitch_mm)
    field[-6:-3, 10:13, 10:13] = hull.pitch_mm
    mesh = meshed(
        VisualHull(
            field=field,
            leaves=all_leaves(field.shape),
            level=0.0,
            origin_mm=hull.origin_mm,
            pitch_mm=hull.pitch_mm,
            touches_border=False,
        )
    )
    assert mesh.body_count == 1
    assert mesh.volume == pytest.approx(meshed(hull).volume)


def test_too_few_views_and_foreign_cameras_are_refused() -> None:
    silhouettes = sphere_silhouettes(RIG, cameras=[CameraId("c01")])
    with pytest.raises(ValueError, match="1 usable"):
        carve(prepare_views(silhouettes, RIG), COARSE)
    with pytest.raises(ValueError, match="c01"):
        carve(prepare_views(silhouettes, RIG.subset([CameraId("c02")])), COARSE)


@pytest.mark.parametrize(
    "wrong", [{"n": 98}, {"size_mm": 0.0}, {"size_mm": float("nan")}, {"max_disagreeing_views": -1}]
)
def test_parameters_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        CarvingParameters(**wrong)
