"""`[opcua]` of the bridge's configuration."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class OpcUaSettings:
    """Where the OPC UA server listens."""
