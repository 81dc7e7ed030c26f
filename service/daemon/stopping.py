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
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self._on_stop, number)
        loop.add_signal_handler(
            signal.SIGHUP, log.warning, "SIGHUP ignored: a new configuration needs a restart"
        )

    def _on_stop(self, number: signal.Signals) -> None:
        log.info("stop requested signal=%s", number.name)
        if self.stop.is_set():
            self.hurry.set()
        self.stop.set()


async def finish(part: "asyncio.Task[None]", requests: StopRequests, limit_s: float) -> None:
    """Wait until the part is through, somebody is in a hurry, or it takes too long."""
    hurry = asyncio.create_task(requests.hurry.wait())
    await asyncio.wait([part, hurry], timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)
    hurry.cancel()
