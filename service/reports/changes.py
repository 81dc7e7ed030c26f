"""Changes since an entry of the crusher's diary, in a sentence."""

import sqlite3
from datetime import datetime, timedelta, tzinfo

from pipeline.gradation.estimates import State
from pipeline.gradation.sieves import MeasuredRange
from service.base.language import Language
from service.lots.trends.changes import ChangedFigure, Changes, EntryChanges, FigureChange, changes
from service.reports.words import Words, words

DECIMALS = {ChangedFigure.D50: 2}
"""Decimals of a figure's amount; 1 of the others."""
RECENT = timedelta(hours=20)
"""An earlier entry is named with its day."""


def told_changes(
    connection: sqlite3.Connection, now: str, hours: float, measured: MeasuredRange, language: Language
) -> Changes:
    """Return the changes since each entry of the diary of the last hours, with their sentences."""
    return with_sentences(changes(connection, now, hours, measured), language, now)


def with_sentences(found: Changes, language: Language, now: str, zone: tzinfo | None = None) -> Changes:
    """Return the changes with their sentences; clock times are of `zone`, by default the host's."""
    say = words(language)
    return found.model_copy(update={"items": [_said(each, say, now, zone) for each in found.items]})


def _said(changed: EntryChanges, say: Words, now: str, zone: tzinfo | None) -> EntryChanges:
    at, present = (datetime.fromisoformat(each).astimezone(zone) for each in (changed.entry.at, now))
    clock = at.strftime(say("trend.clock" if present - at < RECENT else "trend.moment"))
    entry = say(f"since.{changed.entry.kind}", at=clock)
    figures = [each.model_copy(update={"sentence": sentence(each, entry, say)}) for each in changed.figures]
    return changed.model_copy(update={"figures": figures})


def sentence(change: FigureChange, entry: str, say: Words) -> str:
    """Return the sentence on one figure; `entry` says since what, such as "the liner change of 06:10"."""
    figure = say.known("changed", change.figure)
    if change.state is State.NOT_MEASURED or change.difference is None:
        return say("change.not_measured", figure=figure, entry=entry)
    if change.state is State.INSUFFICIENT:
        return say("change.few", figure=figure, entry=entry)
    decimals = DECIMALS.get(change.figure, 1)
    value = say.number(abs(change.difference), decimals)
    if value == say.number(0.0, decimals):  # significant or not: too small to be told
        return say("change.same", figure=figure, entry=entry)
    judgement = say("change.significant" if change.is_significant else "change.not_significant")
    amount = say(f"amount.{change.figure}", value=value)
    way = "change.up" if change.difference > 0 else "change.down"
    return say(way, figure=figure, amount=amount, entry=entry, judgement=judgement)
