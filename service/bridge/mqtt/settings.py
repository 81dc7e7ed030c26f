"""`[mqtt]` of the bridge's configuration."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class MqttSettings:
    """The broker that results are published to."""
