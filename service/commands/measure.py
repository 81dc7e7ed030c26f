"""`stonefall measure`: measure a recording with the daemon's own processing.

Bundles come from the recording instead of the spool, outcomes go to a folder instead of the store. Everything between
is the same, and so are the results.
"""

import json
import os
import shutil
import tempfile
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from drivers.files.recording import open_recording, require_rig_of
from drivers.files.rig_file import read_rig
from pipeline.body_measurement import BodyKind
from pipeline.carving import CarvingField
from pipeline.gradation.curve import PERCENTS
from pipeline.gradation.d4791 import DIMENSIONS
from pipeline.gradation.evaluation import evaluate
from pipeline.gradation.indices import INDICES
from pipeline.gradation.sieves import ALL_SIZES
from pipeline.meshing import Mesher
from pipeline.paper import PAPER
from pipeline.particle import BodyParameters, PipelineParameters
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation.segmenter_choice import SegmenterKind
from service.base.errors import UsageError
from service.commands.lots import curve_table
from service.commands.options import Executor, Json, changed, with_options
from service.commands.results_folder import FOLDERS, RESULTS, Workers, measure_all
from service.configuration.segmentation_settings import SegmentationSettings, plan_segmenter
from service.configuration.settings import load_settings
from service.lots.evaluation import figures_of
from service.lots.standards import read_standards
from service.lots.stones import stones_in
from service.lots.yardsticks import Request
from service.processing.measure_job import RigFile, WorkerContext, prepare
from service.processing.segmenters import SegmenterPlan
from service.processing.worker_pool import WorkerPool
from service.remeasuring.executor import open_cluster
from service.reports.curve import curve_svg
from service.results.fields import Outcome

GRADATION, CURVE = "gradation.json", "gradation.svg"
SIEVE_SET = "stonefall"
DEADLINE_S = 600.0
"""Only a worker that hangs is ended: no stone waits here."""
PAPERS_MODEL = "u2netp"
"""Network of `--method paper` unless another one is named; the paper used the larger U2-Net."""


class MethodName(StrEnum):
    """Method as a whole."""

    OURS = "ours"
    PAPER = "paper"


@dataclass(frozen=True, slots=True)
class MeasureOptions:
    recording: Annotated[Path, typer.Argument()]
    """Folder of the recording."""
    out: Path
    """Folder for results.jsonl, meshes/ and gradation.json; an earlier run's are replaced."""
    rig: Path | None = None
    """Rig file; default: rig.json of the recording."""
    segmenter: SegmenterKind | None = None
    """Segmenter; default: as configured, else auto (onnx where background is in doubt). mask: a U2-Net's mask is
    the silhouette, as in the paper."""
    model: str | None = None
    """ONNX file, or name of `stonefall models list`; default: as configured, else the built-in model."""
    config: Path | None = None
    """Use the parameters of this configuration file."""
    field: CarvingField | None = None
    """sub_voxel: signed distances; view_count: the paper's. Default: as configured, else sub_voxel."""
    body: BodyKind | None = None
    """Body that mesh and shape describe; default: as configured, else photo."""
    texture: Annotated[bool | None, typer.Option("--texture/--no-texture")] = None
    """Whether meshes have a grey value at each vertex; default: as configured, else with photo."""
    mesher: Mesher | None = None
    """own: marching cubes over the cut leaves; skimage: scikit-image's, the reference. Default: as configured, else
    own."""
    method: MethodName = MethodName.OURS
    """paper: the method of the paper as a whole (masks of a U2-Net, voxels counted, scikit-image, no correction);
    the rig is then that of `stonefall calibrate --method paper`."""
    isolevel: float | None = None
    """Level of the surface in the count of 16 views, from 15 to less than 16; default: 15.5."""
    workers: Annotated[int, typer.Option(min=1, max=256)] = os.cpu_count() or 1
    """Processes that measure."""
    executor: Executor = None
    save_silhouettes: bool = False
    """Write silhouettes/<bundle>/<camera>.png as well."""
    as_json: Json = False
    """Print the summary as JSON."""


