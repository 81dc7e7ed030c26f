"""The plant as outlets see it: fresh, or known not to be; orders, and their refusals."""

import asyncio
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from support.bridge import alarm, kept_plant, overview, state_when, tell
from support.fake_feed import FakeFeed, Other, Refusal, serving

from pipeline.gradation.specification import Verdict
from service.base.status import Ne107
from service.bridge import plant as plant_module
from service.bridge.plant import OrderRefusedError, Plant
from service.bridge.plant_state import PlantState, state_of


@pytest.fixture
def daemon(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeFeed]:
    monkeypatch.setattr(plant_module, "POLL_S", 0.02)
    with serving(FakeFeed(last_seq=5)) as feed:
        tell(feed)
        yield feed


async def test_the_state_is_that_of_the_overview_and_the_alarms(daemon: FakeFeed, tmp_path: Path) -> None:
    async with kept_plant(daemon.url, tmp_path) as plant:
        assert plant.state == PlantState()
        state = await state_when(plant, lambda state: state.daemon_answers)
        assert (state.lot, state.verdict, state.n_stones) == ("L-7", Verdict.CONFORMS, 70_000)
        assert (state.last_lot, state.last_verdict) == ("L-6", Verdict.CONFORMS)
        assert (state.triggers, state.measured, state.rejected, state.lost) == (100_000, 99_000, 900, 99)
        assert state.components == {"gate": Ne107.GOOD, "rig": Ne107.GOOD, "c01": Ne107.GOOD}
        assert state.d50_mm is not None and state.d50_mm.value == 11.234
        tell(daemon, alarm(3), ne107="failure", ready=False)
        state = await state_when(plant, lambda state: state.ne107 is Ne107.FAILURE)
        assert [(each.id, each.state) for each in state.alarms] == [(3, "unacknowledged")]
        tell(daemon, alarm(3, "operator"), ne107="failure", ready=False)
        await state_when(plant, lambda state: state.alarms[0].acknowledged_by == "operator")
        tell(daemon)
        await state_when(plant, lambda state: not state.alarms)


def test_figures_of_another_lot_are_not_shown_as_those_of_the_open_one() -> None:
    told = overview()
    told["figures"]["lot"] = "L-6"
    state = state_of(told, ())
    assert (state.lot, state.verdict, state.d50_mm, state.measured) == ("L-7", None, None, 99_000)
    told = overview(lot=None)
    told["figures"]["lot"] = None  # those of the last hour
    state = state_of(told, ())
    assert state.d50_mm is not None
    assert state.verdict is None


@pytest.mark.parametrize(
    "answer",
    [Other(b"{}"), Other(b'{"lot": 3}'), Refusal(401, "unauthorized"), Refusal(503, "busy")],
    ids=str,
)
async def test_while_the_daemon_gives_no_state_nothing_old_is_left(
    answer: Other | Refusal, daemon: FakeFeed, tmp_path: Path
) -> None:
    async with kept_plant(daemon.url, tmp_path) as plant:
        await state_when(plant, lambda state: state.daemon_answers)
        daemon.next_answers.append(answer)
        n_before = plant.n_answers
        state = await state_when(plant, lambda state: not state.daemon_answers)
        assert state == PlantState(trouble=state.trouble)
        assert state.trouble
        await state_when(plant, lambda state: state.daemon_answers)
        assert plant.n_answers > n_before


async def test_a_wrong_key_is_told_and_a_right_one_taken_without_a_restart(
    daemon: FakeFeed, tmp_path: Path
) -> None:
    daemon.key = "right"
    key_file = tmp_path / "key"
    key_file.write_text("wrong\n")
    async with kept_plant(daemon.url, tmp_path, key_file) as plant:
        state = await state_when(plant, lambda state: state.trouble != PlantState().trouble)
        assert state.trouble == "401 unauthorized: no key"
        key_file.write_text("right\n")
        await state_when(plant, lambda state: state.daemon_answers)


