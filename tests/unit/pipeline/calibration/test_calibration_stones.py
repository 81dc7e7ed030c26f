"""Recalibration from stones: the camera that was hit is put back, and the sphere measures as before."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
import trimesh
from support.outlines import bumped, stone_outlines
from support.silhouettes import sphere_silhouettes

from pipeline.calibration.self_calibration import MIN_STONES, _Poses, recalibrate
from pipeline.carving import CarvingParameters, carve
from pipeline.errors import CalibrationError
from pipeline.frames import CameraId
from pipeline.meshing import mesh_hull
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation import SilhouetteSet
from pipeline.views.epipolar_tangency import ALARM_PX, Outlines, outline_hulls
from pipeline.views.prepared import prepare_views

RIG = as_built(nominal_rig(), seed=12)
MADE = {"created_at": "2026-03-01T00:00:00Z", "name": "from stones"}


@pytest.fixture(scope="module")
def stones() -> Sequence[Outlines]:
    rng = np.random.default_rng(8)
    return [stone_outlines(RIG, rng, noise_px=0.08) for _ in range(MIN_STONES)]


@cache
def sphere() -> SilhouetteSet:
    """15 mm, as the true rig sees it."""
    return sphere_silhouettes(RIG)


@cache
def sphere_diameter_mm(rig: RigCalibration) -> float:
    """Of the hull that the calibration `rig` makes of the sphere."""
    mesh = mesh_hull(carve(prepare_views(sphere(), rig), CarvingParameters(n=128)))
    assert mesh is not None
    volume_mm3 = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).volume
    return float(np.cbrt(6 * volume_mm3 / np.pi))


@pytest.mark.parametrize(
    "turn_deg",
    [
        pytest.param((0.06, -0.08, 0.0), id="0.1 degree across the view"),
        pytest.param((0.3, 0.2, 0.346), id="0.5 degree about an odd axis"),
    ],
)
def test_a_camera_that_was_hit_is_put_back(
    stones: Sequence[Outlines], turn_deg: tuple[float, float, float]
) -> None:
    hit = bumped(RIG, "c05", np.array(turn_deg))
    found = recalibrate(stones, hit, **MADE)
    assert found.moved.keys() == {"c05"}
    assert found.scores_before_px["c05"] > 3
    assert max(found.scores_after_px.values()) < ALARM_PX / 2
    assert found.is_acceptable
    assert found.moved[CameraId("c05")].rotation_deg == pytest.approx(np.linalg.norm(turn_deg), abs=0.02)
    assert found.rig.name == "from stones"
    assert found.rig.calibration_id not in {RIG.calibration_id, hit.calibration_id}
    before_mm = sphere_diameter_mm(RIG)
    assert sphere_diameter_mm(found.rig) == pytest.approx(before_mm, abs=0.02)
    assert sphere_diameter_mm(hit) < before_mm - 0.02  # the bump was one to be seen


def test_a_rig_that_drifted_everywhere_keeps_its_scale(stones: Sequence[Outlines]) -> None:
    """All cameras are solved for; only the priors hold the scale then."""
    drifted = RIG
    for number, camera in enumerate(RIG.camera_ids):
        drifted = bumped(drifted, camera, 0.02 * np.random.default_rng(number).normal(size=3))
    found = recalibrate(stones, drifted, **MADE)
    assert found.moved.keys() == set(RIG.camera_ids)
    assert min(found.scores_before_px.values()) > ALARM_PX
    assert max(found.scores_after_px.values()) < ALARM_PX / 2
    assert sphere_diameter_mm(found.rig) == pytest.approx(sphere_diameter_mm(RIG), abs=0.02)


def test_the_jacobian_is_the_derivative(stones: Sequence[Outlines]) -> None:
    poses = _Poses(bumped(RIG, "c05", np.array([0.05, 0.02, 0.01])), (CameraId("c05"), CameraId("c09")))
    hulls = [outline_hulls(stones[0], RIG)]
    steps = 1e-5 * np.eye(12)
    differences = [(poses.residuals(step, hulls) - poses.residuals(-step, hulls)) / 2e-5 for step in steps]
    jacobian = poses.jacobian(np.zeros(12), hulls)
    assert np.abs(jacobian).max() > 10
    assert jacobian == pytest.approx(np.column_stack(differences), abs=0.3)


def test_only_the_cameras_that_were_asked_for_move(stones: Sequence[Outlines]) -> None:
    found = recalibrate(stones, RIG, **MADE, cameras=["c03"])
    assert found.moved.keys() == {"c03"}
    for before, after in zip(RIG.cameras, found.rig.cameras, strict=True):
        assert (before is after) == (before.id != "c03")


def test_too_few_stones_are_refused_with_the_number_that_it_takes(stones: Sequence[Outlines]) -> None:
    with pytest.raises(CalibrationError, match=f"19 stones .* let at least {MIN_STONES} fall"):
        recalibrate(stones[1:], RIG, **MADE)


def test_a_camera_that_the_rig_has_not_is_refused(stones: Sequence[Outlines]) -> None:
    with pytest.raises(CalibrationError, match="has no camera c99"):
        recalibrate(stones, RIG, **MADE, cameras=["c99"])
