"""Shifts by local time."""

import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.lots import shifts as shifts_of_the_clock
from service.lots.shifts import LotsSettings, shift_at, shift_named, shifts_before

STARTS = ("22:00", "06:00", "14:00")


def at(text: str) -> datetime:
    return datetime.fromisoformat(text).astimezone()


@pytest.mark.parametrize(
    ("now", "ago", "begin", "end"),
    [
        ("2026-03-02T07:00", 0, "2026-03-02T06:00", "2026-03-02T14:00"),
        ("2026-03-02T06:00", 0, "2026-03-02T06:00", "2026-03-02T14:00"),
        ("2026-03-02T05:59", 0, "2026-03-01T22:00", "2026-03-02T06:00"),
        ("2026-03-02T23:00", 0, "2026-03-02T22:00", "2026-03-03T06:00"),
        ("2026-03-02T07:00", 1, "2026-03-01T22:00", "2026-03-02T06:00"),
        ("2026-03-02T07:00", 7, "2026-02-27T22:00", "2026-02-28T06:00"),
    ],
)
def test_a_shift_reaches_from_its_start_to_the_next_one(now: str, ago: int, begin: str, end: str) -> None:
    found = shift_at(at(now), STARTS, ago)
    assert (found.since, found.until) == (at(begin), at(end))


def test_shifts_follow_one_another() -> None:
    now = datetime.now(UTC).astimezone()
    shifts = [shift_at(now, STARTS, ago) for ago in range(30)]
    assert all(later.since == earlier.until for later, earlier in pairwise(shifts))
    assert shifts[0].since <= now < shifts[0].until
    whole_day = shift_at(now, ("06:00",))
    assert timedelta(hours=23) <= whole_day.until - whole_day.since <= timedelta(hours=25)


def test_a_list_of_shifts_takes_each_moment_once(monkeypatch: pytest.MonkeyPatch) -> None:
    moments: list[datetime] = []
    moment_of = shifts_of_the_clock._moment
    monkeypatch.setattr(
        shifts_of_the_clock, "_moment", lambda local: moments.append(local) or moment_of(local)
    )
    assert len(shifts_before(at("2026-03-02T07:00"), STARTS, 1000)) == 1000
    assert len(moments) < 1050


@pytest.fixture
def berlin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The host's local time is that of Berlin: 02:00 to 03:00 is skipped on 2026-03-29, and twice on 2026-10-25."""
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.usefixtures("berlin")
@given(
    starts=st.lists(
        st.sampled_from(("00:00", "01:59", "02:00", "02:30", "02:59", "03:00", "03:30", "14:00")), min_size=1
    ),
    day=st.sampled_from(("2026-03-29", "2026-10-25")),
    minutes=st.integers(0, 48 * 60),
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_shifts_part_the_days_on_which_the_clock_is_changed(
    starts: list[str], day: str, minutes: int
) -> None:
    """Each moment is in one shift, whose name finds it, whichever start the clock skips or repeats."""
    now = (datetime.fromisoformat(day).astimezone(UTC) + timedelta(minutes=minutes)).astimezone()
    shifts = shifts_before(now, starts, 3 * len(starts) + 3)
    assert shifts[0].since <= now < shifts[0].until
    assert all(later.since == earlier.until > earlier.since for later, earlier in pairwise(shifts))
    assert [shift_named(each.name, now, starts) for each in shifts] == shifts


@pytest.mark.usefixtures("berlin")
def test_a_skipped_start_is_after_the_change_and_a_repeated_one_is_the_first() -> None:
    skipped = shift_at(datetime(2026, 3, 29, 12, tzinfo=UTC).astimezone(), ("02:30", "14:30"))
    assert (skipped.name, skipped.since) == ("2026-03-29-0330", datetime(2026, 3, 29, 1, 30, tzinfo=UTC))
    repeated = shift_at(datetime(2026, 10, 25, 12, tzinfo=UTC).astimezone(), ("02:30", "14:30"))
    assert repeated.since == datetime(2026, 10, 25, 0, 30, tzinfo=UTC)
    assert repeated.until - repeated.since == timedelta(hours=13)


def test_no_other_name_is_that_of_a_shift() -> None:
    now = at("2026-03-02T07:00")
    assert shift_named("2026-03-02-0600", now, STARTS) == shift_at(now, STARTS)
    for other in ("2026-03-02-0700", "2026-03-02-1400", "1900-01-01-0600", "today", "2026-13-01-0600", ""):
        assert shift_named(other, now, STARTS) is None


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"shift_starts": ("6:00",)}, "6:00"),
        ({"shift_starts": ("24:00",)}, "24:00"),
        ({"shift_starts": ()}, "shift_starts"),
        ({"min_mm": 50.0}, "min_mm"),
        ({"min_mm": -1.0}, "min_mm"),
    ],
)
def test_wrong_settings_name_the_field(wrong: dict, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        LotsSettings(**wrong)
