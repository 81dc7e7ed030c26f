"""The present time as files and answers have it, see `pipeline.frames.rfc3339`."""

from datetime import UTC, datetime, timedelta

from pipeline.frames import rfc3339

EARLIEST = datetime(2026, 1, 1, tzinfo=UTC)
"""No stone was measured before: a clock that says so has not been set since a host without a battery started."""


def utc_now(timespec: str = "milliseconds") -> str:
    """Return the present time."""
    return rfc3339(datetime.now(UTC), timespec)


def utc_ago(age_ns: int) -> str:
    """Return the time `age_ns` before now, in milliseconds: the date of an event whose age a monotonic clock gives."""
    return rfc3339(datetime.now(UTC) - timedelta(microseconds=age_ns / 1000))


def ns_since(utc: str) -> int:
    """Return the age of a time (RFC 3339), in ns; wrong by as much as the clock was set since."""
    return round((datetime.now(UTC) - datetime.fromisoformat(utc)) / timedelta(microseconds=1) * 1000)


def is_of_unset_clock(utc: str) -> bool:
    """True for a time (RFC 3339 in UTC) by a clock that had not been set since the host started."""
    return utc < rfc3339(EARLIEST)
