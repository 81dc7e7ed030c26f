"""One live recording: bundles are offered on the loop and written on a thread of their own.

The disk may be slow, full or gone: the loop never waits for it, and the number of waiting bundles is bounded. When
that bound or the reserve of free space is reached, the recording ends early, reports it and keeps what it has; when
it cannot be written it fails and leaves nothing. Cameras and measuring are not affected.
"""

import asyncio
import queue
import shutil
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from enum import StrEnum
from typing import Any

from drivers.errors import RecordingError
from drivers.files.durable import read_json, write_json
from drivers.files.recording import RecordingWriter
from drivers.files.times import utc_now
from pipeline.frames import BundleKind, FrameBundle
from service.base.schema import Time, served

MAX_WAITING = 16
"""Most bundles that wait for the disk: four seconds at four stones a second, 340 MB with 16 cameras."""


class EndedBy(StrEnum):
    """Why a recording has ended."""

    COUNT = "count"
    """It has as many stones as were requested."""
    DURATION = "duration"
    """The requested time is over."""
    STOP = "stop"
    """It was stopped on request, or no more bundles will come."""
    LOW_DISK = "low_disk"
    """The reserve of free space was reached."""
    SLOW_DISK = "slow_disk"
    """`MAX_WAITING` bundles were waiting to be written."""


class RecordingState(StrEnum):
    """State of a live recording."""

    RECORDING = "recording"
    COMPLETE = "complete"
    """The folder exists under its final name."""
    FAILED = "failed"
    """It was ended without a folder being left."""


@served
class RecordingStatus:
    """State of a recording. A `complete` one can be replayed and measured, a `failed` one left no usable files."""

    name: str
    """Name of its folder, and in the addresses."""
    state: RecordingState
    """`recording`: under way; `complete`: usable; `failed`: no usable files."""
    created_at: Time
    """RFC 3339 UTC."""
    bundles: int
    """Bundles written so far, exposures of the empty rig included."""
    bytes: int
    """Size of the bundles on disk."""
    stones: int | None = None
    """Stones and balls among the bundles so far, those before it began included; null unless it is under way.
    """
    ended_by: str | None = None
    """Why it ended: `count`, `duration` or `stop` as requested; `low_disk` or `slow_disk`: earlier than
    requested; null while it runs."""
    reason: str | None = None
    """Why it failed, in words; null unless `failed`."""
    made_by: Mapping[str, Any] = field(default_factory=dict)
    """How it was made, as in recording.json."""

    @property
    def is_cut_short(self) -> bool:
        """Whether it failed, or ended before it had what was requested."""
        return self.reason is not None or self.ended_by in (EndedBy.LOW_DISK, EndedBy.SLOW_DISK)


