"""The life of a worker process: forked from a server, tuned, warmed up, and ended with its parent."""

import ctypes
import errno
import gc
import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import forkserver
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from service.base.errors import WorkerFailure

WarmUp = Callable[[], bool]
"""Loads or compiles something; returns whether something was compiled."""
Prepare = Callable[[Any], Sequence[WarmUp]]
"""Called first in a new process, with the context; returns the warm-ups that must run before jobs, longest first."""

OOM_SCORE = "800"
"""Of 1000: when memory runs out the kernel kills a worker, which costs a retry, and not the daemon."""
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
"""Parameters of mallopt(3)."""
TRIM_THRESHOLD_BYTES = 128 << 20
"""Freed memory that is kept for new arrays."""
MMAP_THRESHOLD_BYTES = 32 << 20
"""Smallest array that gets memory of its own from the kernel; glibc allows no more."""

_warm_ups: Sequence[WarmUp] = ()
"""Warm-ups of this process."""


def import_for_workers(module: str) -> None:
    """Start the server that workers are forked from; it imports the module in parallel with this process."""
    multiprocessing.set_forkserver_preload([module])
    ensure_fork_server()


def ensure_fork_server() -> None:
    """Start the server if it does not run, or does not any more; what it imports stays the same."""
    its_own = {
        "PYTHONSAFEPATH": "1",  # otherwise it would import from the working directory first
        "PYTHONPATH": os.pathsep.join(sys.path),
        "OPENBLAS_NUM_THREADS": "1",  # otherwise it has a thread, with which it must not be forked
    }
    before = {name: os.environ.get(name) for name in its_own}
    os.environ |= its_own
    try:
        forkserver.ensure_running()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def begin_process(name: str, prepare: Prepare) -> None:
    """Name a new worker process, have it ignore signals, end it with its parent, and before it without memory.

    `prepare` is not called: to unpickle it has imported what it needs.
    """
    Path("/proc/self/comm").write_text(name)
    Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)
    for number in (signal.SIGINT, signal.SIGTERM):  # a terminal sends them to the whole process group
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, name="end-with-parent", daemon=True).start()


def lower_priority(niceness: int) -> tuple[WarmUp, ...]:
    """Give this process a lower priority (nice(2)) than the daemon, which receives the frames."""
    os.nice(niceness)
    return ()


def prepare_process(prepare: Prepare, context: object) -> int:
    """Call `prepare` and return the number of warm-ups that are left to run."""
    global _warm_ups
    with worker_boundary():
        _warm_ups = prepare(context)
    return len(_warm_ups)


def warm_up(number: int) -> bool:
    """Run one warm-up of this process; return whether something was compiled."""
    with worker_boundary():
        return _warm_ups[number]()


@contextmanager
def worker_boundary() -> Iterator[None]:
    """Turn any exception within into a `WorkerFailure` with the traceback as text, which can always be pickled."""
    try:
        yield
    except Exception as err:  # noqa: BLE001 - the one place where everything is caught
        is_hosts = isinstance(err, OSError) and err.errno in (errno.EMFILE, errno.ENFILE, errno.ENOSPC)
        raise WorkerFailure("".join(traceback.format_exception(err)), is_hosts) from None


def keep_freed_memory() -> None:
    """Set malloc to reuse freed memory for new arrays of all threads, instead of returning it to the kernel.

    Fresh memory is cleared by the kernel page by page: copying 16 images into it takes 16 ms instead of 4, and a stone
    of 40 mm is measured 6 % slower.
    """
    libc = ctypes.CDLL(None)
    libc.mallopt(_M_ARENA_MAX, 1)
    libc.mallopt(_M_MMAP_THRESHOLD, MMAP_THRESHOLD_BYTES)
    libc.mallopt(_M_TRIM_THRESHOLD, TRIM_THRESHOLD_BYTES)


def freeze_gc() -> None:
    """Collect garbage, then exclude all objects from later collections, a full one of which took 100 ms."""
    gc.collect()
    gc.freeze()


def _end_with_parent() -> None:
    """Kill this process as soon as its parent is gone.

    The sentinel is a pipe whose other end only the parent holds. PR_SET_PDEATHSIG would not do: it
    fires when the parent's *thread* that spawned us ends (prctl(2)).
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGKILL)