async def test_a_daemon_that_hangs_is_no_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that accepts, and then sends a byte now and then for ever."""
    monkeypatch.setattr(plant_module, "ANSWER_S", 0.3)
    ended = threading.Event()

    class Trickling(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Length: 100000\r\n\r\n")
            with_patience = iter(range(100_000))
            try:
                while not ended.wait(0.05) and next(with_patience) >= 0:
                    self.wfile.write(b" ")
            except OSError:
                pass

        def log_message(self, *_: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Trickling)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        async with kept_plant(f"http://127.0.0.1:{server.server_port}", tmp_path) as plant:
            state = await state_when(plant, lambda state: state.trouble != PlantState().trouble)
            assert state.trouble == "no answer within 0.3 s"
    finally:
        ended.set()
        server.shutdown()
        thread.join()
        server.server_close()


async def test_orders_are_given_once_with_the_key_of_who_gives_them(daemon: FakeFeed, tmp_path: Path) -> None:
    key_file = tmp_path / "key"
    key_file.write_text("bridge's")
    plant = Plant(daemon.url, key_file, tmp_path, None)
    daemon.documents["/api/v1/lots"] = {"lot": "L-8"}
    daemon.next_answers.append(Refusal(503, "busy", {"Retry-After": "0"}))
    await plant.open_lot("L-8", "basalt-8-16", closes="L-7")
    await plant.acknowledge(3, token="operator's")  # noqa: S106 - of nothing
    await plant.close_lot("L-8/..")
    asked = [(path, headers["Authorization"]) for _, path, headers in daemon.asked]
    assert asked == [
        ("/lots", "Bearer bridge's"),
        ("/lots", "Bearer bridge's"),
        ("/alarms/3/acknowledge", "Bearer operator's"),
        ("/lots/L-8%2F../close", "Bearer bridge's"),
    ]
    assert len({headers["Idempotency-Key"] for _, _, headers in daemon.asked}) == 3
    assert daemon.bodies[0] == {"lot": "L-8", "product": "basalt-8-16", "closes": "L-7"}


async def test_any_document_can_be_asked_for(daemon: FakeFeed, tmp_path: Path) -> None:
    plant = Plant(daemon.url, None, tmp_path, None)
    daemon.documents["/products"] = {"items": []}
    assert await plant.get("/products", limit=5) == {"items": []}
    daemon.next_answers.append(Refusal(403, "forbidden"))
    with pytest.raises(OrderRefusedError, match="403 forbidden"):
        await plant.get("/products")
    assert [path for _, path, _ in daemon.asked] == ["/products?limit=5", "/products?"]


async def test_a_refusal_says_why(daemon: FakeFeed, tmp_path: Path) -> None:
    plant = Plant(daemon.url, None, tmp_path, None)
    daemon.next_answers.append(Refusal(409, "lot-conflict"))
    with pytest.raises(OrderRefusedError, match="409 lot-conflict: told so") as refused:
        await plant.open_lot("L-8", "basalt-8-16")
    assert refused.value.kind == "lot-conflict"


@pytest.mark.parametrize("token", ["Schlüssel\u2026", "two\nlines"])
async def test_a_token_that_cannot_be_sent_is_refused(token: str, daemon: FakeFeed, tmp_path: Path) -> None:
    with pytest.raises(OrderRefusedError, match="the token is none of a key"):
        await Plant(daemon.url, None, tmp_path, None).acknowledge(3, token)
    assert daemon.asked == []


async def test_states_are_coalesced(daemon: FakeFeed, tmp_path: Path) -> None:
    async with kept_plant(daemon.url, tmp_path) as plant:
        await state_when(plant, lambda state: state.daemon_answers)
        states = plant.states()
        assert (await anext(states)).lot == "L-7"
        n_before = plant.n_answers
        for n_stones in (1, 2, 3):
            lot = {**overview()["lot"], "n_stones": n_stones}
            tell(daemon, lot=lot)
            while plant.n_answers < n_before + 2 * n_stones:  # noqa: ASYNC110 - it has no event for it
                await asyncio.sleep(0.01)
        assert (await anext(states)).n_stones == 3
        await states.aclose()
