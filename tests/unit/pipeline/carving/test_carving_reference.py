"""Carving where the surface is gives the same hull as asking every view about every voxel."""

from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.extents import examples
from support.silhouettes import distances_of, sphere_silhouettes

from pipeline.carving import LEAF, CarvingParameters, VisualHull, carve, octree, samples, warm_up
from pipeline.carving.reference import carve_every_voxel
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation.silhouette import (
    INSIDE,
    UNKNOWN,
    KnownDistances,
    Silhouette,
    SilhouetteSet,
    ViewStatus,
)
from pipeline.views.prepared import prepare_views

BUILT = as_built(nominal_rig(), seed=7)
SAMPLING = (
    "find_undecided", "lower_distances", "count_view", "count_enclosing_views", "fill_blocks", "write_leaves",
)  # fmt: skip
DISTORTIONS = {"none": np.zeros(5), "all": np.array([-0.3, 0.4, 2e-3, -3e-3, 1.0])}


@cache
def seen(lens: str, center_mm: tuple[float, float, float]) -> tuple[RigCalibration, SilhouetteSet]:
    """A ball in every other camera."""
    cameras = tuple(replace(camera, distortion=DISTORTIONS[lens]) for camera in BUILT.cameras[::2])
    rig = replace(BUILT, cameras=cameras)
    return rig, sphere_silhouettes(rig, center_mm, 4.0)


def with_unknown(silhouette: Silhouette, share: float) -> Silhouette:
    """The left part of the region unknown: all of it may be body."""
    column = int(share * silhouette.labels.shape[1])
    labels, distance_px = silhouette.labels.copy(), distances_of(silhouette).copy()
    labels[:, :column] = UNKNOWN
    from_border_px = column - 0.5 - np.arange(labels.shape[1], dtype=np.float32)
    distance_px = np.maximum(distance_px, np.clip(from_border_px, -40, 40))
    return replace(silhouette, labels=labels, distances=KnownDistances(distance_px))


def on_grid(hull: VisualHull, n: int) -> NDArray[np.float32]:
    """The field on the whole grid and one sample around it; what carving leaves out is outside."""
    low = np.round(hull.origin_mm / hull.pitch_mm + (n + 1) / 2).astype(int)
    field = np.full((n + 2,) * 3, -hull.pitch_mm if hull.level == 0 else 0.0, np.float32)
    field[tuple(slice(a, a + size) for a, size in zip(low, hull.field.shape, strict=True))] = hull.field
    return field


def assert_same(found: VisualHull, expected: VisualHull, n: int) -> None:
    """The same voxels; at both ends of cut edges the same values, up to a voxel; and cut cells begin in leaves."""
    assert (found.level, found.touches_border) == (expected.level, expected.touches_border)
    values, true_values = on_grid(found, n), on_grid(expected, n)
    is_inside = true_values > expected.level
    assert ((values > found.level) == is_inside).all()
    limit = found.pitch_mm if found.level == 0 else np.inf
    for axis in range(3):
        is_cut = np.diff(is_inside, axis=axis)
        for ends in (slice(None, -1), slice(1, None)):
            at_end = tuple(ends if along == axis else slice(None) for along in range(3))
            near, truly_near = (
                np.clip(each[at_end][is_cut], -limit, limit) for each in (values, true_values)
            )
            assert near == pytest.approx(truly_near, abs=1e-4)
    corners = [is_inside[i : n + 1 + i, j : n + 1 + j, k : n + 1 + k] for i, j, k in np.ndindex(2, 2, 2)]
    cells = np.argwhere(np.any(corners, axis=0) & ~np.all(corners, axis=0))
    low = np.round(found.origin_mm / found.pitch_mm + (n + 1) / 2).astype(int)
    leaves = {tuple(first) for first in (found.leaves + low - 1) // LEAF}
    assert {tuple(cell) for cell in (cells - 1) // LEAF} <= leaves


@examples(0.15)
@given(
    lens=st.sampled_from(sorted(DISTORTIONS)),
    center_mm=st.sampled_from([(0.0, 0.0, 0.0), (2.0, -1.0, 3.0), (6.5, 0.0, 0.0)]),
    missing=st.sets(st.integers(0, 7), max_size=3),
    unknown=st.dictionaries(st.integers(0, 7), st.floats(0, 1), max_size=2),
    n=st.sampled_from([16, 20, 32, 40]),
    overruled=st.integers(0, 2),
    field=st.sampled_from(["sub_voxel", "view_count"]),
)
def test_sparse_carving_is_carving_every_voxel(
    lens: str,
    center_mm: tuple[float, float, float],
    missing: set[int],
    unknown: dict[int, float],
    n: int,
    overruled: int,
    field: Literal["sub_voxel", "view_count"],
) -> None:
    rig, silhouettes = seen(lens, center_mm)
    given_views = dict(silhouettes)
    for index, share in unknown.items():
        camera = rig.camera_ids[index]
        given_views[camera] = with_unknown(silhouettes[camera], share)
    for index in missing:
        camera = rig.camera_ids[index]
        given_views[camera] = replace(silhouettes[camera], status=ViewStatus.MULTIPLE)
    parameters = CarvingParameters(n=n, size_mm=20, field=field, max_disagreeing_views=overruled)
    views = prepare_views(given_views, rig)
    assert_same(carve(views, parameters), carve_every_voxel(views, parameters), n)


def test_a_blind_view_decides_nothing_wherever_its_image_ends() -> None:
    rig, silhouettes = seen("all", (0.0, 0.0, 0.0))
    camera = rig.cameras[0]
    blind = Silhouette(
        camera=camera.id,
        status=ViewStatus.OK,
        image_size_px=camera.image_size_px,
        offset_uv=(500, 0),
        labels=np.full((1024, 200), INSIDE),
        distances=KnownDistances(np.full((1024, 200), 40, np.float32)),
    )
    parameters = CarvingParameters(n=32, size_mm=20)
    cut = {**silhouettes, CameraId(camera.id): blind}
    assert_same(
        carve(prepare_views(cut, rig), parameters), carve_every_voxel(prepare_views(cut, rig), parameters), 32
    )


def test_blocks_are_left_out_and_filled_in_a_larger_grid() -> None:
    rig, silhouettes = seen("all", (2.0, -1.0, 3.0))
    parameters = CarvingParameters(n=64, size_mm=16)
    hull = carve(prepare_views(silhouettes, rig), parameters)
    assert_same(hull, carve_every_voxel(prepare_views(silhouettes, rig), parameters), 64)
    is_inside = on_grid(hull, 64)[1:-1, 1:-1, 1:-1] > 0
    assert len(hull.leaves) * LEAF**3 < 0.8 * 64**3
    assert is_inside.any()


@pytest.mark.parametrize("field", ["sub_voxel", "view_count"])
def test_after_the_warm_up_nothing_is_left_to_compile(field: Literal["sub_voxel", "view_count"]) -> None:
    kernels = [octree._ask_views, octree._write_octants, *(getattr(samples, name) for name in SAMPLING)]
    made_up = warm_up(CarvingParameters(field=field))
    assert (made_up.field > made_up.level).any()
    compiled = [len(kernel.signatures) for kernel in kernels]
    rig, silhouettes = seen("all", (2.0, -1.0, 3.0))
    carve(prepare_views(silhouettes, rig), CarvingParameters(field=field, n=40, size_mm=20))
    assert [len(kernel.signatures) for kernel in kernels] == compiled
