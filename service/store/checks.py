"""Health of the store: is it written, how long does its disk suffice, was something removed unread."""

import shutil
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from pipeline.frames import rfc3339
from service.base.messages import Code, joined, message
from service.base.status import Checks, HealthCheck, health_check, trouble_check
from service.store.retention import Disk, RetentionLimits
from service.store.store import Store
from service.store.trouble import StoreTrouble

LOW_DISK_BYTES = 1 << 30
"""Free space on the store's file system below which health warns; below a tenth of it, the check fails."""


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


def store_checks(store: Store, n_waiting: int) -> Checks:
    """Return the checks of a store that `n_waiting` stones wait for, and of its disk."""
    return {
        "store": store_check(store.trouble, store.incidents, last_seq=store.last_seq, n_waiting=n_waiting),
        "disk": disk_check(free_bytes(store.dir)),
    }


def free_bytes(folder: Path) -> int | None:
    """Return the free space of a file system, None if that does not answer."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None


def store_check(
    trouble: StoreTrouble | None, incidents: Sequence[str], *, last_seq: int, n_waiting: int
) -> HealthCheck:
    """Check that results can be written, and that nothing was moved aside at a start."""
    said = [] if trouble is None else [trouble.said, message(Code.STORE_AWAITED, stones=n_waiting)]
    aside = "; ".join(f"store.dir/{incident.removesuffix('.')}" for incident in incidents)
    if aside:
        said.append(message(Code.STORE_ASIDE, paths=aside))
    detail = joined(said)
    return health_check(detail, last_seq, "results", warn=bool(aside), fail=trouble is not None)


def disk_check(free_bytes: int | None) -> HealthCheck:
    """Check that the file system of the store answers and has room."""
    if free_bytes is None:
        return health_check(message(Code.DISK_SILENT), fail=True)
    is_low, is_lowest = free_bytes < LOW_DISK_BYTES, free_bytes < LOW_DISK_BYTES // 10
    detail = message(Code.DISK_FREE, free_gb=free_bytes / 1e9)
    return health_check(detail, free_bytes, "bytes", warn=is_low, fail=is_lowest)


def retention_checks(kept: RetentionFacts) -> Checks:
    """Return the checks of the days for which the disk suffices, unknown at first, and of what was removed."""
    problems = [] if kept.trouble is None else [message(Code.RETENTION_FAILED, reported=kept.trouble)]
    if kept.overrun:
        problems.append(message(Code.CONSUMER_OVERRUN, consumers=", ".join(kept.overrun)))
    disk_days = health_check(None)
    if (use := kept.use) is not None:
        is_short = use.days_left is not None and use.days_left < kept.warn_days
        bytes_of = {
            "files": use.files_bytes,
            "results": use.results_bytes,
            "recordings": kept.recordings_bytes,
        }
        taken = message(
            Code.DISK_TAKEN, **{f"{name}_gb": n_bytes / 1e9 for name, n_bytes in bytes_of.items()}
        )
        detail = joined([taken, *([message(Code.DISK_SHORT)] if is_short else [])])
        days_left = None if use.days_left is None else round(use.days_left, 1)
        disk_days = health_check(detail, days_left, "days", warn=is_short)
    return {"disk_days": disk_days, "retention": trouble_check(joined(problems))}


def store_use(connection: sqlite3.Connection, limits: RetentionLimits, disk: Disk, now: datetime) -> StoreUse:
    """Return the space that the store takes, and the days for which the disk suffices at the rate of the last one."""
    first_seq, last_seq, files_bytes = connection.execute(
        "SELECT first_seq, last_seq, files_bytes FROM store"
    ).fetchone()
    page_bytes, n_pages, n_free = (
        connection.execute(f"PRAGMA {name}").fetchone()[0]
        for name in ("page_size", "page_count", "freelist_count")
    )
    results_bytes = page_bytes * (n_pages - n_free)
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
    """Return when the space is used up, None if never; each growth has bytes a day, and bytes after which it ends."""
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
