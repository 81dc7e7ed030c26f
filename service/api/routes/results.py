"""The feed: every outcome in order, for a client that keeps its own position."""

import asyncio
from contextlib import suppress
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response
from pydantic import BaseModel, Field

from service.api.context import ApiContext, Context
from service.api.feeds import KEEP_S, MAX_SEQ, MAX_SMALL, cursor_problem
from service.api.pages import FeedPage, feed_page
from service.api.problems import problem_responses
from service.results.fields import Result
from service.store import read

router = APIRouter(prefix="/results", tags=["results"])


class ResultsPage(BaseModel):
    """One page of the feed. Ask again with `after = next_after`; every result is delivered at least once."""

    instance_id: str = Field(description="Identity of the history; when it changes, start again from 0")
    first_seq: int = Field(description="`seq` of the oldest result kept; `last_seq + 1` when there is none")
    last_seq: int = Field(description="`seq` of the newest result; 0 before the first")
    next_after: int = Field(description="The cursor: pass it as `after` of the next request")
    items: list[Result] = Field(description="In the order of `seq`; empty when there is nothing new")


@router.get("", response_model=ResultsPage, responses=problem_responses(409, 410))
async def results(
    context: Context,
    after: Annotated[
        int, Query(ge=0, le=MAX_SEQ, description="`seq` of the last result you have; 0: from the beginning")
    ] = 0,
    limit: Annotated[int, Query(ge=1, le=1000, description="Results of a page, at most")] = 100,
    wait_s: Annotated[
        float, Query(ge=0, le=30, description="Longest wait for a result when there is none yet, s")
    ] = 0,
) -> Response:
    """Return the results after `after`, in order, without gaps, each at least once.

    410 `cursor-expired`: results after `after` are no longer kept, the feed begins at `first_seq`. 409 `cursor-ahead`:
    the feed has not reached `after`, as when the store was replaced or restored from a backup.
    """
    page = await _page(context, after, limit, wait_s)
    if (problem := cursor_problem(page, after, "result")) is not None:
        raise problem
    return Response(page.content, media_type="application/json")


async def _page(context: ApiContext, after: int, limit: int, wait_s: float) -> FeedPage:
    """Return the page after `after`, as soon as there is a result on it or `wait_s` are over."""
    store = context.store
    if wait_s == 0 or after != store.last_seq:
        page = await _page_now(context, after, limit)
        if wait_s == 0 or after != page.last_seq:
            return page
    with suppress(TimeoutError):
        async with asyncio.timeout(wait_s):
            await store.wait_beyond(after)
    await context.waking.turn()
    return await _page_now(context, after, limit)


async def _page_now(context: ApiContext, after: int, limit: int) -> FeedPage:
    """Return the page after `after`, the same to all who ask for it at this moment."""
    store = context.store

    async def make() -> FeedPage:
        if is_big:
            return await context.reading.run(read, store.path, feed_page, store.instance_id, after, limit)
        return await store.read(feed_page, store.instance_id, after, limit)

    is_big = min(limit, store.last_seq - after) > MAX_SMALL
    question = ("results", after, limit, store.last_seq)
    return await context.shared.get(question, make, keep_s=0 if is_big else KEEP_S)
