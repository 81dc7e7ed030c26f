"""A POST with an idempotency key is carried out once, and answered alike as often as it is repeated."""

import asyncio
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.eventually import PATIENCE_S
from support.rest import FakeControl, app_of, assert_problem, client_of

from service.store import Store, open_store
from service.web import idempotency

PRODUCT = {"title": "8/16", "density_kg_m3": 2700, "lower_mm": 8, "upper_mm": 16}
LOT = {"lot": "L1", "product": "basalt"}


@pytest.fixture
async def product(client: httpx.AsyncClient) -> None:
    assert (await client.put("/products/basalt", json=PRODUCT)).status_code == 200


def keyed(key: str = "k1") -> dict[str, str]:
    return {"Idempotency-Key": key}


async def actions(client: httpx.AsyncClient, subject: str) -> list[str]:
    return [entry["action"] for entry in (await client.get(f"/audit?subject={subject}")).json()["items"]]


@pytest.mark.usefixtures("product")
async def test_five_parallel_identical_posts_make_one_lot_and_get_one_answer(
    client: httpx.AsyncClient,
) -> None:
    answers = await asyncio.gather(*(client.post("/lots", json=LOT, headers=keyed()) for _ in range(5)))
    first, *others = sorted(answers, key=lambda each: "Idempotent-Replayed" in each.headers)
    assert (first.status_code, "Idempotent-Replayed" in first.headers) == (201, False)
    for other in others:
        assert (other.status_code, other.content) == (201, first.content)
        assert other.headers["Idempotent-Replayed"] == "true"
        assert other.headers["Location"] == first.headers["Location"]
        assert other.headers["Content-Type"] == "application/json"
    assert await actions(client, "L1") == ["lot opened"]


async def test_the_first_answer_comes_again_whatever_happened_since_and_after_a_restart(
    state_dir: Path, control: FakeControl
) -> None:
    with open_store(state_dir) as store:
        async with client_of(app_of(store, control)) as client:
            await client.put("/products/basalt", json=PRODUCT)
            first = await client.post("/lots", json=LOT, headers=keyed())
            await client.post("/lots/L1/close", json={})
            again = await client.post("/lots", json=LOT, headers=keyed())
            assert (again.status_code, again.json()["state"]) == (201, "open")
            refused = await client.post("/lots", json=LOT, headers=keyed("k2"))
            assert_problem(refused, 409, "lot-conflict")
    with open_store(state_dir) as store:
        async with client_of(app_of(store, control)) as client:
            again = await client.post("/lots", json=LOT, headers=keyed())
            assert (again.status_code, again.content) == (201, first.content)
            assert again.headers["Idempotent-Replayed"] == "true"
            again = await client.post("/lots", json=LOT, headers=keyed("k2"))
            assert (again.status_code, again.content) == (409, refused.content)
            assert again.headers["Content-Type"] == "application/problem+json"


@pytest.mark.usefixtures("product")
@pytest.mark.parametrize(
    ("path", "body"),
    [("/lots", LOT | {"lot": "L2"}), ("/lots/L1/close", LOT)],
)
async def test_a_key_is_for_one_request(client: httpx.AsyncClient, path: str, body: dict[str, Any]) -> None:
    await client.post("/lots", json=LOT, headers=keyed())
    assert_problem(await client.post(path, json=body, headers=keyed()), 422, "idempotency-key-reused")
    assert (await client.get("/lots/L2")).status_code == 404


@pytest.mark.usefixtures("product")
async def test_a_key_is_for_one_query(client: httpx.AsyncClient) -> None:
    await client.post("/lots", json=LOT)
    closed = await client.post("/lots/L1/close?wait_s=0", json={}, headers=keyed())
    assert closed.status_code == 200
    again = await client.post("/lots/L1/close?wait_s=0.1", json={}, headers=keyed())
    assert_problem(again, 422, "idempotency-key-reused")


@pytest.mark.parametrize("key", ["", "a b", "é", "x" * 129])
async def test_a_key_that_is_none(client: httpx.AsyncClient, key: str) -> None:
    headers = {"Idempotency-Key": key.encode()}
    answer = await client.post("/lots", json=LOT, headers=headers)
    assert_problem(answer, 422, "invalid-request")
    assert answer.json()["errors"][0]["field"] == "header.Idempotency-Key"


