"""What JSON schemas of answers say beyond their types."""

from typing import Any

from pydantic.config import JsonDict

TIME: JsonDict = {"format": "date-time"}
"""Addition to the schema of a text that is a time, RFC 3339."""


def always_present(schema: dict[str, Any]) -> None:
    """Mark all fields of a model as required in its schema: they are in every answer, defaults included."""
    schema["required"] = list(schema["properties"])
    for property_ in schema["properties"].values():
        property_.pop("default", None)
