"""What takes long is made beside the daemon, once for all who ask the same, and never too much of it at a time."""

import asyncio
import os
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import httpx
import pytest
import trimesh
from support.daemon_process import process_name
from support.eventually import PATIENCE_S
from support.outcomes import add, measured, rejected
from support.rest import FakeControl, ReadingThread, app_of, assert_problem, client_of, particle_files
from support.worker_jobs import Stumble, stumble, wait_for

from service.base.errors import StoreError
from service.particles.renditions import NotKeptError, stone_png
from service.particles.routes.results import RESULTS
from service.store import Store, read
from service.store.reads import results_after
from service.web import pace, reader_process
from service.web.feeds import MAX_SMALL, page_after
from service.web.pace import BURST, RATE_HZ, Pace
from service.web.pages import feed_page
from service.web.reader_process import BusyError, ReaderProcess

T = TypeVar("T")
FILES = ("mesh.ply", "mesh.stl", "mesh.glb", "preview.png", "views/c01.png", "views/c01/silhouette.png")
N_POLLS = 60
N_PICTURES = 60


@pytest.fixture
async def reading(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[ReaderProcess]:
    """The process, with the patience and the priority of a machine that computes something else."""
    monkeypatch.setattr(reader_process, "DEADLINE_S", PATIENCE_S)
    monkeypatch.setattr(reader_process, "NICENESS", 1)
    reading = ReaderProcess()
    yield reading
    reading.close()


async def asked(store: Store, control: FakeControl, reading: Any, path: str) -> httpx.Response:
    async with client_of(app_of(store, control, reading=reading)) as client:
        return await client.get(path, headers={"X-Request-Id": "one"})


class CountingThread(ReadingThread):
    """A place to read that counts what it is asked for."""

    n_runs = 0

    async def run(self, function: Callable[..., T], *arguments: object) -> T:
        self.n_runs += 1
        return await super().run(function, *arguments)


async def test_files_and_big_pages_are_made_beside_the_daemon(
    store: Store, control: FakeControl, session: int, tmp_path: Path
) -> None:
    await add(store, session, 1, measured(), await asyncio.to_thread(particle_files, tmp_path / "out"))
    for number in range(2, MAX_SMALL + 2):
        await add(store, session, number, rejected("empty"))
    beside = CountingThread()
    for number, path in enumerate(
        (*(f"/particles/1/{name}" for name in FILES), "/results", "/particles"), start=1
    ):
        assert (await asked(store, control, beside, path)).status_code == 200
        assert beside.n_runs == number, path
    for path in (f"/results?limit={MAX_SMALL}", f"/results?after={MAX_SMALL}", "/particles?limit=1"):
        assert (await asked(store, control, beside, path)).status_code == 200
    assert beside.n_runs == number


async def test_streams_far_behind_share_full_pages_although_stones_fall(
    store: Store, control: FakeControl, session: int
) -> None:
    for number in range(1, MAX_SMALL + 3):
        await add(store, session, number, rejected("empty"))
    beside = CountingThread()
    context = app_of(store, control, reading=beside).state.context
    stream = replace(RESULTS, is_stream=True)
    first = await page_after(context, stream, 0, MAX_SMALL + 1)
    await add(store, session, MAX_SMALL + 3, rejected("empty"))
    assert (await page_after(context, stream, 0, MAX_SMALL + 1)).content == first.content
    assert beside.n_runs == 1
    # not full, and what says how far the feed goes: made anew
    assert (await page_after(context, stream, 0, 100)).cursor.next_after == MAX_SMALL + 3
    assert (await page_after(context, RESULTS, 0, 1)).cursor.last_seq == MAX_SMALL + 3
    await add(store, session, MAX_SMALL + 4, rejected("empty"))
    assert (await page_after(context, RESULTS, 0, 1)).cursor.last_seq == MAX_SMALL + 4


@pytest.mark.full
async def test_the_process_answers_what_a_thread_answers(
    store: Store, control: FakeControl, session: int, tmp_path: Path, reading: ReaderProcess
) -> None:
    await add(store, session, 1, measured(), await asyncio.to_thread(particle_files, tmp_path / "out"))
    for number in range(2, MAX_SMALL + 2):
        await add(store, session, number, rejected("empty"))
    for path in (*(f"/particles/1/{name}" for name in FILES), "/results", "/particles", "/particles/2/mesh"):
        here = await asked(store, control, ReadingThread(), path)
        there = await asked(store, control, reading, path)
        assert (there.status_code, there.headers, there.content) == (
            here.status_code,
            here.headers,
            here.content,
        )


@pytest.mark.parametrize("n", [MAX_SMALL, MAX_SMALL + 1])
async def test_a_page_has_the_bytes_of_its_results(
    client: httpx.AsyncClient, store: Store, session: int, n: int
) -> None:
    for number in range(1, n + 1):
        await add(store, session, number, measured(detail="5 µm größer"))
    items = [(await client.get(f"/particles/{seq}")).content for seq in range(1, n + 1)]
    head = f'{{"instance_id":"{store.instance_id}","first_seq":1,"last_seq":{n},"next_after":{n},"items":['
    assert (await client.get("/results")).content == head.encode() + b",".join(items) + b"]}"
    newest_first = b",".join(reversed(items))
    page = (await client.get(f"/particles?limit={n}")).content
    assert page == b'{"next_cursor":null,"items":[' + newest_first + b"]}"


async def test_it_is_a_process_of_lower_priority(reading: ReaderProcess) -> None:
    pid = await reading.run(os.getpid)
    assert pid != os.getpid()
    assert process_name(pid) == "stonefall-read"
    assert os.getpriority(os.PRIO_PROCESS, pid) == os.getpriority(os.PRIO_PROCESS, 0) + 1
    assert await reading.run(os.getpid) == pid


async def test_its_death_costs_one_retry_then_an_answer_to_come_again(
    store: Store, control: FakeControl, tmp_path: Path, reading: ReaderProcess
) -> None:
    once, always = tmp_path / "once", tmp_path / "always"
    once.mkdir()
    always.mkdir()
    assert await reading.run(stumble, Stumble(once, "kill", failures=1)) == "done"
    with pytest.raises(BusyError):
        await reading.run(stumble, Stumble(always, "kill", failures=2))
    assert len(list(always.iterdir())) == 2
    assert await reading.run(stumble, Stumble(once, "kill", failures=1)) == "done"


async def test_what_it_raises_is_raised_here(tmp_path: Path, reading: ReaderProcess) -> None:
    pid = await reading.run(os.getpid)
    with pytest.raises(NotKeptError, match=r"mesh\.sfmesh was not kept"):
        await reading.run(stone_png, tmp_path, 480)
    with pytest.raises(StoreError, match="nowhere"):
        await reading.run(read, tmp_path / "nowhere", results_after, 0, 1)
    with pytest.raises(TypeError):
        await reading.run(stone_png)
    assert await reading.run(os.getpid) == pid


async def test_when_too_many_wait_the_next_is_told_to_come_again(
    store: Store,
    control: FakeControl,
    session: int,
    tmp_path: Path,
    reading: ReaderProcess,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(reader_process, "MAX_WAITING", 3)
    waiting = [asyncio.create_task(reading.run(wait_for, tmp_path / "go")) for _ in range(3)]
    await asyncio.sleep(0)
    await add(store, session, 1, measured())
    answer = await asked(store, control, reading, "/particles/1/preview.png")
    assert_problem(answer, 503, "busy")
    assert answer.headers["Retry-After"] == "2"
    (tmp_path / "go").touch()
    assert len(set(await asyncio.gather(*waiting))) == 1
    assert (await asked(store, control, reading, "/particles/1/preview.png")).status_code == 404


@pytest.mark.full
async def test_figures_do_not_wait_for_pictures(
    store: Store, control: FakeControl, session: int, tmp_path: Path
) -> None:
    """None of 60 pictures is drawn before the figures have come, and not one of them is lost."""
    for number in range(1, N_PICTURES + 1):
        await asyncio.to_thread(trimesh.creation.box().export, tmp_path / "mesh.ply")
        await add(store, session, number, measured(), {"mesh.ply": tmp_path / "mesh.ply"})
    may_draw, all_wait, n_drawing = asyncio.Event(), asyncio.Event(), 0

    class Drawing(ReadingThread):
        async def run(self, function: Callable[..., T], *arguments: object) -> T:
            nonlocal n_drawing
            n_drawing += 1
            if n_drawing == N_PICTURES:
                all_wait.set()
            await may_draw.wait()
            return await super().run(function, *arguments)

    async with client_of(app_of(store, control, drawing=Drawing())) as client, asyncio.timeout(PATIENCE_S):
        pictures = [
            asyncio.create_task(client.get(f"/particles/{seq}/preview.png"))
            for seq in range(1, N_PICTURES + 1)
            for _ in range(2)  # two who ask for the same share one drawing
        ]
        await all_wait.wait()
        assert (await client.get("/windows/current?minutes=60")).status_code == 200
        assert not any(picture.done() for picture in pictures)
        may_draw.set()
        assert {(await picture).status_code for picture in pictures} == {200}
    assert n_drawing == N_PICTURES


async def test_long_polls_for_the_same_share_one_page(
    client: httpx.AsyncClient, store: Store, session: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    queries: list[object] = []
    n_waiting, all_wait = 0, asyncio.Event()
    reads, wait_while = store.read, store.wait_while

    async def counted(query: Any, *arguments: Any) -> Any:
        queries.append(query)
        return await reads(query, *arguments)

    async def observed(is_awaited: Callable[[], bool]) -> None:
        nonlocal n_waiting
        n_waiting += 1
        if n_waiting == N_POLLS:
            all_wait.set()
        await wait_while(is_awaited)

    monkeypatch.setattr(store, "read", counted)
    monkeypatch.setattr(store, "wait_while", observed)
    async with asyncio.timeout(PATIENCE_S):
        polls = [asyncio.create_task(client.get("/results?wait_s=30")) for _ in range(N_POLLS)]
        await all_wait.wait()
        await add(store, session, 1, measured())
        answers = [(await poll).content for poll in polls]
    assert len(set(answers)) == 1
    assert b'"next_after":1,' in answers[0]
    # a machine may be so slow that a page is no longer kept when the last one asks
    assert queries.count(feed_page) < N_POLLS / 5


async def test_requests_take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    waits_s: list[float] = []

    async def note(delay_s: float) -> None:
        waits_s.append(delay_s)

    now_s = 100.0
    monkeypatch.setattr(asyncio.get_running_loop(), "time", lambda: now_s)
    monkeypatch.setattr(pace.asyncio, "sleep", note)
    turns = Pace(BURST)
    for _ in range(BURST + 3):
        await turns.turn()
    assert max(waits_s[:BURST]) < 1e-6
    assert waits_s[BURST:] == pytest.approx([1 / RATE_HZ, 2 / RATE_HZ, 3 / RATE_HZ])
