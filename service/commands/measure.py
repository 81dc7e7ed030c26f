"""`stonefall measure`: the daemon's pipeline over a recording, offline."""

import json
import multiprocessing
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from drivers.errors import RecordingError
from drivers.recording import BundleHeader, Recording, open_recording, playback_order
from drivers.rig_file import read_rig
from pipeline.frames import BundleKind
from pipeline.gradation import gradation
from pipeline.particle import PipelineParameters
from pipeline.rig import require_cameras
from service.errors import UsageError
from service.record import lost_record
from service.settings import load_settings
from service.worker_job import LearnJob, MeasureJob, WorkerContext, initialize, learn_background, measure


class SegmenterName(StrEnum):
    """How silhouettes are found."""

    BACKGROUND = "background"


class Field(StrEnum):
    """Which field is carved."""

    SUB_VOXEL = "sub_voxel"
    VIEW_COUNT = "view_count"


def command(
    recording: Annotated[Path, typer.Argument(help="Folder of the recording.")],
    out: Annotated[Path, typer.Option(help="Folder for results.jsonl, meshes/ and gradation.json.")],
    rig: Annotated[Path | None, typer.Option(help="Rig file; default: the recording's own rig.json.")] = None,
    segmenter: Annotated[SegmenterName, typer.Option()] = SegmenterName.BACKGROUND,
    config: Annotated[Path | None, typer.Option(help="Take the parameters of this configuration.")] = None,
    field: Annotated[Field | None, typer.Option(help="view_count is the paper's field.")] = None,
    workers: Annotated[int, typer.Option(min=1, max=256)] = os.cpu_count() or 1,
    save_silhouettes: Annotated[bool, typer.Option("--save-silhouettes")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Measure every particle of a recording; the same numbers as the daemon's, whatever the number of workers."""
    source = open_recording(recording)
    rig_path = rig or source.path / "rig.json"
    if not rig_path.exists():
        raise UsageError(f"{recording} has no rig.json; name a rig file with --rig")
    calibration = read_rig(rig_path)
    require_cameras(calibration, source.camera_ids)
    parameters = load_settings(config).pipeline if config else PipelineParameters()
    if field is not None:
        parameters = replace(parameters, carving=replace(parameters.carving, field=field.value))
    context = WorkerContext(
        rig_path=rig_path, parameters=parameters, is_simulated=source.is_simulated, segmenter=segmenter.value
    )
    (out / "meshes").mkdir(parents=True, exist_ok=True)
    records = []
    partial = out / "results.jsonl.tmp"
    with partial.open("w") as lines:
        for record in _measured(source, context, out, workers, save_silhouettes, calibration.calibration_id):
            lines.write(json.dumps(record) + "\n")
            records.append(record)
    partial.rename(out / "results.jsonl")
    measured = [record for record in records if record["outcome"] == "measured"]
    curve = gradation([r["sieve_size_mm"] for r in measured], [r["volume_mm3"] for r in measured])
    (out / "gradation.json").write_text(json.dumps(asdict(curve), indent=2) + "\n")
    _report(records, as_json)


def _measured(
    source: Recording,
    context: WorkerContext,
    out: Path,
    workers: int,
    save_silhouettes: bool,
    calibration_id: str,
) -> Iterator[dict[str, Any]]:
    """The records in playback order; background exposures are folded in where they stand in that order."""
    headers = playback_order(source)
    n_particles = sum(header.kind is not BundleKind.BACKGROUND for header in headers)
    progress = Progress(console=Console(file=sys.stderr))
    with _work_folder(out) as work, progress, _pool(workers, context) as pool:
        bar = progress.add_task("measuring", total=n_particles)
        waiting: list[tuple[BundleHeader, Path, Future[dict[str, Any]]]] = []
        background: Path | None = None

        def finished(keep: int) -> Iterator[dict[str, Any]]:
            while len(waiting) > keep:
                header, folder, future = waiting.pop(0)
                yield _collect(header, folder, future, out, calibration_id, source.is_simulated)
                progress.advance(bar)

        for number, header in enumerate(headers):
            if header.kind is BundleKind.BACKGROUND:
                yield from finished(keep=0)  # nothing reads the old background any more
                previous, background = background, work / f"background-{number}.npz"
                job = LearnJob(
                    bundle_path=header.path,
                    camera_ids=source.camera_ids,
                    previous_path=previous,
                    out_path=background,
                )
                pool.submit(learn_background, job).result()
                if previous is not None:
                    previous.unlink()
                continue
            folder = work / str(number)
            task = MeasureJob(
                bundle_path=header.path,
                camera_ids=source.camera_ids,
                background_path=background,
                out_dir=folder,
                save_silhouettes=save_silhouettes,
            )
            waiting.append((header, folder, pool.submit(measure, task)))
            yield from finished(keep=4 * workers)
        yield from finished(keep=0)
    for damaged in source.unreadable:
        yield lost_record(
            None,
            bundle=damaged.path.stem,
            reason="unreadable",
            detail=damaged.problem,
            calibration_id=calibration_id,
            is_simulated=source.is_simulated,
        )


def _collect(
    header: BundleHeader,
    folder: Path,
    future: Future[dict[str, Any]],
    out: Path,
    calibration_id: str,
    is_simulated: bool,
) -> dict[str, Any]:
    """The record of a finished job, its files moved to where the command promises them."""
    try:
        record = future.result()
    except RecordingError as err:
        return lost_record(
            header.trigger,
            bundle=header.name,
            reason="unreadable",
            detail=str(err),
            calibration_id=calibration_id,
            is_simulated=is_simulated,
        )
    if record["mesh"] is not None:
        record["mesh"] = f"meshes/{header.name}.ply"
        (folder / "mesh.ply").replace(out / record["mesh"])
    if (folder / "silhouettes").exists():
        kept = out / "silhouettes" / header.name
        kept.parent.mkdir(exist_ok=True)
        shutil.rmtree(kept, ignore_errors=True)
        (folder / "silhouettes").rename(kept)
    return record


@contextmanager
def _work_folder(out: Path) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix=".measuring-", dir=out) as work:
        yield Path(work)


@contextmanager
def _pool(workers: int, context: WorkerContext) -> Iterator[ProcessPoolExecutor]:
    pool = ProcessPoolExecutor(
        workers, mp_context=multiprocessing.get_context("spawn"), initializer=initialize, initargs=(context,)
    )
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _report(records: list[dict[str, Any]], as_json: bool) -> None:
    outcomes = [record["outcome"] for record in records]
    summary = {outcome: outcomes.count(outcome) for outcome in ("measured", "rejected", "lost")}
    if as_json:
        typer.echo(json.dumps({"bundles": len(records), **summary}))
        return
    table = Table("bundle", "outcome", "quality", "volume mm³", "sieve mm", "views", "remarks")
    for record in records:
        measured = record["outcome"] == "measured"
        dropped = ", ".join(f"{camera} {why}" for camera, why in record["dropped_views"].items())
        table.add_row(
            record["bundle"],
            record["outcome"],
            record["quality"] or "",
            f"{record['volume_mm3']:.1f}" if measured else "",
            f"{record['sieve_size_mm']:.2f}" if measured else "",
            str(len(record["views"])) if measured else "",
            record["detail"] or dropped,
        )
    Console().print(table)
    typer.echo(f"{len(records)} bundles = " + " + ".join(f"{n} {outcome}" for outcome, n in summary.items()))
