"""kill -9 at any moment: what was acknowledged is there, nothing is there twice, no number is missing."""

import os
import subprocess
import sys
from pathlib import Path

from service.store import open_store

TESTS = Path(__file__).parents[3]
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


async def test_kill_9_loses_nothing_acknowledged(state_dir: Path) -> None:
    acknowledged: dict[int, int] = {}
    for n_acknowledged in (1, 17, 43):
        acknowledged |= run_until_killed(state_dir, n_acknowledged)
    store = open_store(state_dir)
    try:
        n_open = (await store.accounting()).in_progress
        assert n_open > 0
        assert await store.lose_open("shutdown", "killed") == n_open
        counts = await store.accounting()
        items = (await store.results_after(0, 10_000)).items
    finally:
        store.close()
    by_seq = {item["seq"]: item for item in items}
    assert sorted(by_seq) == list(range(1, len(items) + 1))
    assert {seq: by_seq[seq]["n"] for seq in acknowledged} == acknowledged
    for seq, n in acknowledged.items():
        mesh = state_dir / by_seq[seq]["mesh"]
        assert mesh.read_bytes() == b"mesh %d" % n
    assert counts.is_balanced
    assert counts.in_progress == 0
    assert counts.lost >= n_open
    assert counts.triggers == len(items)
