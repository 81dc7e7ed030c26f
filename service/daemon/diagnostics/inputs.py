"""Inputs of an archive for support."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from service.host.machine import HostNeeds


@dataclass(frozen=True, slots=True, kw_only=True)
class Secrets:
    """What must not appear in the archive, wherever it stands."""

    values: frozenset[str]
    files: tuple[Path, ...]  # of one secret each

    def all(self) -> Iterator[str]:
        """Yield all of them; a file that cannot be read has none. Blocks."""
        yield from self.values
        for path in self.files:
            try:
                yield path.read_text(encoding="utf-8", errors="replace").strip()
            except OSError:
                continue


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """Where to look, and what the running daemon adds; all of it can be pickled."""

    store_dir: Path
    calibration: Path  # the configured rig file
    needs: HostNeeds
    secrets: Secrets
    configuration: Mapping[str, Any]  # as JSON has it
    live: Mapping[str, Any] = field(default_factory=dict)
    """By the name of the file: documents and texts of the running daemon; empty when none runs."""
