"""When an endpoint is tried again, and when no more: simulated time."""

from datetime import UTC, datetime, timedelta

import pytest

from service.delivery.progress import EndpointAnswer, EndpointProgress, enabled, next_progress, replayed

NOW = datetime(2026, 3, 1, 12, tzinfo=UTC)
REFUSED = EndpointAnswer(status=500, problem="HTTP 500")
TAKEN = EndpointAnswer(status=204)


def pauses_until_disabled(answer: EndpointAnswer, chance: float = 0.0) -> list[float]:
    progress, now, pauses = EndpointProgress(after=3), NOW, []
    while progress.disabled_at is None:
        now += timedelta(seconds=progress.pause_s(now))
        progress = next_progress(progress, 4, answer, now, chance)
        pauses.append(progress.pause_s(now))
        assert len(pauses) < 100_000
    return pauses


def test_an_endpoint_is_tried_seven_times_in_a_day_and_disabled() -> None:
    assert pauses_until_disabled(REFUSED) == [5, 300, 1800, 7200, 18_000, 36_000, 86_400 - 63_305, 0]


def test_pauses_are_spread_by_a_tenth_and_end_after_the_same_day() -> None:
    pauses = pauses_until_disabled(REFUSED, chance=1.0)
    assert pauses[:6] == pytest.approx([5.5, 330, 1980, 7920, 19_800, 39_600])
    assert sum(pauses) == pytest.approx(86_400)


def test_a_message_that_is_taken_forgets_the_failures() -> None:
    failed = next_progress(EndpointProgress(after=3), 4, REFUSED, NOW)
    assert (failed.after, failed.attempts, failed.last_problem) == (3, 1, "HTTP 500")
    assert failed.failing_since == "2026-03-01T12:00:00.000Z"
    taken = next_progress(failed, 4, TAKEN, NOW)
    assert taken == EndpointProgress(after=4, last_taken_at="2026-03-01T12:00:00.000Z")


def test_one_that_is_gone_is_disabled_at_once() -> None:
    gone = next_progress(
        EndpointProgress(after=3), 4, EndpointAnswer(status=410, problem="HTTP 410 Gone"), NOW
    )
    assert (gone.disabled_at, gone.attempts) == ("2026-03-01T12:00:00.000Z", 1)


@pytest.mark.parametrize("status", [429, 503])
def test_retry_after_is_honoured_up_to_an_hour(status: int) -> None:
    for asked_s, pause_s in ((40.0, 40.0), (0.0, 1.0), (-5.0, 1.0), (999_999_999.0, 3600.0)):
        answer = EndpointAnswer(status=status, problem="busy", retry_after_s=asked_s)
        assert next_progress(EndpointProgress(after=3), 4, answer, NOW).pause_s(NOW) == pause_s
    assert (
        sum(pauses_until_disabled(EndpointAnswer(status=status, problem="busy", retry_after_s=1e9))) == 86_400
    )
    other = EndpointAnswer(status=500, problem="HTTP 500", retry_after_s=40.0)
    assert next_progress(EndpointProgress(after=3), 4, other, NOW).pause_s(NOW) == 5


def test_a_clock_that_is_set_back_delays_by_a_day_at_most_and_one_set_forward_disables_nothing() -> None:
    failed = next_progress(EndpointProgress(after=3), 4, REFUSED, NOW)
    assert failed.pause_s(NOW - timedelta(days=400)) == 86_400
    later = next_progress(failed, 4, REFUSED, NOW + timedelta(days=400))
    assert (later.disabled_at, later.pause_s(NOW + timedelta(days=400))) == (None, 300)


@pytest.mark.parametrize("answer", [REFUSED, EndpointAnswer(status=429, problem="busy", retry_after_s=1e9)])
def test_failures_of_fifteen_minutes_are_told_and_no_shorter_ones(answer: EndpointAnswer) -> None:
    progress, now = EndpointProgress(after=3), NOW
    for _ in range(240):
        if progress.pause_s(now) == 0:
            progress = next_progress(progress, 4, answer, now)
        assert progress.is_failing(now) == (now - NOW >= timedelta(minutes=15))
        now += timedelta(seconds=5)
    assert progress.is_failing(NOW - timedelta(days=1)) is False  # the clock was set; the next attempt tells
    assert not next_progress(progress, 4, TAKEN, now).is_failing(now)
    assert not enabled(progress).is_failing(now)
    assert not replayed(progress, 1).is_failing(now)


def test_what_somebody_asks_for() -> None:
    disabled = next_progress(EndpointProgress(after=3), 4, EndpointAnswer(status=410, problem="gone"), NOW)
    assert enabled(disabled) == EndpointProgress(after=3)
    again = replayed(disabled, 1)
    assert (again.after, again.attempts, again.disabled_at) == (1, 0, disabled.disabled_at)
