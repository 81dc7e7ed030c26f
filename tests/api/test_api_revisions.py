"""Stones measured again over REST: what comes in the feed, what is served by id and by seq, and what hinders it."""

import asyncio
from io import BytesIO
from pathlib import Path

import httpx
import pytest
import trimesh
from support.calibration_desk import CONFIGURED
from support.outcomes import add, measured
from support.remeasuring import AgainPool, add_old
from support.rest import BOX_MM, assert_problem
from support.stores import folder_of

from service.processing.measure_job import THUMBNAIL
from service.results.version import ALGORITHM_VERSION
from service.store import Store

CALIBRATION = CONFIGURED.calibration_id


@pytest.fixture
async def name(store: Store, session: int, tmp_path: Path) -> str:
    """Store a stone of an older algorithm, with frames; return its id."""
    return await add_old(store, session, 1, tmp_path, CALIBRATION)


async def test_the_feed_has_both_items_and_the_answer_the_newest(
    client: httpx.AsyncClient, name: str, again: AgainPool
) -> None:
    again.fields = {"sieve_size_mm": 21.5}
    answer = await client.post(f"/particles/{name}/revisions", json={})
    assert answer.status_code == 200, answer.text
    newest = answer.json()["result"]
    assert (answer.json()["is_new"], newest["seq"], newest["sieve_size_mm"]) == (True, 2, 21.5)
    page = (await client.get("/results", params={"fields": "lean"})).json()
    assert [(item["seq"], item["id"], item["revision"], item["revises"]) for item in page["items"]] == [
        (1, name, 1, None),
        (2, name, 2, 1),
    ]
    assert (page["last_seq"], page["next_after"]) == (2, 2)
    assert (await client.get(f"/particles/{name}")).json() == newest
    assert (await client.get("/particles/2")).json() == newest
    assert (await client.get("/particles/1")).json()["sieve_size_mm"] == 20.0
    listed = (await client.get("/particles", params={"min_sieve_size_mm": 21})).json()["items"]
    assert [item["seq"] for item in listed] == [2]


async def test_a_second_time_nothing_is_added(client: httpx.AsyncClient, name: str, again: AgainPool) -> None:
    answers = await asyncio.gather(*(client.post(f"/particles/{key}/revisions") for key in (name, "1", name)))
    assert sorted(answer.json()["is_new"] for answer in answers) == [False, False, True]
    assert {answer.json()["result"]["seq"] for answer in answers} == {2}
    assert len(again.jobs) == 1
    counts = (await client.get("/accounting")).json()
    assert (counts["triggers"], counts["measured"]) == (1, 1)


async def test_files_by_id_are_the_newest_and_by_seq_for_ever(
    client: httpx.AsyncClient, store: Store, name: str
) -> None:
    before = await client.get(f"/particles/{name}/mesh.stl")
    newest = (await client.post(f"/particles/{name}/revisions")).json()["result"]
    assert newest["mesh"] == "particles/2/mesh.ply"

    async def size_of(key: str) -> list[float]:
        mesh = trimesh.load_mesh(BytesIO((await client.get(f"/particles/{key}/mesh.stl")).content), "stl")
        return [round(length) for length in mesh.extents]

    assert (await size_of(name), await size_of("2"), await size_of("1")) == (
        [1, 2, 3],
        [1, 2, 3],
        list(BOX_MM),
    )
    asked = {"If-None-Match": before.headers["ETag"]}
    assert (await client.get(f"/particles/{name}/mesh.stl", headers=asked)).status_code == 200
    assert (await client.get("/particles/1/mesh.stl", headers=asked)).status_code == 304
    frames = [await client.get(f"/particles/{key}/views/c01.png") for key in (name, "1", "2")]
    assert {each.status_code for each in frames} == {200}
    assert len({each.content for each in frames}) == 1
    assert (await client.get(f"/particles/{name}/preview.png")).status_code == 200
    folder = folder_of(store.dir, name)
    thumbnail = (await client.get(f"/particles/{name}/preview.png?size_px=240")).content
    assert (folder / "r2" / THUMBNAIL).read_bytes() == thumbnail, "the one that came with the revision"
    before = (await client.get("/particles/1/preview.png?size_px=240")).content
    assert len(before) > len(thumbnail), "drawn, as the first result came without one"


