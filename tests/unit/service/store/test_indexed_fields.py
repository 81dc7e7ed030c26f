"""The list of indexed fields changes from release to release, in either direction, and no number is lost."""

import asyncio
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from support.outcomes import add, measured, rejected, trigger

from pipeline.frames import BundleKind
from service.lots.lots import LotDefinition, close_lot, open_lot
from service.lots.products import ProductDefinition, save_product
from service.lots.stones import MEASURED_COLUMNS
from service.results.fields import INDEXED_FIELDS
from service.store import ParticleFilter, Store, indexed_fields, open_store, schema
from service.store.backups import restore
from service.store.reads import particles, results_after
from service.store.writes import add_revision

LONGER = (*INDEXED_FIELDS, "supported_share", "min_box_mm", "time_is_doubtful")
"""The list of another release."""
COLUMNS = "seq, kind, sieve_size_mm, supported_share, min_box_mm, time_is_doubtful"


def stone(number: int, **fields: Any) -> dict[str, Any]:
    """Return a record whose numbers are not those of the others."""
    return measured(sieve_size_mm=10.0 + number, supported_share=number / 3, zingg_class="rod", **fields)


async def fill(store: Store, first: int = 1) -> None:
    """Add a stone, one with a revision, one in a lot whose result is removed, one that is rejected, and a ball."""
    session = await store.begin_session({})
    await add(store, session, first, stone(first))
    again = await add(store, session, first + 1, stone(first + 1))
    await store.write(save_product, "basalt", ProductDefinition(title="8/16", density_kg_m3=2700), "anna")
    await store.write(open_lot, LotDefinition(lot=f"L{first}"), "basalt", None, "anna")
    kept = await add(store, session, first + 2, stone(first + 2))
    await store.write(close_lot, f"L{first}", None, "anna")
    await add(store, session, first + 3, rejected("empty"))
    await store.record_triggers(session, {"ball": trigger(first + 4, BundleKind.BALL)})
    await store.finish(session, "ball", stone(first + 4))
    await store.write(revise, store.particles_dir, again, stone(first + 10))
    await store.write(lambda base: base.execute("DELETE FROM results WHERE seq = ?", (kept,)))


def revise(connection: sqlite3.Connection, particles_dir: Path, seq: int, record: dict[str, Any]) -> None:
    (name,) = connection.execute("SELECT id FROM results WHERE seq = ?", (seq,)).fetchone()
    assert add_revision(connection, particles_dir, name, record, {}) is not None


def rows(state_dir: Path) -> list[tuple[Any, ...]]:
    """Return the rows of some fields in the database."""
    with schema.connect_reader(state_dir / "results.sqlite") as connection:
        return connection.execute(f"SELECT {COLUMNS} FROM indexed_fields ORDER BY seq").fetchall()  # noqa: S608 - above


def columns(state_dir: Path) -> set[str]:
    with schema.connect_reader(state_dir / "results.sqlite") as connection:
        return {name for name, _ in indexed_fields.columns(connection)}


