"""A client that has the newest version is told so, and one that changes an older one is refused."""

import asyncio
from typing import Any

import httpx
import pytest
from support.outcomes import add, measured
from support.rest import assert_problem

from service.store import Store

PRODUCT = {"title": "8/16", "density_kg_m3": 2700, "lower_mm": 8, "upper_mm": 16}


def seen(answer: httpx.Response) -> dict[str, str]:
    return {"If-Match": answer.headers["ETag"]}


@pytest.fixture
async def product(client: httpx.AsyncClient) -> httpx.Response:
    return await client.put("/products/basalt", json=PRODUCT)


@pytest.fixture
async def lot(client: httpx.AsyncClient, product: httpx.Response) -> httpx.Response:
    return await client.post("/lots", json={"lot": "L1", "product": "basalt"})


@pytest.fixture
async def cursor(client: httpx.AsyncClient, store: Store, session: int) -> httpx.Response:
    for number in range(1, 5):
        await add(store, session, number, measured())
    return await client.put("/consumers/mes/cursor", json={"after": 1})


async def test_who_has_the_newest_version_is_told_so(
    client: httpx.AsyncClient, store: Store, session: int, lot: httpx.Response, product: httpx.Response
) -> None:
    await add(store, session, 1, measured())
    for path in ("/products/basalt", "/lots/L1", "/particles/1"):
        first = await client.get(path)
        again = await client.get(path, headers={"If-None-Match": first.headers["ETag"]})
        assert (again.status_code, again.content) == (304, b"")
        assert again.headers["ETag"] == first.headers["ETag"]
        other = await client.get(path, headers={"If-None-Match": '"other"'})
        assert (other.status_code, other.json()) == (200, first.json())
    assert product.headers["ETag"] == (await client.get("/products/basalt")).headers["ETag"]


async def test_every_change_is_another_version(
    client: httpx.AsyncClient, store: Store, session: int, lot: httpx.Response
) -> None:
    await add(store, session, 1, measured())
    changes = {
        "/products/basalt": client.put("/products/basalt", json=PRODUCT | {"title": "other"}),
        "/particles/1": client.put("/particles/1/pin", json={"is_pinned": True, "reason": "why"}),
        "/lots/L1": client.post("/lots/L1/close", json={}),
    }
    for path, change in changes.items():
        before = await client.get(path)
        changed = await change
        now = await client.get(path, headers={"If-None-Match": before.headers["ETag"]})
        assert (now.status_code, now.headers["ETag"]) == (200, changed.headers["ETag"])


@pytest.mark.usefixtures("lot")
async def test_of_two_who_saw_the_same_one_comes_too_late(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await add(store, session, 1, measured())

    async def asked(path: str, method: str, change: str, body: dict[str, Any]) -> None:
        version = seen(await client.get(path))
        bodies = (body, body | {"tonnage_t": 2.0} if "close" in change else body | {"reason": "second"})
        if path == "/products/basalt":
            bodies = (body, body | {"title": "third"})
        answers = await asyncio.gather(
            *(client.request(method, change, json=each, headers=version) for each in bodies)
        )
        first, late = sorted(answers, key=lambda each: each.status_code)
        assert first.status_code == 200
        assert_problem(late, 412, "precondition-failed")
        again = await client.request(method, change, json=bodies[1], headers=seen(first))
        assert again.status_code == 200

    await asked("/products/basalt", "PUT", "/products/basalt", PRODUCT | {"title": "second"})
    await asked("/particles/1", "PUT", "/particles/1/pin", {"is_pinned": True, "reason": "first"})
    await asked("/lots/L1", "POST", "/lots/L1/close", {})
    await asked("/lots/L1", "POST", "/lots/L1/void", {"reason": "first"})


async def test_stones_that_fell_since_are_no_change_of_a_lot(
    client: httpx.AsyncClient, store: Store, session: int, lot: httpx.Response
) -> None:
    await add(store, session, 1, measured())
    now = await client.get("/lots/L1", headers={"If-None-Match": lot.headers["ETag"]})
    assert (now.status_code, now.json()["n_stones"]) == (200, 1)
    closed = await client.post("/lots/L1/close", json={}, headers=seen(lot))
    assert (closed.status_code, closed.json()["state"]) == (200, "closed")


async def test_of_two_clients_of_one_name_the_late_one_moves_no_cursor(
    client: httpx.AsyncClient, cursor: httpx.Response
) -> None:
    answers = await asyncio.gather(
        *(client.put("/consumers/mes/cursor", json={"after": n}, headers=seen(cursor)) for n in (2, 3))
    )
    first, late = sorted(answers, key=lambda each: each.status_code)
    assert first.status_code == 200
    assert_problem(late, 412, "precondition-failed")
    assert "read it again" in late.json()["detail"]
    now = await client.get("/consumers/mes/cursor")
    assert (now.json()["after"], now.headers["ETag"]) == (first.json()["after"], first.headers["ETag"])
    assert late.headers["ETag"] == now.headers["ETag"]
    assert (
        await client.get("/consumers/mes/cursor", headers={"If-None-Match": now.headers["ETag"]})
    ).status_code == 304
    again = await client.put("/consumers/mes/cursor", json={"after": 4}, headers=seen(now))
    assert (again.status_code, again.json()["after"]) == (200, 4)
    back = await client.put("/consumers/mes/cursor", json={"after": 1})
    assert (back.status_code, back.json()["after"]) == (200, 1)


async def test_results_that_come_are_no_change_of_a_cursor(
    client: httpx.AsyncClient, store: Store, session: int, cursor: httpx.Response
) -> None:
    await add(store, session, 5, measured())
    assert (await client.get("/consumers/mes/cursor")).headers["ETag"] == cursor.headers["ETag"]
    moved = await client.put("/consumers/mes/cursor", json={"after": 5}, headers=seen(cursor))
    assert moved.status_code == 200


@pytest.mark.parametrize("version", ['"1"', "*"])
async def test_no_version_of_what_is_not_there_can_be_seen_so_nothing_is_created(
    client: httpx.AsyncClient, version: str
) -> None:
    for path, body in (("/products/basalt", PRODUCT), ("/consumers/mes/cursor", {"after": 0})):
        refused = await client.put(path, json=body, headers={"If-Match": version})
        assert_problem(refused, 412, "precondition-failed")
        assert "leave out If-Match" in refused.json()["detail"]
        assert (await client.get(path)).status_code == 404
        assert (await client.put(path, json=body)).status_code == 200
    pinned = await client.put("/particles/9/pin", json={"is_pinned": False}, headers={"If-Match": version})
    assert_problem(pinned, 404, "unknown-particle")


@pytest.mark.usefixtures("lot")
async def test_any_version_and_what_is_not_there(client: httpx.AsyncClient) -> None:
    assert (await client.post("/lots/L1/close", json={}, headers={"If-Match": "*"})).status_code == 200
    either = f'"other", {(await client.get("/lots/L1")).headers["ETag"]}'
    assert (await client.post("/lots/L1/close", json={}, headers={"If-Match": either})).status_code == 200
    assert_problem(
        await client.post("/lots/L9/close", json={}, headers={"If-Match": '"1"'}), 404, "unknown-lot"
    )
    refused = await client.post("/lots/L1/void", json={"reason": "x"}, headers={"If-Match": "nonsense"})
    assert_problem(refused, 412, "precondition-failed")
    assert (await client.get("/lots/L1")).json()["state"] == "closed"
