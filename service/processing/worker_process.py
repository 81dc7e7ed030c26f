"""What goes on in a worker process but for its jobs: how it begins, is made ready, and ends with its parent."""

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

from service.errors import WorkerFailure

WarmUp = Callable[[], bool]
"""Has something loaded or compiled; whether that took a compiler."""
Prepare = Callable[[Any], Sequence[WarmUp]]
"""First thing in a new process, given the context; returns what is left to do before jobs come, the longest first."""


@contextmanager
def worker_boundary() -> Iterator[None]:
    """Turn whatever goes wrong within into a `WorkerFailure` with the traceback as text: it travels home as it is."""
    try:
        yield
    except Exception as err:  # noqa: BLE001 - the one place where everything is caught
        raise WorkerFailure("".join(traceback.format_exception(err))) from None


_warm_ups: Sequence[WarmUp] = ()
"""Of this process."""


def begin(name: str, prepare: Prepare) -> None:
    """First thing in a new worker process, which has by now imported what `prepare` needs."""
    Path("/proc/self/comm").write_text(name)
    for number in (signal.SIGINT, signal.SIGTERM):  # a terminal sends them to the whole process group
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, name="end-with-parent", daemon=True).start()


def prepare_process(prepare: Prepare, context: object) -> int:
    """How many warm-ups there are."""
    global _warm_ups
    with worker_boundary():
        _warm_ups = prepare(context)
    return len(_warm_ups)


def warm_up(number: int) -> bool:
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
