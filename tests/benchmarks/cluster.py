"""Have an archive measured again by the daemon, by one worker of a local cluster, and by two, one of which is killed.

Run: .venv/bin/python tests/benchmarks/cluster.py [--stones 500] [--size-mm 8] [--folder DIR]

A daemon measures the stones and archives their frames; ten are rendered, and fall again and again. Then an older
algorithm is made to have measured them, three times, and `stonefall remeasure` revises them all: the daemon alone, one
worker, two workers of which one is killed when half of the stones are done. Prints how long each took, from the first
revision to the last, and exits with 1 unless all results and meshes are equal, bit for bit. All of it shares this
machine. With --folder the archive is kept, and used again by the next run; --by chooses who measures.
"""

import argparse
import json
import sqlite3
import subprocess
import sys
import tempfile
import time
from contextlib import closing, nullcontext
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Any

from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.cluster import LocalCluster
from support.daemon_process import STONEFALL, DaemonProcess, free_port
from support.eventually import eventually
from support.printed import show
from support.remeasuring import make_old
from support.stone_recording import write_stones
from support.stores import folder_of

SEED, N_RENDERED = 25, 10
LOT = "archive"
EVER = {"since": "2000-01-01T00:00:00Z", "until": "2100-01-01T00:00:00Z"}
LOOK_S = 0.05
ROOM = "keep_raw = {}"
"""What the archive keeps, and a few that fall until the daemon is stopped."""
OWN = ("seq", "revision", "revises", "recorded_at", "timings_ms", "mesh")
"""Fields in which revisions differ."""


class Kind(StrEnum):
    """By what the stones are measured again."""

    DAEMON = "daemon"
    ONE = "1"
    TWO = "2"
    KILLED = "2-killed"


N_WORKERS = {Kind.ONE: 1, Kind.TWO: 2, Kind.KILLED: 2}
WORDS = {
    Kind.DAEMON: "the daemon's own process",
    Kind.ONE: "1 worker",
    Kind.TWO: "2 workers",
    Kind.KILLED: "2 workers, one killed half-way",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One run of the command over all stones."""

    kind: Kind
    results: dict[str, dict[str, Any]]  # by id, without the fields of the revision
    meshes: dict[str, bytes]
    revising_s: float  # from the first revision to the last


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--stones", type=int, default=500)
    parser.add_argument("--size-mm", type=float, default=8)
    parser.add_argument("--folder", type=Path, help="for the archive, kept")
    parser.add_argument("--by", type=Kind, nargs="*", default=list(Kind), help=", ".join(Kind))
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    kept = nullcontext(str(arguments.folder)) if arguments.folder else tempfile.TemporaryDirectory()
    with kept as name, tempfile.TemporaryDirectory(dir="/dev/shm") as spool:
        folder = Path(name)
        fill_archive(folder, spool, arguments)
        runs = [remeasured(folder, spool, kind) for kind in arguments.by]
    return report(runs, as_json=arguments.json)


def daemon_of(folder: Path, spool: str, n_stones: int, *, loop: bool) -> DaemonProcess:
    rig = 'pace = "fast"\nloop = true' if loop else 'pace = "fast"'
    return DaemonProcess(
        folder,
        folder / "stones",
        rig=rig,
        store=ROOM.format(n_stones + 200),
        voxels=256,
        body="photo",
        spool=spool,
        slots=2,
        port=free_port(),
        command=(STONEFALL,),
    )


def fill_archive(folder: Path, spool: str, arguments: argparse.Namespace) -> None:
    """Let stones fall into a lot of their own, unless that is there."""
    if (folder / "state").exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    write_stones(
        folder / "stones", "angular", size_mm=arguments.size_mm, n_stones=N_RENDERED, n_empty=1, seed=SEED
    )
    daemon = daemon_of(folder, spool, arguments.stones, loop=True)
    with daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] >= arguments.stones, timeout_s=900)
        daemon.put("/products/rock", {"title": "rock", "density_kg_m3": 2700})
        daemon.post("/lots", {"lot": LOT, "product": "rock"})
        daemon.post(f"/lots/{LOT}/assign", EVER)
        daemon.post(f"/lots/{LOT}/close", {})
        daemon.stop()


def rows(folder: Path, query: str, *values: object) -> list[Any]:
    path = folder / "state" / "results.sqlite"
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as database:
        return database.execute(query, values).fetchall()


def n_revisions(folder: Path) -> int:
    return int(rows(folder, "SELECT count(*) FROM revisions")[0][0])


def remeasured(folder: Path, spool: str, kind: Kind) -> Run:
    """Have all stones measured again, by the daemon or by a cluster of so many workers."""
    make_old(folder / "state")
    n_stones = len(rows(folder, "SELECT seq FROM stones WHERE lot = ?", LOT))
    daemon = daemon_of(folder, spool, n_stones, loop=False)
    starting: Any = (
        LocalCluster(folder / "cluster", n_workers=N_WORKERS[kind]) if kind in N_WORKERS else nullcontext()
    )
    with daemon, starting as cluster:
        daemon.hear("READY=1")
        session = rows(folder, "SELECT max(session) FROM sessions")[0][0]
        fallen = "SELECT count(*) FROM results WHERE session = ?"
        eventually(lambda: rows(folder, fallen, session)[0][0] == N_RENDERED)
        n_before, last_seq = n_revisions(folder), rows(folder, "SELECT last_seq FROM store")[0][0]
        executor = () if cluster is None else ("--executor", cluster.executor)
        command = subprocess.Popen(
            [STONEFALL, "remeasure", "--config", daemon.config_path, "--lot", LOT, "--json", *executor],
            stdout=subprocess.PIPE,
            text=True,
        )
        if kind is Kind.KILLED:
            while n_revisions(folder) < n_before + n_stones // 2 and command.poll() is None:
                time.sleep(LOOK_S)
            cluster.kill_worker(0)
        done = json.loads(command.communicate()[0])
        daemon.stop()
    assert (len(done["revised"]), done["failed"], done["without_frames"]) == (n_stones, {}, []), done
    return run_of(folder, kind, last_seq)


def run_of(folder: Path, kind: Kind, last_seq: int) -> Run:
    """Return what the command has added to the store."""
    records = [
        json.loads(text)
        for (text,) in rows(folder, "SELECT record FROM revisions WHERE seq > ? ORDER BY seq", last_seq)
    ]
    times = [datetime.fromisoformat(record["recorded_at"]).timestamp() for record in records]
    return Run(
        kind=kind,
        results={
            record["id"]: {field: value for field, value in record.items() if field not in OWN}
            for record in records
        },
        meshes={
            record["id"]: (
                folder_of(folder / "state", record["id"]) / f"r{record['revision']}" / "mesh.sfmesh"
            ).read_bytes()
            for record in records
            if record["mesh"] is not None
        },
        revising_s=times[-1] - times[0],
    )


def report(runs: list[Run], *, as_json: bool) -> int:
    table = Table(
        "measured again by", "stones", "first to last revision s", "stones a second", "equal to the first"
    )
    are_equal = [(run.results, run.meshes) == (runs[0].results, runs[0].meshes) for run in runs]
    for run, is_equal in zip(runs, are_equal, strict=True):
        n_stones = f"{len(run.results)}, {len(run.meshes)} meshes"
        table.add_row(
            WORDS[run.kind],
            n_stones,
            f"{run.revising_s:.0f}",
            f"{(len(run.results) - 1) / run.revising_s:.1f}",
            "yes" if is_equal else "NO",
        )
    show(table, as_json=as_json)
    return 0 if all(are_equal) else 1


if __name__ == "__main__":
    sys.exit(main())
