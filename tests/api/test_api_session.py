"""Sessions of browsers: what they open, and what an attacker makes of them."""

import time
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.outcomes import add, measured
from support.rest import FakeControl, app_of, assert_problem, client_of
from support.sent_events import opened
from support.served import served_by

from pipeline.frames import rfc3339
from service.store import Store
from service.store.keys import AccessKey, create_key, revoke_key, sha256_of
from service.store.trouble import StoreTrouble, TroubleCause
from service.web.clients import MAX_WRONG
from service.web.sessions import LONGEST_S, NAME, NAME_OVER_TLS, UNUSED_S, Sessions
from service.web.settings import ApiSettings, Scope, WithoutKeys

ALL = tuple(Scope)
HOST = "stonefall.plant:8080"
OURS = {"Origin": f"http://{HOST}"}
NAMED = ApiSettings(host="0.0.0.0", allowed_hosts=("stonefall.plant",))  # noqa: S104 - not bound
KEY = AccessKey(sha256_of("test"), "office", ("read",))
ARM = {"state": "armed"}


class Clock:
    """The wall clock of the sessions, which a test sets."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = time.time()
        monkeypatch.setattr("service.web.auth.time.time", lambda: self.now_s)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


@pytest.fixture
def token(state_dir: Path, store: Store) -> str:
    return create_key(state_dir, "office", ALL, None, "root")[1]


@pytest.fixture
async def remote(store: Store, control: FakeControl) -> AsyncIterator[httpx.AsyncClient]:
    """Return a client of the network that keeps no cookies: tests send them by hand."""
    async with client_of(app_of(store, control, NAMED), "192.0.2.9", HOST) as client:
        yield client


async def signed_in(client: httpx.AsyncClient, token: str) -> dict[str, str]:
    """Sign in, and return the header of the cookie."""
    answer = await client.post("/session", json={"token": token}, headers=OURS)
    assert answer.status_code == 200, answer.text
    client.cookies.clear()
    return {"Cookie": answer.headers["Set-Cookie"].partition(";")[0]}


async def test_a_key_is_exchanged_for_a_cookie_that_reads_and_writes(
    remote: httpx.AsyncClient, store: Store, token: str, control: FakeControl
) -> None:
    answer = await remote.post("/session", json={"token": token}, headers=OURS)
    assert answer.json()["who"] == "key office"
    assert answer.json()["scopes"] == [*ALL]
    assert answer.headers["Cache-Control"] == "no-store"
    cookie, _, attributes = answer.headers["Set-Cookie"].partition(";")
    assert cookie.startswith(f"{NAME}=")
    assert {each.strip().lower() for each in attributes.split(";")} == {
        "httponly",
        "samesite=strict",
        "path=/",
        f"max-age={UNUSED_S}",
    }
    assert token not in str(answer.headers) + answer.text
    remote.cookies.clear()
    assert_problem(await remote.get("/results"), 401, "unauthorized")
    assert (await remote.get("/results", headers={"Cookie": cookie})).status_code == 200
    armed = await remote.put("/acquisition", json=ARM, headers={"Cookie": cookie, **OURS})
    assert (armed.status_code, control.state) == (200, "armed")
    entries = (await remote.get("/audit", headers={"Cookie": cookie})).json()["items"]
    assert {entry["who"] for entry in entries if entry["action"] != "key created"} == {"key office"}
    assert "session begun" in [entry["action"] for entry in entries]
    assert token not in str(entries)


async def test_scopes_are_those_of_the_key(remote: httpx.AsyncClient, state_dir: Path, store: Store) -> None:
    cookie = await signed_in(remote, create_key(state_dir, "wall", (Scope.READ,), None, "root")[1])
    assert (await remote.get("/session", headers=cookie)).json()["scopes"] == ["read"]
    refused = await remote.put("/acquisition", json=ARM, headers={**cookie, **OURS})
    assert_problem(refused, 403, "forbidden")
    assert "key 'wall' lacks the scope 'operate'" in refused.json()["detail"]


@pytest.mark.parametrize(
    "origin",
    [
        None,
        "null",
        "",
        "http://evil.example",
        "http://evil.plant:8080",
        "http://www.stonefall.plant:8080",
        "http://stonefall.plant:3000",  # another service of the same host: its pages send our cookie
        "https://stonefall.plant:8080",
        "http://stonefall.plant:8080.evil.example",
        "http://evil@stonefall.plant:8080",
        "http://stonefall.plant:8080/",
        "stonefall.plant:8080",
    ],
)
async def test_another_page_writes_nothing_with_our_cookie(
    remote: httpx.AsyncClient, token: str, control: FakeControl, origin: str | None
) -> None:
    cookie = await signed_in(remote, token)
    headers = cookie if origin is None else {**cookie, "Origin": origin}
    for method, path in (
        ("PUT", "/acquisition"),
        ("POST", "/recordings"),
        ("POST", "/calibrations/0001/activate"),
        ("DELETE", "/recordings/a"),
        ("DELETE", "/session"),
    ):
        refused = await remote.request(method, path, json=ARM, headers=headers)
        assert_problem(refused, 403, "foreign-origin")
    assert control.state == "disarmed"
    assert (await remote.get("/results", headers=cookie)).status_code == 200  # and is not signed out


async def test_programs_write_with_their_key_alone(remote: httpx.AsyncClient, token: str) -> None:
    bearer = {"Authorization": f"Bearer {token}"}
    assert (await remote.put("/acquisition", json=ARM, headers=bearer)).status_code == 200
    cookie = await signed_in(remote, token)
    both = {**bearer, **cookie}  # the key is looked at, not the cookie
    assert (await remote.put("/acquisition", json=ARM, headers=both)).status_code == 200
    wrong = {**cookie, **OURS, "Authorization": "Bearer guess"}
    assert_problem(await remote.put("/acquisition", json=ARM, headers=wrong), 401, "unauthorized")


async def test_a_foreign_page_signs_nobody_in(remote: httpx.AsyncClient, token: str) -> None:
    for origin in (
        "http://evil.example",
        "null",
        "http://stonefall.plant:3000",
        "http://www.stonefall.plant",
    ):
        answer = await remote.post("/session", json={"token": token}, headers={"Origin": origin})
        assert_problem(answer, 403, "foreign-origin")
        assert "Set-Cookie" not in answer.headers
    form = await remote.post(
        "/session", content=f'{{"token": "{token}"}}', headers={"Content-Type": "text/plain"}
    )
    assert_problem(form, 415, "unsupported-media-type")


async def test_each_sign_in_is_another_session(remote: httpx.AsyncClient, token: str) -> None:
    """Whatever cookie an attacker has planted before, the session that follows is not known to him."""
    planted = {"Cookie": f"{NAME}=planted"}
    first = await remote.post("/session", json={"token": token}, headers={**OURS, **planted})
    again = await remote.post(
        "/session", json={"token": token}, headers={**OURS, **planted, "Idempotency-Key": "one"}
    )
    third = await remote.post(
        "/session", json={"token": token}, headers={**OURS, **planted, "Idempotency-Key": "one"}
    )
    assert len({each.headers["Set-Cookie"] for each in (first, again, third)}) == 3
    assert "Idempotent-Replayed" not in third.headers


async def test_no_answer_of_a_sign_in_is_kept(remote: httpx.AsyncClient, store: Store, token: str) -> None:
    await remote.post("/session", json={"token": token}, headers={**OURS, "Idempotency-Key": "one"})
    kept = await store.read(lambda connection: connection.execute("SELECT count(*) FROM answers").fetchone())
    assert kept == (0,)


async def test_a_session_dies_with_its_key(
    remote: httpx.AsyncClient, state_dir: Path, token: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    cookie = await signed_in(remote, token)
    revoke_key(state_dir, "office", "root")
    dead = await remote.get("/results", headers=cookie)
    assert_problem(dead, 401, "unauthorized")
    assert "key 'office' was revoked at 2" in dead.json()["detail"]
    create_key(state_dir, "office", ALL, None, "root")  # another key of the same name
    assert_problem(await remote.get("/results", headers=cookie), 401, "unauthorized")
    end = rfc3339(time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(time.time() + 3600)))
    short = await signed_in(remote, create_key(state_dir, "short", ALL, end, "root")[1])
    assert (await remote.get("/session", headers=short)).json()["expires_at"] == end
    monkeypatch.setattr("service.web.auth.utc_now", lambda: end)
    assert_problem(await remote.get("/results", headers=short), 401, "unauthorized")


async def test_a_session_ends_unless_it_is_renewed_and_after_a_month_anyway(
    remote: httpx.AsyncClient, token: str, clock: Clock
) -> None:
    cookie, unused = await signed_in(remote, token), await signed_in(remote, token)
    begun_s = clock.now_s
    clock.now_s = begun_s + UNUSED_S - 1
    renewed = await remote.get("/session", headers=cookie)
    remote.cookies.clear()
    assert f"Max-Age={UNUSED_S};" in renewed.headers["Set-Cookie"]
    clock.now_s = begun_s + UNUSED_S + 1
    assert (await remote.get("/results", headers=cookie)).status_code == 200
    assert_problem(await remote.get("/results", headers=unused), 401, "unauthorized")
    n_renewals = 0
    while (answer := await remote.get("/session", headers=cookie)).json()["who"] is not None:
        remote.cookies.clear()
        clock.now_s += UNUSED_S / 2
        n_renewals += 1
    assert LONGEST_S - UNUSED_S <= clock.now_s - begun_s <= LONGEST_S + UNUSED_S
    assert n_renewals > 50
    assert "Max-Age=0" in answer.headers["Set-Cookie"]  # the browser is to forget it


async def test_a_session_of_a_clock_that_was_wrong_is_none(
    remote: httpx.AsyncClient, token: str, clock: Clock
) -> None:
    cookie = await signed_in(remote, token)
    clock.now_s -= 60  # set by a time server
    assert (await remote.get("/results", headers=cookie)).status_code == 200
    clock.now_s -= 365 * 24 * 3600
    assert_problem(await remote.get("/results", headers=cookie), 401, "unauthorized")
    clock.now_s += 730 * 24 * 3600
    assert_problem(await remote.get("/results", headers=cookie), 401, "unauthorized")


async def test_who_signs_out_is_out_with_every_copy_of_the_cookie(
    remote: httpx.AsyncClient, store: Store, control: FakeControl, token: str
) -> None:
    cookie, other = await signed_in(remote, token), await signed_in(remote, token)
    renewed = await remote.get("/session", headers=cookie)
    remote.cookies.clear()
    copy = {"Cookie": renewed.headers["Set-Cookie"].partition(";")[0]}
    answer = await remote.delete("/session", headers={**cookie, **OURS})
    assert answer.status_code == 204
    assert "Max-Age=0" in answer.headers["Set-Cookie"]
    for each in (cookie, copy):
        assert_problem(await remote.get("/results", headers=each), 401, "unauthorized")
    assert (await remote.get("/results", headers=other)).status_code == 200
    async with client_of(app_of(store, control, NAMED), "192.0.2.9", HOST) as restarted:
        for each in (cookie, copy):
            assert_problem(await restarted.get("/results", headers=each), 401, "unauthorized")
        assert (await restarted.get("/results", headers=other)).status_code == 200
    assert (await remote.delete("/session")).status_code == 204  # without one, nothing happens
    actions = [entry["action"] for entry in (await remote.get("/audit", headers=other)).json()["items"]]
    assert actions.count("session ended") == 1


async def test_no_cookie_is_stored(remote: httpx.AsyncClient, store: Store, token: str) -> None:
    cookie = (await signed_in(remote, token))["Cookie"].partition("=")[2]
    rows = await store.read(
        lambda connection: connection.execute("SELECT * FROM browser_sessions").fetchall()
    )
    assert [row[:2] for row in rows] == [(sha256_of(cookie), sha256_of(token))]


async def test_a_disk_that_refuses_keeps_nobody_out(
    remote: httpx.AsyncClient, store: Store, token: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Store, "trouble", StoreTrouble(TroubleCause.FULL, "no room"))
    cookie = await signed_in(remote, token)
    assert (await remote.get("/results", headers=cookie)).status_code == 200
    assert (await remote.delete("/session", headers={**cookie, **OURS})).status_code == 204
    assert_problem(await remote.get("/results", headers=cookie), 401, "unauthorized")


async def test_sessions_are_bounded_and_those_that_ended_are_forgotten(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.web.sessions.MAX_SESSIONS", 3)
    sessions = Sessions(store)
    begun = [sessions.begin(KEY, 1_000 + number)[1] for number in range(5)]
    assert [sessions.find(cookie, 1_010) is not None for cookie in begun] == [False, False, True, True, True]
    last = sessions.begin(KEY, 1_003 + UNUSED_S)[1]
    await store.write(lambda connection: None)
    again = Sessions(store)
    alive = [again.find(cookie, 1_003 + UNUSED_S) is not None for cookie in (*begun, last)]
    assert alive == [False, False, False, False, True, True]
    assert len(again._sessions) == 2


async def test_guesses_are_limited_and_dead_cookies_are_none(
    remote: httpx.AsyncClient, state_dir: Path, token: str
) -> None:
    cookie = await signed_in(remote, token)
    for _ in range(3 * MAX_WRONG):  # a browser with an old cookie must not shut out its neighbours
        dead = {"Cookie": cookie["Cookie"][:-1]}
        assert_problem(await remote.get("/results", headers=dead), 401, "unauthorized")
    other = create_key(state_dir, "other", ALL, None, "root")[1]
    for _ in range(MAX_WRONG):
        wrong = await remote.post("/session", json={"token": "guess"}, headers=OURS)
        assert_problem(wrong, 401, "unauthorized")
        assert "Set-Cookie" not in wrong.headers
    wrong = await remote.post("/session", json={"token": "guess"}, headers=OURS)
    assert_problem(wrong, 429, "too-many-attempts")
    assert (await remote.post("/session", json={"token": other}, headers=OURS)).status_code == 200
    wrong = await remote.get("/session", headers={"Authorization": "Bearer guess"})
    assert_problem(wrong, 429, "too-many-attempts")  # it is no way around
    assert (await remote.get("/results", headers=cookie)).status_code == 200


async def test_of_two_cookies_one_is_planted(remote: httpx.AsyncClient, token: str) -> None:
    """Another host of the domain can set a cookie of our name: who it signs in would act for the attacker."""
    cookie = (await signed_in(remote, token))["Cookie"]
    planted = (await signed_in(remote, token))["Cookie"]
    for both in (f"{cookie}; {planted}", f"{planted}; other=1; {cookie}"):
        assert_problem(await remote.get("/results", headers={"Cookie": both}), 401, "unauthorized")
    assert (await remote.get("/results", headers={"Cookie": f"a=b; {cookie}; {NAME}x=1"})).status_code == 200


async def test_over_tls_no_other_host_can_plant_one(store: Store, control: FakeControl, token: str) -> None:
    tls = {"X-Forwarded-Proto": "https"}
    ours = {"Origin": "https://stonefall.plant"}
    async with client_of(app_of(store, control, NAMED), "192.0.2.9", "stonefall.plant") as client:
        answer = await client.post("/session", json={"token": token}, headers={**tls, **ours})
        client.cookies.clear()
        cookie, _, attributes = answer.headers["Set-Cookie"].partition(";")
        assert cookie.startswith(f"{NAME_OVER_TLS}=")
        assert "Secure" in attributes
        assert "Path=/" in attributes
        assert "Domain" not in attributes
        assert (await client.get("/results", headers={**tls, "Cookie": cookie})).status_code == 200
        plain = cookie.replace(NAME_OVER_TLS, NAME)
        assert_problem(await client.get("/results", headers={**tls, "Cookie": plain}), 401, "unauthorized")
        written = await client.put("/acquisition", json=ARM, headers={**tls, **ours, "Cookie": cookie})
        assert written.status_code == 200
        http = {"Origin": "http://stonefall.plant"}  # a page that anybody on the way may have written
        refused = await client.put("/acquisition", json=ARM, headers={**tls, **http, "Cookie": cookie})
        assert_problem(refused, 403, "foreign-origin")


@pytest.mark.parametrize("host", ["127.0.0.1:8081", "stonefall.plant"])
async def test_a_proxy_passes_on_the_name_or_it_is_configured(
    store: Store, control: FakeControl, token: str, host: str
) -> None:
    ours = {"Origin": "https://stonefall.plant", "X-Forwarded-Proto": "https", "X-Forwarded-For": "192.0.2.9"}
    async with client_of(app_of(store, control, NAMED), host=host) as client:
        answer = await client.post("/session", json={"token": token}, headers=ours)
        assert answer.status_code == 200


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(data=st.data())
@pytest.mark.full
def test_no_other_cookie_is_a_session(
    store: Store, monkeypatch: pytest.MonkeyPatch, data: st.DataObject
) -> None:
    monkeypatch.setattr(Store, "trouble", StoreTrouble(TroubleCause.FULL, "so that memory alone has them"))
    sessions = Sessions(store)
    _, cookie = sessions.begin(KEY, 10**9)
    at = data.draw(st.integers(0, len(cookie) - 1))
    other = data.draw(
        st.one_of(
            st.characters(codec="latin-1").map(lambda char: cookie[:at] + char + cookie[at + 1 :]),
            st.just(cookie[:at]),
            st.text(st.characters(codec="latin-1")).map(lambda text: cookie + text),
            st.text(),
        )
    )
    assert (sessions.find(other, 1e9) is None) == (other != cookie)


async def test_a_stream_ends_with_its_session(
    store: Store, control: FakeControl, session: int, token: str
) -> None:
    async with served_by(app_of(store, control)) as served:
        host = f"127.0.0.1:{served.port}"
        async with httpx.AsyncClient(base_url=f"http://{host}/api/v1") as client:
            ours = {"Origin": f"http://{host}"}
            answer = await client.post("/session", json={"token": token}, headers=ours)
            cookie = answer.headers["Set-Cookie"].partition(";")[0]
            stream = await opened(served, more=f"Cookie: {cookie}\r\n")
            assert (await stream.head()).startswith("HTTP/1.1 200")
            await stream.next()
            assert (await client.delete("/session", headers=ours)).status_code == 204
            await add(store, session, 1, measured())
            problem = await stream.next()
            assert problem is not None
            assert (problem.event, problem.data["status"]) == ("problem", 401)
            assert await stream.next() is None
        store.release_waiters()


async def test_who_am_i(store: Store, control: FakeControl, state_dir: Path) -> None:
    everywhere = ApiSettings(host="0.0.0.0", without_keys=WithoutKeys.EVERY_HOST_MAY_READ)  # noqa: S104 - not bound
    app = app_of(store, control, everywhere)
    async with client_of(app) as here, client_of(app, "192.0.2.9", "127.0.0.1") as there:
        nobody = {"expires_at": None, "has_keys": False, "is_display": False}
        there_asks = (await there.get("/session")).json()
        assert there_asks == {"who": None, "scopes": ["read"], "keyless": [], **nobody}
        keyless = [
            {"address": address, "user_agent": here.headers["User-Agent"]}
            for address in ("127.0.0.1", "192.0.2.9")
        ]
        here_asks = (await here.get("/session")).json()
        assert here_asks == {"who": "this machine", "scopes": [*ALL], "keyless": keyless, **nobody}
        _, token = create_key(state_dir, "office", (Scope.READ, Scope.OPERATE), None, "root")
        for client in (here, there):
            unknown = {"who": None, "scopes": [], "keyless": [], **nobody, "has_keys": True}
            assert (await client.get("/session")).json() == unknown
            bearer = await client.get("/session", headers={"Authorization": f"Bearer {token}"})
            assert (bearer.json()["who"], bearer.json()["scopes"]) == ("key office", ["read", "operate"])
            assert "Set-Cookie" not in bearer.headers


async def test_viewers_of_this_machine_need_no_key_if_that_is_configured(
    store: Store, control: FakeControl, token: str
) -> None:
    app = app_of(store, control, ApiSettings(loopback_reads_without_key=True))
    async with client_of(app) as here, client_of(app, "192.0.2.9", "127.0.0.1:8080") as there:
        assert (await here.get("/results")).status_code == 200
        assert (await here.get("/session")).json()["who"] == "this machine"
        assert (await here.get("/results", headers={"Cookie": f"{NAME}=dead"})).status_code == 200
        assert_problem(await here.put("/acquisition", json=ARM), 401, "unauthorized")
        assert_problem(await here.get("/config"), 401, "unauthorized")
        wrong = {"Authorization": "Bearer guess"}
        assert_problem(await here.get("/results", headers=wrong), 401, "unauthorized")
        for header in ("X-Forwarded-For", "Forwarded", "Via", "X-Real-IP"):  # a proxy asks for somebody
            assert_problem(await here.get("/results", headers={header: "192.0.2.9"}), 401, "unauthorized")
        assert_problem(await there.get("/results"), 401, "unauthorized")
    async with client_of(app_of(store, control, ApiSettings())) as here:
        assert_problem(await here.get("/results"), 401, "unauthorized")


async def test_a_proxy_on_this_machine_writes_for_nobody_without_keys(
    store: Store, control: FakeControl
) -> None:
    async with client_of(app_of(store, control, ApiSettings())) as here:
        forwarded = {"X-Forwarded-For": "192.0.2.9"}
        assert_problem(await here.put("/acquisition", json=ARM, headers=forwarded), 403, "forbidden")
        assert (await here.put("/acquisition", json=ARM)).status_code == 200
