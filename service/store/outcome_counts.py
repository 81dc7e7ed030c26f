"""Counts of all results that can be asked for often: only what came since the last time is read."""

import sqlite3
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True, kw_only=True)
class OutcomeCounts:
    """Number of results of each outcome, reason and quality (empty where there is none), removed ones too."""

    up_to_seq: int = 0
    n: Mapping[tuple[str, str, str], int] = field(default_factory=dict)
    in_progress: int = 0  # triggers without an outcome yet


def outcome_counts(connection: sqlite3.Connection, known: OutcomeCounts) -> OutcomeCounts:
    """Return the counts now; `known` are earlier ones, or none."""
    first_seq, last_seq = connection.execute("SELECT first_seq, last_seq FROM store").fetchone()
    if known.up_to_seq + 1 < first_seq:  # some were removed before they were counted
        known = OutcomeCounts()
    n = Counter(known.n)
    for outcome, reason, quality, count in connection.execute(
        "SELECT outcome, coalesce(reason, ''), coalesce(quality, ''), sum(n) FROM listed WHERE seq > ?"
        " GROUP BY 1, 2, 3",
        (known.up_to_seq,),
    ):
        n[outcome, reason, quality] += count
    if known.up_to_seq == 0:
        for outcome, reason, quality, count in connection.execute(
            "SELECT outcome, reason, quality, n FROM removed_results"
        ):
            n[outcome, reason, quality] += count
    (in_progress,) = connection.execute("SELECT total(n) FROM triggers WHERE state = 'open'").fetchone()
    return OutcomeCounts(up_to_seq=last_seq, n=dict(n), in_progress=int(in_progress))
