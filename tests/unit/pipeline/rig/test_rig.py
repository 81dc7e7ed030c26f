"""Projection, rays and the rig document."""

import copy
import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import RigError
from pipeline.rig.camera_arrays import camera_arrays
from pipeline.rig.cameras import Lens, RigCalibration, checksum_of, rig_to_document
from pipeline.rig.design import as_built, nominal_rig
from pipeline.rig.document import rig_from_document

NOMINAL = nominal_rig()
BUILT = as_built(NOMINAL, seed=1)


def test_nominal_design_is_the_paper_s() -> None:
    assert len(NOMINAL.cameras) == 16
    for camera in NOMINAL.cameras:
        assert np.linalg.norm(camera.center_mm) == pytest.approx(300)
        assert camera.project([[0, 0, 0]])[0][0] == pytest.approx([639.5, 511.5])
        # z up in the world is up in every image
        assert camera.project([[0, 0, 5]])[0][0][1] < 511.5
    # 1 px is 0.048 mm at the centre
    shift = NOMINAL.cameras[0].project([[0, 0.048, 0]])[0][0] - [639.5, 511.5]
    assert np.linalg.norm(shift) == pytest.approx(1.0, abs=0.001)


def test_projection_agrees_with_opencv() -> None:
    points_mm = np.random.default_rng(0).uniform(-20, 20, (50, 3))
    for camera in BUILT.cameras:
        rvec = cv2.Rodrigues(camera.R)[0]
        expected = cv2.projectPoints(points_mm, rvec, camera.t_mm, camera.K, camera.distortion)[0][:, 0]
        assert camera.project(points_mm)[0] == pytest.approx(expected, abs=1e-6)


@given(st.integers(0, 15), *[st.floats(-20, 20)] * 3)
def test_rays_invert_the_projection(index: int, x: float, y: float, z: float) -> None:
    camera, point_mm = BUILT.cameras[index], np.array([x, y, z])
    pixels, depths_mm = camera.project(point_mm[None])
    ray = camera.rays(pixels)[0]
    assert np.linalg.norm(np.cross(point_mm - camera.center_mm, ray)) < 1e-6
    assert depths_mm[0] > 0


def test_the_ray_through_a_pixel_is_seen_there() -> None:
    pixels_uv = np.random.default_rng(1).uniform(0, 1000, size=(50, 2))
    bent = replace(BUILT.cameras[5], distortion=np.array([-0.08, 0.1, 1e-3, -2e-3, 0.01]))
    skewed = replace(bent, K=bent.K + np.array([[0, 5, 0], [0, 0, 0], [0, 0, 0]]))
    for camera in (BUILT.cameras[0], bent, skewed):
        seen_uv, _ = camera.project(camera.center_mm + 300 * camera.rays(pixels_uv))
        np.testing.assert_allclose(seen_uv, pixels_uv, atol=1e-8)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 1e-12)
    expected = cv2.undistortPoints(pixels_uv[:, None], bent.K, bent.distortion, criteria=criteria)[:, 0]
    np.testing.assert_allclose(bent.normalized_coordinates(pixels_uv), expected, atol=1e-10)
    assert bent.rays(np.empty((0, 2))).shape == (0, 3)


def test_cameras_as_arrays_are_the_cameras() -> None:
    bent = replace(BUILT.cameras[5], distortion=np.array([-0.08, 0.1, 1e-3, -2e-3, 0.01]))
    cameras = [BUILT.cameras[0], bent, BUILT.cameras[9]]
    arrays = camera_arrays(cameras)
    owners = np.arange(60) % 3
    pixels_uv = np.random.default_rng(2).uniform(0, 1000, size=(60, 2))
    normalized = arrays.normalized_coordinates(pixels_uv, owners)
    for index, camera in enumerate(cameras):
        np.testing.assert_allclose(arrays.centers_mm[index], camera.center_mm, rtol=1e-12)
        assert arrays.focals_px[index] == camera.focal_px
        np.testing.assert_array_equal(
            normalized[owners == index], camera.normalized_coordinates(pixels_uv[owners == index])
        )


def test_document_round_trip_keeps_the_identity() -> None:
    document = json.loads(json.dumps(rig_to_document(BUILT)))
    assert rig_from_document(document).calibration_id == BUILT.calibration_id
    assert rig_from_document(document).calibration_id != NOMINAL.calibration_id


def with_lens(rig: RigCalibration, lens: Lens) -> RigCalibration:
    return replace(
        rig, cameras=tuple(replace(camera, lens=lens) for camera in rig.cameras), length_sd_percent=0.05
    )


WITH_LENS = with_lens(BUILT, Lens(focal_length_mm=25.0, f_number=2.0, focus_mm=300.0, blur_px=0.9))


@given(
    st.builds(
        Lens,
        focal_length_mm=st.floats(1, 1000),
        f_number=st.floats(0.5, 64),
        focus_mm=st.floats(10, 1e5),
        blur_px=st.floats(0, 50),
    )
)
def test_lenses_are_read_as_written(lens: Lens) -> None:
    written = with_lens(BUILT, lens)
    read = rig_from_document(json.loads(json.dumps(rig_to_document(written))))
    assert [camera.lens for camera in read.cameras] == [lens] * 16
    assert read.length_sd_percent == 0.05
    assert read.calibration_id == written.calibration_id != BUILT.calibration_id


def test_a_rig_without_lenses_has_the_document_of_before() -> None:
    document = rig_to_document(BUILT)
    assert "length_sd_percent" not in document
    assert "lens" not in document["cameras"][0]
    for member in (document, document["cameras"][0]):
        member["length_sd_percent"] = member["lens"] = None
    del document["checksum"]
    assert rig_from_document(document).calibration_id == BUILT.calibration_id


