"""Words of a query that a route does not know are refused: a typing error would be a wrong report."""

import re

import httpx
import pytest
from support.rest import assert_problem


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("/particles?min_sieve=3", "min_sieve: .*did you mean min_sieve_size_mm"),
        ("/results?afte=3", "afte: .*did you mean after"),
        (
            "/lots?colour=red",
            "colour: .*there are before, customer, external_id, limit, order, product, search, state",
        ),
        ("/health?verbose=1", "verbose: .*there are none here"),
    ],
)
async def test_an_unknown_word_of_a_query_is_refused_with_the_nearest_known_one(
    client: httpx.AsyncClient, path: str, words: str
) -> None:
    answer = await client.get(path)
    assert_problem(answer, 422, "invalid-request")

    assert re.search(words, answer.json()["detail"]), answer.json()["detail"]


@pytest.mark.parametrize("path", ["/results", "/diary", "/lots"])
async def test_a_plus_sign_that_came_as_a_blank_is_told(client: httpx.AsyncClient, path: str) -> None:
    name = "before" if path == "/lots" else "since"
    for offset in ("+02:00", "+0200"):
        refused = await client.get(f"{path}?{name}=2026-08-15T10:00:00{offset}")
        assert_problem(refused, 422, "invalid-request")
        assert refused.json()["detail"].startswith(f"query.{name}: ")
        assert refused.json()["detail"].endswith("; a plus sign is %2B in a query")
    assert (await client.get(f"{path}?{name}=2026-08-15T10:00:00%2B02:00")).status_code == 200
    wrong = await client.get(f"{path}?{name}=2026-08-15 25:00:00")
    assert "%2B" not in wrong.text


async def test_a_query_that_is_not_utf_8_is_refused(client: httpx.AsyncClient) -> None:
    refused = await client.get("/lots?order=Gr%F6%DFe")
    assert_problem(refused, 422, "invalid-request")
    assert refused.json()["detail"].startswith("query.order: must be UTF-8")
    assert (await client.get("/lots?order=Gr%C3%B6%C3%9Fe")).status_code == 200


async def test_a_body_that_is_not_utf_8_is_told_with_its_byte(client: httpx.AsyncClient) -> None:
    entry = '{"kind": "other", "text": "Größe"}'
    for media_type in ("application/json", "application/json; charset=iso-8859-1"):
        headers = {"Content-Type": media_type}
        refused = await client.post("/diary", content=entry.encode("latin-1"), headers=headers)
        assert_problem(refused, 400, "bad-request")
        place = entry.index("ö")
        assert f"must be UTF-8: byte 0xF6 at position {place} is not" in refused.json()["detail"]
        taken = await client.post("/diary", content=entry.encode(), headers=headers)
        assert taken.json()["text"] == "Größe"


@pytest.mark.parametrize("path", ["/accounting", "/lots/none", "/lots?colour=red", "/openapi.json"])
async def test_head_has_the_headers_of_get_and_no_body(client: httpx.AsyncClient, path: str) -> None:
    got, head = await client.get(path), await client.head(path)
    assert (head.status_code, head.content) == (got.status_code, b"")
    own = {"x-request-id", "date"}
    assert {k: v for k, v in head.headers.items() if k not in own} == {
        k: v for k, v in got.headers.items() if k not in own
    }


async def test_head_of_a_stream_ends(client: httpx.AsyncClient) -> None:
    head = await client.head("/results/stream")
    assert (head.status_code, head.headers["Content-Type"].partition(";")[0], head.content) == (
        200, "text/event-stream", b"",
    )  # fmt: skip
    assert (await client.head("/lots/L1/close")).status_code == 405
