"""Marks of fields beyond their types: dataclasses are settings, and schemas of the REST interface, as they are."""

from dataclasses import dataclass, is_dataclass
from typing import Annotated, Any, TypeVar, dataclass_transform

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter
from pydantic.config import JsonDict

from pipeline.frames import rfc3339
from pipeline.schema import SCHEMA

T = TypeVar("T")

TIME: JsonDict = {"format": "date-time"}
"""Addition to the schema of a text that is a time, RFC 3339."""
Time = Annotated[str, Field(json_schema_extra=TIME)]
"""A time of an answer, RFC 3339 UTC."""
OptionalTime = Annotated[str | None, Field(json_schema_extra=TIME)]
GivenTime = Annotated[str, AfterValidator(rfc3339), Field(json_schema_extra=TIME)]
"""A time that a client gives, RFC 3339 in any zone; the value is UTC."""


def _describe_inherited(schema: dict[str, Any], kind: type[Any]) -> None:
    """Describe the fields that a dataclass has from its base: pydantic reads its own docstrings alone."""
    if is_dataclass(base := kind.__base__):
        for name, member in TypeAdapter(base).json_schema(mode="serialization")["properties"].items():
            schema["properties"][name].setdefault("description", member.get("description"))


@dataclass_transform(frozen_default=True, kw_only_default=True)
def served(kind: type[T]) -> type[T]:
    """Make a frozen dataclass that REST serves: docstrings describe its fields, and all are always there."""
    return _described(kind, **SCHEMA)


@dataclass_transform(frozen_default=True, kw_only_default=True)
def request_body(kind: type[T]) -> type[T]:
    """Make a frozen dataclass that is the body of a request: docstrings describe its fields, and others are errors."""
    return _described(kind, use_attribute_docstrings=True, extra="forbid")


def _described(kind: type[T], **config: object) -> type[T]:
    config |= {"json_schema_extra": _describe_inherited}
    kind.__pydantic_config__ = config  # type: ignore[attr-defined]  # where pydantic looks for it
    return dataclass(frozen=True, slots=True, kw_only=True)(kind)


Name = Annotated[str, Field(min_length=1, max_length=200)]
"""A name or title that people give."""
Remark = Annotated[str, Field(max_length=2000)]


LIVE = "applies without a restart"
Live = Annotated[T, LIVE]
"""A setting that applies when the file is read again; others are built into devices, workers, store or sockets."""


def require_ranges(settings: object, **ranges: tuple[float, float]) -> None:
    """Raise `ValueError` when a setting is below or above its range."""
    for name, (low, high) in ranges.items():
        value = getattr(settings, name)
        if not low <= value <= high:
            shown = (each if isinstance(each, int) else f"{each:g}" for each in (low, high, value))
            raise ValueError("{} must be in {}..{}, not {}".format(name, *shown))


class RequestBody(BaseModel):
    """Body of a request, in which other fields than its own are errors."""

    model_config = ConfigDict(extra="forbid")


def always_present(schema: dict[str, Any]) -> None:
    """Mark all fields of a model as required in its schema: they are in every answer, defaults included."""
    schema["required"] = list(schema["properties"])
    for property_ in schema["properties"].values():
        property_.pop("default", None)
