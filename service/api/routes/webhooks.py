"""Webhooks: endpoints that are told of events, what became of that, and what an operator can do about it."""

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query
from pydantic import BaseModel, ConfigDict, Field

from service.api.auth import Who, require
from service.api.context import Context
from service.api.feeds import MAX_SEQ
from service.api.problems import Problem, existing, problem_responses
from service.api.settings import Scope
from service.base.ids import ID
from service.base.redaction import shown
from service.base.schema import TIME
from service.delivery.table import Attempt, EventCursorError, deliveries
from service.delivery.webhooks import BeingTestedError, EndpointStatus
from service.store.events import EventType

router = APIRouter(prefix="/webhooks", tags=["webhooks"], dependencies=[Depends(require(Scope.CONFIGURE))])


class WebhookDocument(BaseModel):
    """An endpoint that events are posted to, and its progress; without its secrets."""

    name: str = Field(description="As it is configured")
    url: str = Field(description="Scheme, host and first part of the path: the rest may be secret")
    events: list[EventType] = Field(description="Types of the events that it gets")
    after: int = Field(description="`seq` of the last event that it has taken")
    waiting: int = Field(description="Events that wait to be posted to it")
    attempts: int = Field(description="Failed ones of the next event")
    failing_since: str | None = Field(
        json_schema_extra=TIME, description="First of these, RFC 3339 UTC; null without any"
    )
    next_attempt_at: str | None = Field(
        json_schema_extra=TIME, description="When it is tried again; null: at once, or it is disabled"
    )
    last_problem: str | None = Field(description="Of the latest attempt; null if it did not fail")
    last_taken_at: str | None = Field(
        json_schema_extra=TIME, description="When it took a message last; null before the first"
    )
    disabled_at: str | None = Field(
        json_schema_extra=TIME, description="Not null: it gets nothing until it is enabled"
    )


class WebhooksDocument(BaseModel):
    """All endpoints that are configured."""

    items: list[WebhookDocument] = Field(description="In the order of the configuration")


class DeliveriesDocument(BaseModel):
    """The newest attempts of an endpoint; 500 are kept."""

    items: list[Attempt] = Field(description="Newest first")


class ReplayRequest(BaseModel):
    """From where events are posted to an endpoint again."""

    model_config = ConfigDict(extra="forbid")

    after: int = Field(
        ge=0, le=MAX_SEQ, strict=True, description="`seq` of the last event that is not posted again"
    )


async def name_of(
    context: Context,
    webhook: Annotated[str, Path(pattern=ID, description="`name` of the endpoint")],
) -> str:
    """Return the name of an endpoint that is configured."""
    return existing(context.control.webhooks.find(webhook), "webhook", webhook).name


Name = Annotated[str, Depends(name_of)]


@router.get("", response_model=WebhooksDocument)
async def webhooks(context: Context) -> dict[str, Any]:
    """List the webhook endpoints, and how far they are."""
    return {"items": [_document(status) for status in await context.control.webhooks.statuses()]}


@router.get("/{webhook}/deliveries", responses=problem_responses(404))
async def webhook_deliveries(
    context: Context,
    name: Name,
    limit: Annotated[int, Query(ge=1, le=500, description="Attempts, at most")] = 100,
) -> DeliveriesDocument:
    """List the deliveries of a webhook: the newest attempts and their outcome, newest first."""
    return DeliveriesDocument(items=await context.store.read(deliveries, name, limit))


@router.post("/{webhook}/enable", response_model=WebhookDocument, responses=problem_responses(404))
async def enable_webhook(context: Context, name: Name, asking: Who) -> dict[str, Any]:
    """Enable a webhook: try its endpoint again at once, whether it was disabled or waits for its next attempt."""
    context.store.require_writable()
    await context.control.webhooks.enable(name, asking)
    return _document(await context.control.webhooks.status(name))


@router.post("/{webhook}/replay", response_model=WebhookDocument, responses=problem_responses(404, 409, 410))
async def replay_webhook(context: Context, name: Name, wanted: ReplayRequest, asking: Who) -> dict[str, Any]:
    """Replay events to a webhook: all after a number, under the ids that they had; forward, it skips events.

    A disabled one gets them when it is enabled. 409 `cursor-ahead` and 410 `cursor-expired` as at `/events`.
    """
    context.store.require_writable()
    try:
        await context.control.webhooks.replay(name, wanted.after, asking)
    except EventCursorError as err:
        status, slug = (409, "cursor-ahead") if err.is_ahead else (410, "cursor-expired")
        raise Problem(status, slug, str(err), **err.ends) from err
    return _document(await context.control.webhooks.status(name))


@router.post("/{webhook}/test", responses=problem_responses(404))
async def test_webhook(context: Context, name: Name, asking: Who) -> Attempt:
    """Test a webhook: send `webhook.test` now, once, disabled or not, and return the outcome.

    It takes as long as the endpoint, `[webhooks] timeout_s` at most. 503 `busy` while another test is under way.
    """
    context.store.require_writable()
    try:
        return await context.control.webhooks.test(name, asking)
    except BeingTestedError as err:
        raise Problem(503, "busy", str(err), retry_after_s=2) from err


def _document(status: EndpointStatus) -> dict[str, Any]:
    endpoint = status.endpoint
    return asdict(status.progress) | {
        "name": endpoint.name,
        "url": shown(endpoint.target._replace(query="").geturl()),
        "events": endpoint.events,
        "waiting": status.n_due,
    }
