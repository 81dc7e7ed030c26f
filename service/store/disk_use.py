"""Use of the disk by the store, and the days until it is full."""

import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from pipeline.frames import rfc3339
from service.store.retention import Disk, RetentionLimits


@dataclass(frozen=True, slots=True, kw_only=True)
class StoreUse:
    """Use of the disk by the store."""

    files_bytes: int
    results_bytes: int
    days_left: float | None
    """Days until the free space is used up at the rate of the last day; None if that is unknown, or it never is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RetentionFacts:
    """Facts about retention for health; nothing is known before the first look."""

    use: StoreUse | None = None
    recordings_bytes: int = 0
    warn_days: float
    overrun: tuple[str, ...] = ()  # consumers whose unread results were removed
    trouble: str | None = None  # why nothing can be removed


def store_use(connection: sqlite3.Connection, limits: RetentionLimits, disk: Disk, now: datetime) -> StoreUse:
    """Return the space that the store takes, and the days for which the disk suffices at the rate of the last one."""
    first_seq, last_seq, files_bytes = connection.execute(
        "SELECT first_seq, last_seq, files_bytes FROM store"
    ).fetchone()
    results_bytes = _used_bytes(connection)
    n, oldest, first_recent = connection.execute(
        "SELECT count(*), min(captured_at), min(seq) FROM listed WHERE captured_at BETWEEN ? AND ?",
        (rfc3339(now - timedelta(days=1)), rfc3339(now)),
    ).fetchone()
    days_left = None
    if n and (days := (now - datetime.fromisoformat(oldest)) / timedelta(days=1)) >= 1 / 24:
        (recent_bytes,) = connection.execute(
            "SELECT coalesce(avg(bytes), 0) * count(*) FROM files WHERE seq >= ?", (first_recent,)
        ).fetchone()
        row_bytes = results_bytes / (last_seq - first_seq + 1)
        most_bytes = [limits.max_files_gb * 1e9, limits.files_age_days * recent_bytes / days]
        most_files_bytes = min((most for most in most_bytes if most), default=float("inf"))
        most_results_bytes = limits.results_days * n / days * row_bytes or float("inf")
        growths = [
            (recent_bytes / days, most_files_bytes - files_bytes),
            (n / days * row_bytes, most_results_bytes - results_bytes),
        ]
        days_left = days_until_full(disk.spare_bytes(limits), growths)
    return StoreUse(files_bytes=files_bytes, results_bytes=results_bytes, days_left=days_left)


def days_until_full(spare_bytes: float, growths: Sequence[tuple[float, float]]) -> float | None:
    """Return when the space is used up, None if never.

    Parameters
    ----------
    growths
        Each with its bytes a day, and the bytes after which it ends.
    """
    days = 0.0
    growing = [(rate, room) for rate, room in growths if rate > 0 and room > 0]
    while growing:
        total_rate = sum(rate for rate, _ in growing)
        step_days = min(room / rate for rate, room in growing)
        if spare_bytes <= total_rate * step_days:
            return days + max(spare_bytes, 0.0) / total_rate
        days += step_days
        spare_bytes -= total_rate * step_days
        growing = [(rate, left) for rate, room in growing if (left := room - rate * step_days) > 0]
    return None


def _used_bytes(connection: sqlite3.Connection) -> int:
    page_bytes, n, n_free = (
        connection.execute(f"PRAGMA {name}").fetchone()[0]
        for name in ("page_size", "page_count", "freelist_count")
    )
    return int(page_bytes * (n - n_free))
