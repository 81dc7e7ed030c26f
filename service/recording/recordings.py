"""The daemon's recordings: on the disk, at most one under way, and the newest bundles in memory for the next one.

The newest stones are kept in memory so that a recording can begin in the past; the newest exposures of the empty rig
are kept for longer, because a recording without them cannot be measured.
"""

import asyncio
import logging
import re
import shutil
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from http import HTTPStatus
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from drivers.errors import RecordingError
from drivers.files.bundle_file import Compression
from drivers.files.durable import read_json, sync
from drivers.files.recording import UNKNOWN_UTC, RecordingSource, RecordingWriter
from pipeline.frames import BundleKind, FrameBundle
from pipeline.rig.cameras import RigCalibration
from service.base.errors import ProblemError, ProblemKind
from service.base.messages import Code, message
from service.base.schema import request_body, require_ranges
from service.base.status import Checks, trouble_check
from service.recording.live_recording import EndedBy, LiveRecording, RecordingState, RecordingStatus

log = logging.getLogger(__name__)

KEPT_BACKGROUNDS = 5
"""Newest exposures of the empty rig that are kept in memory for the next recording."""
CLOSE_S = 10.0
"""Longest wait for the bundles that an ending recording still has to write."""
NAME = r"^[A-Za-z0-9_-]{1,64}$"
"""Pattern of the name of a recording, which is the name of a folder and part of a URL."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingsSettings:
    """Parameters of recordings that are made while measuring."""

    pre_trigger: int = 8  # newest stones that are kept in memory for the next recording; 21 MB each
    reserve_gb: float = 2.0  # a recording ends before less than this is free; results need room too
    # "zstd" halves the 21 MB of a bundle; 80 ms of a core instead of 25, which is taken from measuring
    compression: Compression = "none"

    def __post_init__(self) -> None:
        require_ranges(self, pre_trigger=(0, 1000), reserve_gb=(0, 100_000))

    @property
    def reserve_bytes(self) -> int:
        return round(self.reserve_gb * 1e9)


@request_body
class RecordingRequest:
    """Request for a recording. It ends when `count` or `duration_s` is reached, whichever comes first."""

    name: Annotated[str, Field(pattern=NAME)]
    """Name of its folder; must be new."""
    count: Annotated[int, Field(ge=1, le=1_000_000, strict=True)] | None = None
    """Number of stones to record from now on."""
    duration_s: Annotated[float, Field(gt=0, le=86_400, strict=True)] | None = None
    """Seconds to record from now on."""
    pre_trigger: Annotated[int, Field(ge=0, le=1000, strict=True)] = 0
    """Number of stones before now to record as well, as far as their frames are kept."""

    def __post_init__(self) -> None:
        if self.count is None and self.duration_s is None:
            raise ValueError("give count, duration_s or both: a recording must end")


class Refusal(StrEnum):
    """Why a recording is not started, or not deleted."""

    EXISTS = "recording-exists"
    RUNNING = "recording-running"
    NO_ROOM = "no-room"


class RecordingRefusedError(ProblemError):
    """A recording cannot be started or deleted now."""

    kinds = (
        ProblemKind(Refusal.EXISTS, HTTPStatus.CONFLICT, "A recording of this name exists"),
        ProblemKind(Refusal.RUNNING, HTTPStatus.CONFLICT, "A recording is running"),
        ProblemKind(Refusal.NO_ROOM, HTTPStatus.INSUFFICIENT_STORAGE, "Not enough disk space"),
    )

    def __init__(self, refusal: Refusal, detail: str) -> None:
        super().__init__(detail, refusal)


def require_room(folder: Path, n_bundles: int, source: RecordingSource, reserve_bytes: int) -> None:
    """Refuse a recording that would not fit in addition to the reserve; `folder` need not exist yet."""
    while not folder.exists():
        folder = folder.parent
    free_bytes = shutil.disk_usage(folder).free
    needed_bytes = n_bundles * source.bundle_bytes
    if free_bytes < needed_bytes + reserve_bytes:
        raise RecordingRefusedError(
            Refusal.NO_ROOM,
            f"{n_bundles} bundles may take {needed_bytes / 1e9:.1f} GB in addition to the reserve of"
            f" {reserve_bytes / 1e9:.1f} GB, and {free_bytes / 1e9:.1f} GB are free: make room or record less",
        )


def recording_in(folder: Path, name: str) -> RecordingStatus | None:
    """Return the status of the recording of this name on the disk, None if there is none."""
    path = folder / name
    if not re.fullmatch(NAME, name) or not path.exists():
        return None
    sizes = [file.stat().st_size for file in (path / "bundles").glob("*.tiff")]
    document: Any = {}
    reason = None
    try:
        document = read_json(path / "recording.json")
    except RecordingError as err:
        reason = f"recording.json {err.problem}"
    if not isinstance(document, dict) or not isinstance(document.get("made_by", {}), dict):
        document, reason = {}, "recording.json does not describe a recording"
    made_by = document.get("made_by", {})
    ended_by = made_by.get("ended_by")
    return RecordingStatus(
        name=path.name,
        state=RecordingState.FAILED if reason else RecordingState.COMPLETE,
        created_at=str(document.get("created_at", UNKNOWN_UTC)),
        bundles=len(sizes),
        bytes=sum(sizes),
        ended_by=ended_by if isinstance(ended_by, str) else None,
        reason=reason,
        made_by=made_by,
    )


def remove_recording(folder: Path, name: str) -> None:
    """Remove a recording: at once under its name, so that after a kill the next start removes the rest."""
    hidden = folder / f".{name}.deleted.unfinished"
    (folder / name).rename(hidden)
    sync(folder)
    shutil.rmtree(hidden)


class Recordings:
    """Keeps the newest bundles and records them: `offer` it every bundle; all methods are called on the event loop."""

    def __init__(
        self, folder: Path, source: RecordingSource, settings: RecordingsSettings, made_by: Mapping[str, Any]
    ) -> None:
        """Open the folder of recordings, creating it, and remove what a killed daemon left unfinished; on a thread."""
        folder.mkdir(parents=True, exist_ok=True)
        for unfinished in folder.glob(".*.unfinished"):
            log.warning("removed a recording that the daemon's crash left unfinished: %s", unfinished.name)
            shutil.rmtree(unfinished, ignore_errors=True)
        self._folder = folder
        self._source = source
        self._settings = settings
        self._made_by = made_by
        self._stones: deque[tuple[int, FrameBundle]] = deque(maxlen=settings.pre_trigger)
        self._backgrounds: deque[tuple[int, FrameBundle]] = deque(maxlen=KEPT_BACKGROUNDS)
        self._n_offered = 0
        self._live: LiveRecording | None = None
        self._failed: dict[str, RecordingStatus] = {}
        self._last: RecordingStatus | None = None

    @property
    def trouble(self) -> str | None:
        """Why the latest recording ended early or failed, None if it did not."""
        if self._last is None or not self._last.is_cut_short:
            return None
        why = str(self._last.reason or self._last.ended_by)
        return message(Code.RECORDING_CUT_SHORT, recording=self._last.name, reported=why)

    def checks(self) -> Checks:
        return {"recording": trouble_check(self.trouble)}

    def use_rig(self, rig: RigCalibration) -> None:
        """Write this calibration into the rig files of later recordings."""
        self._source = replace(self._source, rig=rig)

    def offer(self, bundle: FrameBundle) -> None:
        """Keep a bundle in memory, and pass it to the recording under way; never blocks."""
        self._n_offered += 1
        kept = self._backgrounds if bundle.kind is BundleKind.BACKGROUND else self._stones
        if bundle.frames:
            kept.append((self._n_offered, bundle))
        if self._live is not None:
            self._live.offer(bundle)

    async def start(self, plan: RecordingRequest) -> RecordingStatus:
        """Begin a recording; it is refused if the name is taken, another one is under way, or there is no room."""
        path = self._folder / plan.name
        await asyncio.to_thread(self._require_name_and_room, path, plan)
        # no await from here on: of two simultaneous requests only one starts a recording
        if self._live is not None:
            raise RecordingRefusedError(
                Refusal.RUNNING, f"recording {self._live.path.name} is under way: stop it first"
            )
        stones = list(self._stones)[-plan.pre_trigger :] if plan.pre_trigger else []
        earlier = [bundle for _, bundle in sorted([*self._backgrounds, *stones], key=itemgetter(0))]
        asked = {"count": plan.count, "duration_s": plan.duration_s, "pre_trigger": len(stones)}
        made_by = {**self._made_by, **asked}
        live = LiveRecording(
            RecordingWriter(path, self._source, made_by=made_by, compression=self._settings.compression),
            room_needed_bytes=self._settings.reserve_bytes + self._source.bundle_bytes,
            count=plan.count,
            earlier=earlier,
            on_closed=self._on_closed,
        )
        live.start(plan.duration_s)
        self._live, self._last = live, None
        self._failed.pop(plan.name, None)
        log.info("recording recording=%s earlier=%d", plan.name, len(earlier))
        return live.status()

    async def stop(self, name: str) -> RecordingStatus | None:
        """End a recording and return its status when it is complete; None when there is none of that name."""
        if (live := self._running(name)) is None:
            return await self.find(name)
        await _end(live)
        return live.status()

    async def find(self, name: str) -> RecordingStatus | None:
        """Return the status of a recording, None when there is none of that name."""
        if (live := self._running(name)) is not None:
            return live.status()
        return await asyncio.to_thread(recording_in, self._folder, name) or self._failed.get(name)

    async def delete(self, name: str) -> bool:
        """Delete a recording, unless it is under way; return whether there was one of that name."""
        if self._running(name) is not None:
            raise RecordingRefusedError(Refusal.RUNNING, f"recording {name} is under way: stop it first")
        has_failed = self._failed.pop(name, None) is not None
        if await asyncio.to_thread(recording_in, self._folder, name) is None:
            return has_failed
        await asyncio.to_thread(remove_recording, self._folder, name)
        return True

    def path(self, name: str) -> Path:
        """Return the folder of a recording that is complete."""
        return self._folder / name

    async def all(self) -> list[RecordingStatus]:
        """Return all recordings, sorted by name: on the disk, under way, and those that failed since the start."""
        kept = await asyncio.to_thread(
            lambda: [recording_in(self._folder, path.name) for path in self._folder.iterdir()]
        )
        known = self._failed | {status.name: status for status in kept if status is not None}
        if self._live is not None:
            known[self._live.path.name] = self._live.status()
        return [known[name] for name in sorted(known)]

    async def close(self) -> None:
        """End the recording under way; what it has is kept."""
        if self._live is not None:
            await _end(self._live)

    def _running(self, name: str) -> LiveRecording | None:
        return self._live if self._live is not None and self._live.path.name == name else None

    def _require_name_and_room(self, path: Path, plan: RecordingRequest) -> None:
        if path.exists():
            raise RecordingRefusedError(
                Refusal.EXISTS, f"there is a recording {path.name} already: choose another name"
            )
        n_bundles = (plan.count or 1) + plan.pre_trigger + KEPT_BACKGROUNDS
        require_room(self._folder, n_bundles, self._source, self._settings.reserve_bytes)

    def _on_closed(self, status: RecordingStatus) -> None:
        self._live, self._last = None, status
        if status.state is RecordingState.FAILED:
            self._failed[status.name] = status
        log.log(
            logging.ERROR if status.is_cut_short else logging.INFO,
            "recording ended: %s recording=%s bundles=%d bytes=%d",
            status.reason or status.ended_by,
            status.name,
            status.bundles,
            status.bytes,
        )


async def _end(live: LiveRecording) -> None:
    live.end(EndedBy.STOP)
    try:
        async with asyncio.timeout(CLOSE_S):
            await live.closed.wait()
    except TimeoutError:
        log.error("the disk is too slow: a recording may stay incomplete recording=%s", live.path.name)
