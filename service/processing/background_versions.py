"""Choose the version of the background that each stone is measured with, by the order of the bundles alone.

The first exposures of the empty rig are learnt before any later bundle is started. After these, one more makes
little difference, and stones do not wait for it: it is learnt while the next ones are measured, and used from a fixed
number of stones later on, or when another exposure follows.
"""

import asyncio
from dataclasses import dataclass
from pathlib import Path
from typing import Any

N_AWAITED = 3
"""Exposures that stones wait for: the mean of three has hardly more noise than that of more."""
N_BESIDE = 8
"""Stones that are started while an exposure is learnt, which takes as long as three of them."""


@dataclass(frozen=True, slots=True)
class LearntBackground:
    """A new version, in a folder, and the optics of each camera in its exposure (`results.record.optics_record`)."""

    path: Path
    optics: dict[str, Any]


class BackgroundVersions:
    """The version `in_use`, and the exposure that is being learnt, which becomes the next version."""

    def __init__(self, in_use: Path | None = None) -> None:
        self.in_use = in_use
        self._n_learnt = 0
        self._next: asyncio.Task[Any] | None = None
        self._n_beside = 0
        self._retired: list[Path] = []

    def is_gone(self) -> bool:
        """True when the folder of the version in use was deleted."""
        return self.in_use is not None and not self.in_use.exists()

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
        if job.cancelled() or job.exception() is not None:
            return
        if not isinstance(learnt := job.result(), LearntBackground):
            return
        if self.in_use is not None:
            self._retired.append(self.in_use)
        self.in_use = learnt.path
        self._n_learnt += 1
