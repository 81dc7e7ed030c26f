"""Recordings on the disk: list them, and remove one."""

import re
import shutil
from pathlib import Path
from typing import Any

from drivers.errors import RecordingError
from drivers.files.durable import read_json, sync
from drivers.files.recording import UNKNOWN_UTC
from service.recording.live_recording import RecordingState, RecordingStatus

NAME = r"^[A-Za-z0-9_-]{1,64}$"
RECORDING_NAME = re.compile(NAME.strip("^$"))
"""Pattern of the name of a recording, which is the name of a folder and part of a URL."""


def recordings_in(folder: Path) -> list[RecordingStatus]:
    """Return the status of every recording in a folder."""
    return [status for path in folder.iterdir() if (status := recording_in(folder, path.name))]


def recording_in(folder: Path, name: str) -> RecordingStatus | None:
    """Return the status of the recording of this name, None if there is none."""
    path = folder / name
    return _status_of(path) if RECORDING_NAME.fullmatch(name) and path.exists() else None


def _status_of(path: Path) -> RecordingStatus:
    sizes = [file.stat().st_size for file in (path / "bundles").glob("*.tiff")]
    document: Any = {}
    reason = None
    try:
        document = read_json(path / "recording.json")
    except RecordingError as err:
        reason = f"recording.json {err.problem}"
    if not isinstance(document, dict) or not isinstance(document.get("made_by", {}), dict):
        document, reason = {}, "recording.json is damaged"
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
    path = folder / name
    hidden = folder / f".{name}.deleted.unfinished"
    path.rename(hidden)
    sync(folder)
    shutil.rmtree(hidden)
