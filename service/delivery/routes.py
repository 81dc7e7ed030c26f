"""Webhooks: endpoints that are told of events, what became of that, and what an operator can do about it."""

from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query
from pydantic import BaseModel, Field

from service.base.ids import ID
from service.base.schema import RequestBody
from service.delivery.table import Attempt, deliveries
from service.delivery.webhooks import WebhookDocument, Webhooks
from service.web.auth import CONFIGURABLE, Who
from service.web.context import Context
from service.web.feeds import MAX_SEQ
from service.web.problems import existing, problem_responses

router = APIRouter(prefix="/webhooks", tags=["webhooks"], dependencies=CONFIGURABLE)


class WebhooksDocument(BaseModel):
    """All endpoints that are configured."""

    items: list[WebhookDocument] = Field(description="In the order of the configuration")


class DeliveriesDocument(BaseModel):
    """The newest attempts of an endpoint; 500 are kept."""

    items: list[Attempt] = Field(description="Newest first")


class ReplayRequest(RequestBody):
    """From where events are posted to an endpoint again."""

    after: int = Field(
        ge=0, le=MAX_SEQ, strict=True, description="`seq` of the last event that is not posted again"
    )


async def name_of(
    context: Context, webhook: Annotated[str, Path(pattern=ID, description="`name` of the endpoint")]
) -> str:
    """Return the name of an endpoint that is configured."""
    return existing(context.part(Webhooks).find(webhook), "webhook", webhook).name


Name = Annotated[str, Depends(name_of)]


@router.get("")
async def webhooks(context: Context) -> WebhooksDocument:
    """List the webhook endpoints, and how far they are."""
    return WebhooksDocument(items=await context.part(Webhooks).statuses())


@router.get("/{webhook}/deliveries")
async def webhook_deliveries(
    context: Context,
    name: Name,
    limit: Annotated[int, Query(ge=1, le=500, description="Attempts, at most")] = 100,
) -> DeliveriesDocument:
    """List the deliveries of a webhook: the newest attempts and their outcome, newest first."""
    return DeliveriesDocument(items=await context.store.read(deliveries, name, limit))


@router.post("/{webhook}/enable")
async def enable_webhook(context: Context, name: Name, asking: Who) -> WebhookDocument:
    """Enable a webhook: try its endpoint again at once, whether it was disabled or waits for its next attempt."""
    context.store.require_writable()
    await context.part(Webhooks).enable(name, asking)
    return await context.part(Webhooks).status(name)


@router.post("/{webhook}/replay", responses=problem_responses(410))
async def replay_webhook(context: Context, name: Name, wanted: ReplayRequest, asking: Who) -> WebhookDocument:
    """Replay events to a webhook: all after a number, under the ids that they had; forward, it skips events.

    A disabled one gets them when it is enabled. 409 `cursor-ahead` and 410 `cursor-expired` as at `/events`.
    """
    context.store.require_writable()
    await context.part(Webhooks).replay(name, wanted.after, asking)
    return await context.part(Webhooks).status(name)


@router.post("/{webhook}/test")
async def test_webhook(context: Context, name: Name, asking: Who) -> Attempt:
    """Test a webhook: send `webhook.test` now, once, disabled or not, and return the outcome.

    It takes as long as the endpoint, `[webhooks] timeout_s` at most. 503 `busy` while another test is under way.
    """
    context.store.require_writable()
    return await context.part(Webhooks).test(name, asking)


ROUTERS = (router,)
