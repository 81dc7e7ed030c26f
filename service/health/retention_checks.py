"""Health of what the store keeps: how long its disk suffices, and whether something was removed unread."""

from service.status import CheckStatus, HealthCheck
from service.store.disk_use import RetentionFacts


def disk_days(facts: RetentionFacts | None) -> HealthCheck:
    """Check for how many days like the last one the disk suffices; nothing is observed while that is unknown."""
    if facts is None or (use := facts.use) is None:
        return HealthCheck(status=CheckStatus.PASS)
    days_left = use.days_left
    is_short = days_left is not None and days_left < facts.warn_days
    detail = (
        f"meshes and silhouettes take {use.files_bytes / 1e9:.1f} GB, results {use.results_bytes / 1e9:.1f} GB,"
        f" recordings {facts.recordings_bytes / 1e9:.1f} GB"
    )
    if is_short:
        detail += "; then the oldest files are removed: make room, or set limits in [store.retention]"
    return HealthCheck(
        status=CheckStatus.WARN if is_short else CheckStatus.PASS,
        observed_value=None if days_left is None else round(days_left, 1),
        observed_unit="days",
        detail=detail,
    )


def retention(facts: RetentionFacts | None) -> HealthCheck:
    """Check that nothing was removed before its consumer had read it, and that what is due can be removed."""
    problems = [] if facts is None or facts.trouble is None else [facts.trouble]
    if facts is not None and facts.overrun:
        problems.append(
            f"results were removed that {', '.join(facts.overrun)} had not read:"
            " look at that consumer, or delete it (/consumers)"
        )
    return HealthCheck(
        status=CheckStatus.WARN if problems else CheckStatus.PASS, detail="; ".join(problems) or None
    )
