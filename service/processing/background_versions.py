"""Choose the version of the background that each stone is measured with, by the order of the bundles alone.

The first exposures of the empty rig are learnt before any later bundle is started. After these, one more makes
little difference, and stones do not wait for it: it is learnt while the next ones are measured, and used from a fixed
number of stones later on, or when another exposure follows.
"""

import asyncio
import logging
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.processing.background_files import KeptBackground
from service.processing.left_bundles import BACKGROUND

log = logging.getLogger(__name__)

N_AWAITED = 3
"""Exposures that stones wait for: the mean of three has hardly more noise than that of more."""
N_BESIDE = 8
"""Stones that are started while an exposure is learnt, which takes as long as three of them."""
LEARNING = "learning-"
"""Begins the name of a version's folder until it is complete."""


@dataclass(frozen=True, slots=True)
class LearntBackground:
    """A new version, in a folder, and the optics of each camera in its exposure (`results.record.optics_record`)."""

    path: Path
    optics: dict[str, Any]


class BackgroundVersions:
    """The version `in_use`, and the exposure that is being learnt, which becomes the next version."""

    def __init__(self, folder: Path, kept: KeptBackground | None) -> None:
        """`folder`: of all versions; `kept`: the background of the last session, for the next one, if any is kept."""
        self.in_use: Path | None = None
        self._folder = folder
        self._kept = kept
        self._keeping: asyncio.Task[None] | None = None
        self._n_folders = 0
        self._n_learnt = 0
        self._next: asyncio.Task[Any] | None = None
        self._n_beside = 0
        self._retired: list[Path] = []

    async def restore(self) -> None:
        """Begin with the background that was kept for this start, without one if there is none."""
        self.in_use, self._next, self._n_learnt = None, None, 0
        learning = self.new_folder()
        if self._kept is not None and await asyncio.to_thread(self._kept.restore, learning) is not None:
            self.in_use = complete(learning)

    async def restore_if_gone(self) -> None:
        """Begin anew when the folder of the version in use was deleted."""
        if self.in_use is not None and not self.in_use.exists():
            log.error("the background was deleted from the spool folder=%s", self._folder)
            await self.restore()

    def new_folder(self) -> Path:
        """Return where the next version is to be written, until `complete` gives it its name."""
        self._n_folders += 1
        return self._folder / f"{LEARNING}{self._n_folders:08d}"

    async def advance(self, is_background: bool) -> tuple[Path, ...]:
        """Wait until `in_use` is the version that the next bundle needs; return those no longer needed from it on."""
        self._n_beside += not is_background
        if is_background or self._n_beside > N_BESIDE:
            await self._use_next()
        retired, self._retired = tuple(self._retired), []
        return retired

    async def learn(self, job: asyncio.Task[Any]) -> None:
        """Note the job that learns an exposure, and wait for it if later bundles have to.

        A result that is not a `LearntBackground` changes nothing.
        """
        self._next, self._n_beside = job, 0
        if self._n_learnt < N_AWAITED:
            await self._use_next()

    async def _use_next(self) -> None:
        job, self._next = self._next, None
        if job is None:
            return
        await asyncio.wait([job])
        if not job.cancelled() and job.exception() is None and isinstance(job.result(), LearntBackground):
            if self.in_use is not None:
                self._retired.append(self.in_use)
            self.in_use = job.result().path
            self._n_learnt += 1

    async def keep(self, path: Path, tasks: asyncio.TaskGroup) -> None:
        """Keep a version for the next start, in a task: stones do not wait for the disk."""
        if self._keeping is not None:
            await self._keeping
        if self._kept is not None:
            self._keeping = tasks.create_task(asyncio.to_thread(self._kept.keep, path))

    async def remove(self, versions: Sequence[Path]) -> None:
        """Remove versions when none is being copied for the next start."""
        if self._keeping is not None:
            await asyncio.wait([self._keeping])
        for path in versions:
            await asyncio.to_thread(shutil.rmtree, path, ignore_errors=True)


def complete(learning: Path) -> Path:
    """Give a version of the background the name that says that it is complete."""
    return learning.rename(learning.with_name(learning.name.replace(LEARNING, BACKGROUND)))
