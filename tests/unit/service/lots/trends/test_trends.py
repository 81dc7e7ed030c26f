"""Trends over hours, the crusher's diary, and what has changed since its entries."""

import json
import sqlite3
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from support.fallen import fall

from pipeline.frames import rfc3339
from pipeline.gradation.estimates import State
from pipeline.gradation.sieves import OF_THE_RIG
from service.base.language import Language
from service.lots.stones import stones_between, stretch, times_of
from service.lots.trends.changes import ChangedFigure, EntryChanges, FigureChange, changes
from service.lots.trends.diary import DiaryKind, DiaryRequest, FutureEntryError, entries, note_entry
from service.lots.trends.trend import bucket_s_of, trend
from service.reports.changes import sentence, with_sentences
from service.reports.words import words
from service.store.indexed_fields import index_results
from service.store.schema import connect, prepare
from service.store.writes import begin_session

NOON = datetime(2026, 3, 2, 12, 0, tzinfo=UTC)
EVER = ("2000-01-01T00:00:00.000Z", "2100-01-01T00:00:00.000Z")


@pytest.fixture
def connection(tmp_path: Path) -> Iterator[sqlite3.Connection]:
    prepare(tmp_path / "results.sqlite")
    connection = connect(tmp_path / "results.sqlite")
    yield connection
    connection.close()


def at(hours: float) -> datetime:
    """Return a time so many hours after noon."""
    return NOON + timedelta(hours=hours)


def note(connection: sqlite3.Connection, hours: float, kind: DiaryKind = DiaryKind.LINER) -> None:
    note_entry(connection, DiaryRequest(kind=kind, at=rfc3339(at(hours))), "key op")


def found(connection: sqlite3.Connection, hours: float = 24.0, now: float = 0.0) -> list[EntryChanges]:
    return changes(connection, rfc3339(at(now)), hours, OF_THE_RIG).items


def of(entry: EntryChanges, name: ChangedFigure) -> FigureChange:
    return next(each for each in entry.figures if each.figure is name)


def test_the_stones_of_a_stretch_are_those_of_a_lot_in_the_order_of_time(
    connection: sqlite3.Connection,
) -> None:
    fall(connection, at(0), 10)
    whole = stretch(connection, *EVER, 10_000)
    assert (whole.n_stones, whole.n_measured) == (600, 540)
    expected = stones_between(connection, *EVER).lot
    assert np.array_equal(whole.lot.measures, expected.measures, equal_nan=True)
    times = times_of(connection, *EVER)
    assert len(times) == 600
    assert (times[1:] >= times[:-1]).all()
    assert times[0] == pytest.approx(NOON.timestamp(), abs=2)
    part = stretch(connection, *EVER, 100)
    assert (part.n_stones, part.n_measured) == (600, 540)
    assert 60 <= part.lot.n_measured <= 100


def test_a_trend_has_every_bucket_and_what_fell_in_it(connection: sqlite3.Connection) -> None:
    fall(connection, at(-1), 20, per_min=30)
    note(connection, -0.5)
    note(connection, -3)
    found = trend(connection, rfc3339(at(0)), 1, OF_THE_RIG)
    assert (found.bucket_s, len(found.buckets)) == (120, 30)
    assert (found.since, found.until) == (rfc3339(at(-1)), rfc3339(at(0)))
    assert [bucket.n_stones for bucket in found.buckets] == [60] * 10 + [0] * 20
    assert found.buckets[0].stones_per_min == 30
    assert found.buckets[0].d50_mm.value == pytest.approx(13, abs=2)
    assert found.buckets[0].shape_percent.state is State.INSUFFICIENT
    assert found.buckets[-1].d50_mm.state is State.NOT_MEASURED
    assert [entry.at for entry in found.diary] == [rfc3339(at(-0.5))]
    later = trend(connection, rfc3339(at(0) + timedelta(seconds=45)), 1, OF_THE_RIG)
    assert later.buckets[1] == found.buckets[1]  # the same edges
    assert later.buckets[-1].since == rfc3339(at(0))


def test_stones_of_a_replay_count_when_their_results_came(connection: sqlite3.Connection) -> None:
    session = begin_session(connection, {"is_replay": True})
    fall(connection, at(-10_000), 1, per_min=30)  # while it was recorded
    fell = connection.execute("SELECT * FROM stones ORDER BY seq")
    columns = [column for column, *_ in fell.description]
    records = [dict(zip(columns, row, strict=True)) | {"kind": "particle"} for row in fell]
    connection.execute("DELETE FROM indexed_fields")  # its results get rows anew
    for record in records:
        seq, came = record["seq"], {"recorded_at": rfc3339(at(-0.5) + timedelta(seconds=record["seq"]))}
        connection.execute(
            "INSERT INTO triggers (trigger, session, bundle, sequence, kind, captured_at, state)"
            " VALUES (?, ?, ?, ?, 'particle', ?, 'measured')",
            (seq, session, record["id"], seq, record["captured_at"]),
        )
        connection.execute(
            "INSERT INTO results (seq, id, trigger, session, record) VALUES (?, ?, ?, ?, ?)",
            (seq, record["id"], seq, session, json.dumps(record | came)),
        )
        index_results(connection, "seq = ?", seq)
    buckets = trend(connection, rfc3339(at(0)), 1, OF_THE_RIG).buckets
    assert [(bucket.n_stones, bucket.measured) for bucket in buckets if bucket.n_stones] == [(30, 27)]
    times = times_of(connection, rfc3339(at(-1)), rfc3339(at(0)))
    assert times[0] == pytest.approx(at(-0.5).timestamp() + 1, abs=0.01)
    assert len(times) == 30
    within = stones_between(connection, rfc3339(at(-1)), rfc3339(at(0)))
    assert (within.lot.n_measured, len(within.measured_ids)) == (27, 27)
    assert stones_between(connection, rfc3339(at(-10_000)), rfc3339(at(-9_999))).lot.n_measured == 0


