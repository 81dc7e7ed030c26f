"""Run the daemon on a recording at several rates and report losses and delays of results.

Run: .venv/bin/python tests/benchmarks/sustained.py [--rates 4,10,20] [--seconds 60] [--burst 20] [--burst-seconds 10]
     [--size-mm 25] [--stones 20] [--keep-raw 200] [--record 0] [--body estimate] [--slots 2] [--queue 100]
     [--recording DIR] [--bridge] [--json]

Stones are rendered first; with `--recording` they are kept there for the next run. `--record` also records that many
bundles live; with `--bridge` the bridge runs beside, with all outlets whose packages are there. Stones fall in rounds
of 60, a little closer than the rate says, with an exposure of the empty rig before each round. A trigger's time is when
it appeared in the store, or earlier if the recording's own pace says so; a result is durable when it appears in the
store. Exits with 1 if a stone is lost at up to ten a second or in the burst, results are later than the goal, or a call
in the daemon holds the interpreter's lock for more than 20 ms.
"""

import argparse
import json
import os
import sqlite3
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import closing, nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.daemon_process import DaemonProcess
from support.lock_probe import LONG_S, waits_ms
from support.printed import show
from support.stone_recording import ROUND_GAP_S, write_paced, write_stones
from support.usage import cpu_s, own_mb, percentiles, rss_mb

from drivers.files.recording import Recording, open_recording, read_bundle
from pipeline.synthesis.bundles import (
    TRIGGER_DELAY_NS,
)
from service.commands.rehearsal.rehearsed_bridge import rehearsed_bridge

