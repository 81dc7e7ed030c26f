"""The page of documentation: the OpenAPI document by `docs.html.jinja`, without scripts or fonts from elsewhere."""

from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from service.base.templates import templates_in


def docs_page(document: dict[str, Any]) -> str:
    """Return the page: every operation by tag, then every schema."""
    by_tag: dict[str, list[tuple[str, str, dict[str, Any]]]] = {}
    for path, operations in (document["paths"] | document["webhooks"]).items():
        for method, operation in operations.items():
            by_tag.setdefault(operation["tags"][0], []).append((path, method.upper(), operation))
    templates = templates_in(Path(__file__).parent)
    templates.filters |= {"kind": _kind, "name_in": _name_in, "prose": _prose}
    explained = {tag["name"]: tag["description"] for tag in document["tags"]}
    return templates.get_template("docs.html.jinja").render(document, by_tag=by_tag, explained=explained)


def _kind(schema: dict[str, Any]) -> Markup:
    """Return a JSON schema in a few words of HTML."""
    if "$ref" in schema:
        return Markup('<a href="#{0}">{0}</a>').format(_name_in(schema))
    if alternatives := schema.get("anyOf", schema.get("oneOf")):
        return Markup(" or ").join(map(_kind, alternatives))
    if isinstance(schema.get("type"), list):  # a scalar or null
        return _kind(schema | {"type": schema["type"][0]}) + " or null"
    if "enum" in schema or "const" in schema:
        values = schema.get("enum", [schema.get("const")])
        return Markup(", ").join(Markup("<code>{}</code>").format(value) for value in values)
    if schema.get("type") == "array":
        return "list of " + _kind(schema["items"])
    if isinstance(schema.get("additionalProperties"), dict):
        return "map to " + _kind(schema["additionalProperties"])
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


def _prose(text: str) -> Markup:
    """Return text as HTML, with what stands between backticks as code."""
    parts = text.split("`")
    return Markup("").join(
        Markup("<code>{}</code>").format(part) if i % 2 else part for i, part in enumerate(parts)
    )
