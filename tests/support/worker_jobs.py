"""Jobs for the worker pool that run, crash, hang or leave a trace, on demand."""

import ctypes
import faulthandler
import os
import resource
import signal
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from service.base.errors import WorkerFailure
from service.processing.worker_process import WarmUp, worker_boundary

TRACEBACK = """Traceback (most recent call last):
  File "/opt/stonefall/service/worker_job.py", line 1, in measure
FileNotFoundError: 3 mm/s: '/run/stonefall/7/mesh.ply'
"""

MEMORY_BYTES = 1 << 30
"""What a job that hogs memory gets of it."""

GREETING: list[str] = []


def prepare(context: str) -> list[WarmUp]:
    if context == "die":
        os._exit(7)
    GREETING.append(context)
    return []


def share(notes: Path) -> list[WarmUp]:
    if (notes / "broken").exists():
        os._exit(7)
    while (notes / "hold").exists():
        time.sleep(0.01)
    return [partial(compile_once, notes, part) for part in ("a", "b", "c")]


def compile_once(notes: Path, part: str) -> bool:
    """Compile what no process has; two at the same time would fail."""
    kept, begun = notes / part, notes / f"{part}.begun"
    if kept.exists():
        return False
    begun.touch(exist_ok=False)
    time.sleep(0.1)
    kept.touch()
    return True


def greeting_and_pid(name: str) -> tuple[str, int]:
    return f"{GREETING[0]} {name}", os.getpid()


@dataclass(frozen=True)
class Stumble:
    """Fail in the given way as long as fewer than `failures` attempts were noted in the `notes` folder."""

    notes: Path
    way: str
    failures: int


def stumble(job: Stumble) -> str:
    attempt = len(list(job.notes.iterdir()))
    (job.notes / f"{attempt}-{os.getpid()}").touch()
    if attempt < job.failures:
        if job.way == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if job.way == "crash":
            faulthandler.disable()  # pytest's would print its traceback
            ctypes.string_at(0)
        if job.way == "hang":
            time.sleep(60)
        if job.way == "loop":
            while True:  # in the interpreter: no call that a signal would interrupt
                pass
        if job.way == "hog":
            resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
            with worker_boundary():
                hoard = []
                while True:
                    hoard.append(bytearray(MEMORY_BYTES // 16))
        if job.way == "no file":
            resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))
            with worker_boundary():
                job.notes.joinpath("one too many").open("w")
        raise WorkerFailure(TRACEBACK)
    return "done"


def stay() -> None:
    time.sleep(60)


def wait_for(path: Path) -> int:
    while not path.exists():
        time.sleep(0.01)
    return os.getpid()
