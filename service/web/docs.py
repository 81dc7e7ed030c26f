"""The documentation page: HTML made from the OpenAPI document, without scripts or fonts from elsewhere."""

from collections.abc import Iterator, Sequence
from html import escape
from typing import Any

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem;
  color: #222 }
h2 { margin: 2.5rem 0 .5rem; border-bottom: 2px solid #b5a48a; text-transform: capitalize }
summary { cursor: pointer; padding: .4rem .5rem; background: #f5f2ec; border-radius: 4px }
details { margin: .4rem 0 } details > div { padding: .2rem 1rem }
code { font: 13px/1.4 ui-monospace, monospace } b.method { display: inline-block; width: 3.2rem }
b.PUT { color: #a35200 } b.GET { color: #1d6b3f }
table { border-collapse: collapse; width: 100%; margin: .5rem 0 }
td { vertical-align: top; padding: .2rem .8rem .2rem 0; border-bottom: 1px solid #e5e0d6 }
@media (prefers-color-scheme: dark) {
  body { background: #1c1b19; color: #ddd } summary { background: #2b2925 } a { color: #9cf }
  b.GET { color: #7fcf9f } b.PUT { color: #f0a868 } td { border-color: #3a3731 }
}
"""


def docs_page(document: dict[str, Any]) -> str:
    """Return the page: every operation by tag, then every schema."""
    info = document["info"]
    by_tag: dict[str, list[str]] = {}
    components = document["components"]
    for path, operations in (document["paths"] | document["webhooks"]).items():
        for method, operation in operations.items():
            part = _operation(path, method.upper(), operation, components["parameters"])
            by_tag.setdefault(operation["tags"][0], []).append(part)
    described = {tag["name"]: tag["description"] for tag in document["tags"]}
    sections = "".join(
        f"<h2>{escape(tag)}</h2><p>{_prose(described.get(tag) or '')}</p>{''.join(parts)}"
        for tag, parts in by_tag.items()
    )
    answers = "".join(_shared_answer(name, answer) for name, answer in components["responses"].items())
    schemas = "".join(_schema(name, schema) for name, schema in components["schemas"].items())
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(info["title"])}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style>'
        f"<h1>{escape(info['title'])} <small>{escape(info['version'])}</small></h1>"
        f'<p>{escape(info["summary"])}. For programs: <a href="openapi.json">openapi.json</a> '
        f"(OpenAPI {escape(document['openapi'])}).</p><p>{_prose(info['description'])}</p>"
        f"{sections}<h2>Shared answers</h2>{answers}<h2>Schemas</h2>{schemas}</html>"
    )


def _operation(path: str, method: str, operation: dict[str, Any], shared: dict[str, Any]) -> str:
    description = operation.get("description", "")
    parameters = [
        (item["name"], item["in"], _type(item["schema"]), item.get("description", ""))
        for each in operation.get("parameters", [])
        for item in [shared[_name_in(each)] if "$ref" in each else each]
    ]
    if "requestBody" in operation:
        (content,) = operation["requestBody"]["content"].values()
        parameters.append(("body", "body", _type(content["schema"]), ""))
    answers = [
        (status, _type(answer) if "$ref" in answer else ", ".join(_contents(answer)), _answer(answer))
        for status, answer in operation["responses"].items()
    ]
    scopes = ", ".join(scope for each in operation.get("security", ()) for scope in each["key"])
    key = f"Needs a key with the scope `{scopes}`." if scopes else "Needs no key."
    return (
        f'<details><summary><b class="method {method}">{method}</b> <code>{escape(path)}</code>'
        f" {escape(operation['summary'])}</summary>"
        f"<div><p>{_prose(description)}</p><p>{_prose(key)}</p>{_table(parameters)}{_table(answers)}</div></details>"
    )


def _answer(answer: dict[str, Any]) -> str:
    headers = ", ".join(f"`{name}`" for name in answer.get("headers", ()))
    description: str = answer.get("description", "")
    return f"{description}; headers {headers}" if headers else description


def _shared_answer(name: str, answer: dict[str, Any]) -> str:
    return (
        f'<details id="{escape(name)}"><summary><code>{escape(name)}</code></summary>'
        f"<div><p>{_prose(_answer(answer))}</p></div></details>"
    )


def _schema(name: str, schema: dict[str, Any]) -> str:
    fields = [
        (field, _type(body), body.get("description", ""))
        for field, body in schema.get("properties", {}).items()
    ]
    values = f"<p>{_type(schema)}</p>" if not fields else ""
    return (
        f'<details id="{escape(name)}"><summary><code>{escape(name)}</code></summary><div>'
        f"<p>{_prose(schema.get('description', ''))}</p>{values}{_table(fields)}</div></details>"
    )


def _contents(answer: dict[str, Any]) -> Iterator[str]:
    for media_type, content in answer.get("content", {}).items():
        is_file = content["schema"].get("format") == "binary"
        yield f"<code>{escape(media_type)}</code>" if is_file else _type(content["schema"])


def _type(schema: dict[str, Any]) -> str:
    """Return a JSON schema in a few words of HTML."""
    if "$ref" in schema:
        name = escape(_name_in(schema))
        return f'<a href="#{name}">{name}</a>'
    if alternatives := schema.get("anyOf", schema.get("oneOf")):
        return " or ".join(_type(part) for part in alternatives)
    if isinstance(schema.get("type"), list):  # a scalar or null
        return f"{_type(schema | {'type': schema['type'][0]})} or null"
    if "enum" in schema or "const" in schema:
        return ", ".join(
            f"<code>{escape(str(value))}</code>" for value in schema.get("enum", [schema.get("const")])
        )
    if schema.get("type") == "array":
        return f"list of {_type(schema['items'])}"
    if isinstance(schema.get("additionalProperties"), dict):
        return f"map to {_type(schema['additionalProperties'])}"
    limits = [
        f"{sign} {schema[key]:g}" for key, sign in (("minimum", "≥"), ("maximum", "≤")) if key in schema
    ]
    kind = schema.get("type", "any")
    words = [kind if kind == "integer" else schema.get("format", kind), *limits]
    if "default" in schema:
        words.append(f"(default {schema['default']})")
    return escape(" ".join(words))


def _name_in(reference: dict[str, str]) -> str:
    return reference["$ref"].rsplit("/", 1)[-1]


def _prose(text: str) -> str:
    """Return text as HTML, with what stands between backticks as code."""
    parts = escape(text).split("`")
    return "".join(f"<code>{part}</code>" if i % 2 else part for i, part in enumerate(parts))


def _table(rows: Sequence[tuple[str, ...]]) -> str:
    """Return a table; the first cell of a row is a name, the last is prose, the others are HTML already."""
    lines = (
        f"<tr><td><code>{escape(first)}</code></td>{''.join(f'<td>{cell}</td>' for cell in middle)}"
        f"<td>{_prose(last)}</td></tr>"
        for first, *middle, last in rows
    )
    return f"<table>{''.join(lines)}</table>" if rows else ""
