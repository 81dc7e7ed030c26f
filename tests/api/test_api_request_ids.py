"""Each request has an id, by which its client and the log speak of it."""

import uuid

import httpx
import pytest
from support.rest import FakeControl, app_of, assert_problem, client_of

from service.base.status import Health
from service.store import Store


async def test_the_id_of_the_client_is_in_every_answer(client: httpx.AsyncClient) -> None:
    headers = {"X-Request-Id": "mes-4711:retry.1"}
    for path, status in (
        ("/health", 200),
        ("/nothing", 404),
        ("/results?limit=0", 422),
        ("/openapi.json", 200),
    ):
        answer = await client.get(path, headers=headers)
        assert (answer.status_code, answer.headers["X-Request-Id"]) == (status, "mes-4711:retry.1")
        if status >= 400:
            assert answer.json()["request_id"] == "mes-4711:retry.1"
    refused = await client.put("/acquisition", content=b"x" * 2_000_000, headers=headers)
    assert_problem(refused, 413, "content-too-large")
    assert refused.headers["X-Request-Id"] == "mes-4711:retry.1"


@pytest.mark.parametrize("given", [None, "", "a b", "x" * 129, 'a"b', "é"])
async def test_without_a_valid_one_it_gets_its_own(client: httpx.AsyncClient, given: str | None) -> None:
    headers = {} if given is None else {"X-Request-Id": given.encode()}
    ids = {(await client.get("/health", headers=headers)).headers["X-Request-Id"] for _ in range(2)}
    assert len(ids) == 2
    for each in ids:
        uuid.UUID(each)


class FaultyControl(FakeControl):
    def health(self) -> Health:
        raise ZeroDivisionError


async def test_the_log_of_a_failure_names_it(store: Store, caplog: pytest.LogCaptureFixture) -> None:
    async with client_of(app_of(store, FaultyControl())) as client:
        answer = await client.get("/health", headers={"X-Request-Id": "mes-4712"})
    assert_problem(answer, 500, "internal-error")
    assert answer.headers["X-Request-Id"] == "mes-4712"
    assert "request mes-4712: GET /api/v1/health failed" in caplog.text
