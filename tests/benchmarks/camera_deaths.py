"""Kill the process of the cameras again and again while stones fall, and report how soon it is replaced.

Run: .venv/bin/python tests/benchmarks/camera_deaths.py [--deaths 10]
Exits with 1 if a stone that the simulator dropped has no outcome, or one is not measured for another reason than that
images are missing.
"""

import argparse
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.live_rig import LiveRig, eventually, live_rig
from support.printed import show
from support.small_recording import write_small_recording
from support.usage import percentiles

BETWEEN_S = 12.0
"""Longer than a process must live to be replaced at once."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--deaths", type=int, default=10)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    n_deaths = arguments.deaths
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_small_recording(folder / "recording", n_stones=7, n_backgrounds=4)
        with live_rig(folder, folder / "recording") as live:
            before = live.accounting()
            live.rig.belt.start()
            process_ms, whole_ms = [], []
            for _ in range(n_deaths):
                time.sleep(BETWEEN_S)
                took_ms = deaths_ms(live)
                process_ms.append(took_ms[0])
                whole_ms.append(took_ms[1])
            time.sleep(2.0)
            live.rig.belt.stop()
            time.sleep(1.0)
            live.daemon.wait_for("/accounting", lambda now: now["in_progress"] == 0)
            counts, n_stones = live.accounting(), live.stones
    table = Table("", "found", title=f"{n_deaths} deaths of the process of the cameras, 4 stones/s")
    reasons = {reason: n - before["by_reason"].get(reason, 0) for reason, n in counts["by_reason"].items()}
    table.add_row("until there is another process, ms: p50, p95, p99, max", percentiles(process_ms))
    table.add_row("until all 16 cameras are armed again, ms: p50, p95, p99, max", percentiles(whole_ms))
    table.add_row("stones that fell (simulator), triggers", f"{n_stones}, {counts['triggers']}")
    table.add_row("measured, rejected, lost", "{measured}, {rejected}, {lost}".format(**counts))
    table.add_row("lost or rejected by reason", str(reasons))
    show(table, as_json=arguments.json, width=120)
    is_whole = (
        counts["triggers"] == n_stones
        and counts["is_balanced"]
        and set(reasons) <= {"no_frames", "insufficient_views"}
    )
    return 0 if is_whole else 1


def deaths_ms(live: LiveRig) -> tuple[float, float]:
    """Kill the process; return the time until there is another one, and until all cameras are armed."""
    pid = live.daemon.camera_pid()
    recoveries = live.status("c16")["recoveries"]
    os.kill(pid, signal.SIGKILL)
    killed_s = time.monotonic()

    def is_replaced() -> bool:
        try:
            return live.daemon.camera_pid() != pid
        except ValueError:
            return False

    eventually(is_replaced, "another process is there")
    process_s = time.monotonic() - killed_s
    eventually(lambda: live.status("c16")["recoveries"] > recoveries, "c16 is back")
    live.wait_until_whole()
    return process_s * 1e3, (time.monotonic() - killed_s) * 1e3


if __name__ == "__main__":
    sys.exit(main())