async def test_pages_of_the_list_go_on_after_a_revision(
    client: httpx.AsyncClient, store: Store, session: int, tmp_path: Path
) -> None:
    names = [await add_old(store, session, n, tmp_path, CALIBRATION) for n in range(1, 5)]
    for key in names[1:3]:
        assert (await client.post(f"/particles/{key}/revisions")).json()["is_new"]
    seen, cursor = [], None
    while cursor is not None or not seen:
        page = (
            await client.get("/particles", params={"limit": 1} | ({"cursor": cursor} if cursor else {}))
        ).json()
        seen += [item["id"] for item in page["items"]]
        cursor = page["next_cursor"]
    assert seen == names[::-1]


async def test_a_pin_on_a_revision_is_of_the_stone(client: httpx.AsyncClient, name: str) -> None:
    await client.post(f"/particles/{name}/revisions")
    before = (await client.get(f"/particles/{name}")).headers["ETag"]
    pinned = await client.put("/particles/2/pin", json={"is_pinned": True}, headers={"If-Match": before})
    assert pinned.status_code == 200
    assert (await client.get("/particles/1")).json()["is_pinned"]


async def test_only_stones_that_may_have_frames(
    client: httpx.AsyncClient, store: Store, session: int, name: str
) -> None:
    await store.write(lambda base: base.execute("UPDATE store SET first_raw = 2"))
    await add(store, session, 2, measured())

    async def listed(has_frames: bool) -> list[int]:
        page = await client.get("/particles", params={"has_frames": has_frames})
        return [item["seq"] for item in page.json()["items"]]

    assert (await listed(True), await listed(False)) == ([2], [1])
    await client.put(f"/particles/{name}/pin", json={"is_pinned": True})
    assert (await listed(True), await listed(False)) == ([2, 1], [])


async def test_what_hinders_it_is_told(
    client: httpx.AsyncClient, store: Store, session: int, name: str, tmp_path: Path
) -> None:
    unknown = await add_old(store, session, 2, tmp_path, "unknown")
    answer = await client.post(f"/particles/{unknown}/revisions")
    assert_problem(answer, 409, "calibration-gone")
    dark = await add_old(store, session, 3, tmp_path, CALIBRATION, segmenters={"c01": "background"})
    assert_problem(await client.post(f"/particles/{dark}/revisions"), 409, "no-background")
    await asyncio.to_thread((await store.raw_path(1)).unlink)
    assert_problem(await client.post(f"/particles/{name}/revisions"), 404, "not-kept")
    assert_problem(await client.post("/particles/99/revisions"), 404, "unknown-particle")
    done = await add(store, session, 4, measured(algorithm_version=ALGORITHM_VERSION))
    assert not (await client.post(f"/particles/{done}/revisions")).json()["is_new"]
    assert store.last_seq == 4


async def test_an_order_is_a_folder_of_the_host_and_only_what_lies_in_it_is_taken(
    client: httpx.AsyncClient, name: str
) -> None:
    ordered = (await client.post(f"/particles/{name}/revisions/orders")).json()
    assert ordered["is_needed"] and Path(ordered["folder"]).name == ordered["order"]
    assert await asyncio.to_thread((Path(ordered["folder"]) / "order.pickle").is_file)
    own = {"order": ordered["order"], "record": {"outcome": "measured"}}
    assert_problem(await client.post(f"/particles/{name}/revisions", json=own), 409, "not-measured")
    assert_problem(await client.post(f"/particles/{name}/revisions", json=own), 409, "not-ordered")
    away = {"order": "../1"}
    assert (await client.post(f"/particles/{name}/revisions", json=away)).status_code == 422
    assert (await client.post(f"/particles/{name}/revisions")).json()["is_new"]
    assert (await client.post(f"/particles/{name}/revisions/orders")).json() == {
        "is_needed": False,
        "order": None,
        "folder": None,
    }
