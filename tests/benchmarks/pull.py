"""How soon the reference client has a backlog of 10 000 results of a real daemon.

.venv/bin/python tests/benchmarks/pull.py [--results 10000]
"""

import argparse
import json
import sqlite3
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

if __package__ is None:
    sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2])]

from rich.table import Table
from support.daemon_process import PATIENCE_S, STONEFALL, DaemonProcess
from support.eventually import eventually
from support.printed import show
from support.reference_client import start_client
from support.small_recording import write_small_recording

from service.store.indexed_fields import index_results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--results", type=int, default=10_000)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    n = arguments.results
    table = Table("fields", "results", "s")
    with tempfile.TemporaryDirectory(prefix="pull-") as name:
        folder = Path(name)
        recording = folder / "recording"
        write_small_recording(recording, n_stones=3)
        with DaemonProcess(folder, recording) as daemon:
            daemon.hear("READY=1")
            daemon.wait_for("/accounting", lambda counts: counts["measured"] == 3)
            daemon.stop()
        multiply_newest(folder / "state" / "results.sqlite", n)
        with DaemonProcess(folder, recording, rig="speed = 0.01", command=(STONEFALL,)) as daemon:
            daemon.hear("READY=1")
            url = daemon.url("").removesuffix("/api/v1")
            for fields in ("lean", "all"):
                table.index_results(
                    fields, "seq = ?", str(n), f"{pulled_s(url, folder / fields, fields, n):.1f}"
                )
    show(table, as_json=arguments.json)


def multiply_newest(database: Path, n: int) -> None:
    """Add copies of the newest result until there are `n`."""
    with closing(sqlite3.connect(database)) as connection, connection:
        trigger = connection.execute("SELECT * FROM triggers ORDER BY trigger DESC LIMIT 1").fetchone()
        names = [column[1] for column in connection.execute("PRAGMA table_info(triggers)")]
        seq, id_, session, text = connection.execute(
            "SELECT seq, id, session, record FROM results ORDER BY seq DESC LIMIT 1"
        ).fetchone()
        for number in range(seq + 1, n + 1):
            key = trigger[0] + number
            copy = {**dict(zip(names, trigger, strict=True)), "trigger": key, "bundle": f"copy-{number}"}
            marks = ", ".join("?" for _ in copy)
            connection.execute(f"INSERT INTO triggers VALUES ({marks})", tuple(copy.values()))  # noqa: S608 - marks
            record = {**json.loads(text), "seq": number, "id": f"{id_[:8]}-{number:08d}"}
            connection.execute(
                "INSERT INTO results (seq, id, trigger, session, record) VALUES (?, ?, ?, ?, ?)",
                (number, record["id"], key, session, json.dumps(record)),
            )
            index_results(connection, "seq = ?", number)
        connection.execute("UPDATE store SET last_seq = ?", (n,))


def pulled_s(url: str, database: Path, fields: str, n: int) -> float:
    """Return the time from the start of the client to its last result, s."""
    began_s = time.monotonic()
    client = start_client(url, database, "--fields", fields)
    try:
        eventually(lambda: n_stored(database) >= n, PATIENCE_S)
        return time.monotonic() - began_s
    finally:
        client.kill()
        client.wait()


def n_stored(database: Path) -> int:
    try:
        with closing(sqlite3.connect(database)) as connection:
            return int(connection.execute("SELECT count(*) FROM stones").fetchone()[0])
    except sqlite3.OperationalError:  # no table yet
        return 0


if __name__ == "__main__":
    main()
