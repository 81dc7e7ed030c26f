"""`[contacts]` of the bridge's configuration."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactsSettings:
    """Where the register map of Modbus TCP is served, and the lines that are switched."""
