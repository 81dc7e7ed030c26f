"""Turns for requests, so that clients in a closed loop leave the event loop and the processor to the measuring.

Without them 200 long polls, or four clients that ask again at once, keep the daemon busy all the time, however cheap
each answer is: the loop has the priority of the daemon, which is above that of the workers. Clients that are gone take
no turn, and those without a right key take none from the others.
"""

import asyncio
from collections import OrderedDict
from collections.abc import Callable, MutableMapping
from enum import Enum
from typing import Any

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from service.web.clients import host_of_client, origin_of
from service.web.problems import Problem, problem_response

RATE_HZ = 100.0
"""Turns a second; a request takes about 2 ms of the loop."""
BURST = 40
"""Turns that are given at once after a quiet time: a page with all its pictures does not wait."""
WOKEN = 5
"""Clients that a result wakes at once: what the loop does for these, the next stone's images wait for."""
MAX_WAITING = 256
"""Longest queue; beyond it the newest request of the client with most of them is refused."""
TURN = "turn"
"""Where the state of a request has its turn."""


class Turn(Enum):
    """Fate of a request that waits."""

    COME = "it is answered now"
    REFUSED = "too many wait"
    GONE = "its client has closed the connection"


Waiting = asyncio.Future[Turn]
Queues = OrderedDict[str, dict[Waiting, None]]
"""Those who wait, of each client in the order of asking; the client whose turn is next comes first."""


class Pace:
    """Gives at most `RATE_HZ` turns a second, after a quiet time `burst` at once, in the order of asking."""

    def __init__(self, burst: int) -> None:
        self._burst = burst
        self._last_s = float("-inf")  # when the turn given last is due

    def take(self) -> float:
        """Take the next turn, and return the seconds until it is due; negative: at once."""
        now_s = asyncio.get_running_loop().time()
        self._last_s = max(self._last_s, now_s - self._burst / RATE_HZ) + 1 / RATE_HZ
        return self._last_s - now_s

    async def turn(self) -> None:
        """Return when it is one's turn."""
        await asyncio.sleep(self.take())


class Turns:
    """Turns at a pace: those with a right key and all others alternate, and among either the clients, while they wait.

    Clients are told apart by a text, such as their address.
    """

    def __init__(self) -> None:
        self._pace = Pace(BURST)
        self._known: Queues = OrderedDict()
        self._strangers: Queues = OrderedDict()
        self._order = [self._known, self._strangers]
        self._is_due = False  # the next turn is taken, and given as soon as it is due
        self.n_waiting = 0

    def ask(self, client: str, *, is_known: bool) -> Waiting:
        """Queue a request; the result is its turn, a refusal, or that its client is gone."""
        queues = self._known if is_known else self._strangers
        if self.n_waiting >= MAX_WAITING:
            self._refuse_one(queues, client)
        waiting: Waiting = asyncio.get_running_loop().create_future()
        if self.n_waiting >= MAX_WAITING:
            waiting.set_result(Turn.REFUSED)
            return waiting
        queues.setdefault(client, {})[waiting] = None
        self.n_waiting += 1
        self._go_on()
        return waiting

    def leave(self, client: str, waiting: Waiting, *, is_known: bool) -> None:
        """Take a request out that waits no longer, for any reason."""
        queues = self._known if is_known else self._strangers
        own = queues.get(client, {})
        if waiting in own:
            del own[waiting]
            self.n_waiting -= 1
        if not own:
            queues.pop(client, None)

    def _refuse_one(self, queues: Queues, client: str) -> None:
        """Refuse the newest request of the client with most, strangers first, unless the asking client has more."""
        others = self._strangers or self._known if queues is self._known else self._strangers
        if not others:
            return
        longest = max(others, key=lambda each: len(others[each]))
        n_fair = len(queues.get(client, {})) + 1 if others is queues else 0
        if len(others[longest]) > n_fair:
            self._end(others, longest, next(reversed(others[longest])), Turn.REFUSED)

    def _go_on(self) -> None:
        while self.n_waiting > 0 and not self._is_due:
            delay_s = self._pace.take()
            if delay_s > 0:
                self._is_due = True
                asyncio.get_running_loop().call_later(delay_s, self._come_due)
                return
            self._give()

    def _come_due(self) -> None:
        self._is_due = False
        self._give()
        self._go_on()

    def _give(self) -> None:
        """Give the turn to the oldest request of the next client; it is unused when the queues are empty."""
        for queues in self._order:
            if queues:
                client = next(iter(queues))
                queues.move_to_end(client)
                self._order.remove(queues)
                self._order.append(queues)
                self._end(queues, client, next(iter(queues[client])), Turn.COME)
                return

    def _end(self, queues: Queues, client: str, waiting: Waiting, turn: Turn) -> None:
        self.leave(client, waiting, is_known=queues is self._known)
        if not waiting.done():
            waiting.set_result(turn)


def paced(app: ASGIApp, is_known: Callable[[Request], bool]) -> ASGIApp:
    """Have each request to `app` begin when it is its turn; `is_known` says if it has a right key."""
    turns = Turns()

    async def pacing(scope: Scope, receive: Receive, send: Send) -> None:
        request, state = Request(scope), scope.setdefault("state", {})
        if state.get(TURN) is Turn.GONE:
            return
        client, has_key = origin_of(host_of_client(request)), is_known(request)
        waiting = state[TURN] = turns.ask(client, is_known=has_key)
        try:
            turn = await waiting
        finally:
            turns.leave(client, waiting, is_known=has_key)
        if turn is Turn.COME:
            await app(scope, receive, send)
        elif turn is Turn.REFUSED:
            problem = Problem(503, "too-many-connections", f"{MAX_WAITING} requests wait already")
            await problem_response(request, problem)(scope, receive, send)

    return pacing


def give_up_turn(state: MutableMapping[str, Any]) -> None:
    """End the waiting of the request with this state: its client has closed the connection."""
    waiting = state.setdefault(TURN, Turn.GONE)
    if isinstance(waiting, asyncio.Future) and not waiting.done():
        waiting.set_result(Turn.GONE)
