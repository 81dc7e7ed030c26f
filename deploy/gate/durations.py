"""Durations of a run: kept in `.cache/durations.json`, printed as tables, and bounded for quick tests."""

import json
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from gate.steps import N_PROCESSES, Extent, Ran

FILE = Path(".cache/durations.json")
N_LONGEST = 10
LIMIT_S = 10.0
"""Longest call, or set-up, of a quick test that has a processor to itself."""
LONGER = {
    **{
        f"tests/live/test_live_equals_replay.py::test_outcomes_and_measured_numbers_are_equal[{rig}]": (
            "its set-up plays a whole recording to a daemon through sixteen cameras"
        )
        for rig in ("cameras wait", "in the air")
    },
    "tests/daemon/test_daemon_crash.py::test_after_a_kill_the_next_daemon_measures_what_lay_in_the_spool_once": (
        "three daemons after one another"
    ),
}
"""Quick tests that may take longer, with the reason."""
REFERENCE_GFLOPS = 100.0
"""Speed of one processor of the machine that `LIMIT_S` is meant for; a machine that is slower now has more time."""
PROBE_S = 0.5
PROBE_N = 512


@dataclass(slots=True)
class Times:
    """Durations of one test; its set-up includes that of fixtures which later tests share."""

    setup_s: float = 0.0
    call_s: float = 0.0
    teardown_s: float = 0.0
    outcome: str = "passed"

    @property
    def whole_s(self) -> float:
        return self.setup_s + self.call_s + self.teardown_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Durations:
    """All that is kept of a run."""

    utc: str
    extent: Extent
    wall_s: float
    processor_s: float
    """Processor seconds of the whole machine meanwhile; a step's own lack processes that it has not waited for."""
    gflops: float
    """Slowest of one processor before, amid and after the run, in GFLOP/s."""
    steps: dict[str, tuple[float, float]]
    """Name of each step -> wall and processor seconds."""
    tests: dict[str, Times] = field(default_factory=dict)


def gflops() -> float:
    """Measure the speed of one processor in a product of matrices, in GFLOP/s, under the present load."""
    a = np.ones((PROBE_N, PROBE_N), np.float32)
    with threadpool_limits(1):
        n_products, start_s = 0, time.monotonic()
        while (elapsed_s := time.monotonic() - start_s) < PROBE_S:
            a @ a
            n_products += 1
    return 2 * PROBE_N**3 * n_products / elapsed_s / 1e9


def busy_s() -> float:
    """Return for how long the processors of this machine have worked since its start (proc_stat(5))."""
    _, user, nice, system, _, _, irq, softirq, *_ = Path("/proc/stat").read_text().partition("\n")[0].split()
    return sum(map(int, (user, nice, system, irq, softirq))) / os.sysconf("SC_CLK_TCK")


def read_reports(paths: Iterable[Path]) -> dict[str, Times]:
    """Return the times of all tests in files of pytest-reportlog, of those as well that a run has not ended."""
    tests: dict[str, Times] = {}
    for path in paths:
        whole, _, _ = path.read_text().rpartition("\n") if path.exists() else ("", "", "")
        for line in whole.splitlines():
            report = json.loads(line)
            if report["$report_type"] == "TestReport":
                times = tests.setdefault(report["nodeid"], Times())
                setattr(times, f"{report['when']}_s", round(report["duration"], 3))
                if report["outcome"] != "passed":
                    times.outcome = report["outcome"]
    return tests


def keep(durations: Durations) -> None:
    """Write `FILE`, whole or not at all."""
    unfinished = FILE.with_suffix(".tmp")
    unfinished.write_text(json.dumps(asdict(durations), indent=1))
    unfinished.replace(FILE)


def kept() -> Durations | None:
    """Read `FILE`; None if there is none that can be read."""
    try:
        document: dict[str, Any] = json.loads(FILE.read_text())
        tests = {name: Times(**times) for name, times in document.pop("tests").items()}
        return Durations(**document, tests=tests)
    except (OSError, ValueError, TypeError, KeyError):
        return None


def tables(durations: Durations) -> Iterator[str]:
    """Yield the lines that say where the minutes went."""
    yield f"{'step':<10} {'wall s':>7} {'processor s':>12}"
    for name, (wall_s, processor_s) in durations.steps.items():
        yield f"{name:<10} {wall_s:7.0f} {processor_s:12.0f}"
    times = durations.tests.values()
    yield (
        f"tests: {len(times)}, their calls {sum(each.call_s for each in times):.0f} s, set-up of fixtures"
        f" {sum(each.setup_s for each in times):.0f} s, their end {sum(each.teardown_s for each in times):.0f} s"
    )
    folders: dict[str, list[float]] = {}
    for name, each in durations.tests.items():
        sums = folders.setdefault(
            "/".join(Path(name.partition("::")[0]).parts[:3]).removesuffix(".py"), [0, 0, 0]
        )
        for i, seconds in enumerate((1, each.setup_s, each.call_s + each.teardown_s)):
            sums[i] += seconds
    yield f"{'folder':<36} {'tests':>6} {'set-up s':>9} {'rest s':>7}"
    for folder, (n_tests, setup_s, rest_s) in sorted(folders.items(), key=lambda entry: -sum(entry[1][1:]))[
        :N_LONGEST
    ]:
        yield f"{folder:<36} {n_tests:6.0f} {setup_s:9.0f} {rest_s:7.0f}"
    yield "the longest tests, with set-up, call and end in s:"
    longest = sorted(durations.tests.items(), key=lambda entry: -entry[1].whole_s)[:N_LONGEST]
    for name, each in longest:
        yield f"{each.setup_s:7.1f} {each.call_s:6.1f} {each.teardown_s:6.1f}  {name}"


def too_long(durations: Durations) -> list[str]:
    """Return a complaint for each quick test above the limit, and for each exception without a test."""
    # share of a processor that each process of the sessions has
    share = min(1.0, (os.cpu_count() or 1) / N_PROCESSES)
    limit_s = LIMIT_S / share * max(1.0, REFERENCE_GFLOPS / durations.gflops)
    wrong = [
        f"{name} took {max(each.setup_s, each.call_s):.1f} s, longer than {limit_s:.0f} s: make it shorter, mark it"
        " `full`, or name it with the reason in deploy/gate/durations.py"
        for name, each in durations.tests.items()
        if max(each.setup_s, each.call_s) > limit_s and name not in LONGER
    ]
    return wrong + [
        f"{name} may take longer, and does not exist" for name in LONGER if name not in durations.tests
    ]


def summed(ran: Sequence[Ran]) -> dict[str, tuple[float, float]]:
    """Return wall and processor seconds of steps by name."""
    return {each.step.name: (round(each.wall_s, 1), round(each.processor_s, 1)) for each in ran}
