"""Let stones fall at a steady rate through the whole live chain, beside a client, and see whether anything grows.

    .venv/bin/python tests/soak/steady.py [--minutes 20] [--rate 4] [--size-mm 5] [--keep-raw 50] [--small]

Sixteen simulated GigE cameras and a light gate in a process of their own, the daemon on the real Aravis driver, and a
client that follows the feed and asks for health every second. Memory (PSS), descriptors and threads of the daemon and
all its processes are sampled every ten seconds, in short runs more often. Times are from the trigger, 247 ms before the
exposure, to the durable result.

A quantity GROWS when the line through its samples (the median of all slopes), from the first quarter on, rises by more
than it may: 30 MB, 5 descriptors, 5 threads. Exits with 1 if one does, if a stone is lost, or if what the simulated
belt counted has not exactly one outcome each.
"""

import argparse
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

if __package__ is None:
    sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2])]

from support.daemon_process import STONEFALL, DaemonProcess, descendants_of
from support.simulator_process import SimulatorProcess
from support.small_recording import write_small_recording
from support.stone_recording import write_stones
from support.usage import n_descriptors, n_threads, percentiles, pss_mb, rss_mb

from service.results.fields import Outcome

SAMPLE_S = 10.0
MIN_SAMPLES = 24
HEALTH_S = 1.0
SETTLE_S = 2.0
DRAIN_S = 300.0
MAX_RISE = {"memory, MB (PSS)": 30.0, "descriptors": 5.0, "threads": 5.0}
"""By how much a quantity may rise from the first quarter to the end."""
SEED = 13


