"""Time the start of the daemon until READY: with nothing compiled yet, and with what the first start kept.

Run: .venv/bin/python tests/benchmarks/start.py [--slots 2] [--repeat 3] [--segmenter auto|onnx|background]
Compiled code is kept in a folder of its own (`NUMBA_CACHE_DIR`). Also prints how long each module compiles.

Exits with 1 if a start takes longer than its limit.
"""

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, get_args

from numba.core.event import Event, Listener, install_listener
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from research.performance import worker_context
from support.daemon_process import STONEFALL, DaemonProcess, descendants_of
from support.printed import show
from support.small_recording import write_small_recording
from support.usage import cpu_s, own_mb, rss_mb

from pipeline.segmentation.segmenter_choice import SegmenterKind
from service.processing.measure_job import initialize

COLD_S, WARM_S = 20.0, 5.0
"""Limits of a start with nothing compiled, and of one with everything compiled."""
PATIENCE_S = 600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    ready_s: float  # by the clock
    cpu_s: float  # processor time of the daemon and its workers until then
    memory_mb: Sequence[float]  # of daemon and workers
    own_mb: Sequence[float]  # the part of it that is not shared


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--slots", type=int, default=2)
    parser.add_argument("--repeat", type=int, default=3, help="warm starts")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--segmenter", choices=get_args(SegmenterKind), default="auto")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["NUMBA_CACHE_DIR"] = str(folder / "compiled apart")
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
            compiled_s = process.submit(compile_all).result()
        os.environ["NUMBA_CACHE_DIR"] = str(folder / "compiled")
        write_small_recording(folder / "recording", n_stones=1)
        cold = start(folder, arguments)
        warm = [start(folder, arguments) for _ in range(arguments.repeat)]
    table = Table(
        "", "ready after s", "of the processors, s", "memory of daemon, workers, MB", "of it their own",
        title=f"{arguments.slots} workers; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
    )  # fmt: skip
    for label, each in [("cold", cold), *(("warm", each) for each in warm)]:
        table.add_row(
            label,
            f"{each.ready_s:.1f}",
            f"{each.cpu_s:.1f}",
            ", ".join(f"{mb:.0f}" for mb in each.memory_mb),
            ", ".join(f"{mb:.0f}" for mb in each.own_mb),
        )
    show(table, as_json=arguments.json, width=110)
    modules = ", ".join(f"{name} {seconds:.1f}" for name, seconds in compiled_s.most_common())
    Console(stderr=True).print(
        f"compiled in {compiled_s.total():.1f} s of the processor: {modules}", highlight=False
    )
    return int(cold.ready_s > COLD_S or median(each.ready_s for each in warm) > WARM_S)


class Compilations(Listener):
    """Processor seconds of compiling by module; functions that are compiled for another one count for their own."""

    def __init__(self) -> None:
        self.by_module: Counter[str] = Counter()
        self._open: list[
            tuple[float, float]
        ] = []  # when each began, and the time of nested compilations since

    def on_start(self, event: Event) -> None:
        self._open.append((time.process_time(), 0.0))

    def on_end(self, event: Event) -> None:
        begun_s, others_s = self._open.pop()
        elapsed_s = time.process_time() - begun_s
        self.by_module[event.data["dispatcher"].py_func.__module__] += elapsed_s - others_s
        if self._open:
            self._open[-1] = (self._open[-1][0], self._open[-1][1] + elapsed_s)


def compile_all() -> Counter[str]:
    """Prepare this process as a worker; return the seconds that each module compiled."""
    seen = Compilations()
    with install_listener("numba:compile", seen):
        initialize(worker_context())
    return seen.by_module


def start(folder: Path, arguments: Any) -> Start:
    begin_s = time.monotonic()
    with DaemonProcess(
        folder,
        folder / "recording",
        segmentation=f'segmenter = "{arguments.segmenter}"',
        voxels=256,
        slots=arguments.slots,
        command=(STONEFALL,),
    ) as daemon:
        daemon.hear("READY=1", timeout_s=PATIENCE_S)
        ready_s = time.monotonic() - begin_s
        pids = [daemon.process.pid, *daemon.worker_pids()]
        all_pids = [daemon.process.pid, *descendants_of(daemon.process.pid)]
        return Start(
            ready_s=ready_s,
            cpu_s=cpu_s(all_pids, with_ended_children=True),
            memory_mb=[rss_mb(pid) for pid in pids],
            own_mb=[own_mb(pid) for pid in pids],
        )


if __name__ == "__main__":
    sys.exit(main())
