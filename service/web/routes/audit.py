"""Who changed what."""

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, Field

from service.store.audit import AuditEntry, csv_page, entries
from service.web.auth import READABLE
from service.web.context import ApiContext, Context
from service.web.feeds import MAX_SEQ

router = APIRouter(tags=["audit"], dependencies=READABLE)

PAGE = 1000
"""Entries of an export that are read at a time."""

Subject = Annotated[str | None, Query(max_length=64, description="Only changes of this subject")]
After = Annotated[int, Query(ge=0, le=MAX_SEQ, description="`entry` of the last one that is known")]


class AuditPage(BaseModel):
    """Entries in their order."""

    items: list[AuditEntry] = Field(description="By rising `entry`")


@router.get("/audit")
async def audit(
    context: Context,
    subject: Subject = None,
    after: After = 0,
    limit: Annotated[int, Query(ge=1, le=1000, description="Entries of a page, at most")] = 100,
) -> AuditPage:
    """List the audit: who changed what, oldest first. It has every write over REST but the cursors of consumers."""
    return AuditPage(items=await context.store.read(entries, subject, after, limit))


@router.get("/audit.csv", response_class=StreamingResponse, responses={200: {"content": {"text/csv": {}}}})
async def audit_csv(context: Context, subject: Subject = None, after: After = 0) -> StreamingResponse:
    """Download the audit as CSV (RFC 4180): oldest first, `before` and `after` as JSON."""
    first = await _page(context, subject, after)
    return StreamingResponse(
        _pages(context, subject, first),
        media_type="text/csv",
        headers={"Content-Disposition": 'attachment; filename="audit.csv"'},
    )


async def _pages(
    context: ApiContext, subject: str | None, page: tuple[bytes, int | None]
) -> AsyncIterator[bytes]:
    content, last = page
    yield content
    while last is not None:
        content, last = await _page(context, subject, last)
        yield content


async def _page(context: ApiContext, subject: str | None, after: int) -> tuple[bytes, int | None]:
    return await context.read_beside(csv_page, subject, after, PAGE)
