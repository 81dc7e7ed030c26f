"""Turns for requests, so that clients in a closed loop leave the event loop and the processor to the measuring.

Without them 200 long polls, or four clients that ask again at once, keep the daemon busy all the time, however cheap
each answer is: the loop has the priority of the daemon, which is above that of the workers.
"""

import asyncio

from starlette.types import ASGIApp, Receive, Scope, Send

RATE_HZ = 100.0
"""Turns a second; a request takes about 2 ms of the loop."""
BURST = 40
"""Turns that are given at once after a quiet time: a page with all its pictures does not wait."""


class Pace:
    """Gives at most `RATE_HZ` turns a second, after a quiet time `BURST` at once, in the order of asking."""

    def __init__(self) -> None:
        self._last_s = float("-inf")  # when the turn given last is due

    async def turn(self) -> None:
        """Return when it is one's turn."""
        now_s = asyncio.get_running_loop().time()
        self._last_s = max(self._last_s, now_s - BURST / RATE_HZ) + 1 / RATE_HZ
        await asyncio.sleep(self._last_s - now_s)


class PacedRequests:
    """ASGI application around another one, in which each request begins when it is its turn."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._pace = Pace()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self._pace.turn()
        await self._app(scope, receive, send)
