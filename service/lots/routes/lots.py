"""Lots of the plant: opened, closed, voided; the stones that are assigned to them."""

import asyncio
import re
import sqlite3
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Response
from fastapi import Request as HttpRequest
from pydantic import BaseModel, Field

from service.base.ids import ID
from service.base.schema import GivenTime, RequestBody, request_body
from service.lots.lots import (
    LotChoice,
    LotDefinition,
    LotDocument,
    LotState,
    Tonnage,
    assign,
    close_lot,
    definition_of,
    facts_of,
    find_lot,
    lots,
    open_lot,
    void_lot,
)
from service.web.auth import OPERABLE, READABLE, Who
from service.web.context import Context
from service.web.etags import NOT_MODIFIED, TAGGED, IfMatch, change_if_match, etag, unchanged
from service.web.feeds import MAX_SEQ
from service.web.problems import existing, problem_responses
from service.web.version import BASE

router = APIRouter(prefix="/lots", tags=["lots"])

LotName = Annotated[str, Path(pattern=ID, description="Id of the lot")]
STONES = re.compile('-[0-9]+-[0-9]+-[0-9]+(?=")')
"""The numbers of stones in the tag of a lot, and the revision that is completed."""
Change = Callable[[Callable[..., LotDocument | None], object], Awaitable[LotDocument]]
"""Makes a change of a lot, such as `close_lot`, with what is given for it; returns the lot after it."""


@request_body
class LotRequest(LotDefinition):
    """A lot to open, in the words of ISA-95."""

    product: Annotated[str, Field(pattern=ID)]
    """Material definition."""
    product_version: Annotated[int, Field(ge=1, le=MAX_SEQ, strict=True)] | None = None
    """The newest when absent."""
    closes: Annotated[str, Field(pattern=ID)] | None = None
    """The open lot, which is closed first: no stone falls between the two."""


class CloseRequest(RequestBody):
    """What is known of a lot at its end."""

    tonnage_t: Tonnage | None = Field(default=None, description="Of the whole lot, t")


class VoidRequest(RequestBody):
    """Why a lot or a sieving counts no more."""

    reason: Annotated[str, Field(min_length=1, max_length=2000)] = Field(
        description="Why it counts no more; kept with it and in the audit"
    )


class AssignRequest(RequestBody):
    """A time, whose stones outside of any lot are to be in this one."""

    since: Annotated[GivenTime, Field(description="Captured at or after")]
    until: Annotated[GivenTime, Field(description="Captured before")]


class LotsQuery(LotChoice):
    """Lots that are listed."""

    limit: int = Field(default=100, ge=1, le=1000, description="Lots of a page, at most")


class LotsPage(BaseModel):
    """Lots, newest first."""

    items: list[LotDocument] = Field(description="Newest first")
    next_before: str | None = Field(description="Pass as `before` for the next page; null on the last")


class Assigned(BaseModel):
    """What an assignment changed."""

    lot: LotDocument = Field(description="The lot as it is now")
    n_assigned: int = Field(description="Stones that are in the lot now and were in none")


@router.post(
    "",
    status_code=201,
    response_model=LotDocument,
    dependencies=OPERABLE,
    responses={**TAGGED, **problem_responses(404)},
)
async def post_lot(context: Context, wanted: LotRequest, response: Response, asking: Who) -> LotDocument:
    """Open a lot: what falls from now on is in it, whenever it is measured.

    The same request again returns the open lot. 409 `lot-conflict` while another is open that it does
    not name in `closes`, or if this one was.
    """
    record = await context.write(
        open_lot, definition_of(wanted), wanted.product, wanted.product_version, asking, wanted.closes
    )
    response.headers["Location"] = f"{BASE}/lots/{wanted.lot}"
    return _served(response, record)


@router.get("", response_model=LotsPage, dependencies=READABLE)
async def list_lots(context: Context, query: Annotated[LotsQuery, Query()]) -> LotsPage:
    """List the lots, newest first."""
    found = await context.store.read(lots, query, query.limit + 1)
    items = found[: query.limit]
    return LotsPage(items=items, next_before=items[-1].opened_at if len(found) > query.limit else None)


