"""A part of the daemon, by what the daemon does with it: it starts, ends, checks and reconfigures all alike."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

from service.base.status import Checks
from service.configuration.settings import Settings

Running = asyncio.Task[None]


async def _nothing(*_: Running) -> None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A part of the daemon; what it does not need stays as it is here."""

    run: Callable[[], Coroutine[Any, Any, None]] = _nothing
    """Its task."""
    close: Callable[[Running], Awaitable[None]] = _nothing
    """Ends the task in order; what still runs afterwards is cancelled."""
    checks: Callable[[], Checks] = dict
    """Returns its checks of health as they are now."""
    use: Callable[[Settings], None] = lambda settings: None
    """Takes what the configuration says now and no restart is needed for; `Configuration` knows what that is."""


@asynccontextmanager
async def started(part: Part, tasks: asyncio.TaskGroup) -> AsyncIterator[None]:
    """Run a part until the daemon stops; when the daemon fails, its task group ends all parts."""
    running = tasks.create_task(part.run())
    yield
    await part.close(running)
    running.cancel()
