"""Print each stone as it is measured: a reader of the REST feed, built on the client beside it.

It needs only the standard library. `client.py` is the start for a client of your own.
"""

import argparse
import json
import os
import re
import signal
import sys
import time
from pathlib import Path
from typing import Any

from client import Client, ClientError, NoAnswerError, Position, Reporter, follow

ROW = "{:>4}  {:<17} {:<10} {:<9} {:<8} {:>10} {:>8} {:>8} {:>9} {:>8}  {}"
HEAD = ROW.format(
    "seq", "bundle", "class", "outcome", "quality", "volume mm3", "error %", "sieve mm", "error mm", "time ms",
    "remarks",
)  # fmt: skip
"""Column headings; the errors are those of volume and sieve size against the truth of a synthetic recording."""
PATIENCE_S = 60.0
"""Longest wait for a held rig with `--once`."""
WAIT_S = 2.0
"""Longest wait for the next stone, after which the daemon's process is looked at."""


def ask(client: Client, path: str, process: int | None, timeout_s: float = 40) -> dict[str, Any] | None:
    """Return the response, None while there is none; end the program when the process has ended.

    The daemon keeps its port until it ends: while it runs, no other process responds there.
    """
    end_without(process)
    answer = None
    try:
        answer = client.get(path, timeout_s)
    except NoAnswerError:
        pass
    except ClientError as err:
        print(err, file=sys.stderr, flush=True)
    end_without(process)
    return answer


def end_without(process: int | None) -> None:
    if process is not None and not is_running(process):
        sys.exit("the daemon ended")


def wait_until_ready(client: Client, base: str, process: int | None, patience_s: float = 120) -> None:
    deadline = time.monotonic() + patience_s
    while ask(client, "/health/live", process, timeout_s=2) is None:
        if time.monotonic() > deadline:
            sys.exit(f"no answer from {base} within {patience_s:.0f} s")
        time.sleep(0.2)


def is_running(process: int) -> bool:
    """True while a process runs; False for one that ended, even if its parent has not read its exit code."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def number_of(bundle: str) -> int | None:
    """Return the number of a bundle in its recording; a replay in a loop appends the round, live cameras count."""
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
        item["detail"] or dropped or ", ".join(item["quality_causes"]),
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("base", help="such as http://127.0.0.1:8080")
    parser.add_argument("--truth", type=Path, help="truth.jsonl of a synthetic recording")
    parser.add_argument("--once", action="store_true", help="end when all triggers have their outcome")
    parser.add_argument(
        "--stones", type=int, help="number of stones that will fall; without it the daemon knows the end"
    )
    parser.add_argument("--key-file", type=Path, help="file with the token of a key, if the daemon needs one")
    parser.add_argument("--while-process", type=int, help="stop waiting when this process is gone")
    arguments = parser.parse_args()
    truth = {}
    if arguments.truth:
        records = [json.loads(line) for line in arguments.truth.read_text().splitlines()]
        truth = {number_of(record["bundle"]): record for record in records}
    base, process = arguments.base, arguments.while_process
    client = Client(base, arguments.key_file)
    wait_until_ready(client, base, process)
    print(f"results   {base}/api/v1/results")
    print(f"health    {base}/api/v1/health")
    print(f"API       {base}/api/v1/docs")
    print(f"pages     {base}/\n")
    print(HEAD, flush=True)
    is_through, held_since = False, time.monotonic()
    balls = set()
    reporter = Reporter(Position(), lambda text: print(text, file=sys.stderr, flush=True))
    for step in follow(client, Position(), fields=None, wait_s=WAIT_S):
        end_without(process)
        if process is None or not isinstance(step.trouble, NoAnswerError):  # the process tells of its own end
            reporter.note(step)
        for item in step.items:
            print(row(item, truth.get(number_of(item["bundle"]))), flush=True)
            if item["kind"] == "ball":
                balls.add(item["id"])
        if arguments.once and not step.items and step.trouble is None:
            counts, acquisition = ask(client, "/accounting", process), ask(client, "/acquisition", process)
            if counts is None or acquisition is None:
                continue
            if is_through:
                return summary(counts, len(balls))
            if acquisition["state"] != "held":
                held_since = time.monotonic()
            elif time.monotonic() - held_since > PATIENCE_S:
                sys.exit(f"held: {acquisition['trouble']}")
            # then once more for what came between the two responses
            has_ended = (
                acquisition["state"] == "disarmed"
                if arguments.stones is None
                else counts["triggers"] >= arguments.stones
            )
            is_through = counts["triggers"] > 0 and counts["in_progress"] == 0 and has_ended
    raise AssertionError("it is followed without end")


def summary(counts: dict[str, Any], n_balls: int) -> int:
    """Print what became of all triggers, and which of them a lot leaves out; return the exit code."""
    parts = {name: counts[name] for name in ("measured", "rejected", "lost")}
    holds = counts["triggers"] == sum(parts.values())
    print(f"\n{counts['triggers']} triggers = " + " + ".join(f"{n} {name}" for name, n in parts.items()))
    if n_balls:
        balls = "1 is a ball" if n_balls == 1 else f"{n_balls} are balls"
        print(
            f"{counts['triggers'] - n_balls} of them are stones; {balls} as calibrations use, which no lot counts"
        )
    return 0 if holds and parts["measured"] > 0 else 1


if __name__ == "__main__":
    # at once: an exception may be raised where Python ignores it, and everything printed is flushed
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))
    sys.exit(main())
