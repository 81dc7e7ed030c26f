"""The life of a worker process around its jobs: it begins, is warmed up, and ends with its parent."""

import errno
import multiprocessing
import os
import signal
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
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


@contextmanager
def worker_boundary() -> Iterator[None]:
    """Turn any exception within into a `WorkerFailure` with the traceback as text, which can always be pickled."""
    try:
        yield
    except Exception as err:  # noqa: BLE001 - the one place where everything is caught
        is_hosts = isinstance(err, OSError) and err.errno in (errno.EMFILE, errno.ENFILE, errno.ENOSPC)
        raise WorkerFailure("".join(traceback.format_exception(err)), is_hosts) from None


_warm_ups: Sequence[WarmUp] = ()
"""Warm-ups of this process."""


def begin_process(name: str, prepare: Prepare) -> None:
    """Name a new worker process, have it ignore signals, end it with its parent, and before it without memory.

    `prepare` is not called: to unpickle it has imported what it needs.
    """
    Path("/proc/self/comm").write_text(name)
    Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)
    for number in (signal.SIGINT, signal.SIGTERM):  # a terminal sends them to the whole process group
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, name="end-with-parent", daemon=True).start()


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


def _end_with_parent() -> None:
    """Kill this process as soon as its parent is gone.

    The sentinel is a pipe whose other end only the parent holds. PR_SET_PDEATHSIG would not do: it
    fires when the parent's *thread* that spawned us ends (prctl(2)).
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGKILL)
