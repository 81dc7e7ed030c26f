"""Keys of `stonefall keys` on a served store: known at once, dead at once, never opened by a damaged file."""

import asyncio
import json
from collections.abc import AsyncIterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest
from support.rest import FakeControl, app_of, assert_problem, client_of

from pipeline.frames import rfc3339
from service.base.errors import StoreError
from service.store import Store
from service.store.keys import FILE, create_key, rename_file, revoke_key, sha256_of, take_over
from service.web.clients import MAX_WRONG
from service.web.settings import ApiKey, ApiSettings, Scope, WithoutKeys

CONFIGURED = ApiKey(
    name="scada", sha256="9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
)  # of "test"
EVERYWHERE = "0.0.0.0"  # noqa: S104 - not bound


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def created(folder: Path, name: str, *scopes: Scope, expires_at: str | None = None) -> dict[str, str]:
    """Create a key and return the header that asks with it."""
    return bearer(create_key(folder, name, scopes or (Scope.READ,), expires_at, "root")[1])


@pytest.fixture
async def remote(store: Store, control: FakeControl) -> AsyncIterator[httpx.AsyncClient]:
    async with client_of(app_of(store, control, ApiSettings()), "192.0.2.1") as client:
        yield client


async def test_a_key_opens_its_scopes_at_once_and_is_dead_at_once(
    remote: httpx.AsyncClient, state_dir: Path
) -> None:
    assert (await remote.get("/results")).status_code == 200  # there is no key
    mes = created(state_dir, "mes", Scope.READ, Scope.OPERATE)
    assert_problem(await remote.get("/results"), 401, "unauthorized")
    assert (await remote.get("/results", headers=mes)).status_code == 200
    armed = await remote.put("/acquisition", json={"state": "armed"}, headers=mes)
    assert armed.status_code == 200
    assert_problem(await remote.get("/config", headers=mes), 403, "forbidden")
    revoke_key(state_dir, "mes", "root")
    dead = await remote.get("/results", headers=mes)
    assert_problem(dead, 401, "unauthorized")
    assert "key 'mes' was revoked at 2" in dead.json()["detail"]
    assert_problem(await remote.get("/results"), 401, "unauthorized")  # the last one revoked opens nothing
    again = created(state_dir, "mes")
    assert (await remote.get("/results", headers=again)).status_code == 200
    assert (await remote.get("/results", headers=mes)).status_code == 401


