"""The bounded queue from the threads of the devices to the event loop; it blocks neither side."""

import asyncio
import threading
from collections import Counter, deque
from collections.abc import Mapping

from drivers.interfaces import DeviceEvent, FrameLost
from pipeline.frames import Frame

RESERVE = 256
"""Room beyond the capacity for events other than frames: a refused trigger would be a stone that is not counted."""


class EventInbox:
    """An `EventSink` for any number of threads; one task on the loop gets the events in the order of delivery."""

    def __init__(self, loop: asyncio.AbstractEventLoop, capacity: int) -> None:
        if capacity < 1:
            raise ValueError(f"capacity must be at least 1, not {capacity}")
        self._loop = loop
        self._capacity = capacity
        self._events: deque[DeviceEvent] = deque()
        self._arrived = asyncio.Event()
        # shared by producers only: the loop takes from the deque without it and so never waits
        self._delivering = threading.Lock()
        self._refused: Counter[str] = Counter()

    @property
    def refused(self) -> Mapping[str, int]:
        """Number of events of each class (`Frame`, `Trigger`, ...) that were refused for want of room."""
        return dict(self._refused)

    def deliver(self, event: DeviceEvent) -> bool:
        """Take an event without blocking, from any thread; `False` when it was refused and counted."""
        limit = self._capacity if isinstance(event, Frame | FrameLost) else self._capacity + RESERVE
        with self._delivering:
            if len(self._events) >= limit or self._loop.is_closed():
                self._refused[type(event).__name__] += 1
                return False
            self._events.append(event)
            # the loop waits only while there is no event: for earlier ones it was woken already
            if len(self._events) == 1:
                self._loop.call_soon_threadsafe(self._arrived.set)
        return True

    async def get(self, timeout_s: float | None = None) -> DeviceEvent | None:
        """Return the next event, None when none came within `timeout_s`; from one task at a time."""
        if self._events:  # the usual case: the frames of a stone come together
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
