"""Keys outlive a database that is damaged or restored; where they are lost, nothing is open."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from service.base.errors import StoreError
from service.store import open_store
from service.store.backups import back_up, restore
from service.store.history import DATABASE
from service.store.keys import MAX_KEYS, create_key, revoke_key, stored_keys

PAGE_BYTES = 4096


@pytest.fixture
def keyed(state_dir: Path) -> Path:
    """Return the folder of a store with two keys, which nothing has open."""
    for name in ("mes", "lab"):
        create_key(state_dir, name, ("read",), None, "root")
    return state_dir


def states(state_dir: Path) -> dict[str, bool]:
    """Return the names of the keys, and whether each is accepted."""
    return {key.name: key.revoked_at is None for key in stored_keys(state_dir)}


def restart(state_dir: Path) -> None:
    with open_store(state_dir):
        pass


def damage(state_dir: Path, table: str) -> None:
    with closing(sqlite3.connect(state_dir / DATABASE)) as connection:
        sql = "SELECT rootpage FROM sqlite_schema WHERE name = ?"
        (page,) = connection.execute(sql, (table,)).fetchone()
    with (state_dir / DATABASE).open("r+b") as file:
        file.seek((page - 1) * PAGE_BYTES)
        file.write(PAGE_BYTES * b"\xa5")


def test_a_restored_backup_brings_no_key_back_and_takes_none_away(keyed: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.sqlite"
    with closing(sqlite3.connect(keyed / DATABASE)) as connection, connection:
        connection.execute("INSERT INTO browser_sessions VALUES ('cookie', 'key', 1, 1, 0)")
    back_up(keyed, copy)
    revoke_key(keyed, "mes", "root")
    create_key(keyed, "office", ("read",), None, "root")
    now = states(keyed)
    restore(copy, keyed)
    assert states(keyed) == now == {"mes": False, "lab": True, "office": True}
    with closing(sqlite3.connect(keyed / DATABASE)) as connection:
        assert connection.execute("SELECT * FROM browser_sessions").fetchall() == []
    new = tmp_path / "new"
    restore(copy, new, any_audit=True)
    assert states(new) == {"mes": True, "lab": True}


def test_a_damaged_database_keeps_its_keys_if_they_can_be_read(keyed: Path) -> None:
    damage(keyed, "results")
    restart(keyed)
    assert list(keyed.glob(f"aside/*-damaged/{DATABASE}"))
    assert states(keyed) == {"mes": True, "lab": True}


@pytest.mark.parametrize("table", ["keys", "store"])
def test_keys_that_are_lost_open_nothing_until_there_is_one(keyed: Path, tmp_path: Path, table: str) -> None:
    copy = tmp_path / "copy.sqlite"
    back_up(keyed, copy)
    damage(keyed, table)
    for _ in range(2):
        restart(keyed)
        with pytest.raises(StoreError, match="may have had keys: restore a backup, or create them anew"):
            stored_keys(keyed)
    create_key(keyed, "new", ("read",), None, "root")
    assert states(keyed) == {"new": True}
    restore(copy, keyed, any_audit=True)
    assert states(keyed) == {"mes": True, "lab": True, "new": True}


def test_a_damaged_store_that_never_had_a_key_has_lost_none(state_dir: Path) -> None:
    restart(state_dir)
    damage(state_dir, "keys")
    restart(state_dir)
    assert list(state_dir.glob("aside/*-damaged"))
    assert stored_keys(state_dir) == []


def test_a_database_that_was_removed_may_have_had_keys(keyed: Path) -> None:
    (keyed / DATABASE).unlink()
    restart(keyed)
    with pytest.raises(StoreError, match="may have had keys"):
        stored_keys(keyed)


def test_a_new_store_has_no_keys_and_none_were_lost(state_dir: Path) -> None:
    assert stored_keys(state_dir) == []
    restart(state_dir)
    assert stored_keys(state_dir) == []


def test_keys_are_bounded_and_those_that_are_dead_give_way(
    keyed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert MAX_KEYS == 1000
    monkeypatch.setattr("service.store.keys.MAX_KEYS", 3)
    revoke_key(keyed, "mes", "root")
    for name in ("third", "fourth"):
        create_key(keyed, name, ("read",), None, "root")
    assert states(keyed) == {"lab": True, "third": True, "fourth": True}
    with pytest.raises(StoreError, match="has 3 keys: revoke old ones"):
        create_key(keyed, "fifth", ("read",), None, "root")
