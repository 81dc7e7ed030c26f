"""Endpoints made over REST: sealed in the store, beside those of the configuration, and never beyond its hosts."""

from dataclasses import replace
from pathlib import Path

import pytest
from pydantic import SecretStr
from support.eventually import soon
from support.webhook_receiver import KEY, OTHER_KEY, OTHER_SECRET, SECRET, Receiver, is_signed
from unit.service.delivery.test_webhooks import telling

from service.base.errors import TooManyError
from service.delivery.definitions import SEAL, WebhookConflictError, new_secret
from service.delivery.settings import MAX_ENDPOINTS, WebhookEndpoint, WebhooksSettings, key_of
from service.delivery.webhooks import Webhooks, open_webhooks
from service.store import Store
from service.store.backups import back_up
from service.store.event_log import EventLog
from service.store.events import EventType, NewEvent

HERE = WebhooksSettings(allowed_hosts=("127.0.0.1",), timeout_s=60)
ERP = WebhookEndpoint(
    name="erp",
    url="http://127.0.0.1:9/hook/path-token?query=token",
    secrets=(SecretStr(SECRET),),
    events=(EventType.LOT_CLOSED,),
)


def at(receiver: Receiver) -> WebhookEndpoint:
    return replace(ERP, url=f"http://127.0.0.1:{receiver.port}/hook")


async def defined(store: Store, endpoint: WebhookEndpoint = ERP) -> Webhooks:
    webhooks = await open_webhooks(store, HERE)
    assert await webhooks.define(endpoint, True, "a test")
    return webhooks


async def happen(store: Store) -> None:
    log = EventLog(store)
    log.note(NewEvent(type=EventType.LOT_CLOSED, subject="L1"))
    await log.written()


async def test_neither_database_nor_backup_tells_what_is_secret(store: Store, tmp_path: Path) -> None:
    await defined(store)
    back_up(store.dir, tmp_path / "copy.sqlite")
    files = [path for path in store.dir.rglob("*") if path.is_file() and path.name != SEAL]
    contents = b"".join(path.read_bytes() for path in (*files, tmp_path / "copy.sqlite"))
    for secret in (SECRET, SECRET.removeprefix("whsec_"), "path-token", "query=token"):
        assert secret.encode() not in contents
    assert (store.dir / SEAL).stat().st_mode & 0o777 == 0o600


async def test_a_reload_and_a_restart_keep_them(store: Store) -> None:
    webhooks = await defined(store)
    mes = replace(ERP, name="mes")
    await webhooks.use(replace(HERE, endpoints=(mes,)))
    assert [each.name for each in await webhooks.statuses()] == ["erp", "mes"]
    await webhooks.use(HERE)
    again = await open_webhooks(store, HERE)
    assert again.find("erp") == webhooks.find("erp") == ERP


async def test_of_two_with_one_name_the_configurations_is_served(store: Store) -> None:
    webhooks = await defined(store)
    fixed = replace(ERP, url="http://127.0.0.1:7/fixed")
    await webhooks.use(replace(HERE, endpoints=(fixed,)))
    assert webhooks.find("erp") == fixed
    with pytest.raises(WebhookConflictError, match="is of the configuration"):
        await webhooks.remove("erp", "a test")
    await webhooks.use(HERE)
    assert webhooks.find("erp") == ERP


async def test_with_another_key_it_is_not_served_and_health_says_so(store: Store) -> None:
    await defined(store)
    (store.dir / SEAL).unlink()
    webhooks = await open_webhooks(store, HERE)
    assert webhooks.find("erp") is None
    (trouble,) = webhooks.troubles
    assert "erp: cannot be read with webhooks.key of this machine" in trouble
    assert await webhooks.define(replace(ERP, name="new"), True, "a test")  # which makes another key
    assert webhooks.find("erp") is None
    await webhooks.remove("erp", "a test")
    assert webhooks.troubles == []


async def test_a_host_that_is_not_allowed_any_more_is_not_asked(store: Store) -> None:
    async with Receiver() as receiver:
        webhooks = await defined(store, at(receiver))
        for allowed in ((), ("localhost",)):
            await webhooks.use(replace(HERE, allowed_hosts=allowed))
            attempt = await webhooks.test("erp", "a test")
            assert attempt.problem == "127.0.0.1 is not in [webhooks] allowed_hosts: not asked"
        assert receiver.ids == []
        await webhooks.use(HERE)
        assert (await webhooks.test("erp", "a test")).status == 204


async def test_messages_of_a_rotation_carry_both_signatures(store: Store) -> None:
    async with Receiver() as receiver:
        webhooks = await defined(store, at(receiver))
        lost = new_secret()
        for secret in (lost, SecretStr(OTHER_SECRET)):  # the answer with the first one was lost
            await webhooks.rotate("erp", secret, "a test")
        await webhooks.test("erp", "a test")
        await webhooks.end_rotation("erp", "a test")
        await webhooks.test("erp", "a test")
        both, newest = receiver.requests
        signed = [
            [is_signed(each.headers, each.body, key) for key in (KEY, OTHER_KEY)] for each in (both, newest)
        ]
        assert signed == [[True, True], [False, True]]
        assert not is_signed(both.headers, both.body, key_of(lost.get_secret_value()))


async def test_one_that_is_made_while_events_happen_is_told_from_then_on(store: Store) -> None:
    async with Receiver() as receiver:
        await happen(store)
        webhooks = await open_webhooks(store, HERE)
        async with telling(webhooks):
            await webhooks.define(at(receiver), True, "a test")
            await happen(store)
            await soon(lambda: len(receiver.ids) == 1)
            await webhooks.remove("erp", "a test")
            await happen(store)
            await webhooks.define(at(receiver), True, "a test")
            await happen(store)
            await soon(lambda: len(receiver.ids) == 2)
        assert [each.document["data"]["seq"] for each in receiver.requests] == [2, 4]


async def test_there_is_a_most(store: Store) -> None:
    webhooks = await open_webhooks(store, HERE)
    for n in range(MAX_ENDPOINTS):
        await webhooks.define(replace(ERP, name=f"n{n}"), True, "a test")
    with pytest.raises(TooManyError, match="remove one"):
        await webhooks.define(replace(ERP, name="more"), True, "a test")
    assert not await webhooks.define(replace(ERP, name="n0", events=(EventType.LOT_OPENED,)), True, "a test")
