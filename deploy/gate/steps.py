"""The steps of the gate, in their order, and the running and timing of one."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

BIN = Path(sys.executable).parent
NO_TESTS = 5
"""Exit code of pytest when all selected tests are of a wider extent."""
KEPT = Path(".cache/gate")
"""What each step of the latest run printed, and the reports of its tests."""


class Extent(StrEnum):
    """Extent of a run; each holds all that the ones before it hold."""

    QUICK = "quick"
    """Each contract, seam, property and path once: for people."""
    FULL = "full"
    """Each row of the fault table and each path: for CI."""
    NIGHT = "night"
    """Statistics, load and long cycles."""

    @property
    def options(self) -> tuple[str, ...]:
        """Return the options of pytest that select it."""
        return () if self is Extent.QUICK else (f"--{self}",)


@dataclass(frozen=True, slots=True)
class Step:
    """A command with a name."""

    name: str
    command: tuple[str, ...]

    @property
    def printed(self) -> Path:
        """File with what the command prints."""
        return KEPT / f"{self.name}.txt"

    @property
    def reports(self) -> Path:
        """File with a line for each report of a test, if the step runs tests."""
        return KEPT / f"{self.name}.jsonl"


@dataclass(frozen=True, slots=True)
class Ran:
    """A step that has ended, with its exit code and what it took."""

    step: Step
    code: int
    wall_s: float
    processor_s: float

    @property
    def has_failed(self) -> bool:
        return self.code not in (0, NO_TESTS)


FORM = (
    Step("format", (f"{BIN}/ruff", "format", "--check", "--quiet", ".")),
    Step("lint", (f"{BIN}/ruff", "check", "--quiet", ".")),
    Step("imports", (f"{BIN}/lint-imports", "--no-cache")),
)
TYPES = Step("types", ("nice", f"{BIN}/mypy"))
"""Fills what the tests leave of the processors."""
COMPILE = Step("compile", (f"{BIN}/stonefall", "compile", "--config", "deploy/stonefall.toml"))
"""All loops once, for all processes that follow."""
COLLECT = Step("collect", (f"{BIN}/pytest", "--collect-only", "--quiet"))
"""Compiles what the processes of the tests would each compile: they import the same at the same time."""

RIGS = ("tests/live", "tests/screens", "tests/soak")
"""Whole rigs and browsers: one after the other, as they want a processor whenever they want one and else wait."""
N_PROCESSES = 3
"""One more than processors: daemons and devices mostly wait."""


def stages(extent: Extent, selected: Sequence[str] | None = None) -> list[list[list[Step]]]:
    """Return the stages of a run, one after the other; the lanes of a stage run side by side, each step by step.

    `selected`: the files of tests to run instead of all.
    """
    files = sorted(map(str, Path("tests").rglob("test_*.py"))) if selected is None else selected
    # beside the rigs by their names, not by their folders: some folders only compute, others mostly wait
    files = sorted(files, key=lambda file: (not file.startswith(RIGS), Path(file).name))
    return [[[*FORM, COLLECT], [COMPILE]], [[_tests(extent, files)] if files else [], [TYPES]]]


def _tests(extent: Extent, files: Sequence[str]) -> Step:
    shared = ("-p", "gate.sharing", "--numprocesses", str(N_PROCESSES), "--dist", "loadfile")
    report = f"--report-log={KEPT}/tests.jsonl"
    command = (f"{BIN}/pytest", *extent.options, *shared, "--no-loadscope-reorder", report, *files)
    return Step("tests", command)


class Runner:
    """Runs lanes of steps and can end them; `on_failed` is called for each step that fails."""

    def __init__(self, on_failed: Callable[[Ran], None] = lambda ran: None) -> None:
        self._on_failed = on_failed
        self.running: list[str] = []
        """Names of the steps that run."""
        self.ran: list[Ran] = []
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._is_ending = threading.Event()

    def run(self, lanes: Sequence[Sequence[Step]]) -> None:
        """Run the lanes side by side, each step by step, also the steps after one that fails."""
        threads = [threading.Thread(target=self._run_lane, args=(lane,)) for lane in lanes]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def end(self) -> None:
        """Terminate what runs and start nothing more."""
        self._is_ending.set()
        for process in tuple(self._processes):
            process.send_signal(signal.SIGTERM)

    def _run_lane(self, steps: Sequence[Step]) -> None:
        for step in steps:
            if not self._is_ending.is_set():
                self.ran.append(ran := self._run_step(step))
                if ran.has_failed:
                    self._on_failed(ran)

    def _run_step(self, step: Step) -> Ran:
        start_s = time.monotonic()
        self.running.append(step.name)
        with step.printed.open("wb") as printed:
            process = subprocess.Popen(  # noqa: S603 - one of the steps above, no shell
                step.command, stdin=subprocess.DEVNULL, stdout=printed, stderr=subprocess.STDOUT
            )
        self._processes.add(process)
        _, status, usage = os.wait4(process.pid, 0)  # with all processes that it has waited for
        process.returncode = os.waitstatus_to_exitcode(status)
        self._processes.discard(process)
        self.running.remove(step.name)
        used_s = usage.ru_utime + usage.ru_stime
        return Ran(step, process.returncode, time.monotonic() - start_s, used_s)
