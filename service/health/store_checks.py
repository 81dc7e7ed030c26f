"""Health of the store: can it be written, how long does its disk suffice, was something removed unread."""

from service.base.status import CheckStatus, HealthCheck
from service.health.facts import Facts

LOW_DISK_BYTES = 1 << 30
"""Free space on the store's file system below which health warns; below a tenth of it, the check fails."""


def store(facts: Facts) -> HealthCheck:
    """Check that results can be written, and that nothing was moved aside at a start."""
    is_held = facts.store_trouble is not None
    held = [f"{facts.store_trouble}; {facts.without_outcome} stones wait for it"] if is_held else []
    aside = [f"store.dir/{incident.removesuffix('.')}" for incident in facts.store_incidents]
    if aside:
        aside.append("look at it, restore a backup if results are missing, then move it out of store.dir")
    return HealthCheck(
        status=CheckStatus.of(warn=bool(aside), fail=is_held),
        observed_value=facts.last_seq,
        observed_unit="results",
        detail="; ".join(held + aside) or None,
    )


def disk(facts: Facts) -> HealthCheck:
    """Check that the file system of the store answers and has room."""
    if facts.free_bytes is None:
        return HealthCheck(status=CheckStatus.FAIL, detail="the file system of store.dir does not answer")
    return HealthCheck(
        status=CheckStatus.of(
            warn=facts.free_bytes < LOW_DISK_BYTES, fail=facts.free_bytes < LOW_DISK_BYTES // 10
        ),
        observed_value=facts.free_bytes,
        observed_unit="bytes",
        detail=f"{facts.free_bytes / 1e9:.1f} GB free for results",
    )


def disk_days(facts: Facts) -> HealthCheck:
    """Check for how many days like the last one the disk suffices; nothing is observed while that is unknown."""
    kept = facts.retention
    if kept is None or (use := kept.use) is None:
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


def retention(facts: Facts) -> HealthCheck:
    """Check that nothing was removed before its consumer had read it, and that what is due can be removed."""
    kept = facts.retention
    problems = [] if kept is None or kept.trouble is None else [kept.trouble]
    if kept is not None and kept.overrun:
        problems.append(
            f"results were removed that {', '.join(kept.overrun)} had not read:"
            " look at that consumer, or delete it (/consumers)"
        )
    return HealthCheck(status=CheckStatus.of(warn=bool(problems)), detail="; ".join(problems) or None)
