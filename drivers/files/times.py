"""Times as text: RFC 3339 in UTC with `Z`, so that texts sort as the times they stand for."""

from datetime import UTC, datetime, timedelta
from typing import Literal

Resolution = Literal["seconds", "milliseconds"]
"""Files that a person makes now and then have seconds, everything that is measured has milliseconds."""


def rfc3339(moment: datetime, resolution: Resolution = "milliseconds") -> str:
    """Return a moment as text, such as `2026-01-01T12:00:00.000Z`; what is finer than `resolution` is cut off.

    Raises
    ------
    ValueError
        The moment has no offset from UTC, or lies outside of the years 1 to 9999 in UTC.
    """
    if moment.tzinfo is None:
        raise ValueError(f"time {moment.isoformat()!r} has no offset from UTC")
    try:
        utc = moment.astimezone(UTC)
    except OverflowError:
        raise ValueError(f"time {moment.isoformat()!r} is out of range") from None
    return utc.isoformat(timespec=resolution).replace("+00:00", "Z")


def utc_now(resolution: Resolution = "milliseconds") -> str:
    """Return the present time."""
    return rfc3339(datetime.now(UTC), resolution)


def utc_ago(age_ns: int) -> str:
    """Return the time `age_ns` before now, in milliseconds: the date of an event whose age a monotonic clock gives."""
    return rfc3339(datetime.now(UTC) - timedelta(microseconds=age_ns / 1000))
