"""The OpenAPI document is committed and complete, its page readable without a network."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import jsonschema_rs
import pytest
from pydantic import BaseModel

from service.daemon.rest.examples import EXAMPLES
from service.daemon.rest.openapi import openapi_text
from service.results.fields import ALWAYS
from service.web.openapi_parts import shared_answer
from service.web.problems import all_problems
from service.web.settings import ApiSettings

ROOT = Path(__file__).parents[2]
COMMITTED = ROOT / "deploy" / "openapi.json"


def test_the_committed_description_is_the_programs() -> None:
    assert COMMITTED.read_text(encoding="utf-8") == openapi_text(), (
        "run: python -m service.daemon.rest.openapi > deploy/openapi.json, and raise API_VERSION"
    )


async def test_it_is_served(client: httpx.AsyncClient) -> None:
    served = (await client.get("/openapi.json")).json()
    assert served == json.loads(openapi_text())
    assert served["openapi"].startswith("3.1")


def test_every_reference_leads_somewhere_and_every_error_is_a_problem() -> None:
    text = openapi_text()
    document = json.loads(text)
    for kind, name in re.findall(r'"#/components/(\w+)/([^"]+)"', text):
        assert name in document["components"][kind]
    for _, _, operation in operations():
        for status, answer in operation["responses"].items():
            if status == "default" or status >= "4":
                assert list(answer["content"]) == ["application/problem+json"]
        assert operation["description"]
    result = document["components"]["schemas"]["Result"]
    assert set(result["required"]) == set(ALWAYS)  # further ones may be left out, by `fields` alone


async def test_the_page_needs_nothing_else(client: httpx.AsyncClient) -> None:
    page = (await client.get("/docs")).text
    assert not re.search(r"<script|src=|https?://|@import|url\(", page)
    anchors = set(re.findall(r'id="(\w+)"', page))
    assert set(re.findall(r'href="#(\w+)"', page)) <= anchors
    for path in json.loads(openapi_text())["paths"]:
        assert f"<code>{path}</code>" in page


def operations() -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield each operation, with its parameters and answers instead of references to them."""
    document = json.loads(openapi_text())

    def resolved(part: dict[str, Any]) -> dict[str, Any]:
        _, _, kind, name = part["$ref"].split("/") if "$ref" in part else ("", "", "", "")
        return dict(document["components"][kind][name]) if name else part

    for path, described in document["paths"].items():
        for method, operation in described.items():
            parameters = [resolved(each) for each in operation.get("parameters", ())]
            answers = {status: resolved(each) for status, each in operation["responses"].items()}
            yield path, method, operation | {"parameters": parameters, "responses": answers}


def test_what_operations_share_is_described_once() -> None:
    document = json.loads(openapi_text())
    inline = [
        answer
        for described in document["paths"].values()
        for operation in described.values()
        for status, answer in operation["responses"].items()
        if status >= "3" and list(answer) != ["$ref"]
    ]
    assert inline == []
    n_operations = sum(len(operations) for operations in document["paths"].values())
    assert len(COMMITTED.read_text(encoding="utf-8").splitlines()) < 155 * n_operations
    for status, titles in all_problems().items():
        answer = document["components"]["responses"][shared_answer(str(int(status)))["$ref"].split("/")[-1]]
        assert set(re.findall(r"`([a-z-]+)` \(", answer["description"])) == set(titles)


def test_each_operation_has_a_summary_for_people() -> None:
    summaries = {operation["operationId"]: operation["summary"] for _, _, operation in operations()}
    assert summaries["alarms"] == "List the alarms"
    assert summaries["post_lot"] == "Open a lot"
    for summary in summaries.values():
        assert re.fullmatch(r"(?!Return|Post|Put)[A-Z][a-z]+ .{2,64}", summary), summary


