"""The store in a process of its own, to be killed."""

import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]
REPOSITORY = TESTS.parent


def run_until_killed(state_dir: Path, n_acknowledged: int) -> dict[int, int]:
    """Kill the writer after it has acknowledged so many results, and return them: n by seq."""
    process = subprocess.Popen(
        [sys.executable, "-m", "support.store_writer", str(state_dir)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": f"{REPOSITORY}{os.pathsep}{TESTS}"},
    )
    with process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(n_acknowledged)]
        process.kill()
        lines += process.stdout.readlines()
    # the last line may be torn
    pairs = [line.split() for line in lines if line.endswith("\n")]
    assert len(pairs) >= n_acknowledged
    return {int(seq): int(n) for seq, n in pairs}
