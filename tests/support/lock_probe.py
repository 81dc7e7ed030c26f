"""`stonefall` with a thread that notes how long it waits for the interpreter's lock.

Run: python lock_probe.py FILE [arguments of stonefall]
A line of FILE is one wait beyond NOTED_MS: when it ended (monotonic clock, s) and how long it was (ms). What the thread
waited for a core is left out, what the process did not compute meanwhile, for then nobody held the lock, and what a
hypervisor took away from a core, which looks like computing. It begins once FILE is there. With LOCK_STACKS in the
environment the stacks of all threads come before a wait beyond LONG_S: this takes time, and may end the process while
it loads modules.
"""

import faulthandler
import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

PERIOD_S = 0.004
WAITING_S = 0.1
TICK_NS = 1_000_000_000 // os.sysconf("SC_CLK_TCK")
NOTED_MS = 5.0
LONG_S = 0.02
"""What no call of the daemon may take with the lock held."""


def watch(path: Path) -> None:
    """Sleep, and note how much later than asked the interpreter lets this thread go on."""
    while not path.exists():
        time.sleep(WAITING_S)
    with path.open("a", encoding="utf-8") as file:
        _note_waits(file)


def _note_waits(file: TextIO) -> None:
    is_told = "LOCK_STACKS" in os.environ
    own = os.open(f"/proc/self/task/{threading.get_native_id()}/schedstat", os.O_RDONLY)
    machines = os.open("/proc/stat", os.O_RDONLY)
    no_core_ns, computed_ns = 0, 0  # so that nothing is noted at first
    while True:
        no_core_before_ns, computed_before_ns = no_core_ns, computed_ns
        due_ns = time.monotonic_ns() + round(1e9 * PERIOD_S)
        if is_told:
            faulthandler.dump_traceback_later(PERIOD_S + LONG_S, file=file)  # by a thread that needs no lock
        time.sleep(PERIOD_S)
        now_ns = time.monotonic_ns()
        if is_told:
            faulthandler.cancel_dump_traceback_later()
        computed_ns = time.process_time_ns()
        no_core_ns = _waited_for_core_ns(own) + _stolen_ns(machines)
        without_core_ns, meanwhile_ns = no_core_ns - no_core_before_ns, computed_ns - computed_before_ns
        waited_ms = min(now_ns - due_ns - without_core_ns, meanwhile_ns) / 1e6
        if waited_ms > NOTED_MS:
            file.write(f"{now_ns / 1e9:.3f} {waited_ms:.1f}\n")
            file.flush()


def _waited_for_core_ns(own: int) -> int:
    return int(os.pread(own, 100, 0).split()[1])


def _stolen_ns(machines: int) -> int:
    """Of all cores together, told in whole ticks."""
    return int(os.pread(machines, 200, 0).split()[8]) * TICK_NS


def waits_ms(path: Path, since_s: float) -> Iterator[float]:
    """Waits that were noted in a file after some time of the monotonic clock."""
    for line in path.read_text().splitlines():
        match line.split():
            case [at_s, waited_ms] if at_s[0].isdigit() and float(at_s) > since_s:
                yield float(waited_ms)


def main() -> None:
    from service.commands.cli import main as stonefall  # the workers import this module, too

    threading.Thread(target=watch, args=(Path(sys.argv.pop(1)),), name="lock probe", daemon=True).start()
    stonefall()


if __name__ == "__main__":
    main()
