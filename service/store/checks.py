"""Health of the store: can it be written, how long does its disk suffice, was something removed unread."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from service.base.status import Checks, CheckStatus, HealthCheck, trouble_check
from service.store.disk_use import RetentionFacts
from service.store.store import Store

LOW_DISK_BYTES = 1 << 30
"""Free space on the store's file system below which health warns; below a tenth of it, the check fails."""


def store_checks(store: Store, n_waiting: int) -> Checks:
    """Return the checks of a store that `n_waiting` stones wait for, and of its disk."""
    return {
        "store": store_check(
            None if store.trouble is None else str(store.trouble),
            store.incidents,
            last_seq=store.last_seq,
            n_waiting=n_waiting,
        ),
        "disk": disk_check(free_bytes(store.dir)),
    }


def free_bytes(folder: Path) -> int | None:
    """Return the free space of a file system, None if that does not answer."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None


def store_check(
    trouble: str | None, incidents: Sequence[str], *, last_seq: int, n_waiting: int
) -> HealthCheck:
    """Check that results can be written, and that nothing was moved aside at a start."""
    held = [] if trouble is None else [f"{trouble}; {n_waiting} stones wait for it"]
    aside = [f"store.dir/{incident.removesuffix('.')}" for incident in incidents]
    if aside:
        aside.append("look at it, restore a backup if results are missing, then move it out of store.dir")
    return HealthCheck(
        status=CheckStatus.of(warn=bool(aside), fail=bool(held)),
        observed_value=last_seq,
        observed_unit="results",
        detail="; ".join(held + aside) or None,
    )


def disk_check(free_bytes: int | None) -> HealthCheck:
    """Check that the file system of the store answers and has room."""
    if free_bytes is None:
        return HealthCheck(status=CheckStatus.FAIL, detail="the file system of store.dir does not answer")
    return HealthCheck(
        status=CheckStatus.of(warn=free_bytes < LOW_DISK_BYTES, fail=free_bytes < LOW_DISK_BYTES // 10),
        observed_value=free_bytes,
        observed_unit="bytes",
        detail=f"{free_bytes / 1e9:.1f} GB free for results",
    )


def retention_checks(kept: RetentionFacts) -> Checks:
    """Return the checks of the space that the store takes, and of what was removed."""
    return {"disk_days": _disk_days(kept), "retention": _retention(kept)}


def _disk_days(kept: RetentionFacts) -> HealthCheck:
    """Check for how many days like the last one the disk suffices; nothing is observed while that is unknown."""
    if (use := kept.use) is None:
        return HealthCheck(status=CheckStatus.PASS)
    days_left = use.days_left
    is_short = days_left is not None and days_left < kept.warn_days
    detail = (
        f"meshes and silhouettes take {use.files_bytes / 1e9:.1f} GB, results {use.results_bytes / 1e9:.1f} GB,"
        f" recordings {kept.recordings_bytes / 1e9:.1f} GB"
    )
    if is_short:
        detail += "; then the oldest files are removed: make room, or set limits in [store.retention]"
    return HealthCheck(
        status=CheckStatus.of(warn=is_short),
        observed_value=None if days_left is None else round(days_left, 1),
        observed_unit="days",
        detail=detail,
    )


def _retention(kept: RetentionFacts) -> HealthCheck:
    """Check that nothing was removed before its consumer had read it, and that what is due can be removed."""
    problems = [] if kept.trouble is None else [kept.trouble]
    if kept.overrun:
        problems.append(
            f"results were removed that {', '.join(kept.overrun)} had not read:"
            " look at that consumer, or delete it (/consumers)"
        )
    return trouble_check("; ".join(problems) or None)