@with_options
def command(options: MeasureOptions) -> None:
    """Measure every stone of a recording, with the same results as the daemon's, on any number of workers."""
    source = open_recording(options.recording, takes_masks=True)
    rig_path = options.rig or source.path / "rig.json"
    if options.rig is None and not rig_path.exists():
        raise UsageError(f"{options.recording} has no rig.json; name a rig file with --rig")
    calibration = read_rig(rig_path)
    require_rig_of(source, calibration, rig_path)
    settings = load_settings(options.config) if options.config else None
    parameters = settings.pipeline if settings else PipelineParameters()
    segmentation = settings.segmentation if settings else SegmentationSettings()
    if options.method is MethodName.PAPER:
        if options.config is not None:
            raise UsageError("--method paper has parameters of its own; leave --config out")
        parameters, segmentation = PAPER, SegmentationSettings(segmenter="mask", model=PAPERS_MODEL)
    if source.holds_masks:
        if options.segmenter or options.model or options.method is MethodName.PAPER:
            raise UsageError(f"{options.recording} holds masks: leave --segmenter, --model and --method out")
        if options.body == "photo" or options.texture:
            raise UsageError(f"{options.recording} holds masks, which show nothing within the outlines")
        parameters = replace(parameters, body=BodyParameters("estimate", texture=False))
    try:
        parameters = replace(
            parameters,
            meshing=changed(parameters.meshing, mesher=options.mesher),
            body=changed(parameters.body, kind=options.body, texture=options.texture),
            carving=changed(parameters.carving, field=options.field, isolevel=options.isolevel),
        )
    except ValueError as err:
        raise typer.BadParameter(str(err), param_hint="--isolevel") from err
    context = WorkerContext(
        parameters=replace(parameters, fall=source.fall),
        is_simulated=source.is_simulated,
        segmentation=SegmenterPlan(takes_masks=True)
        if source.holds_masks
        else _segmenter_plan(segmentation, options.segmenter, options.model),
    )
    taken = [name for name in FOLDERS if (options.out / name).exists()]
    if taken and not (options.out / RESULTS).exists():
        raise UsageError(
            f"{options.out} has {taken[0]}/ but no {RESULTS}: it is not a folder of results; name another --out"
        )
    options.out.mkdir(parents=True, exist_ok=True)
    rig_file = RigFile(rig_path, calibration.calibration_id)
    with tempfile.TemporaryDirectory(prefix=".measuring-", dir=options.out) as name:
        unfinished = Path(name)
        workers = measuring_pool(options.executor, options.workers, context)
        records = measure_all(
            source, rig_file, workers, unfinished, save_silhouettes=options.save_silhouettes
        )
        (unfinished / GRADATION).write_text(json.dumps(_gradation(records, calibration), indent=2) + "\n")
        figures = figures_of(stones_in(records), Request())
        (unfinished / CURVE).write_text(curve_svg(figures.curve), encoding="utf-8")
        _replace_results(unfinished, options.out)
    _print_summary(records, options.as_json)
    if figures.measured and not options.as_json:
        Console().print(curve_table(figures.model_dump(mode="json")))


def measuring_pool(executor: str | None, workers: int, context: WorkerContext) -> Workers:
    """Return the cluster, if one is named, or else processes of this machine; entering it starts them."""
    if executor is not None:
        return open_cluster(executor, context)
    return WorkerPool(slots=workers, deadline_s=DEADLINE_S, prepare=prepare, context=context)


