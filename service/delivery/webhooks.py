"""Post events to endpoints, in their order and each at least once: a task an endpoint, the events are the outbox."""

import asyncio
import logging
import random
import ssl
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from http import HTTPStatus
from sqlite3 import Connection
from typing import Concatenate, ParamSpec, TypeVar

from pydantic import SecretStr

from pipeline.frames import rfc3339
from service.base import messages
from service.base.errors import ProblemError, ProblemKind, StoreError
from service.base.status import Checks, trouble_check
from service.delivery import definitions, table
from service.delivery.definitions import Definitions, WebhookConflictError
from service.delivery.posting import Message, message_of, post, signatures, trial_message
from service.delivery.progress import EndpointAnswer, EndpointProgress, next_progress
from service.delivery.settings import WebhookEndpoint, WebhooksSettings
from service.delivery.table import Attempt
from service.delivery.webhook_documents import WebhookDocument
from service.store import Store
from service.store.events import CursorError, events_after

log = logging.getLogger(__name__)

P = ParamSpec("P")
T = TypeVar("T")

STORE_RETRY_S = 5.0
"""Pause after the store could not be read."""


class BeingTestedError(ProblemError):
    """The endpoint is being tested already."""

    kinds = (
        ProblemKind("busy", HTTPStatus.SERVICE_UNAVAILABLE, "More is asked for than can be made at a time"),
    )
    retry_after_s = 2


class UnknownWebhookError(ProblemError):
    """There is no such endpoint, or not any more."""

    kinds = (ProblemKind("unknown-webhook", HTTPStatus.NOT_FOUND, "No such webhook"),)


@dataclass(slots=True)
class _Told:
    """What is known of an endpoint in memory."""

    progress: EndpointProgress | None = None  # None: before the first look
    looked_from: int = -1  # after this event
    looked_to: int = -1  # ... and up to this one there is none for it
    tls: ssl.SSLContext | None = None
    wake: asyncio.Event = field(default_factory=asyncio.Event)
    is_testing: bool = False


async def _wait(event: asyncio.Event, timeout_s: float) -> None:
    with suppress(TimeoutError):
        async with asyncio.timeout(timeout_s):
            await event.wait()


async def open_webhooks(store: Store, settings: WebhooksSettings) -> "Webhooks":
    """Return the endpoints, as an earlier run of the daemon has left them; new ones begin with the next event."""
    webhooks = Webhooks(store, settings)
    await webhooks.use(settings)
    return webhooks


