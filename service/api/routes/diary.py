"""The crusher's diary, and what has changed since an entry of it."""

from typing import Annotated

from fastapi import APIRouter, Depends, Query, Response
from pydantic import BaseModel, Field

from pipeline.frames import rfc3339
from service.api.auth import Who, require
from service.api.context import Context
from service.api.problems import Problem
from service.api.routes.trends import KEEP_S, Hours
from service.api.routes.windows import next_second
from service.api.settings import Scope
from service.api.shared_documents import shared
from service.api.trend_answers import changes_json
from service.base.language import Language
from service.base.schema import GivenTime
from service.lots.trends.changes import Changes
from service.lots.trends.diary import DiaryEntry, DiaryRequest, FutureEntryError, entries, note_entry

router = APIRouter(tags=["diary"])

READABLE = [Depends(require(Scope.READ))]
OPERABLE = [Depends(require(Scope.OPERATE))]


class DiaryPage(BaseModel):
    """Entries of the crusher's diary."""

    items: list[DiaryEntry] = Field(description="Newest first")


@router.post(
    "/diary",
    status_code=201,
    dependencies=OPERABLE,
)
@router.post(
    "/events",
    name="post_event",
    status_code=201,
    dependencies=OPERABLE,
)
async def post_diary(context: Context, wanted: DiaryRequest, asking: Who) -> DiaryEntry:
    """Enter into the crusher's diary what was done; it is an event, `diary.noted`, and a mark on the trends.

    `POST /diary` and `POST /events` are the same. An entry is never edited: a later one says what was wrong.
    """
    context.store.require_writable()
    try:
        return await context.store.write(note_entry, wanted, asking)
    except FutureEntryError as err:
        raise Problem(422, "invalid-request", f"body.{err}") from err


@router.get("/diary", dependencies=READABLE)
async def get_diary(
    context: Context,
    since: Annotated[GivenTime | None, Query(description="Done at or after, RFC 3339")] = None,
    until: Annotated[GivenTime | None, Query(description="Done before")] = None,
    limit: Annotated[int, Query(ge=1, le=1000, description="Entries of the answer, at most")] = 100,
) -> DiaryPage:
    """List the entries of the crusher's diary, newest first."""
    return DiaryPage(items=await context.store.read(entries, since, until, limit))


@router.get("/diary/changes", response_model=Changes, dependencies=READABLE)
async def get_changes(
    context: Context,
    hours: Hours = 24.0,
    language: Annotated[Language, Query(description="Language of the sentences")] = Language.ENGLISH,
) -> Response:
    """List the changes since each diary entry of the last hours: D50, FI, SI and stones a minute, before and after.

    Each side reaches to the neighbouring entry, at most 12 h. Stones that fall soon after each other are alike, which
    the intervals allow for. Clock times in sentences are the host's.
    """
    now, measured = rfc3339(next_second()), context.control.lots.measured
    content = await shared(context, changes_json, now, hours, measured, language, keep_s=KEEP_S)
    return Response(content, media_type="application/json")