class LiveRecording:
    """A recording under way: `start`, any number of `offer`, `end`; `closed` is set when the folder is complete.

    It ends by itself after `count` stones, and when less than `room_needed_bytes` are free; `earlier` bundles are
    written first and do not count. Methods are called on the loop; `on_free` is called on any thread, for every bundle
    that is written or dropped, `on_closed` on the loop.
    """

    def __init__(
        self,
        writer: RecordingWriter,
        *,
        room_needed_bytes: int,
        count: int | None = None,
        earlier: Sequence[FrameBundle] = (),
        on_free: Callable[[], None] = lambda: None,
        on_closed: Callable[[RecordingStatus], None] = lambda status: None,
    ) -> None:
        self.path = writer.path
        self.stones = 0
        """Stones and balls written so far."""
        self.without_frames = 0
        """Bundles without any frame, which a bundle file cannot represent."""
        self.ended_by: EndedBy | None = None
        self.closed = asyncio.Event()
        self._status = RecordingStatus(
            name=self.path.name,
            state=RecordingState.RECORDING,
            created_at=utc_now("seconds"),
            bundles=0,
            bytes=0,
            made_by=writer.made_by,
        )
        self._writer = writer
        self._room_needed_bytes = room_needed_bytes
        self._still_wanted = count
        self._max_waiting = len(earlier) + MAX_WAITING
        self._on_free = on_free
        self._on_closed = on_closed
        self._last_sequence = -1
        self._sequence_shift = 0
        self._waiting: queue.SimpleQueue[FrameBundle | EndedBy] = queue.SimpleQueue()
        for bundle in earlier:
            self._waiting.put(self._in_order(bundle))
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None
        # of normal priority: a starved thread that holds the interpreter's lock blocks the loop, 240 ms measured
        self._thread = threading.Thread(target=self._run, name=f"recording {self.path.name}", daemon=True)

    def start(self, duration_s: float | None = None) -> None:
        """Start writing, and end after `duration_s` if given."""
        self._thread.start()
        if duration_s is not None:
            self._timer = self._loop.call_later(duration_s, self.end, EndedBy.DURATION)

    def offer(self, bundle: FrameBundle) -> None:
        """Add a bundle unless the recording has ended; never blocks."""
        if self.ended_by is not None or self.closed.is_set():
            return
        if not bundle.frames:
            self.without_frames += 1
            self._on_free()
            return
        if self._waiting.qsize() >= self._max_waiting:
            self.end(EndedBy.SLOW_DISK)
            return
        self._waiting.put(self._in_order(bundle))
        if self._still_wanted is not None and bundle.kind is not BundleKind.BACKGROUND:
            self._still_wanted -= 1
            if self._still_wanted == 0:
                self.end(EndedBy.COUNT)

    def end(self, by: EndedBy) -> None:
        """End the recording after the bundles that it has; only the first reason counts."""
        if self.ended_by is None:
            self.ended_by = by
            self._waiting.put(by)

    def status(self) -> RecordingStatus:
        stones = None if self.closed.is_set() else self.stones
        return replace(self._status, stones=stones, ended_by=self.ended_by)

    def _in_order(self, bundle: FrameBundle) -> FrameBundle:
        """Return the bundle with a sequence number above all before: a gate may count anew during a recording."""
        sequence = bundle.trigger.sequence + self._sequence_shift
        if sequence <= self._last_sequence:
            self._sequence_shift += self._last_sequence + 1 - sequence
            sequence = self._last_sequence + 1
        self._last_sequence = sequence
        return replace(bundle, trigger=replace(bundle.trigger, sequence=sequence, name=bundle.name))

    def _close(self, ended_by: EndedBy | None, failure: str | None) -> None:
        self._thread.join()  # which has nothing left to do
        if self._timer is not None:
            self._timer.cancel()
        state = RecordingState.FAILED if failure else RecordingState.COMPLETE
        self._status = replace(self._status, state=state, reason=failure)
        self.ended_by = ended_by
        self.closed.set()
        self._on_closed(self.status())

    # --- the thread ---

    def _run(self) -> None:
        ended_by: EndedBy | None = None
        failure: str | None = "the recorder crashed: see the journal"
        try:
            with self._writer as writer:
                by = self._write_bundles(writer)
                if self._status.bundles == 0:
                    raise RecordingError(self.path, f"nothing was recorded, it ended by {by}")
                made_by = {**writer.made_by, "ended_by": by, "without_frames": self.without_frames}
                self._status = replace(self._status, made_by=made_by)
                document = read_json(writer.folder / "recording.json")
                document |= {"created_at": self._status.created_at, "made_by": made_by}
                write_json(writer.folder / "recording.json", document)
            ended_by, failure = by, None
        except RecordingError as err:
            failure = err.problem
        except OSError as err:
            failure = f"cannot be written: {err.strerror}"
        finally:
            self._loop.call_soon_threadsafe(self._close, ended_by, failure)

    def _write_bundles(self, writer: RecordingWriter) -> EndedBy:
        while isinstance(bundle := self._waiting.get(), FrameBundle):
            if shutil.disk_usage(writer.folder).free < self._room_needed_bytes:
                return EndedBy.LOW_DISK
            writer.add(bundle)
            n_bytes = (writer.folder / "bundles" / f"{bundle.name}.tiff").stat().st_size
            before = self._status
            self._status = replace(before, bundles=before.bundles + 1, bytes=before.bytes + n_bytes)
            self.stones += bundle.kind is not BundleKind.BACKGROUND
            self._on_free()
        return bundle
