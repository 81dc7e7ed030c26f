"""The feed: every outcome in order, for a reader that keeps its own position."""

import asyncio
from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import Response

from service.api.context import Context
from service.api.pages import page_of
from service.api.problems import Problem, documented
from service.api.schemas import ResultsPage

MAX_SEQ = 10**15
"""Beyond any feed, within what a JSON number and SQLite hold exactly."""

router = APIRouter(prefix="/results", tags=["results"])


@router.get("", response_model=ResultsPage, responses=documented(409, 410))
async def results(
    context: Context,
    after: Annotated[int, Query(ge=0, le=MAX_SEQ, description="The last `seq` you have")] = 0,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
    wait_s: Annotated[
        float, Query(ge=0, le=30, description="How long to wait when there is nothing new")
    ] = 0,
) -> Response:
    """Results after `after`, in order, without gaps, at least once.

    410 `cursor-expired` when results after `after` are gone already (`first_seq` says where the feed begins);
    409 `cursor-ahead` when `after` was never given, as after a restored backup.
    """
    page = await context.store.results_after(after, limit)
    if not page.items and after == page.last_seq and wait_s > 0:
        try:
            async with asyncio.timeout(wait_s):
                await context.store.wait_beyond(after)
        except TimeoutError:
            pass
        else:
            page = await context.store.results_after(after, limit)
    ends: dict[str, Any] = {"first_seq": page.first_seq, "last_seq": page.last_seq}
    if after > page.last_seq:
        raise Problem(409, "cursor-ahead", f"the newest result is {page.last_seq}, not {after}", **ends)
    if after < page.first_seq - 1:
        raise Problem(410, "cursor-expired", f"the oldest result kept is {page.first_seq}", **ends)
    head = {
        "instance_id": context.store.instance_id,
        **ends,
        "next_after": page.items[-1]["seq"] if page.items else after,
    }
    return await page_of(head, page.items)
