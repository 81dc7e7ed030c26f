"""Shifts by local time."""

from datetime import UTC, datetime, timedelta
from itertools import pairwise

import pytest

from service.lots.shifts import LotsSettings, shift_at

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
    assert shift_at(at(now), STARTS, ago) == (at(begin), at(end))


def test_shifts_follow_one_another() -> None:
    now = datetime.now(UTC).astimezone()
    shifts = [shift_at(now, STARTS, ago) for ago in range(30)]
    assert all(later[0] == earlier[1] for later, earlier in pairwise(shifts))
    assert shifts[0][0] <= now < shifts[0][1]
    begin, end = shift_at(now, ("06:00",), 0)
    assert timedelta(hours=23) <= end - begin <= timedelta(hours=25)


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
