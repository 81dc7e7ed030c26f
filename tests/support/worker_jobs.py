"""Jobs for the worker pool that run, crash, hang or leave a trace, on demand."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from service.errors import WorkerFailure

TRACEBACK = """Traceback (most recent call last):
  File "/opt/stonefall/service/worker_job.py", line 1, in measure
FileNotFoundError: 3 mm/s: '/run/stonefall/7/mesh.ply'
"""

GREETING: list[str] = []


def initialize(context: str, number: int) -> bool:
    if context == "die":
        os._exit(7)
    GREETING.append(context)
    return False


def compile_once(notes: Path, number: int) -> bool:
    """Compile only what no earlier process of this number has."""
    (notes / f"{number}-{os.getpid()}").touch()
    return len(list(notes.glob(f"{number}-*"))) == 1


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
        if job.way == "hang":
            time.sleep(60)
        raise WorkerFailure(TRACEBACK)
    return "done"


def stay(_: None) -> None:
    time.sleep(60)
