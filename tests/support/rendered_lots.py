"""A lot of rendered stones, each as it is and as it was measured through the whole pipeline.

The stones are those of one rig with deviations, with lenses at F2.0; they are measured with the true rig and default
parameters, and read from their records as a lot of the daemon reads them.
"""

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import count
from multiprocessing import get_context
from pathlib import Path

import cv2
import trimesh
from threadpoolctl import threadpool_limits

from pipeline.body_measurement import BodyKind
from pipeline.evaluation.scene import EvaluationScene, build_scene
from pipeline.fall import Fall
from pipeline.frames import CameraId, FrameBundle
from pipeline.gradation.stones import OPTIONAL, REQUIRED, Stone, UnmeasuredStone
from pipeline.measuring import ShapeMeasurement, measure_shape
from pipeline.particle import BodyParameters, ParticleResult, PipelineParameters, measure_bundle
from pipeline.segmentation import Segmenter
from pipeline.segmentation.subtraction import SegmentationParameters
from pipeline.synthesis.bodies import Body
from pipeline.synthesis.bundles import render_bundle, stream, without_views
from pipeline.synthesis.exposure import LENS_PRESETS, LensPreset
from pipeline.synthesis.irregular_bodies import irregular_body
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.stones import STONE_FORMS, stone
from service.lots.stones import stone_of
from service.processing.models.networks import read_model
from service.processing.segmenters import SegmenterPlan, build_segmenter
from service.results.record import document_of, result_record

FORM_SHARES: Mapping[str, float] = {
    "angular": 0.28,
    "irregular": 0.20,
    "flaky": 0.24,
    "elongated": 0.08,
    "round": 0.06,
    "rough": 0.05,
    "splinter": 0.05,
    "dented": 0.03,
    "two-lobed": 0.01,
}
"""By number, as of a crushed rock of a flakiness index above 10; trominoes and horseshoes are no stones of a quarry."""
MEDIAN_MM, GEOMETRIC_SD = 13.0, 1.5
SIZES_MM = (5.0, 36.0)
"""Least and greatest sieve size; between them sizes are log-normal by number."""
MAX_FERET_MM = 44.0
"""Longer stones do not fall: the field of view is not made for them."""
DRAWN_MM = 20.0
BODY, POSE, EXPOSURE = range(3)
"""Purposes of the random streams of a stone."""
STONES_PER_JOB = 10
ALL_CAMERAS = "all"
Pair = tuple[str, str]
"""Two cameras that are removed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One stone: as it is, and as it was measured by all cameras and without those of each pair."""

    number: int
    form: str
    true: Stone
    found: Mapping[str, Stone | UnmeasuredStone]


def true_stone(shape: ShapeMeasurement) -> Stone:
    """Return the stone that a perfect measurement finds."""
    return Stone(**{name: getattr(shape, name) for name in (*REQUIRED, *OPTIONAL) if hasattr(shape, name)})


def body(number: int, seed: int) -> tuple[Body, Stone]:
    """Return stone `number` of a lot, and its true measures."""
    rng = stream(seed, number, BODY)
    form = str(rng.choice(list(FORM_SHARES), p=list(FORM_SHARES.values())))
    drawn = stone(form, DRAWN_MM, rng) if form in STONE_FORMS else irregular_body(form, DRAWN_MM, rng)
    shape = measure_shape(drawn.mesh.vertices, drawn.mesh.faces)
    largest_mm = min(SIZES_MM[1], MAX_FERET_MM * shape.sieve_size_mm / shape.max_feret_mm)
    sizes_mm = (MEDIAN_MM * GEOMETRIC_SD ** float(rng.normal()) for _ in count())
    size_mm = next(size_mm for size_mm in sizes_mm if SIZES_MM[0] <= size_mm <= largest_mm)
    vertices = drawn.mesh.vertices * (size_mm / shape.sieve_size_mm)
    mesh = trimesh.Trimesh(vertices, drawn.mesh.faces, process=False)
    return replace(drawn, mesh=mesh), true_stone(measure_shape(mesh.vertices, mesh.faces))


@cache
def scene_of(seed: int) -> EvaluationScene:
    return build_scene(seed, exposure=LENS_PRESETS[LensPreset.F2])


@cache
def segmenter() -> Segmenter:
    return build_segmenter(SegmenterPlan(wanted="auto", model=read_model()), SegmentationParameters())


def measured(number: int, seed: int, pairs: Sequence[Pair], kind: BodyKind) -> Row:
    """Render and measure stone `number`."""
    scene, (it, true) = scene_of(seed), body(number, seed)
    placed = tumble(it, scene.true_rig, stream(seed, number, POSE))
    bundle = render_bundle([placed], scene.simulated, stream(seed, number, EXPOSURE), sequence=number + 1)
    parameters = PipelineParameters(body=BodyParameters(kind))
    whole = measure_bundle(bundle, scene.true_rig, scene.background, segmenter(), parameters)
    found = {ALL_CAMERAS: recorded(whole, bundle, scene)}
    for pair in pairs:
        rest = without_views(bundle, [CameraId(camera) for camera in pair], "removed")
        result = measure_bundle(
            rest,
            scene.true_rig,
            scene.background,
            lambda frame, background: whole.silhouettes[frame.camera],  # as found before
            parameters,
        )
        found[" ".join(pair)] = recorded(result, rest, scene)
    return Row(number=number, form=it.name, true=true, found=found)


def recorded(result: ParticleResult, bundle: FrameBundle, scene: EvaluationScene) -> Stone | UnmeasuredStone:
    """Return the stone that a lot reads from the record of a result."""
    record = result_record(
        result,
        bundle.trigger,
        bundle=bundle.name,
        calibration_id=scene.true_rig.calibration_id,
        is_simulated=True,
        speed_at_gate_mm_s=Fall().speed_at_gate_mm_s,
        timings_ms={},
    )
    return stone_of(document_of(record))


def measure_job(job: tuple[range, int, Sequence[Pair], BodyKind]) -> list[Row]:
    """Measure some stones of a lot."""
    numbers, seed, pairs, kind = job
    cv2.setNumThreads(1)
    with threadpool_limits(1):
        return [measured(number, seed, pairs, kind) for number in numbers]


def measured_rows(
    n_stones: int,
    seed: int,
    n_jobs: int,
    pairs: Sequence[Pair],
    out: Path | None = None,
    kind: BodyKind = "photo",
) -> list[Row]:
    """Render and measure a lot; the same stones whatever the number of processes."""
    jobs = [
        (range(first, min(first + STONES_PER_JOB, n_stones)), seed, pairs, kind)
        for first in range(0, n_stones, STONES_PER_JOB)
    ]
    rows: list[Row] = []
    with ProcessPoolExecutor(n_jobs, get_context("forkserver")) as pool:
        for done in pool.map(measure_job, jobs):
            rows += done
            if out is not None:  # after each job, as all of them take long
                out.write_text(json.dumps([asdict(row) for row in rows], indent=1))
    return rows
