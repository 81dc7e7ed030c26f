"""Folders of results: measured from a recording, which stands in the place of the spool, and read again."""

import asyncio
import json
import sys
from collections.abc import Mapping
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import IO, Any

from rich.console import Console
from rich.progress import Progress

from drivers.files.image_file import write_png
from drivers.files.recording import Recording, playback_order, unreadable_triggers
from drivers.files.silhouette_file import read_silhouettes
from service.base.errors import ServiceError
from service.processing.measure_job import MESH, SILHOUETTES, RigFile
from service.processing.processing import CalibrationInUse, Processing, ProcessingContext, ProcessingObserver
from service.processing.spool import Loss, SpooledBundle
from service.processing.worker_pool import JobPool
from service.results.fields import LossReason, Result, completed
from service.results.record import document_of

RESULTS = "results.jsonl"
MESHES, LABELS = FOLDERS = ("meshes", "silhouettes")

Workers = AbstractAsyncContextManager[JobPool]
"""Processes or a cluster, which measure once they are entered."""
IN_FLIGHT = 4
"""Bundles in flight for each worker, however many there are."""


class _PlaybackSpool:
    """A recording in the place of the spool."""

    def __init__(self, source: Recording, in_flight: int) -> None:
        self._bundles = [
            SpooledBundle(trigger=header.trigger, name=header.name, content=header.path)
            for header in playback_order(source)
        ] + [
            SpooledBundle(
                trigger=trigger,
                name=error.path.stem,
                content=Loss(reason=LossReason.UNREADABLE, detail=error.problem),
            )
            for trigger, error in unreadable_triggers(source)
        ]
        self.n_particles = sum(not bundle.is_background for bundle in self._bundles)
        self._room = asyncio.Semaphore(in_flight)

    async def take(self) -> SpooledBundle | None:
        await self._room.acquire()
        return self._bundles.pop(0) if self._bundles else None

    async def release(self, bundle: SpooledBundle, seq: int | None = None) -> None:
        self._room.release()


class _ResultsFolder:
    """The output folder in the place of the store."""

    def __init__(self, out: Path, lines: IO[str]) -> None:
        self._out = out
        self._lines = lines
        self.records: list[dict[str, Any]] = []

    async def finish(self, session: int, bundle: str, record: Result, files: Mapping[str, Path]) -> int:
        """Write a record, and move its mesh and silhouettes to the output folder."""
        kept = document_of(record)
        if mesh := files.get(MESH):
            kept["mesh"] = f"{MESHES}/{bundle}.ply"
            mesh.replace(self._out / kept["mesh"])
        if silhouettes := files.get(SILHOUETTES):
            folder = self._out / LABELS / bundle
            folder.mkdir(parents=True)
            for camera, labels in read_silhouettes(silhouettes).items():
                write_png(folder / f"{camera}.png", labels)
        self._lines.write(json.dumps(kept) + "\n")
        self.records.append(kept)
        return len(self.records)


def read_results(results: Path) -> list[dict[str, Any]]:
    """Return the records in a folder or file of results; raise `ServiceError` with the line that cannot be read."""
    path = results / RESULTS if results.is_dir() else results
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as err:
        raise ServiceError(f"{path}: {err}") from err
    records = []
    for number, line in enumerate(lines, start=1):
        try:
            records.append(completed(dict(json.loads(line))))
        except (ValueError, TypeError) as err:
            raise ServiceError(f"{path}: line {number}: {err}") from err
    return records


def measure_all(
    source: Recording, rig_file: RigFile, workers: Workers, out: Path, *, save_silhouettes: bool
) -> list[dict[str, Any]]:
    """Measure all bundles and return their records in playback order; records and files are written to `out`."""
    (out / MESHES).mkdir()
    work = out / "work"
    work.mkdir()
    with (out / RESULTS).open("w") as lines, Progress(console=Console(file=sys.stderr)) as progress:
        results = _ResultsFolder(out, lines)

        async def run() -> None:
            async with workers as pool:
                playback = _PlaybackSpool(source, IN_FLIGHT * pool.size)
                bar = progress.add_task("measuring", total=playback.n_particles)
                processing = Processing(
                    ProcessingContext(
                        session=0,
                        camera_ids=source.camera_ids,
                        is_simulated=source.is_simulated,
                        save_silhouettes=save_silhouettes,
                        folder=work,
                    ),
                    spool=playback,
                    pool=pool,
                    finish=results.finish,
                    calibration=lambda: CalibrationInUse(rig_file),
                    observer=ProcessingObserver(
                        on_progress=lambda: progress.update(bar, completed=len(results.records))
                    ),
                )
                await processing.run()

        asyncio.run(run())
    return results.records
