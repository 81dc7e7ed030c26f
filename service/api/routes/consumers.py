"""Named readers of the feed: results are kept for longer while one of them has not read them."""

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Response
from pydantic import BaseModel, ConfigDict, Field

from service.api.auth import Who, require
from service.api.context import Context
from service.api.feeds import MAX_SEQ
from service.api.problems import Problem, existing, problem_responses
from service.api.settings import Scope
from service.results.fields import TIME
from service.store.holds import CursorError, TooManyConsumersError, consumers, forget, park

router = APIRouter(prefix="/consumers", tags=["results"])

ConsumerName = Annotated[
    str, Path(pattern=r"^[A-Za-z0-9_.-]{1,64}$", description="Name that the consumer chooses")
]


class Consumer(BaseModel):
    """A named reader of the feed, and its place there."""

    name: str = Field(description="Name that the consumer chose")
    after: int = Field(description="`seq` of the last result that it has")
    moved_at: str = Field(description="When the cursor was parked, RFC 3339 UTC", json_schema_extra=TIME)
    unread: int = Field(description="Results since")
    is_overrun: bool = Field(
        description="True when results that it has not read were removed: `[store.retention] consumer_days`"
    )


class Consumers(BaseModel):
    """All consumers, by name."""

    items: list[Consumer] = Field(description="By name")


class Cursor(BaseModel):
    """The place up to which a consumer has read the feed."""

    model_config = ConfigDict(extra="forbid")

    after: int = Field(ge=0, le=MAX_SEQ, strict=True, description="`next_after` of the last page that it has")


@router.get(
    "", response_model=Consumers, dependencies=[Depends(require(Scope.READ))], responses=problem_responses()
)
async def list_consumers(context: Context) -> dict[str, Any]:
    """Return all consumers."""
    return {"items": [asdict(consumer) for consumer in await context.store.read(consumers)]}


@router.put(
    "/{name}/cursor",
    response_model=Consumer,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=problem_responses(409, 410),
)
async def park_cursor(context: Context, name: ConsumerName, cursor: Cursor) -> dict[str, Any]:
    """Park the place of a consumer, which this makes known; results after it are kept for longer.

    409 `cursor-ahead` and 410 `cursor-expired` as at `/results`; 409 `too-many-consumers`.
    """
    context.store.require_writable()
    try:
        return asdict(await context.store.write(park, name, cursor.after))
    except CursorError as err:
        status, slug = (409, "cursor-ahead") if err.is_ahead else (410, "cursor-expired")
        raise Problem(status, slug, str(err), **err.ends) from err
    except TooManyConsumersError as err:
        raise Problem(409, "too-many-consumers", str(err)) from err


@router.delete(
    "/{name}",
    status_code=204,
    response_class=Response,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=problem_responses(404),
)
async def delete_consumer(context: Context, name: ConsumerName, asking: Who) -> None:
    """Forget a consumer: nothing is kept for it any more."""
    context.store.require_writable()
    is_forgotten = await context.store.write(forget, name, asking)
    existing(is_forgotten or None, "consumer", repr(name))
