"""Requests by signals: stop in order (the first SIGTERM or SIGINT), at once (the second), reload (SIGHUP)."""

import asyncio
import logging
import signal
from dataclasses import dataclass, field
from typing import Any

log = logging.getLogger(__name__)


@dataclass(slots=True)
class StopRequests:
    """Events that signals set."""

    stop: asyncio.Event = field(default_factory=asyncio.Event)
    """Stop in order: measure what was seen."""
    stop_now: asyncio.Event = field(default_factory=asyncio.Event)
    """Give up what is not measured yet."""
    reload: asyncio.Event = field(default_factory=asyncio.Event)
    """Read the configuration again."""

    def listen(self) -> None:
        """Install the signal handlers of this process."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self._on_stop, number)
        loop.add_signal_handler(signal.SIGHUP, self.reload.set)

    async def wait_for(self, task: "asyncio.Task[None]", timeout_s: float) -> None:
        """Return when the task is done, at the time-out, or when a second signal requests to stop at once."""
        await _first_of(task, self.stop_now, timeout_s)

    async def unless_stopped(self, event: asyncio.Event) -> None:
        """Return when the event is set or a stop is requested."""
        waiting = asyncio.create_task(event.wait())
        await _first_of(waiting, self.stop)
        waiting.cancel()

    def _on_stop(self, number: signal.Signals) -> None:
        log.info("stop requested signal=%s", number.name)
        if self.stop.is_set():
            self.stop_now.set()
        self.stop.set()


async def _first_of(task: "asyncio.Task[Any]", event: asyncio.Event, timeout_s: float | None = None) -> None:
    waiting = asyncio.create_task(event.wait())
    await asyncio.wait([task, waiting], timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
    waiting.cancel()
