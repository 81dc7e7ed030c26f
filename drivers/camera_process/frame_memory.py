"""Memory that one process receives frames into and another one reads them from, without a copy.

It is divided into slots of one frame each. The writing end takes a free slot and names it when it is full; the
reading end reports released images. Both ends outlive the other.
"""

import mmap
import os
import weakref
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import Image

MAX_HELD = 8
"""Images of a camera that may be held in its memory: two seconds of stones. Who holds more holds copies."""
ON_THE_WAY = 8
"""Further images that are on their way to the reader, or the word that they are held no longer."""


class SlotsToFill:
    """The end that receives; `file` opens the other end, and may be closed then. Thread-safe."""

    def __init__(self, n_slots: int) -> None:
        self.n_slots = n_slots
        self.slot_bytes = 0  # until the first is taken
        self.file = os.fdopen(os.memfd_create("frames"), "r+b", buffering=0)
        self._bytes = np.empty(0, np.uint8)
        # the one freed last is taken first: pages that no frame ever needed are not there
        self._free = deque(range(n_slots))

    def take(self, n_bytes: int) -> NDArray[np.uint8] | None:
        """Return a free slot (N,) to receive so many bytes into, as many each time; None when all are full."""
        if self.slot_bytes == 0:
            self.slot_bytes = -(-n_bytes // mmap.PAGESIZE) * mmap.PAGESIZE
            self.file.truncate(self.slot_bytes * self.n_slots)
            self._bytes = np.frombuffer(mmap.mmap(self.file.fileno(), 0), np.uint8)
        try:
            slot = self._free.pop()
        except IndexError:
            return None
        return self._bytes[slot * self.slot_bytes :][: self.slot_bytes]

    def slot_of(self, image: Image) -> int:
        """Return the slot that an image is in."""
        return int(image.ctypes.data - self._bytes.ctypes.data) // self.slot_bytes

    def free(self, slot: int) -> None:
        """Let a slot be taken again."""
        self._free.append(slot)


class FilledSlots:
    """The reading end; takes over the file. `on_free` is called with a slot when the last view of its image is gone.

    It is called on any thread, at any place where the last view is dropped: it must neither block nor lock.
    """

    def __init__(self, file: int, slot_bytes: int, n_slots: int, on_free: Callable[[int], None]) -> None:
        self._slot_bytes = slot_bytes
        self._on_free = on_free
        self._held: set[int] = set()
        try:
            self._memory = mmap.mmap(file, slot_bytes * n_slots, prot=mmap.PROT_READ)
        finally:
            os.close(file)

    @property
    def n_held(self) -> int:
        """Number of images that are held."""
        return len(self._held)

    def image(self, slot: int, size_px: tuple[int, int]) -> Image:
        """Return the image (H, W) in a slot, read-only; any view of it keeps the slot."""
        width_px, height_px = size_px
        pixels = np.frombuffer(self._memory, np.uint8, width_px * height_px, slot * self._slot_bytes)
        self._held.add(slot)
        weakref.finalize(pixels, self._let_go, slot).atexit = False
        return pixels.reshape(height_px, width_px)

    def copy(self, slot: int, size_px: tuple[int, int]) -> Image:
        """Return a copy of the image in a slot, which is free at once."""
        return self.image(slot, size_px).copy()

    def _let_go(self, slot: int) -> None:
        self._held.discard(slot)
        self._on_free(slot)
