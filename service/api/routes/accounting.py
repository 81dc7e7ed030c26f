"""What became of the triggers."""

from dataclasses import asdict
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query

from service.api.context import Context
from service.api.problems import documented
from service.api.routes.results import MAX_SEQ
from service.api.schemas import AccountingDocument

router = APIRouter(prefix="/accounting", tags=["accounting"])

SessionNumber = Annotated[int, Query(ge=1, le=MAX_SEQ)]


@router.get("", response_model=AccountingDocument, responses=documented())
async def accounting(
    context: Context,
    session: Annotated[
        SessionNumber | Literal["current"] | None, Query(description="One run of the daemon; all when absent")
    ] = None,
) -> dict[str, Any]:
    """Count triggers and outcomes; every trigger is in exactly one of the four."""
    number = context.store.session if session == "current" else session
    counts = await context.store.accounting(number)
    return {**asdict(counts), "is_balanced": counts.is_balanced, "session": number}
