"""The table of result fields in `service/web/README.md`; a test compares it with this.

Run `python -m service.results.table` after a change of `service.results.fields`, and put what it prints between the two
markers of the guide.
"""

import sys
from collections.abc import Iterator, Mapping
from typing import Any

from service.results.fields import MEASURED_FIELDS, Result

BEGIN = "<!-- python -m service.results.table -->"
END = "<!-- end of the table -->"
Definitions = Mapping[str, Mapping[str, Any]]


def fields_table() -> str:
    """Return the fields of a result as a Markdown table, between the markers."""
    schema = Result.model_json_schema(mode="serialization")
    rows = ["| field | type | null | meaning |", "|---|---|---|---|", *_rows(schema, schema["$defs"], "")]
    return "\n".join([BEGIN, *rows, END]) + "\n"


def _rows(schema: Mapping[str, Any], definitions: Definitions, prefix: str) -> Iterator[str]:
    for name, field in schema["properties"].items():
        kinds = [_resolved(each, definitions) for each in field.get("anyOf", [field])]
        (kind,) = (each for each in kinds if each.get("type") != "null")
        null = "no"
        if name in MEASURED_FIELDS and not prefix:
            null = "unless measured"
        elif len(kinds) > 1:
            null = "yes"
        meaning = " ".join(field.get("description", "").split())
        yield f"| `{prefix}{name}` | {_type(kind, definitions)} | {null} | {meaning} |"
        if "properties" in kind:
            yield from _rows(kind, definitions, f"{prefix}{name}.")
        elif (values := _map_values(kind, definitions)) is not None and "properties" in values:
            yield from _rows(values, definitions, f"{prefix}{name}.<camera>.")


def _type(kind: Mapping[str, Any], definitions: Definitions) -> str:
    if "const" in kind or "enum" in kind:
        return ", ".join(f"`{value}`" for value in kind.get("enum", [kind.get("const")]))
    if kind.get("type") == "array":
        return f"list of {_type(_resolved(kind['items'], definitions), definitions)}s"
    if (values := _map_values(kind, definitions)) is not None:
        return f"map to {_type(values, definitions)}"
    return "time" if kind.get("format") == "date-time" else str(kind["type"])


def _map_values(kind: Mapping[str, Any], definitions: Definitions) -> Mapping[str, Any] | None:
    """Return the schema of the values of a map, None for anything else."""
    values = kind.get("additionalProperties")
    return _resolved(values, definitions) if isinstance(values, dict) else None


def _resolved(schema: Mapping[str, Any], definitions: Definitions) -> Mapping[str, Any]:
    return definitions[schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema


if __name__ == "__main__":
    sys.stdout.write(fields_table())
