"""The dependency of every route: what `create_app` was given, kept in the state of the application."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from sqlite3 import Connection
from typing import Annotated, Concatenate, ParamSpec, TypeVar

from fastapi import Depends, Request

from service.base.errors import StoreError
from service.store import Store, read
from service.store.accounting import OutcomeCounts, outcome_counts
from service.web.clients import Attempts, Keyless
from service.web.connections import OpenStreams
from service.web.control import Control
from service.web.key_ring import KeyRing
from service.web.pace import WOKEN, Pace
from service.web.pairings import Pairings
from service.web.reader_process import Reading
from service.web.request_times import RequestTimes
from service.web.sessions import Sessions
from service.web.settings import ApiSettings
from service.web.shared_answers import SharedAnswers

P = ParamSpec("P")
T = TypeVar("T")


class CountedOutcomes:
    """The counts of all results, kept so that each time only new results are read."""

    def __init__(self) -> None:
        self._known = OutcomeCounts()

    async def now(self, store: Store) -> OutcomeCounts:
        """Return the counts; while the store cannot be read, those of the last time."""
        with suppress(StoreError):
            self._known = await store.read(outcome_counts, self._known)
        return self._known


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiContext:
    """The store, the daemon and the settings that the routes work on."""

    store: Store
    control: Control
    settings: ApiSettings
    keys: KeyRing
    reading: Reading
    """Where figures, documents and big pages are made: clients must not take the processor from measuring."""
    drawing: Reading
    """Where meshes and pictures of stones are made: figures do not wait for them."""
    sessions: Sessions
    site: Callable[[], str] = str
    """Returns the name of plant and instrument, which pages have in their heads; empty without one."""
    shared: SharedAnswers = field(default_factory=SharedAnswers)
    waking: Pace = field(default_factory=partial(Pace, WOKEN))
    """Long polls are answered one after the other, although a result wakes all of them at once."""
    streams: OpenStreams = field(default_factory=OpenStreams)
    counted: CountedOutcomes = field(default_factory=CountedOutcomes)
    times: RequestTimes = field(default_factory=RequestTimes)
    guesses: Attempts = field(default_factory=Attempts)
    """Wrong keys."""
    codes: Attempts = field(default_factory=Attempts)
    """Wrong codes of screens."""
    pairings: Pairings = field(default_factory=Pairings)
    keyless: Keyless = field(default_factory=Keyless)

    async def read_beside(self, query: Callable[..., T], *arguments: object) -> T:
        """Return `query(connection, *arguments)`, made in the reading process: it takes long."""
        return await self.reading.run(read, self.store.path, query, *arguments)

    async def write(
        self, change: Callable[Concatenate[Connection, P], T], *args: P.args, **kwargs: P.kwargs
    ) -> T:
        """Return `change(connection, ...)`; raise `StoreError` at once while the store cannot be written."""
        self.store.require_writable()
        return await self.store.write(change, *args, **kwargs)

    def part(self, kind: type[T]) -> T:
        """Return the part of the daemon of this class."""
        return self.control.part(kind)


async def context_of(request: Request) -> ApiContext:
    context: ApiContext = request.app.state.context
    return context


Context = Annotated[ApiContext, Depends(context_of)]
