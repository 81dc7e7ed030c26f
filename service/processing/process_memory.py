"""How a process that lives long deals with its memory: with what it has freed, and with what it never frees."""

import ctypes
import gc

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
"""Of mallopt(3)."""
KEPT_BYTES = 128 << 20
LARGEST_BYTES = 32 << 20
"""glibc takes no more."""


def keep_freed_memory() -> None:
    """Let images and fields be made where others were, of all threads: what is new is cleared first, page by page.

    To copy 16 images into fresh memory takes 16 ms instead of 4, and a stone of 40 mm is measured 6 % slower.
    """
    libc = ctypes.CDLL(None)
    libc.mallopt(_M_ARENA_MAX, 1)
    libc.mallopt(_M_MMAP_THRESHOLD, LARGEST_BYTES)
    libc.mallopt(_M_TRIM_THRESHOLD, KEPT_BYTES)


def freeze_gc() -> None:
    """Never look at what is there by now for garbage again: that took 100 ms, with the interpreter's lock held."""
    gc.collect()
    gc.freeze()
