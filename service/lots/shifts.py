"""Shifts, by the host's local time."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, time, timedelta

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


def shift_at(now: datetime, starts: Sequence[str], ago: int) -> tuple[datetime, datetime]:
    """Return begin and end of the present shift, or of one so many shifts ago; `now` is a local time.

    Local times are kept over a change to or from summer time, on whose day a shift is an hour shorter or longer.
    """
    times = sorted(time.fromisoformat(start) for start in starts)
    days = ago // len(times) + 2
    begins = [
        datetime.combine(now.date() + timedelta(days=day), each).astimezone()
        for day in range(-days, 3)
        for each in times
    ]
    present = max(number for number, begin in enumerate(begins) if begin <= now)
    return begins[present - ago], begins[present - ago + 1]
