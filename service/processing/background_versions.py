"""Which version of the background a stone is measured with: that depends on the order of the bundles alone.

The first exposures of the empty rig are learnt before any later bundle is started. Once there are some, one more makes
little difference, and no stone waits for it: it is learnt beside the next ones, and used from a certain stone after it
on, or when another exposure follows.
"""

import asyncio
from dataclasses import dataclass
from pathlib import Path
from typing import Any

WAITED_FOR = 3
"""Exposures from which the mean has hardly more noise than from any number."""
BESIDE = 8
"""Stones that are started while an exposure is learnt: that takes as long as three of them."""


@dataclass(frozen=True, slots=True)
class Learnt:
    """A new version, in a folder, and what its exposure says of each camera, see `record.optics_record`."""

    path: Path
    optics: dict[str, Any]


class BackgroundVersions:
    """The version `in_use`, and the exposure that is being learnt, which becomes the next one."""

    def __init__(self, in_use: Path | None = None) -> None:
        self.in_use = in_use
        self._n_learnt = 0
        self._next: asyncio.Task[Any] | None = None
        self._n_beside = 0
        self._retired: list[Path] = []

    async def turn_of(self, is_background: bool) -> tuple[Path, ...]:
        """Wait until what is `in_use` is what the next bundle asks for; versions that no bundle from it on does."""
        self._n_beside += not is_background
        if is_background or self._n_beside > BESIDE:
            await self._use_next()
        retired, self._retired = tuple(self._retired), []
        return retired

    async def learn(self, job: asyncio.Task[Any]) -> None:
        """Take a job whose result, if it has none of another kind, is `Learnt`; wait for it if later ones have to."""
        self._next, self._n_beside = job, 0
        if self._n_learnt < WAITED_FOR:
            await self._use_next()

    async def _use_next(self) -> None:
        job, self._next = self._next, None
        if job is None:
            return
        await asyncio.wait([job])
        if job.cancelled() or job.exception() is not None or not isinstance(learnt := job.result(), Learnt):
            return
        if self.in_use is not None:
            self._retired.append(self.in_use)
        self.in_use = learnt.path
        self._n_learnt += 1
