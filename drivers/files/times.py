"""The time of now as files and answers have it."""

from datetime import UTC, datetime

from pipeline.frames import rfc3339


def utc_now(timespec: str = "milliseconds") -> str:
    """Return the time of now as text."""
    return rfc3339(datetime.now(UTC), timespec)
