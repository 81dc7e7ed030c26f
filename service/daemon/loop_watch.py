"""How long the event loop was held up, and whether the wall clock was set while nobody looked."""

import asyncio
import time
from collections import deque

PERIOD_S = 0.02
WINDOW_S = 60.0
STEP_S = 0.1
"""A wall clock that moves by more against the monotonic one was set, not disciplined."""
STEP_REMEMBERED_S = 3600.0


class LoopWatch:
    """`run` is a task; what it saw is read at any time."""

    def __init__(self) -> None:
        self._held_up: deque[tuple[float, float]] = deque()  # when, and for how long
        self._step_at_s: float | None = None
        self._step_s = 0.0

    async def run(self) -> None:
        """Wake up on time, or note by how much it was too late."""
        offset_s = time.time() - time.monotonic()
        while True:
            due_s = time.monotonic() + PERIOD_S
            await asyncio.sleep(PERIOD_S)
            now_s = time.monotonic()
            self._note(now_s, now_s - due_s)
            moved_s = time.time() - time.monotonic() - offset_s
            offset_s += moved_s
            if abs(moved_s) > STEP_S:
                self._step_at_s, self._step_s = now_s, moved_s

    def worst_ms(self) -> float:
        """Longest delay within the last minute."""
        return max((lag_s for _, lag_s in self._held_up), default=0.0) * 1e3

    def clock_step_s(self) -> float | None:
        """By how much the wall clock was last set, None when that was not within the hour."""
        if self._step_at_s is None or time.monotonic() - self._step_at_s > STEP_REMEMBERED_S:
            return None
        return self._step_s

    def _note(self, now_s: float, lag_s: float) -> None:
        while self._held_up and (now_s - self._held_up[0][0] > WINDOW_S):
            self._held_up.popleft()
        while self._held_up and self._held_up[-1][1] <= lag_s:  # only what may still become the worst
            self._held_up.pop()
        self._held_up.append((now_s, lag_s))
