"""Print each stone as it is measured: a small client of the REST feed, as a start for your own.

It keeps its cursor, asks with a long poll, and needs only the standard library.
"""

import argparse
import json
import re
import sys
import time
import urllib.request
from contextlib import suppress
from http.client import HTTPException
from pathlib import Path
from typing import Any

ROW = "{:>4}  {:<17} {:<10} {:<9} {:<8} {:>10} {:>8} {:>8} {:>9} {:>8}  {}"
HEAD = ROW.format(
    "seq", "bundle", "class", "outcome", "quality", "volume mm3", "error %", "sieve mm", "error mm", "time ms",
    "remarks",
)  # fmt: skip
"""The errors are those of volume and sieve size against the true ones of a synthetic recording."""
HELD_S = 60.0
"""With --once: longest wait for a rig that is held."""


def get(base: str, path: str, timeout_s: float = 40) -> dict[str, Any]:
    with urllib.request.urlopen(f"{base}/api/v1{path}", timeout=timeout_s) as answer:  # noqa: S310 - the user's own URL
        return dict(json.load(answer))


def ask(base: str, path: str, process: int | None, timeout_s: float = 40) -> dict[str, Any] | None:
    """Return the answer, None while there is none; exit when the process of the daemon has ended.

    While the daemon runs it keeps its port, so the answer cannot be another program's.
    """
    exit_without(process)
    answer = None
    with suppress(OSError, HTTPException, json.JSONDecodeError):
        answer = get(base, path, timeout_s)
    exit_without(process)
    return answer


def exit_without(process: int | None) -> None:
    if process is not None and not is_running(process):
        sys.exit("the daemon ended")


def wait_until_ready(base: str, process: int | None, timeout_s: float = 120) -> None:
    deadline = time.monotonic() + timeout_s
    while ask(base, "/health/live", process, timeout_s=2) is None:
        if time.monotonic() > deadline:
            sys.exit(f"no answer from {base} within {timeout_s:.0f} s")
        time.sleep(0.2)


def is_running(process: int) -> bool:
    """Return whether a process runs; False for one that ended, even while its parent has not read its exit code."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def number_of(bundle: str) -> int | None:
    """Return the digits that a bundle's name begins with: its number in the recording, in any round of a loop."""
    number = re.match(r"\d+", bundle)
    return int(number[0]) if number else None


def row(item: dict[str, Any], truth: dict[str, Any] | None) -> str:
    measured = item["outcome"] == "measured"
    volume_error = sieve_error = ""
    if measured and truth is not None:
        volume_error = f"{100 * (item['volume_mm3'] / truth['volume_mm3'] - 1):+.2f}"
        sieve_error = f"{item['sieve_size_mm'] - truth['sieve_size_mm']:+.3f}"
    dropped = ", ".join(f"{camera}: {why}" for camera, why in item["dropped_views"].items())
    return ROW.format(
        item["seq"],
        item["bundle"],
        truth["body"] if truth is not None else item["zingg_class"] or "",
        item["outcome"],
        item["quality"] or "",
        f"{item['volume_mm3']:.1f}" if measured else "",
        volume_error,
        f"{item['sieve_size_mm']:.2f}" if measured else "",
        sieve_error,
        f"{item['timings_ms'].get('total', 0):.0f}",
        item["detail"] or dropped,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("base", help="address of the daemon, such as http://127.0.0.1:8080")
    parser.add_argument("--truth", type=Path, help="truth.jsonl of a synthetic recording, to print errors")
    parser.add_argument("--once", action="store_true", help="exit when all triggers have their outcome")
    parser.add_argument(
        "--stones",
        type=int,
        help="number of stones that fall, for --once; default: until the recording has ended",
    )
    parser.add_argument("--while-process", type=int, help="exit when this process has ended")
    arguments = parser.parse_args()
    truth = {}
    if arguments.truth:
        records = [json.loads(line) for line in arguments.truth.read_text().splitlines()]
        truth = {number_of(record["bundle"]): record for record in records}
    base, process = arguments.base, arguments.while_process
    wait_until_ready(base, process)
    print(f"results   {base}/api/v1/results")
    print(f"health    {base}/api/v1/health")
    print(f"API       {base}/api/v1/docs\n")
    print(HEAD, flush=True)
    cursor, is_through, held_since = 0, False, time.monotonic()
    while True:
        page = ask(base, f"/results?after={cursor}&wait_s={0 if is_through else 2}", process)
        if page is None:
            time.sleep(0.5)  # keep the cursor over an outage
            continue
        for item in page["items"]:
            print(row(item, truth.get(number_of(item["bundle"]))), flush=True)
        cursor = page["next_after"]
        if arguments.once and not page["items"]:
            counts, acquisition = ask(base, "/accounting", process), ask(base, "/acquisition", process)
            if counts is None or acquisition is None:
                continue
            if is_through:
                return summary(counts)
            if acquisition["state"] != "held":
                held_since = time.monotonic()
            elif time.monotonic() - held_since > HELD_S:
                sys.exit(f"held: {acquisition['trouble']}")
            # one more page, for results that came between the two answers
            has_ended = (
                acquisition["state"] == "disarmed"
                if arguments.stones is None
                else counts["triggers"] >= arguments.stones
            )
            is_through = counts["triggers"] > 0 and counts["in_progress"] == 0 and has_ended


def summary(counts: dict[str, Any]) -> int:
    parts = {name: counts[name] for name in ("measured", "rejected", "lost")}
    holds = counts["triggers"] == sum(parts.values())
    print(f"\n{counts['triggers']} triggers = " + " + ".join(f"{n} {name}" for name, n in parts.items()))
    return 0 if holds and parts["measured"] > 0 else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
