"""What happened beside results: lots, alarms, calibrations, the state of the rig."""

from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import Response
from pydantic import BaseModel, Field

from service.api.context import Context
from service.api.feeds import EVENTS, MAX_SEQ, CursorPage, cursor_problem, page_after
from service.api.problems import problem_responses
from service.base.schema import TIME
from service.store.events import EventType

router = APIRouter(prefix="/events", tags=["events"])


class EventDocument(BaseModel):
    """Something that happened."""

    seq: int = Field(description="Strictly increasing, without gaps")
    at: str = Field(description="When it happened, RFC 3339 UTC", json_schema_extra=TIME)
    type: EventType = Field(description="What happened; later versions have more types")
    subject: str = Field(description="To what: a lot, the check of an alarm, a calibration, a verification")
    data: dict[str, Any] = Field(description="More of it, by type")


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
    if (problem := cursor_problem(page, after, EVENTS.kind)) is not None:
        raise problem
    return Response(page.content, media_type="application/json")
