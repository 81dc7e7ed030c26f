"""The jobs of a calibration, run in this process: observe rendered bodies, solve from exact outlines."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import rendered
from support.ball_drops import drops_across
from support.outlines import bumped, stone_outlines

from drivers.files.durable import read_json
from drivers.files.recording import write_bundle
from drivers.files.rig_file import read_rig, write_rig
from pipeline.calibration import BallDrop, BallView
from pipeline.calibration.self_calibration import MIN_STONES
from pipeline.frames import BundleKind, CameraId
from pipeline.particle import PipelineParameters
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from service.calibration.drop_files import ObservedDrop, read_drop, write_drop
from service.calibration.drops import Solved, SolveJob, observe, solve
from service.calibration.states import Method
from service.processing import measure_job
from service.processing.backgrounds import write_background
from service.processing.measure_job import MeasureJob, RigFile, Worker, WorkerContext, WorkerFailure
from service.processing.segmenters import build_segmenter


@pytest.fixture
def worker(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make this process a worker, at its usual priority."""
    context = WorkerContext(parameters=PipelineParameters(), is_simulated=True)
    segmenter = build_segmenter(context.segmentation, context.parameters.segmentation)
    monkeypatch.setattr(measure_job, "_worker", Worker(context=context, segmenter=segmenter))


def observed(folder: Path, kind: BundleKind, diameters_mm: tuple[float, ...] = ()) -> ObservedDrop:
    """Observe a sphere of 15 mm in its bundle, as a worker does."""
    rig = rendered.rig()
    write_rig(folder / "rig.json", rig)
    write_background(folder / "background", rendered.background())
    write_bundle(folder / "bundle.tiff", rendered.sphere_bundle(), rig.camera_ids, compression="none")
    job = MeasureJob(
        bundle_path=folder / "bundle.tiff",
        camera_ids=rig.camera_ids,
        rig_file=RigFile(folder / "rig.json", rig.calibration_id),
        background_path=folder / "background",
        out_dir=folder,
    )
    return observe(job, kind, diameters_mm)


def test_a_ball_is_the_one_of_two_that_it_looks_like(worker: None, tmp_path: Path):
    seen = observed(tmp_path, BundleKind.BALL, (10.0, 15.0))
    assert (seen.diameter_mm, len(seen.views), seen.refused) == (15.0, 16, {})
    assert seen.center_mm == pytest.approx((0.5, -0.3, 0.2), abs=0.005)
    assert seen.vertical_minus_horizontal_mm == pytest.approx(0.0, abs=0.01)
    assert max(seen.residuals_px.values()) < 0.05
    assert read_drop(tmp_path / "outlines.npz").diameter_mm == 15.0


def test_a_stone_is_compared_by_its_tangents(worker: None, tmp_path: Path):
    seen = observed(tmp_path, BundleKind.PARTICLE)
    assert (seen.diameter_mm, seen.center_mm, len(seen.views)) == (None, None, 16)
    assert max(seen.residuals_px.values()) < 0.3
    assert len(read_drop(tmp_path / "outlines.npz").views) == 16


def test_another_rig_under_the_name_is_no_measurement(worker: None, tmp_path: Path):
    write_rig(tmp_path / "rig.json", nominal_rig())
    job = MeasureJob(
        bundle_path=tmp_path / "bundle.tiff",
        camera_ids=rendered.rig().camera_ids,
        rig_file=RigFile(tmp_path / "rig.json", "another"),
        background_path=None,
        out_dir=tmp_path,
    )
    write_bundle(job.bundle_path, rendered.sphere_bundle(), job.camera_ids, compression="none")
    with pytest.raises(WorkerFailure, match=r"holds calibration .*, not another"):
        observe(job, BundleKind.BALL, (15.0,))


def solution_of(
    folder: Path,
    drops: Sequence[BallDrop],
    initial: RigCalibration,
    method: Method,
    diameters_mm: tuple[float, ...] = (10.0,),
) -> Solved:
    paths = []
    for number, drop in enumerate(drops):
        paths.append(folder / f"{number:03d}.npz")
        write_drop(paths[-1], drop)
    write_rig(folder / "initial.json", initial)
    return solve(
        SolveJob(
            outline_paths=tuple(paths),
            initial_path=folder / "initial.json",
            diameters_mm=diameters_mm,
            method=method,
            name="solved",
            created_at="2026-11-21T04:00:00Z",
            folder=folder,
        )
    )


def test_balls_are_solved_into_a_rig_and_a_report(tmp_path: Path):
    nominal = nominal_rig()
    found = solution_of(tmp_path, drops_across(as_built(nominal, 5), 10), nominal, Method.BUNDLE)
    assert found.refusal is None
    assert read_rig(tmp_path / "rig.json").calibration_id == found.calibration_id
    report = read_json(tmp_path / "report.json")
    assert report["calibration_id"] == found.calibration_id
    assert max(report["residuals_after_px"].values()) < 0.1 < min(report["residuals_before_px"].values())


def test_all_drops_together_tell_which_ball_is_which(tmp_path: Path):
    # one by one, against a lens that is 9 % off, the smaller ball would be taken for the larger
    nominal = nominal_rig()
    true = as_built(nominal, 5)
    lens = np.array([[1.09, 1, 1], [1, 1.09, 1], [1, 1, 1]])
    long = replace(true, cameras=tuple(replace(each, K=each.K * lens) for each in true.cameras))
    small, large = drops_across(long, 8, seed=1), drops_across(long, 8, seed=2, diameter_mm=11.5)
    drops = [
        replace(drop, name=f"{number}", diameter_mm=11.5) for number, drop in enumerate((*small, *large))
    ]
    found = solution_of(tmp_path, drops, nominal, Method.BUNDLE, (10.0, 11.5))
    assert found.refusal is None
    report = read_json(tmp_path / "report.json")
    assert abs(report["edge_offset_px"]) < 0.05


def test_stones_put_a_camera_back(tmp_path: Path):
    rig = as_built(nominal_rig(), 12)
    rng = np.random.default_rng(8)
    stones = [_as_drop(stone_outlines(rig, rng, noise_px=0.08)) for _ in range(MIN_STONES)]
    found = solution_of(tmp_path, stones, bumped(rig, "c05", np.array([0.06, -0.08, 0.0])), Method.STONES)
    assert found.refusal is None
    assert read_rig(tmp_path / "rig.json").calibration_id == found.calibration_id
    report = read_json(tmp_path / "report.json")
    assert list(report["moved"]) == ["c05"]
    assert report["residuals_after_px"]["c05"] < 0.3 < report["residuals_before_px"]["c05"]


def _as_drop(outlines: dict[CameraId, np.ndarray]) -> BallDrop:
    views = {
        camera: BallView(outline_uv=outline, center_uv=outline.mean(axis=0), radius_px=1.0, rms_px=0.0)
        for camera, outline in outlines.items()
    }
    return BallDrop(name="stone", diameter_mm=None, views=views)


@pytest.mark.parametrize("method", list(Method))
def test_too_few_drops_are_a_reason_and_no_failure(tmp_path: Path, method: Method):
    nominal = nominal_rig()
    found = solution_of(tmp_path, drops_across(as_built(nominal, 5), 1), nominal, method)
    assert found.calibration_id is None
    assert found.refusal
    assert not (tmp_path / "rig.json").exists()
