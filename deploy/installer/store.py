"""The database of results as the installer sees it: its schema, its newest number, its backups.

Run as a command by the service's user, because opening a database may leave files beside it.
"""

import json
import sqlite3
import sys
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path

DATABASE, BACKUPS = "results.sqlite", "backups"


@dataclass(frozen=True)
class Copy:
    """A database of results: the one in use, or a backup."""

    path: str
    schema: int
    last_seq: int
    modified_at: float


@dataclass(frozen=True)
class Stock:
    """All databases in the folder of a store; `in_use` is None before the first start."""

    in_use: Copy | None
    backups: tuple[Copy, ...]


def look(state_dir: Path) -> Stock:
    """Return the databases of a store; a backup that cannot be read is left out."""
    path = state_dir / DATABASE
    backups = []
    for backup in sorted((state_dir / BACKUPS).glob("*.sqlite")):
        try:
            backups.append(_copy(backup))
        except (sqlite3.Error, TypeError, ValueError) as err:  # of a damaged one
            print(f"{backup}: {err}", file=sys.stderr)
    return Stock(_copy(path) if path.exists() else None, tuple(backups))


def backup_for(stock: Stock, schema: int) -> Copy | None:
    """Return the backup with the most results that a release can read which knows schemas up to `schema`."""
    fitting = [copy for copy in stock.backups if copy.schema <= schema]
    return max(fitting, key=lambda copy: (copy.last_seq, copy.modified_at), default=None)


def write_later(database: Path, seq: int, out: Path) -> int:
    """Write all results after number `seq` as lines of JSON, and return how many these are."""
    with closing(_open(database)) as connection, out.open("w") as file:
        rows = connection.execute("SELECT seq, id, record FROM results WHERE seq > ? ORDER BY seq", (seq,))
        count = 0
        for number, particle, record in rows:
            file.write(json.dumps({"seq": number, "id": particle, **json.loads(record)}) + "\n")
            count += 1
    return count


def _copy(path: Path) -> Copy:
    with closing(_open(path)) as connection:
        (schema,) = connection.execute("PRAGMA user_version").fetchone()
        (last_seq,) = connection.execute("SELECT last_seq FROM store").fetchone()
    return Copy(str(path), schema, last_seq, path.stat().st_mtime)


def _open(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["look", folder]:
            print(json.dumps(asdict(look(Path(folder)))))
        case ["later", source, number, target]:
            print(write_later(Path(source), int(number), Path(target)))
        case _:
            sys.exit("look FOLDER | later DATABASE SEQ OUT")