SEED = 12
REQUIRED_HZ = 10.0
"""Rate that two cores must keep up with for any time."""
REQUIRED_MS = 500.0
"""Goal for the 99th percentile of the time from exposure to durable result."""
RIG = """pace = "recorded"
loop = true
[bundling]
window_ms = {window_ms:.0f}
dead_time_ms = {dead_time_ms:.0f}
"""
"""Bundling for triggers closer than 220 ms; a live rig with them needs cameras that are not busy while they wait."""
LOCK_PROBE = Path(__file__).parents[1] / "support/lock_probe.py"
LOCK_WAITS = "lock-waits"
LOOK_S = 0.01
"""Interval at which the store is asked for new triggers and results."""
SAMPLE_S = 1.0
DRAIN_S = 600.0
"""Longest wait for bundles in the queue at the end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """Figures of a daemon at one rate."""

    name: str
    rate_hz: float
    is_required: bool  # whether it must lose nothing and be in time
    counts: dict[str, Any]
    sustained_hz: float  # results between the first and the last
    latency_ms: list[float]  # from the exposure to the durable result, in the order of the triggers
    worker_ms: list[float]  # of each bundle, in its worker
    waiting: int  # triggers without a result, at most
    loop_ms: float  # longest hold-up of the event loop
    cores: dict[str, float]  # of daemon and workers
    memory_mb: dict[str, list[float]]
    recorded: str
    bodies: dict[str, int]  # results by the body that was measured
    kept: int  # results whose frames are archived, or were until newer ones came
    lock_ms: float  # longest wait for the interpreter's lock in the daemon, without the wait for a core

    @property
    def problems(self) -> list[str]:
        if not self.is_required:
            return []
        return [
            problem
            for problem, is_so in {
                "the accounts do not add up": not self.counts["is_balanced"] or self.counts["in_progress"],
                f"{self.counts['lost']} stones were lost": self.counts["lost"],
                "results come too late": np.quantile(self.latency_ms or [0.0], 0.99) > REQUIRED_MS
                and self.rate_hz <= REQUIRED_HZ,
                "a call held the interpreter's lock too long": self.lock_ms > 1000 * LONG_S,
            }.items()
            if is_so
        ]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rates", default="4,10,20", help="stones a second; each rate runs for --seconds")
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--burst", type=float, default=20, help="stones a second; 0: no burst")
    parser.add_argument("--burst-seconds", type=float, default=10)
    parser.add_argument("--size-mm", type=float, default=25)
    parser.add_argument("--stones", type=int, default=20, help="number of different stones")
    parser.add_argument("--keep-raw", type=int, default=200, help="number of stones whose frames are kept")
    parser.add_argument("--record", type=int, default=0, help="number of bundles to record live")
    parser.add_argument("--body", default="photo", help="hull, estimate or photo")
    parser.add_argument("--slots", type=int, default=2)
    parser.add_argument("--queue", type=int, default=100, help="bundles that may wait")
    parser.add_argument("--recording", type=Path)
    parser.add_argument("--bridge", action="store_true")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--out", type=Path, help="JSON of all runs, which tests/benchmarks/plots.py draws")
    arguments = parser.parse_args()
    plan = [
        (f"{float(rate):g}/s", float(rate), arguments.seconds) for rate in arguments.rates.split(",") if rate
    ]
    if arguments.burst:
        plan.append((f"burst of {arguments.burst:g}/s", arguments.burst, arguments.burst_seconds))
    with tempfile.TemporaryDirectory() as name:
        path = arguments.recording or Path(name) / "stones"
        if not path.exists():
            write_stones(
                path, "angular", size_mm=arguments.size_mm, n_stones=arguments.stones, n_empty=1, seed=SEED
            )
        recording = open_recording(path)
        runs = [played(recording, run_name, rate_hz, s, arguments) for run_name, rate_hz, s in plan]
        read_ms = 1000 * float(np.median([seconds_to_read(recording) for _ in range(5)]))
    if arguments.out is not None:
        arguments.out.write_text(json.dumps([asdict(run) for run in runs], indent=1))
    show(table_of(runs, read_ms, arguments), as_json=arguments.json)
    for run in runs:
        for problem in run.problems:
            Console(stderr=True).print(f"FAILED: {run.name}: {problem}")
    return int(any(run.problems for run in runs))


@dataclass(slots=True)
class Watched:
    """Times at which triggers and results appeared in the store, by their numbers."""

    triggers_s: dict[int, float] = field(default_factory=dict)
    results_s: dict[int, float] = field(default_factory=dict)

    def look(self, store: Path, is_over: threading.Event) -> None:
        with closing(sqlite3.connect(f"file:{store}?mode=ro", uri=True)) as connection:
            while not is_over.wait(LOOK_S):
                last_trigger, last_seq = connection.execute(
                    "SELECT (SELECT coalesce(max(trigger), 0) FROM triggers), last_seq FROM store"
                ).fetchone()
                now_s = time.monotonic()
                for known, last in ((self.triggers_s, last_trigger), (self.results_s, last_seq)):
                    known.update(dict.fromkeys(range(len(known) + 1, last + 1), now_s))


def played(recording: Recording, name: str, rate_hz: float, seconds: float, arguments: Any) -> Run:
    """Run a daemon from its start to the last result; return its figures."""
    with tempfile.TemporaryDirectory() as folder_name, tempfile.TemporaryDirectory(dir="/dev/shm") as spool:
        folder = Path(folder_name)
        due_s = write_paced(folder / "recording", recording, rate_hz)
        apart_ms = 1000 * min(due_s[1], ROUND_GAP_S)
        with DaemonProcess(
            folder,
            folder / "recording",
            rig=RIG.format(window_ms=0.4 * apart_ms, dead_time_ms=0.9 * apart_ms),
            voxels=256,
            body=arguments.body,
            spool=spool,
            store=f"keep_raw = {arguments.keep_raw}",
            slots=arguments.slots,
            max_bundles=arguments.queue,
            command=(sys.executable, LOCK_PROBE, folder / LOCK_WAITS),
        ) as daemon:
            daemon.hear("READY=1")
            url = daemon.url("").removesuffix("/api/v1")
            bridge = rehearsed_bridge(folder, url) if arguments.bridge else nullcontext()
            (folder / LOCK_WAITS).touch()
            watched, is_over = Watched(), threading.Event()
            store = folder / "state/results.sqlite"
            watching = threading.Thread(target=watched.look, args=(store, is_over))
            watching.start()
            try:
                with bridge:
                    samples = watch(daemon, seconds, arguments.record)
                    daemon.wait_for("/accounting", lambda now: now["in_progress"] == 0, timeout_s=DRAIN_S)
            finally:
                time.sleep(10 * LOOK_S)
                is_over.set()
                watching.join()

            return run_of(daemon, name, rate_hz, watched, samples, due_s, arguments)


def watch(daemon: DaemonProcess, seconds: float, n_recorded: int) -> list[dict[str, Any]]:
    """Let stones fall for `seconds`, then disarm; return a sample of the daemon for each second."""
    if n_recorded:
        daemon.post("/recordings", {"name": "benchmark", "count": n_recorded})
    samples = [sample(daemon)]
    begin_s = time.monotonic()
    while time.monotonic() - begin_s < seconds:
        time.sleep(min(SAMPLE_S, max(0.0, seconds - (time.monotonic() - begin_s))))
        samples.append(sample(daemon))
    daemon.put("/acquisition", {"state": "disarmed"})
    return samples


def sample(daemon: DaemonProcess) -> dict[str, Any]:
    pid, workers = daemon.process.pid, daemon.worker_pids()
    return {
        "at_s": time.monotonic(),
        "loop_ms": daemon.get("/health")["checks"]["loop"]["observed_value"],
        "cpu_s": {"daemon": {pid: cpu_s([pid])}, "workers": {worker: cpu_s([worker]) for worker in workers}},
        "rss_mb": {"daemon": [rss_mb(pid)], "workers": [rss_mb(worker) for worker in workers]},
        "own_mb": {"workers": [own_mb(worker) for worker in workers]},
    }


def run_of(
    daemon: DaemonProcess,
    name: str,
    rate_hz: float,
    watched: Watched,
    samples: Sequence[dict[str, Any]],
    due_s: NDArray[np.float64],
    arguments: Any,
) -> Run:
    with closing(sqlite3.connect(daemon.folder / "state/results.sqlite")) as connection:
        rows = connection.execute("SELECT seq, trigger, record FROM results ORDER BY seq").fetchall()
    seen_s = np.array(list(watched.triggers_s.values()))
    round_of, position = np.divmod(np.arange(len(seen_s)), len(due_s) - 1)
    schedule_s = round_of * due_s[-1] + due_s[position]
    # a trigger came no later than the next ones less the scheduled time between: a held-up loop hides no delay
    triggered_s = np.minimum.accumulate((seen_s - schedule_s)[::-1])[::-1] + schedule_s
    ended_s = np.array([watched.results_s[seq] for seq, _, _ in rows])
    begun_s = np.array([triggered_s[trigger - 1] for _, trigger, _ in rows])
    records = [json.loads(record) for _, _, record in rows]
    first, last = samples[0], samples[-1]
    span_s = last["at_s"] - first["at_s"]
    recording = daemon.get("/recordings")["items"] if arguments.record else []
    return Run(
        name=name,
        rate_hz=rate_hz,
        is_required=rate_hz <= REQUIRED_HZ or name.startswith("burst"),
        counts=daemon.get("/accounting"),
        sustained_hz=float((len(rows) - 1) / np.ptp(ended_s)) if len(rows) > 1 else 0.0,
        latency_ms=list(1000 * (ended_s - begun_s) - TRIGGER_DELAY_NS / 1e6),
        worker_ms=[record["timings_ms"]["total"] for record in records if record["timings_ms"]],
        waiting=int(max(((begun_s <= end_s) & (ended_s >= end_s)).sum() for end_s in ended_s))
        if len(rows)
        else 0,
        loop_ms=max(each["loop_ms"] for each in samples),
        cores={part: busy_s(samples, part) / span_s for part in ("daemon", "workers")},
        memory_mb={
            "daemon": last["rss_mb"]["daemon"],
            "workers": last["rss_mb"]["workers"],
            "workers, their own": last["own_mb"]["workers"],
        },
        bodies=dict(Counter(json.loads(record).get("body") or "none" for _, _, record in rows)),
        kept=len(rows) - daemon.get("/health")["checks"]["archive"]["observed_value"],
        lock_ms=max(waits_ms(daemon.folder / LOCK_WAITS, since_s=first["at_s"]), default=0.0),
        recorded=", ".join(f"{each['state']} {each['bundles']}" for each in recording) or "-",
    )


def busy_s(samples: Sequence[dict[str, Any]], part: str) -> float:
    """Return the processor time between the first and the last sample, with processes that came or went meanwhile."""
    before, latest = samples[0]["cpu_s"][part], {}
    for each in samples:
        latest |= each["cpu_s"][part]
    return sum(seconds - before.get(pid, 0.0) for pid, seconds in latest.items())


def table_of(runs: Sequence[Run], read_ms: float, arguments: Any) -> Table:
    table = Table(
        "",
        *(run.name for run in runs),
        title=f"{arguments.seconds:g} s each, burst {arguments.burst_seconds:g} s; {arguments.stones} stones"
        f" of {arguments.size_mm:g} mm again and again, {arguments.slots} workers, frames of {arguments.keep_raw} kept;"
        f" load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
        caption=f"Speed of the host: reading and checking a bundle took {read_ms:.0f} ms afterwards.",
    )
    for label, cells in {
        "triggers = measured + rejected + lost": [
            "{triggers} = {measured} + {rejected} + {lost}".format(**run.counts) for run in runs
        ],
        "by reason": [str(run.counts["by_reason"] or "") for run in runs],
        "results/s": [f"{run.sustained_hz:.2f}" for run in runs],
        "exposure to durable result, ms: p50, p95, p99, max": [percentiles(run.latency_ms) for run in runs],
        "in the worker, ms: p50, p95, p99, max": [percentiles(run.worker_ms) for run in runs],
        "triggers without a result, at most": [str(run.waiting) for run in runs],
        "longest hold-up of the loop, ms": [f"{run.loop_ms:.0f}" for run in runs],
        "longest wait for the interpreter's lock, ms": [f"{run.lock_ms:.0f}" for run in runs],
        "bodies": [", ".join(f"{n} {body}" for body, n in run.bodies.items()) for run in runs],
        "results with their frames": [f"{run.kept} of {len(run.latency_ms)}" for run in runs],
        "cores used by daemon, workers": [
            f"{run.cores['daemon']:.2f}, {run.cores['workers']:.2f}" for run in runs
        ],
        **{
            f"memory of {part}, MB": [", ".join(f"{mb:.0f}" for mb in run.memory_mb[part]) for run in runs]
            for part in runs[0].memory_mb
        },
        "recorded": [run.recorded for run in runs],
    }.items():
        table.add_row(label, *cells)
    return table


def seconds_to_read(recording: Recording) -> float:
    start_s = time.process_time()
    read_bundle(recording.headers[-1].path, recording.camera_ids)
    return time.process_time() - start_s


if __name__ == "__main__":
    sys.exit(main())
