"""Who changed what."""

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from service.api.context import Context
from service.api.problems import problem_responses
from service.api.routes.results import MAX_SEQ
from service.lots.audit import entries
from service.results.fields import TIME

router = APIRouter(prefix="/audit", tags=["audit"])


class AuditEntryDocument(BaseModel):
    """One change; never edited."""

    entry: int
    at: str = Field(json_schema_extra=TIME)
    who: str = Field(description="Name of the key, or `this machine` while none is configured")
    action: str
    subject: str = Field(description="What was changed, such as the id of a lot")
    before: dict[str, Any] | None
    after: dict[str, Any] | None


class AuditPage(BaseModel):
    """Entries in their order."""

    items: list[AuditEntryDocument]


@router.get("", response_model=AuditPage, responses=problem_responses())
async def audit(
    context: Context,
    subject: Annotated[str | None, Query(max_length=64)] = None,
    after: Annotated[int, Query(ge=0, le=MAX_SEQ, description="`entry` of the last one that is known")] = 0,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> dict[str, Any]:
    """Return who changed lots and products, oldest first."""
    return {"items": [asdict(each) for each in await context.store.read(entries, subject, after, limit)]}
