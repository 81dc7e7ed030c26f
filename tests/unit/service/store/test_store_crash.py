"""kill -9 at any moment: what was acknowledged is there, nothing is there twice, no number is missing."""

from pathlib import Path

from support.outcomes import lose_open
from support.store_process import run_until_killed
from support.stores import folder_of

from service.store import open_store
from service.store.accounting import accounting
from service.store.reads import results_after


async def test_kill_9_loses_nothing_acknowledged(state_dir: Path) -> None:
    acknowledged: dict[int, int] = {}
    for n_acknowledged in (1, 17, 43):
        acknowledged |= run_until_killed(state_dir, n_acknowledged)
    store = open_store(state_dir)
    try:
        n_open = (await store.read(accounting)).in_progress
        assert n_open > 0
        assert await lose_open(store, "shutdown", "killed") == n_open
        counts = await store.read(accounting)
        items = (await store.read(results_after, 0, 10_000)).items
    finally:
        store.close()
    by_seq = {item["seq"]: item for item in items}
    assert sorted(by_seq) == list(range(1, len(items) + 1))
    assert {seq: by_seq[seq]["n"] for seq in acknowledged} == acknowledged
    for seq, n in acknowledged.items():
        mesh = folder_of(state_dir, by_seq[seq]["id"]) / "mesh.ply"
        assert mesh.read_bytes() == b"mesh %d" % n
    assert counts.is_balanced
    assert counts.in_progress == 0
    assert counts.lost >= n_open
    assert counts.triggers == len(items)