@dataclass(frozen=True, slots=True)
class Trend:
    """How a quantity moves over the run, its first quarter left out: that is the warm-up."""

    values: Sequence[float]  # at even times
    seconds: float  # from the first to the last
    max_rise: float

    @property
    def slope_per_s(self) -> float:
        """The median of the slopes between all pairs of samples: no single one decides."""
        steady = list(enumerate(self.values))[len(self.values) // 4 :]
        step_s = self.seconds / max(len(self.values) - 1, 1)
        slopes = [(late - early) / (j - i) / step_s for (i, early), (j, late) in combinations(steady, 2)]
        return float(np.median(slopes)) if slopes else 0.0

    @property
    def grows(self) -> bool:
        return self.slope_per_s * 0.75 * self.seconds > self.max_rise


@dataclass(frozen=True, slots=True)
class Seen:
    """A result, of which the rest is not kept."""

    key: tuple[int, str]  # session and bundle
    outcome: str
    late_ms: float  # from the trigger to the durable result
    views: int


@dataclass(slots=True)
class Follower:
    """A client that follows the feed and asks for health; `follow` is its thread."""

    daemon: DaemonProcess
    is_over: threading.Event = field(default_factory=threading.Event)
    results: list[Seen] = field(default_factory=list)
    n_not_passed: Counter[str] = field(default_factory=Counter)  # how often a check did not pass
    reasons: dict[str, str] = field(default_factory=dict)  # what each said then, the last time
    failure: str | None = None

    def follow(self) -> None:
        asked_s = 0.0
        try:
            while not self.is_over.is_set():
                self.take()
                if time.monotonic() - asked_s > HEALTH_S:
                    asked_s = time.monotonic()
                    for reason in self.daemon.get("/health")["reasons"]:
                        check, _, detail = reason.partition(": ")
                        self.n_not_passed[check] += 1
                        self.reasons[check] = detail
        except (OSError, ValueError, KeyError, AssertionError) as err:
            self.failure = f"the client failed: {err!r}"

    def take(self, wait_s: int = 1) -> None:
        """Take the next page of the feed."""
        after = len(self.results)
        page = self.daemon.get(f"/results?after={after}&limit=100&wait_s={wait_s}")["items"]
        for number, result in enumerate(page, start=after + 1):
            assert result["seq"] == number, (result["seq"], number)
            self.results.append(_seen(result))


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """What was seen of a run."""

    seconds: float
    fallen: int  # counted by the simulated belt
    counts: dict[str, Any]  # the daemon's accounting
    results: Sequence[Seen]
    n_not_passed: Counter[str]
    reasons: dict[str, str]
    trends: dict[str, Trend]
    rss_mb: Sequence[float]  # of the daemon's own process
    failure: str | None

    @property
    def unbalanced(self) -> list[str]:
        """What does not add up between the belt, the accounting and the feed."""
        counts, n_results = self.counts, len(self.results)
        return [
            problem
            for problem, is_so in {
                f"{self.fallen} stones fell, {counts['triggers']} have a trigger": self.fallen
                != counts["triggers"],
                f"{counts['triggers']} triggers have {n_results} outcomes": n_results != counts["triggers"],
                "a stone has two outcomes": len({result.key for result in self.results}) != n_results,
                "the accounting is not balanced": not counts["is_balanced"] or counts["in_progress"],
                self.failure or "": self.failure is not None,
            }.items()
            if is_so
        ]

    @property
    def problems(self) -> list[str]:
        lost = [f"{self.counts['lost']} stones were lost: {self.counts['by_reason']}"]
        return [
            *self.unbalanced,
            *(lost if self.counts["lost"] else []),
            *(f"{name} GROWS" for name, trend in self.trends.items() if trend.grows),
        ]


def run_steadily(
    folder: Path,
    recording: Path,
    *,
    seconds: float,
    rate_hz: float = 4.0,
    keep_raw: int = 0,
    voxels: int = 256,
) -> Run:
    """Run daemon and rig for so long, and return what was seen."""
    with (
        tempfile.TemporaryDirectory(dir="/dev/shm") as spool,
        SimulatorProcess(folder, recording, rate_hz=rate_hz) as simulator,
        DaemonProcess(
            folder,
            recording,
            rig=simulator.section,
            voxels=voxels,
            spool=spool,
            store=f"keep_raw = {keep_raw}",
            slots=2,
            command=(STONEFALL,),
        ) as daemon,
    ):
        daemon.hear("READY=1")
        daemon.wait_for("/acquisition", lambda now: now["state"] == "armed" and now["cameras_armed"] == 16)
        daemon.wait_for("/accounting", lambda now: now["backgrounds"] == 2)
        follower = Follower(daemon)
        following = threading.Thread(target=follower.follow, name="client")
        following.start()
        try:
            simulator.ask({"do": "start"})
            samples = watch(daemon, follower, seconds)
            simulator.ask({"do": "stop"})
            time.sleep(SETTLE_S)
            counts = daemon.wait_for("/accounting", lambda now: now["in_progress"] == 0, timeout_s=DRAIN_S)
        finally:
            follower.is_over.set()
            following.join()
        while follower.failure is None and len(follower.results) < counts["triggers"]:
            follower.take(wait_s=0)
        fallen = simulator.ask({"do": "counters"})["belt"]["stones"]
        assert daemon.stop() == 0
    return Run(
        seconds=seconds,
        fallen=fallen,
        counts=counts,
        results=follower.results,
        n_not_passed=follower.n_not_passed,
        reasons=follower.reasons,
        trends={
            name: Trend([sample[name] for sample in samples], seconds, max_rise)
            for name, max_rise in MAX_RISE.items()
        },
        rss_mb=[sample["rss"] for sample in samples],
        failure=follower.failure,
    )


def watch(daemon: DaemonProcess, follower: Follower, seconds: float) -> list[dict[str, float]]:
    """Return samples at even times, from the first stone on."""
    begin_s, samples = time.monotonic(), [sample(daemon.process.pid)]
    n_samples = max(MIN_SAMPLES, round(seconds / SAMPLE_S))
    while len(samples) <= n_samples and follower.failure is None:
        due_s = begin_s + len(samples) * seconds / n_samples
        time.sleep(max(0.0, due_s - time.monotonic()))
        samples.append(sample(daemon.process.pid))
    return samples


def sample(pid: int) -> dict[str, float]:
    """Return what the daemon and all its processes take of the machine now."""
    taken = dict.fromkeys(MAX_RISE, 0.0)
    for each in (pid, *descendants_of(pid)):
        try:
            new = (pss_mb(each), n_descriptors(each), n_threads(each))
        except (FileNotFoundError, ProcessLookupError, ValueError):  # it ended meanwhile
            continue
        for name, value in zip(taken, new, strict=True):
            taken[name] += value
    return taken | {"rss": rss_mb(pid)}


def _seen(result: dict[str, Any]) -> Seen:
    triggered, written = (datetime.fromisoformat(result[name]) for name in ("captured_at", "recorded_at"))
    return Seen(
        key=(result["session"], result["bundle"]),
        outcome=result["outcome"],
        late_ms=(written - triggered).total_seconds() * 1000,
        views=len(result["views"]),
    )


def table_of(run: Run) -> Table:
    views = Counter(result.views for result in run.results if result.outcome == Outcome.MEASURED)
    late_ms = [result.late_ms for result in run.results]
    table = Table("", "", title=f"{run.seconds / 60:g} minutes, {run.fallen} stones")
    rows = {
        "stones that fell (simulated belt)": run.fallen,
        "triggers = measured + rejected + lost": "{triggers} = {measured} + {rejected} + {lost}".format(
            **run.counts
        ),
        "by reason": run.counts["by_reason"],
        "stones with so many views": dict(sorted(views.items(), reverse=True)),
        "trigger to durable result, ms: p50, p95, p99, max": percentiles(late_ms),
    }
    quarters = np.array_split(np.array(late_ms), 4)
    for number, quarter in enumerate(quarters, start=1):
        rows[f"    quarter {number}: p50, p99"] = (
            ", ".join(f"{ms:.0f}" for ms in np.quantile(quarter, [0.5, 0.99])) if len(quarter) else "-"
        )
    rows["memory of the daemon's own process, MB (RSS): start, middle, end"] = _start_middle_end(run.rss_mb)
    for name, trend in run.trends.items():
        rows[f"{name}: start, middle, end; slope an hour; may rise by"] = (
            f"{_start_middle_end(trend.values)}; {3600 * trend.slope_per_s:+.1f}; {trend.max_rise:g}:"
            f" {'GROWS' if trend.grows else 'flat'}"
        )
    for check, n_times in run.n_not_passed.most_common():
        rows[f"health, {n_times} polls: {check}"] = run.reasons[check]
    for name, value in rows.items():
        table.add_row(name, str(value))
    return table


def _start_middle_end(values: Sequence[float]) -> str:
    return ", ".join(f"{values[place]:.0f}" for place in (0, len(values) // 2, -1))


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=20)
    parser.add_argument("--rate", type=float, default=4, help="stones a second")
    parser.add_argument("--size-mm", type=float, default=5)
    parser.add_argument("--keep-raw", type=int, default=50, help="stones whose frames are kept")
    parser.add_argument("--small", action="store_true", help="images of a quarter of the size, ready at once")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="steady-") as name:
        folder = Path(name)
        recording = folder / "recording"
        if arguments.small:
            write_small_recording(recording, n_stones=6, n_backgrounds=1)
        else:
            write_stones(recording, "round", size_mm=arguments.size_mm, n_stones=20, n_empty=1, seed=SEED)
        run = run_steadily(
            folder,
            recording,
            seconds=60 * arguments.minutes,
            rate_hz=arguments.rate,
            keep_raw=arguments.keep_raw,
            voxels=64 if arguments.small else 256,
        )
    Console(width=150).print(table_of(run))
    for problem in run.problems:
        Console().print(f"FAILED: {problem}")
    if not run.problems:
        Console().print("flat, and every stone has exactly one outcome")
    return int(bool(run.problems))


if __name__ == "__main__":
    sys.exit(main())
