"""Stones measured again: each with its frames, its calibration and the background in use now, for a revision of it.

A revision is one transaction: the item of the feed, the lot that the stone is in, the entry of the audit.
"""

import asyncio
import logging
import os
import shutil
import sqlite3
from collections.abc import Callable, Mapping
from enum import StrEnum
from http import HTTPStatus
from pathlib import Path
from typing import Any

from drivers.errors import RecordingError
from drivers.files.rig_file import read_rig
from drivers.interfaces import FrameLossReason
from pipeline.segmentation.silhouette import FoundBy
from pipeline.views.dropped import DropCause, DroppedView
from service.base.errors import ProblemError, ProblemKind
from service.lots.lots import note_revised
from service.processing.measure_job import RESULT_FILES, MeasureJob, RigFile
from service.results.fields import RUSH, Outcome, Result
from service.results.version import ALGORITHM_VERSION
from service.store import Record, Store, audit
from service.store.particle_files import RAW, drop_sources, first_seq
from service.store.reads import particle
from service.store.writes import add_revision

log = logging.getLogger(__name__)

DAMAGED = str(DroppedView(DropCause.NO_FRAME, FrameLossReason.DAMAGED))
"""Why a view is missing whose page cannot be read."""
NOTED = (
    "seq", "revision", "outcome", "reason", "quality", "volume_mm3", "sieve_size_mm", "calibration_id",
    "algorithm_version",
)  # fmt: skip
"""Fields of a result that the audit has before and after."""


class Hindrance(StrEnum):
    """Why a stone cannot be measured again; a word of the REST contract."""

    NO_FRAMES = "not-kept"
    NO_CALIBRATION = "calibration-gone"
    NO_BACKGROUND = "no-background"
    NO_ORDER = "not-ordered"
    FAILED = "not-measured"


class RemeasureError(ProblemError):
    """A stone is not measured again; its result stays as it is."""

    kinds = (
        ProblemKind(Hindrance.NO_FRAMES, HTTPStatus.NOT_FOUND, "This file was not kept"),
        ProblemKind(
            Hindrance.NO_CALIBRATION, HTTPStatus.CONFLICT, "The calibration of this result is not kept"
        ),
        ProblemKind(Hindrance.NO_BACKGROUND, HTTPStatus.CONFLICT, "The empty rig was not exposed yet"),
        ProblemKind(Hindrance.NO_ORDER, HTTPStatus.CONFLICT, "Conflict"),
        ProblemKind(Hindrance.FAILED, HTTPStatus.CONFLICT, "The stone could not be measured again"),
    )

    def __init__(self, why: Hindrance, detail: str) -> None:
        super().__init__(detail, why)


