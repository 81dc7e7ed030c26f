"""Results and events as server-sent events."""

from dataclasses import replace
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Query, Request

from service.particles.routes.results import RESULTS, ChosenFields
from service.web.auth import READABLE
from service.web.context import Context
from service.web.feeds import EVENTS, MAX_SEQ
from service.web.problems import problem_responses
from service.web.streams import EventStream, OpenStream, open_stream

router = APIRouter(tags=["streams"], dependencies=READABLE)


async def cursor(
    after: Annotated[
        int, Query(ge=0, le=MAX_SEQ, description="Number of the last one you have; 0: from the beginning")
    ] = 0,
    last_event_id: Annotated[
        int | None,
        Header(
            alias="Last-Event-ID",
            ge=0,
            le=MAX_SEQ,
            description="The same, sent by clients that connect again; wins",
        ),
    ] = None,
) -> int:
    """Return where the stream begins."""
    return after if last_event_id is None else last_event_id


Cursor = Annotated[int, Depends(cursor)]


@router.get("/results/stream", response_class=EventStream, responses=problem_responses(409, 410))
async def results_stream(
    request: Request, context: Context, names: ChosenFields, after: Cursor
) -> OpenStream:
    """Stream the results as server-sent events: the feed.

    First comes `history` (`instance_id`, `first_seq`, `last_seq`), then a `result` each, with `seq` as its `id`; after
    15 s of silence a comment. Connect again with `Last-Event-ID` to go on. 409 and 410 as of `/results`; what goes
    wrong later is an event `problem`, the last one. `fields` chooses fields as of `/results`.
    """
    return await open_stream(context, replace(RESULTS, choice=names), after, request)


@router.get("/events/stream", response_class=EventStream, responses=problem_responses(409, 410))
async def events_stream(request: Request, context: Context, after: Cursor) -> OpenStream:
    """Stream the events as server-sent events: `/events`, each by its type, like `/results/stream`."""
    return await open_stream(context, EVENTS, after, request)
