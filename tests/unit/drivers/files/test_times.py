"""Times as text are in UTC, and sort as the times."""

from datetime import UTC, datetime, timedelta, timezone

import pytest

from drivers.files.times import rfc3339, utc_ago, utc_now

MOMENT = datetime(2026, 1, 2, 3, 4, 5, 678_999, UTC)


def test_a_moment_has_milliseconds_or_seconds() -> None:
    assert rfc3339(MOMENT) == "2026-01-02T03:04:05.678Z"
    assert rfc3339(MOMENT, "seconds") == "2026-01-02T03:04:05Z"


def test_another_zone_is_converted() -> None:
    assert rfc3339(MOMENT.astimezone(timezone(timedelta(hours=2)))) == rfc3339(MOMENT)


def test_a_moment_without_offset_or_out_of_range_is_refused() -> None:
    with pytest.raises(ValueError, match="'2026-01-02 03:04:05' has no offset from UTC"):
        rfc3339(datetime(2026, 1, 2, 3, 4, 5))
    with pytest.raises(ValueError, match="is out of range"):
        rfc3339(datetime.min.replace(tzinfo=timezone(timedelta(hours=1))))


@pytest.mark.parametrize(
    "text",
    [
        "2026-01-02T03:04:05Z",
        "2026-01-02t03:04:05z",
        "2026-01-02 03:04:05z",
        "2026-01-02T05:04:05+02:00[Europe/Helsinki]",
        "2026-01-02T03:04:05Z[Etc/GMT+2]",
        "2026-W01-5T03:04:05Z",
    ],
)
def test_texts_of_one_moment_are_equal(text: str) -> None:
    assert rfc3339(text, "seconds") == "2026-01-02T03:04:05Z"


@pytest.mark.parametrize(
    "text",
    [
        "2026-01-02T03:04:05[Europe/Berlin]",
        "2026-01-02T03:04:05Z[",
        "2026-01-02T03:04:05Z[]",
        "[Europe/Berlin]",
        "2026-01-02T05:04:05+01:00[!Europe/Helsinki]",
    ],
)
def test_a_zone_alone_or_one_that_must_agree_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"isoformat|no offset"):
        rfc3339(text)


def test_now_and_a_while_ago() -> None:
    before, earlier = utc_now(), utc_ago(2_000_000_000)
    assert earlier < before <= utc_now()
    elapsed = datetime.fromisoformat(before) - datetime.fromisoformat(earlier)
    assert elapsed.total_seconds() == pytest.approx(2, abs=0.5)
