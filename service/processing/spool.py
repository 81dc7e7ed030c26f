"""The bounded queue of bundles between the cameras and the workers: one TIFF file each, on tmpfs.

A worker maps the file, so a frame is copied once on its way; later bundles are written over the same file.

Bundles leave strictly in the order in which they came. When the spool is full the whole new bundle is lost: this is
the one place where stones are dropped for lack of speed, never half a bundle and never by blocking a camera.
A lost bundle keeps its place in the order, without a file. Bundles that an earlier session left come first.
"""

import asyncio
import logging
import shutil
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.files.bundle_file import overwrite_bundle
from pipeline.frames import BundleKind, CameraId, FrameBundle, MissingReason, Trigger
from service.base.messages import Code, joined, message
from service.base.status import Checks, health_check
from service.results.fields import LossReason

log = logging.getLogger(__name__)

MAX_LOSSES = 50_000
"""Most losses that wait for a store that is held, 0.5 kB each: three hours of stones. Later ones are one a reason."""
LEFT = "left-"
"""Begins the name of what another session left; those of this one's files are numbers."""
LEFT_BACKGROUND = LEFT + "{}-background"
"""Name of the folder of a background that another session learnt, by its number."""
SPARE_FILES = 4
"""Free files that are kept to be written over: fresh memory of tmpfs costs 7 ms a bundle."""
RECENT_S = 60.0
"""Time for which a loss is reported as trouble."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """Why a trigger ends as `lost`: a word of the REST contract, and the details for people."""

    reason: LossReason
    detail: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SpooledBundle:
    """One trigger in the order of processing: a file to measure, or why the trigger is lost."""

    trigger: Trigger
    name: str
    content: Path | Loss

    @property
    def is_background(self) -> bool:
        return self.trigger.kind is BundleKind.BACKGROUND


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftBundle(SpooledBundle):
    """A complete bundle of an earlier session, in the folder of this one."""

    content: Path
    session: int
    background: Path | None  # the newest that its session had learnt


class BundleFiles:
    """Hands out files of one existing folder, which holds nothing else; called on the event loop.

    `on_free` is called for every bundle that needs its place no longer, those without a file included.
    """

    def __init__(self, folder: Path, *, on_free: Callable[[], None] = lambda: None) -> None:
        self._folder = folder
        self.on_free = on_free
        self._n_files = 0
        self._spare: list[Path] = []

    def take(self) -> Path:
        """Return a free file, or the name of a new one if there is none."""
        if self._spare:
            return self._spare.pop()
        self._n_files += 1
        return self._folder / f"{self._n_files:08d}.tiff"

    async def give_back(self, path: Path) -> None:
        """Take back a file that is no longer read, which may be gone, to be written over by a later bundle."""
        is_of_earlier = path.name.startswith(
            LEFT
        )  # its name must not become another bundle's, and it had no place
        if not is_of_earlier and len(self._spare) < SPARE_FILES:
            self._spare.append(path)
        else:
            await asyncio.to_thread(path.unlink, missing_ok=True)
        if not is_of_earlier:
            self.on_free()


class Spool:
    """Bounded queue of bundles: `offer` to it, `take` from it and `release`; `write` is the task in between."""

    def __init__(
        self,
        files: BundleFiles,
        *,
        max_bundles: int,
        camera_ids: Sequence[CameraId],
        archive: Callable[[Path, int], bool] = lambda path, seq: False,
        store_trouble: Callable[[], str | None] = lambda: None,
        left: Sequence[LeftBundle] = (),
    ) -> None:
        """`store_trouble` returns why bundles do not get their outcome now, None if they do.

        `archive` takes over the file of the result `seq`, to give it back later; it returns False if it does not.
        """
        self._files = files
        self._camera_ids = tuple(camera_ids)
        self._archive = archive
        self._store_trouble = store_trouble
        self._n_losses = 0  # that wait for their outcome
        self._counted: dict[tuple[BundleKind, LossReason], SpooledBundle] = {}  # losses beyond `MAX_LOSSES`
        self._offered: asyncio.Queue[FrameBundle | SpooledBundle | None] = asyncio.Queue()
        self._ready: asyncio.Queue[SpooledBundle | None] = asyncio.Queue()
        self.max_bundles = max_bundles
        self.n_queued = self._n_left = len(left)
        """Bundles offered and not yet released, in memory or on tmpfs: never more than `max_bundles`."""
        self.overflows = 0
        """Stones and balls lost because the spool was full, or could not be written."""
        self._troubles: dict[str, tuple[str, float]] = {}
        """By kind of trouble what was the last, and when."""
        for each in left:
            self._ready.put_nowait(each)

    @property
    def trouble(self) -> str | None:
        """What went wrong with the spool within the last `RECENT_S`, None if nothing did."""
        recent_s = time.monotonic() - RECENT_S
        return ", ".join(text for text, at_s in list(self._troubles.values()) if at_s > recent_s) or None

    @property
    def n_waiting(self) -> int:
        """Bundles and losses that have no outcome yet."""
        return self.n_queued + self._n_losses + sum(each.trigger.n_stones for each in self._counted.values())

    def checks(self) -> Checks:
        """Check that there is room for the next bundles, and that none was lost lately."""
        trouble, waiting = (
            self.trouble,
            message(Code.QUEUE_WAITING, bundles=self.n_queued, most=self.max_bundles),
        )
        is_filling = 2 * self.n_queued > self.max_bundles
        detail = joined([waiting, *([message(Code.QUEUE_TROUBLE, reported=trouble)] if trouble else [])])
        is_troubled = is_filling or trouble is not None
        is_full = self.n_queued >= self.max_bundles
        return {"queue": health_check(detail, self.n_queued, "bundles", warn=is_troubled, fail=is_full)}

    def offer(self, bundle: FrameBundle) -> None:
        """Add a bundle, or its loss if it has no frames or the spool is full; never blocks."""
        if not bundle.frames:
            self._lose(bundle, _loss_without_frames(bundle))
        elif self.n_queued >= self.max_bundles:
            self._lose(bundle, self._overflow(bundle, f"{self.n_queued} bundles were waiting"))
        else:
            self.n_queued += 1
            self._offered.put_nowait(bundle)

    def finish(self) -> None:
        """Declare the end of all offers: `take` returns None after the last bundle."""
        self._offer_counted()
        self._offered.put_nowait(None)

    async def write(self) -> None:
        """Write the offered bundles one after the other, on a thread; return after `finish`."""
        # a thread of its own: stones do not wait for the requests of clients
        with ThreadPoolExecutor(1, thread_name_prefix="spool") as thread:
            while (item := await self._offered.get()) is not None:
                self._ready.put_nowait(
                    await self._spooled(item, thread) if isinstance(item, FrameBundle) else item
                )
        self._ready.put_nowait(None)

    async def take(self) -> SpooledBundle | None:
        """Return the next bundle in order, None when there are no more."""
        return await self._ready.get()

    async def release(self, bundle: SpooledBundle, seq: int | None = None) -> None:
        """Free the place of a bundle that has its outcome; `seq` is the number of its result if it was processed."""
        if isinstance(bundle.content, Loss):
            self._n_losses -= 1
            if self._n_losses == 0:
                self._offer_counted()
            self._files.on_free()
            return
        self.n_queued -= 1
        if isinstance(bundle, LeftBundle):
            self._n_left -= 1
            if self._n_left == 0:
                await asyncio.to_thread(remove_backgrounds, bundle.content.parent)
        if seq is None or not self._archive(bundle.content, seq):
            await self._files.give_back(bundle.content)

    def _lose(self, bundle: FrameBundle, loss: Loss) -> None:
        lost = SpooledBundle(trigger=bundle.trigger, name=bundle.name, content=loss)
        if self._n_losses < MAX_LOSSES or self._store_trouble() is None:  # else its trigger has no row yet
            self._n_losses += 1
            self._offered.put_nowait(lost)
        elif not lost.is_background:
            kind = bundle.trigger.kind, loss.reason
            known = self._counted.get(kind)
            n_stones = bundle.trigger.n_stones + (0 if known is None else known.trigger.n_stones)
            self._counted[kind] = replace(lost, trigger=replace(bundle.trigger, n_stones=n_stones))

    def _offer_counted(self) -> None:
        """Offer the losses that were only counted: those of one reason as the last of them, with their number."""
        for lost in self._counted.values():
            self._n_losses += 1
            self._offered.put_nowait(replace(lost, name=f"{lost.name}-counted"))
        self._counted = {}

    async def _spooled(self, bundle: FrameBundle, thread: ThreadPoolExecutor) -> SpooledBundle:
        path = self._files.take()
        try:
            await asyncio.get_running_loop().run_in_executor(thread, self._write, path, bundle)
        except OSError as err:  # a full tmpfs is a full queue
            with suppress(OSError):
                await asyncio.to_thread(path.unlink, missing_ok=True)
            log.error("bundle lost, the spool cannot be written: %s bundle=%s", err, bundle.name)
            self.n_queued -= 1
            self._n_losses += 1
            loss = self._overflow(bundle, f"spool: {err.strerror}")
            return SpooledBundle(trigger=bundle.trigger, name=bundle.name, content=loss)
        return SpooledBundle(trigger=bundle.trigger, name=bundle.name, content=path)

    def _write(self, path: Path, bundle: FrameBundle) -> None:
        """Write a bundle's file, on the thread; a folder that was deleted is made anew."""
        try:
            overwrite_bundle(path, bundle, self._camera_ids)
        except FileNotFoundError:
            path.parent.mkdir(parents=True, exist_ok=True)
            log.error("the spool was deleted and is made anew folder=%s", path.parent)
            self._note("deleted", "its folder was deleted, and made anew")
            overwrite_bundle(path, bundle, self._camera_ids)

    def _overflow(self, bundle: FrameBundle, detail: str) -> Loss:
        """Count a bundle that finds no room; return its loss, of which a store that is held is the cause."""
        self.overflows += bundle.trigger.kind is not BundleKind.BACKGROUND
        if (trouble := self._store_trouble()) is not None:
            return Loss(reason=LossReason.STORE_HELD, detail=trouble)
        self._note("full", f"{self.overflows} stones lost since the start ({detail})")
        return Loss(reason=LossReason.QUEUE_FULL, detail=detail)

    def _note(self, kind: str, trouble: str) -> None:
        self._troubles[kind] = trouble, time.monotonic()


def remove_backgrounds(folder: Path) -> None:
    """Remove the backgrounds of earlier sessions, when nothing is left to be measured with them."""
    for path in folder.glob(LEFT_BACKGROUND.format("*")):
        shutil.rmtree(path, ignore_errors=True)


def _loss_without_frames(bundle: FrameBundle) -> Loss:
    if bundle.unreadable is not None:
        return Loss(reason=LossReason.UNREADABLE, detail=bundle.unreadable)
    causes = sorted(set(bundle.missing.values()))
    if causes == [MissingReason.DISARMED]:
        return Loss(reason=LossReason.SHUTDOWN, detail="the rig was disarmed before the frames came")
    if causes == [MissingReason.DOWN]:
        return Loss(reason=LossReason.DOWN, detail="counted by the light gate while the daemon was down")
    return Loss(reason=LossReason.NO_FRAMES, detail=", ".join(causes) or "no camera delivered")
