"""What happened beside results: lots, alarms, calibrations, the state of the rig."""

from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response
from pydantic import Field

from service.base.schema import served
from service.store.events import NewEvent
from service.web.auth import READABLE
from service.web.context import Context
from service.web.feeds import EVENTS, MAX_SEQ, page_after, require_within
from service.web.pages import CursorPage
from service.web.problems import problem_responses

router = APIRouter(prefix="/events", tags=["events"], dependencies=READABLE)


@served
class EventDocument(NewEvent):
    """Something that happened."""

    seq: int
    """Strictly increasing, without gaps."""


class EventsDocument(CursorPage):
    """One page of the events. Ask again with `after = next_after`."""

    items: list[EventDocument] = Field(description="In the order of `seq`; empty when there is nothing new")


@router.get("", response_model=EventsDocument, responses=problem_responses(409, 410))
async def events(
    context: Context,
    after: Annotated[
        int, Query(ge=0, le=MAX_SEQ, description="`seq` of the last event you have; 0: from the beginning")
    ] = 0,
    limit: Annotated[int, Query(ge=1, le=1000, description="Events of a page, at most")] = 100,
    wait_s: Annotated[
        float, Query(ge=0, le=30, description="Longest wait for an event when there is none yet, s")
    ] = 0,
) -> Response:
    """Follow the events: those after `after`, in order, without gaps, each at least once. The newest 100 000 are kept.

    410 `cursor-expired` and 409 `cursor-ahead` as of `/results`.
    """
    page = await page_after(context, EVENTS, after, limit, wait_s)
    require_within(page.cursor, after, EVENTS.kind)
    return Response(page.content, media_type="application/json")
