"""Errors have one form and reveal nothing internal; keys and scopes permit what they should."""

import errno
import hashlib
import re
import sqlite3
from collections.abc import AsyncIterator
from contextlib import closing
from http import HTTPStatus
from pathlib import Path

import httpx
import pytest
from support.outcomes import add, measured
from support.rest import FakeControl, app_of, assert_problem, client_of

from service.base.status import Health
from service.store import Store
from service.web.problems import all_problems
from service.web.settings import ApiKey, ApiSettings, Scope

ROOT = Path(__file__).parents[2]
ARM = {"state": "armed"}


def test_each_kind_has_a_title_and_stands_in_the_guide() -> None:
    sources = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "service").rglob("*.py"))
    raised = re.findall(r'Problem\(\s*(\d{3}),\s*"([a-z-]+)"', sources)
    described = all_problems()
    titles = {kind for kinds in described.values() for kind in kinds}
    assert [(status, kind) for status, kind in raised if kind not in described[HTTPStatus(int(status))]] == []
    kinds = {kind for _, kind in raised}
    kinds |= {f"unknown-{kind}" for kind in re.findall(r'existing\([^"]+"([a-z]+)", ', sources)}
    assert {"not-ready", "unknown-lot", "unknown-sample"} <= kinds <= titles
    guide = (ROOT / "service" / "web" / "README.md").read_text(encoding="utf-8")
    unknown = {kind for kind in titles if f"`{kind}`" not in guide}
    assert {kind for kind in unknown if f"`{kind.removeprefix('unknown')}`" not in guide} == set()


async def test_unknown_paths_and_methods(client: httpx.AsyncClient) -> None:
    assert_problem(await client.get("/nothing"), 404, "not-found")
    assert_problem(await client.get("/results/"), 404, "not-found")
    refused = await client.post("/results")
    assert_problem(refused, 405, "method-not-allowed")
    assert refused.headers["Allow"] == "GET"
    for path, allowed in (("/acquisition", "GET, PUT"), ("/verifications", "GET, POST")):
        refused = await client.delete(path)
        assert_problem(refused, 405, "method-not-allowed")
        assert refused.headers["Allow"] == allowed


async def test_wrong_fields_are_named_as_the_client_wrote_them(client: httpx.AsyncClient) -> None:
    answer = await client.get("/accounting", params={"session": "x"})
    assert_problem(answer, 422, "invalid-request")
    assert {error["field"] for error in answer.json()["errors"]} == {"query.session"}
    answer = await client.put("/acquisition", json={"state": "flying", "more": 1})
    assert {error["field"] for error in answer.json()["errors"]} == {"body.state", "body.more"}


async def test_malformed_bodies(client: httpx.AsyncClient) -> None:
    headers = {"Content-Type": "application/json"}
    for content in (b"{", b"\xff\xfe", b"[" * 100_000, b""):
        answer = await client.put("/acquisition", content=content, headers=headers)
        assert answer.status_code in (400, 422)
        assert answer.headers["Content-Type"] == "application/problem+json"


async def test_bodies_have_a_limit(client: httpx.AsyncClient, control: FakeControl) -> None:
    async def endless() -> AsyncIterator[bytes]:
        for _ in range(20):
            yield b" " * 100_000

    assert_problem(await client.put("/acquisition", content=b" " * 1_000_001), 413, "content-too-large")
    headers = {"Content-Type": "application/json"}
    answer = await client.put("/acquisition", content=endless(), headers=headers)
    assert_problem(answer, 413, "content-too-large")


class FaultyControl(FakeControl):
    def health(self) -> Health:
        raise ZeroDivisionError("the secret of the house")


async def test_a_bug_is_a_500_without_a_trace(store: Store, caplog: pytest.LogCaptureFixture) -> None:
    async with client_of(app_of(store, FaultyControl(), ApiSettings())) as client:
        answer = await client.get("/health")
    assert_problem(answer, 500, "internal-error")
    assert "secret" not in answer.text
    assert "ZeroDivision" not in answer.text
    assert "GET /api/v1/health failed" in caplog.text
    assert "ZeroDivisionError: the secret of the house" in caplog.text


@pytest.mark.parametrize("path", ["/api/v1//health", "/stonefall/api/v1/health"])
async def test_a_bug_is_a_500_however_its_address_is_written(store: Store, path: str) -> None:
    """The answer to a failure is made outside of what reads the address."""
    async with client_of(app_of(store, FaultyControl(), ApiSettings(path_prefix="/stonefall"))) as client:
        answer = await client.get(client.base_url.copy_with(path=path))
    assert answer.json()["type"] == "urn:stonefall:problem:internal-error"
    assert answer.json()["instance"] == "/api/v1/health"


async def test_a_broken_store_is_a_503(
    client: httpx.AsyncClient, state_dir: Path, caplog: pytest.LogCaptureFixture
) -> None:
    database, aside = state_dir / "results.sqlite", state_dir / "aside"
    database.rename(aside)
    answer = await client.get("/results")
    aside.rename(database)
    assert_problem(answer, 503, "store-unavailable")
    assert answer.headers["Retry-After"] == "5"
    assert str(state_dir) not in answer.text
    assert f"GET /api/v1/results failed: {database}: unable to open" in caplog.text


