"""What a killed daemon has left: triggers without an outcome, and the bundles on tmpfs that are whole."""

from collections.abc import Sequence
from pathlib import Path

from drivers.errors import RecordingError
from drivers.files.recording import read_bundle
from drivers.interfaces import FrameLossReason
from pipeline.frames import CameraId
from service.store.schema import connect_reader


def open_triggers(folder: Path) -> list[tuple[int, str]]:
    """Return session and bundle of each trigger in the store of the daemon's folder that has no outcome."""
    with connect_reader(folder / "state/results.sqlite") as connection:
        return connection.execute(
            "SELECT session, bundle FROM triggers WHERE state = 'open' ORDER BY trigger"
        ).fetchall()


def whole_bundles(folder: Path, cameras: Sequence[CameraId]) -> set[tuple[int, str]]:
    """Return session and bundle of each open trigger whose bundle in the daemon's spool is whole."""
    found = set()
    for path in (folder / "spool").glob("*/*/*.tiff"):
        try:
            bundle = read_bundle(path, cameras)
        except RecordingError:
            continue
        if FrameLossReason.DAMAGED not in bundle.missing.values():
            is_left = path.name.startswith("left-")
            found.add((int(path.name.split("-")[1] if is_left else path.parent.name), bundle.name))
    return found & set(open_triggers(folder))