@pytest.mark.parametrize(("hours", "bucket_s"), [(1, 120), (12, 900), (24, 1800), (720, 86_400)])
def test_buckets_are_few(hours: float, bucket_s: int) -> None:
    assert bucket_s_of(hours) == bucket_s


@pytest.mark.full
def test_a_new_shape_since_a_liner_change_is_significant_and_said_so(connection: sqlite3.Connection) -> None:
    next_seq = fall(connection, at(-4), 120, per_min=60)
    fall(connection, at(-2), 115, per_min=60, long_share=0.24, first_seq=next_seq, seed=1)
    note(connection, -2)
    (entry,) = found(connection)
    shape, rate = of(entry, ChangedFigure.SHAPE), of(entry, ChangedFigure.RATE)
    assert shape.is_significant
    assert shape.low is not None
    assert shape.high is not None
    assert 0 < shape.low < 6 < shape.high < 12
    assert not rate.is_significant
    assert rate.before == pytest.approx(60, rel=0.02)
    assert (entry.before_since, entry.after_until) == (rfc3339(at(-14)), rfc3339(at(0)))
    (english,) = with_sentences(
        changes(connection, rfc3339(at(0)), 24, OF_THE_RIG), Language.ENGLISH, rfc3339(at(0)), UTC
    ).items
    assert of(english, ChangedFigure.SHAPE).sentence == (
        f"Shape index up {shape.difference:.1f} points since the liner change of 10:00, significant"
    )
    (german,) = with_sentences(
        changes(connection, rfc3339(at(30)), 48, OF_THE_RIG), Language.GERMAN, rfc3339(at(30)), UTC
    ).items
    sentence = of(german, ChangedFigure.SHAPE).sentence
    assert sentence.startswith(
        "Kornformkennzahl seit dem Wechsel der Brechwerkzeuge von 02.03.2026 10:00 um "
    )
    assert sentence.endswith(" Punkte gestiegen, signifikant")


def test_what_is_compared_ends_at_the_neighbouring_entries(connection: sqlite3.Connection) -> None:
    fall(connection, at(-5), 300, per_min=20)
    for hours in (-4, -3, -1):
        note(connection, hours, DiaryKind.GAP)
    entries = found(connection)
    assert [(each.before_since, each.after_until) for each in entries] == [
        (rfc3339(at(-3)), rfc3339(at(0))),
        (rfc3339(at(-4)), rfc3339(at(-1))),
        (rfc3339(at(-16)), rfc3339(at(-3))),
    ]
    assert not any(figure.is_significant for each in entries for figure in each.figures)
    assert [each.before_since for each in found(connection, hours=2)] == [rfc3339(at(-3))]


def test_few_stones_are_not_judged_and_none_are_not_measured(connection: sqlite3.Connection) -> None:
    fall(connection, at(-1), 20, per_min=2)
    note(connection, -0.8)
    (entry,) = found(connection)
    assert {each.state for each in entry.figures} == {State.INSUFFICIENT}
    assert not any(each.is_significant for each in entry.figures)
    note(connection, -0.1)
    newest = found(connection)[0]
    assert (newest.n_after, of(newest, ChangedFigure.D50).state) == (0, State.NOT_MEASURED)
    said = with_sentences(
        changes(connection, rfc3339(at(0)), 24, OF_THE_RIG), Language.ENGLISH, rfc3339(at(0)), UTC
    )
    assert (
        of(said.items[0], ChangedFigure.RATE).sentence == "Rate since the liner change of 11:54: not measured"
    )
    assert of(said.items[1], ChangedFigure.RATE).sentence.endswith("11:12: too few stones to tell")


def test_the_diary_is_never_of_the_future_and_leaves_event_and_audit(connection: sqlite3.Connection) -> None:
    noted = note_entry(connection, DiaryRequest(kind=DiaryKind.GAP, value=25.0, text="worn bars"), "key op")
    assert (noted.entry, noted.at) == (1, noted.noted_at)
    (event,) = connection.execute("SELECT type, subject, data ->> 'value' FROM events")
    assert event == ("diary.noted", "1", 25.0)
    assert list(connection.execute("SELECT who, action, subject FROM audit")) == [
        ("key op", "diary noted", "1")
    ]
    with pytest.raises(FutureEntryError):
        note_entry(connection, DiaryRequest(kind=DiaryKind.GAP, at=EVER[1]), "key op")
    assert len(entries(connection, None, None, 10)) == 1
    assert entries(connection, None, noted.at, 10) == []


def test_what_is_too_small_to_be_told_is_not_called_significant() -> None:
    tiny = FigureChange(figure=ChangedFigure.D50, state=State.MEASURED, difference=0.001, is_significant=True)
    assert sentence(tiny, "the liner change", words(Language.ENGLISH)).endswith("as before the liner change")
