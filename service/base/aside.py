"""Folders of what was moved aside at a start, because it does not belong to the history: `aside/<time>-<why>/`."""

import logging
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from drivers.files.durable import sync

log = logging.getLogger(__name__)

ASIDE, NOTE = "aside", "note.txt"


def new_folder(state_dir: Path, why: str) -> Path:
    """Create and return a new folder for what is moved away."""
    folder = state_dir / ASIDE / folder_name(why)
    folder.mkdir(parents=True)
    return folder


def folder_name(why: str) -> str:
    """Return the name of a folder that is made now."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%S.%fZ}-{why}"


def explain(folder: Path, note: str) -> None:
    """Add to the note of what was moved away."""
    log.error("store: %s folder=%s", note, folder)
    with (folder / NOTE).open("a", encoding="utf-8") as file:
        file.write(f"{note}\n")
    sync(folder)


def incidents(state_dir: Path) -> list[str]:
    """Return the notes on all that was moved aside at a start and still lies there."""
    found = []
    for path in sorted((state_dir / ASIDE).glob(f"*/{NOTE}")):
        with suppress(OSError):  # moved elsewhere just now
            note = " ".join(path.read_text(encoding="utf-8").split())
            found.append(f"{path.parent.relative_to(state_dir)}: {note}")
    return found
