"""The tables of guides that follow from the program; a test compares them with this.

Run `python -m service.results.table` after a change of `service.results.fields` or `service.results.version`: it writes
each between the two markers of its guide.
"""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from service.results.fields import MEASURED_FIELDS, Result
from service.results.version import CHANGES, CHANGES_GUIDE

BEGIN = "<!-- python -m service.results.table -->"
END = "<!-- end of the table -->"
Definitions = Mapping[str, Mapping[str, Any]]


def fields_table() -> list[str]:
    """Return the fields of a result as a Markdown table."""
    schema = Result.model_json_schema(mode="serialization")
    return ["| field | type | null | meaning |", "|---|---|---|---|", *_rows(schema, schema["$defs"], "")]


def changes_table() -> list[str]:
    """Return the changes of all versions of the algorithm as a Markdown table."""
    rows = (f"| {version} | {changed} | {figure} |" for version, (changed, figure) in CHANGES.items())
    return ["| version | what changed in results | a figure of that time |", "|---|---|---|", *rows]


TABLES: Mapping[str, Callable[[], list[str]]] = {
    "service/web/README.md": fields_table,
    CHANGES_GUIDE: changes_table,
}
"""By the guide that has it."""


def renewed(guide: str, table: list[str]) -> str:
    """Return the text of a guide with this table between its markers."""
    before, _, rest = guide.partition(BEGIN)
    return before + "\n".join([BEGIN, *table, END]) + rest.partition(END)[2]


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
    for name, table in TABLES.items():
        path = Path(name)
        path.write_text(renewed(path.read_text(encoding="utf-8"), table()), encoding="utf-8")
