"""Webhooks: endpoints that are told of events, what became of that, and what an operator can do about it."""

from dataclasses import asdict
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query, Response
from pydantic import AfterValidator, BaseModel, Field, SecretStr

from service.base.errors import InvalidRequestError
from service.base.ids import ID, NEW_ID
from service.base.schema import RequestBody
from service.delivery.definitions import new_secret
from service.delivery.settings import MAX_URL, WebhookEndpoint, key_of
from service.delivery.table import Attempt, deliveries
from service.delivery.webhook_documents import DefinedWebhook, WebhookDocument
from service.delivery.webhooks import Webhooks
from service.store.events import EventType
from service.web.auth import CONFIGURABLE, Who
from service.web.context import ApiContext, Context
from service.web.feeds import MAX_SEQ
from service.web.problems import problem_responses


def _a_secret(given: SecretStr) -> SecretStr:
    """Return a secret as it is given; raise `ValueError` if it is none, without telling it."""
    key_of(given.get_secret_value())
    return given


GivenSecret = Annotated[SecretStr, Field(max_length=200), AfterValidator(_a_secret)]
MADE_OR_GIVEN = "`whsec_` and base64 of 24 to 64 bytes; one is made and shown when absent"

router = APIRouter(prefix="/webhooks", tags=["webhooks"], dependencies=CONFIGURABLE)


class WebhooksDocument(BaseModel):
    """All endpoints."""

    items: list[WebhookDocument] = Field(
        description="Those made over REST by name, then those of the configuration in its order"
    )


class DeliveriesDocument(BaseModel):
    """The newest attempts of an endpoint; 500 are kept."""

    items: list[Attempt] = Field(description="Newest first")


class ReplayRequest(RequestBody):
    """From where events are posted to an endpoint again."""

    after: int = Field(
        ge=0, le=MAX_SEQ, strict=True, description="`seq` of the last event that is not posted again"
    )


class WebhookRequest(RequestBody):
    """An endpoint as it is to be."""

    url: str = Field(
        max_length=MAX_URL,
        description="`http` or `https`, without user and password; its host must be in `[webhooks] allowed_hosts`",
    )
    events: tuple[EventType, ...] = Field(
        default=tuple(EventType),
        min_length=1,
        max_length=len(EventType),
        description="Types of the events that it gets; all when absent",
    )
    secret: GivenSecret | None = Field(default=None, description=f"Of a new one: {MADE_OR_GIVEN}")


class SecretRequest(RequestBody):
    """A secret beside the one that the receiver knows."""

    secret: GivenSecret | None = Field(default=None, description=MADE_OR_GIVEN)


class ResendRequest(RequestBody):
    """The event to be sent once more."""

    event: int = Field(ge=1, le=MAX_SEQ, strict=True, description="`seq` of the event")


async def name_of(
    context: Context, webhook: Annotated[str, Path(pattern=ID, description="`name` of the endpoint")]
) -> str:
    """Return the name of an endpoint that is there."""
    return context.part(Webhooks).require(webhook).name


Name = Annotated[str, Depends(name_of)]
NewName = Annotated[str, Path(pattern=NEW_ID, description="`name` of the endpoint")]


@router.get("")
async def webhooks(context: Context) -> WebhooksDocument:
    """List the webhook endpoints, and how far they are."""
    return WebhooksDocument(items=await context.part(Webhooks).statuses())


@router.put("/{webhook}", responses=problem_responses(409))
async def put_webhook(
    context: Context, webhook: NewName, wanted: WebhookRequest, asking: Who
) -> DefinedWebhook:
    """Define or change a webhook: a new one is told of what happens from then on, and its secret is shown this once.

    409 `webhook-conflict` for one of the configuration, or if `secret` is another one than it has.
    """
    context.store.require_writable()
    secret = wanted.secret or new_secret()
    try:
        endpoint = WebhookEndpoint(name=webhook, url=wanted.url, events=wanted.events, secrets=(secret,))
        is_new = await context.part(Webhooks).define(endpoint, wanted.secret is not None, asking)
    except ValueError as err:
        raise InvalidRequestError(str(err).removeprefix(f"{webhook}: ")) from None
    return await _defined(context, webhook, secret if is_new and wanted.secret is None else None)


@router.delete("/{webhook}", status_code=204, response_class=Response, responses=problem_responses(409))
async def delete_webhook(
    context: Context,
    webhook: Annotated[str, Path(pattern=ID, description="`name` of the endpoint")],
    asking: Who,
) -> None:
    """Remove a webhook that was made over REST: it is told of nothing any more. 409 for one of the configuration."""
    context.store.require_writable()
    await context.part(Webhooks).remove(webhook, asking)


@router.put("/{webhook}/secret", responses=problem_responses(404, 409))
async def rotate_webhook_secret(
    context: Context, name: Name, wanted: SecretRequest, asking: Who
) -> DefinedWebhook:
    """Begin the rotation of a secret: messages are signed with a new one as well, which is shown this once.

    Asked again, it replaces the new one; the one that the receiver knows stays until the rotation is ended.
    """
    context.store.require_writable()
    secret = wanted.secret or new_secret()
    await context.part(Webhooks).rotate(name, secret, asking)
    return await _defined(context, name, secret if wanted.secret is None else None)


@router.delete("/{webhook}/secret", responses=problem_responses(404, 409))
async def end_webhook_rotation(context: Context, name: Name, asking: Who) -> WebhookDocument:
    """End the rotation of a secret: messages are signed with the newest one alone."""
    context.store.require_writable()
    await context.part(Webhooks).end_rotation(name, asking)
    return await context.part(Webhooks).status(name)


async def _defined(context: ApiContext, name: str, made: SecretStr | None) -> DefinedWebhook:
    """Return an endpoint with the secret that was made for it."""
    status = await context.part(Webhooks).status(name)
    return DefinedWebhook(**asdict(status), secret=None if made is None else made.get_secret_value())


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


@router.post("/{webhook}/resend", responses=problem_responses(410))
async def resend_webhook_event(context: Context, name: Name, wanted: ResendRequest, asking: Who) -> Attempt:
    """Resend one event to a webhook: now, once, under the id that it had, whatever its turn; returns the outcome.

    409 `cursor-ahead` and 410 `cursor-expired` as at `/events`, 503 `busy` while another message is sent by hand.
    """
    context.store.require_writable()
    return await context.part(Webhooks).resend(name, wanted.event, asking)


ROUTERS = (router,)