async def test_a_field_that_is_added_is_filled_from_the_records_at_the_next_start(
    state_dir: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        await fill(store)
        before = (await store.read(results_after, 0, 100)).items
    assert columns(state_dir) == set(INDEXED_FIELDS)
    monkeypatch.setattr(indexed_fields, "INDEXED_FIELDS", LONGER)
    monkeypatch.setattr(indexed_fields, "STEP", 2)
    with caplog.at_level("INFO"), await asyncio.to_thread(open_store, state_dir) as store:
        assert store.incidents == []
        assert (await store.read(results_after, 0, 100)).items == before
        listed = await store.read(particles, ParticleFilter(), None, 4)
        assert [each["seq"] for each in listed] == [5, 4, 6, 1]  # a page is full whatever was removed
        rods = await store.read(particles, ParticleFilter(zingg_class="rod"), None, 4)
        assert [each["seq"] for each in rods] == [6, 1]  # balls have a form, and are no stones
    assert "indexes supported_share, min_box_mm, time_is_doubtful: up to result 2 of 5" in caplog.text
    assert rows(state_dir) == [
        (1, "particle", 11.0, 1 / 3, "[30.0,20.0,10.0]", 0),
        (2, "particle", 21.0, 11 / 3, "[30.0,20.0,10.0]", 0),
        (3, "particle", 13.0, None, None, None),  # the record is gone
        (4, "particle", None, None, None, 0),
        (5, "ball", 15.0, 5 / 3, "[30.0,20.0,10.0]", 0),
    ]


async def test_a_release_with_a_shorter_list_loses_nothing(
    state_dir: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with monkeypatch.context() as newer:
        newer.setattr(indexed_fields, "INDEXED_FIELDS", LONGER)
        with await asyncio.to_thread(open_store, state_dir) as store:
            await fill(store)
            backup = await store.back_up(keep=1)
    first = rows(state_dir)
    assert first[2] == (3, "particle", 13.0, 1.0, "[30.0,20.0,10.0]", 0)  # of the record that is gone
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert store.incidents == []
        await fill(store, 11)  # the other release's columns are filled as well
    both = rows(state_dir)
    assert both[:5] == first
    assert [row[3] for row in both[5:]] == [11 / 3, 7.0, 13 / 3, None, 5.0]
    with monkeypatch.context() as newer, caplog.at_level("INFO"):
        newer.setattr(indexed_fields, "INDEXED_FIELDS", LONGER)
        with await asyncio.to_thread(open_store, state_dir) as store:
            assert store.incidents == []
    assert "indexes" not in caplog.text
    assert rows(state_dir) == both
    await asyncio.to_thread(restore, backup, state_dir)
    assert rows(state_dir) == first


KILLED = """
import logging, os, signal, sys
from pathlib import Path
from service.store import indexed_fields, open_store

class Kill(logging.Handler):
    def emit(self, record):
        if "up to result 3 of" in record.getMessage():
            os.kill(os.getpid(), signal.SIGKILL)

logging.basicConfig(level=logging.INFO, handlers=[Kill()])
indexed_fields.INDEXED_FIELDS += ("supported_share", "min_box_mm", "time_is_doubtful")
indexed_fields.STEP = 1
open_store(Path(sys.argv[1]))
"""


@pytest.mark.full
async def test_a_start_that_is_killed_while_it_fills_columns_is_gone_on_with(
    state_dir: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        await fill(store)
    killed = await asyncio.to_thread(subprocess.run, [sys.executable, "-c", KILLED, str(state_dir)])
    assert killed.returncode == -signal.SIGKILL
    assert [row[3] for row in rows(state_dir)] == [1 / 3, 11 / 3, None, None, None]
    with caplog.at_level("INFO"), await asyncio.to_thread(open_store, state_dir) as store:
        assert store.incidents == []  # by whichever release
    assert [row[3] for row in rows(state_dir)] == [1 / 3, 11 / 3, None, None, 5 / 3]
    assert "up to result 2 of" not in caplog.text
    caplog.clear()
    monkeypatch.setattr(indexed_fields, "INDEXED_FIELDS", LONGER)
    with caplog.at_level("INFO"), await asyncio.to_thread(open_store, state_dir) as store:
        assert store.incidents == []
    assert "indexes" not in caplog.text


async def test_rows_of_the_schema_before_are_kept_and_balls_are_added(state_dir: Path) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        await fill(store)
    wanted = copies(state_dir)
    assert [row[1] for row in wanted] == [*4 * ["particle"], "ball"]
    to_schema_14(state_dir / "results.sqlite")
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert store.incidents == []
    assert copies(state_dir) == wanted


def copies(state_dir: Path) -> list[tuple[Any, ...]]:
    """Return all columns, in the order of the list."""
    names = ", ".join(("seq", "kind", "id", "lot", "n_stones", *INDEXED_FIELDS))
    with schema.connect_reader(state_dir / "results.sqlite") as connection:
        return connection.execute(f"SELECT {names} FROM indexed_fields ORDER BY seq").fetchall()  # noqa: S608 - ours


def to_schema_14(database: Path) -> None:
    """Replace a database by one of schema 14 with the same rows."""
    today = database.rename(database.with_name("today.sqlite"))
    scripts = (path for path in files("service.store").iterdir() if path.name.endswith(".sql"))
    first = sorted(scripts, key=lambda path: path.name)[:14]
    with closing(sqlite3.connect(database, isolation_level=None)) as old:
        old.executescript("".join(script.read_text(encoding="utf-8") for script in first))
        old.execute("ATTACH ? AS today", (str(today),))
        for table, names in (
            *((name, "*") for name in ("store", "sessions", "products", "lots", "triggers")),
            ("results", "seq, id, trigger, session, record"),
            *((name, "*") for name in ("revisions", "removed_results", "audit")),
        ):
            if names == "*":  # of that schema
                names = ", ".join(row[1] for row in old.execute(f"PRAGMA main.table_info({table})"))
            old.execute(f"INSERT INTO {table} ({names}) SELECT {names} FROM today.{table}")  # noqa: S608 - above
        names = ", ".join(row[1] for row in old.execute("PRAGMA main.table_info(stones)"))
        old.execute(  # whose results are gone
            f"INSERT INTO stones ({names}) SELECT {names} FROM today.stones WHERE seq NOT IN (SELECT seq FROM results)"  # noqa: S608 - above
        )
        old.execute("PRAGMA user_version = 14")


def test_what_a_gradation_needs_is_indexed() -> None:
    assert set(MEASURED_COLUMNS) <= set(INDEXED_FIELDS)


@pytest.mark.parametrize(
    ("query", "plan"),
    [
        (  # stones of a month, by outcome
            "SELECT sum(n_stones), sum(outcome = 'measured') FROM stones WHERE captured_at BETWEEN 'a' AND 'b'",
            ["SEARCH indexed_fields USING COVERING INDEX indexed_by_time (captured_at>? AND captured_at<?)"],
        ),
        (  # of the last minute
            "SELECT count(*) FROM results JOIN stones USING (seq)"
            " WHERE json_extract(record, '$.recorded_at') >= 'a' AND stones.outcome = 'measured'",
            [
                "SEARCH results USING INDEX results_by_commit (<expr>>?)",
                "SEARCH indexed_fields USING INTEGER PRIMARY KEY (rowid=?)",
            ],
        ),
        (
            "SELECT volume_mm3 FROM stones WHERE lot = 'L1' ORDER BY seq",
            ["SEARCH indexed_fields USING INDEX stones_by_lot (lot=?)"],
        ),
    ],
)
def test_stones_are_found_by_an_index(tmp_path: Path, query: str, plan: list[str]) -> None:
    schema.prepare(tmp_path / "results.sqlite")
    with schema.connect_reader(tmp_path / "results.sqlite") as connection:
        assert [row[3] for row in connection.execute(f"EXPLAIN QUERY PLAN {query}")] == plan


@pytest.mark.parametrize("wanted", [ParticleFilter(), ParticleFilter(outcome="measured", zingg_class="rod")])
def test_a_page_of_particles_is_looked_for_from_the_newest_on(tmp_path: Path, wanted: ParticleFilter) -> None:
    schema.prepare(tmp_path / "results.sqlite")
    with schema.connect_reader(tmp_path / "results.sqlite") as connection:
        asked: list[str] = []
        connection.set_trace_callback(asked.append)
        particles(connection, wanted, 500, 10)
        connection.set_trace_callback(None)
        plan = [row[3] for row in connection.execute(f"EXPLAIN QUERY PLAN {asked[0]}")]
    assert "SEARCH indexed_fields USING INTEGER PRIMARY KEY (rowid<?)" in plan
    assert not any("SCAN" in step or "B-TREE" in step for step in plan)
