"""The way to the broker, made again for ever: one connection at a time, and what waits for it to be open."""

import asyncio
import logging
import random
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Generic, TypeVar

from service.bridge.mqtt.connection import BrokerConnection, BrokerError

log = logging.getLogger(__name__)

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 10.0
LASTED_S = 5.0
"""A connection that lasted as long was a good one: the next pause is the first again, and the next trouble is told."""
MAX_TOLD = 10
T = TypeVar("T")


def pause_s(n_failed: int) -> float:
    """Return the time to wait after so many failures in a row: doubled each time, less up to a half by chance.

    After a power cut all bridges of a plant would come back to the broker in one moment.
    """
    return min(FIRST_PAUSE_S * 2.0 ** min(n_failed, 16), LONGEST_PAUSE_S) * random.uniform(0.5, 1)  # noqa: S311 - no secret


class Link(Generic[T]):
    """Makes connections to the broker, one after the other; through each a sender `T` is open at times."""

    def __init__(self, name: str, connect: Callable[[], BrokerConnection]) -> None:
        self._name, self._connect = name, connect
        self._sender: asyncio.Future[T] = asyncio.get_running_loop().create_future()

    async def sender(self) -> T:
        """Return the open sender; wait while there is none."""
        return await asyncio.shield(self._sender)

    def open(self, sender: T) -> None:
        """Let messages pass."""
        self.shut()
        self._sender.set_result(sender)

    def shut(self) -> None:
        """Have messages wait."""
        if self._sender.done():
            self._sender = asyncio.get_running_loop().create_future()

    async def keep(self, serve: Callable[[BrokerConnection], Awaitable[None]]) -> None:
        """Connect again and again until it is cancelled; `serve` runs as long as the connection, and calls `open`."""
        now_s, n_failed = asyncio.get_running_loop().time, 0
        told: set[str] = set()  # reasons of this row of failures: each is told once
        while True:
            began_s, reason = now_s(), ""
            try:
                async with self._connect() as connection:
                    log.info("broker %s: connected", self._name)
                    connection.ended.add_done_callback(lambda _: self.shut())
                    await _while_connected(connection, asyncio.ensure_future(serve(connection)))
            except BrokerError as err:
                reason = str(err)
            if now_s() - began_s >= LASTED_S:
                n_failed, told = 0, set()
            if reason not in told and len(told) < MAX_TOLD:
                log.warning("broker %s: %s", self._name, reason)
                told.add(reason)
            await asyncio.sleep(pause_s(n_failed))
            n_failed += 1


async def _while_connected(connection: BrokerConnection, serving: "asyncio.Future[None]") -> None:
    """Wait for the end of the connection or of what serves it; raise the error of either."""
    try:
        await asyncio.wait((serving, connection.ended), return_when=asyncio.FIRST_COMPLETED)
        await (connection.ended if connection.ended.done() else serving)
    finally:
        serving.cancel()
        with suppress(asyncio.CancelledError, BrokerError):
            await serving
