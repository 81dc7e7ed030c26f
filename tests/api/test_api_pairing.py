"""Screens that are signed in by a code: who may, once, for minutes; and displays, which only read."""

from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest
from support.rest import FakeControl, app_of, assert_problem, client_of

from service.store import Store
from service.store.keys import create_key, revoke_key, stored_keys
from service.store.pairings import LASTS_S
from service.web.clients import MAX_WRONG
from service.web.pairings import MOST_OF_ADDRESS, MOST_OPEN
from service.web.sessions import LASTING_S, LONGEST_S, UNUSED_S
from service.web.settings import ApiSettings, Role, Scope

HOST = "stonefall.plant:8080"
OURS = {"Origin": f"http://{HOST}", "User-Agent": "Wall/1.0"}
NAMED = ApiSettings(host="0.0.0.0", allowed_hosts=("stonefall.plant",))  # noqa: S104 - not bound
READ, OPERATE, CONFIGURE = Scope


class Clock:
    """The wall clock, which a test sets."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 1_800_000_000.0
        monkeypatch.setattr("time.time", lambda: self.now_s)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


@pytest.fixture
async def wall(store: Store, control: FakeControl) -> AsyncIterator[httpx.AsyncClient]:
    """Return a screen of the network."""
    async with client_of(app_of(store, control, NAMED), "192.0.2.9", HOST) as client:
        client.headers.update(OURS)
        yield client


@pytest.fixture
def boss(state_dir: Path, store: Store) -> dict[str, str]:
    """Return the header of a key that may all."""
    return bearer(create_key(state_dir, "boss", tuple(Scope), None, "root")[1])


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


async def shown(client: httpx.AsyncClient) -> tuple[str, str]:
    """Return the code that a screen shows, and its secret."""
    answer = await client.post("/session/pairing")
    assert answer.status_code == 201, answer.text
    return answer.json()["code"], answer.json()["secret"]


async def claimed(client: httpx.AsyncClient, secret: str) -> httpx.Response:
    return await client.post("/session/pairing/claim", json={"secret": secret})


async def confirmed(
    client: httpx.AsyncClient, code: str, key: dict[str, str], name: str = "silo-2", role: Role = Role.DISPLAY
) -> httpx.Response:
    wanted = {"name": name, "role": role}
    return await client.post(f"/pairings/{code}/confirm", json=wanted, headers=key)


async def paired(wall: httpx.AsyncClient, boss: dict[str, str]) -> dict[str, str]:
    """Pair the screen as a display, and return the header of its cookie."""
    code, secret = await shown(wall)
    assert (await confirmed(wall, code, boss)).status_code == 200
    answer = await claimed(wall, secret)
    wall.cookies.clear()
    return {"Cookie": answer.headers["Set-Cookie"].partition(";")[0]}


async def test_a_code_that_is_confirmed_signs_its_screen_in_once(
    wall: httpx.AsyncClient, boss: dict[str, str]
) -> None:
    begun = (await wall.post("/session/pairing")).json()
    code, secret = begun["code"], begun["secret"]
    assert begun["confirm_at"] == f"http://{HOST}/setup?code={code}#screens"
    assert begun["qr_svg"].startswith("<svg")
    assert (await claimed(wall, secret)).json() == {"is_signed_in": False}
    seen = (await wall.get(f"/pairings/{code}", headers=boss)).json()
    assert (seen["address"], seen["user_agent"]) == ("192.0.2.9", "Wall/1.0")
    made = (await confirmed(wall, code, boss)).json()
    assert made == {"name": "silo-2", "scopes": ["read"], "is_display": True, "asked_from_now_on": []}
    answer = await claimed(wall, secret)
    assert answer.json() == {"is_signed_in": True}
    assert f"Max-Age={LASTING_S};" in answer.headers["Set-Cookie"]
    assert (await wall.get("/results")).status_code == 200
    wall.cookies.clear()
    assert_problem(await wall.get("/results"), 401, "unauthorized")
    assert_problem(await claimed(wall, secret), 404, "unknown-pairing")
    assert_problem(await confirmed(wall, code, boss, "other"), 404, "unknown-pairing")
    entries = (await wall.get("/audit", headers=boss)).json()["items"]
    done = [(each["who"], each["action"], each["subject"]) for each in reversed(entries)]
    assert sorted(done) == sorted(
        [
            ("stonefall keys of root", "key created", "boss"),
            ("key boss", "screen paired", "silo-2"),
            ("key silo-2", "session begun", "silo-2"),
        ]
    )
    (screen,) = (each["after"] for each in entries if each["action"] == "screen paired")
    assert (screen["address"], screen["user_agent"]) == ("192.0.2.9", "Wall/1.0")
    assert (screen["scopes"], screen["is_display"]) == (["read"], True)
    assert secret not in str(entries) and code not in str(entries)


async def test_a_display_reads_and_writes_nothing(
    wall: httpx.AsyncClient, boss: dict[str, str], control: FakeControl
) -> None:
    cookie = await paired(wall, boss)
    for method, path in (
        ("PUT", "/acquisition"),
        ("POST", "/lots"),
        ("PUT", "/products/a"),
        ("POST", "/events"),
        ("DELETE", "/consumers/a"),
        ("POST", "/pairings/123456/confirm"),
    ):
        refused = await wall.request(method, path, json={"state": "armed"}, headers=cookie)
        assert_problem(refused, 403, "forbidden")
        assert refused.json()["detail"] == (
            "key 'silo-2' is a display's, which may only read: sign in with another key"
        )
    assert control.state == "disarmed"
    asked = (await wall.get("/session", headers=cookie)).json()
    assert (asked["who"], asked["scopes"], asked["is_display"]) == ("key silo-2", ["read"], True)


async def test_a_display_stays_signed_in_until_its_key_is_revoked(
    wall: httpx.AsyncClient,
    store: Store,
    control: FakeControl,
    boss: dict[str, str],
    state_dir: Path,
    clock: Clock,
) -> None:
    cookie = await paired(wall, boss)
    for elapsed_s in (UNUSED_S + 1, LONGEST_S + 1, 300 * 24 * 3600):
        clock.now_s += elapsed_s
        assert (await wall.get("/results", headers=cookie)).status_code == 200
        renewed = await wall.get("/session", headers=cookie)
        assert f"Max-Age={LASTING_S};" in renewed.headers["Set-Cookie"]
        wall.cookies.clear()
        other = await wall.post("/session", json={"token": boss["Authorization"].split()[1]})
        assert other.status_code == 200  # when those that ended are forgotten
        wall.cookies.clear()
    await store.write(lambda connection: None)
    async with client_of(app_of(store, control, NAMED), "192.0.2.9", HOST) as restarted:
        clock.now_s -= 10 * 24 * 3600  # until a time server has answered
        assert (await restarted.get("/results", headers=cookie)).status_code == 200
        revoke_key(state_dir, "silo-2", "root")
        for client in (wall, restarted):
            dead = await client.get("/results", headers=cookie)
            assert_problem(dead, 401, "unauthorized")
            assert "key 'silo-2' was revoked at" in dead.json()["detail"]


async def test_only_who_may_make_keys_confirms_and_gives_no_more_than_it_has(
    wall: httpx.AsyncClient, boss: dict[str, str], state_dir: Path
) -> None:
    code, secret = await shown(wall)
    for scopes, status in (((READ,), 403), ((READ, OPERATE), 403)):
        key = bearer(create_key(state_dir, f"k{len(scopes)}", scopes, None, "root")[1])
        assert (await wall.get(f"/pairings/{code}", headers=key)).status_code == status
        assert (await confirmed(wall, code, key)).status_code == status
    for headers in ({}, bearer("guess"), bearer(secret), bearer(code)):
        assert (await confirmed(wall, code, headers)).status_code == 401
    limited = bearer(create_key(state_dir, "limited", (READ, CONFIGURE), None, "root")[1])
    refused = await confirmed(wall, code, limited, role=Role.ENGINEER)
    assert_problem(refused, 403, "forbidden")
    assert "may not give operate" in refused.json()["detail"]
    assert_problem(await confirmed(wall, code, limited, name="boss"), 409, "key-conflict")
    assert_problem(await confirmed(wall, code, limited, name="../x"), 422, "invalid-request")
    assert (await claimed(wall, secret)).json() == {"is_signed_in": False}
    assert (await confirmed(wall, code, limited)).status_code == 200


@pytest.mark.parametrize("role", Role)
async def test_a_role_is_its_scopes(wall: httpx.AsyncClient, boss: dict[str, str], role: Role) -> None:
    code, secret = await shown(wall)
    assert (await confirmed(wall, code, boss, role=role)).status_code == 200
    assert (await claimed(wall, secret)).json() == {"is_signed_in": True}
    asked = (await wall.get("/session")).json()
    assert (asked["scopes"], asked["is_display"]) == ([*role.scopes], role is Role.DISPLAY)


async def test_a_code_runs_out_and_outlives_no_restart(
    wall: httpx.AsyncClient, store: Store, control: FakeControl, boss: dict[str, str], clock: Clock
) -> None:
    code, secret = await shown(wall)
    async with client_of(app_of(store, control, NAMED), "192.0.2.9", HOST) as restarted:
        assert_problem(await claimed(restarted, secret), 404, "unknown-pairing")
        await shown(restarted)
        assert_problem(await confirmed(restarted, code, boss), 404, "unknown-pairing")
    code, secret = await shown(wall)
    clock.now_s += LASTS_S
    assert_problem(await confirmed(wall, code, boss), 404, "unknown-pairing")
    assert_problem(await claimed(wall, secret), 404, "unknown-pairing")
    code, secret = await shown(wall)
    assert (await confirmed(wall, code, boss)).status_code == 200
    clock.now_s += LASTS_S  # the screen has not come for it
    assert_problem(await claimed(wall, secret), 404, "unknown-pairing")


async def test_codes_are_bounded_and_cannot_be_guessed(
    store: Store, control: FakeControl, boss: dict[str, str]
) -> None:
    app = app_of(store, control, NAMED)
    codes = []
    for n in range(MOST_OPEN // MOST_OF_ADDRESS):
        async with client_of(app, f"192.0.2.{n}", HOST) as screen:
            codes += [(await shown(screen))[0] for _ in range(MOST_OF_ADDRESS)]
    assert len(set(codes)) == MOST_OPEN
    async with client_of(app, "192.0.2.0", HOST) as screen, client_of(app, "192.0.2.99", HOST) as other:
        assert_problem(await other.post("/session/pairing"), 429, "too-many-pairings")
        for _ in range(MAX_WRONG - MOST_OF_ADDRESS):  # they take the place of its own
            newest = (await shown(screen))[0]
        assert_problem(await screen.post("/session/pairing"), 429, "too-many-attempts")
        assert (await other.get(f"/pairings/{codes[-1]}", headers=boss)).status_code == 200
        assert_problem(await other.get(f"/pairings/{codes[0]}", headers=boss), 404, "unknown-pairing")
        wrong = next(code for n in range(99) if (code := f"{n:06d}") not in {*codes, newest})
        for _ in range(MAX_WRONG - 1):
            assert_problem(await other.get(f"/pairings/{wrong}", headers=boss), 404, "unknown-pairing")
        assert_problem(await confirmed(other, wrong, boss), 429, "too-many-attempts")
        assert_problem(await confirmed(other, newest, boss), 429, "too-many-attempts")
        assert_problem(await other.get("/pairings/12345", headers=boss), 422, "invalid-request")
    rows = await store.read(lambda connection: connection.execute("SELECT count(*) FROM pairings").fetchone())
    assert rows == (MOST_OPEN,)


async def test_a_foreign_page_begins_and_ends_nothing(wall: httpx.AsyncClient, boss: dict[str, str]) -> None:
    code, secret = await shown(wall)
    assert (await confirmed(wall, code, boss)).status_code == 200
    foreign = {"Origin": "http://stonefall.plant:3000"}
    assert_problem(await wall.post("/session/pairing", headers=foreign), 403, "foreign-origin")
    answer = await wall.post("/session/pairing/claim", json={"secret": secret}, headers=foreign)
    assert_problem(answer, 403, "foreign-origin")
    assert (await claimed(wall, secret)).json() == {"is_signed_in": True}


async def test_a_key_that_was_revoked_before_its_screen_came_opens_nothing(
    wall: httpx.AsyncClient, boss: dict[str, str], state_dir: Path
) -> None:
    code, secret = await shown(wall)
    assert (await confirmed(wall, code, boss)).status_code == 200
    revoke_key(state_dir, "silo-2", "root")
    assert_problem(await claimed(wall, secret), 401, "unauthorized")


async def test_the_first_key_says_who_needs_one_from_then_on(
    store: Store, control: FakeControl, state_dir: Path
) -> None:
    app = app_of(store, control, ApiSettings())
    async with client_of(app) as here, client_of(app, "127.0.0.1") as mes:
        assert (await mes.get("/results", headers={"User-Agent": "mes/2\x01\x7f"})).status_code == 200
        code, secret = await shown(here)
        made = (await confirmed(here, code, {})).json()
        asked = [each["user_agent"] for each in made["asked_from_now_on"]]
        assert asked == [here.headers["User-Agent"], "mes/2"]
        assert [key.name for key in stored_keys(state_dir)] == ["silo-2"]
        assert_problem(await mes.get("/results"), 401, "unauthorized")
        assert (await claimed(here, secret)).json() == {"is_signed_in": True}
        assert (await here.get("/session")).json()["keyless"] == []
