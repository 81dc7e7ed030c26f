"""Databases as the installer sees them: which backup an older release takes, and what that one lacks."""

import json
import sqlite3
from pathlib import Path

import pytest
from installer import store, switch
from installer.host import InstallError
from installer.store import Copy, Stock
from support.installed_host import NEW, OLD


def copy(name: str, schema: int, last_seq: int, modified_at: float = 0.0) -> Copy:
    return Copy(name, schema, last_seq, modified_at)


def test_an_older_release_takes_the_newest_backup_that_it_can_read() -> None:
    in_use = copy("results.sqlite", 12, 100)
    backups = (copy("a", 10, 40), copy("b", 11, 70, 1.0), copy("c", 12, 100), copy("d", 11, 70, 2.0))
    assert switch.plan_return(NEW, Stock(in_use, backups)) == switch.Return(None, 0)
    assert switch.plan_return(OLD, Stock(None, backups)) == switch.Return(None, 0)
    assert switch.plan_return(OLD, Stock(in_use, backups)) == switch.Return(backups[3], 30)
    with pytest.raises(InstallError, match=r"schema 12, 0\.3\.0 reads schemas up to 11"):
        switch.plan_return(OLD, Stock(in_use, backups[2:3]))


def database(path: Path, schema: int, n: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    connection = sqlite3.connect(path)
    connection.executescript(
        "CREATE TABLE store (last_seq INTEGER); CREATE TABLE results (seq INTEGER, id TEXT, record TEXT)"
    )
    connection.execute(f"PRAGMA user_version = {schema}")
    connection.execute("INSERT INTO store VALUES (?)", (n,))
    connection.executemany(
        "INSERT INTO results VALUES (?, ?, ?)", [(i, f"s{i}", '{"outcome": "lost"}') for i in range(1, n + 1)]
    )
    connection.commit()
    connection.close()


def test_what_a_backup_does_not_have_is_written_out(tmp_path: Path) -> None:
    assert store.look(tmp_path) == Stock(None, ())
    database(tmp_path / "results.sqlite", 12, 5)
    database(tmp_path / "backups/before-1.sqlite", 11, 3)
    (tmp_path / "backups/torn.sqlite").write_bytes(b"SQLite format 3\0 and then nothing")
    stock = store.look(tmp_path)
    assert stock.in_use is not None and (stock.in_use.schema, stock.in_use.last_seq) == (12, 5)
    assert [(Path(each.path).name, each.schema) for each in stock.backups] == [("before-1.sqlite", 11)]
    assert store.write_later(tmp_path / "results.sqlite", 3, tmp_path / "later.jsonl") == 2
    lines = [json.loads(line) for line in (tmp_path / "later.jsonl").read_text().splitlines()]
    assert lines == [{"seq": i, "id": f"s{i}", "outcome": "lost"} for i in (4, 5)]
