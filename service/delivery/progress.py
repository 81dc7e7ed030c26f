"""Progress of an endpoint through the events, and its next attempt: pure, time is an argument."""

from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from http import HTTPStatus

from pipeline.frames import rfc3339

PAUSES_S = (5.0, 300.0, 1800.0, 7200.0, 18_000.0, 36_000.0)
"""Pauses after the first failures of an event; the last one is repeated."""
JITTER = 0.1
"""Share by which a pause is longer at most: endpoints that failed together are not tried together."""
GIVE_UP_S = 24 * 3600.0
"""Time of pauses after which an endpoint is disabled; not by the clock, which may be set meanwhile."""
MIN_PAUSE_S, MAX_ASKED_PAUSE_S = 1.0, 3600.0
"""Pauses that an endpoint can ask for."""
FAILING_S = 900.0
"""Time without success after which health reports that an endpoint fails."""
ASKS_TO_WAIT = (HTTPStatus.TOO_MANY_REQUESTS, HTTPStatus.SERVICE_UNAVAILABLE)


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointAnswer:
    """Outcome of one request."""

    status: int | None = None  # None: there was no answer
    problem: str | None = None  # None: the message was taken
    retry_after_s: float | None = None
    duration_ms: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointProgress:
    """Progress of an endpoint; times are RFC 3339."""

    after: int  # last event that it has taken
    attempts: int = 0  # failed ones of the next event
    waited_s: float = 0.0  # since the first of these: the pauses between them
    failing_since: str | None = None
    next_attempt_at: str | None = None
    last_problem: str | None = None  # None once the next message was taken
    last_taken_at: str | None = None
    disabled_at: str | None = None

    def pause_s(self, now: datetime) -> float:
        """Return the time until the next attempt; clocks that were set meanwhile delay it by a day at most."""
        if self.next_attempt_at is None:
            return 0.0
        remaining = datetime.fromisoformat(self.next_attempt_at) - now
        return min(max(remaining.total_seconds(), 0.0), GIVE_UP_S)

    def is_failing(self, now: datetime) -> bool:
        """True when it has taken nothing for `FAILING_S`, by its pauses and not by a clock that may be set."""
        return self.waited_s - self.pause_s(now) >= FAILING_S


def next_progress(
    progress: EndpointProgress, event: int, answer: EndpointAnswer, now: datetime, chance: float = 0.0
) -> EndpointProgress:
    """Return the progress after an attempt to post `event`; `chance` is random, 0 to 1."""
    at = rfc3339(now)
    if answer.problem is None:
        return EndpointProgress(after=event, last_taken_at=at)
    failed = replace(
        progress,
        attempts=progress.attempts + 1,
        failing_since=progress.failing_since or at,
        last_problem=answer.problem,
        next_attempt_at=None,
    )
    left_s = GIVE_UP_S - progress.waited_s
    if answer.status == HTTPStatus.GONE or left_s <= 0:
        return replace(failed, disabled_at=at)
    pause_s = PAUSES_S[min(progress.attempts, len(PAUSES_S) - 1)] * (1 + JITTER * chance)
    if answer.retry_after_s is not None and answer.status in ASKS_TO_WAIT:
        pause_s = min(max(answer.retry_after_s, MIN_PAUSE_S), MAX_ASKED_PAUSE_S)
    pause_s = min(pause_s, left_s)
    return replace(
        failed,
        waited_s=progress.waited_s + pause_s,
        next_attempt_at=rfc3339(now + timedelta(seconds=pause_s)),
    )


def enabled(progress: EndpointProgress) -> EndpointProgress:
    """Return the progress of an endpoint that is tried again at once, as if it had not failed."""
    return EndpointProgress(after=progress.after, last_taken_at=progress.last_taken_at)


def replayed(progress: EndpointProgress, after: int) -> EndpointProgress:
    """Return the progress of an endpoint that gets all events after a number again."""
    return replace(
        enabled(progress), after=after, last_problem=progress.last_problem, disabled_at=progress.disabled_at
    )
