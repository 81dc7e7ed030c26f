"""Requests take turns: the gone take none, strangers none of those with a key, and no client those of the others."""

import asyncio
import hashlib
from collections.abc import AsyncIterator
from dataclasses import dataclass

import pytest
from support.rest import FakeControl, app_of, assert_problem, client_of
from support.served import Served, served_by

from service.store import Store
from service.web import pace
from service.web.pace import BURST, MAX_WAITING, RATE_HZ, Turn, Turns, Waiting
from service.web.settings import ApiKey, ApiSettings

MES = ApiKey(name="mes", sha256=hashlib.sha256(b"mes-token").hexdigest())
RIGHT, WRONG = ({"Authorization": f"Bearer {token}"} for token in ("mes-token", "guess"))
GET = b"GET /api/v1/results HTTP/1.1\r\nHost: localhost\r\n\r\n"


@dataclass
class Clock:
    """The time of the event loop, which passes when a test says so."""

    now_s: float = 100.0

    async def passes(self, n_turns: float) -> None:
        self.now_s += n_turns / RATE_HZ
        for _ in range(3):
            await asyncio.sleep(0)


@pytest.fixture
async def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(asyncio.get_running_loop(), "time", lambda: clock.now_s)
    return clock


@pytest.fixture
async def turns(clock: Clock) -> Turns:
    """Turns of which the first ones have just been taken."""
    turns = Turns()
    first = [turns.ask("before", is_known=True) for _ in range(BURST)]
    await clock.passes(0.01)  # rounding has the last of them wait for no time at all
    assert [waiting.result() for waiting in first] == BURST * [Turn.COME]
    return turns


class Asked:
    """Requests in the order in which they came to their turn."""

    def __init__(self, turns: Turns) -> None:
        self.came: list[str] = []
        self.refused: list[str] = []
        self._turns = turns

    def __call__(self, name: str, client: str, *, is_known: bool = True) -> Waiting:
        waiting = self._turns.ask(client, is_known=is_known)
        waiting.add_done_callback(lambda done: self._note(name, done))
        return waiting

    def _note(self, name: str, done: Waiting) -> None:
        if done.result() is Turn.COME:
            self.came.append(name)
        elif done.result() is Turn.REFUSED:
            self.refused.append(name)


async def test_clients_alternate_while_they_wait(turns: Turns, clock: Clock) -> None:
    asked = Asked(turns)
    for name, client in (("a1", "a"), ("a2", "a"), ("a3", "a"), ("b1", "b"), ("b2", "b")):
        asked(name, client)
    assert asked.came == []
    for _ in range(5):
        await clock.passes(1.01)
    assert asked.came == ["a1", "b1", "a2", "b2", "a3"]


async def test_those_with_a_key_have_every_second_turn_however_many_strangers_wait(
    turns: Turns, clock: Clock
) -> None:
    asked = Asked(turns)
    for number in range(20):
        asked(f"stranger {number}", f"stranger {number}", is_known=False)
    for number in range(3):
        asked(f"known {number}", "mes")
    for _ in range(6):
        await clock.passes(1.01)
    assert {name for name in asked.came if name.startswith("known")} == {"known 0", "known 1", "known 2"}


async def test_who_is_gone_takes_no_turn(turns: Turns, clock: Clock) -> None:
    asked = Asked(turns)
    gone = [asked("gone", "a") for _ in range(100)]
    asked("here", "a")
    for waiting in gone:
        pace.give_up_turn({pace.TURN: waiting})
        turns.leave("a", waiting, is_known=True)
    assert turns.n_waiting == 1
    await clock.passes(1.01)
    assert asked.came == ["here"]
    assert turns.n_waiting == 0


async def test_of_too_many_the_last_ones_of_whoever_has_most_are_refused(turns: Turns, clock: Clock) -> None:
    asked = Asked(turns)
    for number in range(MAX_WAITING):
        asked(f"a{number}", "a")
    asked("one more", "a")
    asked("b", "b")
    await clock.passes(0)
    assert asked.refused == ["one more", f"a{MAX_WAITING - 1}"]
    assert turns.n_waiting == MAX_WAITING


async def test_strangers_are_refused_before_those_with_a_key(turns: Turns, clock: Clock) -> None:
    asked = Asked(turns)
    for number in range(MAX_WAITING):
        asked(f"stranger {number}", f"stranger {number}", is_known=False)
    for number in range(MAX_WAITING):
        asked(f"known {number}", "mes")
    asked("late stranger", "late", is_known=False)
    await clock.passes(0)
    assert len(asked.refused) == MAX_WAITING + 1
    assert not [name for name in asked.refused if name.startswith("known")]


class KeptTurns(Turns):
    """Lets a test look at the turns of an application."""

    made: "list[KeptTurns]"

    def __init__(self) -> None:
        super().__init__()
        self.made.append(self)
        self.strangers: list[bool] = []

    def ask(self, client: str, *, is_known: bool) -> Waiting:
        self.strangers.append(not is_known)
        return super().ask(client, is_known=is_known)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[KeptTurns]:
    monkeypatch.setattr(KeptTurns, "made", [], raising=False)
    monkeypatch.setattr(pace, "Turns", KeptTurns)
    return KeptTurns.made


@pytest.fixture
async def served(store: Store, control: FakeControl, made: list[KeptTurns]) -> AsyncIterator[Served]:
    async with served_by(app_of(store, control, ApiSettings(keys=(MES,)))) as served:
        yield served


async def test_a_connection_that_is_closed_leaves_the_queue(
    served: Served, made: list[KeptTurns], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pace, "RATE_HZ", 0.001)
    monkeypatch.setattr(pace, "BURST", 1)
    first = await served.connect(GET)
    assert b" 401 " in await first.reader.readline()
    waiting = [await served.connect(GET) for _ in range(20)]
    await served.until(lambda: made[0].n_waiting == 20)
    for client in waiting:
        client.writer.close()
    await served.until(lambda: made[0].n_waiting == 0)
    await served.until(lambda: len(served.connections) == 1)


async def test_wrong_keys_are_strangers_and_right_ones_are_not(
    store: Store, control: FakeControl, made: list[KeptTurns]
) -> None:
    async with client_of(app_of(store, control, ApiSettings(keys=(MES,)))) as client:
        for headers in ({}, WRONG, RIGHT):
            await client.get("/results", headers=headers)
    assert made[0].strangers == [True, True, False]


async def test_while_there_is_no_key_this_machine_is_known(
    store: Store, control: FakeControl, made: list[KeptTurns]
) -> None:
    app = app_of(store, control, ApiSettings(host="0.0.0.0"))  # noqa: S104 - nothing is bound
    async with client_of(app) as client, client_of(app, "192.0.2.1") as other:
        await client.get("/results")
        await other.get("/results")
    assert made[0].strangers == [False, True]


async def test_too_many_who_wait_are_told_so(
    store: Store, control: FakeControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pace, "MAX_WAITING", 0)
    async with client_of(app_of(store, control, ApiSettings())) as client:
        assert_problem(await client.get("/health/live"), 503, "too-many-connections")
