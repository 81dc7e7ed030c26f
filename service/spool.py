"""The bounded queue of bundles between the cameras and the workers: one TIFF file each, on tmpfs.

Bundles leave it strictly in the order they came. When it is full the whole new bundle is lost: the one
place where stones are dropped for lack of speed, never half a bundle and never by blocking a camera.
A lost bundle keeps its place in the order, without a file.
"""

import asyncio
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.recording import write_bundle
from drivers.replay_belt import UNREADABLE
from pipeline.frames import BundleKind, CameraId, FrameBundle, Trigger
from service.bundle_windows import DISARMED

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """Why a trigger ends as `lost` (a word of the REST contract), and the same for people."""

    reason: str
    detail: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SpooledBundle:
    """One trigger's turn: a file to measure, or what it was lost to."""

    trigger: Trigger
    name: str
    content: Path | Loss

    @property
    def is_background(self) -> bool:
        return self.trigger.kind is BundleKind.BACKGROUND


class Spool:
    """`offer` on one side, `take` and `release` on the other, `write` as a task in between.

    `folder` exists and belongs to this spool alone.
    """

    def __init__(
        self,
        folder: Path,
        *,
        max_bundles: int,
        camera_ids: Sequence[CameraId],
    ) -> None:
        self._folder = folder
        self._camera_ids = tuple(camera_ids)
        self._offered: asyncio.Queue[FrameBundle | SpooledBundle | None] = asyncio.Queue()
        self._ready: asyncio.Queue[SpooledBundle | None] = asyncio.Queue()
        self.max_bundles = max_bundles
        self.held = 0
        """Bundles offered and not yet released, in memory or on tmpfs: never more than `max_bundles`."""
        self.overflows = 0
        self.on_release: Callable[[], None] = lambda: None
        """Called on the loop for every bundle that is through, lost ones included."""
        self._written = 0

    def offer(self, bundle: FrameBundle) -> None:
        """Take a bundle over; never blocks."""
        if not bundle.frames:
            self._lose(bundle, _without_frames(bundle))
        elif self.held >= self.max_bundles:
            self.overflows += 1
            self._lose(bundle, Loss(reason="queue_full", detail=f"{self.held} bundles were waiting"))
        else:
            self.held += 1
            self._offered.put_nowait(bundle)

    def finish(self) -> None:
        """No more offers: `take` returns None after the last bundle."""
        self._offered.put_nowait(None)

    async def write(self) -> None:
        """Write what is offered, one after the other, off the loop; returns after `finish`."""
        while (item := await self._offered.get()) is not None:
            self._ready.put_nowait(await self._spooled(item) if isinstance(item, FrameBundle) else item)
        self._ready.put_nowait(None)

    async def take(self) -> SpooledBundle | None:
        """Return the next bundle in order, None when there will be none."""
        return await self._ready.get()

    async def release(self, bundle: SpooledBundle) -> None:
        """Forget a taken bundle that has its outcome."""
        if isinstance(bundle.content, Path):
            await asyncio.to_thread(bundle.content.unlink)
            self.held -= 1
        self.on_release()

    def _lose(self, bundle: FrameBundle, loss: Loss) -> None:
        self._offered.put_nowait(SpooledBundle(trigger=bundle.trigger, name=bundle.name, content=loss))

    async def _spooled(self, bundle: FrameBundle) -> SpooledBundle:
        self._written += 1  # sequences may repeat when the gate restarts, file names must not
        path = self._folder / f"{self._written:08d}.tiff"
        try:
            await asyncio.to_thread(write_bundle, path, bundle, self._camera_ids, compression="none")
        except OSError as err:  # a full tmpfs is a full queue
            log.error("bundle lost, the spool cannot be written: %s bundle=%s", err, bundle.name)
            self.held -= 1
            loss = Loss(reason="queue_full", detail=f"spool: {err.strerror}")
            return SpooledBundle(trigger=bundle.trigger, name=bundle.name, content=loss)
        return SpooledBundle(trigger=bundle.trigger, name=bundle.name, content=path)


def _without_frames(bundle: FrameBundle) -> Loss:
    causes = sorted(set(bundle.missing.values()))
    if len(causes) == 1 and causes[0].startswith(f"{UNREADABLE}: "):  # in a recording
        return Loss(reason="unreadable", detail=causes[0].removeprefix(f"{UNREADABLE}: "))
    if causes == [DISARMED]:
        return Loss(reason="shutdown", detail="the rig was disarmed before the frames came")
    return Loss(reason="no_frames", detail=", ".join(causes) or "no camera delivered")
