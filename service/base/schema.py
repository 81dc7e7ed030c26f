"""Marks of fields beyond their types: dataclasses are settings, and schemas of the REST interface, as they are."""

from dataclasses import is_dataclass
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter
from pydantic.config import JsonDict

from pipeline.frames import rfc3339
from pipeline.schema import SCHEMA

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


ANSWER: ConfigDict = {**SCHEMA, "json_schema_extra": _describe_inherited}  # type: ignore[typeddict-item]  # a plain dict, as pipeline knows no pydantic
"""`__pydantic_config__` of a dataclass that is served: docstrings describe its fields, and all are always there."""
REQUEST = ConfigDict(use_attribute_docstrings=True, extra="forbid", json_schema_extra=_describe_inherited)
"""`__pydantic_config__` of a dataclass that is the body of a request."""

Name = Annotated[str, Field(min_length=1, max_length=200)]
"""A name or title that people give."""
Remark = Annotated[str, Field(max_length=2000)]


LIVE = "applies without a restart"
T = TypeVar("T")
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
