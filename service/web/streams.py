"""Feeds as server-sent events: each item as it comes, from where the client has left off.

A page is made once for all streams that are at the same place. A client that does not read holds one page and is closed
like any other (`service.web.connections`).
"""

import asyncio
import logging
from collections.abc import AsyncGenerator
from contextlib import aclosing
from dataclasses import replace

from fastapi import Request
from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from service.base.errors import ProblemError, StoreError
from service.web.auth import require
from service.web.context import ApiContext
from service.web.feeds import page_after, require_within
from service.web.pages import Feed, FeedPage, server_sent
from service.web.problems import Problem, failure_of, problem_document, problem_of, store_unavailable
from service.web.reader_process import BusyError
from service.web.request_ids import request_id_of
from service.web.settings import Scope as KeyScope

log = logging.getLogger(__name__)

HEARTBEAT_S = 15.0
"""Longest silence: proxies and clients take a longer one for a dead connection."""
HEARTBEAT = b": nothing new\n\n"
PAGE = 100
"""Items that are sent at a time."""
BUSY_PAUSE_S = 2.0

may_read = require(KeyScope.READ)
"""Raises the problem 401 or 403 when the key that opened the stream is not valid any more."""


class EventStream(StreamingResponse):
    """Server-sent events, as the OpenAPI document names them.

    FastAPI's own class would encode each item anew for every reader, in two tasks of each.
    """

    media_type = "text/event-stream"


class OpenStream(EventStream):
    """The answer that sends chunks as they come, until client or daemon end; it is counted among the streams."""

    def __init__(self, context: ApiContext, chunks: AsyncGenerator[bytes, None], request: Request) -> None:
        self._chunks = _with_problems(chunks, request)
        headers = {"Cache-Control": "no-cache", "X-Accel-Buffering": "no"}  # a proxy is not to collect it
        super().__init__(self._chunks, headers=headers)
        self._streams, self._request = context.streams, request

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._streams.one_more(self._request):
            async with aclosing(self._chunks):
                await super().__call__(scope, receive, send)


async def open_stream(context: ApiContext, feed: Feed, after: int, request: Request) -> OpenStream:
    """Return the stream of a feed.

    Raises `CursorError` when the feed does not have what follows `after`, `Problem` when too many streams are open.
    """
    context.streams.require_room(request)
    feed = replace(feed, is_stream=True)
    page = await page_after(context, feed, after, 1)
    require_within(page.cursor, after, feed.kind)
    return OpenStream(context, _chunks(context, feed, after, request), request)


async def _chunks(
    context: ApiContext, feed: Feed, after: int, request: Request
) -> AsyncGenerator[bytes, None]:
    """Yield pages as server-sent events, and something at least every `HEARTBEAT_S`."""
    store, is_begun = context.store, False
    while True:
        await may_read(request, context)
        await context.waking.turn()
        page = await _patient_page(context, feed, after)
        if not is_begun:
            is_begun = True
            yield server_sent("history", page.cursor.model_dump(exclude={"next_after"}))
        require_within(page.cursor, after, feed.kind)
        if page.cursor.next_after != after:
            after = page.cursor.next_after
            yield page.content
            continue
        if store.is_released:
            return
        try:
            async with asyncio.timeout(HEARTBEAT_S):
                await feed.wait_beyond(store, after)
        except TimeoutError:
            yield HEARTBEAT


async def _with_problems(
    chunks: AsyncGenerator[bytes, None], request: Request
) -> AsyncGenerator[bytes, None]:
    """Yield chunks; what goes wrong is the last event."""
    try:
        async with aclosing(chunks):
            async for chunk in chunks:
                yield chunk
    except (Problem, ProblemError) as err:
        yield _sent_problem(err if isinstance(err, Problem) else problem_of(err), request)
    except StoreError as err:
        log.error("%s: %s", failure_of(request), err)
        yield _sent_problem(store_unavailable(), request)


def _sent_problem(problem: Problem, request: Request) -> bytes:
    return server_sent("problem", problem_document(problem, request.scope["path"], request_id_of(request)))


async def _patient_page(context: ApiContext, feed: Feed, after: int) -> FeedPage:
    """Return the page after `after`, as soon as the process that makes big ones has time for it."""
    while True:
        try:
            return await page_after(context, feed, after, PAGE)
        except BusyError:
            await asyncio.sleep(BUSY_PAUSE_S)