class Webhooks:
    """Endpoints of webhooks, made by `open_webhooks`: `run` is their task. Call it on the event loop."""

    def __init__(
        self,
        store: Store,
        settings: WebhooksSettings,
        *,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
        chance: Callable[[], float] = random.random,
        wait: Callable[[asyncio.Event, float], Awaitable[None]] = _wait,
    ) -> None:
        self._store = store
        self._now = now
        self._chance = chance
        self._wait = wait
        self._is_changed = asyncio.Event()
        self._defining = asyncio.Lock()
        self._take(settings, Definitions((), ()))

    async def use(self, settings: WebhooksSettings) -> None:
        """Serve these endpoints and those of the store from now on, and no others.

        Of two with one name the configuration's is served. A message under way may be sent once more.
        """
        async with self._defining:
            if settings.endpoints:
                await self._store.write(table.begin, [endpoint.name for endpoint in settings.endpoints])
            self._take(settings, await self._store.read(definitions.definitions, self._store.dir))

    def _take(self, settings: WebhooksSettings, defined: Definitions) -> None:
        self._settings = settings
        self._unreadable = defined.unreadable
        self._endpoints = {endpoint.name: endpoint for endpoint in (*defined.endpoints, *settings.endpoints)}
        self._told = {name: _Told() for name in self._endpoints}
        self._is_changed.set()

    @property
    def troubles(self) -> list[str]:
        """Which endpoints are disabled or have failed for long, and why."""
        found = [
            messages.about(name, trouble)
            for name, told in self._told.items()
            if told.progress is not None and (trouble := _trouble(told.progress, self._now())) is not None
        ]
        unreadable = messages.message(messages.Code.WEBHOOK_UNREADABLE, seal=definitions.SEAL)
        return [*found, *(messages.about(name, unreadable) for name in self._unreadable)]

    def checks(self) -> Checks:
        troubles = self.troubles
        return {"webhooks": trouble_check(messages.joined(troubles), len(troubles), "disabled")}

    async def run(self) -> None:
        """Post events to all endpoints until waiting in the store is ended."""
        while not self._store.is_released:
            self._is_changed.clear()
            async with asyncio.TaskGroup() as tasks:
                telling = tasks.create_task(self._tell_all())
                changing = tasks.create_task(self._is_changed.wait())
                await asyncio.wait((telling, changing), return_when=asyncio.FIRST_COMPLETED)
                telling.cancel()
                changing.cancel()

    async def _tell_all(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            for name, endpoint in self._endpoints.items():
                tasks.create_task(self._tell(endpoint, self._told[name]))
            while not self._store.is_released:
                await self._store.wait_for_event(self._store.last_event)
                for told in self._told.values():
                    told.wake.set()

    def find(self, name: str) -> WebhookEndpoint | None:
        """Return an endpoint, None if there is none of this name."""
        return self._endpoints.get(name)

    def require(self, name: str) -> WebhookEndpoint:
        """Return an endpoint; raise `UnknownWebhookError` if there is none of this name."""
        if (found := self.find(name)) is None:
            raise UnknownWebhookError(f"there is no webhook {name}")
        return found

    async def define(self, wanted: WebhookEndpoint, is_given: bool, who: str) -> bool:
        """Make or change an endpoint over REST, and return whether it is new; see `definitions.define`.

        Raises `ValueError` if its host is not one that the configuration allows.
        """
        if not self._settings.allows_host(wanted.host):
            raise ValueError(
                f"url: its host {wanted.host} is not in [webhooks] allowed_hosts of the configuration"
            )
        return await self._change(wanted.name, definitions.define, self._store.dir, wanted, is_given, who)

    async def rotate(self, name: str, secret: SecretStr, who: str) -> None:
        """Sign with another secret as well."""
        await self._change(name, definitions.rotate, self._store.dir, name, secret, who)

    async def end_rotation(self, name: str, who: str) -> None:
        """Sign with the newest secret alone from now on."""
        await self._change(name, definitions.end_rotation, self._store.dir, name, who)

    async def remove(self, name: str, who: str) -> None:
        """Remove an endpoint that was made over REST; raise `UnknownWebhookError` if there is none."""
        if not await self._change(name, definitions.remove, name, who):
            raise UnknownWebhookError(f"there is no webhook {name}")

    async def _change(
        self, name: str, change: Callable[Concatenate[Connection, P], T], *args: P.args, **kwargs: P.kwargs
    ) -> T:
        """Return `change(connection, ...)`, after which the endpoints of the store are others."""
        if self._is_of_configuration(name):
            raise WebhookConflictError(f"webhook {name} is of the configuration: change it there")
        changed = await self._store.write(change, *args, **kwargs)
        await self.use(self._settings)
        return changed

    def _is_of_configuration(self, name: str) -> bool:
        return any(endpoint.name == name for endpoint in self._settings.endpoints)

    async def status(self, name: str) -> WebhookDocument:
        """Return an endpoint and its progress."""
        endpoint = self.require(name)
        progress = asdict(await self._store.read(table.progress_of, name))
        del progress["waited_s"]
        return WebhookDocument(
            name=name,
            is_of_configuration=self._is_of_configuration(name),
            n_secrets=len(endpoint.secrets) + len(endpoint.secret_files),
            url=endpoint.shown_url,
            events=endpoint.events,
            waiting=await self._store.read(table.n_due, progress["after"], endpoint.events),
            **progress,
        )

    async def statuses(self) -> list[WebhookDocument]:
        """Return all endpoints and their progress."""
        return [await self.status(name) for name in tuple(self._endpoints)]

    async def enable(self, name: str, who: str) -> None:
        """Try an endpoint again at once, whether it was disabled or waits."""
        await self._store.write(table.enable, name, who)
        self._wake(name)

    async def replay(self, name: str, after: int, who: str) -> None:
        """Post all events after a number to an endpoint again; to a disabled one when it is enabled.

        Raises `CursorError` if they are not there yet, or no longer.
        """
        await self._store.write(table.replay, name, after, who)
        self._wake(name)

    async def test(self, name: str, who: str) -> Attempt:
        """Send a message without an event, once, disabled or not; raise `BeingTestedError` while one is being sent."""
        message = trial_message(self._store.instance_id, rfc3339(self._now()))
        return await self._send_once(name, message, who)

    async def resend(self, name: str, event: int, who: str) -> Attempt:
        """Send one event once more, out of its turn and under the id that it had; as `test` does.

        Raises `CursorError` if it is not there yet, or no longer.
        """
        found = await self._store.read(events_after, event - 1, 1)
        if not found.items or found.items[0]["seq"] != event:
            problem = f"events {found.first_seq} to {found.last_seq} are kept, not {event}"
            raise CursorError(problem, event, found.first_seq, found.last_seq)
        return await self._send_once(name, message_of(found.items[0], self._store.instance_id), who)

    async def _send_once(self, name: str, message: Message, who: str) -> Attempt:
        endpoint, told = self.require(name), self._told[name]
        if told.is_testing:
            raise BeingTestedError(f"webhook {name} is being tested")
        told.is_testing = True
        try:
            _, delivery = await self._send(endpoint, told, message, attempt=1)
            await self._store.write(table.note_trial, name, delivery, who)
        finally:
            told.is_testing = False
        return delivery

    def _wake(self, name: str) -> None:
        if name in self._told:  # else it was taken out of the configuration meanwhile
            self._told[name].wake.set()

    # --- the task of an endpoint ---

    async def _tell(self, endpoint: WebhookEndpoint, told: _Told) -> None:
        while not self._store.is_released:
            try:
                await self._step(endpoint, told)
            except StoreError as err:  # health says so, too
                log.error("webhook %s: %s", endpoint.name, err)
                await asyncio.sleep(STORE_RETRY_S)

    async def _step(self, endpoint: WebhookEndpoint, told: _Told) -> None:
        """Post the next event to an endpoint, or wait until there is a reason to look again."""
        told.wake.clear()
        before = await self._store.read(table.progress_of, endpoint.name)
        if told.looked_from != before.after:
            told.looked_from = told.looked_to = before.after
        told.progress = before
        if before.disabled_at is not None:
            await told.wake.wait()
            return
        if (pause_s := before.pause_s(self._now())) > 0:
            await self._wait(told.wake, pause_s)
            return
        due = await self._store.read(events_after, told.looked_to, 1, endpoint.events)
        if told.looked_to + 1 < due.first_seq and before.attempts == 0:
            log.error("webhook %s: events before %d are no longer kept", endpoint.name, due.first_seq)
        if not due.items:
            told.looked_to = due.last_seq
            await told.wake.wait()
            return
        (event,) = due.items
        message = message_of(event, self._store.instance_id)
        answer, delivery = await self._send(endpoint, told, message, attempt=before.attempts + 1)
        after = next_progress(before, event["seq"], answer, self._now(), self._chance())
        if after.disabled_at is not None:
            log.error("webhook %s is disabled: %s", endpoint.name, answer.problem)
        elif after.attempts == 1:
            log.warning("webhook %s: %s", endpoint.name, answer.problem)
        elif before.attempts > 0 and answer.problem is None:
            log.info("webhook %s takes messages again, attempts=%d", endpoint.name, before.attempts + 1)
        told.progress = await self._store.write(table.note, endpoint.name, delivery, before, after)

    async def _send(
        self, endpoint: WebhookEndpoint, told: _Told, message: Message, attempt: int
    ) -> tuple[EndpointAnswer, Attempt]:
        now = self._now()
        try:
            headers = await asyncio.to_thread(_signed, endpoint, message, int(now.timestamp()))
            told.tls = told.tls or await asyncio.to_thread(endpoint.tls)
        except ValueError as err:  # of a secret or a certificate
            answer = EndpointAnswer(problem=str(err))
        else:
            answer = await post(endpoint, self._settings, message.body, headers, told.tls)
        delivery = Attempt(
            at=rfc3339(now),
            webhook_id=message.id,
            type=message.type,
            event=message.event,
            attempt=attempt,
            status=answer.status,
            problem=answer.problem,
            duration_ms=answer.duration_ms,
        )
        return answer, delivery


def _trouble(progress: EndpointProgress, now: datetime) -> str | None:
    if progress.disabled_at is not None:
        code, since = messages.Code.WEBHOOK_DISABLED, progress.disabled_at
    elif progress.is_failing(now):
        code, since = messages.Code.WEBHOOK_FAILING, str(progress.failing_since)
    else:
        return None
    return messages.message(code, since=since, reported=str(progress.last_problem))


def _signed(endpoint: WebhookEndpoint, message: Message, timestamp_s: int) -> dict[str, str]:
    """Return the headers that sign a message; reads files."""
    return {
        "webhook-id": message.id,
        "webhook-timestamp": str(timestamp_s),
        "webhook-signature": signatures(endpoint.keys(), message.id, timestamp_s, message.body),
    }
