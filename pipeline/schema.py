"""How dataclasses that are served as they are describe themselves."""

from collections.abc import Mapping

SCHEMA: Mapping[str, object] = {
    "use_attribute_docstrings": True,
    "json_schema_serialization_defaults_required": True,
}
"""`__pydantic_config__` of such a class: docstrings describe its fields, and all are always there."""
