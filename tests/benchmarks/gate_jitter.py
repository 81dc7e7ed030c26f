#!/usr/bin/env python3
"""Print a histogram of how exactly the gate's firmware makes its pulses, in cycles of 62.5 ns.

    .venv/bin/python tests/benchmarks/gate_jitter.py [--stones 2000] [--delay-us 247000] [--json]

The binary that is flashed runs on an emulated board (simavr). Stones come at random, 13 a second, as closely as 3 ms.
Beside work: every stone bounces, and the host asks for the identity all the time, so that the line is busy both ways.
A pulse is compared with the cycle of its own edge plus the delay. The emulator sees pins between two instructions
only, which is up to 4 cycles late: that is in the histogram, and not in the chip's capture and compare units.
"""

import argparse
import random
import sys
import tempfile
from collections import Counter
from pathlib import Path

from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.emulated_board import HZ, MS, US, Board, Build, running
from support.printed import show

from drivers.gates.gate_protocol import set_pulses

START = 100 * MS
RATE_HZ = 13
CLOSEST = 3 * MS
IDENTIFY_EVERY = 10 * MS


def errors(board: Board, *, stones: int, delay_us: int, is_busy: bool) -> Counter[int]:
    """Return the number of pulses by the cycles that they came after they were due."""
    dice = random.Random(1)  # noqa: S311 - nothing secret
    board.hear(set_pulses(delay_us, 100), START // 2)
    due, at = [], START
    for _ in range(stones):
        at += CLOSEST + round(dice.expovariate(RATE_HZ) * HZ)
        due.append(at)
        board.stone(at, width=MS)
        if is_busy:
            board.stone(at + MS + 200 * US, width=MS // 4)
    if is_busy:
        for asked in range(START, at, IDENTIFY_EVERY):
            board.hear(b"?\n", asked)
    board.run(at + delay_us * US + 10 * MS)
    closings = iter(board.rises("beam"))
    edges = [next(closing for closing in closings if closing >= each) for each in due]
    return Counter(
        rise - edge - delay_us * US for edge, rise in zip(edges, board.rises("trigger"), strict=True)
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="How exactly the gate's firmware makes its pulses.")
    parser.add_argument("--stones", type=int, default=2000)
    parser.add_argument("--delay-us", type=int, default=247_000)
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        build = Build.make(Path(folder))
        found = {}
        for is_busy in (False, True):
            with running(build) as board:
                found[is_busy] = errors(
                    board, stones=options.stones, delay_us=options.delay_us, is_busy=is_busy
                )
    table = Table("cycles from due", "ns", "pulses, calm", "pulses, busy", "")
    most = max(max(counts.values()) for counts in found.values())
    for cycles in range(min(map(min, found.values())), max(map(max, found.values())) + 1):
        calm, busy = (found[is_busy][cycles] for is_busy in (False, True))
        table.add_row(str(cycles), f"{cycles * 62.5:g}", str(calm), str(busy), "#" * round(40 * busy / most))
    show(table, as_json=options.json)


if __name__ == "__main__":
    main()
