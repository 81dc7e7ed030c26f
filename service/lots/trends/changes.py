"""Changes since an entry of the diary: figures before and after it, and their significance."""

import sqlite3
from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta
from enum import StrEnum

from pydantic import Field

from pipeline.frames import rfc3339
from pipeline.gradation.differences import Difference, difference_in_time, significant
from pipeline.gradation.estimates import State
from pipeline.gradation.influences import Influences, rate_influences, share_influences, size_influences
from pipeline.gradation.sieves import MeasuredRange
from service.base.schema import Time
from service.base.status import Report
from service.lots.comparing import ends_of
from service.lots.figures import SHARES
from service.lots.stones import stretch, times_of
from service.lots.trends.diary import DiaryEntry, entries

MAX_SIDE = timedelta(hours=12)
"""How far before and after an entry is looked."""
MAX_STONES = 20_000
"""Stones of a side whose size and shape are looked at; of more, every so many."""
MAX_ENTRIES = 20
"""Entries that are looked at, the newest."""


class ChangedFigure(StrEnum):
    """A figure that is looked at before and after an entry."""

    D50 = "d50_mm"
    FLAKINESS = "flakiness_percent"
    SHAPE = "shape_percent"
    RATE = "stones_per_min"


class FigureChange(Report):
    """One figure before and after an entry, in the unit of its name."""

    figure: ChangedFigure = Field(
        description="`d50_mm`; `flakiness_percent`, FI of EN 933-3; `shape_percent`, SI of EN 933-4; `stones_per_min`,"
        " while the crusher runs"
    )
    state: State = Field(
        description="`insufficient`: too few stones before or after to judge; `not_measured`: one of them has no value"
    )
    before: float | None = Field(
        default=None, description="Before the entry, null where nothing was measured"
    )
    after: float | None = Field(default=None, description="After it")
    difference: float | None = Field(default=None, description="After less before")
    low: float | None = Field(default=None, description="Lower end of the 95 % interval of the difference")
    high: float | None = Field(default=None, description="Upper end of it")
    is_significant: bool = Field(
        default=False,
        description="More than chance: without a change, any of the figures of an entry is so in at most 5 % of cases"
        " (Holm). False where it cannot be judged",
    )
    sentence: str = Field(default="", description="The same for people, in the language asked for")


class EntryChanges(Report):
    """What has changed since an entry of the diary."""

    entry: DiaryEntry = Field(description="The entry")
    before_since: Time = Field(
        description="What is compared begins here: at the entry before it, at most 12 h back"
    )
    after_until: Time = Field(description="It ends here: at the next entry, at most 12 h later, or now")
    n_before: int = Field(description="Measured stones before the entry")
    n_after: int = Field(description="Measured stones after it")
    figures: list[FigureChange] = Field(description="Each figure once")


class Changes(Report):
    """What has changed since each entry of the diary."""

    items: list[EntryChanges] = Field(description="Newest entry first, at most 20")


Figures = Mapping[ChangedFigure, Influences | None]
"""The figures before or after an entry."""


def changes(connection: sqlite3.Connection, now: str, hours: float, measured: MeasuredRange) -> Changes:
    """Compare the figures before and after each entry of the last hours; `with_sentences` adds the sentences."""
    since = _moved(now, -timedelta(hours=hours))
    known = entries(connection, _moved(since, -MAX_SIDE), now, MAX_ENTRIES + 1)
    wanted = [entry for entry in known if entry.at >= since][:MAX_ENTRIES]
    times = sorted({entry.at for entry in known})
    return Changes(items=[_changes(connection, entry, times, now, measured) for entry in wanted])


def _changes(
    connection: sqlite3.Connection, entry: DiaryEntry, times: list[str], now: str, measured: MeasuredRange
) -> EntryChanges:
    since = max([_moved(entry.at, -MAX_SIDE), *(at for at in times if at < entry.at)])
    until = min([now, _moved(entry.at, MAX_SIDE), *(at for at in times if at > entry.at)])
    n_before, before = _side(connection, since, entry.at, measured)
    n_after, after = _side(connection, entry.at, until, measured)
    return EntryChanges(
        entry=entry,
        before_since=since,
        after_until=until,
        n_before=n_before,
        n_after=n_after,
        figures=list(_figure_changes(before, after)),
    )


def _side(
    connection: sqlite3.Connection, since: str, until: str, measured: MeasuredRange
) -> tuple[int, Figures]:
    found = stretch(connection, since, until, MAX_STONES)
    return found.n_measured, {
        ChangedFigure.D50: size_influences(found.lot, 50, measured),
        **{ChangedFigure(name): share_influences(found.lot, of(measured)) for name, of in SHARES.items()},
        ChangedFigure.RATE: rate_influences(times_of(connection, since, until)),
    }


def _figure_changes(before: Figures, after: Figures) -> Iterator[FigureChange]:
    pairs = {name: (before[name], after[name]) for name in ChangedFigure}
    differences = {
        name: difference_in_time(first, second)
        for name, (first, second) in pairs.items()
        if first is not None and second is not None
    }
    clear = significant({name: each.p_value for name, each in differences.items() if each.can_be_judged})
    for name, (first, second) in pairs.items():
        found = differences.get(name)
        yield FigureChange(
            figure=name,
            state=_state(found),
            before=None if first is None else first.value,
            after=None if second is None else second.value,
            **ends_of(found),
            is_significant=name in clear,
        )


def _state(difference: Difference | None) -> State:
    if difference is None:
        return State.NOT_MEASURED
    return State.MEASURED if difference.can_be_judged else State.INSUFFICIENT


def _moved(at: str, by: timedelta) -> str:
    return rfc3339(datetime.fromisoformat(at) + by)
