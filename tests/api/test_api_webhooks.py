"""Webhooks over REST: what became of them, and what an operator does about it; secrets are never shown."""

from typing import Any

import httpx
import pytest
from support.rest import FakeControl, app_of, assert_problem, client_of
from support.webhook_receiver import OTHER_SECRET, SECRET, Receiver, answer, is_signed

from service.delivery.settings import key_of
from service.store import Store
from service.store.event_log import EventLog
from service.store.events import EventType, NewEvent
from service.web.settings import ApiKey, ApiSettings, Scope

pytestmark = pytest.mark.usefixtures("webhooks")


async def document(answer: httpx.Response) -> dict[str, Any]:
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


async def test_endpoints_are_listed_without_what_is_secret(
    client: httpx.AsyncClient, receiver: Receiver, store: Store
) -> None:
    log = EventLog(store)
    log.note(*(NewEvent(type=each, subject="L1") for each in (EventType.LOT_OPENED, EventType.LOT_CLOSED)))
    await log.written()
    answer = await client.get("/webhooks")
    assert (await document(answer))["items"] == [
        {
            "name": "mes",
            "is_of_configuration": True,
            "n_secrets": 1,
            "url": f"http://127.0.0.1:{receiver.port}/hook",
            "events": ["lot.closed"],
            "after": 0,
            "waiting": 1,
            "attempts": 0,
            "failing_since": None,
            "next_attempt_at": None,
            "last_problem": None,
            "last_taken_at": None,
            "disabled_at": None,
        }
    ]
    assert "whsec" not in answer.text
    assert "hidden" not in answer.text


async def test_a_test_says_what_came_of_it_and_is_in_the_history(
    client: httpx.AsyncClient, receiver: Receiver
) -> None:
    receiver.answer_next(answer(404))
    refused = await document(await client.post("/webhooks/mes/test"))
    assert (refused["status"], refused["problem"]) == (404, "HTTP 404 Not Found")
    taken = await document(await client.post("/webhooks/mes/test"))
    assert (taken["status"], taken["problem"], taken["type"]) == (204, None, "webhook.test")
    found = (await document(await client.get("/webhooks/mes/deliveries")))["items"]
    assert found == [taken, refused]
    assert (await document(await client.get("/webhooks/mes/deliveries?limit=1")))["items"] == [taken]
    assert receiver.ids == [refused["webhook_id"], taken["webhook_id"]]


async def test_enabling_and_replaying_are_in_the_audit(client: httpx.AsyncClient) -> None:
    enabled = await document(await client.post("/webhooks/mes/enable"))
    assert (enabled["disabled_at"], enabled["attempts"]) == (None, 0)
    assert (await document(await client.post("/webhooks/mes/replay", json={"after": 0})))["after"] == 0
    entries = (await document(await client.get("/audit")))["items"]
    assert [(each["action"], each["subject"], each["who"]) for each in entries] == [
        ("webhook enabled", "mes", "this machine"),
        ("webhook replayed", "mes", "this machine"),
    ]
    assert_problem(await client.post("/webhooks/mes/replay", json={"after": 1}), 409, "cursor-ahead")
    for wrong in ({"after": -1}, {"after": "0"}, {}, {"after": 0, "until": 1}):
        assert_problem(await client.post("/webhooks/mes/replay", json=wrong), 422, "invalid-request")


async def test_what_is_gone_cannot_be_replayed(client: httpx.AsyncClient, store: Store) -> None:
    log = EventLog(store)
    log.note(*(NewEvent(type=EventType.LOT_CLOSED, subject="L1") for _ in range(5)))
    await log.written()
    await store.write(lambda connection: connection.execute("DELETE FROM events WHERE seq < 4") and None)
    refused = await client.post("/webhooks/mes/replay", json={"after": 2})
    assert_problem(refused, 410, "cursor-expired")
    assert (refused.json()["first_seq"], refused.json()["last_seq"]) == (4, 5)
    assert (await document(await client.post("/webhooks/mes/replay", json={"after": 3})))["waiting"] == 2


async def test_an_endpoint_that_is_not_configured_is_unknown(client: httpx.AsyncClient) -> None:
    assert_problem(await client.get("/webhooks/erp/deliveries"), 404, "unknown-webhook")
    for action in ("enable", "test"):
        assert_problem(await client.post(f"/webhooks/erp/{action}"), 404, "unknown-webhook")
    assert_problem(await client.post("/webhooks/erp/replay", json={"after": 0}), 404, "unknown-webhook")
    assert_problem(await client.post("/webhooks/a%20b/test"), 422, "invalid-request")


