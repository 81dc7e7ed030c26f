"""Counts of triggers and of their outcomes."""

from dataclasses import asdict
from typing import Annotated

from fastapi import APIRouter, Query

from service.base.schema import served
from service.store.accounting import Accounting
from service.store.accounting import accounting as counts_of
from service.web.auth import READABLE
from service.web.context import Context

router = APIRouter(prefix="/accounting", tags=["accounting"], dependencies=READABLE)


@served
class AccountingDocument(Accounting):
    """`triggers = measured + rejected + lost + in_progress`."""

    session: int | None
    """Session (run of the daemon) that is counted; null: all."""


@router.get("")
async def accounting(
    context: Context,
    session: Annotated[
        str | None,
        Query(
            pattern="^(current|[1-9][0-9]{0,14})$",
            description="Number of the session (run of the daemon) to count, or `current`; all when absent",
        ),
    ] = None,
) -> AccountingDocument:
    """Count the triggers and their outcomes; every trigger is in exactly one of the four."""
    number = context.store.session if session == "current" else None if session is None else int(session)
    return AccountingDocument(**asdict(await context.store.read(counts_of, number)), session=number)
