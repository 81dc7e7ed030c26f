"""Named readers of the feed: results are kept for longer while one of them has not read them."""

import sqlite3
from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request, Response
from pydantic import BaseModel, Field

from service.base.ids import ID
from service.base.schema import RequestBody
from service.store.retention import ConsumerDocument, ParkedCursor, consumers, forget, park
from service.web.auth import OPERABLE, READABLE, Who
from service.web.context import Context
from service.web.etags import NOT_MODIFIED, IfMatch, change_if_match, etag, unchanged
from service.web.feeds import MAX_SEQ
from service.web.problems import existing, problem_responses

router = APIRouter(prefix="/consumers", tags=["results"])

ConsumerName = Annotated[str, Path(pattern=ID, description="Name that the consumer chooses")]


class Consumers(BaseModel):
    """All consumers, by name."""

    items: list[ConsumerDocument] = Field(description="By name")


class Cursor(RequestBody):
    """The place up to which a consumer has read the feed."""

    after: int = Field(ge=0, le=MAX_SEQ, strict=True, description="`next_after` of the last page that it has")


@router.get("", dependencies=READABLE)
async def list_consumers(context: Context) -> Consumers:
    """List the consumers."""
    return Consumers(items=await context.store.read(consumers))


@router.get("/{name}/cursor", response_model=ParkedCursor, dependencies=READABLE, responses=NOT_MODIFIED)
async def parked_cursor(context: Context, request: Request, response: Response, name: ConsumerName) -> Any:
    """Get the cursor of a consumer; its `ETag` is for `If-Match` where two clients share the name."""
    found = existing(await context.store.read(_find, name), "consumer", repr(name))
    response.headers["ETag"] = _tag(found)
    return unchanged(request, _tag(found)) or asdict(found)


@router.put("/{name}/cursor", dependencies=OPERABLE, responses=problem_responses(409, 410))
async def park_cursor(
    context: Context, response: Response, name: ConsumerName, cursor: Cursor, if_match: IfMatch = None
) -> ConsumerDocument:
    """Park the cursor of a consumer, which this makes known; results after it are kept for longer.

    409 `cursor-ahead` and 410 `cursor-expired` as at `/results`; 409 `too-many-consumers`. 412 with `If-Match` when
    another client of this name has parked meanwhile: read the cursor, and go on from where that one is.
    """

    def version(connection: sqlite3.Connection) -> str | None:
        found = _find(connection, name)
        return None if found is None else _tag(found)

    parked: ConsumerDocument = await context.write(
        change_if_match, if_match, version, park, name, cursor.after
    )
    response.headers["ETag"] = _tag(parked)
    return parked


@router.delete("/{name}", status_code=204, response_class=Response, dependencies=OPERABLE)
async def delete_consumer(context: Context, name: ConsumerName, asking: Who) -> None:
    """Forget a consumer: nothing is kept for it any more."""
    is_forgotten = await context.write(forget, name, asking)
    existing(is_forgotten or None, "consumer", repr(name))


def _find(connection: sqlite3.Connection, name: str) -> ConsumerDocument | None:
    return next((consumer for consumer in consumers(connection) if consumer.name == name), None)


def _tag(parked: ParkedCursor) -> str:
    """Return the version of a cursor; results that come meanwhile are no change of it."""
    return etag(parked.name, parked.after, parked.moved_at)
