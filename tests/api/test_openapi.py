"""The OpenAPI document is committed and complete, its page readable without a network."""

import json
import re
from pathlib import Path

import httpx

from service.api.openapi import openapi_text

COMMITTED = Path(__file__).parents[2] / "deploy" / "openapi.json"


def test_the_committed_description_is_the_programs() -> None:
    assert COMMITTED.read_text(encoding="utf-8") == openapi_text(), (
        "run: python -m service.api.openapi > deploy/openapi.json, and raise API_VERSION"
    )


async def test_it_is_served(client: httpx.AsyncClient) -> None:
    served = (await client.get("/openapi.json")).json()
    assert served == json.loads(openapi_text())
    assert served["openapi"].startswith("3.1")


def test_every_reference_leads_somewhere_and_every_error_is_a_problem() -> None:
    text = openapi_text()
    document = json.loads(text)
    for name in re.findall(r'"#/components/schemas/(\w+)"', text):
        assert name in document["components"]["schemas"]
    for operations in document["paths"].values():
        for operation in operations.values():
            for status, answer in operation["responses"].items():
                if status == "default" or status >= "4":
                    assert list(answer["content"]) == ["application/problem+json"]
            assert operation["description"]
    result = document["components"]["schemas"]["Result"]
    assert set(result["required"]) == set(result["properties"])


async def test_the_page_needs_nothing_else(client: httpx.AsyncClient) -> None:
    root = await client.get("http://127.0.0.1:8080/")
    assert (root.status_code, root.headers["Location"]) == (307, "/api/v1/docs")
    page = (await client.get("/docs")).text
    assert not re.search(r"<script|src=|https?://|@import|url\(", page)
    anchors = set(re.findall(r'id="(\w+)"', page))
    assert set(re.findall(r'href="#(\w+)"', page)) <= anchors
    for path in json.loads(openapi_text())["paths"]:
        assert f"<code>{path}</code>" in page
