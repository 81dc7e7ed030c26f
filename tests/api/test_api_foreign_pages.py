"""What a page of a stranger can have a browser ask for is refused; what programs ask for is not."""

import httpx
import pytest
from support.rest import FakeControl, app_of, assert_problem, client_of

from service.store import Store
from service.web.settings import ApiSettings, WithoutKeys

ARM = {"state": "armed"}
NAMED = ApiSettings(
    host="0.0.0.0",  # noqa: S104 - not bound
    allowed_hosts=("stonefall.plant", "192.0.2.80"),
    without_keys=WithoutKeys.EVERY_HOST_MAY_READ,
)


@pytest.mark.parametrize("path", ["/results", "/health/live", "/openapi.json", "/docs", "/nothing"])
async def test_a_name_that_is_not_ours_reads_nothing(store: Store, control: FakeControl, path: str) -> None:
    """A page whose own name leads to this machine would otherwise read as if it were ours (DNS rebinding)."""
    async with client_of(app_of(store, control, ApiSettings()), host="rebound.example") as client:
        answer = await client.get(path)
        assert_problem(answer, 421, "unknown-host")
        assert "'rebound.example'" in answer.json()["detail"]
        assert_problem(await client.put("/acquisition", json=ARM), 421, "unknown-host")
        assert_problem(await client.post("/calibrations/0001/activate"), 421, "unknown-host")
    assert control.state == "disarmed"


@pytest.mark.parametrize(
    ("host", "is_ours"),
    [
        ("localhost:8080", True),
        ("LOCALHOST.", True),
        ("127.0.0.2", True),
        ("[::1]:8080", True),
        ("stonefall.plant", True),
        ("Stonefall.Plant:8080", True),
        ("192.0.2.80", True),
        ("192.0.2.7:8080", True),  # the address that the request came to
        ("192.0.2.8", False),
        ("rebound.example", False),
        ("stonefall.plant.rebound.example", False),
        ("127.0.0.1.rebound.example", False),
        ("127.0.0.1@rebound.example", False),
        ("[bad", False),
        ("", False),
    ],
)
async def test_names_of_this_service(store: Store, control: FakeControl, host: str, is_ours: bool) -> None:
    async with client_of(app_of(store, control, NAMED), "192.0.2.9", "192.0.2.7:8080") as client:
        answer = await client.get("/results", headers={"Host": host})
    assert answer.status_code == (200 if is_ours else 421)


@pytest.mark.parametrize(
    ("origin", "is_ours"),
    [
        ("http://127.0.0.1:8080", True),
        ("https://stonefall.plant", True),
        ("http://127.0.0.1", False),
        ("http://localhost:3000", False),
        ("http://[::1]:8080", False),
        ("https://rebound.example", False),
        ("http://127.0.0.1:8080.rebound.example", False),
        ("http://[bad", False),
        ("null", False),
        ("", False),
    ],
)
async def test_pages_of_strangers_do_not_write(
    store: Store, control: FakeControl, origin: str, is_ours: bool
) -> None:
    headers = {"Origin": origin}
    async with client_of(app_of(store, control, NAMED)) as client:
        assert (await client.get("/results", headers=headers)).status_code == 200
        arm = await client.put("/acquisition", json=ARM, headers=headers)
        roll_back = await client.post("/calibrations/0001/activate", headers=headers)  # as a form does
        recording = await client.post("/recordings/r1/stop", headers=headers)
    if is_ours:
        assert (arm.status_code, roll_back.status_code, recording.status_code) == (200, 200, 404)
        return
    for answer in (arm, roll_back, recording):
        assert_problem(answer, 403, "foreign-origin")
        assert repr(origin) in answer.json()["detail"]
    assert control.state == "disarmed"


@pytest.mark.parametrize(
    ("media_type", "is_json"),
    [
        ("application/json", True),
        ("Application/JSON; charset=utf-8", True),
        ("text/plain", False),
        ("application/x-www-form-urlencoded", False),
        ("multipart/form-data; boundary=x", False),
        (None, False),
    ],
)
async def test_bodies_are_json_and_say_so(
    client: httpx.AsyncClient, control: FakeControl, media_type: str | None, is_json: bool
) -> None:
    """A form sends what looks like JSON as text, without asking whether it may."""
    headers = {} if media_type is None else {"Content-Type": media_type}
    answer = await client.put("/acquisition", content=b'{"state": "armed"}', headers=headers)
    if is_json:
        assert (answer.status_code, control.state) == (200, "armed")
        return
    assert_problem(answer, 415, "unsupported-media-type")
    assert control.state == "disarmed"
    signed = await client.post("/calibrations/0001/activate", content=b"{}", headers=headers)
    assert_problem(signed, 415, "unsupported-media-type")


async def test_a_compressed_body_is_refused_as_such(client: httpx.AsyncClient) -> None:
    for coding, status in (("gzip", 415), ("identity", 200), ("UTF-8", 200), ("utf8", 200), ("", 200)):
        headers = {"Content-Type": "application/json", "Content-Encoding": coding}
        answer = await client.put("/acquisition", content=b'{"state": "disarmed"}', headers=headers)
        assert answer.status_code == status
        if status == 415:
            assert_problem(answer, 415, "unsupported-media-type")
            assert answer.json()["detail"] == "a body must not be compressed: Content-Encoding is 'gzip'"
            assert answer.headers["Accept-Encoding"] == "identity"


async def test_a_program_needs_no_body_to_write(client: httpx.AsyncClient) -> None:
    assert (await client.post("/calibrations/0001/activate")).status_code == 200