async def test_while_the_first_is_carried_out_the_next_is_told_to_come_again(
    client: httpx.AsyncClient, control: FakeControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, release = asyncio.Event(), asyncio.Event()

    async def find(name: str) -> None:
        begun.set()
        await release.wait()

    monkeypatch.setattr(control.recordings, "find", find)
    monkeypatch.setattr(idempotency, "WAIT_S", 0.05)
    first = asyncio.create_task(client.post("/recordings/a/stop", headers=keyed()))
    await begun.wait()
    refused = await client.post("/recordings/a/stop", headers=keyed())
    other = await client.post("/recordings/b/stop", headers=keyed())
    release.set()
    assert_problem(refused, 409, "request-in-progress")
    assert refused.headers["Retry-After"] == "1"
    assert_problem(other, 422, "idempotency-key-reused")
    assert_problem(await first, 404, "unknown-recording")
    again = await client.post("/recordings/a/stop", headers=keyed())
    assert (again.content, again.headers["Idempotent-Replayed"]) == ((await first).content, "true")


async def test_what_depends_on_more_than_the_request_is_tried_again(
    client: httpx.AsyncClient, control: FakeControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fail(name: str) -> None:
        raise ZeroDivisionError

    with monkeypatch.context() as patched:
        patched.setattr(control.recordings, "find", fail)
        failed = await client.post("/recordings/a/stop", headers=keyed())
    assert_problem(failed, 500, "internal-error")
    tried = await client.post("/recordings/a/stop", headers=keyed())
    assert_problem(tried, 404, "unknown-recording")
    assert "Idempotent-Replayed" not in tried.headers


@pytest.mark.usefixtures("product")
async def test_a_key_belongs_to_who_asks_and_who_may_not_write_gets_no_old_answer(
    client: httpx.AsyncClient, store: Store, control: FakeControl
) -> None:
    await client.post("/lots", json=LOT, headers=keyed())
    async with client_of(app_of(store, control), "192.0.2.7") as other:
        assert_problem(await other.post("/lots", json=LOT, headers=keyed()), 403, "forbidden")
    with closing(sqlite3.connect(store.path)) as database:
        database.execute("UPDATE answers SET who = 'key mes'")
        database.commit()
    own = await client.post("/lots", json=LOT, headers=keyed())
    assert "Idempotent-Replayed" not in own.headers
    assert own.status_code == 201  # the lot that is open already


@pytest.mark.usefixtures("product")
async def test_answers_are_kept_for_a_day_and_are_never_too_many(
    client: httpx.AsyncClient, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(idempotency, "MAX_KEPT", 2)
    for key in ("k1", "k2"):
        await client.post("/lots", json=LOT, headers=keyed(key))
    refused = await client.post("/lots", json=LOT, headers=keyed("k3"))
    assert_problem(refused, 429, "too-many-keys")
    assert refused.headers["Retry-After"] == "3600"
    with closing(sqlite3.connect(store.path)) as database:
        database.execute("UPDATE answers SET answered_at = '2026-01-01T00:00:00.000Z' WHERE key = 'k1'")
        database.commit()
    assert (await client.post("/lots", json=LOT, headers=keyed("k3"))).status_code == 201
    with closing(sqlite3.connect(store.path)) as database:
        assert database.execute("SELECT key FROM answers ORDER BY key").fetchall() == [("k2",), ("k3",)]


@pytest.mark.usefixtures("product")
async def test_a_disk_that_refuses_the_answer_does_not_keep_it_from_the_client(
    client: httpx.AsyncClient, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(idempotency, "WAIT_S", 0.05)
    with closing(sqlite3.connect(store.path, isolation_level=None)) as database:
        database.execute("BEGIN IMMEDIATE")  # from now on nothing else can be written
        stopped = await client.post("/recordings/a/stop", headers=keyed())
        assert_problem(stopped, 404, "unknown-recording")
        waiting = await client.post("/recordings/a/stop", headers=keyed())
        assert waiting.status_code in (409, 503)  # in progress; or the store is known to be held already
        assert "Retry-After" in waiting.headers
        database.execute("ROLLBACK")
    async with asyncio.timeout(PATIENCE_S):
        while "Idempotent-Replayed" not in waiting.headers:
            waiting = await client.post("/recordings/a/stop", headers=keyed())
    assert waiting.content == stopped.content
