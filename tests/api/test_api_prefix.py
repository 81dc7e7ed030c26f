"""The service below a path of a proxy, which passes the path on or strips it."""

from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest
from support.rest import FakeControl, app_of, client_of

from service.store import Store
from service.store.keys import create_key
from service.web.routes.screens import PAGES, ROOT
from service.web.settings import OWN_PATHS, ApiSettings, Scope
from service.web.version import BASE

PREFIX = "/stonefall"
HOST = "stonefall.plant"
SETTINGS = ApiSettings(path_prefix=PREFIX, allowed_hosts=(HOST,), trusted_proxies=("127.0.0.1",))
OVER_TLS = {"X-Forwarded-Proto": "https", "X-Forwarded-For": "192.0.2.9"}
OURS = {**OVER_TLS, "Origin": f"https://{HOST}"}


@pytest.fixture(params=[f"{PREFIX}{BASE}", BASE], ids=["passed on", "stripped"])
async def proxied(
    store: Store, control: FakeControl, request: pytest.FixtureRequest
) -> AsyncIterator[httpx.AsyncClient]:
    async with client_of(app_of(store, control, SETTINGS), host=HOST) as client:
        client.base_url = httpx.URL(f"http://{HOST}{request.param}")
        yield client


async def test_a_browser_signs_in_and_writes(
    proxied: httpx.AsyncClient, state_dir: Path, control: FakeControl
) -> None:
    _, token = create_key(state_dir, "office", tuple(Scope), None, "root")
    answer = await proxied.post("/session", json={"token": token}, headers=OURS)
    cookie, _, attributes = answer.headers["Set-Cookie"].partition(";")
    assert cookie.startswith("__Host-stonefall-session-stonefall=")  # one name an instrument of the host
    assert {"Secure", "Path=/", "HttpOnly"} <= {each.strip() for each in attributes.split(";")}
    proxied.cookies.clear()
    headers = {**OURS, "Cookie": cookie}
    armed = await proxied.put("/acquisition", json={"state": "armed"}, headers=headers)
    assert (armed.status_code, control.state) == (200, "armed")
    foreign = {**headers, "Origin": "https://other.plant"}
    assert (await proxied.put("/acquisition", json={"state": "disarmed"}, headers=foreign)).status_code == 403


async def test_what_is_made_is_found_where_location_says(proxied: httpx.AsyncClient, state_dir: Path) -> None:
    _, token = create_key(state_dir, "office", tuple(Scope), None, "root")
    key = {"Authorization": f"Bearer {token}", **OVER_TLS}
    product = {"title": "8/16", "density_kg_m3": 2850, "lower_mm": 8, "upper_mm": 16}
    await proxied.put("/products/basalt", json=product, headers=key)
    opened = await proxied.post("/lots", json={"lot": "L-1", "product": "basalt"}, headers=key)
    assert opened.status_code == 201, opened.text
    assert opened.headers["Location"] == f"{PREFIX}{BASE}/lots/L-1"
    assert (await proxied.get(f"https://{HOST}{PREFIX}{BASE}/lots/L-1", headers=key)).json()["lot"] == "L-1"


async def test_a_doubled_slash_after_the_prefix_is_one(proxied: httpx.AsyncClient) -> None:
    for path in (f"{PREFIX}//api/v1/health/live", f"{PREFIX}{BASE}//health/live"):
        assert (await proxied.get(f"http://{HOST}{path}", headers=OVER_TLS)).status_code == 200


@pytest.mark.full
async def test_the_document_names_the_prefix_as_its_server(proxied: httpx.AsyncClient) -> None:
    document = (await proxied.get("/openapi.json", headers=OVER_TLS)).json()
    assert [server["url"] for server in document["servers"]] == [PREFIX]


async def test_the_folder_itself_leads_into_it(store: Store, control: FakeControl) -> None:
    async with client_of(app_of(store, control, SETTINGS), host=HOST) as client:
        answer = await client.get(f"http://{HOST}{PREFIX}", headers=OVER_TLS)
        assert (answer.status_code, answer.headers["Location"]) == (308, f"{PREFIX}/")
        for path in (f"{PREFIX}/", "/"):
            assert (await client.get(f"http://{HOST}{path}", headers=OVER_TLS)).status_code == 200
        for path in ("/stonefallen/lots", f"{PREFIX}{PREFIX}/lots"):
            assert (await client.get(f"http://{HOST}{path}", headers=OVER_TLS)).status_code == 404


@pytest.mark.parametrize(
    "prefix",
    [
        "stonefall",
        "/",
        "/a/",
        "//a",
        "/a b",
        "/ä",
        "/..",
        "/a?b",
        "/a;b",
        "/api",
        "/lots/x",
        "https://x/a",
        "/%61",
    ],
)
def test_a_prefix_that_leads_nowhere_is_refused(prefix: str) -> None:
    with pytest.raises(ValueError, match="path_prefix must be a path such as /stonefall"):
        ApiSettings(path_prefix=prefix)


def test_a_prefix_hides_no_path_of_ours() -> None:
    ours = {address.split("/")[1] for address in (*PAGES, ROOT, BASE)}
    assert ours - {""} == set(OWN_PATHS)
