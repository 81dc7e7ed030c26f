"""The crusher's diary."""

from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from service.base.schema import GivenTime
from service.lots.trends.diary import DiaryEntry, DiaryRequest, entries, note_entry
from service.web.auth import OPERABLE, READABLE, Who
from service.web.context import Context

router = APIRouter(tags=["diary"])


class DiaryPage(BaseModel):
    """Entries of the crusher's diary."""

    items: list[DiaryEntry] = Field(description="Newest first")


@router.post("/diary", status_code=201, dependencies=OPERABLE)
@router.post("/events", name="post_event", status_code=201, dependencies=OPERABLE)
async def post_diary(context: Context, wanted: DiaryRequest, asking: Who) -> DiaryEntry:
    """Enter into the crusher's diary what was done; it is an event, `diary.noted`, and a mark on the trends.

    `POST /diary` and `POST /events` are the same. An entry is never edited: a later one says what was wrong.
    """
    return await context.write(note_entry, wanted, asking)


@router.get("/diary", dependencies=READABLE)
async def get_diary(
    context: Context,
    since: Annotated[GivenTime | None, Query(description="Done at or after, RFC 3339")] = None,
    until: Annotated[GivenTime | None, Query(description="Done before")] = None,
    limit: Annotated[int, Query(ge=1, le=1000, description="Entries of the answer, at most")] = 100,
) -> DiaryPage:
    """List the entries of the crusher's diary, newest first."""
    return DiaryPage(items=await context.store.read(entries, since, until, limit))
