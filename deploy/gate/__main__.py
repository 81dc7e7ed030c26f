"""Run the gate: checks of the source beside tests, where the minutes went, and what was seen."""

import argparse
import os
import signal
import sys
import threading
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from gate.durations import Durations, busy_s, gflops, keep, kept, read_reports, summed, tables, too_long
from gate.selection import reached
from gate.steps import BIN, FORM, KEPT, TYPES, Extent, Ran, Runner, stages

TOLD_EVERY_S = 20.0
TYPICAL_S = {Extent.QUICK: 300.0, Extent.FULL: 900.0, Extent.NIGHT: 3600.0}
"""Duration of a run that none was before, on two processors."""


def main() -> None:
    """Check the source and run the tests; the exit code is 1 if anything fails."""
    parser = argparse.ArgumentParser(prog="deploy/check", description=main.__doc__)
    extents = parser.add_mutually_exclusive_group()
    for extent, text in (
        (Extent.FULL, "what CI runs: every row of the fault table, every path"),
        (Extent.NIGHT, "statistics, load and long cycles as well"),
    ):
        extents.add_argument(f"--{extent}", dest="extent", action="store_const", const=extent, help=text)
    text = "only the tests that a change since a commit (HEAD) can reach"
    parser.add_argument("--changed", nargs="?", const="HEAD", metavar="COMMIT", help=text)
    text = "run nothing; print where the minutes of the latest whole run went"
    parser.add_argument("--durations", action="store_true", help=text)
    parser.set_defaults(extent=Extent.QUICK)
    arguments, tests = parser.parse_known_args()
    if arguments.durations:
        print(*tables(kept() or sys.exit("no run of the gate is kept")), sep="\n")
    elif tests:
        _run_these(arguments.extent, tests)
    else:
        sys.exit(_run(arguments.extent, arguments.changed))


def _run_these(extent: Extent, tests: Sequence[str]) -> None:
    """Check the source, then become pytest with these arguments."""
    KEPT.mkdir(parents=True, exist_ok=True)
    runner = _runner()
    runner.run([FORM, [TYPES]])
    if any(each.has_failed for each in runner.ran):
        sys.exit(1)
    os.execv(f"{BIN}/pytest", ["pytest", *extent.options, *tests])  # noqa: S606 - pytest of this environment, no shell


def _run(extent: Extent, since: str | None) -> int:
    KEPT.mkdir(parents=True, exist_ok=True)
    for old in KEPT.iterdir():
        old.unlink()
    selected = None if since is None else reached(since)
    if selected is not None:
        print(f"{len(selected)} files of tests can be reached by what changed since {since}", flush=True)
    start_s, start_busy_s, speeds, runner = time.monotonic(), busy_s(), [gflops()], _runner()
    before = kept()
    typical_s = before.wall_s if before and before.extent == extent else TYPICAL_S[extent]
    telling = threading.Thread(
        target=_tell, args=(runner, start_s, typical_s if since is None else None), daemon=True
    )
    telling.start()
    for lanes in stages(extent, selected):
        runner.run(lanes)
        speeds.append(gflops())
    runner.end()
    tests = read_reports(KEPT.glob("*.jsonl"))
    durations = Durations(
        utc=datetime.now(UTC).isoformat(timespec="seconds"),
        extent=extent,
        wall_s=round(time.monotonic() - start_s, 1),
        processor_s=round(busy_s() - start_busy_s, 1),
        gflops=round(min(speeds), 1),
        steps=summed(runner.ran),
        tests=tests,
    )
    is_whole = selected is None
    wrong = too_long(durations) if extent is Extent.QUICK and is_whole else []
    if is_whole:
        keep(durations)
        print(*tables(durations), *wrong, sep="\n")
    return _conclude(durations, runner.ran, has_slow=bool(wrong))


def _conclude(durations: Durations, ran: Sequence[Ran], *, has_slow: bool) -> int:
    """Print what was seen, in pytest's own words and in one line; return the exit code."""
    for each in ran:
        if each.step.reports.exists():
            print(_last_line(each.step.printed))
    n_failed = sum(each.outcome == "failed" for each in durations.tests.values())
    failed = [each.step.name for each in ran if each.has_failed]
    minutes, processor_minutes = durations.wall_s / 60, durations.processor_s / 60
    print(
        f"{'not good' if failed or has_slow else 'good'}: {len(durations.tests)} tests, {n_failed} failed;"
        f" steps that failed: {', '.join(failed) or 'none'}; {minutes:.1f} minutes,"
        f" {processor_minutes:.1f} of processor time at {durations.gflops:.0f} GFLOP/s",
        flush=True,
    )
    return int(bool(failed) or has_slow)


def _show(ran: Ran) -> None:
    print(f"--- {ran.step.name} failed\n{ran.step.printed.read_text(errors='replace')}", flush=True)


def _last_line(printed: Path) -> str:
    return (printed.read_text(errors="replace").strip().splitlines() or [""])[-1]


def _runner() -> Runner:
    """Build the runner, which SIGTERM and Ctrl-C end with all that it runs."""
    runner = Runner(_show)

    def end(number: int, _: object) -> None:
        runner.end()
        sys.exit(128 + number)

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    return runner


def _tell(runner: Runner, start_s: float, typical_s: float | None) -> None:
    """Print at times what runs, how many tests have run, and how long it will take."""
    while True:
        time.sleep(TOLD_EVERY_S)
        elapsed_s = time.monotonic() - start_s
        tests = read_reports(KEPT.glob("*.jsonl"))
        n_failed = sum(each.outcome == "failed" for each in tests.values())
        left = "" if typical_s is None else f", about {max(0.0, typical_s - elapsed_s) / 60:.0f} min left"
        running = ", ".join(runner.running)
        done = f"{len(tests)} tests, {n_failed} failed"
        print(f"[{elapsed_s // 60:2.0f}:{elapsed_s % 60:02.0f}] {running}; {done}{left}", flush=True)


if __name__ == "__main__":
    main()