def test_part_of_a_rig_keeps_all_that_is_known_of_it() -> None:
    part = WITH_LENS.subset(["c03", "c01"])
    assert part.camera_ids == ("c01", "c03")
    assert part.cameras[0].lens == WITH_LENS.cameras[0].lens
    assert (part.name, part.length_sd_percent) == (WITH_LENS.name, 0.05)


def test_as_built_is_seeded_and_deviates_as_told() -> None:
    assert as_built(NOMINAL, seed=1).calibration_id == BUILT.calibration_id
    assert as_built(NOMINAL, seed=2).calibration_id != BUILT.calibration_id
    for nominal, built in zip(NOMINAL.cameras, BUILT.cameras, strict=True):
        assert np.linalg.norm(nominal.center_mm - built.center_mm) == pytest.approx(2)
        angle = np.rad2deg(np.arccos((np.trace(nominal.R.T @ built.R) - 1) / 2))
        assert angle == pytest.approx(1)


def test_a_bare_projection_matrix_is_enough() -> None:
    document = rig_to_document(BUILT)
    del document["checksum"]
    for number, entry in enumerate(document["cameras"]):
        for key in ("K", "R", "t_mm", "distortion"):
            entry[key] = None
        # a projection matrix has no scale and no sign
        entry["projection"] = ((-3.0) ** (number % 3) * np.array(entry["projection"])).tolist()
    read = rig_from_document(document)
    for camera, expected in zip(read.cameras, BUILT.cameras, strict=True):
        assert pytest.approx(expected.K, abs=1e-6) == camera.K
        assert pytest.approx(expected.R, abs=1e-9) == camera.R
        assert camera.t_mm == pytest.approx(expected.t_mm, abs=1e-6)


def edited(*path: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    def edit(document: dict[str, Any]) -> None:
        target: Any = document
        for key in path[:-1]:
            target = target[key]
        target[path[-1]] = value

    return edit


CAMERA = ("cameras", 2)


@pytest.mark.parametrize(
    ("edit", "field"),
    [
        (edited("format", value="stonefall-rig/9"), "format"),
        (edited("method", value="magic"), "method"),
        (edited("name", value=None), "name"),
        (edited("created_at", value="yesterday"), "created_at"),
        (edited("created_at", value=17), "created_at"),
        (edited("ball_diameter_mm", value=-3), "ball_diameter_mm"),
        (edited("cameras", value=[]), "cameras"),
        (edited("cameras", value={}), "cameras"),
        (edited(*CAMERA, value="c03"), "cameras[2]"),
        (edited(*CAMERA, "id", value="../etc"), "cameras[2].id"),
        (edited(*CAMERA, "id", value="c01"), "cameras[2].id"),
        (edited(*CAMERA, "image_size_px", value=[1280]), "cameras[2].image_size_px"),
        (edited(*CAMERA, "image_size_px", value=[0, 1024]), "cameras[2].image_size_px"),
        (edited(*CAMERA, "K", 0, 0, value=25.0), "cameras[2].K"),
        (edited(*CAMERA, "K", value=[[1, 2], [3, 4]]), "cameras[2].K"),
        (edited(*CAMERA, "K", 1, 1, value=float("nan")), "document"),
        (edited(*CAMERA, "K", 1, 1, value=10**400), "cameras[2].K"),
        (edited(*CAMERA, "serial", value="\udcff"), "document"),
        (edited(*CAMERA, "serial", value=[1]), "cameras[2].serial"),
        (edited(*CAMERA, "K", 0, 0, value="wide"), "cameras[2].K"),
        (edited(*CAMERA, "R", value=[[1, 0, 0], [0, 1, 0], [0, 0, 2]]), "cameras[2].R"),
        (edited(*CAMERA, "t_mm", 0, value=20.0), "cameras[2].R"),
        (edited(*CAMERA, "t_mm", 2, value=9000.0), "cameras[2].t_mm"),
        (edited(*CAMERA, "t_mm", value=None), "cameras[2].t_mm"),
        (edited(*CAMERA, "distortion", value=[0, 0]), "cameras[2].distortion"),
        (edited(*CAMERA, "projection", 0, 3, value=77.0), "cameras[2].projection"),
        (edited(*CAMERA, "rms_px", value=-1), "cameras[2].rms_px"),
        (edited("length_sd_percent", value="good"), "length_sd_percent"),
        (edited(*CAMERA, "lens", value="F2"), "cameras[2].lens"),
        (edited(*CAMERA, "lens", value={}), "cameras[2].lens.focal_length_mm"),
        (edited(*CAMERA, "lens", "f_number", value=0), "cameras[2].lens.f_number"),
        (edited(*CAMERA, "lens", "focus_mm", value=True), "cameras[2].lens.focus_mm"),
        (edited(*CAMERA, "lens", "blur_px", value=None), "cameras[2].lens.blur_px"),
    ],
)
def test_an_impossible_rig_is_refused_with_the_field_named(
    edit: Callable[[dict[str, Any]], None], field: str
) -> None:
    document = copy.deepcopy(rig_to_document(WITH_LENS))
    del document["checksum"]
    edit(document)
    with pytest.raises(RigError) as caught:
        rig_from_document(document)
    assert caught.value.field == field
    assert str(caught.value).startswith(f"{field}: ")


def test_an_edited_file_with_its_old_checksum_is_refused() -> None:
    document = rig_to_document(BUILT)
    document["cameras"][0]["t_mm"][0] += 0.001
    with pytest.raises(RigError, match="checksum"):
        rig_from_document(document)
    document["checksum"] = checksum_of(document)
    del document["cameras"][0]["projection"]
    document["checksum"] = checksum_of(document)
    rig_from_document(document)
