"""The fields of a result as the columns of a table: each a single value with its type, unit and definition."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from functools import cache
from typing import Any

from service.base.units import unit_of
from service.results.fields import Result

PARTS = {"min_box_mm": "abc", "center_mm": "xyz"}
"""Lists of numbers that become a column each, by the letters of these: `min_box_a_mm`."""
Cell = str | float | int | bool | datetime | None


class ColumnKind(StrEnum):
    """Type of the values of a column."""

    NUMBER = "number"
    INTEGER = "integer"
    BOOLEAN = "boolean"
    TIME = "date-time"
    TEXT = "string"
    JSON = "json"
    """Lists and maps, as text."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnOfStones:
    """A column: where its value is in a record, and what it means."""

    name: str
    kind: ColumnKind
    path: tuple[str | int, ...]
    description: str

    @property
    def unit(self) -> str | None:
        """Unit at the end of its name."""
        return unit_of(self.name)

    def cell(self, record: Mapping[str, Any]) -> Cell:
        """Return the value of a record, None where it is not known."""
        value: Any = record
        for step in self.path:
            value = None if value is None else value[step] if isinstance(step, int) else value.get(step)
        if value is None or (self.kind is ColumnKind.TIME and not value):
            return None
        match self.kind:
            case ColumnKind.TIME:
                return datetime.fromisoformat(value)
            case ColumnKind.BOOLEAN:
                return bool(value)
            case ColumnKind.NUMBER:
                return float(value)
            case ColumnKind.JSON:
                return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
        found: Cell = value
        return found


@cache
def columns_of_stones() -> tuple[ColumnOfStones, ...]:
    """Return the columns that a result has, in the order of its fields."""
    schema = Result.model_json_schema(mode="serialization")
    return tuple(_columns(schema, schema["$defs"], ()))


def _columns(
    schema: Mapping[str, Any], definitions: Mapping[str, Any], within: tuple[str, ...]
) -> Iterator[ColumnOfStones]:
    for name, field in schema["properties"].items():
        (kind,) = (
            definitions[each["$ref"].rpartition("/")[2]] if "$ref" in each else each
            for each in field.get("anyOf", [field])
            if each.get("type") != "null"
        )
        path = (*within, name)
        description = " ".join(field.get("description", "").split())
        if "properties" in kind:
            yield from _columns(kind, definitions, path)
        elif name in PARTS:
            stem, _, unit = name.rpartition("_")
            for place, letter in enumerate(PARTS[name]):
                yield ColumnOfStones(
                    name=f"{stem}_{letter}_{unit}",
                    kind=ColumnKind.NUMBER,
                    path=(*path, place),
                    description=description,
                )
        else:
            yield ColumnOfStones(name=".".join(path), kind=_kind(kind), path=path, description=description)


def _kind(schema: Mapping[str, Any]) -> ColumnKind:
    """Return the type of the values that a schema describes; what has a choice of words is text."""
    kind = schema.get("format") if schema.get("format") == ColumnKind.TIME else schema.get("type")
    if kind in ("array", "object"):
        return ColumnKind.JSON
    return ColumnKind(kind or ColumnKind.TEXT)