async def test_asking_again_does_not_mend_a_damaged_store(
    client: httpx.AsyncClient, store: Store, session: int, state_dir: Path
) -> None:
    await add(store, session, 1, measured())
    assert (await client.get("/consumers")).status_code == 200  # keys were read, as at the start of a daemon
    database = state_dir / "results.sqlite"
    with closing(sqlite3.connect(database)) as other:
        other.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    database.write_bytes(database.read_bytes()[:4096].ljust(100_000, b"\xa5"))
    answer = await client.get("/results")
    assert_problem(answer, 500, "store-damaged")
    assert "Retry-After" not in answer.headers
    assert "restore a backup" in answer.json()["detail"]


async def test_a_disk_that_refuses_to_write_is_a_503(
    client: httpx.AsyncClient, control: FakeControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def start(plan: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system", "/secret/path")

    monkeypatch.setattr(control.recordings, "start", start)
    answer = await client.post("/recordings", json={"name": "a", "count": 1})
    assert_problem(answer, 503, "store-unavailable")
    assert "secret" not in answer.text


@pytest.mark.parametrize(
    ("address", "host", "is_allowed"),
    [
        ("127.0.0.1", "127.0.0.1:8080", True),
        ("::1", "[::1]:8080", True),
        ("::ffff:127.0.0.1", "localhost", True),
        ("192.0.2.7", "127.0.0.1", False),
        ("192.0.2.7", "instrument", False),
        ("127.0.0.1", "instrument", False),  # through a proxy on this machine
    ],
)
async def test_without_keys_only_this_machine_writes(
    store: Store, control: FakeControl, address: str, host: str, is_allowed: bool
) -> None:
    settings = ApiSettings(allowed_hosts=("instrument",))
    async with client_of(app_of(store, control, settings), address, host) as client:
        assert (await client.get("/results")).status_code == 200
        answer = await client.put("/acquisition", json=ARM)
    if is_allowed:
        assert answer.json()["state"] == "armed"
    else:
        assert_problem(answer, 403, "forbidden")
        assert control.state == "disarmed"


def key(name: str, *scopes: Scope) -> ApiKey:
    return ApiKey(name=name, sha256=hashlib.sha256(f"{name}-token".encode()).hexdigest(), scopes=scopes)


async def test_keys_and_scopes(store: Store, control: FakeControl) -> None:
    keys = (key("mes", Scope.READ), key("shift", Scope.READ, Scope.OPERATE))
    async with client_of(app_of(store, control, ApiSettings(keys=keys))) as client:
        for headers in ({}, {"Authorization": "Basic bWVz"}, {"Authorization": "Bearer nobody-token"}):
            answer = await client.get("/results", headers=headers)
            assert_problem(answer, 401, "unauthorized")
            assert answer.headers["WWW-Authenticate"].startswith("Bearer")
        mes, shift = ({"Authorization": f"Bearer {name}-token"} for name in ("mes", "shift"))
        for path in ("/results", "/particles", "/accounting", "/cameras", "/acquisition", "/health"):
            assert (await client.get(path)).status_code == 401
            assert (await client.get(path, headers=mes)).status_code == 200
        assert_problem(await client.put("/acquisition", json=ARM, headers=mes), 403, "forbidden")
        assert_problem(await client.put("/acquisition", json=ARM), 401, "unauthorized")  # loopback is no key
        assert control.state == "disarmed"
        assert (await client.put("/acquisition", json=ARM, headers=shift)).json()["state"] == "armed"
        for path in ("/health/live", "/health/ready", "/openapi.json", "/docs"):
            assert (await client.get(path)).status_code == 200


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="key 'mes': sha256"):
        ApiKey(name="mes", sha256="token")
    with pytest.raises(ValueError, match="port"):
        ApiSettings(port=70000)
    with pytest.raises(ValueError, match="max_body_bytes"):
        ApiSettings(max_body_bytes=0)
    for host in ("", "256.1.1.1", "1.2.3", "a b", "http://plant", "plant:8080", "-a", "a..b", "[::1]", "*"):
        with pytest.raises(ValueError, match=r"^host must be an address or a host name"):
            ApiSettings(host=host)
        with pytest.raises(ValueError, match=r"^allowed_hosts: "):
            ApiSettings(allowed_hosts=("plant", host))
    for host in ("::", "fe80::1%eth0", "192.0.2.1", "plant", "a-1.plant.example"):
        assert ApiSettings(host=host).host == host


@pytest.mark.parametrize(
    ("host", "url"),
    [
        ("0.0.0.0", "http://127.0.0.1:8080"),  # noqa: S104 - not bound
        ("::", "http://[::1]:8080"),
        ("10.0.0.2", "http://10.0.0.2:8080"),
        ("fd00::2", "http://[fd00::2]:8080"),
        ("rig-1.plant", "http://rig-1.plant:8080"),
    ],
)
def test_this_machine_reaches_a_daemon_that_listens_on_every_interface(host: str, url: str) -> None:
    assert ApiSettings(host=host, port=8080).local_url == url
