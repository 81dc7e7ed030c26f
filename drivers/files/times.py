"""The present time as files and answers have it, see `pipeline.frames.rfc3339`."""

from datetime import UTC, datetime, timedelta

from pipeline.frames import rfc3339


def utc_now(timespec: str = "milliseconds") -> str:
    """Return the present time."""
    return rfc3339(datetime.now(UTC), timespec)


def utc_ago(age_ns: int) -> str:
    """Return the time `age_ns` before now, in milliseconds: the date of an event whose age a monotonic clock gives."""
    return rfc3339(datetime.now(UTC) - timedelta(microseconds=age_ns / 1000))
