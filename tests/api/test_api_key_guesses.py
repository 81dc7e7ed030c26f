"""Wrong keys are slowed down, by who sends them and not by who he says he is, and shut out nobody with a right one."""

import hashlib

import httpx
import pytest
from support.rest import FakeControl, app_of, assert_problem, client_of
from support.served import served_by

from service.store import Store
from service.web.clients import MAX_REMEMBERED, MAX_WRONG, PAUSE_S, Attempts
from service.web.settings import ApiKey, ApiSettings

MES = ApiKey(name="mes", sha256=hashlib.sha256(b"mes-token").hexdigest())
RIGHT, WRONG = ({"Authorization": f"Bearer {token}"} for token in ("mes-token", "guess"))


def guessed(host: str, n: int = MAX_WRONG, now_s: float = 0.0) -> Attempts:
    guesses = Attempts()
    for _ in range(n):
        guesses.note(host, now_s)
    return guesses


async def test_an_address_that_guesses_must_wait(store: Store, control: FakeControl) -> None:
    app = app_of(store, control, ApiSettings(keys=(MES,)))
    async with client_of(app, "192.0.2.66") as stranger, client_of(app, "192.0.2.1") as mes:
        for _ in range(MAX_WRONG):
            assert_problem(await stranger.get("/results", headers=WRONG), 401, "unauthorized")
        refused = await stranger.get("/results", headers=WRONG)
        assert_problem(refused, 429, "too-many-attempts")
        assert 0 < int(refused.headers["Retry-After"]) <= PAUSE_S
        assert refused.json()["retry_after_s"] == int(refused.headers["Retry-After"])
        assert (await stranger.get("/health/live")).status_code == 200
        assert (await mes.get("/results", headers=RIGHT)).status_code == 200


async def test_a_right_key_that_was_never_seen_is_not_shut_out_by_others_at_its_address(
    store: Store, control: FakeControl
) -> None:
    async with client_of(app_of(store, control, ApiSettings(keys=(MES,)))) as client:
        for _ in range(MAX_WRONG):
            await client.get("/results", headers=WRONG)
        for _ in range(2):
            assert (await client.get("/results", headers=WRONG)).status_code == 429
            assert (await client.get("/results", headers=RIGHT)).status_code == 200


@pytest.mark.parametrize(
    ("trusted", "last"), [((), 429), (("192.0.2.0/24",), 429), (("127.0.0.1",), 401), (("127.0.0.0/8",), 401)]
)
async def test_nobody_is_believed_who_asks_for_somebody_else_but_a_configured_proxy(
    store: Store, control: FakeControl, trusted: tuple[str, ...], last: int
) -> None:
    settings = ApiSettings(keys=(MES,), trusted_proxies=trusted)
    async with (
        served_by(app_of(store, control, settings), settings) as served,
        httpx.AsyncClient(base_url=f"http://127.0.0.1:{served.port}/api/v1") as client,
    ):
        for number in range(MAX_WRONG + 1):
            answer = await client.get("/results", headers={**WRONG, "X-Forwarded-For": f"203.0.113.{number}"})
    assert answer.status_code == last


async def test_no_key_is_no_guess(store: Store, control: FakeControl) -> None:
    async with client_of(app_of(store, control, ApiSettings(keys=(MES,)))) as client:
        for _ in range(3 * MAX_WRONG):
            assert (await client.get("/results")).status_code == 401
        assert (await client.get("/results", headers=RIGHT)).status_code == 200


def test_the_pause_ends_and_is_not_prolonged() -> None:
    guesses = guessed("192.0.2.66")
    assert guesses.pause_s("192.0.2.66", 0.0) == PAUSE_S
    assert guesses.pause_s("192.0.2.66", PAUSE_S / 2) == PAUSE_S / 2
    assert guesses.pause_s("192.0.2.66", PAUSE_S) == 0.0
    guesses.note("192.0.2.66", PAUSE_S)  # counts as the first
    assert guesses.pause_s("192.0.2.66", PAUSE_S) == 0.0


def test_guesses_of_another_day_do_not_add_up() -> None:
    guesses = guessed("192.0.2.66", MAX_WRONG - 1)
    guesses.note("192.0.2.66", 2 * PAUSE_S)
    assert guesses.pause_s("192.0.2.66", 2 * PAUSE_S) == 0.0


def test_the_addresses_of_one_host_are_one() -> None:
    for mine, same, other in (
        ("192.0.2.66", "::ffff:192.0.2.66", "192.0.2.67"),
        ("2001:db8::1", "2001:db8::ffff:2", "2001:db8:0:1::1"),
    ):
        guesses = guessed(mine)
        assert guesses.pause_s(same, 0.0) > 0
        assert guesses.pause_s(other, 0.0) == 0


def test_memory_is_bounded_and_the_latest_are_kept() -> None:
    guesses = guessed("192.0.2.66")
    for number in range(2 * MAX_REMEMBERED):
        host = f"10.0.{number // 256}.{number % 256}"
        guesses.note(host, 0.0)
        guesses.note("192.0.2.66", 0.0)
    assert len(guesses._wrong) == MAX_REMEMBERED
    assert guesses.pause_s("192.0.2.66", 0.0) == PAUSE_S
