"""Measure how long the event loop is held up, and detect that the wall clock was set."""

import asyncio
import time
from collections import deque

from drivers.files.times import EARLIEST, is_of_unset_clock, utc_now
from service.base.messages import Code, message
from service.base.status import Checks, HealthCheck, trouble_check

PERIOD_S = 0.02
WINDOW_S = 60.0
"""Time over which the longest delay is reported."""
STEP_S = 0.1
"""Move of the wall clock against the monotonic one, within a period, above which it was set and not disciplined."""
STEP_REMEMBERED_S = 3600.0
LOOP_MS = 250.0
"""Delay of the event loop above which frames may be matched late."""


class LoopWatch:
    """Watches the event loop and the wall clock: `run` is its task, the findings can be read at any time."""

    def __init__(self) -> None:
        self._delays: deque[tuple[float, float]] = deque()  # time and length of each, lengths decreasing
        self._step_at_s: float | None = None
        self._step_s = 0.0

    async def run(self) -> None:
        """Sleep again and again, and record by how much each sleep ends too late."""
        offset_s = time.time() - time.monotonic()
        while True:
            due_s = time.monotonic() + PERIOD_S
            await asyncio.sleep(PERIOD_S)
            now_s = time.monotonic()
            self._record(now_s, now_s - due_s)
            moved_s = time.time() - time.monotonic() - offset_s
            offset_s += moved_s
            was_set = time.time() - moved_s > EARLIEST.timestamp()
            if abs(moved_s) > STEP_S and was_set:  # else results say themselves that their times are wrong
                self._step_at_s, self._step_s = now_s, moved_s

    def worst_ms(self) -> float:
        """Return the longest delay of the loop within the last minute."""
        return max((delay_s for _, delay_s in self._delays), default=0.0) * 1e3

    def clock_step_s(self) -> float | None:
        """Return by how much the wall clock was last set, None if it was not set within the last hour."""
        if self._step_at_s is None or time.monotonic() - self._step_at_s > STEP_REMEMBERED_S:
            return None
        return self._step_s

    def checks(self) -> Checks:
        """Return the checks of the event loop and of the wall clock."""
        return {
            "loop": loop_check(self.worst_ms()),
            "clock": clock_check(self.clock_step_s(), is_unset=is_of_unset_clock(utc_now())),
        }

    def _record(self, now_s: float, delay_s: float) -> None:
        while self._delays and (now_s - self._delays[0][0] > WINDOW_S):
            self._delays.popleft()
        while self._delays and self._delays[-1][1] <= delay_s:  # these can never be the longest again
            self._delays.pop()
        self._delays.append((now_s, delay_s))


def loop_check(worst_ms: float) -> HealthCheck:
    """Check that the event loop was not held up."""
    problem = message(Code.LOOP_BLOCKED, blocked_ms=worst_ms)
    return trouble_check(problem if worst_ms > LOOP_MS else None, round(worst_ms, 1), "ms")


def clock_check(step_s: float | None, *, is_unset: bool) -> HealthCheck:
    """Check that the wall clock is set, and was not set lately."""
    problem = None
    if is_unset:
        problem = message(Code.CLOCK_UNSET)
    elif step_s is not None:
        problem = message(Code.CLOCK_SET, step_s=step_s)
    return trouble_check(problem, step_s, "s")
