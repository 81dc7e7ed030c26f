"""What retention takes, in which order, and what it must not take; on a store with any clock and any disk."""

import math
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from support.outcomes import add, measured, rejected
from support.rest import particle_files

from service.store import Store
from service.store.accounting import accounting
from service.store.checks import days_until_full, store_use
from service.store.reads import particle, results_after
from service.store.retention import (
    STEP,
    Disk,
    RetentionLimits,
    consumers,
    files_going,
    is_older,
    mark_files,
    note_gone,
    park,
    pin,
    remove_results,
)

WIDE = Disk(total_bytes=10**12, free_bytes=10**11)
NOW = datetime.now(UTC)
LATER = NOW + timedelta(days=40)


async def fill(store: Store, session: int, folder: Path, n: int) -> None:
    for number in range(1, n + 1):
        await add(store, session, number, measured(), particle_files(folder / "out"))


async def states(store: Store) -> list[Any]:
    """Return why the files of each result that is left were removed."""
    return [item["files_removed"] for item in (await store.read(results_after, 0, 100)).items]


async def remove_files(store: Store) -> None:
    """Note all files that are going as gone."""
    while going := await store.read(files_going):
        await store.write(note_gone, [seq for seq, _ in going])


async def test_without_a_limit_nothing_goes(store: Store, session: int, tmp_path: Path) -> None:
    await fill(store, session, tmp_path, 3)
    limits = RetentionLimits(min_free_gb=0)
    assert await store.write(mark_files, limits, Disk(10**12, 0), LATER) == 0
    assert await store.write(remove_results, limits, LATER) == 0


async def test_files_go_by_age_the_oldest_first_and_numbers_stay(
    store: Store, session: int, tmp_path: Path
) -> None:
    await fill(store, session, tmp_path, 3)
    await add(store, session, 4, rejected("empty"))
    limits = RetentionLimits(files_days=30)
    assert await store.write(mark_files, limits, WIDE, NOW + timedelta(days=29)) == 0
    assert await store.write(mark_files, limits, WIDE, LATER) == 4
    assert await states(store) == ["age"] * 4
    assert [seq for seq, _ in await store.read(files_going)] == [1, 2, 3, 4]
    await remove_files(store)
    assert await store.read(files_going) == []
    assert (await store.read(store_use, limits, WIDE, LATER)).files_bytes == 0
    assert await store.write(remove_results, limits, LATER) == 0


@pytest.mark.parametrize(
    ("disk", "limits"),
    [
        (Disk(10**12, 2 * 10**9 - 1), RetentionLimits(min_free_gb=2)),
        (Disk(10**12, 10**11 - 1), RetentionLimits(min_free_percent=10)),
        (WIDE, RetentionLimits(max_files_gb=0)),  # filled in below
    ],
)
async def test_as_many_go_as_are_needed_for_space(
    store: Store, session: int, tmp_path: Path, disk: Disk, limits: RetentionLimits
) -> None:
    await fill(store, session, tmp_path, 3)
    if disk is WIDE:
        size = (await store.read(store_use, limits, WIDE, NOW)).files_bytes
        limits = RetentionLimits(max_files_gb=(size - 1) / 1e9)
    assert await store.write(mark_files, limits, disk, NOW) == 1
    assert await states(store) == ["space", None, None]
    # what is going counts as gone, until it is and the disk is measured again
    assert await store.write(mark_files, limits, disk, NOW) == 0


async def test_steps_are_small(store: Store, session: int, tmp_path: Path) -> None:
    await fill(store, session, tmp_path, STEP + 3)
    limits = RetentionLimits(files_days=1, results_days=2)
    assert await store.write(mark_files, limits, WIDE, LATER) == STEP
    assert await store.write(mark_files, limits, WIDE, LATER) == 3
    await remove_files(store)
    assert await store.write(remove_results, limits, LATER) == STEP
    assert await store.write(remove_results, limits, LATER) == 2


async def test_results_leave_the_feed_without_a_gap_and_the_accounting_keeps_their_counts(
    store: Store, session: int, tmp_path: Path
) -> None:
    await fill(store, session, tmp_path, 3)
    for number, reason in ((4, "empty"), (5, "multiple"), (6, "empty")):
        await add(store, session, number, rejected(reason))
    before = await store.read(accounting, session)
    limits = RetentionLimits(results_days=30)  # files go with their results at the latest
    await store.write(mark_files, limits, WIDE, LATER)
    assert await store.write(remove_results, limits, LATER) == 5  # the newest stays
    page = await store.read(results_after, 0, 10)
    assert (page.first_seq, page.last_seq) == (6, 6)
    assert await store.read(particle, 1) is not None  # not before its files
    await remove_files(store)
    await store.write(remove_results, limits, LATER)
    assert await store.read(particle, 1) is None
    assert await store.read(accounting, session) == before
    assert await store.read(accounting, None) == before
    assert before.is_balanced
    assert await add(store, session, 7, measured()) == 7