async def test_an_expired_key_says_so(
    remote: httpx.AsyncClient, state_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    end = datetime.now(UTC) + timedelta(days=1)
    mes = created(state_dir, "mes", expires_at=rfc3339(end))
    assert (await remote.get("/results", headers=mes)).status_code == 200
    monkeypatch.setattr("service.web.auth.utc_now", lambda: rfc3339(end))
    for _ in range(2 * MAX_WRONG):  # it is no guess: others at this address are not shut out
        refused = await remote.get("/results", headers=mes)
        assert_problem(refused, 401, "unauthorized")
    assert refused.json()["detail"] == f"key 'mes' expired at {rfc3339(end)}"
    assert refused.headers["WWW-Authenticate"] == 'Bearer error="invalid_token"'
    assert (await remote.get("/results", headers=created(state_dir, "other"))).status_code == 200


async def test_guesses_stay_limited(remote: httpx.AsyncClient, state_dir: Path) -> None:
    mes = created(state_dir, "mes")
    for _ in range(MAX_WRONG):
        assert_problem(await remote.get("/results", headers=bearer("guess")), 401, "unauthorized")
    assert_problem(await remote.get("/results", headers=bearer("guess")), 429, "too-many-attempts")
    assert (await remote.get("/results", headers=mes)).status_code == 200


@pytest.mark.parametrize(
    "content", [b"{", b"", b"[]", b'{"keys": [{"name": "mes"}]}', b"\xff", b" " * 2_000_000]
)
async def test_a_damaged_file_of_an_earlier_release_opens_nothing_and_configured_keys_still_work(
    store: Store, control: FakeControl, state_dir: Path, content: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    await asyncio.to_thread((state_dir / FILE).write_bytes, content)
    rename_file(state_dir, await store.write(take_over, state_dir))
    assert caplog.text.count(f"keys: {state_dir / FILE}: ") == 1
    assert await asyncio.to_thread((state_dir / f"{FILE}.damaged").read_bytes) == content
    for keys, status in (((CONFIGURED,), 200), ((), 401)):
        async with client_of(app_of(store, control, ApiSettings(keys=keys))) as client:
            assert (await client.get("/results")).status_code == 401
            assert (await client.get("/results", headers=bearer("test"))).status_code == status
    assert "create them anew" in caplog.text
    mes = created(state_dir, "mes")
    async with client_of(app_of(store, control)) as client:
        assert (await client.get("/results", headers=mes)).status_code == 200


async def test_keys_of_an_earlier_release_are_taken_over_once(
    store: Store, remote: httpx.AsyncClient, state_dir: Path
) -> None:
    times = {"created_at": "2026-01-01T00:00:00.000Z", "created_by": "ann", "scopes": ["read"]}
    revoked = {"revoked_at": "2026-02-01T00:00:00.000Z", "revoked_by": "bob"}
    keys = [
        {"name": "mes", "sha256": sha256_of("mes"), "expires_at": None, **times},
        {"name": "old", "sha256": sha256_of("old"), **times, **revoked},
    ]
    text = json.dumps({"format": "stonefall-keys/1", "keys": keys})
    for _ in range(2):  # a file that was put back changes nothing
        await asyncio.to_thread((state_dir / FILE).write_text, text)
        rename_file(state_dir, await store.write(take_over, state_dir))
        assert await asyncio.to_thread((state_dir / f"{FILE}.taken-over").read_text) == text
        assert not await asyncio.to_thread((state_dir / FILE).exists)
        assert (await remote.get("/results", headers=bearer("mes"))).status_code == 200
        dead = await remote.get("/results", headers=bearer("old"))
        assert_problem(dead, 401, "unauthorized")
        assert dead.json()["detail"] == f"key 'old' was revoked at {revoked['revoked_at']}"
        entries = (await remote.get("/audit", headers=bearer("mes"))).json()["items"]
        assert [(each["who"], each["action"]) for each in entries] == [("stonefall", "keys taken over")]
        assert [each["revoked_by"] for each in entries[0]["after"]["keys"]] == [None, "bob"]
        assert "sha256" not in str(entries)


async def test_a_store_that_cannot_be_read_opens_nothing_and_keys_that_are_known_stay(
    store: Store, control: FakeControl, state_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(query: object) -> None:
        raise StoreError("disk I/O error")

    mes, guest = created(state_dir, "mes"), bearer("guess")
    async with client_of(app_of(store, control)) as client, client_of(app_of(store, control)) as new:
        assert (await client.get("/results", headers=mes)).status_code == 200
        with monkeypatch.context() as patched:
            patched.setattr(store, "read_here", refuse)
            assert (await client.get("/results", headers=mes)).status_code == 200
            assert (await client.get("/results", headers=guest)).status_code == 401
            for headers in (mes, guest, {}):
                assert (await new.get("/results", headers=headers)).status_code == 401
        assert (await new.get("/results", headers=mes)).status_code == 200


async def test_without_any_key_other_hosts_may_read_only_when_told_in_words(
    store: Store, control: FakeControl, state_dir: Path
) -> None:
    for without_keys, status in ((WithoutKeys.NOTHING, 401), (WithoutKeys.EVERY_HOST_MAY_READ, 200)):
        settings = ApiSettings(host=EVERYWHERE, allowed_hosts=("plant",), without_keys=without_keys)
        app = app_of(store, control, settings)
        async with client_of(app, "192.0.2.1", "plant") as remote, client_of(app) as local:
            assert (await remote.get("/results")).status_code == status
            assert (await remote.put("/acquisition", json={"state": "armed"})).status_code == 403
            assert (await remote.get("/config")).status_code == 403
            assert (await remote.get("/health/live")).status_code == 200
            assert (await local.get("/results")).status_code == 200
            assert (await local.get("/config")).status_code == 200
            mes = created(state_dir, "mes")
            assert (await remote.get("/results")).status_code == 401
            assert (await remote.get("/results", headers=mes)).status_code == 200
        await store.write(lambda connection: connection.execute("DELETE FROM keys").close())


async def test_what_the_command_did_is_in_the_audit_once(
    store: Store, control: FakeControl, state_dir: Path
) -> None:
    boss = created(state_dir, "boss", *Scope)
    created(state_dir, "mes", Scope.READ, expires_at="2099-01-01T00:00:00.000Z")
    for _ in range(2):  # as after a restart
        async with client_of(app_of(store, control)) as client:
            entries = (await client.get("/audit", headers=boss)).json()["items"]
            assert [(each["action"], each["subject"]) for each in entries] == [
                ("key created", "boss"),
                ("key created", "mes"),
            ]
    revoke_key(state_dir, "mes", "ann")
    created(state_dir, "mes")
    async with client_of(app_of(store, control)) as client:
        entries = (await client.get("/audit?after=2", headers=boss)).json()["items"]
    assert [(each["who"], each["action"], each["subject"]) for each in entries] == [
        ("stonefall keys of ann", "key revoked", "mes"),
        ("stonefall keys of root", "key created", "mes"),
    ]
    assert entries[0]["before"]["expires_at"] == "2099-01-01T00:00:00.000Z"
    assert entries[0]["after"]["scopes"] == ["read"]
    assert "sha256" not in str(entries)