class Jobs:
    """Finds out whether and with what stones are measured again; all on the event loop."""

    def __init__(
        self,
        store: Store,
        rig_file_of: Callable[[str | None], RigFile | None],
        background: Callable[[], Path | None],
        *,
        folder: Path,
        save_silhouettes: bool,
    ) -> None:
        """`rig_file_of`: by `calibration_id`; `background`: the version in use; `folder`: on tmpfs."""
        self.store = store
        self.folder = folder
        self._rig_file_of = rig_file_of
        self._background = background
        self._save_silhouettes = save_silhouettes
        self._held: tuple[Path, Path] | None = (
            None  # a version, and links to its files that stay when it is removed
        )
        self._n_held = 0
        self._holding = asyncio.Lock()

    async def wanted(self, name: str) -> Record | None:
        """Return the newest result of the stone; None if it is all that today's algorithm can say.

        Raises `RemeasureError` if the stone never had frames.
        """
        record = await self.store.read(particle, name)
        if record is None or record["outcome"] == Outcome.LOST:
            raise RemeasureError(Hindrance.NO_FRAMES, f"{name} never had frames")
        was_rushed = record.get("refinement_fallback") == RUSH
        return None if record.get("algorithm_version") == ALGORITHM_VERSION and not was_rushed else record

    async def job_for(self, record: Record, out_dir: Path) -> MeasureJob:
        """Return the job that measures a stone again; raise `RemeasureError` when something for it is gone."""
        name, calibration_id = record["id"], record.get("calibration_id")
        frames = await self.store.folder(first_seq(name)) / RAW
        if record["files_removed"] is not None or not await asyncio.to_thread(frames.is_file):
            raise RemeasureError(Hindrance.NO_FRAMES, f"the frames of {name} are not kept any more")
        rig_file = self._rig_file_of(calibration_id)
        if rig_file is None:
            detail = f"{name}: calibration {calibration_id} is not kept"
            raise RemeasureError(Hindrance.NO_CALIBRATION, detail)
        try:
            rig = await asyncio.to_thread(read_rig, rig_file.path)
        except RecordingError as err:
            raise RemeasureError(Hindrance.NO_CALIBRATION, f"{name}: {err}") from err
        async with self._holding:
            background = await asyncio.to_thread(self._held_background)
        if background is None and FoundBy.BACKGROUND in record.get("segmenters", {}).values():
            detail = "the empty rig was not exposed yet: arm the rig, or wait a moment"
            raise RemeasureError(Hindrance.NO_BACKGROUND, detail)
        return MeasureJob(
            bundle_path=frames,
            camera_ids=tuple(camera.id for camera in rig.cameras),
            rig_file=rig_file,
            background_path=background,
            out_dir=out_dir,
            save_silhouettes=self._save_silhouettes,
        )

    def _held_background(self) -> Path | None:
        """Return the background in use as links of our own, for the version may be removed meanwhile; blocks."""
        while (in_use := self._background()) is not None:
            if self._held is not None and self._held[0] == in_use:
                return self._held[1]
            for links in self.folder.glob("background-*"):
                going = links.rename(links.with_name("going"))  # who reads it finds all of it, or nothing
                shutil.rmtree(going, ignore_errors=True)
            self._n_held += 1
            links = self.folder / f"background-{self._n_held}"
            try:
                shutil.copytree(in_use, links, copy_function=os.link)
            except OSError:
                if self._background() == in_use:
                    raise
            if self._background() == in_use:  # or it may have been half removed already
                self._held = in_use, links
        return None


async def revise(store: Store, before: Record, record: Result, folder: Path, who: str) -> bool:
    """Revise a stone by what was measured into a folder; return False if it was revised since `before`.

    Raises `RemeasureError` if frames of it were damaged since, or its files were just removed.
    """
    damaged = [
        camera for camera, why in record.dropped_views.items() if why == DAMAGED and camera in before["views"]
    ]
    if damaged:  # a result must not become worse for that
        raise RemeasureError(Hindrance.FAILED, f"{before['id']}: frames of {', '.join(damaged)} are damaged")
    files = {name: path for name in RESULT_FILES if (path := folder / name).is_file()}
    seq = await store.write(_revise, store.particles_dir, before, record, files, who)
    if seq is not None:
        drop_sources(files)
        log.info("measured again id=%s seq=%d by=%s", before["id"], seq, who)
    return seq is not None


def _revise(
    connection: sqlite3.Connection,
    particles_dir: Path,
    before: Record,
    record: Result,
    files: Mapping[str, Path],
    who: str,
) -> int | None:
    """Add a revision and return its `seq`; None if `before` is not the stone's newest result any more."""

    def noted(record: Record) -> dict[str, Any]:
        return {field: record.get(field) for field in NOTED}

    name = before["id"]
    newest = particle(connection, name)
    if newest is not None and newest["seq"] != before["seq"]:
        return None
    seq = add_revision(connection, particles_dir, name, record, files)
    after = None if seq is None else particle(connection, seq)
    if after is None:
        raise RemeasureError(Hindrance.NO_FRAMES, f"the files of {name} were just removed")
    if after["lot"] is not None:
        note_revised(connection, after["lot"])
    audit.note(connection, who, "particle remeasured", name, before=noted(before), after=noted(after))
    return seq
