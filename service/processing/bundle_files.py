"""The files on tmpfs that bundles travel in: one that is through is written over by the next bundle."""

import asyncio
from collections.abc import Callable
from pathlib import Path

SPARE_FILES = 4
"""So many files are kept to be written over: fresh memory of tmpfs costs 7 ms a bundle."""


class BundleFiles:
    """Hands out files of one folder, which exists and belongs to these files alone; all on the loop.

    `on_through` is called for every bundle that needs its place no longer, those without a file included.
    """

    def __init__(self, folder: Path, *, on_through: Callable[[], None] = lambda: None) -> None:
        self._folder = folder
        self.on_through = on_through
        self._n_files = 0
        self._spare: list[Path] = []

    def take(self) -> Path:
        """Return a file that nobody reads any more, else the name of a new one."""
        if self._spare:
            return self._spare.pop()
        self._n_files += 1
        return self._folder / f"{self._n_files:08d}.tiff"

    async def give_back(self, path: Path) -> None:
        """Take back a file that is read no longer."""
        if len(self._spare) < SPARE_FILES:
            self._spare.append(path)
        else:
            await asyncio.to_thread(path.unlink)
        self.on_through()
