"""Who changed what."""

from collections.abc import AsyncIterator
from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, Field

from service.api.context import ApiContext, Context
from service.api.feeds import MAX_SEQ
from service.base.schema import TIME
from service.store import read
from service.store.audit import csv_page, entries

router = APIRouter(tags=["audit"])

PAGE = 1000
"""Entries of an export that are read at a time."""

Subject = Annotated[str | None, Query(max_length=64, description="Only changes of this subject")]
After = Annotated[int, Query(ge=0, le=MAX_SEQ, description="`entry` of the last one that is known")]


class AuditEntryDocument(BaseModel):
    """One change; never edited."""

    entry: int = Field(description="Number of the entry, in the order of the changes")
    at: str = Field(description="When it was changed, RFC 3339 UTC", json_schema_extra=TIME)
    who: str = Field(description="Name of the key, or `this machine` while there is none")
    action: str = Field(description="Such as `lot opened`, `calibration activated`, `acquisition disarmed`")
    subject: str = Field(description="What was changed, such as the id of a lot")
    before: dict[str, Any] | None = Field(description="What it was before; null when there was nothing")
    after: dict[str, Any] | None = Field(description="What it is since; null when there is nothing")
    digest: str | None = Field(
        description="SHA-256 of the digest before and of this entry, which makes the entries a chain; null in those of"
        " earlier versions"
    )


class AuditPage(BaseModel):
    """Entries in their order."""

    items: list[AuditEntryDocument] = Field(description="By rising `entry`")


@router.get("/audit", response_model=AuditPage)
async def audit(
    context: Context,
    subject: Subject = None,
    after: After = 0,
    limit: Annotated[int, Query(ge=1, le=1000, description="Entries of a page, at most")] = 100,
) -> dict[str, Any]:
    """List the audit: who changed what, oldest first. It has every write over REST but the cursors of consumers."""
    return {"items": [asdict(each) for each in await context.store.read(entries, subject, after, limit)]}


@router.get(
    "/audit.csv",
    response_class=StreamingResponse,
    responses={200: {"content": {"text/csv": {}}}},
)
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
    return await context.reading.run(read, context.store.path, csv_page, subject, after, PAGE)