def test_headers_of_answers_are_described() -> None:
    headers = {
        (method, path.removeprefix("/api/v1"), status): set(answer.get("headers", ()))
        for path, method, operation in operations()
        for status, answer in operation["responses"].items()
    }
    assert headers["post", "/lots", "201"] == {"ETag", "Location", "Idempotent-Replayed"}
    assert headers["post", "/diary", "201"] == {"Idempotent-Replayed"}
    assert headers["put", "/products/{product}", "200"] == headers["get", "/lots/{lot}", "304"] == {"ETag"}
    assert headers["get", "/results", "200"] == set()
    assert all(
        each == {"Retry-After"} for (_, _, status), each in headers.items() if status in ("429", "503")
    )


def test_everything_has_a_description() -> None:
    document = json.loads(openapi_text())
    tags = {tag["name"] for tag in document["tags"] if tag["description"]}
    missing = [
        name for name, schema in document["components"]["schemas"].items() if not schema.get("description")
    ]
    for name, schema in document["components"]["schemas"].items():
        fields = schema.get("properties", {}).items()
        missing += [f"{name}.{field}" for field, body in fields if not body.get("description")]
    for path, method, operation in operations():
        parameters = operation.get("parameters", [])
        missing += [f"{method} {path}: {each['name']}" for each in parameters if not each.get("description")]
        missing += [f"tag {tag}" for tag in operation["tags"] if tag not in tags]
    assert missing == []


def test_files_are_binary_texts_are_text_and_everything_else_has_a_schema() -> None:
    media_types = set()
    for path, method, operation in operations():
        for answer in operation["responses"].values():
            for media_type, content in answer.get("content", {}).items():
                assert content["schema"], (method, path)
                if media_type in ("text/plain", "text/event-stream"):
                    assert content["schema"] == {"type": "string"}, (method, path)
                elif "json" not in media_type:
                    assert content["schema"] == {"type": "string", "format": "binary"}, (method, path)
                    media_types.add(media_type)
    assert {"image/png", "application/x-tar", "model/ply", "application/pdf", "text/csv"} <= media_types


def test_every_post_may_be_repeated_with_a_key() -> None:
    for path, method, operation in operations():
        names = {each["name"] for each in operation.get("parameters", ())}
        is_session = path.startswith("/api/v1/session")  # of which none is given twice
        assert ("Idempotency-Key" in names) == (method == "post" and not is_session), path
        # the key is looked at with the scope
        assert "security" in operation or method == "get" or is_session, path


def test_each_operation_names_its_scope() -> None:
    scopes = {(method, path): it["security"] for path, method, it in operations() if "security" in it}
    for (method, path), (required,) in scopes.items():
        (scope,) = required["key"]
        reads = method == "get" or path == "/api/v1/reports/verify"  # a file is too large for an address
        assert scope in ({"read", "configure"} if reads else {"operate", "configure"}), (method, path)
    assert scopes["post", "/api/v1/lots"] == [{"key": ["operate"]}]
    assert scopes["get", "/api/v1/config"] == [{"key": ["configure"]}]


def test_the_guide_names_each_resource() -> None:
    guide = (ROOT / "service" / "web" / "README.md").read_text(encoding="utf-8")
    table = guide[guide.index("## Resources") : guide.index("## Generated clients")]
    resources = {path.removeprefix("/api/v1").split("{")[0].rstrip("/") for path, _, _ in operations()}
    assert len(resources) > 20
    assert {each for each in resources if f"`{each}`" not in table and f"`{each}/{{" not in table} == set()


def types_of(schema: dict[str, Any]) -> list[str]:
    kind = schema.get("type", [])
    return kind if isinstance(kind, list) else [kind]


def schemas(part: Any) -> Iterator[dict[str, Any]]:
    """Yield each object of the document: schemas are among them."""
    if isinstance(part, dict):
        yield part
    for inner in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        yield from schemas(inner)


