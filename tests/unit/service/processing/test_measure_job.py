"""What a job of a worker leaves out when other stones wait."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from support import rendered

from drivers.files.bundle_file import write_bundle
from drivers.files.rig_file import write_rig
from pipeline.particle import BodyParameters, PipelineParameters
from pipeline.preview import THUMBNAIL_PX
from service.processing import measure_job
from service.processing.backgrounds import write_background
from service.processing.measure_job import (
    MESH,
    THUMBNAIL,
    MeasureJob,
    RigFile,
    Worker,
    WorkerContext,
    measure,
)
from service.processing.segmenters import CLASSICAL, build_segmenter
from service.results.fields import RUSH, Result


def measured(folder: Path, monkeypatch: pytest.MonkeyPatch, body: BodyParameters, is_rushed: bool) -> Result:
    """What a worker says of a sphere."""
    parameters = PipelineParameters(body=body)
    worker = Worker(
        context=WorkerContext(parameters=parameters, is_simulated=True, draws_thumbnails=True),
        segmenter=build_segmenter(CLASSICAL, parameters.segmentation),
    )
    monkeypatch.setattr(measure_job, "_worker", worker)
    rig, bundle = rendered.rig(), rendered.sphere_bundle()
    write_rig(folder / "rig.json", rig)
    write_background(folder / "background", rendered.background())
    write_bundle(folder / "bundle.tiff", bundle, rig.camera_ids, compression="none")
    job = MeasureJob(
        bundle_path=folder / "bundle.tiff",
        camera_ids=rig.camera_ids,
        rig_file=RigFile(folder / "rig.json", rig.calibration_id),
        background_path=folder / "background",
        out_dir=folder / "out",
        is_rushed=is_rushed,
    )
    return measure(job).record


@pytest.mark.parametrize(
    ("texture", "is_rushed", "is_textured"),
    [(None, False, True), (None, True, False), (True, True, True), (False, False, False)],
)
@pytest.mark.full
def test_under_a_rush_a_stone_is_neither_refined_nor_textured_unless_texture_is_asked_for(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    texture: bool | None,
    is_rushed: bool,
    is_textured: bool,
) -> None:
    record = measured(tmp_path, monkeypatch, BodyParameters("photo", texture), is_rushed)
    assert ("refine" in record.timings_ms) != is_rushed
    assert (record.refinement_fallback == RUSH) == is_rushed
    assert ("texture" in record.timings_ms) == is_textured
    mesh = trimesh.load_mesh(tmp_path / "out" / MESH, process=False)
    assert (mesh.visual.kind == "vertex") == is_textured
    assert (record.quality, record.quality_causes) == (("reduced", ["rush"]) if is_rushed else ("good", []))
    thumbnail = tmp_path / "out" / THUMBNAIL
    assert thumbnail.exists() != is_rushed
    if not is_rushed:
        image = cv2.imread(str(thumbnail))
        assert image is not None
        assert image.shape == (THUMBNAIL_PX, THUMBNAIL_PX, 3)
        assert (np.ptp(image[120, 120]) == 0) == is_textured  # grey, as the cameras are


def test_a_rush_takes_nothing_from_the_word_where_outlines_alone_were_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for is_rushed in (False, True):
        (folder := tmp_path / str(is_rushed)).mkdir()
        record = measured(folder, monkeypatch, BodyParameters("estimate"), is_rushed)
        assert (record.quality, record.quality_causes, record.refinement_fallback) == ("good", [], None)
