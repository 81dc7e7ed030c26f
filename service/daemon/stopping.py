"""How the daemon is asked to stop: the first SIGTERM or SIGINT in order, the second one in a hurry."""

import asyncio
import logging
import signal
from dataclasses import dataclass, field

log = logging.getLogger(__name__)


@dataclass(slots=True)
class StopRequests:
    """What the signals have asked for."""

    stop: asyncio.Event = field(default_factory=asyncio.Event)
    hurry: asyncio.Event = field(default_factory=asyncio.Event)

    def listen(self) -> None:
        """Take over the signals of this process."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self._on_stop, number)
        loop.add_signal_handler(
            signal.SIGHUP, log.warning, "SIGHUP ignored: a new configuration needs a restart"
        )

    async def wait_for(self, task: "asyncio.Task[None]", limit_s: float) -> None:
        """Return when the task is through, takes too long, or the stop is asked for a second time."""
        await _first_of(task, self.hurry, limit_s)

    async def unless_stopped(self, event: asyncio.Event) -> None:
        """Return when the event is set or the stop is asked for."""
        waiting = asyncio.create_task(_set(event))
        await _first_of(waiting, self.stop)
        waiting.cancel()

    def _on_stop(self, number: signal.Signals) -> None:
        log.info("stop requested signal=%s", number.name)
        if self.stop.is_set():
            self.hurry.set()
        self.stop.set()


async def _first_of(task: "asyncio.Task[None]", event: asyncio.Event, limit_s: float | None = None) -> None:
    waiting = asyncio.create_task(_set(event))
    await asyncio.wait([task, waiting], timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)
    waiting.cancel()


async def _set(event: asyncio.Event) -> None:
    await event.wait()
