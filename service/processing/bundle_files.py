"""The files on tmpfs that bundles pass to the workers in; a file that is free is written over by a later bundle."""

import asyncio
from collections.abc import Callable
from pathlib import Path

from service.processing.left_bundles import is_left

SPARE_FILES = 4
"""Free files that are kept to be written over: fresh memory of tmpfs costs 7 ms a bundle."""


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
        """Take back a file that is no longer read; it may be gone."""
        if is_left(path):  # its name must not become another bundle's, and it had no place
            await asyncio.to_thread(path.unlink, missing_ok=True)
            return
        if len(self._spare) < SPARE_FILES:
            self._spare.append(path)
        else:
            await asyncio.to_thread(path.unlink, missing_ok=True)
        self.on_free()