@router.get("/{lot}", response_model=LotDocument, dependencies=READABLE, responses=NOT_MODIFIED)
async def get_lot(context: Context, asked: HttpRequest, response: Response, lot: LotName) -> Any:
    """Get a lot; its `ETag` is for `If-Match` of a change."""
    record = existing(await context.store.read(find_lot, lot), "lot", lot)
    return unchanged(asked, _tag(record)) or _served(response, record)


async def change_of(
    context: Context, lot: LotName, asking: Who, response: Response, if_match: IfMatch = None
) -> Change:
    """Return the function that changes a lot; for `If-Match`, stones that fell meanwhile are no change."""

    def version(connection: sqlite3.Connection) -> str:
        return _tag_of_facts(existing(find_lot(connection, lot), "lot", lot))

    async def changed(change: Callable[..., LotDocument | None], given: object) -> LotDocument:
        facts = None if if_match is None else STONES.sub("", if_match)
        found = await context.write(change_if_match, facts, version, change, lot, given, asking)
        return _served(response, existing(found, "lot", lot))

    return changed


@router.post("/{lot}/close", response_model=LotDocument, dependencies=OPERABLE)
async def post_close(
    context: Context,
    wanted: CloseRequest,
    changed: Annotated[Change, Depends(change_of)],
    response: Response,
    wait_s: Annotated[
        float,
        Query(
            ge=0,
            le=300,
            description="Longest wait for the last stones' outcomes, the verdict and the report, s",
        ),
    ] = 0.0,
) -> LotDocument:
    """Close a lot; what fell before stays in it, though it is measured later. A closed one stays as it is.

    Figures are final once `completion` is of this `revision`: `wait_s` waits for that, `lot.completed` is its event.
    """
    record = await changed(close_lot, wanted.tonnage_t)
    with suppress(TimeoutError):
        async with asyncio.timeout(wait_s):
            while record.is_closed and not record.is_final and not context.store.is_released:
                last_event = context.store.last_event
                record = existing(await context.store.read(find_lot, record.lot), "lot", record.lot)
                if not record.is_final:
                    await context.store.wait_for_event(last_event)
    return _served(response, record)


@router.post("/{lot}/void", response_model=LotDocument, dependencies=OPERABLE)
async def post_void(wanted: VoidRequest, changed: Annotated[Change, Depends(change_of)]) -> LotDocument:
    """Declare a lot void: it counts no more, and is kept."""
    return await changed(void_lot, wanted.reason)


@router.post("/{lot}/assign", response_model=Assigned, dependencies=OPERABLE)
async def post_assign(context: Context, lot: LotName, wanted: AssignRequest, asking: Who) -> Assigned:
    """Assign stones to a lot: those of a time that are in no lot; the audit keeps who did it."""
    done = await context.write(assign, lot, wanted.since, wanted.until, asking)
    record, n_assigned = existing(done, "lot", lot)
    return Assigned(lot=record, n_assigned=n_assigned)


def _served(response: Response, record: LotDocument) -> LotDocument:
    response.headers["ETag"] = _tag(record)
    return record


def _tag(record: LotDocument) -> str:
    """Return the version of a lot: what the plant says of it, how many stones it has, and what is completed."""
    completed = 0 if record.completion is None else record.completion.revision
    return f'{_tag_of_facts(record)[:-1]}-{record.n_stones}-{record.in_progress}-{completed}"'


def _tag_of_facts(record: LotDocument) -> str:
    """Return the version of what people say of a lot: its stones come by themselves."""
    by_itself = {
        "n_stones": 0,
        "in_progress": 0,
        "completion": None,
        "reached": None,
        "state": LotState.CLOSED,
    }
    return (
        etag(facts_of(record) | by_itself)
        if record.is_closed
        else etag(facts_of(record) | by_itself | {"state": record.state})
    )