async def test_a_pinned_result_keeps_row_and_files_until_it_is_unpinned(
    store: Store, session: int, tmp_path: Path
) -> None:
    await fill(store, session, tmp_path, 4)
    await store.write(pin, 2, "dispute with the customer", "key mes")
    limits = RetentionLimits(files_days=10, results_days=20)

    async def retain() -> None:
        await store.write(mark_files, limits, WIDE, LATER)
        await remove_files(store)
        await store.write(remove_results, limits, LATER)

    await retain()
    record = await store.read(particle, 2)
    assert record is not None
    assert (record["is_pinned"], record["pin_reason"]) == (True, "dispute with the customer")
    assert record["files_removed"] is None
    page = await store.read(results_after, 3, 10)
    assert (page.first_seq, [item["seq"] for item in page.items]) == (4, [4])
    await store.write(pin, 2, None, "key mes")
    await retain()
    assert await store.read(particle, 2) is None


async def test_a_consumer_holds_what_it_has_not_read_but_not_for_ever(
    store: Store, session: int, tmp_path: Path
) -> None:
    for number in range(1, 7):
        await add(store, session, number, rejected("empty"))
    await store.write(park, "mes", 2)
    await store.write(park, "quick", 5)
    limits = RetentionLimits(results_days=39, consumer_days=7)
    assert await store.write(remove_results, limits, LATER) == 2
    assert await store.write(remove_results, limits, LATER) == 0
    assert not any(consumer.is_overrun for consumer in await store.read(consumers))
    assert await store.write(remove_results, limits, NOW + timedelta(days=45)) == 0
    assert await store.write(remove_results, limits, NOW + timedelta(days=47)) == 3
    mes, quick = await store.read(consumers)
    assert (mes.name, mes.unread, mes.is_overrun) == ("mes", 4, True)
    assert (quick.name, quick.is_overrun) == ("quick", False)
    assert (await store.read(results_after, 5, 10)).first_seq == 6


def test_times_that_are_not_known_are_in_doubt() -> None:
    assert not is_older("1970-01-01T00:00:00.000Z", 1, NOW)
    assert not is_older("2026-01-01T00:00:00.000Z", 0, NOW)
    assert is_older("2021-01-01T00:00:00.000Z", 1, datetime(2026, 1, 1, tzinfo=UTC))


@pytest.mark.parametrize(
    ("spare", "growths", "days"),
    [
        (100.0, [(10.0, math.inf)], 10.0),
        (100.0, [(10.0, math.inf), (40.0, math.inf)], 2.0),
        (100.0, [(40.0, 40.0), (10.0, math.inf)], 6.0),  # one day of both, then the rest of 50 by one of them
        (100.0, [(40.0, 40.0)], None),
        (100.0, [], None),
        (-5.0, [(10.0, math.inf)], 0.0),
    ],
)
def test_days_until_the_disk_is_full(
    spare: float, growths: list[tuple[float, float]], days: float | None
) -> None:
    assert days_until_full(spare, growths) == days


async def test_days_left_follow_from_what_was_measured(store: Store, session: int, tmp_path: Path) -> None:
    limits = RetentionLimits(min_free_gb=0)
    assert (await store.read(store_use, limits, WIDE, NOW)).days_left is None
    await fill(store, session, tmp_path, 10)
    captured = datetime(2026, 2, 28, 23, 0, tzinfo=UTC)  # of the fake triggers, a minute apart
    assert (await store.read(store_use, limits, WIDE, captured + timedelta(minutes=20))).days_left is None
    use = await store.read(store_use, limits, WIDE, captured + timedelta(hours=12, minutes=1))
    assert use.days_left is not None
    assert use.days_left == pytest.approx(1e11 / (2 * (use.files_bytes + use.results_bytes)), rel=0.01)
    capped = RetentionLimits(min_free_gb=0, max_files_gb=1, results_days=365)
    use = await store.read(store_use, capped, WIDE, captured + timedelta(hours=12, minutes=1))
    assert use.days_left is None  # limits are reached long before the end of the disk


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"files_days": -1.0}, "files_days must be in 0..36500, not -1"),
        ({"min_free_percent": 101.0}, "min_free_percent must be in 0..100, not 101"),
        ({"max_files_gb": math.nan}, "max_files_gb must be in"),
        ({"files_days": 9.0, "results_days": 3.0}, "files_days must not exceed results_days, 3, not 9"),
    ],
)
def test_wrong_limits_are_named(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RetentionLimits(**wrong)
