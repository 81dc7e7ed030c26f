"""Counts of triggers and of their outcomes."""

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from service.api.context import Context

router = APIRouter(prefix="/accounting", tags=["accounting"])


class AccountingDocument(BaseModel):
    """`triggers = measured + rejected + lost + in_progress`."""

    session: int | None = Field(description="Session (run of the daemon) that is counted; null: all")
    triggers: int = Field(description="Stones and balls that the light gate reported")
    measured: int = Field(description="Triggers whose stone has a body and its measures")
    rejected: int = Field(description="Triggers whose views were looked at and found unfit")
    lost: int = Field(description="Triggers whose views were never looked at")
    in_progress: int = Field(description="Triggers without an outcome yet")
    is_balanced: bool = Field(description="Whether the sum holds; false is a fault of the service")
    backgrounds: int = Field(description="Exposures of the empty rig; not among the triggers")
    by_reason: dict[str, int] = Field(description="Rejected and lost triggers, by reason")
    by_quality: dict[str, int] = Field(description="Measured triggers, by quality")


@router.get("", response_model=AccountingDocument)
async def accounting(
    context: Context,
    session: Annotated[
        str | None,
        Query(
            pattern="^(current|[1-9][0-9]{0,14})$",
            description="Number of the session (run of the daemon) to count, or `current`; all when absent",
        ),
    ] = None,
) -> dict[str, Any]:
    """Count the triggers and their outcomes; every trigger is in exactly one of the four."""
    number = context.store.session if session == "current" else None if session is None else int(session)
    counts = await context.store.accounting(number)
    return {**asdict(counts), "is_balanced": counts.is_balanced, "session": number}
