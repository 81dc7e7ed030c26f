"""Answers that were given to requests with an idempotency key, kept for a day in case a request is repeated."""

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.files.times import utc_ago, utc_now
from service.store.schema import rows_by_name

KEPT_NS = 24 * 3600 * 10**9
"""For at least this time an answer is kept."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """An answer and the digest of its request."""

    request: str  # digest
    status: int
    headers: Mapping[str, str]
    body: bytes


def keep_answer(connection: sqlite3.Connection, who: str, key: str, answer: Answer) -> None:
    """Keep an answer, and remove those that are older than a day."""
    connection.execute("DELETE FROM answers WHERE answered_at < ?", (utc_ago(KEPT_NS),))
    connection.execute(
        "INSERT OR REPLACE INTO answers (who, key, request, answered_at, status, headers, body)"
        " VALUES (?, ?, ?, ?, ?, ?, ?)",
        (who, key, answer.request, utc_now(), answer.status, json.dumps(answer.headers), answer.body),
    )


def find_answer(connection: sqlite3.Connection, who: str, key: str) -> Answer | None:
    """Return the answer to the request that had this key, None if there is none."""
    rows = connection.execute(
        "SELECT request, status, headers, body FROM answers WHERE who = ? AND key = ?", (who, key)
    )
    answers = (Answer(**row | {"headers": json.loads(row["headers"])}) for row in rows_by_name(rows))
    return next(answers, None)


def n_answers(connection: sqlite3.Connection, who: str) -> int:
    """Return the number of answers of the last day."""
    since = utc_ago(KEPT_NS)
    rows = connection.execute("SELECT count(*) FROM answers WHERE answered_at >= ? AND who = ?", (since, who))
    return int(rows.fetchone()[0])
