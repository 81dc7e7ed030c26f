"""Shifts, by the host's local time."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, time, timedelta
from itertools import pairwise

from pipeline.gradation.sieves import OF_THE_RIG, MeasuredRange
from service.base.language import Language


@dataclass(frozen=True, slots=True, kw_only=True)
class LotsSettings:
    """`[lots]` of the configuration: sizes that are measured, when shifts begin, the language of issued reports."""

    min_mm: float = OF_THE_RIG.min_mm  # smaller stones may pass unseen: their passing is not measured
    max_mm: float = OF_THE_RIG.max_mm  # larger ones may be cut
    shift_starts: tuple[str, ...] = ("06:00", "14:00", "22:00")
    report_language: Language = Language.ENGLISH  # of the report that is issued when a lot is complete
    no_stones_min: float | None = None  # armed and with an open lot, so long without a stone is an alarm

    def __post_init__(self) -> None:
        if not 0 <= self.min_mm < self.max_mm:
            raise ValueError(
                f"min_mm must be at least 0 and below max_mm, not {self.min_mm:g} and {self.max_mm:g}"
            )
        if self.no_stones_min is not None and not 0 < self.no_stones_min <= 1440:
            raise ValueError(f"no_stones_min must be above 0 and at most 1440, not {self.no_stones_min:g}")
        if not self.shift_starts:
            raise ValueError("shift_starts needs one time at least")
        for start in self.shift_starts:
            if not re.fullmatch(r"([01][0-9]|2[0-3]):[0-5][0-9]", start):
                raise ValueError(f"shift_starts are times such as 06:00, not {start!r}")

    @property
    def measured(self) -> MeasuredRange:
        """Sizes between which every stone is measured."""
        return MeasuredRange(min_mm=self.min_mm, max_mm=self.max_mm)


NAME = "%Y-%m-%d-%H%M"
"""Name of a shift: when it begins, by the host's local time."""
MAX_AGO = 1000
"""Shifts that can be named, the newest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shift:
    """A shift; times are local."""

    since: datetime
    until: datetime

    @property
    def name(self) -> str:
        """Name of the shift, such as `2026-03-02-0600`."""
        return f"{self.since:{NAME}}"


def shift_at(now: datetime, starts: Sequence[str], ago: int = 0) -> Shift:
    """Return the present shift, or the one so many shifts ago; `now` is a local time.

    Local times are kept over a change to or from summer time, on whose day a shift is an hour shorter or longer. A
    start that the clock skips is an hour later by the clock, one that comes twice is the first; of two starts at one
    moment there is one.
    """
    return shifts_before(now, starts, ago + 1)[-1]


def shifts_before(now: datetime, starts: Sequence[str], n_shifts: int) -> list[Shift]:
    """Return the present shift and those before it, `n_shifts` in all, the newest first; `now` is a local time."""
    times = sorted({time.fromisoformat(start) for start in starts})
    days = n_shifts // len(times) + 3  # a day of a change may have a shift less
    dates = (now.date() + timedelta(days=day) for day in range(-days, 3))
    begins = sorted({_moment(datetime.combine(date, each)) for date in dates for each in times})
    present = max(number for number, begin in enumerate(begins) if begin <= now)
    oldest = present + 1 - n_shifts
    return [Shift(since=since, until=until) for since, until in pairwise(begins[oldest : present + 2])][::-1]


def shift_named(name: str, now: datetime, starts: Sequence[str]) -> Shift | None:
    """Return the shift of a name, None if none has it or it has not begun; `now` is a local time."""
    try:
        begin = _moment(datetime.strptime(name, NAME))
    except (ValueError, OverflowError):
        return None
    if not now - timedelta(days=MAX_AGO) <= begin <= now:
        return None
    found = shift_at(begin, starts)
    return found if found.name == name else None


def _moment(local: datetime) -> datetime:
    """Return a local time with its zone; `astimezone` alone takes one that the clock skips for an hour too early."""
    return datetime.fromtimestamp(local.timestamp(), UTC).astimezone()
