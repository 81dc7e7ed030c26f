"""Measure how late bundles are complete while computation wants all cores, by the priority that the daemon has.

Run as root: .venv/bin/python tests/benchmarks/priorities.py [--seconds 15] [--rate 4] [--foreign 8]

Sixteen simulated GigE cameras on loopback, whose own processor time is guaranteed. Calm: workers with little to do.
Loaded: workers that never catch up, and `--foreign` processes in sessions of their own that never wait. The unit's
priorities are taken from it and its slice: `Nice=` by nice(1), `CPUWeight=` by a control group beside that of the
foreign processes, as the slices of systemd lie side by side.
Exits with 1 if a bundle with the unit's priorities lacks a frame.
"""

import argparse
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.daemon_process import DaemonProcess
from support.eventually import eventually
from support.printed import show
from support.simulator_process import SimulatorProcess
from support.stone_recording import write_stones
from support.usage import percentiles

ROOT = Path(__file__).parents[2]
UNIT, SLICE = ROOT / "systemd/stonefall.service", ROOT / "systemd/stonefall.slice"
PROBE = ROOT / "tests/support/capture_probe.py"
CPU_GROUPS = next(
    (
        path
        for path in map(Path, ("/sys/fs/cgroup/cpu", "/sys/fs/cgroup"))
        if (path / "cgroup.procs").exists()
    ),
    None,
)
ADDRESS = "127.45.0.2"
N_STONES = 10
DEFAULT_WEIGHT, LARGEST_WEIGHT = 100, 10_000
IN_GROUP = 'echo $$ > "$0" && exec "$@"'
SPIN = "while True: pass"
N_CAMERAS = 16


@dataclass(frozen=True, kw_only=True)
class Condition:
    """What the daemon has to do, and which priority it has for that."""

    name: str
    is_loaded: bool
    nice: int = 0
    weight: int | None = None  # None: no control group


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of the stones under a condition."""

    latency_ms: list[float]  # from the edge of the gate to the complete bundle
    incomplete: int
    loop_ms: float  # longest hold-up of the event loop


def setting(path: Path, name: str) -> int:
    """Return a number that a unit sets."""
    (found,) = re.findall(rf"^{name}=(-?\d+)$", path.read_text(), re.M)
    return int(found)


def conditions() -> list[Condition]:
    nice, weight = setting(UNIT, "Nice"), setting(SLICE, "CPUWeight")
    return [
        Condition(name="calm, the unit", is_loaded=False, nice=nice, weight=weight),
        Condition(name="loaded, no priorities", is_loaded=True),
        Condition(name="loaded, Nice= of the unit alone", is_loaded=True, nice=nice),
        Condition(name="loaded, the unit and its slice", is_loaded=True, nice=nice, weight=weight),
    ]


@contextmanager
def cpu_group(name: str, weight: int) -> Iterator[Path]:
    """Make a control group and yield the file that takes its processes; its processes must have ended at the end."""
    if CPU_GROUPS is None:
        sys.exit("there are no control groups for the processor")
    group = CPU_GROUPS / f"stonefall-bench-{name}"
    group.mkdir()
    try:
        if (group / "cpu.weight").exists():
            (group / "cpu.weight").write_text(str(weight))
        else:
            (group / "cpu.shares").write_text(str(1024 * weight // DEFAULT_WEIGHT))
        yield group / "cgroup.procs"
    finally:
        eventually(lambda: not (group / "cgroup.procs").read_text())  # who lost the daemon is ending
        group.rmdir()


@contextmanager
def foreign_load(count: int, processes: Path) -> Iterator[None]:
    """Let processes compute that have nothing to do with the daemon, each in a session and all in a control group."""
    command = ["sh", "-c", IN_GROUP, processes, sys.executable, "-c", SPIN]
    spinning = [subprocess.Popen(command, start_new_session=True) for _ in range(count)]
    try:
        yield
    finally:
        for process in spinning:
            process.kill()
            process.wait()


def measure(
    condition: Condition, folder: Path, simulator: SimulatorProcess, arguments: argparse.Namespace
) -> Outcome:
    """Let stones fall under a condition."""
    own, load = folder / "daemon", arguments.foreign if condition.is_loaded else 0
    notes = own / "bundles"
    own.mkdir()
    with (
        cpu_group("foreign", DEFAULT_WEIGHT) as foreign,
        cpu_group("daemon", condition.weight or DEFAULT_WEIGHT) as group,
        tempfile.TemporaryDirectory(dir="/dev/shm") as spool,
        DaemonProcess(
            own,
            own,
            rig=simulator.section,
            voxels=512 if condition.is_loaded else 64,
            body="photo" if condition.is_loaded else "hull",
            max_bundles=arguments.queue,
            spool=spool,
            store="keep_raw = 0",
            slots=2,
            command=(
                *("sh", "-c", IN_GROUP, group if condition.weight else "/dev/null"),
                *("nice", "-n", str(condition.nice), sys.executable, PROBE, notes),
            ),
        ) as daemon,
    ):
        daemon.hear("READY=1")
        daemon.wait_for("/acquisition", lambda now: now["cameras_armed"] == N_CAMERAS)
        daemon.wait_for("/accounting", lambda now: now["backgrounds"] == 2)
        with foreign_load(load, foreign if condition.weight else Path("/dev/null")):
            simulator.ask({"do": "start"})
            time.sleep(arguments.seconds)
            loop_ms = daemon.get("/health")["checks"]["loop"]["observed_value"]
            simulator.ask({"do": "stop"})
            time.sleep(1)
        lines = [line.split() for line in notes.read_text().splitlines()]
    return Outcome(
        latency_ms=[float(waited_ms) for waited_ms, _ in lines],
        incomplete=sum(int(count) < N_CAMERAS for _, count in lines),
        loop_ms=loop_ms,
    )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=15, help="of stones under each condition")
    parser.add_argument("--rate", type=float, default=4, help="stones a second")
    parser.add_argument("--foreign", type=int, default=8, help="processes that compute beside the daemon")
    parser.add_argument(
        "--queue", type=int, default=60, help="bundles that may wait; more are lost, after they are complete"
    )
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    table = Table(
        "",
        *("stones", "edge to complete bundle, ms: p50, p95, p99, max", "incomplete", "loop, ms"),
        title=f"{arguments.seconds:g} s each, {arguments.rate:g} stones/s, {arguments.foreign} foreign processes",
    )
    outcomes = {}
    with tempfile.TemporaryDirectory() as name:
        recording = Path(name) / "recording"
        write_stones(recording, "angular", size_mm=25, n_stones=N_STONES, n_empty=2, seed=11)
        for number, condition in enumerate(conditions()):
            folder = Path(name) / str(number)
            folder.mkdir()
            with (
                cpu_group("simulator", LARGEST_WEIGHT) as group,
                SimulatorProcess(folder, recording, rate_hz=arguments.rate, address=ADDRESS) as simulator,
            ):
                group.write_text(str(simulator.process.pid))
                outcomes[condition] = outcome = measure(condition, folder, simulator, arguments)
            cells = percentiles(outcome.latency_ms), str(outcome.incomplete), f"{outcome.loop_ms:.0f}"
            table.add_row(condition.name, str(len(outcome.latency_ms)), *cells)
    show(table, as_json=arguments.json, width=130)
    return int(any(outcome.incomplete for condition, outcome in outcomes.items() if condition.weight))


if __name__ == "__main__":
    sys.exit(main())