def test_generators_of_clients_can_write_all_of_it() -> None:
    """What clients in Java did not compile with, or lost (`tests/benchmarks/generated_client.py`)."""
    document = json.loads(openapi_text())
    for schema in schemas(document):
        parts = [each for each in schema.get("anyOf", ()) if each.get("type") != "null"]
        if len(parts) > 1:  # its default becomes a name, a list without a name no class
            assert "default" not in schema and "array" not in {each.get("type") for each in parts}, schema
        if "integer" in types_of(schema):  # 32 bits
            assert schema["format"] == "int64", schema
        if "boolean" in types_of(schema):  # an enumeration of texts
            assert "const" not in schema and "enum" not in schema, schema
    for path, _, operation in operations():
        for parameter in operation.get("parameters", ()):  # a union becomes an object
            parts = [each for each in parameter["schema"].get("anyOf", ()) if each.get("type") != "null"]
            assert len(parts) <= 1, (path, parameter["name"])
    imported = {"Consumer", "Duration", "File", "List", "Map", "Pair", "Set", "URI"}
    assert not imported & set(document["components"]["schemas"])


def test_numbers_that_are_asked_for_are_bounded() -> None:
    """SQLite takes integers of 64 bits: beyond, a request would end in 500 instead of 422."""
    document = json.loads(openapi_text())
    n_numbers = 0
    for path, method, operation in operations():
        asked = [operation.get("parameters", []), operation.get("requestBody", {})]
        named = re.findall(r"#/components/schemas/(\w+)", json.dumps(asked))
        asked += [document["components"]["schemas"][name] for name in named]
        numbers = [each for each in schemas(asked) if "integer" in types_of(each)]
        assert all("maximum" in each or "enum" in each for each in numbers), (method, path, numbers)
        n_numbers += len(numbers)
    assert n_numbers > 20


@pytest.mark.parametrize("model", EXAMPLES, ids=lambda model: model.__name__)
def test_examples_are_valid(model: type[BaseModel]) -> None:
    schemas = json.loads(openapi_text())["components"]
    name = next(
        name for name, schema in schemas["schemas"].items() if schema.get("examples") == [EXAMPLES[model]]
    )
    reference = {"$ref": f"#/components/schemas/{name}", "components": schemas}
    jsonschema_rs.validate(reference, EXAMPLES[model], validate_formats=True)


def test_the_service_is_where_the_document_says() -> None:
    (server,) = json.loads(openapi_text())["servers"]
    defaults = {name: variable["default"] for name, variable in server["variables"].items()}
    assert server["url"].format(**defaults) == f"http://{ApiSettings().host}:{ApiSettings().port}"


def test_whatever_a_client_sends_has_a_bound() -> None:
    """A text, a list or a map without one would be parsed, stored and sent again on the event loop."""
    document = json.loads(openapi_text())
    unbounded: list[str] = []

    def look(schema: dict[str, Any], where: str) -> None:
        while "$ref" in schema:
            schema = document["components"]["schemas"][schema["$ref"].rpartition("/")[2]]
        for each in schema.get("anyOf", ()):
            look(each, where)
        bounds = {
            # a pattern has a bound if nothing in it repeats at will
            "string": "maxLength" in schema
            or "enum" in schema
            or schema.get("format") == "date-time"
            or re.search(r"[+*]|,\}", schema.get("pattern", "*").replace("[\\x21-\\x7e]", "")) is None,
            "array": "maxItems" in schema,
            "object": "properties" in schema or "maxProperties" in schema,
        }
        unbounded.extend(where for kind in types_of(schema) if not bounds.get(kind, True))
        for name, each in schema.get("properties", {}).items():
            look(each, f"{where}.{name}")
        for each in (schema.get("items"), schema.get("additionalProperties")):
            if isinstance(each, dict):
                look(each, f"{where}[]")

    for path, method, operation in operations():
        for body in operation.get("requestBody", {}).get("content", {}).values():
            look(body["schema"], f"{method} {path}")
        for each in operation.get("parameters", ()):
            if each["in"] != "header":  # the server bounds the head of a request
                look(each["schema"], f"{method} {path} {each['name']}")
    assert unbounded == []
