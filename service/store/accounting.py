"""The balance of triggers: `triggers = measured + rejected + lost + in_progress`, each counted by itself."""

import sqlite3
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from pydantic import computed_field

from service.base.schema import served
from service.results.fields import Outcome

Counts = Counter[tuple[str, str, str]]
"""Number of results of each outcome, reason and quality (empty where there is none)."""


@served
class Accounting:
    """Counts of the light gate's triggers by outcome; background exposures are counted separately."""

    triggers: int
    """Stones and balls that the light gate reported."""
    measured: int
    """Triggers whose stone has a body and its measures."""
    rejected: int
    """Triggers whose views were looked at and found unfit."""
    lost: int
    """Triggers whose views were never looked at."""
    in_progress: int
    """Triggers without an outcome yet."""
    backgrounds: int
    """Exposures of the empty rig; not among the triggers."""
    by_reason: Mapping[str, int]
    """Rejected and lost triggers, by reason."""
    by_quality: Mapping[str, int]
    """Measured triggers, by quality."""

    @computed_field(description="True if the sum holds; false is a fault of the service")  # type: ignore[prop-decorator]  # pydantic asks for this order
    @property
    def is_balanced(self) -> bool:
        """True if every trigger is counted exactly once; `False` is a fault of the store."""
        return self.triggers == self.measured + self.rejected + self.lost + self.in_progress


@dataclass(frozen=True, slots=True, kw_only=True)
class OutcomeCounts:
    """Counts of all results, removed ones too, that can be asked for often: only new results are read each time."""

    up_to_seq: int = 0
    n: Counts = field(default_factory=Counter)
    in_progress: int = 0  # triggers without an outcome yet


def outcome_counts(connection: sqlite3.Connection, known: OutcomeCounts) -> OutcomeCounts:
    """Return the counts now; `known` are earlier ones, or none."""
    first_seq, last_seq = connection.execute("SELECT first_seq, last_seq FROM store").fetchone()
    if known.up_to_seq + 1 < first_seq:  # some were removed before they were counted
        known = OutcomeCounts()
    n = known.n + _counted(connection, "listed", "seq > ?", known.up_to_seq)
    if known.up_to_seq == 0:
        n += _counted(connection, "removed_results")
    (in_progress,) = connection.execute("SELECT total(n) FROM triggers WHERE state = 'open'").fetchone()
    return OutcomeCounts(up_to_seq=last_seq, n=n, in_progress=int(in_progress))


def accounting(connection: sqlite3.Connection, session: int | None = None) -> Accounting:
    """Return the counts of one session, or of all.

    Triggers are counted where they were recorded and outcomes where they are served, so the balance is a check.
    """
    condition, given = ("TRUE", ()) if session is None else ("session = ?", (session,))
    triggers = f"SELECT state, sum(n) FROM triggers WHERE {condition} GROUP BY state"  # noqa: S608 - one of two above
    states = Counter(dict(connection.execute(triggers, given)))
    removed = _counted(connection, "removed_results", condition, *given)
    counted = _counted(connection, "listed", condition, *given) + removed
    by_outcome, by_reason, by_quality = Counter[str](), Counter[str](), Counter[str]()
    for (outcome, reason, quality), n in counted.items():
        by_outcome[outcome] += n
        if outcome == Outcome.MEASURED:
            by_quality[quality] += n
        else:
            by_reason[reason] += n
    return Accounting(
        # the rows of removed ones went with their results
        triggers=states.total() - states["background"] + removed.total(),
        measured=by_outcome[Outcome.MEASURED],
        rejected=by_outcome[Outcome.REJECTED],
        lost=by_outcome[Outcome.LOST],
        in_progress=states["open"],
        backgrounds=states["background"],
        by_reason=dict(by_reason),
        by_quality=dict(by_quality),
    )


def _counted(connection: sqlite3.Connection, table: str, condition: str = "TRUE", *given: int) -> Counts:
    rows = connection.execute(
        "SELECT outcome, coalesce(reason, ''), coalesce(quality, ''), sum(n)"  # noqa: S608 - constants
        f" FROM {table} WHERE {condition} GROUP BY outcome, reason, quality",
        given,
    )
    return Counter({(outcome, reason, quality): n for outcome, reason, quality, n in rows})
