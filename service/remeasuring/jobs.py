"""Jobs that measure a stone again: with its frames, its calibration, and the background in use now."""

import asyncio
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from drivers.errors import RecordingError
from drivers.files.rig_file import read_rig
from pipeline.segmentation.silhouette import FoundBy
from service.processing.measure_job import MeasureJob, RigFile
from service.remeasuring.hindrance import Hindrance, RemeasureError
from service.results.fields import Outcome
from service.results.refinement import RUSH
from service.results.version import ALGORITHM_VERSION
from service.store import Record, Store
from service.store.particle_files import RAW, first_seq
from service.store.reads import particle


class RigFiles(Protocol):
    """The calibrations, by the id that results name."""

    def rig_file_of(self, calibration_id: str | None) -> RigFile | None: ...


class BackgroundInUse(Protocol):
    """The processing of the stones that fall; it knows the background in use."""

    @property
    def background(self) -> Path | None: ...


@dataclass(frozen=True, slots=True)
class HeldBackground:
    """A version of the background, and links to its files that stay when it is removed."""

    version: Path
    links: Path


class Jobs:
    """Finds out whether and with what stones are measured again; all on the event loop."""

    def __init__(
        self,
        store: Store,
        calibrations: RigFiles,
        processing: BackgroundInUse,
        *,
        folder: Path,
        save_silhouettes: bool,
    ) -> None:
        """`folder`: on tmpfs, for links to the background."""
        self._store = store
        self._calibrations = calibrations
        self._processing = processing
        self._folder = folder
        self._save_silhouettes = save_silhouettes
        self._held: HeldBackground | None = None
        self._n_held = 0
        self._holding = asyncio.Lock()

    async def wanted(self, name: str) -> Record | None:
        """Return the newest result of the stone; None if it is all that today's algorithm can say.

        Raises
        ------
        RemeasureError
            It never had frames.
        """
        record = await self._store.read(particle, name)
        if record is None or record["outcome"] == Outcome.LOST:
            raise RemeasureError(Hindrance.NO_FRAMES, f"{name} never had frames")
        was_rushed = record.get("refinement_fallback") == RUSH
        return None if record.get("algorithm_version") == ALGORITHM_VERSION and not was_rushed else record

    async def job_for(self, record: Record, out_dir: Path) -> MeasureJob:
        """Return the job that measures a stone again; raise `RemeasureError` when something for it is gone."""
        name, calibration_id = record["id"], record.get("calibration_id")
        frames = await self._store.folder(first_seq(name)) / RAW
        if record["files_removed"] is not None or not await asyncio.to_thread(frames.is_file):
            raise RemeasureError(Hindrance.NO_FRAMES, f"the frames of {name} are not kept any more")
        rig_file = self._calibrations.rig_file_of(calibration_id)
        if rig_file is None:
            raise RemeasureError(
                Hindrance.NO_CALIBRATION, f"{name}: calibration {calibration_id} is not kept"
            )
        try:
            rig = await asyncio.to_thread(read_rig, rig_file.path)
        except RecordingError as err:
            raise RemeasureError(Hindrance.NO_CALIBRATION, f"{name}: {err}") from err
        async with self._holding:
            background = await asyncio.to_thread(self._held_background)
        if background is None and FoundBy.BACKGROUND in record.get("segmenters", {}).values():
            raise RemeasureError(
                Hindrance.NO_BACKGROUND, "the empty rig was not exposed yet: arm the rig, or wait a moment"
            )
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
        while (in_use := self._processing.background) is not None:
            if self._held is not None and self._held.version == in_use:
                return self._held.links
            for links in self._folder.glob("background-*"):
                going = links.rename(links.with_name("going"))  # who reads it finds all of it, or nothing
                shutil.rmtree(going, ignore_errors=True)
            self._n_held += 1
            links = self._folder / f"background-{self._n_held}"
            try:
                shutil.copytree(in_use, links, copy_function=os.link)
            except OSError:
                if self._processing.background == in_use:
                    raise
            if self._processing.background == in_use:  # or it may have been half removed already
                self._held = HeldBackground(in_use, links)
        return None
