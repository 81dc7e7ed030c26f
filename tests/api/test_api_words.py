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
