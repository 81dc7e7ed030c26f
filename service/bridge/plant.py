"""The daemon as the outlets see it: its present state, its feeds, and orders to it."""

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from service.base.abandonable import start_abandonable
from service.bridge.client import BridgeClient
from service.bridge.feeds import BridgeError, feed
from service.bridge.plant_state import PlantAlarm, PlantState, alarms_of, state_of
from service.bridge.reference_client import ClientError, Step

log = logging.getLogger(__name__)

POLL_S = 1.0
"""Time between two looks at the overview, which the daemon makes at most about once a second."""
ANSWER_S = 5.0
"""Longest wait for it: after this time, and the one between two looks, an old state is shown as good no more."""
ORDER_S = 20.0
"""Longest time that an order is repeated for while the daemon does not answer."""


class OrderRefusedError(BridgeError):
    """The daemon refuses an order, or does not answer; `kind` is the last part of the problem's type, if it has one."""

    def __init__(self, detail: str, kind: str = "") -> None:
        super().__init__(detail)
        self.kind = kind


class Plant:
    """The daemon behind an address. `keep` it running; call it on the event loop."""

    def __init__(self, url: str, key_file: Path | None, folder: Path, consumer: str | None) -> None:
        self._url, self._key_file, self._consumer = url, key_file, consumer
        self.folder = folder
        self._state = PlantState()
        self._changed, self._poll = asyncio.Event(), asyncio.Event()
        self._told_trouble: str | None = None
        self.looked_s = time.monotonic()
        """Time of the last look, whatever came of it, by the monotonic clock."""
        self.n_answers = 0
        """Looks that the daemon has answered: a heartbeat that stops when the state is not fresh."""

    @property
    def state(self) -> PlantState:
        """The state now."""
        return self._state

    async def states(self) -> AsyncIterator[PlantState]:
        """Yield the state now, then each other one; of several while the last was shown only the newest."""
        while True:
            changed = self._changed
            yield self._state
            await changed.wait()

    def results(self, outlet: str, fields: str | None = "lean") -> AsyncIterator[Step]:
        """Follow all results for an outlet, from its own cursor: each is delivered when the next step is asked for.

        `fields` is `lean`, names separated by commas, or None for all.
        """
        consumer = None if self._consumer is None else f"{self._consumer}-{outlet}"
        file = self.folder / outlet / "results.cursor"
        return feed(self._client(), file, consumer=consumer, fields=fields)

    def events(self, outlet: str) -> AsyncIterator[Step]:
        """Follow what happens beside results (`/events`) for an outlet, as `results`."""
        return feed(self._client(), self.folder / outlet / "events.cursor", fields=None, feed="events")

    async def open_lot(self, lot: str, product: str, token: str | None = None, **more: Any) -> dict[str, Any]:
        """Open a lot, with more fields of `POST /lots`, such as `closes`; return its document.

        All orders are given with the bridge's key, or with the `token` of a user, whom the audit then names. They raise
        `OrderRefusedError`.
        """
        return await self.order("/lots", {"lot": lot, "product": product, **more}, token)

    async def close_lot(self, lot: str, token: str | None = None) -> dict[str, Any]:
        """Close a lot; return its document."""
        return await self.order(f"/lots/{quote(lot, safe='')}/close", {}, token)

    async def acknowledge(self, alarm: int, token: str | None = None) -> dict[str, Any]:
        """Acknowledge an alarm; return it."""
        return await self.order(f"/alarms/{alarm}/acknowledge", {}, token)

    async def order(self, path: str, body: Mapping[str, Any], token: str | None = None) -> dict[str, Any]:
        """Post an order, repeated under one idempotency key while there is no answer; return the daemon's answer."""
        client = self._client(token)
        try:
            return await _asked(client, path, lambda: client.post(path, body, patience_s=ORDER_S))
        finally:
            self._poll.set()

    async def get(self, path: str, **query: object) -> dict[str, Any]:
        """Return the document at a path; raise `OrderRefusedError`, whose cause has the problem."""
        client = self._client()
        return await _asked(client, path, lambda: client.get(path, ANSWER_S, **query))

    async def keep(self) -> None:
        """Keep the state up to date, until it is cancelled."""
        client = self._client()
        overview_alarms: object = None
        alarms: tuple[PlantAlarm, ...] = ()

        def look(client: BridgeClient) -> tuple[PlantState, object, tuple[PlantAlarm, ...]]:
            overview = client.get("/overview", ANSWER_S)
            told = overview.get("alarms")
            now = alarms if told == overview_alarms else alarms_of(client.get("/alarms", ANSWER_S))
            return state_of(overview, now), told, now

        try:
            while True:
                try:
                    async with asyncio.timeout(ANSWER_S):
                        state, overview_alarms, alarms = await start_abandonable("overview", look, client)
                except (ClientError, TimeoutError, ValueError) as err:
                    state = PlantState(trouble=str(err) or f"no answer within {ANSWER_S:g} s")
                    client.abandon()  # its thread may have it still
                    client = self._client()
                self.n_answers += state.daemon_answers
                self._show(state)
                self.looked_s = time.monotonic()
                self._poll.clear()
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._poll.wait(), POLL_S)
        finally:
            client.abandon()

    def _show(self, state: PlantState) -> None:
        if state.trouble != self._told_trouble:
            self._told_trouble = state.trouble
            log.info("daemon %s: %s", self._url, state.trouble or "answers")
        if replace(state, at=self._state.at) != self._state:
            self._changed.set()
            self._changed = asyncio.Event()
        self._state = state

    def _client(self, token: str | None = None) -> BridgeClient:
        return BridgeClient(self._url, self._key_file, token)


async def _asked(client: BridgeClient, path: str, ask: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Ask on a thread of its own, and close the client."""
    try:
        return await start_abandonable(f"ask {path}", ask)
    except ClientError as err:
        raise OrderRefusedError(str(err), err.kind) from err
    except ValueError as err:  # no HTTP header can have it
        raise OrderRefusedError("the token is none of a key", "unauthorized") from err
    finally:
        client.abandon()
