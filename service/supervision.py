"""What may fail is restarted with back-off until its budget is used up; what should move is watched.

Time enters as an argument, except in `supervise`.
"""

import logging
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class RestartPolicy:
    """Wait longer after each failure in a row; give up after too many within the window."""

    delays_s: tuple[float, ...] = (1.0, 2.0, 5.0, 10.0, 30.0)
    budget: int = 10  # failures within the window that are still followed by a restart
    window_s: float = 300.0


@dataclass(slots=True)
class FailureLog:
    """The failures of one supervised session within the policy's window."""

    policy: RestartPolicy
    times_s: list[float] = field(default_factory=list)

    def next_delay_s(self, now_s: float) -> float | None:
        """Note a failure at `now_s`; how long to wait before the restart, or None when it is one too many."""
        oldest_s = now_s - self.policy.window_s
        self.times_s = [time_s for time_s in self.times_s if time_s > oldest_s] + [now_s]
        failures = len(self.times_s)
        if failures > self.policy.budget:
            return None
        return self.policy.delays_s[min(failures, len(self.policy.delays_s)) - 1]


async def supervise(
    name: str,
    session: Callable[[], Awaitable[None]],
    expected: type[Exception],
    policy: RestartPolicy,
    pause: Callable[[Exception, float], Awaitable[None]],
) -> None:
    """Run `session` until it returns; start it anew when it ends with an `expected` failure.

    Before that, `pause` is awaited with the failure and the seconds to wait. Cancellation and every other
    exception pass through at once; so does the expected failure that exceeds the policy's budget. The same
    cause is logged once.
    """
    failures = FailureLog(policy)
    last_cause = ""
    while True:
        try:
            await session()
        except expected as err:
            delay_s = failures.next_delay_s(time.monotonic())
            if delay_s is None:
                raise
            cause = str(err)
            level = logging.DEBUG if cause == last_cause else logging.ERROR
            log.log(level, "%s failed: %s restart_in_s=%g", name, cause, delay_s)
            last_cause = cause
            await pause(err, delay_s)
        else:
            return


@dataclass(slots=True)
class Heartbeats:
    """When each part last made progress; a part that is late is named.

    A part that has nothing to do calls `beat` when it has verified just that.
    """

    limits_s: Mapping[str, float]
    beats_s: dict[str, float] = field(default_factory=dict)

    def beat(self, part: str, now_s: float) -> None:
        self.beats_s[part] = now_s

    def late(self, now_s: float) -> list[str]:
        """Name the parts without progress for longer than their limit; before its first beat none is late."""
        return [
            part for part, limit_s in self.limits_s.items() if now_s - self.beats_s.get(part, now_s) > limit_s
        ]
