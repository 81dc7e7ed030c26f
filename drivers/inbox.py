"""Where the devices' threads end and the event loop begins: bounded, and never blocking either side."""

import asyncio
import threading
from collections import Counter, deque
from collections.abc import Mapping

from drivers.interfaces import DeviceEvent, FrameLost
from pipeline.frames import Frame

RESERVE = 256
"""Room beyond the capacity for what is not a frame: a refused trigger would be a stone nobody counts."""


class EventInbox:
    """Takes events from any thread; one task on the loop gets them in the order of delivery."""

    def __init__(self, loop: asyncio.AbstractEventLoop, capacity: int) -> None:
        if capacity < 1:
            raise ValueError(f"capacity must be at least 1, not {capacity}")
        self._loop = loop
        self._capacity = capacity
        self._events: deque[DeviceEvent] = deque()
        self._arrived = asyncio.Event()
        # among producers only: the loop takes from the deque without it and so never waits
        self._delivering = threading.Lock()
        self._refused: Counter[str] = Counter()

    @property
    def refused(self) -> Mapping[str, int]:
        """How many events of each kind (`Frame`, `Trigger`, ...) found no room."""
        return dict(self._refused)

    def deliver(self, event: DeviceEvent) -> bool:
        """Take the event without blocking; `False` when it was refused and counted."""
        limit = self._capacity if isinstance(event, Frame | FrameLost) else self._capacity + RESERVE
        with self._delivering:
            if len(self._events) >= limit or self._loop.is_closed():
                self._refused[type(event).__name__] += 1
                return False
            self._events.append(event)
            # the loop only waits when there is none: for those before it was woken
            if len(self._events) == 1:
                self._loop.call_soon_threadsafe(self._arrived.set)
        return True

    async def get(self, timeout_s: float | None = None) -> DeviceEvent | None:
        """Next event, or nothing when none came in time."""
        if self._events:  # as for nearly all of a stone's frames
            return self._events.popleft()
        try:
            async with asyncio.timeout(timeout_s):
                while not self._events:
                    self._arrived.clear()
                    if not self._events:  # one may have come before the line above
                        await self._arrived.wait()
        except TimeoutError:
            return None
        return self._events.popleft()