async def test_an_endpoint_is_made_and_its_secret_shown_this_once(
    client: httpx.AsyncClient, receiver: Receiver
) -> None:
    url = f"http://127.0.0.1:{receiver.port}/erp/path-token?query=token"
    made = await document(await client.put("/webhooks/erp", json={"url": url, "events": ["lot.opened"]}))
    assert (made["name"], made["is_of_configuration"], made["n_secrets"]) == ("erp", False, 1)
    assert (made["url"], made["events"]) == (f"http://127.0.0.1:{receiver.port}/erp/redacted", ["lot.opened"])
    assert (await document(await client.post("/webhooks/erp/test")))["status"] == 204
    (request,) = receiver.requests
    assert request.line == "POST /erp/path-token?query=token HTTP/1.1"
    assert is_signed(request.headers, request.body, key_of(made["secret"]))

    changed = await document(
        await client.put("/webhooks/erp", json={"url": f"{url}2", "secret": made["secret"]})
    )
    assert (changed["secret"], len(changed["events"])) == (None, len(EventType))
    rotated = await document(await client.put("/webhooks/erp/secret", json={}))
    assert (rotated["n_secrets"], rotated["secret"] == made["secret"]) == (2, False)
    assert (await document(await client.put("/webhooks/erp/secret", json={"secret": SECRET})))[
        "secret"
    ] is None
    assert (await document(await client.delete("/webhooks/erp/secret")))["n_secrets"] == 1
    assert_problem(
        await client.put("/webhooks/erp", json={"url": url, "secret": OTHER_SECRET}), 409, "webhook-conflict"
    )
    listed = await client.get("/webhooks")
    assert [each["name"] for each in listed.json()["items"]] == ["erp", "mes"]
    assert (await client.delete("/webhooks/erp")).status_code == 204
    assert_problem(await client.delete("/webhooks/erp"), 404, "unknown-webhook")
    assert_problem(await client.post("/webhooks/erp/test"), 404, "unknown-webhook")

    audit = await client.get("/audit?subject=erp")
    assert [each["action"] for each in audit.json()["items"]] == [
        "webhook defined",
        "webhook tested",
        "webhook changed",
        "webhook secret rotated",
        "webhook secret rotated",
        "webhook rotation ended",
        "webhook removed",
    ]
    for shown in (listed.text, audit.text):
        assert not [each for each in ("whsec", "path-token", "query=token") if each in shown]


async def test_what_the_configuration_has_is_changed_there(
    client: httpx.AsyncClient, receiver: Receiver
) -> None:
    body = {"url": f"http://127.0.0.1:{receiver.port}/other"}
    for refused in (
        await client.put("/webhooks/mes", json=body),
        await client.delete("/webhooks/mes"),
        await client.put("/webhooks/mes/secret", json={}),
        await client.delete("/webhooks/mes/secret"),
    ):
        assert_problem(refused, 409, "webhook-conflict")
        assert refused.json()["detail"] == "webhook mes is of the configuration: change it there"


@pytest.mark.parametrize(
    ("body", "detail"),
    [
        (
            {"url": "http://169.254.169.254/latest"},
            "url: its host 169.254.169.254 is not in [webhooks] allowed_hosts",
        ),
        ({"url": "http://localhost/x"}, "url: its host localhost is not in"),
        ({"url": "http://127.0.0.1@evil.example/x"}, "url must have no user"),
        ({"url": "file:///etc/passwd"}, "url must begin with http:// or https://"),
        ({"url": "gopher://127.0.0.1/x"}, "url must begin with http:// or https://"),
        (
            {"url": "http://127.0.0.1/x", "secret": "hunter2"},
            "body.secret: Value error, a secret begins with whsec_",
        ),
        ({"url": "http://127.0.0.1/x", "secret": ""}, "body.secret: "),
        ({"url": "http://127.0.0.1/x", "events": []}, "body.events: "),
        ({"url": "http://127.0.0.1/x", "ca_file": "/etc/shadow"}, "body.ca_file: "),
        ({"events": ["lot.closed"]}, "body.url: "),
    ],
)
async def test_what_must_not_be_told_is_refused_and_changes_nothing(
    client: httpx.AsyncClient, body: dict[str, Any], detail: str
) -> None:
    refused = await client.put("/webhooks/erp", json=body)
    assert_problem(refused, 422, "invalid-request")
    assert refused.json()["detail"].startswith(detail)
    assert "hunter2" not in refused.text
    assert len((await document(await client.get("/webhooks")))["items"]) == 1
    assert_problem(
        await client.put("/webhooks/..x", json={"url": "http://127.0.0.1/x"}), 422, "invalid-request"
    )


async def test_one_event_is_sent_again_under_its_id(
    client: httpx.AsyncClient, store: Store, receiver: Receiver
) -> None:
    log = EventLog(store)
    log.note(*(NewEvent(type=EventType.LOT_OPENED, subject=f"L{n}") for n in (1, 2)))
    await log.written()
    ids = [
        (await document(await client.post("/webhooks/mes/resend", json={"event": event})))["webhook_id"]
        for event in (2, 1, 2)
    ]
    assert receiver.ids == ids
    assert (receiver.events, ids[0]) == ([2, 1, 2], ids[2])
    assert (await document(await client.get("/webhooks")))["items"][0]["after"] == 0
    assert_problem(await client.post("/webhooks/mes/resend", json={"event": 3}), 409, "cursor-ahead")
    await store.write(lambda connection: connection.execute("DELETE FROM events WHERE seq < 2") and None)
    assert_problem(await client.post("/webhooks/mes/resend", json={"event": 1}), 410, "cursor-expired")
    assert (await document(await client.get("/audit")))["items"][-1]["action"] == "webhook event sent again"


async def test_all_of_it_needs_the_scope_to_configure(store: Store, control: FakeControl) -> None:
    operator = ApiKey(
        name="mes",
        sha256="ca978112ca1bbdcafac231b39a23dc4da786eff8147c4e72b9807785afee48bb",  # of `a`
        scopes=(Scope.READ, Scope.OPERATE),
    )
    headers = {"Authorization": "Bearer a"}
    async with client_of(app_of(store, control, ApiSettings(keys=(operator,)))) as client:
        for method, path in (
            ("GET", ""),
            ("GET", "/mes/deliveries"),
            ("POST", "/mes/enable"),
            ("POST", "/mes/test"),
            ("POST", "/mes/replay"),
            ("POST", "/mes/resend"),
            ("POST", "/erp/test"),
            ("PUT", "/erp"),
            ("DELETE", "/mes"),
            ("PUT", "/mes/secret"),
            ("DELETE", "/mes/secret"),
        ):
            assert_problem(await client.request(method, f"/webhooks{path}"), 401, "unauthorized")
            refused = await client.request(method, f"/webhooks{path}", headers=headers)
            assert_problem(refused, 403, "forbidden")