def _gradation(records: list[dict[str, Any]], rig: RigCalibration) -> dict[str, Any]:
    """Return the gradation, and before it the curve of all measured stones, of any size."""
    lot, sieves = stones_in(records).lot, read_standards().sieve_sets[SIEVE_SET]
    counted = evaluate(lot, sieves.apertures_mm, measured=ALL_SIZES)
    found = asdict(evaluate(lot, sieves.apertures_mm, scale_sd=(rig.length_sd_percent or 0.0) / 100))
    unmeasured = found["unmeasured"]
    reasons = [(*key.split(": "), n) for key, n in unmeasured.pop("by_reason").items()]
    counts = [dict(zip(("fate", "reason", "n_stones"), each, strict=True)) for each in reasons]
    return {
        "sieves_mm": sieves.apertures_mm,
        "passing_percent": [point.by_mass.value or 0.0 for point in counted.curve],
        "quantiles_mm": {f"D{p}": counted.quantiles_exact_mm[p].value for p in PERCENTS},
        **found,
        "unmeasured": {"n_stones": unmeasured["n_stones"], "counts": counts, **unmeasured},
        "indices": {name.removesuffix("_percent"): found["indices"][name] for name in INDICES}
        | {"d4791": _d4791(found["indices"])},
    }


def _d4791(indices: dict[str, Any]) -> dict[str, Any]:
    """Return flat and elongated particles by form, then by ratio."""

    def by_form(forms: list[dict[str, Any]]) -> dict[str, Any]:
        return {
            name.removesuffix("_percent"): {form["ratio"]: form[name] for form in forms}
            for name in DIMENSIONS
        }

    return {
        "whole": by_form(indices["flat_and_elongated"]),
        "fractions": [
            {
                "size": {"min_mm": part["lower_mm"], "max_mm": part["upper_mm"]},
                "mass_percent": part["mass_percent"],
                "n_stones": part["n_stones"],
                "shares": by_form(part["forms"]),
            }
            for part in indices["flat_and_elongated_fractions"]
        ],
        "weighted": by_form(indices["flat_and_elongated_weighted"]),
    }


def _replace_results(unfinished: Path, out: Path) -> None:
    """Replace all files of an earlier run; `results.jsonl` comes last, when everything else is in place."""
    for name in (RESULTS, GRADATION, CURVE):
        (out / name).unlink(missing_ok=True)
    for name in FOLDERS:
        shutil.rmtree(out / name, ignore_errors=True)
    for name in (*FOLDERS, GRADATION, CURVE, RESULTS):
        if (unfinished / name).exists():
            (unfinished / name).rename(out / name)


def _segmenter_plan(
    configured: SegmentationSettings, segmenter: SegmenterKind | None, model: str | None
) -> SegmenterPlan:
    """Return the configured segmenter, changed by the command line; what the command line names must be usable."""
    wanted = changed(configured, segmenter=segmenter, model=model)
    plan = plan_segmenter(wanted)
    if plan.trouble is not None and (wanted.segmenter == "mask" or segmenter == "onnx" or model is not None):
        raise UsageError(plan.trouble)
    if plan.warning is not None:
        typer.echo(f"stonefall: {plan.warning}", err=True)
    return plan


def _print_summary(records: list[dict[str, Any]], as_json: bool) -> None:
    outcomes = [record["outcome"] for record in records]
    summary = {outcome: outcomes.count(outcome) for outcome in Outcome}
    if as_json:
        typer.echo(json.dumps({"bundles": len(records), **summary}))
        return
    table = Table("bundle", "outcome", "quality", "volume mm³", "sieve mm", "views", "remarks")
    for record in records:
        measured = record["outcome"] == Outcome.MEASURED
        dropped = ", ".join(f"{camera} {why}" for camera, why in record["dropped_views"].items())
        table.add_row(
            record["bundle"],
            record["outcome"],
            record["quality"] or "",
            f"{record['volume_mm3']:.1f}" if measured else "",
            f"{record['sieve_size_mm']:.2f}" if measured else "",
            str(len(record["views"])) if measured else "",
            record["detail"] or dropped or ", ".join(record["quality_causes"]),
        )
    Console().print(table)
    typer.echo(f"{len(records)} bundles = " + " + ".join(f"{n} {outcome}" for outcome, n in summary.items()))
