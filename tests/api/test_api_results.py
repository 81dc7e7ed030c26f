"""The feed of results: in order, without gaps, from any cursor, with and without a long poll."""

import asyncio
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.eventually import PATIENCE_S
from support.outcomes import add, measured, rejected, result
from support.rest import assert_problem

from service.particles.routes.results import ResultsPage
from service.results.fields import ALWAYS, LEAN_FIELDS, MEASURED_FIELDS, Result
from service.store import Store


async def test_an_empty_feed(client: httpx.AsyncClient, store: Store) -> None:
    answer = await client.get("/results")
    assert answer.status_code == 200
    assert answer.json() == {
        "instance_id": store.instance_id,
        "first_seq": 1,
        "last_seq": 0,
        "next_after": 0,
        "items": [],
    }


async def test_a_reader_gets_everything_once_in_order(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    records = [measured(volume_mm3=1.0), rejected("empty"), result(outcome="lost", reason="queue_full")] * 3
    for i, record in enumerate(records):
        await add(store, session, i, record)
    after, seen = 0, []
    while True:
        answer = await client.get("/results", params={"after": after, "limit": 2})
        page = ResultsPage.model_validate(answer.json(), strict=True)
        if not page.items:
            break
        assert (page.first_seq, page.last_seq, page.next_after) == (1, 9, page.items[-1].seq)
        seen += [(item.seq, item.outcome) for item in page.items]
        after = page.next_after
    assert seen == [(i + 1, record.outcome) for i, record in enumerate(records)]


async def test_what_is_unknown_is_null_and_what_is_extra_is_kept(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await add(store, session, 1, measured(roughness_um=3.25))
    await add(store, session, 2, measured(gate_extent_mm=41.5, gate_extent_is_plausible=False))
    item, doubtful = (await client.get("/results")).json()["items"]
    assert (item["gate_extent_mm"], item["gate_extent_is_plausible"]) == (None, None)
    assert (doubtful["gate_extent_mm"], doubtful["gate_extent_is_plausible"]) == (41.5, False)
    assert item["roughness_um"] == 3.25
    assert item["mass_g"] is None
    assert item["view_residuals_px"] == {}


async def test_a_commit_wakes_the_long_poll(
    client: httpx.AsyncClient, store: Store, session: int, waiting: asyncio.Event
) -> None:
    await add(store, session, 1, measured())
    poll = asyncio.create_task(client.get("/results", params={"after": 1, "wait_s": 30}))
    await waiting.wait()
    await add(store, session, 2, rejected("empty"))
    page = (await asyncio.wait_for(poll, 5)).json()
    assert (page["last_seq"], page["next_after"], page["items"][0]["reason"]) == (2, 2, "empty")


async def test_shutdown_ends_the_long_poll(
    client: httpx.AsyncClient, store: Store, waiting: asyncio.Event
) -> None:
    poll = asyncio.create_task(client.get("/results", params={"wait_s": 30}))
    await waiting.wait()
    store.release_waiters()
    assert (await asyncio.wait_for(poll, 5)).json()["items"] == []
    later = client.get("/results", params={"wait_s": 30})
    assert (await asyncio.wait_for(later, 5)).status_code == 200


async def test_the_long_poll_gives_up_in_time(client: httpx.AsyncClient, waiting: asyncio.Event) -> None:
    answer = await asyncio.wait_for(client.get("/results", params={"wait_s": 0.05}), PATIENCE_S)
    assert waiting.is_set()
    assert answer.json()["items"] == []


async def test_a_cursor_outside_the_history(
    client: httpx.AsyncClient, store: Store, session: int, state_dir: Path
) -> None:
    for i in range(5):
        await add(store, session, i, measured())
    ahead = await client.get("/results", params={"after": 6, "wait_s": 30})
    assert (ahead.status_code, ahead.json()["type"]) == (409, "urn:stonefall:problem:cursor-ahead")
    assert ahead.json()["last_seq"] == 5

    retention = sqlite3.connect(state_dir / "results.sqlite")
    retention.execute("DELETE FROM results WHERE seq <= 3")
    retention.commit()
    expired = await client.get("/results", params={"after": 2})
    assert (expired.status_code, expired.json()["type"]) == (410, "urn:stonefall:problem:cursor-expired")
    assert expired.json()["first_seq"] == 4
    assert [item["seq"] for item in (await client.get("/results?after=3")).json()["items"]] == [4, 5]

    retention.execute("DELETE FROM results")
    retention.commit()
    retention.close()
    page = (await client.get("/results?after=5")).json()
    assert (page["first_seq"], page["last_seq"], page["items"]) == (6, 5, [])
    assert await add(store, session, 9, measured()) == 6  # a number is never given twice


@pytest.mark.parametrize(
    "query", ["after=-1", "after=x", f"after={10**20}", "limit=0", "limit=1001", "wait_s=31", "wait_s=nan"]
)
async def test_limits(client: httpx.AsyncClient, query: str) -> None:
    answer = await client.get(f"/results?{query}")
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:stonefall:problem:invalid-request")
    assert answer.json()["errors"][0]["field"] == f"query.{query.split('=')[0]}"


async def test_a_lean_feed_has_less_than_a_kilobyte_a_result(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    ended = [name for name in MEASURED_FIELDS if name.endswith(("_mm", "_mm3", "_g", "_percent"))]
    numbers = {name: 10000 / 7 for name in ended if name not in ("min_box_mm", "center_mm")}
    await add(store, session, 1, measured(**numbers, quality="degraded", calibration_id="0123456789abcdef"))
    answer = await client.get("/results", params={"fields": "lean"})
    (item,) = answer.json()["items"]
    assert list(item) == [name for name in Result.model_fields if name in LEAN_FIELDS]
    assert (item["mass_g"], item["is_simulated"], item["is_replay"]) == (10000 / 7, True, True)
    assert len(answer.content) < 1000


async def test_fields_are_chosen_and_unknown_ones_named(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await add(store, session, 1, measured(mass_g=2.5))
    for path in ("/results", "/particles"):
        (whole,) = (await client.get(path)).json()["items"]
        (item,) = (await client.get(path, params={"fields": "mass_g, lot"})).json()["items"]
        assert item == {name: whole[name] for name in (*ALWAYS, "mass_g", "lot")}
        (item,) = (await client.get(path, params={"fields": "lean,optics"})).json()["items"]
        assert set(item) == LEAN_FIELDS | {"optics"}
        assert set(whole) >= set(Result.model_fields)
        refused = await client.get(path, params={"fields": "mass_g,weight,colour"})
        assert_problem(refused, 422, "invalid-request")
        (error,) = refused.json()["errors"]
        assert (error["field"], error["message"][:36]) == (
            "query.fields",
            "no result has 'colour', 'weight'; th",
        )


async def test_a_time_finds_the_cursor(client: httpx.AsyncClient, store: Store, session: int) -> None:
    for i in range(4):
        await add(store, session, i, measured())
    with closing(sqlite3.connect(store.path)) as database:
        for seq, minute in ((1, 0), (2, 10), (3, 5), (4, 20)):  # the clock was set back after the second
            time = f"2026-03-01T06:{minute:02}:00.000Z"
            database.execute(
                "UPDATE results SET record = json_set(record, '$.recorded_at', ?) WHERE seq = ?", (time, seq)
            )
        database.commit()

    async def since(time: str, **more: Any) -> tuple[list[int], int]:
        page = (await client.get("/results", params={"since": time, **more})).json()
        return [item["seq"] for item in page["items"]], page["next_after"]

    assert await since("2026-03-01T00:00:00Z", limit=2) == ([1, 2], 2)
    assert await since("2026-03-01T06:10:00.000Z") == ([2, 3, 4], 4)
    assert await since("2026-03-01T07:10:00+01:00") == ([2, 3, 4], 4)
    assert await since("2026-03-01T06:10:00.001Z") == ([4], 4)
    assert await since("2026-03-02T00:00:00Z") == ([], 4)
    for wrong in ("after=1&since=2026-03-01T00:00:00Z", "since=yesterday", "since=2026-03-01T00:00:00"):
        refused = await client.get(f"/results?{wrong}")
        assert_problem(refused, 422, "invalid-request")
        assert refused.json()["errors"][0]["field"] == "query.since"
