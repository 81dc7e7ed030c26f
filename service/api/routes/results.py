"""The feed: every outcome in order, for a client that keeps its own position."""

import asyncio
import json
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import Response
from pydantic import BaseModel, Field

from service.api.context import Context
from service.api.problems import Problem, problem_responses
from service.results.fields import Result, completed
from service.store import Record

MAX_SEQ = 10**15
"""Beyond any feed, within what a JSON number and SQLite hold exactly."""

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
    return await page_response(head, page.items)


async def page_response(head: Mapping[str, Any], items: Sequence[Record]) -> Response:
    """Return a page as JSON: the members of `head`, and the results as `items`; written off the event loop."""
    return Response(await asyncio.to_thread(_page_json, head, items), media_type="application/json")


def _page_json(head: Mapping[str, Any], items: Sequence[Record]) -> bytes:
    # record by record: a thousand in one call would hold the interpreter's lock for a tenth of a second
    members = [f"{_json(name)}:{_json(value)}" for name, value in head.items()]
    records = [_json(completed(record)) for record in items]
    members.append(f'"items":[{",".join(records)}]')
    return f"{{{','.join(members)}}}".encode()


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
